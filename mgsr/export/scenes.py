"""Write scenes for other programs: undistorted photographs, masks, and cameras as COLMAP text and transforms.json."""

from __future__ import annotations

import itertools
import json
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from plyfile import PlyData, PlyElement
from scipy.spatial.transform import Rotation

from mgsr.data.camera import Camera
from mgsr.data.scene import Scene, View
from mgsr.data.valid_mask import whole_part
from mgsr.errors import MgsrError

_OPENGL = np.diag([1.0, -1, -1, 1])
_POINTS = "sparse_pc.ply"


def write_scene(folder: Path, scene: Scene, scale: float = 1.0) -> None:
    """Write the scene in the user's frame, all lengths times `scale`, into an existing folder.

    images/ holds the photographs as MGSR uses them (pinhole, reduced), named after their split where there is one.
    masks/ holds the same names, white on the object. sparse/0 is a COLMAP model of PINHOLE cameras with the scene's
    points. transforms.json has the same cameras with OpenGL's axes, as nerfstudio reads them, with the split;
    sparse_pc.ply holds the points for it. Undistorted photographs with invalid pixels are cropped to a rectangle of
    valid ones. Where masks mark regions to ignore, new masks are black there.

    Raises MgsrError where an image can't be written.
    """
    views = [_with_ignoring_mask(view) if scene.ignoring else whole_part(view) for view in (*scene.train, *scene.test)]
    names = _file_names(scene)
    cameras = [_scaled(scene.user_from_scene.camera_to_user(view.camera), scale) for view in views]
    for name, view in zip(names, views, strict=True):
        _write_images(folder, name, view)
    points, colors = np.zeros((0, 3)), np.zeros((0, 3), np.uint8)
    if scene.points is not None:
        points, colors = scene.user_from_scene.to_user(scene.points.positions) * scale, scene.points.colors
        _write_points(folder / _POINTS, points, colors)
    _write_colmap(folder / "sparse/0", names, cameras, points, colors)
    masked = scene.masked or scene.ignoring
    frames = [_frame(name, camera, masked) for name, camera in zip(names, cameras, strict=True)]
    document = {"camera_model": "PINHOLE", "frames": frames}
    if scene.test:
        document |= _split([f"images/{name}" for name in names], len(scene.train))
    if scene.points is not None:
        document["ply_file_path"] = _POINTS
    (folder / "transforms.json").write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


def _file_names(scene: Scene) -> list[str]:
    """Return a file name for each photograph that every reader accepts.

    Some readers end a name at the first space, or leave folders out.
    """
    parts = [("train_" if scene.test else "", view.name) for view in scene.train]
    parts += [("test_", view.name) for view in scene.test]
    names: list[str] = []
    taken: set[str] = set()
    for prefix, name in parts:
        plain = re.sub(r"[^A-Za-z0-9._-]+", "_", name)
        stem = plain if plain.startswith(prefix) else prefix + plain
        tries = itertools.chain([stem], (f"{stem}_{number}" for number in itertools.count(2)))
        # Some file systems ignore case.
        names.append(next(text for text in tries if text.lower() not in taken))
        taken.add(names[-1].lower())
    return [f"{name}.png" for name in names]


def _with_ignoring_mask(view: View) -> View:
    """Return the view with a mask that is black on invalid pixels, and off the object where it has a silhouette."""
    valid = np.ones(view.image.shape[:2], bool) if view.valid_mask is None else view.valid_mask
    mask = valid * np.uint8(255)
    return replace(view, alpha=mask if view.alpha is None else np.minimum(view.alpha, mask))


def _split(files: Sequence[str], train: int) -> dict[str, list[str]]:
    """Return the split's lists of names; nerfstudio wants all three."""
    return {"train_filenames": list(files[:train])} | {
        f"{part}_filenames": list(files[train:]) for part in ("val", "test")
    }


def _scaled(camera: Camera, scale: float) -> Camera:
    pose = camera.cam_from_world.copy()
    pose[:3, 3] *= scale
    return Camera(camera.K, pose, camera.width, camera.height)


def _write_images(folder: Path, name: str, view: View) -> None:
    write_image(folder / "images" / name, view.image[..., ::-1])
    if view.alpha is not None:
        write_image(folder / "masks" / name, view.alpha)


def write_image(path: Path, pixels: np.ndarray) -> None:
    """Write an image, [H,W] or [H,W,3] with blue first, uint8, and the folders that it lies in.

    Raises MgsrError where it can't be written.
    """
    import cv2  # imported here, because training needs no OpenCV

    path.parent.mkdir(parents=True, exist_ok=True)
    if not cv2.imwrite(str(path), np.ascontiguousarray(pixels)):
        raise MgsrError(f"{path}: the file cannot be written; check the folder's permissions and the free disk space")


def _write_colmap(
    folder: Path, names: Sequence[str], cameras: Sequence[Camera], points: np.ndarray, colors: np.ndarray
) -> None:
    """Write a COLMAP text model without 2D observations; points [P,3] in the cameras' frame, colors [P,3] uint8.

    Source: COLMAP's documentation, "Output Format".
    """
    camera_lines, image_lines = [], []
    for number, (name, camera) in enumerate(zip(names, cameras, strict=True), start=1):
        K = camera.K
        values = _text([K[0, 0], K[1, 1], K[0, 2], K[1, 2]])
        camera_lines.append(f"{number} PINHOLE {camera.width} {camera.height} {values}")
        x, y, z, w = Rotation.from_matrix(camera.cam_from_world[:3, :3]).as_quat()
        image_lines += [f"{number} {_text([w, x, y, z, *camera.cam_from_world[:3, 3]])} {number} {name}", ""]
    rows = enumerate(zip(points, colors, strict=True), start=1)
    point_lines = [f"{number} {_text(place)} {' '.join(map(str, color))} 0" for number, (place, color) in rows]
    folder.mkdir(parents=True)
    for stem, lines in (("cameras", camera_lines), ("images", image_lines), ("points3D", point_lines)):
        (folder / f"{stem}.txt").write_text("\n".join([*lines, ""]), encoding="utf-8")


def _write_points(path: Path, points: np.ndarray, colors: np.ndarray) -> None:
    """Write points [P,3] with their colours [P,3] uint8 as a binary PLY."""
    rows = np.empty(
        len(points), [(axis, "<f8") for axis in "xyz"] + [(name, "u1") for name in ("red", "green", "blue")]
    )
    for names, values in (("xyz", points), (("red", "green", "blue"), colors)):
        for axis, name in enumerate(names):
            rows[name] = values[:, axis]
    PlyData([PlyElement.describe(rows, "vertex")], byte_order="<").write(str(path))


def _frame(name: str, camera: Camera, masked: bool) -> dict[str, Any]:
    K = camera.K
    frame = {
        "file_path": f"images/{name}",
        "w": camera.width,
        "h": camera.height,
        "fl_x": K[0, 0],
        "fl_y": K[1, 1],
        "cx": K[0, 2],
        "cy": K[1, 2],
        "transform_matrix": (camera.world_from_cam @ _OPENGL).tolist(),
    }
    return frame | ({"mask_path": f"masks/{name}"} if masked else {})


def _text(values: Sequence[float] | np.ndarray) -> str:
    return " ".join(f"{value:.17g}" for value in values)
