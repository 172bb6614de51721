"""Convert meshes and splats from one kind of file to another."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np

from mgsr.data.scene import Similarity
from mgsr.errors import ConfigError, SceneError
from mgsr.export.compressed_ply import is_compressed_ply, load_compressed_ply, write_compressed_ply
from mgsr.export.far_origin import origin_near, origin_text, scaled_origin
from mgsr.export.gltf import UpAxis
from mgsr.export.mesh_files import write_glb, write_ply
from mgsr.export.mesh_reading import load_mesh
from mgsr.export.obj_files import write_obj
from mgsr.export.ply_notes import LOW_PASS, UNIT, read_number, read_origin
from mgsr.export.splats import Splats, load_splats, require_finite, write_splats
from mgsr.export.spz import load_spz, read_spz_origin, write_spz
from mgsr.geometry.precision import box

COMPRESSED = ".compressed.ply"
_MESHES = (".ply", ".glb", ".obj")
_PACKED: dict[str, Callable[[Path, Splats, np.ndarray], None]] = {COMPRESSED: write_compressed_ply, ".spz": write_spz}
_SPLATS = (COMPRESSED, ".ply", ".spz")
# The longer ending first, as both fit the same names.
FILE_SUFFIXES = tuple(dict.fromkeys((*_SPLATS, *_MESHES)))


def convert(source: Path, target: Path, scale: float = 1.0, up: UpAxis | None = None) -> str:
    """Convert `source` to `target`, whose name gives its format, and return a one-line summary.

    Meshes: .ply, .glb, .obj. Splats: .ply, .compressed.ply, .spz. scale: the factor on all lengths. up: the axis of a
    mesh's frame that points up, because .glb needs y up; y by default. Splats keep the origin that their file names.
    Splats far from the frame's origin get an origin near them (`origin_near`).

    Raises the errors of `require_kinds`, and ConfigError for a scale that is not a number above 0. Raises SceneError
    and MeshError for unreadable files, and for content that `target` can't hold.
    """
    require_kinds(source, target, up)
    if not (math.isfinite(scale) and scale > 0):
        raise ConfigError(f"--scale {scale:g}: expected a number above 0")
    if _holds_splats(source):
        return _convert_splats(source, target, scale)
    return _convert_mesh(source, target, scale, up or UpAxis.Y)


def require_kinds(source: Path, target: Path, up: UpAxis | None = None) -> None:
    """Raise ConfigError where `source` can't be converted to `target`.

    It raises where `source` is not a file, where `target` is of another kind of content, or where `target` can't have
    an up axis.
    """
    if not source.is_file():
        raise ConfigError(f"{source}: this file does not exist")
    kind, suffixes = ("splats", _SPLATS) if _holds_splats(source) else ("a mesh", _MESHES)
    if _suffix(target) not in suffixes:
        raise ConfigError(
            f"{target}: {source} is read as {kind}; choose a target with the extension {', '.join(suffixes)}"
        )
    if up is not None and _suffix(target) != ".glb":
        raise ConfigError(
            f"--up {up}: only .glb files are turned, and {target} keeps the frame of {source}; remove --up"
        )


def _suffix(target: Path) -> str:
    name = target.name.lower()
    return next((suffix for suffix in FILE_SUFFIXES if name.endswith(suffix)), target.suffix)


def _convert_mesh(source: Path, target: Path, scale: float, up: UpAxis) -> str:
    mesh = load_mesh(source)
    scaled = mesh.in_frame(_scaled(mesh.vertices, scale))
    match _suffix(target):
        case ".glb":
            write_glb(target, scaled, mesh.colors, up)
        case ".obj":
            write_obj(target, scaled, mesh.colors)
        case _:
            write_ply(target, scaled, mesh.colors, unit=read_number(source, UNIT) * scale)
    return f"a mesh of {len(mesh.faces)} faces"


def _convert_splats(source: Path, target: Path, scale: float) -> str:
    splats, given = _load_splats(source), _read_origin(source)
    places = _scaled(splats["means"] + given, scale)
    origin = scaled_origin(given, scale) if given.any() else origin_near(*box(places))
    to_target = Similarity(scale, given * scale - origin)
    text = f"{len(places)} splats"
    if _suffix(target) == ".ply":
        unit, low_pass = (read_number(source, name) for name in (UNIT, LOW_PASS))
        write_splats(target, splats, to_target, unit * scale, low_pass, origin)
    else:
        text += ", without their reflected light" if "refl_sh" in splats else ""
        _pack_splats(source, target, splats, to_target, origin)
    return text + (f", relative to the origin {origin_text(origin)}, which the file records" if origin.any() else "")


def _pack_splats(source: Path, target: Path, splats: Splats, to_target: Similarity, origin: np.ndarray) -> None:
    """Write splats of `source` in a packed format, with the target's positions, about `origin` [3]."""
    means = to_target.to_user(splats["means"].astype(np.float64)).astype(np.float32)
    log_scales = splats["log_scales"] + np.float32(math.log(to_target.scale))
    try:
        _PACKED[_suffix(target)](target, splats | {"means": means, "log_scales": log_scales}, origin)
    except SceneError as error:
        raise SceneError(f"{source}: {error}") from error


def _read_origin(source: Path) -> np.ndarray:
    """Return the origin [3] that a file of splats names. Raises SceneError where it is no place."""
    return read_spz_origin(source) if source.suffix.lower() == ".spz" else read_origin(source)


def _scaled(places: np.ndarray, scale: float) -> np.ndarray:
    """Return positions [P,3] times `scale`, float64. Raises ConfigError where float32 can't hold them."""
    with np.errstate(over="ignore"):
        scaled = places.astype(np.float64) * scale
    largest, limits = np.abs(scaled).max(initial=0), np.finfo(np.float32)
    if np.any(places) and not limits.tiny <= largest <= limits.max:
        raise ConfigError(
            f"--scale {scale:g} would turn coordinates of up to {np.abs(places).max():g} units into {largest:g}; "
            f"expected {limits.tiny:.0e} to {limits.max:.0e}; choose a scale nearer to 1"
        )
    return scaled


def _holds_splats(path: Path) -> bool:
    if path.suffix.lower() != ".ply":
        return path.suffix.lower() == ".spz"
    with path.open("rb") as file:
        head = file.read(8192)
    return b" f_dc_0" in head or b" packed_position" in head


def _load_splats(path: Path) -> Splats:
    """Load the splats of a .ply, .compressed.ply or .spz file.

    Raises SceneError where values are NaN or infinite: one would spoil all others of a chunk or the scene.
    """
    if path.suffix.lower() == ".spz":
        splats = load_spz(path)
    else:
        splats = load_compressed_ply(path) if is_compressed_ply(path) else load_splats(path)
    require_finite(splats, path)
    return splats
