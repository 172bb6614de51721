"""Packed splats held to what another program, splat-transform, writes and reads (golden/README.md)."""

from __future__ import annotations

import gzip
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from plyfile import PlyData, PlyElement
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from mgsr.errors import SceneError
from mgsr.export.compressed_ply import load_compressed_ply, write_compressed_ply
from mgsr.export.splats import SURFEL_THICKNESS, Splats, load_splats
from mgsr.export.spz import load_spz, write_spz

GOLDEN = Path(__file__).parent / "golden"

# A bit more than half a step of each field: SPZ's bytes, and the compressed PLY's bits of a chunk's range. SPZ may name
# an ellipsoid's axes otherwise, so that its log is compared: half a step of the scales, and of rotations (0.8 degrees)
# over scales that are e^8 apart at most.
SPZ_STEPS = {"means": 1e-6, "ellipsoids": 0.15, "opacity_logits": 0.03, "sh": 0.07}
PLY_STEPS = {"means": 2.2e-3, "quats": 1.3e-3, "log_scales": 2.5e-3, "opacity_logits": 0.03, "sh": 0.016}


def splats(count: int = 40, coefficients: int = 16, axes: int = 3) -> Splats:
    random = np.random.default_rng(7)
    arrays = {
        "means": random.uniform(-2, 2, (count, 3)),
        "quats": random.normal(size=(count, 4)),
        "log_scales": random.uniform(-6, -2, (count, axes)),
        "opacity_logits": random.uniform(-2, 2, count),
        "sh": random.uniform(-0.8, 0.8, (count, coefficients, 3)),
    }
    return {name: array.astype(np.float32) for name, array in arrays.items()}


def log_ellipsoids(arrays: Splats) -> np.ndarray:
    """Return the matrices R diag(log_scales) R^T [N,3,3], which do not depend on the axes' order."""
    axes = Rotation.from_quat(arrays["quats"], scalar_first=True).as_matrix()
    log_scales = arrays["log_scales"]
    if log_scales.shape[1] == 2:
        log_scales = np.column_stack([log_scales, np.full(len(axes), np.log(SURFEL_THICKNESS))])
    return np.asarray(axes @ (log_scales[:, :, None] * axes.transpose(0, 2, 1)))


def check_close(found: Splats, given: Splats, steps: dict[str, float]) -> None:
    """Check that the splats are the same in any order, each field within its step."""
    which = cKDTree(given["means"]).query(found["means"])[1]
    assert len(set(which)) == len(given["means"]) == len(found["means"])
    given, found = ({**arrays, "ellipsoids": log_ellipsoids(arrays)} for arrays in (given, found))
    for name, step in steps.items():
        ours, theirs = given[name][which].astype(np.float64), found[name].astype(np.float64)
        if name == "quats":
            ours, theirs = (x / np.linalg.norm(x, axis=1, keepdims=True) for x in (ours, theirs))
            theirs *= np.sign((ours * theirs).sum(axis=1, keepdims=True))
        np.testing.assert_allclose(theirs, ours, atol=step, rtol=0, err_msg=name)


def test_another_program_reads_our_spz_as_we_do(tmp_path: Path) -> None:
    write_spz(tmp_path / "a.spz", splats())
    assert gzip.decompress((tmp_path / "a.spz").read_bytes()) == gzip.decompress((GOLDEN / "ours.spz").read_bytes())
    theirs = load_splats(GOLDEN / "ours.spz.ply")
    check_close(theirs, splats(), SPZ_STEPS)
    ours = load_spz(GOLDEN / "ours.spz")
    check_close(ours, theirs, {"means": 1e-6, "quats": 1e-3, "log_scales": 1e-6, "sh": 1e-3})


def test_we_read_another_programs_spz_of_version_3() -> None:
    """Check another program's file; half a step of its quaternions is 0.0007 in three parts.

    They have nine bits and a sign up to the root of a half.
    """
    found = load_spz(GOLDEN / "theirs.spz")
    check_close(found, splats(), {"means": 1.3e-4, "quats": 2.1e-3, "log_scales": 0.032, "sh": 0.07})


