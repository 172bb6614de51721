"""Splats as SPZ, Niantic's packed format: about a tenth of the PLY's size, with hardly visible rounding.

The file is the gzip of a 16-byte header and arrays of bytes. These are positions as 24-bit fixed point, opacities,
colours, log scales in sixteenths, quaternions, and higher colour coefficients. The coefficients have 5 bits in the
first degree and 4 in the others. Version 2 stores x, y, z of the quaternion with w >= 0. Version 3 stores the three
smaller parts in ten bits each. Source: the README of Niantic's spz, versions 2 and 3.

The format has y up and z backwards where splat PLYs have y down and z forward. All data therefore turns by half a turn
about x, as in Niantic's own converter. The format has no place for reflected light.

The format has no place for notes either. If positions are relative to another origin than the frame's, the comment of
the gzip header names it (RFC 1952, section 2.3); decoders skip this comment. Like the note in PLYs (`ply_notes.py`), it
is "mgsr origin X Y Z", in the axes of splat PLYs.

MGSR writes version 2, which more programs read. Readers compute w from the rounded x, y, z, so the rotation errs by up
to 10 degrees if w is near 0. An ellipsoid stays the same if its axes are relabelled, so the labels that make w largest
are used (`_least_turned`).
"""

from __future__ import annotations

import gzip
import math
import struct
import zlib
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import expit

from mgsr.data.images import to_uint8
from mgsr.errors import SceneError, in_short
from mgsr.export.far_origin import no_origin, read_origin_text
from mgsr.export.ply_notes import ORIGIN, origin_comments
from mgsr.export.splats import SURFEL_THICKNESS, Splats

_MAGIC = 0x5053474E
_WRITTEN, _READ = 2, (2, 3)
_HEADER = struct.Struct("<IIIBBBB")
_DEGREES = {1: 0, 4: 1, 9: 2, 16: 3}
# The scale from the constant colour coefficient to a byte, about the middle of its range.
_COLOR_SCALE = 0.15
# The signs of a half turn about x: of positions, of quaternions (wxyz), and of the colour coefficients after the first.
_TURN = np.array([1.0, -1, -1])
_QUAT_TURN = np.array([1.0, 1, -1, -1])
_SH_TURN = np.array([-1.0, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1])[:, None]

# The range of log scales that a byte can hold.
_LOG_SCALES = (-10.0, 255 / 16 - 10)
# The largest share of splats whose size may be clipped to that range; beyond it, the scene looks wrong.
_MAX_CUT_OFF = 0.1
# The largest number of fraction bits that programs are known to read correctly.
_MAX_FRACTION_BITS = 20

# The flags of a gzip header, and the header's length without optional fields.
_EXTRA, _NAME, _COMMENT = 4, 8, 16
_GZIP_HEADER = 10
_LONGEST_GZIP_HEADER = 1 << 17

# A hundred million splats would not fit a GPU; a file that claims more was made to fill the memory.
_MAX_SPLATS = 100_000_000


def write_spz(path: Path, splats: Splats, origin: np.ndarray | None = None) -> None:
    """Write splats, as `write_splats` takes them and in the frame that they have, to an SPZ file.

    They must be finite but for opacity logits. origin [3]: the origin of their positions, None for the frame's own.

    Raises SceneError for positions that its 24 bits can't hold, and where many sizes are out of its range.
    """
    _check_sizes(splats["log_scales"])
    fraction = _fraction_bits(splats["means"])
    quats, log_scales = _least_turned(_unit(splats["quats"]), three_scales(splats["log_scales"]))
    count, coefficients = splats["sh"].shape[:2]
    header = _HEADER.pack(_MAGIC, _WRITTEN, count, _DEGREES[coefficients], fraction, 0, 0)
    fixed = np.rint(splats["means"].astype(np.float64) * _TURN * 2**fraction).astype("<i4")
    arrays = [
        fixed.view(np.uint8).reshape(count, 3, 4)[:, :, :3],
        to_uint8(255 * expit(splats["opacity_logits"].astype(np.float64))),
        to_uint8((splats["sh"][:, 0] * _COLOR_SCALE + 0.5) * 255),
        to_uint8((log_scales - _LOG_SCALES[0]) * 16),
        to_uint8(_unit(quats * _QUAT_TURN)[:, 1:] * 127.5 + 127.5),
        _quantised_harmonics(splats["sh"][:, 1:] * _SH_TURN[: coefficients - 1]),
    ]
    body = b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)
    path.write_bytes(_with_comments(gzip.compress(header + body, mtime=0), origin_comments(origin)))


