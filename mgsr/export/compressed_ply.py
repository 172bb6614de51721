"""Splats as PlayCanvas's compressed PLY, which SuperSplat and others read: 16 bytes a splat and one a coefficient.

Source: PlayCanvas's documentation of the format. Each chunk of 256 splats has ranges of values. Within these, a splat
has 32 bits each for its position and its scale (11, 10, 11 bits), and for its colour with opacity (8 bits each). The
three smaller parts of its quaternion have 10 bits each. The format has no place for the light split's reflected half. A
comment names the origin of the positions, if it is not the frame's (`ply_notes.py`).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from plyfile import PlyData, PlyElement, PlyParseError
from scipy.special import expit

from mgsr.errors import SceneError, in_short
from mgsr.export.ply_notes import origin_comments
from mgsr.export.splats import DAMAGE, Splats
from mgsr.export.spz import three_scales

_CHUNK = 256
_RANGES = {
    "position": ("x", "y", "z"),
    "scale": ("scale_x", "scale_y", "scale_z"),
    "color": ("r", "g", "b"),
}
_BITS = (11, 10, 11)
_SH_C0 = 0.28209479177387814
# Scales beyond these are invisible or fill the view, and would coarsen their chunk.
_SCALE_LIMIT = 20.0


def write_compressed_ply(path: Path, splats: Splats, origin: np.ndarray | None = None) -> None:
    """Write splats, as `write_splats` takes them, to a compressed PLY.

    All values except opacity logits must be finite. Splats are sorted along a space-filling curve, so that chunks are
    small.
    origin [3]: the origin of the positions, None for the frame's own.
    """
    ordered = {name: array[_along_curve(splats["means"])] for name, array in splats.items()}
    values = {
        "position": ordered["means"].astype(np.float32),
        "scale": np.clip(three_scales(ordered["log_scales"]), -_SCALE_LIMIT, _SCALE_LIMIT).astype(np.float32),
        "color": (ordered["sh"][:, 0] * _SH_C0 + 0.5).astype(np.float32),
    }
    chunks = np.zeros(-(-len(ordered["means"]) // _CHUNK), [(name, "<f4") for name in _range_names()])
    vertices = np.zeros(
        len(ordered["means"]), [(f"packed_{name}", "<u4") for name in ("position", "rotation", "scale", "color")]
    )
    shares = {kind: _within_chunks(values[kind], chunks, kind) for kind in _RANGES}
    for kind in ("position", "scale"):
        vertices[f"packed_{kind}"] = _pack(shares[kind], _BITS)
    opacity = expit(ordered["opacity_logits"].astype(np.float64))
    vertices["packed_color"] = _pack(np.column_stack([shares["color"], opacity]), (8, 8, 8, 8))
    vertices["packed_rotation"] = _packed_rotations(ordered["quats"])
    elements = [PlyElement.describe(chunks, "chunk"), PlyElement.describe(vertices, "vertex")]
    if ordered["sh"].shape[1] > 1:
        elements.append(PlyElement.describe(_harmonics(ordered["sh"][:, 1:]), "sh"))
    PlyData(elements, byte_order="<", comments=origin_comments(origin)).write(str(path))


def load_compressed_ply(path: Path) -> Splats:
    """Load the splats of such a file, as Gaussians, float32.

    Positions are about the origin that the header names (`ply_notes.read_origin`). Raises SceneError naming the file
    for others.
    """
    try:
        data = PlyData.read(str(path))
        chunks, vertices = data["chunk"].data, data["vertex"].data
        which = np.arange(len(vertices)) // _CHUNK
        parts = {kind: _unpack(vertices[f"packed_{kind}"], _BITS) for kind in ("position", "scale")}
        color = _unpack(vertices["packed_color"], (8, 8, 8, 8))
        values = {
            kind: _from_chunks(part, chunks, kind, which) for kind, part in (parts | {"color": color[:, :3]}).items()
        }
        rest = _load_harmonics(data, len(vertices))
        quats = _unpacked_rotations(vertices["packed_rotation"])
    except (PlyParseError, *DAMAGE) as error:
        raise SceneError(
            f"{path}: expected a compressed PLY file of splats: {in_short(error)}; write it again"
        ) from error
    alpha = np.clip(color[:, 3], 0.5 / 255, 1 - 0.5 / 255)
    splats = {
        "means": values["position"],
        "quats": quats,
        "log_scales": values["scale"],
        "opacity_logits": np.log(alpha / (1 - alpha)),
        "sh": np.concatenate([(values["color"][:, None] - 0.5) / _SH_C0, rest], axis=1),
    }
    return {name: array.astype(np.float32) for name, array in splats.items()}


def is_compressed_ply(path: Path) -> bool:
    """Return whether a PLY's header has the packed properties."""
    with path.open("rb") as file:
        return b"packed_position" in file.read(4096)


def _range_names() -> list[str]:
    return [f"{end}_{name}" for names in _RANGES.values() for end in ("min", "max") for name in names]


def _along_curve(means: np.ndarray) -> np.ndarray:
    """Return an order of points [N,3] in which neighbours stay together (Morton 1966), ten bits an axis."""
    low, high = means.min(axis=0, initial=np.inf), means.max(axis=0, initial=-np.inf)
    cells = ((means - low) / np.maximum(high - low, 1e-30) * 1023).astype(np.int64)
    code = np.zeros(len(means), np.int64)
    for bit in range(10):
        for axis in range(3):
            code |= (cells[:, axis] >> bit & 1) << (3 * bit + axis)
    return np.argsort(code, kind="stable")


