"""Scenes in one file each, for a machine that lacks the readers' libraries and takes few megabytes.

A packed scene holds what training reads of a scene: cameras, pictures as lossless WebP (bytes, as training has them),
the starting points, and the files that a run leaves beside its splats before it trains (flash.npz, exposures.json).
Colours where a mask is zero take part in nothing, and are packed as black. Reading one back needs numpy and Pillow.
"""

from __future__ import annotations

import io
import os
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from mgsr.config import Config
from mgsr.data.camera import Camera
from mgsr.data.scene import Scene, Similarity, View
from mgsr.shading.light_kind import LightKind
from mgsr.start.points import StartingPoints, StartSource

BALL = "ball"
PARTS = ("train", "test")
# What a run finds before it trains, and leaves among its results.
FINDINGS = ("flash.npz", "exposures.json")


@dataclass(frozen=True)
class Packed:
    """A scene, its starting points, and the files that a run leaves before it trains, by their names."""

    scene: Scene
    start: StartingPoints
    findings: dict[str, bytes]


def read(path: Path, config: Config, views: int | None = None) -> Packed:
    """Return a scene as a run has it before it trains; `ball` is the tests' textured ball.

    views: so many of its training photographs, at even distances, None for all.
    """
    if str(path) == BALL:
        scene, start = ball()
        return Packed(scene, start, {})
    from mgsr.data.readers import load_scene
    from mgsr.pipeline.preprocess import preprocess
    from mgsr.pipeline.progress import ignore
    from mgsr.pipeline.steps import StepClock, Steps, never

    scene = load_scene(path, config.data)
    if views is not None:
        scene = replace(scene, train=spread(scene.train, views))
    with tempfile.TemporaryDirectory() as folder:
        scene, start = preprocess(scene, config, Path(folder), Steps(StepClock(), ignore, never))
        found = {name: Path(folder, name) for name in FINDINGS}
        return Packed(scene, start, {name: file.read_bytes() for name, file in found.items() if file.is_file()})


def ball(size: int = 256, train: int = 40, points: int = 20000) -> tuple[Scene, StartingPoints]:
    """Return the tests' textured ball, for a machine without any scene: its photographs' side and number."""
    from tests.training.ball import ball_points, ball_scene

    return ball_scene(size, train, test=4), ball_points(points)


def spread(views: Sequence[View], count: int) -> list[View]:
    """Return `count` of the views, at even distances; all of them where there are not more."""
    if count >= len(views):
        return list(views)
    return [views[i * len(views) // count] for i in range(count)]


def pack(content: Packed, file: Path) -> None:
    """Write a packed scene; the file appears whole or not at all."""
    scene, start = content.scene, content.start
    arrays: dict[str, Any] = {"positions": start.positions, "colors": start.colors}
    if start.normals is not None:
        arrays["normals"] = start.normals
    if start.light is not None:
        arrays["light"] = str(start.light)
    arrays |= {"scale": scene.user_from_scene.scale, "offset": scene.user_from_scene.offset, "name": scene.name}
    arrays |= {name: np.frombuffer(content, np.uint8) for name, content in content.findings.items()}
    for part, views in zip(PARTS, (scene.train, scene.test), strict=True):
        arrays |= {f"{part}_{name}": array for name, array in _view_arrays(views, scene.masked).items()}
    unfinished = file.with_name(f".{file.name}")
    with unfinished.open("wb") as target:
        np.savez_compressed(target, **arrays)
    os.replace(unfinished, file)


def unpack(file: Path) -> Packed:
    """Read what `pack` wrote."""
    with np.load(file) as stored:
        arrays = dict(stored)
    views = {part: list(_views(arrays, part)) for part in PARTS}
    similarity = Similarity(float(arrays["scale"]), arrays["offset"])
    scene = Scene(str(arrays["name"]), file, "packed", views["train"], views["test"], None, similarity)
    light = LightKind(str(arrays["light"])) if "light" in arrays else None
    start = StartingPoints(arrays["positions"], arrays["colors"], StartSource.CAPTURE, arrays.get("normals"), light)
    return Packed(scene, start, {name: arrays[name].tobytes() for name in FINDINGS if name in arrays})


def packed_or_ball(name: str, config: Config) -> Packed:
    """Return what is in a packed file, or for the name `ball` the ball."""
    return read(Path(BALL), config) if name == BALL else unpack(Path(name))


def _view_arrays(views: Sequence[View], masked: bool) -> dict[str, np.ndarray]:
    planes: dict[str, list[np.ndarray | None]] = {
        "pictures": [_picture(view, masked) for view in views],
        "lit": [view.irradiance for view in views],
        "known": [None if view.valid_mask is None else view.valid_mask.astype(np.uint8) for view in views],
    }
    arrays = {
        "names": np.array([view.name for view in views], np.str_),
        "K": np.array([view.camera.K for view in views]),
        "poses": np.array([view.camera.cam_from_world for view in views]),
    }
    for name, images in planes.items():
        coded = [b"" if image is None else _coded(image) for image in images]
        arrays[name] = np.frombuffer(b"".join(coded), np.uint8)
        arrays[f"{name}_sizes"] = np.array([len(code) for code in coded], np.int64)
    return arrays


def _picture(view: View, masked: bool) -> np.ndarray:
    """Return a view's colours, and alpha where there is one, [H,W,3 or 4]."""
    if view.alpha is None:
        return view.image
    shown = view.image * (view.alpha > 0)[..., None] if masked else view.image
    return np.concatenate([shown, view.alpha[..., None]], axis=2)


def _views(arrays: dict[str, np.ndarray], part: str) -> Iterator[View]:
    pictures, lit, known = (_decoded(arrays, f"{part}_{name}") for name in ("pictures", "lit", "known"))
    for i, name in enumerate(arrays[f"{part}_names"]):
        picture = pictures[i]
        assert picture is not None
        height, width, channels = picture.shape
        light, shown = lit[i], known[i]
        yield View(
            str(name),
            Camera(arrays[f"{part}_K"][i], arrays[f"{part}_poses"][i], width, height),
            np.ascontiguousarray(picture[..., :3]),
            np.ascontiguousarray(picture[..., 3]) if channels == 4 else None,
            None if shown is None else shown[..., 0] > 0,
            None if light is None else np.ascontiguousarray(light[..., 0]),
        )


def _coded(image: np.ndarray) -> bytes:
    """Encode an image as lossless WebP; of higher efforts, method 6 saves another 5% in 15 times the time."""
    coded = io.BytesIO()
    Image.fromarray(image).save(coded, "WEBP", lossless=True, exact=True, quality=80, method=4)
    return coded.getvalue()


def _decoded(arrays: dict[str, np.ndarray], name: str) -> list[np.ndarray | None]:
    """Decode images [H,W,3 or 4], None for each that is not there."""
    ends = np.cumsum(arrays[f"{name}_sizes"])
    parts = np.split(arrays[name], ends[:-1]) if len(ends) else []
    return [_image(part.tobytes()) if len(part) else None for part in parts]


def _image(coded: bytes) -> np.ndarray:
    return np.array(Image.open(io.BytesIO(coded)))  # a copy, which torch may take as its own