def load_spz(path: Path) -> Splats:
    """Load the splats of a file of version 2 or 3, as Gaussians, float32.

    Positions are about the origin that it names (`read_spz_origin`). Raises SceneError naming the file for others.
    """
    header, body = _unpacked(path)
    _, version, count, degree, fraction, _, _ = header
    coefficients = {value: key for key, value in _DEGREES.items()}[degree]
    sizes = [9, 1, 3, 3, 3 if version == 2 else 4, 3 * (coefficients - 1)]
    if len(body) < count * sum(sizes):
        raise SceneError(
            f"{path}: the file is truncated: expected {count * sum(sizes)} bytes of splats, got {len(body)}; write it "
            "again"
        )
    edges = np.cumsum([0, *sizes]) * count
    parts = [np.frombuffer(body[a:b], np.uint8) for a, b in pairwise(edges)]
    positions, opacity, color, scales, rotation, rest = (
        part.reshape(count, size) for part, size in zip(parts, sizes, strict=True)
    )
    whole = np.zeros((count, 3, 4), np.uint8)
    whole[:, :, 1:] = positions.reshape(count, 3, 3)
    alpha = np.clip(opacity[:, 0] / 255, 0.5 / 255, 1 - 0.5 / 255)
    higher = (rest.reshape(count, coefficients - 1, 3) - 128.0) / 128 * _SH_TURN[: coefficients - 1]
    splats = {
        # The bytes are the upper three of 32 bits, which extends the sign.
        "means": (whole.view("<i4")[..., 0] >> 8) / 2**fraction * _TURN,
        "quats": (_from_three_bytes(rotation) if version == 2 else _from_four_bytes(rotation)) * _QUAT_TURN,
        "log_scales": scales / 16 + _LOG_SCALES[0],
        "opacity_logits": np.log(alpha / (1 - alpha)),
        "sh": np.concatenate([(color / 255 - 0.5)[:, None] / _COLOR_SCALE, higher], axis=1),
    }
    return {name: array.astype(np.float32) for name, array in splats.items()}


def read_spz_origin(path: Path) -> np.ndarray:
    """Return the origin [3] that the comment of an SPZ file's gzip header names, zeros where it names none.

    Raises SceneError, naming the file, for anything but three finite numbers.
    """
    with path.open("rb") as file:
        comment = _gzip_comment(file.read(_LONGEST_GZIP_HEADER))
    for words in map(str.split, comment.splitlines()):
        if words[:2] == ["mgsr", ORIGIN]:
            return read_origin_text(words[2:], str(path))
    return no_origin()


def _with_comments(data: bytes, comments: list[str]) -> bytes:
    """Add comments to a gzip file; its header must have no optional fields."""
    if not comments:
        return data
    text = "\n".join(comments).encode("latin-1")
    return data[:3] + bytes([data[3] | _COMMENT]) + data[4:_GZIP_HEADER] + text + b"\0" + data[_GZIP_HEADER:]


def _gzip_comment(data: bytes) -> str:
    """Return the comment of a gzip header; empty where there is none or the header is cut off."""
    if data[:2] != b"\x1f\x8b" or len(data) < _GZIP_HEADER or not data[3] & _COMMENT:
        return ""
    rest = data[_GZIP_HEADER:]
    if data[3] & _EXTRA:
        rest = rest[2 + int.from_bytes(rest[:2], "little") :]
    if data[3] & _NAME:
        rest = rest.partition(b"\0")[2]
    return rest.partition(b"\0")[0].decode("latin-1")


def three_scales(log_scales: np.ndarray) -> np.ndarray:
    """Return log scales [N,3]; surfels, which have two, get their thickness."""
    if log_scales.shape[1] == 3:
        return log_scales
    return np.column_stack([log_scales, np.full(len(log_scales), math.log(SURFEL_THICKNESS))])


def _unpacked(path: Path) -> tuple[tuple[int, ...], bytes]:
    with path.open("rb") as raw:
        if raw.read(4) == _MAGIC.to_bytes(4, "little"):
            raise SceneError(
                f"{path}: MGSR does not read SPZ version 4 or later; convert it to version 3, for example with "
                "`splat-transform --spz-version 3 A.spz B.spz`"
            )
    try:
        with gzip.open(path) as file:
            header = _HEADER.unpack(file.read(_HEADER.size))
            magic, version, count, degree = header[:4]
            if magic != _MAGIC or version not in _READ or degree > 3 or count > _MAX_SPLATS:
                raise SceneError(
                    f"{path}: expected SPZ of version 2 or 3 with at most degree 3 and {_MAX_SPLATS} splats, got "
                    f"version {version}, degree {degree}, {count} splats; write it so, or as a PLY file"
                )
            return header, file.read(count * 65)
    except (OSError, EOFError, zlib.error, struct.error) as error:
        raise SceneError(f"{path}: this file is not an SPZ file: {in_short(error)}; write it again") from error


