"""Splats as SPZ, Niantic's packed format: about a tenth of the PLY's size, and what it rounds is hardly seen.

Source: the README of Niantic's spz and its version 2: gzip of a 16-byte header and one array after the other, all
bytes: positions as 24-bit fixed point, opacities, colours, log scales in sixteenths, quaternions (x, y, z of the one
with w >= 0), and higher colour coefficients with 5 bits in the first degree and 4 in the others. The
format has y up and z backwards where splat PLYs have y down and z forward, so that everything is turned half round x on
the way, as Niantic's own converter does. The light split's reflected half has no place in it.
"""

from __future__ import annotations

import gzip
import math
import struct
import zlib
from itertools import pairwise
from pathlib import Path

import numpy as np

from mgsr.errors import SceneError, in_short
from mgsr.export.splats import SURFEL_THICKNESS, Splats

_MAGIC, _VERSION = 0x5053474E, 2
_HEADER = struct.Struct("<IIIBBBB")
_DEGREES = {1: 0, 4: 1, 9: 2, 16: 3}
# What the constant colour coefficient is multiplied with, about the middle, for a byte.
_COLOR_SCALE = 0.15
# What half a turn round x does to y and z, to a quaternion (wxyz), and to the colour coefficients after the first.
_TURN = np.array([1.0, -1, -1])
_QUAT_TURN = np.array([1.0, 1, -1, -1])
_SH_TURN = np.array([-1.0, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1])[:, None]

# A file of a hundred million splats would not fit a card; what claims more was made to fill the memory.
_MAX_SPLATS = 100_000_000


def write_spz(path: Path, splats: Splats) -> None:
    """Write splats as `write_splats` takes them, in the frame that they have.

    Raises SceneError for positions that its 24 bits can't hold.
    """
    fraction = _fraction_bits(splats["means"])
    count, coefficients = splats["sh"].shape[:2]
    header = _HEADER.pack(_MAGIC, _VERSION, count, _DEGREES[coefficients], fraction, 0, 0)
    fixed = np.rint(splats["means"].astype(np.float64) * _TURN * 2**fraction).astype("<i4")
    arrays = [
        fixed.view(np.uint8).reshape(count, 3, 4)[:, :, :3],
        _byte(255 / (1 + np.exp(-splats["opacity_logits"].astype(np.float64)))),
        _byte((splats["sh"][:, 0] * _COLOR_SCALE + 0.5) * 255),
        _byte((three_scales(splats["log_scales"]) + 10) * 16),
        _byte(_unit(splats["quats"] * _QUAT_TURN)[:, 1:] * 127.5 + 127.5),
        _quantised_harmonics(splats["sh"][:, 1:] * _SH_TURN[: coefficients - 1]),
    ]
    body = b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)
    path.write_bytes(gzip.compress(header + body, mtime=0))


def load_spz(path: Path) -> Splats:
    """The splats of a file of version 2, as volumes. Raises SceneError naming the file for others."""
    header, body = _unpacked(path)
    _, _, count, degree, fraction, _, _ = header
    coefficients = {value: key for key, value in _DEGREES.items()}[degree]
    sizes = [9, 1, 3, 3, 3, 3 * (coefficients - 1)]
    if len(body) < count * sum(sizes):
        raise SceneError(f"{path.name}: ends early: expected {count * sum(sizes)} bytes of splats, got {len(body)}")
    edges = np.cumsum([0, *sizes]) * count
    parts = [np.frombuffer(body, np.uint8)[a:b].reshape(count, -1) for a, b in pairwise(edges)]
    positions, opacity, color, scales, rotation, rest = (part.astype(np.float64) for part in parts)
    whole = np.zeros((count, 3, 4), np.uint8)
    whole[:, :, 1:] = positions.reshape(count, 3, 3)
    vector = rotation / 127.5 - 1
    real = np.sqrt(np.maximum(0, 1 - (vector**2).sum(axis=1)))
    alpha = np.clip(opacity[:, 0] / 255, 0.5 / 255, 1 - 0.5 / 255)
    higher = (rest.reshape(count, coefficients - 1, 3) - 128) / 128 * _SH_TURN[: coefficients - 1]
    splats = {
        # The bytes are the upper ones of 32 bits, so that the sign comes along.
        "means": (whole.view("<i4")[..., 0] >> 8) / 2**fraction * _TURN,
        "quats": np.column_stack([real, vector]) * _QUAT_TURN,
        "log_scales": scales / 16 - 10,
        "opacity_logits": np.log(alpha / (1 - alpha)),
        "sh": np.concatenate([(color / 255 - 0.5)[:, None] / _COLOR_SCALE, higher], axis=1),
    }
    return {name: array.astype(np.float32) for name, array in splats.items()}


def three_scales(log_scales: np.ndarray) -> np.ndarray:
    """Log scales [N,3]; surfels, which have two, get their thickness."""
    if log_scales.shape[1] == 3:
        return log_scales
    return np.column_stack([log_scales, np.full(len(log_scales), math.log(SURFEL_THICKNESS))])


def _unpacked(path: Path) -> tuple[tuple[int, ...], bytes]:
    try:
        with gzip.open(path) as file:
            header = _HEADER.unpack(file.read(_HEADER.size))
            magic, version, count, degree = header[:4]
            if magic != _MAGIC or version != _VERSION or degree > 3 or count > _MAX_SPLATS:
                raise SceneError(
                    f"{path.name}: expected SPZ of version {_VERSION} with at most degree 3 and {_MAX_SPLATS} splats, "
                    f"got version {version}, degree {degree}, {count} splats"
                )
            return header, file.read(count * 64)
    except (OSError, EOFError, zlib.error, struct.error) as error:
        raise SceneError(f"{path.name}: not an SPZ file: {in_short(error)}; write it again") from error


def _fraction_bits(means: np.ndarray) -> int:
    """Twelve, as everyone has it, or fewer for splats that are farther out than 2,048 units."""
    if not np.isfinite(means).all():
        raise SceneError("splats: expected finite means, got NaN or infinite ones; SPZ can't hold them")
    farthest = float(np.abs(means).max(initial=0))
    bits = 12 if farthest < 2047 else math.floor(math.log2((2**23 - 1) / farthest))
    if bits < 0:
        raise SceneError(f"splats: a mean lies {farthest:g} units out; SPZ holds 8,388,607: move or scale them first")
    return bits


def _quantised_harmonics(rest: np.ndarray) -> np.ndarray:
    """Coefficients [N,K,3] as bytes, rounded to the middles of steps of 8 (degree 1) and 16, as the format asks."""
    steps = np.where(np.arange(rest.shape[1]) < 3, 8, 16)[:, None]
    fine = np.rint(rest.astype(np.float64) * 128) + 128
    return _byte(np.floor((fine + steps / 2) / steps) * steps)


def _unit(quats: np.ndarray) -> np.ndarray:
    """Unit quaternions with w >= 0."""
    lengths = np.linalg.norm(quats.astype(np.float64), axis=1, keepdims=True)
    unit = quats / np.maximum(lengths, 1e-12)
    return np.where(unit[:, :1] < 0, -unit, unit)


def _byte(values: np.ndarray) -> np.ndarray:
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)
