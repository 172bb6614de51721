"""Splats far from their frame's origin: their places as other readers find them, with the origin that files name."""

from __future__ import annotations

import gzip
import re
import shutil
import struct
import subprocess
import zlib
from pathlib import Path

import numpy as np
import pytest
import trimesh
from plyfile import PlyData, PlyElement
from scipy.spatial import cKDTree

from mgsr.data.scene import Similarity
from mgsr.errors import SceneError
from mgsr.export.compressed_ply import write_compressed_ply
from mgsr.export.convert import convert
from mgsr.export.far_origin import about_origin, origin_notes, origin_of_frame, origin_text
from mgsr.export.obj_files import write_obj
from mgsr.export.ply_notes import read_origin
from mgsr.export.splats import Splats, load_splats, write_splats
from mgsr.export.spz import load_spz, read_spz_origin, write_spz
from tests.export.test_mesh_files import ball, mesh_and_colors
from tests.export.test_packed_splats import GOLDEN, splats

UTM = np.array([512345.67, 4501234.4, 431.2])
GEOCENTRIC = np.array([4308323.455338789, -628516.4200458565, 4645883.308119935])
FRAMES = [Similarity(0.954, UTM), Similarity(0.237, GEOCENTRIC), Similarity(350.0, UTM), Similarity(1e-4, np.ones(3))]
PACKED = [".ply", ".compressed.ply", ".spz"]


def write_far(path: Path, frame: Similarity, unit: float = 1.0) -> tuple[Splats, np.ndarray]:
    """Write splats of the frame's unit ball as a run does; return them and their places in the file's unit."""
    given = splats()
    given["means"] = (given["means"] / 4).astype(np.float32)
    given["log_scales"] += np.float32(2 - np.log(frame.scale * unit))  # of sizes that SPZ holds
    origin = origin_of_frame(frame, unit)
    write_splats(path, given, about_origin(frame, unit, origin), unit, origin=origin)
    return given, (given["means"].astype(np.float64) * frame.scale + frame.offset) * unit


def named_origin(data: bytes) -> np.ndarray:
    found = re.search(rb"mgsr origin (\S+) (\S+) ([^\s\0]+)[\n\0]", data)
    return np.zeros(3) if found is None else np.array([float(word) for word in found.groups()])


def places(path: Path) -> np.ndarray:
    """Return the places as plyfile and a reader of the comment find them."""
    vertex = PlyData.read(str(path))["vertex"]
    stored = np.stack([vertex[axis] for axis in "xyz"], axis=1)
    assert stored.dtype == np.float32
    positions: np.ndarray = stored.astype(np.float64) + named_origin(path.read_bytes())
    return positions


def nearest(found: np.ndarray, given: np.ndarray) -> float:
    """Return the largest distance of a given place to the nearest found one."""
    return float(cKDTree(found - given[0]).query(given - given[0])[0].max())


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("unit", [1.0, 1000.0, 0.3])
def test_places_keep_float32_precision(tmp_path: Path, frame: Similarity, unit: float) -> None:
    _, given = write_far(tmp_path / "a.ply", frame, unit)
    assert named_origin((tmp_path / "a.ply").read_bytes()).any()
    step = 1e-9 * np.abs(frame.offset).max()  # what float64 itself keeps of such numbers, and more
    np.testing.assert_allclose(
        places(tmp_path / "a.ply"), given, rtol=0, atol=unit * (2e-7 * frame.scale + 1e-6 * step)
    )


@pytest.mark.parametrize("frame", FRAMES)
def test_the_origin_is_short_and_in_the_scene(frame: Similarity) -> None:
    origin = origin_of_frame(frame)
    assert (np.abs(origin - frame.offset) <= frame.scale).all()
    text = origin_text(origin)
    np.testing.assert_array_equal([float(word) for word in text.split()], origin)
    np.testing.assert_array_equal(origin, np.round(origin, 5))
    (note,) = origin_notes(frame)
    assert f"positions relative to {text}, which they record" in note


def test_the_note_tells_how_far_away() -> None:
    (note,) = origin_notes(Similarity(1.0, np.array([430987.0, 5411222.0, 210.0])))
    assert note.startswith("the frame's origin lies 5,400,000 units away, ") and " 430987 5411222 210, " in note