def _from_three_bytes(rotation: np.ndarray) -> np.ndarray:
    """Return quaternions [N,4] wxyz, w >= 0, of their x, y, z in [N,3] bytes."""
    vector = rotation / 127.5 - 1
    return np.column_stack([np.sqrt(np.maximum(0, 1 - (vector**2).sum(axis=1))), vector])


def _from_four_bytes(rotation: np.ndarray) -> np.ndarray:
    """Return quaternions [N,4] wxyz of [N,4] bytes.

    Two bits say which part of xyzw is largest. Each other part, the last one lowest, has a sign and nine bits up to the
    root of a half.
    """
    packed = np.ascontiguousarray(rotation).view("<u4")[:, 0].astype(np.int64)
    largest, quats = packed >> 30, np.zeros((len(packed), 4))
    for part in (3, 2, 1, 0):
        stored = largest != part
        value = (packed & 511) / 511 * math.sqrt(0.5)
        quats[:, part] = np.where(stored, np.where(packed >> 9 & 1, -value, value), 0)
        packed = np.where(stored, packed >> 10, packed)
    rest = np.sqrt(np.maximum(0, 1 - (quats**2).sum(axis=1)))
    np.put_along_axis(quats, largest[:, None], rest[:, None], axis=1)
    return quats[:, [3, 0, 1, 2]]


def _check_sizes(log_scales: np.ndarray) -> None:
    """Raise SceneError where many log_scales [N,3] are out of SPZ's range.

    One axis may be arbitrarily thin. Where two axes are out of the format's range, the splat's size is wrong.
    """
    low, high = _LOG_SCALES
    middle = np.sort(log_scales, axis=1)[:, -2]
    share = float(((middle < low) | (middle > high)).mean()) if len(middle) else 0.0
    if share > _MAX_CUT_OFF:
        factor = 10.0 ** round((-4 - float(np.median(middle))) / math.log(10))
        raise SceneError(
            f"{share:.0%} of the splats have sizes outside the range of SPZ, {math.exp(low):.1g} to "
            f"{math.exp(high):.0f} units; multiply --scale (default 1) by {factor:g}"
        )


def _fraction_bits(means: np.ndarray) -> int:
    """Return the fraction bits that the farthest of means [N,3] leaves of 23. Raises SceneError beyond 23 bits."""
    farthest = float(np.abs(means).max(initial=0))
    bits = math.floor(math.log2((2**23 - 1) / farthest)) if farthest > 1 else _MAX_FRACTION_BITS
    if bits < 0:
        raise SceneError(
            f"expected coordinates of at most 8,388,607 units, the limit of SPZ, got {farthest:g}; move or scale the "
            "splats first"
        )
    return min(bits, _MAX_FRACTION_BITS)


def _least_turned(quats: np.ndarray, log_scales: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the same ellipsoids with axes relabelled so that |w| of their quaternions is at least 0.85.

    quats: unit, [N,4] wxyz. log_scales: [N,3]. It applies the axis permutation, of the 24 that are rotations, with the
    largest |w|.
    """
    turns = Rotation.create_group("O")
    turned, scales = quats.copy(), log_scales.copy()
    w, x, y, z = turns.as_quat(scalar_first=True).T
    # The right product with a rotation, which is linear in the quaternion.
    products = np.array([[w, x, y, z], [-x, w, -z, y], [-y, z, w, -x], [-z, -y, x, w]])
    best = np.abs(quats @ products[:, 0]).argmax(axis=1)
    for index, matrix in enumerate(turns.as_matrix()):
        rows = best == index
        turned[rows] = quats[rows] @ products[..., index]
        scales[rows] = log_scales[rows][:, np.abs(matrix).argmax(axis=0)]
    return turned, scales


def _quantised_harmonics(rest: np.ndarray) -> np.ndarray:
    """Return coefficients [N,K,3] as bytes, rounded to the middles of steps of 8 (degree 1) and 16.

    The format asks for these steps.
    """
    steps = np.where(np.arange(rest.shape[1]) < 3, 8, 16)[:, None]
    fine = np.rint(rest.astype(np.float64) * 128) + 128
    return to_uint8(np.floor((fine + steps / 2) / steps) * steps)


def _unit(quats: np.ndarray) -> np.ndarray:
    """Normalise quaternions [N,4] wxyz, and choose the sign with w >= 0."""
    lengths = np.linalg.norm(quats.astype(np.float64), axis=1, keepdims=True)
    unit = quats / np.maximum(lengths, 1e-12)
    turned: np.ndarray = np.where(unit[:, :1] < 0, -unit, unit)
    return turned
