"""Small captures of kinds that people report, each held to what is right for it (the measurement data's `cases`)."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from mgsr.config import DataConfig, Flawed, Masks
from mgsr.data.pointclouds import read_points
from mgsr.data.readers import load_scene
from mgsr.data.scene import Scene
from mgsr.errors import SceneError
from mgsr.pipeline.run_metadata import scene_facts
from tests.optional import present

POINTS = np.random.default_rng(0).uniform(-0.7, 0.7, (50, 3))
# COLMAP's model of the twelve views that many cases have in other forms.
TWELVE = "03_model_elsewhere/dense_0/dense/0/sparse"


@dataclass(frozen=True)
class Case:
    """What a folder must give: its format, how many photographs, and the notes, one pattern for each.

    model: COLMAP's model of its cameras, which pycolmap reads as the witness.
    """

    path: str
    format: str
    photographs: int
    notes: tuple[str, ...] = ()
    model: str | None = TWELVE
    masked: bool = False


ELSEWHERE = r"12 of 12 photographs are in other folders than .* says; .* is read from .*"
LOST = r"1 of 12 photographs skipped: .*image r_00\d\.jpg: "
CASES = [
    Case("01_ignore_masks", "nerfstudio", 24, (r"the masks mark areas to ignore, 4\.\d% of",), None),
    Case(
        "02_other_extension_colmap",
        "colmap",
        12,
        (r"12 of 12 photographs have other extensions than .*; images/IMG_0000\.png is read for IMG_0000\.JPG",),
        "02_other_extension_colmap/sparse/0",
        masked=True,
    ),
    Case("03_model_elsewhere/dense_0", "colmap", 12),
    Case("03_model_elsewhere/eth3d", "colmap", 12),
    Case("03_model_elsewhere/images_4_only", "colmap", 12, (ELSEWHERE, "the photographs are read from images_4; the")),
    Case("03_model_elsewhere/ngp_colmap_sparse", "colmap", 12),
    Case("03_model_elsewhere/ngp_paths", "nerfstudio", 12, (ELSEWHERE,)),
    Case("04_unread_formats/blendedmvs", "mvsnet", 12),
    Case("04_unread_formats/bundler", "bundler", 12),
    Case("04_unread_formats/meshroom", "meshroom", 12, (ELSEWHERE,)),
    Case("04_unread_formats/nero_glossy", "nero", 12),
    Case("04_unread_formats/openmvg", "openmvg", 12),
    Case("04_unread_formats/record3d", "record3d", 12),
    Case("05_one_bad_camera/msvc_nan_camera", "colmap", 11, (LOST + "the camera has NaN",)),
    Case("05_one_bad_camera/nan_camera", "colmap", 11, (LOST + "the camera has NaN",)),
    Case("05_one_bad_camera/nan_pose", "colmap", 11, (LOST + r"the pose has the invalid quaternion \[nan",)),
    Case("06_poses/rows3", "nerfstudio", 12),
    Case("06_poses/scaled", "nerfstudio", 12, (r"12 of 12 photographs with a scale in the pose \(0\.01\)",)),
    Case(
        "07_principal_point_outside",
        "nerfstudio",
        24,
        ("24 of 24 photographs treated as crops of larger ones",),
        None,
        masked=True,
    ),
    Case("09_ply_colours", "nerfstudio", 12),
    Case("10_metashape_groups", "metashape", 12),
    Case(
        "11_far_origin_splats",
        "nerfstudio",
        24,
        (r"the frame's origin lies [\d,]+ units away, so splat files have positions relative to",),
        None,
        masked=True,
    ),
    Case(
        "11b_far_origin_metashape",
        "metashape",
        24,
        (r"the frame's origin lies [\d,]+ units away, so splat files have positions relative to",),
        None,
        masked=True,
    ),
    Case("12_four_views", "nerfstudio", 4, ("too few photographs: .* the surface is a guess",), None),
    Case("13_blurred_frames", "nerfstudio", 36, ("24 of 36 photographs are much less sharp than",), None),
]


@pytest.fixture
def cases(shared_data: Path) -> Path:
    return shared_data / "cases"


@pytest.mark.parametrize("case", CASES, ids=[case.path for case in CASES])
def test_cases(cases: Path, case: Case) -> None:
    scene = load_scene(cases / case.path, DataConfig())
    assert (scene.format, scene.masked) == (case.format, case.masked)
    assert len(scene.train) + len(scene.test) == case.photographs
    notes = scene_facts(scene).notes or []
    assert len(notes) == len(case.notes), notes
    for note, pattern in zip(notes, case.notes, strict=True):
        assert re.match(pattern, note), note
    if case.model is not None:
        check_cameras(scene, cases / case.model)


def check_cameras(scene: Scene, model: Path) -> None:
    """Check that every view projects points where pycolmap's camera of the same number does."""
    pycolmap = pytest.importorskip("pycolmap")
    reconstruction = pycolmap.Reconstruction(str(model))
    images = {int(present(re.search(r"(\d+)\.\w+$", image.name))[1]): image for image in reconstruction.images.values()}
    for place, view in enumerate(sorted(scene.train + scene.test, key=lambda view: view.name)):
        number = int(present(re.search(r"(\d+)$", view.name))[1])
        image = images[place if view.name.startswith("cam") else number]
        camera = reconstruction.cameras[image.camera_id]
        expected = camera.img_from_cam(image.cam_from_world() * POINTS) * (view.camera.width / camera.width)
        pixels, depth = view.camera.project(scene.user_from_scene.to_scene(POINTS))
        assert (depth > 0).all()
        np.testing.assert_allclose(pixels, expected, atol=0.01, err_msg=view.name)


