"""Packed splats held to what another program, splat-transform, writes and reads (golden/README.md)."""

from __future__ import annotations

import gzip
import struct
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from mgsr.errors import SceneError
from mgsr.export.compressed_ply import load_compressed_ply, write_compressed_ply
from mgsr.export.splats import SURFEL_THICKNESS, Splats, load_splats
from mgsr.export.spz import load_spz, write_spz

GOLDEN = Path(__file__).parent / "golden"

# A bit more than half a step of each field: SPZ's bytes, and the compressed PLY's bits of a chunk's range. SPZ keeps
# x, y, z of a quaternion; near 0, w is off by up to the root of 2 (|x| + |y| + |z|) half steps, at most 0.117.
SPZ_STEPS = {"means": 1.3e-4, "quats": 0.117, "log_scales": 0.032, "opacity_logits": 0.03, "sh": 0.07}
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


def check_close(found: Splats, given: Splats, steps: dict[str, float]) -> None:
    """The same splats in any order, each field within its step."""
    which = cKDTree(given["means"]).query(found["means"])[1]
    assert len(set(which)) == len(given["means"]) == len(found["means"])
    for name, step in steps.items():
        ours, theirs = given[name][which].astype(np.float64), found[name].astype(np.float64)
        if name == "quats":
            ours, theirs = (x / np.linalg.norm(x, axis=1, keepdims=True) for x in (ours, theirs))
            theirs *= np.sign((ours * theirs).sum(axis=1, keepdims=True))
        np.testing.assert_allclose(theirs, ours, atol=step, rtol=0, err_msg=name)


def test_another_program_reads_our_spz_as_we_do(tmp_path):
    write_spz(tmp_path / "a.spz", splats())
    assert gzip.decompress((tmp_path / "a.spz").read_bytes()) == gzip.decompress((GOLDEN / "ours.spz").read_bytes())
    theirs = load_splats(GOLDEN / "ours.spz.ply")
    check_close(theirs, splats(), SPZ_STEPS)
    ours = load_spz(GOLDEN / "ours.spz")
    check_close(ours, theirs, {name: 1e-3 for name in SPZ_STEPS if name != "opacity_logits"})


def test_we_read_another_programs_compressed_ply():
    check_close(load_compressed_ply(GOLDEN / "theirs.compressed.ply"), splats(), PLY_STEPS)


def test_our_compressed_ply_is_the_same_as_another_programs(tmp_path):
    """Its reading of its own file is that of ours: both hold the same numbers, in each program's order."""
    write_compressed_ply(tmp_path / "a.compressed.ply", splats())
    ours = load_compressed_ply(tmp_path / "a.compressed.ply")
    steps = {"means": 1e-6, "quats": 1e-6, "log_scales": 1e-6, "sh": 1e-6, "opacity_logits": 1e-5}
    check_close(ours, load_compressed_ply(GOLDEN / "theirs.compressed.ply"), steps)


@pytest.mark.parametrize("coefficients", [1, 4, 9, 16])
@pytest.mark.parametrize(
    ("write", "load", "steps"),
    [(write_spz, load_spz, SPZ_STEPS), (write_compressed_ply, load_compressed_ply, PLY_STEPS)],
)
def test_surfels_of_every_degree_over_several_chunks(tmp_path, write, load, steps, coefficients):
    given = splats(600, coefficients, axes=2)
    write(tmp_path / "a", given)
    thick = np.full((600, 1), max(np.log(SURFEL_THICKNESS), -10 if write is write_spz else -20), np.float32)
    given["log_scales"] = np.hstack([given["log_scales"], thick])
    check_close(load(tmp_path / "a"), given, steps)


def test_spz_far_from_the_origin(tmp_path):
    given = splats()
    given["means"] += 5000
    write_spz(tmp_path / "a.spz", given)
    np.testing.assert_allclose(load_spz(tmp_path / "a.spz")["means"], given["means"], atol=1e-3)
    given["means"] *= 1e5
    with pytest.raises(SceneError, match=r"a mean lies .* units out; SPZ holds 8,388,607: move or scale"):
        write_spz(tmp_path / "a.spz", given)


@pytest.mark.parametrize("write", [write_spz, write_compressed_ply])
def test_means_without_a_place(tmp_path, write):
    given = splats()
    given["means"][3, 1] = np.nan
    with pytest.raises(SceneError, match="expected finite means, got NaN"):
        write(tmp_path / "a", given)


def packed_header(*fields: int) -> bytes:
    """An SPZ file that ends after its header."""
    return gzip.compress(struct.pack("<IIIBBBB", *fields))


@pytest.mark.parametrize(
    ("data", "message"),
    [
        pytest.param(b"hello", r"a\.spz: not an SPZ file: .*write it again", id="not-gzip"),
        pytest.param(gzip.compress(b"short"), r"a\.spz: not an SPZ file", id="shorter-than-a-header"),
        pytest.param(
            packed_header(0x5053474E, 9, 1, 0, 12, 0, 0), "expected SPZ of version 2 .*got version 9", id="version"
        ),
        pytest.param(packed_header(0x5053474E, 2, 5, 0, 12, 0, 0), "ends early: expected 95 bytes", id="ends-early"),
        pytest.param(
            packed_header(0x5053474E, 2, 2**31, 0, 12, 0, 0), "got version 2, degree 0, 2147483648", id="too-many"
        ),
    ],
)
def test_spz_refusals(tmp_path, data, message):
    (tmp_path / "a.spz").write_bytes(data)
    with pytest.raises(SceneError, match=message):
        load_spz(tmp_path / "a.spz")


@pytest.mark.parametrize("cut", [10, 300, 2000])
def test_compressed_ply_refusals(tmp_path, cut):
    (tmp_path / "a.compressed.ply").write_bytes((GOLDEN / "theirs.compressed.ply").read_bytes()[:cut])
    with pytest.raises(SceneError, match=r"a\.compressed\.ply: expected a compressed PLY of splats"):
        load_compressed_ply(tmp_path / "a.compressed.ply")