@pytest.mark.parametrize("offset", [(0, 0, 0), (1e-3, 5, -2), (0, 70, 0)])
def test_near_frames_keep_their_origin(tmp_path: Path, offset: tuple[float, float, float]) -> None:
    frame = Similarity(1.0, np.array(offset, float))
    given, _ = write_far(tmp_path / "a.ply", frame)
    assert not origin_of_frame(frame).any() and origin_notes(frame) == []
    assert b"origin" not in (tmp_path / "a.ply").read_bytes()
    np.testing.assert_allclose(load_splats(tmp_path / "a.ply")["means"], given["means"] + offset, rtol=0, atol=1e-5)
    for name in ("b.compressed.ply", "b.spz", "b.ply"):
        assert "origin" not in convert(tmp_path / "a.ply", tmp_path / name)
        assert b"origin" not in (tmp_path / name).read_bytes()


def test_near_files_are_the_same_to_the_byte(tmp_path: Path) -> None:
    """Check files without an origin and with the frame's own; SPZ's golden file has none."""
    for write, name in ((write_splats, "a.ply"), (write_compressed_ply, "a.compressed.ply"), (write_spz, "a.spz")):
        write(tmp_path / name, splats())
        write(tmp_path / f"zero.{name}", splats(), origin=np.zeros(3))
        assert (tmp_path / name).read_bytes() == (tmp_path / f"zero.{name}").read_bytes()
    golden = gzip.decompress((GOLDEN / "ours.spz").read_bytes())
    assert (tmp_path / "a.spz").read_bytes() == gzip.compress(golden, mtime=0)


@pytest.mark.parametrize("frame", FRAMES[:2])
@pytest.mark.parametrize("suffix", PACKED)
def test_conversions_keep_places(tmp_path: Path, frame: Similarity, suffix: str) -> None:
    _, given = write_far(tmp_path / "a.ply", frame)
    text = convert(tmp_path / "a.ply", tmp_path / f"b{suffix}")
    assert text.endswith(f", relative to the origin {origin_text(origin_of_frame(frame))}, which the file records")
    np.testing.assert_array_equal(named_origin((tmp_path / f"b{suffix}").read_bytes()), origin_of_frame(frame))
    convert(tmp_path / f"b{suffix}", tmp_path / "c.ply")
    # The compressed PLY's ten bits of a chunk's range, and SPZ's twenty bits after the point.
    step = {".ply": 2e-7 * frame.scale, ".compressed.ply": 2e-3 * frame.scale, ".spz": 2e-6}[suffix]
    assert nearest(places(tmp_path / "c.ply"), given) < step
    if suffix == ".ply":
        assert (tmp_path / "a.ply").read_bytes() == (tmp_path / "b.ply").read_bytes()


@pytest.mark.parametrize("suffix", PACKED)
def test_scaling_scales_the_origin(tmp_path: Path, suffix: str) -> None:
    _, given = write_far(tmp_path / "a.ply", Similarity(0.237, GEOCENTRIC))
    convert(tmp_path / "a.ply", tmp_path / f"b{suffix}", scale=0.1)
    origin = named_origin((tmp_path / f"b{suffix}").read_bytes())
    np.testing.assert_array_equal(origin, [430832.35, -62851.64, 464588.33])
    convert(tmp_path / f"b{suffix}", tmp_path / "c.ply", scale=10)
    assert nearest(places(tmp_path / "c.ply"), given) < {".compressed.ply": 5e-4}.get(suffix, 2e-5)


def test_other_programs_doubles(tmp_path: Path) -> None:
    """Check that a PLY with double positions and no comment keeps them, about an origin that it gets."""
    _, given = write_far(tmp_path / "near.ply", Similarity())
    vertex = PlyData.read(str(tmp_path / "near.ply"))["vertex"].data
    wide = np.empty(len(vertex), [(name, "<f8" if name in "xyz" else "<f4") for name in vertex.dtype.names])
    for name in vertex.dtype.names:
        wide[name] = vertex[name].astype(np.float64) + (UTM["xyz".index(name)] if name in "xyz" else 0)
    PlyData([PlyElement.describe(wide, "vertex")], byte_order="<").write(str(tmp_path / "a.ply"))
    for suffix in PACKED:
        assert " relative to the origin 512345.6 4501234.4 431.2," in convert(
            tmp_path / "a.ply", tmp_path / f"b{suffix}"
        )
        convert(tmp_path / f"b{suffix}", tmp_path / "c.ply")
        assert nearest(places(tmp_path / "c.ply"), given + UTM) < (2e-3 if "compressed" in suffix else 2e-6)