def test_a_3dgs_output_lacks_its_photographs(cases: Path) -> None:
    with pytest.raises(
        SceneError, match="this file has the cameras of 3D Gaussian Splatting, but its 12 photographs are not in"
    ):
        load_scene(cases / "04_unread_formats/3dgs_output", DataConfig())


def test_masks_that_mean_ignore_change_no_frame(cases: Path) -> None:
    """Check that the black parts of the masks are unknown, and that the scene's ball is as without masks."""
    root = cases / "01_ignore_masks"
    ignored, off = (load_scene(root, DataConfig(masks=masks)) for masks in (Masks.IGNORE, Masks.OFF))
    assert ignored.user_from_scene.scale == pytest.approx(off.user_from_scene.scale, rel=0.02)
    masks = {path.stem: path for path in (root / "masks").iterdir()}
    from PIL import Image

    for view in ignored.train:
        black = np.asarray(Image.open(masks[view.name]).convert("L")) < 128
        known = np.ones_like(black) if view.valid_mask is None else view.valid_mask
        assert not known[black].any() and (known | black).mean() > 0.97


@pytest.mark.parametrize("name", ["float", "diffuse", "ushort"])
def test_colours_of_point_clouds(cases: Path, name: str) -> None:
    """Check the colours against plyfile's: 0 to 1, bytes, and 0 to 65535."""
    from plyfile import PlyData

    path = cases / "09_ply_colours" / f"{name}.ply"
    vertex = PlyData.read(str(path))["vertex"]
    prefix, largest = {"float": ("", 1), "diffuse": ("diffuse_", 255), "ushort": ("", 65535)}[name]
    expected = np.stack([vertex[prefix + channel] for channel in ("red", "green", "blue")], axis=1) * (255 / largest)
    np.testing.assert_allclose(read_points(path).colors, expected, atol=0.51)


def test_a_point_cloud_that_is_missing_is_told_of(cases: Path, tmp_path: Path) -> None:
    root = shutil.copytree(cases / "09_ply_colours", tmp_path / "scene")
    content = json.loads((root / "transforms.json").read_text())
    content["ply_file_path"] = "gone.ply"
    (root / "transforms.json").write_text(json.dumps(content))
    assert "the points gone.ply named by transforms.json are missing; the run starts without them" in (
        load_scene(root, DataConfig()).notes
    )


def test_blurred_frames_are_left_out_where_that_is_asked_for(cases: Path) -> None:
    scene = load_scene(cases / "13_blurred_frames", DataConfig(flawed=Flawed.DROP))
    assert sorted(view.name for view in scene.train + scene.test) == [f"{i:03d}" for i in range(0, 36, 3)]