def test_spz_keeps_rotations(tmp_path: Path) -> None:
    """Check rotations to half a step in each of three parts of a quaternion, and what w is off for it."""
    given = splats(2000, coefficients=1)
    given["log_scales"][:] = (-6, -4, -2)
    write_spz(tmp_path / "a.spz", given)
    found = load_spz(tmp_path / "a.spz")
    order = np.argsort(found["log_scales"], axis=1)[:, None, :]
    ours, theirs = (Rotation.from_quat(arrays["quats"], scalar_first=True).as_matrix() for arrays in (given, found))
    cosines = np.abs((ours * np.take_along_axis(theirs, order, axis=2)).sum(axis=1))
    assert np.degrees(np.arccos(np.minimum(cosines, 1))).max() < 0.8


@pytest.mark.parametrize("size", [1e-3, 1.0, 100.0, 1e6])
def test_spz_positions_have_as_many_bits_as_there_is_place_for(tmp_path: Path, size: float) -> None:
    given = splats() | {"log_scales": np.zeros((40, 3), np.float32)}
    given["means"] = (given["means"] * size).astype(np.float32)
    write_spz(tmp_path / "a.spz", given)
    half_step = max(2.0**-21, 2 * size / 2**23)
    np.testing.assert_allclose(load_spz(tmp_path / "a.spz")["means"], given["means"], atol=1.01 * half_step, rtol=1e-7)


@pytest.mark.parametrize(("shift", "factor"), [(-7.5, "1000"), (9, "0.0001")])
def test_spz_of_sizes_that_it_can_not_hold(tmp_path: Path, shift: float, factor: str) -> None:
    given = splats()
    given["log_scales"] += shift
    with pytest.raises(
        SceneError, match=rf"of the splats have sizes outside the range of SPZ, .*multiply --scale .* by {factor}$"
    ):
        write_spz(tmp_path / "a.spz", given)
    # Thin ones are what surfaces are made of.
    given = splats()
    given["log_scales"][:, 1] = -14
    write_spz(tmp_path / "a.spz", given)


def test_compressed_ply_from_before_colours_had_ranges(tmp_path: Path) -> None:
    write_compressed_ply(tmp_path / "new.ply", splats(coefficients=1))
    data = PlyData.read(str(tmp_path / "new.ply"))
    kept = [name for name in data["chunk"].data.dtype.names if name[-2:] not in ("_r", "_g", "_b")]
    chunks = data["chunk"].data[kept].astype([(name, "<f4") for name in kept])
    PlyData([PlyElement.describe(chunks, "chunk"), data["vertex"]]).write(str(tmp_path / "old.ply"))
    bytes_ = data["vertex"]["packed_color"][:, None] >> np.array([24, 16, 8]) & 255
    expected = (bytes_ / 255 - 0.5) / 0.28209479
    np.testing.assert_allclose(load_compressed_ply(tmp_path / "old.ply")["sh"][:, 0], expected, atol=1e-6)


@pytest.mark.parametrize("coefficients", [1, 16])
@pytest.mark.parametrize(("write", "load"), [(write_spz, load_spz), (write_compressed_ply, load_compressed_ply)])
def test_no_splats_at_all(
    tmp_path: Path, write: Callable[..., Any], load: Callable[..., Any], coefficients: int
) -> None:
    write(tmp_path / "a", splats(0, coefficients))
    assert load(tmp_path / "a")["sh"].shape == (0, coefficients, 3)


@pytest.mark.parametrize("write", [write_spz, write_compressed_ply])
def test_infinite_opacity_logits(tmp_path: Path, write: Callable[..., Any]) -> None:
    given = splats()
    given["opacity_logits"][:2] = (np.inf, -np.inf)
    write(tmp_path / "a", given)
    found = (load_spz if write is write_spz else load_compressed_ply)(tmp_path / "a")
    which = cKDTree(found["means"]).query(given["means"][:2])[1]
    np.testing.assert_allclose(1 / (1 + np.exp(-found["opacity_logits"][which])), [1, 0], atol=0.002)