def test_decoders_skip_the_comment_of_an_spz(tmp_path: Path) -> None:
    write_spz(tmp_path / "plain.spz", splats())
    write_spz(tmp_path / "far.spz", splats(), origin=np.array([512346.0, -4501234.5, 431.0]))
    plain, far = ((tmp_path / name).read_bytes() for name in ("plain.spz", "far.spz"))
    # RFC 1952: the flag of a comment, and behind ten bytes the text, which ends with a zero.
    assert far == plain[:3] + b"\x10" + plain[4:10] + b"mgsr origin 512346 -4501234.5 431\0" + plain[10:]
    assert gzip.decompress(far) == zlib.decompress(far, 31) == gzip.decompress(plain)
    np.testing.assert_array_equal(read_spz_origin(tmp_path / "far.spz"), [512346, -4501234.5, 431])
    assert not read_spz_origin(tmp_path / "plain.spz").any()
    np.testing.assert_array_equal(load_spz(tmp_path / "far.spz")["means"], load_spz(tmp_path / "plain.spz")["means"])


@pytest.mark.skipif(shutil.which("node") is None, reason="NEEDS NODE: no node on this machine")
def test_node_skips_the_comment_of_an_spz(tmp_path: Path) -> None:
    write_spz(tmp_path / "far.spz", splats(), origin=UTM)
    code = "process.stdout.write(require('zlib').gunzipSync(require('fs').readFileSync(process.argv[1])))"
    found = subprocess.run(["node", "-e", code, tmp_path / "far.spz"], capture_output=True, check=True).stdout
    assert found == gzip.decompress((GOLDEN / "ours.spz").read_bytes())


@pytest.mark.parametrize(
    ("flags", "added", "origin"),
    [
        (0, b"", (0, 0, 0)),
        (8, b"scene.spz\0", (0, 0, 0)),
        (16, b"another program\0", (0, 0, 0)),
        (16, b"another program\nmgsr origin 1 2 3\0", (1, 2, 3)),
        (4 + 8 + 16, struct.pack("<H", 5) + b"ab\0cd" + b"a.spz\0" + b"mgsr origin 1 2.5 -3\0", (1, 2.5, -3)),
        (16, b"mgsr origin 1 2 3", (1, 2, 3)),
    ],
)
def test_gzip_headers(tmp_path: Path, flags: int, added: bytes, origin: tuple[float, float, float]) -> None:
    write_spz(tmp_path / "a.spz", splats(5))
    plain = (tmp_path / "a.spz").read_bytes()
    ends = added[-1:] in (b"", b"\0")
    (tmp_path / "b.spz").write_bytes(plain[:3] + bytes([flags]) + plain[4:10] + added + (plain[10:] if ends else b""))
    np.testing.assert_array_equal(read_spz_origin(tmp_path / "b.spz"), origin)
    if ends:
        np.testing.assert_array_equal(load_spz(tmp_path / "b.spz")["means"], load_spz(tmp_path / "a.spz")["means"])


@pytest.mark.parametrize("data", [b"", b"\x1f\x8b", b"\x1f\x8b\x08\x10", b"\x1f\x8b\x08\x1c" + bytes(6) + b"\xff"])
def test_headers_that_are_cut_off_name_no_origin(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "a.spz").write_bytes(data)
    assert not read_spz_origin(tmp_path / "a.spz").any()


@pytest.mark.parametrize("words", [b"", b"1 2", b"1 2 3 4", b"1 2 x", b"nan 0 0", b"1 1e999 2", b"1 2 \xff3"])
def test_origins_that_are_no_places(tmp_path: Path, words: bytes) -> None:
    write_far(tmp_path / "a.ply", Similarity(0.954, UTM))
    data = (tmp_path / "a.ply").read_bytes()
    (tmp_path / "b.ply").write_bytes(re.sub(rb"(mgsr origin )[^\n]*", lambda found: found[1] + words, data, count=1))
    convert(tmp_path / "a.ply", tmp_path / "a.spz")
    data = (tmp_path / "a.spz").read_bytes()
    (tmp_path / "b.spz").write_bytes(re.sub(rb"(mgsr origin )[^\0]*", lambda found: found[1] + words, data, count=1))
    with pytest.raises(SceneError, match=r"b\.ply: expected an origin of three finite numbers, got .*; write the file"):
        read_origin(tmp_path / "b.ply")
    for name in ("b.ply", "b.spz"):
        with pytest.raises(SceneError, match=name.replace(".", r"\.")):
            convert(tmp_path / name, tmp_path / "c.ply")


def test_obj_of_a_small_scene_far_away(tmp_path: Path) -> None:
    vertices, faces, normals, colors = ball()
    far = 0.01 * vertices + GEOCENTRIC
    write_obj(tmp_path / "a.obj", *mesh_and_colors(far, faces, normals, colors))
    mesh = trimesh.load_mesh(tmp_path / "a.obj", process=False, maintain_order=True)
    np.testing.assert_allclose(mesh.vertices, far, rtol=0, atol=1e-8)
