"""Read and write splats as PLY in the layout that splat viewers read.

All properties are float:

- x y z: the position.
- nx ny nz: a surfel's unit normal, which is the third column of its rotation; 0 for the 3D branch.
- f_dc_0..2: the constant colour coefficients.
- f_rest_0..44: the other coefficients, all of red, then green, then blue. They are padded with zeros to degree 3,
  because some viewers expect that number.
- opacity: a logit.
- scale_0..2: logarithms. The third scale of surfels is SURFEL_THICKNESS in the frame's unit ball.
- rot_0..3: the quaternion, wxyz.

A 3D branch with the light split appends refl_opacity (logit), refl_weight (beta's logit), refl_dc_0..2 and
refl_rest_0.. (in the same order, unpadded). Viewers skip these and show the transmitted half. Comments give the kind of
splats, the number of real coefficients and the 3D branch's low-pass. They also give the origin of the positions, if it
is not the frame's (`ply_notes.py`).
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from plyfile import PlyData, PlyElement, PlyParseError

from mgsr.data.scene import Similarity
from mgsr.errors import SceneError, in_short
from mgsr.export.ply_notes import number_comments, origin_comments
from mgsr.geometry.precision import box, float_is_too_coarse

Splats = dict[str, np.ndarray]

SURFEL_THICKNESS = 1e-6
FULL_SH = 16
_SHAPES = {
    "means": (3,),
    "quats": (4,),
    "opacity_logits": (),
    "refl_opacity_logits": (),
    "weight_logits": (),
}
# Prefixes of the colour coefficients' names, before "dc_" and "rest_".
_COLOR, _REFLECTED = "f_", "refl_"
_SPLIT_FIELDS = ("refl_opacity", "refl_weight", "refl_dc_0", "refl_dc_1", "refl_dc_2")
_SPLIT = ("refl_opacity_logits", "weight_logits", "refl_sh")
# The errors of plyfile's reader for a damaged PLY: a ValueError is also text that can't be decoded.
DAMAGE = (KeyError, ValueError, TypeError, IndexError, OverflowError, MemoryError, OSError)


def write_splats(
    path: Path,
    splats: Splats,
    file_from_scene: Similarity | None = None,
    unit: float = 1.0,
    low_pass: float | None = None,
    origin: np.ndarray | None = None,
) -> None:
    """Write splats as a PLY.

    splats, float32 in the scene's frame: means [N,3], quats [N,4] wxyz, log_scales [N,3] or [N,2] (surfels),
    opacity_logits [N], sh [N,K,3] with K 1, 4, 9 or 16. With the light split also refl_opacity_logits [N],
    weight_logits [N], refl_sh [N,K',3].
    file_from_scene: maps positions to those in the file; None keeps them.

    The header contains the other arguments:

    unit: the factor on the user's lengths.
    low_pass: px^2, of the 3D branch (see `GaussianModel`).
    origin [3]: the origin of the file's positions, in the file's unit; None is the frame's own.

    Raises SceneError for arrays that are missing, unknown or of the wrong shape.
    """
    _check(splats, "splats")
    columns = _columns(splats, file_from_scene or Similarity())
    rows = np.empty(len(splats["means"]), [(name, "<f4") for name in columns])
    for name, values in columns.items():
        rows[name] = values
    kind = "surfels" if splats["log_scales"].shape[1] == 2 else "gaussians"
    comments = [f"mgsr kind {kind}", f"mgsr sh_coefficients {splats['sh'].shape[1]}"]
    comments += number_comments(unit=unit, low_pass=low_pass) + origin_comments(origin)
    PlyData([PlyElement.describe(rows, "vertex")], byte_order="<", comments=comments).write(str(path))


def load_splats(path: Path) -> Splats:
    """Load the arrays of `write_splats`, float32, with the file's own positions.

    They are about the origin that its header names (`ply_notes.read_origin`).

    Files of other programs are read as Gaussians, with all their coefficients. Their means stay float64 if float32
    would be too coarse. Raises SceneError for any other file.
    """
    try:
        data = PlyData.read(str(path))
        splats = _splats(data["vertex"], path, _notes(data.comments))
    except (PlyParseError, *DAMAGE) as error:
        raise SceneError(f"{path}: expected a PLY file of splats: {in_short(error)}; write it again") from error
    _check(splats, str(path))
    return splats


def require_finite(splats: Splats, source: Path) -> None:
    """Raise SceneError for NaN and infinite values, but for infinite opacity logits, which mean 0 and 1."""
    for name, array in splats.items():
        allowed = ~np.isnan(array) if name.endswith("opacity_logits") else np.isfinite(array)
        bad = int((~allowed.reshape(len(array), -1)).any(axis=1).sum()) if len(array) else 0
        if bad:
            raise SceneError(
                f"{source}: {name} of {bad} of {len(array)} splats are NaN or infinite; remove these splats, for "
                "example with `splat-transform A.ply --filter-nan B.ply`"
            )


def _notes(comments: list[str]) -> dict[str, str]:
    """Return what `write_splats` said of the file in its "mgsr KEY VALUE" comments."""
    words = [comment.split() for comment in comments]
    return {line[1]: line[2] for line in words if len(line) == 3 and line[0] == "mgsr"}


def _splats(vertex: PlyElement, path: Path, notes: dict[str, str]) -> Splats:
    names = {item.name for item in vertex.properties}
    _check_properties(names, path)

    def stack(prefix: str, count: int) -> np.ndarray:
        """Return the columns prefix0, prefix1, ... of the file as float32 [N, count]."""
        return np.stack([np.asarray(vertex[f"{prefix}{index}"], np.float32) for index in range(count)], axis=1)

    sh = _load_sh(vertex, names, _COLOR)
    stored = int(notes.get("sh_coefficients", str(sh.shape[1])))
    splats = {
        "means": _places(vertex),
        "quats": stack("rot_", 4),
        "log_scales": stack("scale_", 2 if notes.get("kind") == "surfels" or "scale_2" not in names else 3),
        "opacity_logits": np.asarray(vertex["opacity"], np.float32),
        "sh": sh[:, :stored],
    }
    if "refl_opacity" in names:
        splats["refl_opacity_logits"] = np.asarray(vertex["refl_opacity"], np.float32)
        splats["weight_logits"] = np.asarray(vertex["refl_weight"], np.float32)
        splats["refl_sh"] = _load_sh(vertex, names, _REFLECTED)
    return splats


def _places(vertex: PlyElement) -> np.ndarray:
    """Return positions [N,3] as float32, or as float64 where the file has them so and float32 would be too coarse."""
    places = np.stack([np.asarray(vertex[axis]) for axis in "xyz"], axis=1)
    if places.dtype == np.float64 and float_is_too_coarse(*box(places)):
        return places
    return places.astype(np.float32)


def _check_properties(names: set[str], path: Path) -> None:
    missing = [name for name in ("x", "f_dc_0", "opacity", "scale_0", "rot_0") if name not in names]
    if missing:
        raise SceneError(f"{path}: expected splats in the viewers' layout, but the file lacks {', '.join(missing)}")
    lost = [name for name in _SPLIT_FIELDS if name not in names]
    if lost and "refl_opacity" in names:
        raise SceneError(
            f"{path}: expected all properties of reflected light, but the file lacks {', '.join(lost)}; write it again"
        )


def _load_sh(vertex: PlyElement, names: set[str], prefix: str) -> np.ndarray:
    """Return colour coefficients [N,K,3] float32: the constant term, then the rest."""
    rest = sum(name.startswith(f"{prefix}rest_") for name in names)
    dc = np.stack([np.asarray(vertex[f"{prefix}dc_{channel}"], np.float32) for channel in range(3)], axis=1)
    if rest == 0:
        return dc[:, None]
    flat = np.stack([np.asarray(vertex[f"{prefix}rest_{index}"], np.float32) for index in range(rest)], axis=1)
    higher = flat.reshape(len(flat), 3, rest // 3).transpose(0, 2, 1)
    return np.concatenate([dc[:, None], higher], axis=1)


def _columns(splats: Splats, frame: Similarity) -> dict[str, np.ndarray]:
    """Return the columns [N] of a splat file by name, in the frame of the user."""
    means = frame.to_user(splats["means"].astype(np.float64))
    flat = splats["log_scales"].shape[1] == 2
    normals = _third_axes(splats["quats"]) if flat else np.zeros_like(means)
    columns = dict(zip(("x", "y", "z", "nx", "ny", "nz"), [*means.T, *normals.T], strict=True))
    columns |= _sh_columns(splats["sh"], _COLOR, FULL_SH)
    columns["opacity"] = splats["opacity_logits"]
    # In float64, so that a unit scale preserves every bit.
    scales = splats["log_scales"].astype(np.float64) + math.log(frame.scale)
    if flat:
        thin = np.full((len(scales), 1), math.log(SURFEL_THICKNESS * frame.scale))
        scales = np.concatenate([scales, thin], axis=1)
    columns |= {f"scale_{axis}": scales[:, axis] for axis in range(3)}
    columns |= {f"rot_{part}": splats["quats"][:, part] for part in range(4)}
    if "refl_sh" in splats:
        columns["refl_opacity"], columns["refl_weight"] = splats["refl_opacity_logits"], splats["weight_logits"]
        columns |= _sh_columns(splats["refl_sh"], _REFLECTED, splats["refl_sh"].shape[1])
    return columns


def _third_axes(quats: np.ndarray) -> np.ndarray:
    """Return the third columns [N,3] of the rotations of quats [N,4] wxyz, of any length."""
    lengths = np.linalg.norm(quats.astype(np.float64), axis=1, keepdims=True)
    w, x, y, z = (quats / np.maximum(lengths, 1e-12)).T
    return np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=1)


def _sh_columns(sh: np.ndarray, prefix: str, coefficients: int) -> dict[str, np.ndarray]:
    """Return the columns of sh [N,K,3], padded with zeros to `coefficients`.

    They are the constant terms, then the rest channel by channel.
    """
    padded = np.zeros((len(sh), coefficients, 3), np.float32)
    padded[:, : sh.shape[1]] = sh
    columns = {f"{prefix}dc_{channel}": padded[:, 0, channel] for channel in range(3)}
    rest = padded[:, 1:].transpose(0, 2, 1).reshape(len(sh), 3 * (coefficients - 1))
    return columns | {f"{prefix}rest_{index}": rest[:, index] for index in range(rest.shape[1])}


def _check(splats: Splats, source: str) -> None:
    needed = {"means", "quats", "log_scales", "opacity_logits", "sh"}
    given = set(splats)
    split = given & set(_SPLIT)
    if not needed <= given or (split and split != set(_SPLIT)) or given - needed - set(_SPLIT):
        raise SceneError(f"{source}: expected {sorted(needed)} and all or none of {list(_SPLIT)}, got {sorted(given)}")
    count = len(splats["means"])
    for name, array in splats.items():
        if not _fits(name, array.shape, count):
            raise SceneError(f"{source}: {name}: expected {_wanted(name, count)}, got {list(array.shape)}")


def _fits(name: str, shape: tuple[int, ...], count: int) -> bool:
    if name == "log_scales":
        return shape in ((count, 2), (count, 3))
    if name in ("sh", "refl_sh"):
        return len(shape) == 3 and shape[0] == count and shape[1] in (1, 4, 9, 16) and shape[2] == 3
    return shape == (count, *_SHAPES[name])


def _wanted(name: str, count: int) -> str:
    if name == "log_scales":
        return f"[N={count}, 2 or 3]"
    if name in ("sh", "refl_sh"):
        return f"[N={count}, 1 or 4 or 9 or 16, 3] (at most degree 3)"
    return f"[N={', '.join(map(str, (count, *_SHAPES[name])))}]"