def test_we_read_another_programs_compressed_ply() -> None:
    check_close(load_compressed_ply(GOLDEN / "theirs.compressed.ply"), splats(), PLY_STEPS)


def test_our_compressed_ply_is_the_same_as_another_programs(tmp_path: Path) -> None:
    """Check that our file and another program's hold the same numbers, in each program's order."""
    write_compressed_ply(tmp_path / "a.compressed.ply", splats())
    ours = load_compressed_ply(tmp_path / "a.compressed.ply")
    steps = {"means": 1e-6, "quats": 1e-6, "log_scales": 1e-6, "sh": 1e-6, "opacity_logits": 1e-5}
    check_close(ours, load_compressed_ply(GOLDEN / "theirs.compressed.ply"), steps)


@pytest.mark.parametrize("coefficients", [1, 4, 9, 16])
@pytest.mark.parametrize(
    ("write", "load", "steps"),
    [(write_spz, load_spz, SPZ_STEPS), (write_compressed_ply, load_compressed_ply, PLY_STEPS)],
)
def test_surfels_of_every_degree_over_several_chunks(
    tmp_path: Path, write: Callable[..., Any], load: Callable[..., Any], steps: dict[str, float], coefficients: int
) -> None:
    given = splats(600, coefficients, axes=2)
    write(tmp_path / "a", given)
    thick = np.full((600, 1), max(np.log(SURFEL_THICKNESS), -10 if write is write_spz else -20), np.float32)
    given["log_scales"] = np.hstack([given["log_scales"], thick])
    check_close(load(tmp_path / "a"), given, steps)


def test_spz_far_from_the_origin(tmp_path: Path) -> None:
    given = splats()
    given["means"] += 5000
    write_spz(tmp_path / "a.spz", given)
    np.testing.assert_allclose(load_spz(tmp_path / "a.spz")["means"], given["means"], atol=1e-3)
    given["means"] *= 1e5
    with pytest.raises(SceneError, match=r"at most 8,388,607 units, the limit of SPZ, got .*; move or scale"):
        write_spz(tmp_path / "a.spz", given)


def packed_header(*fields: int) -> bytes:
    """Return an SPZ file that ends after its header."""
    return gzip.compress(struct.pack("<IIIBBBB", *fields))


@pytest.mark.parametrize(
    ("data", "message"),
    [
        pytest.param(b"hello", r"a\.spz: this file is not an SPZ file: .*write it again", id="not-gzip"),
        pytest.param(gzip.compress(b"short"), r"a\.spz: this file is not an SPZ file", id="shorter-than-a-header"),
        pytest.param(
            packed_header(0x5053474E, 9, 1, 0, 12, 0, 0), "expected SPZ of version 2 or 3 .*got version 9", id="version"
        ),
        pytest.param(
            b"NGSP" + bytes(40), r"MGSR does not read SPZ version 4 or later.*--spz-version 3", id="version-4"
        ),
        pytest.param(
            packed_header(0x5053474E, 2, 5, 0, 12, 0, 0), "the file is truncated: expected 95 bytes", id="ends-early"
        ),
        pytest.param(
            packed_header(0x5053474E, 2, 2**31, 0, 12, 0, 0), "got version 2, degree 0, 2147483648", id="too-many"
        ),
    ],
)
def test_spz_refusals(tmp_path: Path, data: bytes, message: str) -> None:
    (tmp_path / "a.spz").write_bytes(data)
    with pytest.raises(SceneError, match=message):
        load_spz(tmp_path / "a.spz")


@pytest.mark.parametrize("cut", [10, 300, 2000])
def test_compressed_ply_refusals(tmp_path: Path, cut: int) -> None:
    (tmp_path / "a.compressed.ply").write_bytes((GOLDEN / "theirs.compressed.ply").read_bytes()[:cut])
    with pytest.raises(SceneError, match=r"a\.compressed\.ply: expected a compressed PLY file of splats"):
        load_compressed_ply(tmp_path / "a.compressed.ply")
