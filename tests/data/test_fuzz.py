"""Damaged and hostile files: whatever is changed in them, a reader gives a capture or one SceneError.

What the long run finds becomes a test of its own (tests/fuzzing.py).
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import settings
from hypothesis import strategies as st
from PIL import Image

from mgsr.data import archive
from mgsr.data.formats import all_formats
from mgsr.data.images import read_picture
from mgsr.data.photo_files import SceneFolder
from mgsr.data.usable import usable_photos
from mgsr.errors import SceneError
from tests.data.captures import BallCapture
from tests.data.test_app_formats import metashape, opensfm, polycam, realitycapture
from tests.data.test_archive import tarred, zipped
from tests.data.test_dataset_formats import gaussians, llff, mvsnet, nero, nsvf, record3d, scannet, tanks
from tests.data.test_photogrammetry_formats import (
    blocksexchange,
    bundler,
    kapture,
    meshroom,
    nvm,
    openmvg,
    pix4d,
    realitycapture_xmp,
)
from tests.data.test_research_formats import middlebury, neus
from tests.fuzzing import LONG, QUICK, Change, byte_changes, fuzz, value_changes

# What is read: a scene of every format, and the file of it that is changed.


def nerfstudio(root: Path) -> Path:
    (BallCapture(views=4).write_blender(root) / "transforms_train.json").rename(root / "transforms.json")
    trimesh.PointCloud(np.eye(3), colors=[[1, 2, 3, 255]] * 3).export(root / "p.ply")
    content = json.loads((root / "transforms.json").read_text())
    content |= {"applied_transform": np.eye(4)[:3].tolist(), "applied_scale": 2.0, "ply_file_path": "p.ply", "k1": 0.1}
    content |= {"train_filenames": [], "test_filenames": ["train/r_1.png"], "camera_model": "OPENCV"}
    (root / "transforms.json").write_text(json.dumps(content))
    return root


def points_with_colors(root: Path, kind: str, rows: tuple[str, ...]) -> Path:
    """Write the same scene with points as text, whose colours are numbers of a kind that PLY names."""
    axes = "".join(f"property double {name}\n" for name in "xyz")
    colors = "".join(f"property {kind} {name}\n" for name in ("red", "green", "blue"))
    head = f"ply\nformat ascii 1.0\nelement vertex {len(rows)}\n{axes}{colors}end_header\n"
    (nerfstudio(root) / "p.ply").write_text(head + "".join(f"0.1 0.2 0.3 {row}\n" for row in rows))
    return root


def colmap(root: Path, text: bool) -> Path:
    pycolmap = pytest.importorskip("pycolmap")
    model = pycolmap.Reconstruction()
    camera = pycolmap.Camera.create_from_model_name(1, "OPENCV", 100.0, 64, 64)
    model.add_camera_with_trivial_rig(camera)
    (root / "images").mkdir()
    for i, pose in enumerate(BallCapture(views=4).poses(), start=1):
        model.add_image_with_trivial_frame(
            pycolmap.Image(name=f"{i}.png", camera_id=1, image_id=i), pycolmap.Rigid3d(pose[:3])
        )
    model.add_point3D(np.ones(3), pycolmap.Track(), np.zeros(3, np.uint8))
    (root / "sparse/0").mkdir(parents=True)
    (model.write_text if text else model.write_binary)(str(root / "sparse/0"))
    return root


@dataclass(frozen=True)
class Target:
    make: Callable[[Path], Path]
    file: str


ROW = "a.jpg,1,2,10,0,0,0,18,0,0,0.1,0,0,0,0,0"
TARGETS = {
    "plain": Target(lambda root: BallCapture(views=4).write_plain(root), "cameras.json"),
    "blender": Target(lambda root: BallCapture(views=4).write_blender(root), "transforms_train.json"),
    "nerfstudio": Target(nerfstudio, "transforms.json"),
    "nerfstudio_points": Target(nerfstudio, "p.ply"),
    "nerfstudio_float_colors": Target(
        lambda root: points_with_colors(root, "float", ("0 0.5 1", "1 0.25 0", "nan 0 0")), "p.ply"
    ),
    "nerfstudio_16_bit_colors": Target(
        lambda root: points_with_colors(root, "ushort", ("0 256 65535", "9 9 9")), "p.ply"
    ),
    "middlebury": Target(middlebury, "v_par.txt"),
    "neus": Target(neus, "cameras_sphere.npz"),
    "polycam": Target(polycam, "keyframes/cameras/101.json"),
    "opensfm": Target(opensfm, "reconstruction.json"),
    "metashape": Target(metashape, "cameras.xml"),
    "realitycapture": Target(lambda root: realitycapture(root, ROW, first="#cameras 1"), "export.csv"),
    "bundler": Target(bundler, "bundle.out"),
    "bundler_list": Target(bundler, "list.txt"),
    "nvm": Target(nvm, "scene.nvm"),
    "openmvg": Target(openmvg, "sfm_data.json"),
    "meshroom": Target(meshroom, "cameras.sfm"),
    "blocksexchange": Target(blocksexchange, "block.xml"),
    "realitycapture_xmp": Target(realitycapture_xmp, "000.xmp"),
    "pix4d": Target(pix4d, "site_calibrated_camera_parameters.txt"),
    "record3d": Target(record3d, "metadata.json"),
    "mvsnet": Target(mvsnet, "cams/00000001_cam.txt"),
    "llff": Target(llff, "poses_bounds.npy"),
    "gaussians": Target(gaussians, "cameras.json"),
    "nero": Target(nero, "1-camera.pkl"),
    "nsvf": Target(nsvf, "pose/0_0000.txt"),
    "nsvf_intrinsics": Target(nsvf, "intrinsics.txt"),
    "scannet": Target(scannet, "pose/1.txt"),
    "scannet_intrinsics": Target(scannet, "intrinsic/intrinsic_color.txt"),
    "tanks": Target(tanks, "Ball_COLMAP_SfM.log"),
    "tanks_intrinsics": Target(tanks, "intrinsics.txt"),
    **{
        f"kapture_{stem}": Target(kapture, f"sensors/{stem}.txt")
        for stem in ("sensors", "records_camera", "trajectories", "rigs")
    },
    "kapture_points": Target(kapture, "reconstruction/points3d.txt"),
    **{
        f"colmap_{stem}_{suffix}": Target(partial(colmap, text=suffix == "txt"), f"sparse/0/{stem}.{suffix}")
        for stem in ("cameras", "images", "points3D")
        for suffix in ("bin", "txt")
    },
}
JSON_TARGETS = [name for name, target in TARGETS.items() if target.file.endswith((".json", ".sfm"))]


def read(root: Path) -> None:
    for kind in all_formats():
        if kind.recognises(root):
            folder = SceneFolder.at(root)
            usable_photos(kind.read(folder), folder)
            return


def fuzz_reader(root: Path, name: str, changes: st.SearchStrategy[Change], how: settings) -> None:
    path = TARGETS[name].make(root) / TARGETS[name].file
    fuzz(path, lambda: read(root), SceneError, changes, how)


@pytest.mark.parametrize("name", TARGETS)
def test_damaged_bytes(tmp_path: Path, name: str) -> None:
    fuzz_reader(tmp_path, name, byte_changes(), QUICK)


@pytest.mark.parametrize("name", JSON_TARGETS)
def test_senseless_values(tmp_path: Path, name: str) -> None:
    fuzz_reader(tmp_path, name, value_changes(), QUICK)


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("name", TARGETS)
def test_damaged_bytes_for_long(tmp_path: Path, name: str) -> None:
    fuzz_reader(tmp_path, name, byte_changes(), LONG)


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("name", JSON_TARGETS)
def test_senseless_values_for_long(tmp_path: Path, name: str) -> None:
    fuzz_reader(tmp_path, name, value_changes(), LONG)


# What the long run found


def test_messages_do_not_repeat_a_long_name_of_a_camera_model(tmp_path: Path) -> None:
    sensors = kapture(tmp_path) / "sensors/sensors.txt"
    sensors.write_text(sensors.read_text().replace("OPENCV", "A" * 5000))
    with pytest.raises(SceneError, match=r"camera model A+ is not supported") as caught:
        read(tmp_path)
    assert len(str(caught.value)) < 1000


# Archives and images

ARCHIVES = ("a.zip", "a.tar", "a.tar.gz", "a.tar.zst")


def fuzz_archive(root: Path, name: str, how: settings) -> None:
    folder = BallCapture(views=2).write_plain(root / "scene")
    files = [path for path in sorted(folder.rglob("*")) if path.is_file()]
    path = root / name
    if name.endswith(".zip"):
        zipped(path, folder)
    else:
        tarred(path, *[(str(file.relative_to(folder)), file.read_bytes()) for file in files])

    def unpack() -> None:
        try:
            archive.unpack(path, root / "out")
        except SceneError:
            assert not (root / "out").exists(), "nothing is left behind"
            raise
        finally:
            shutil.rmtree(root / "out", ignore_errors=True)

    fuzz(path, unpack, SceneError, byte_changes(), how)


@pytest.mark.parametrize("name", ARCHIVES)
def test_damaged_archives(tmp_path: Path, name: str) -> None:
    fuzz_archive(tmp_path, name, QUICK)


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("name", ARCHIVES)
def test_damaged_archives_for_long(tmp_path: Path, name: str) -> None:
    fuzz_archive(tmp_path, name, LONG)


def write_image(path: Path, pixels: np.ndarray) -> None:
    import OpenImageIO
    import pillow_heif

    if path.suffix == ".heic":
        pillow_heif.from_pillow(Image.fromarray(pixels)).save(path)
    elif path.suffix == ".exr":
        output = OpenImageIO.ImageOutput.create(str(path))
        assert output is not None
        assert output.open(str(path), OpenImageIO.ImageSpec(pixels.shape[1], pixels.shape[0], 3, "half"))
        assert output.write_image(pixels / np.float32(255)) and output.close()
    else:
        Image.fromarray(pixels).save(path)


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("name", ["a.png", "a.jpg", "a.tif", "a.webp", "a.bmp", "a.heic", "a.exr"])
def test_damaged_images_for_long(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    write_image(path, np.random.default_rng(0).integers(0, 256, (24, 32, 3), dtype=np.uint8))

    def read() -> None:
        colors = read_picture(path, "test").colors
        assert colors.dtype == np.uint8 and colors.ndim == 3 and colors.shape[2] == 3

    fuzz(path, read, SceneError, byte_changes(), LONG)