def _within_chunks(values: np.ndarray, chunks: np.ndarray, kind: str) -> np.ndarray:
    """Return values [N,3] as shares 0..1 of their chunk's range, and write the ranges to `chunks`."""
    starts = np.arange(0, len(values), _CHUNK)
    which = np.arange(len(values)) // _CHUNK
    low, high = np.minimum.reduceat(values, starts), np.maximum.reduceat(values, starts)
    for axis, name in enumerate(_RANGES[kind]):
        chunks[f"min_{name}"], chunks[f"max_{name}"] = low[:, axis], high[:, axis]
    shares: np.ndarray = (values - low[which]) / np.maximum(high - low, 1e-30)[which]
    return shares


def _from_chunks(shares: np.ndarray, chunks: np.ndarray, kind: str, which: np.ndarray) -> np.ndarray:
    """Map shares [N,...], 0..1, to their chunks' ranges; which [N] gives each splat's chunk.

    Files without ranges for colours store colours in 0..1, which are returned unchanged.
    """
    if kind == "color" and "min_r" not in (chunks.dtype.names or ()):
        return shares
    low, high = (np.stack([chunks[f"{end}_{name}"] for name in _RANGES[kind]], axis=1) for end in ("min", "max"))
    values: np.ndarray = low[which] + shares * (high - low)[which]
    return values


def _pack(shares: np.ndarray, bits: tuple[int, ...]) -> np.ndarray:
    """Pack shares [N,len(bits)] of 0..1 into one number per row, the first in the highest bits."""
    packed = np.zeros(len(shares), np.uint32)
    for axis, count in enumerate(bits):
        top = 2**count - 1
        packed = packed << np.uint32(count) | np.clip(np.rint(shares[:, axis] * top), 0, top).astype(np.uint32)
    return packed


def _unpack(packed: np.ndarray, bits: tuple[int, ...]) -> np.ndarray:
    """Unpack fields of `bits` bits, the highest first, from 32-bit numbers [N]; return [N,len(bits)], 0..1."""
    parts, left = [], 32
    for count in bits:
        left -= count
        parts.append((packed.astype(np.uint64) >> left & (2**count - 1)) / (2**count - 1))
    return np.stack(parts, axis=1)


def _packed_rotations(quats: np.ndarray) -> np.ndarray:
    """Pack quaternions [N,4] wxyz, of any length, into 32 bits each.

    Two bits say which part of wxyz is largest. That part is made positive, and follows from the other three.
    """
    unit = quats.astype(np.float64) / np.maximum(np.linalg.norm(quats, axis=1, keepdims=True), 1e-12)
    largest = np.abs(unit).argmax(axis=1)
    unit *= np.where(np.take_along_axis(unit, largest[:, None], 1) < 0, -1, 1)
    others = np.array([[i for i in range(4) if i != skipped] for skipped in range(4)])[largest]
    shares = np.take_along_axis(unit, others, 1) * np.sqrt(0.5) + 0.5
    packed: np.ndarray = _pack(shares, (10, 10, 10)) | largest.astype(np.uint32) << np.uint32(30)
    return packed


def _unpacked_rotations(packed: np.ndarray) -> np.ndarray:
    """Unpack unit quaternions [N,4] wxyz from 32-bit numbers [N] (see `_packed_rotations`)."""
    largest = packed.astype(np.uint64) >> 30
    smaller = (_unpack(packed, (2, 10, 10, 10))[:, 1:] - 0.5) / np.sqrt(0.5)
    real = np.sqrt(np.maximum(0, 1 - (smaller**2).sum(axis=1)))
    quats = np.zeros((len(packed), 4))
    for skipped in range(4):
        rows = largest == skipped
        quats[rows, skipped] = real[rows]
        quats[np.ix_(rows, [i for i in range(4) if i != skipped])] = smaller[rows]
    return quats


def _harmonics(rest: np.ndarray) -> np.ndarray:
    """Return coefficients [N,K,3] as a table of bytes over -4..4, all of red, then green, then blue."""
    flat = rest.transpose(0, 2, 1).reshape(len(rest), 3 * rest.shape[1])
    table = np.zeros(len(rest), [(f"f_rest_{i}", "u1") for i in range(flat.shape[1])])
    for i in range(flat.shape[1]):
        table[f"f_rest_{i}"] = np.clip(np.floor((flat[:, i] / 8 + 0.5) * 256), 0, 255)
    return table


def _load_harmonics(data: PlyData, count: int) -> np.ndarray:
    """Return the higher colour coefficients [N,K,3], float64, with K = 0 where the file has none."""
    if "sh" not in data:
        return np.zeros((count, 0, 3))
    table = data["sh"].data
    flat = np.stack([table[f"f_rest_{i}"] for i in range(len(table.dtype.names))], axis=1).astype(np.float64)
    # A byte encodes the centre of its quantisation step.
    return (((flat + 0.5) / 256 - 0.5) * 8).reshape(count, 3, flat.shape[1] // 3).transpose(0, 2, 1)
