"""Cameras of photogrammetry programs, held to their documented equations, which are written out here.

Other forms of the same cameras are compared too.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import numpy as np
import pytest
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from mgsr.data.capture import Capture
from mgsr.data.formats import all_formats
from mgsr.data.lens import InverseRadialLens
from mgsr.data.photo_files import SceneFolder
from mgsr.data.usable import usable_photos
from mgsr.errors import MissingPhotoError, SceneError
from tests.data.captures import BallCapture
from tests.data.reading import draw, project, read_capture

WIDTH, HEIGHT = 64, 48
F = 70.0
POSES = BallCapture(views=4).poses()
ROTATIONS = [pose[:3, :3] for pose in POSES]
CENTERS = [-pose[:3, :3].T @ pose[:3, 3] for pose in POSES]
NAMES = [f"images/{i:03d}.jpg" for i in range(4)]
POINTS = np.random.default_rng(3).uniform(-0.7, 0.7, (20, 3))
OPENGL = np.diag([1.0, -1, -1])

Edit = Callable[[str], str]


def same(text: str) -> str:
    return text


def draw_all(root: Path, names: list[str] = NAMES, width: int = WIDTH, height: int = HEIGHT) -> None:
    for name in names:
        draw(root / name, width, height)


def words(*values: ArrayLike) -> str:
    return " ".join(repr(float(x)) for value in values for x in np.ravel(value))


def local(i: int, points: np.ndarray = POINTS) -> np.ndarray:
    """Return world points in the axes of camera i: x right, y down, z forward."""
    in_camera: np.ndarray = points @ ROTATIONS[i].T + POSES[i][:3, 3]
    return in_camera


def agree(capture: Capture, pixels: Callable[[int], np.ndarray], points: np.ndarray = POINTS) -> None:
    """Check that every photograph projects the points to the pixels expected of it."""
    assert len(capture.photos) == 4 and not capture.lost
    for i, photo in enumerate(capture.photos):
        assert photo.image.name == f"{i:03d}.jpg" and photo.size == (WIDTH, HEIGHT)
        np.testing.assert_allclose(project(photo, points), pixels(i), atol=1e-7)


def brown(xy: np.ndarray, k: tuple[float, ...], wide: float = 0.0, tall: float = 0.0) -> np.ndarray:
    """Return Brown's distortion. wide: the factor of r^2 + 2 x^2 in x; tall: that of r^2 + 2 y^2 in y."""
    x, y = xy.T
    r2 = x * x + y * y
    radial = 1 + sum(term * r2 ** (i + 1) for i, term in enumerate(k))
    return np.stack(
        [
            x * radial + wide * (r2 + 2 * x * x) + 2 * tall * x * y,
            y * radial + tall * (r2 + 2 * y * y) + 2 * wide * x * y,
        ],
        axis=1,
    )


def fails(root: Path, name: str, *parts: str) -> None:
    """Check that reading raises an error that has all these parts."""
    with pytest.raises(SceneError) as caught:
        usable_photos(read_capture(root, name), SceneFolder.at(root))
    for part in parts:
        assert part in str(caught.value)


def loses(root: Path, name: str, *parts: str) -> None:
    """Check that one photograph alone is lost, with an error that has all these parts."""
    capture = read_capture(root, name)
    assert len(capture.photos) == 3 and len(capture.lost) == 1
    for part in parts:
        assert part in str(capture.lost[0])


# The same scene as three programs and the MVSNet form have it


@pytest.mark.parametrize("name", ["bundler", "openmvg", "meshroom"])
def test_three_forms_of_one_scene_have_the_cameras_of_its_fourth(shared_data: Path, name: str) -> None:
    cases = shared_data / "cases" / "04_unread_formats"
    capture = read_capture(cases / name, name)
    assert len(capture.photos) == 12 and not capture.lost
    for i, photo in enumerate(sorted(capture.photos, key=lambda photo: photo.image)):
        content = (cases / f"blendedmvs/cams/{i:08d}_cam.txt").read_text().split()
        np.testing.assert_allclose(photo.cam_from_world, np.array(content[1:17], float).reshape(4, 4), atol=1e-7)
        np.testing.assert_allclose(photo.K, np.array(content[18:27], float).reshape(3, 3), atol=1e-4)
        assert photo.image.stem == f"{i:03d}" and photo.size == (128, 128) and photo.lens is None


def test_other_programs_folders_are_left_to_them(shared_data: Path) -> None:
    new = ("bundler", "nvm", "openmvg", "meshroom", "blocksexchange", "realitycapture_xmp", "kapture", "pix4d")
    kinds = [kind for kind in all_formats() if kind.name in new]
    assert len(kinds) == len(new)
    for folder in sorted(path for path in shared_data.rglob("*") if path.is_dir()):
        for kind in kinds:
            assert not kind.recognises(folder) or folder.name == kind.name, f"{folder} is no {kind.name}"


# Bundler


def bundler(root: Path, k1: float = 0.2, k2: float = -0.1, edit: Edit = same, edit_list: Edit = same) -> Path:
    lines = ["# Bundle file v0.3", "4 2"]
    for pose in POSES:
        rotation, translation = OPENGL @ pose[:3, :3], OPENGL @ pose[:3, 3]
        lines += [f"{F} {k1} {k2}", *[words(row) for row in rotation], words(translation)]
    lines += ["0.5 1.5 -2.5", "10 20 30", "2 0 5 1.5 -2.5 1 7 3 4", "1e3 0 0", "255 0 7", "0"]
    (root / "bundle.out").write_text(edit("\n".join(lines) + "\n"), newline="")
    (root / "list.txt").write_text(edit_list("".join(f"{name} 0 {F}\n" for name in NAMES)), newline="")
    draw_all(root)
    return root


def bundler_pixels(i: int, k1: float = 0.2, k2: float = -0.1) -> np.ndarray:
    """Return pixels by Bundler's equations: P = R X + t; p = -P / P.z; p' = f r(p) p, from the middle, with y up."""
    P = local(i) @ OPENGL
    p = -P[:, :2] / P[:, 2:]
    r2 = (p**2).sum(axis=1, keepdims=True)
    p = F * (1 + k1 * r2 + k2 * r2**2) * p
    return np.stack([WIDTH / 2 + p[:, 0], HEIGHT / 2 - p[:, 1]], axis=1)


def test_bundler_projects_as_its_manual_says(tmp_path: Path) -> None:
    capture = read_capture(bundler(tmp_path), "bundler")
    agree(capture, bundler_pixels)
    assert capture.points is not None and not capture.notes
    assert capture.points.positions.tolist() == [[0.5, 1.5, -2.5], [1000, 0, 0]]
    assert capture.points.colors.tolist() == [[10, 20, 30], [255, 0, 7]]


@pytest.mark.parametrize(
    "edit",
    [lambda text: text.replace("\n", "\r\n"), lambda text: "\ufeff" + text, lambda text: text.replace("\n", " \n\n")],
)
def test_bundler_files_of_other_systems(tmp_path: Path, edit: Callable[..., Any]) -> None:
    agree(read_capture(bundler(tmp_path, edit=edit, edit_list=edit), "bundler"), bundler_pixels)


def test_bundler_lists_with_names_alone_and_with_blanks_in_them(tmp_path: Path) -> None:
    bundler(tmp_path, edit_list=lambda _: "".join(f"./my photos/{i:03d}.jpg{' 0 70.5' * (i % 2)}\n" for i in range(4)))
    (tmp_path / "images").rename(tmp_path / "my photos")
    agree(read_capture(tmp_path, "bundler"), bundler_pixels)


@pytest.mark.parametrize(
    ("bundle", "listed"),
    [
        ("bundle.rd.out", "list.rd.txt"),
        ("model.bundle.out", "model.list.txt"),
        ("bundle/bundle.out", "list.txt"),
        ("scene.out", "my images.lst"),
    ],
)
def test_bundler_files_by_the_names_that_programs_give(tmp_path: Path, bundle: str, listed: str) -> None:
    bundler(tmp_path)
    (tmp_path / "bundle").mkdir()
    (tmp_path / "bundle.out").rename(tmp_path / bundle)
    (tmp_path / "list.txt").rename(tmp_path / listed)
    (tmp_path / "notes.txt").write_text("one\ntwo\nthree\nfour\n")
    agree(read_capture(tmp_path, "bundler"), bundler_pixels)


def test_a_camera_that_bundler_did_not_place_is_lost_alone(tmp_path: Path) -> None:
    bundler(tmp_path, edit=lambda text: text.replace(f"{F} 0.2", "0 0.2", 1))
    loses(tmp_path, "bundler", "bundle.out, camera 0 (images/000.jpg)", "it has no pose")


def test_a_camera_with_no_number_is_lost_alone(tmp_path: Path) -> None:
    bundler(tmp_path, edit=lambda text: text.replace(f"{F} 0.2", "-nan(ind) 0.2", 1))
    loses(tmp_path, "bundler", "bundle.out, camera 0", "expected 15 numbers")


def test_damaged_bundler_files_are_named(tmp_path: Path) -> None:
    bundler(tmp_path)
    whole = (tmp_path / "bundle.out").read_text()
    for text, reason in [
        (whole[:200], "truncated"),
        (whole.replace("4 2", "4 -2"), "expected a count"),
        (whole.replace("v0.3", "v0.4"), "version v0.4"),
    ]:
        (tmp_path / "bundle.out").write_text(text)
        fails(tmp_path, "bundler", "bundle.out", reason, "export")
    (tmp_path / "bundle.out").write_text(whole)
    (tmp_path / "list.txt").write_text("a.jpg\n")
    fails(tmp_path, "bundler", "list.txt: the list names 1 photographs, but bundle.out has 4 cameras")
    (tmp_path / "list.txt").unlink()
    fails(tmp_path, "bundler", "bundle.out: expected one list of its 4 photographs, found 0", "add list.txt beside it")


# VisualSFM


def quaternion(rotation: np.ndarray) -> np.ndarray:
    wxyz: np.ndarray = Rotation.from_matrix(rotation).as_quat()[[3, 0, 1, 2]]
    return wxyz


def nvm(root: Path, r: float = 0.3, header: str = "NVM_V3 ", edit: Edit = same) -> Path:
    lines = [header, "", "4  "]
    for name, rotation, center in zip(NAMES, ROTATIONS, CENTERS, strict=True):
        lines.append(f"{name}\t{F} {words(quaternion(rotation), center)} {r} 0 ")
    lines += [
        "",
        "2",
        "0.5 1.5 -2.5 10 20 30 1 0 5 1.5 -2.5 ",
        "-nan(ind) 0 0 255 0 7 0",
        "",
        "",
        "0",
        "",
        "#the last part",
    ]
    lines += ["0"]
    (root / "scene.nvm").write_text(edit("\n".join(lines) + "\n"), newline="")
    draw_all(root)
    return root


def undistorted(pixels: np.ndarray, r: float, f: float = F) -> np.ndarray:
    """Return what multicore bundle adjustment makes of a measurement, in pixels from the principal point."""
    measured = pixels - [WIDTH / 2, HEIGHT / 2]
    straight: np.ndarray = measured * (1 + r / f**2 * (measured**2).sum(axis=1, keepdims=True))
    return straight


@pytest.mark.parametrize("r", [0.3, -0.2, 0.0, 1e-12])
def test_visualsfm_measures_as_its_bundle_adjustment_says(tmp_path: Path, r: float) -> None:
    capture = read_capture(nvm(tmp_path, r), "nvm")
    assert len(capture.photos) == 4 and not capture.lost and not capture.notes
    for i, photo in enumerate(capture.photos):
        rays = local(i)
        np.testing.assert_allclose(
            undistorted(project(photo, POINTS), r), F * rays[:, :2] / rays[:, 2:], atol=1e-8, err_msg=photo.source
        )
    assert capture.points is not None
    assert capture.points.positions.tolist() == [[0.5, 1.5, -2.5]] and capture.points.colors.tolist() == [[10, 20, 30]]


def test_rays_that_the_measured_lens_cannot_show_are_nan() -> None:
    edge = 2 / 3 / np.sqrt(3 * 0.2)  # the largest undistorted radius of d (1 - 0.2 d^2)
    x, _ = InverseRadialLens(-0.2).distort(np.array([edge - 1e-6, edge + 1e-6]), np.zeros(2))
    assert np.isfinite(x).tolist() == [True, False]


def plain_pixels(i: int, fx: float = F, fy: float = F, cx: float = WIDTH / 2, cy: float = HEIGHT / 2) -> np.ndarray:
    rays = local(i)
    projected: np.ndarray = rays[:, :2] / rays[:, 2:] * [fx, fy] + [cx, cy]
    return projected


@pytest.mark.parametrize("edit", [lambda text: text.replace("\n", "\r\n"), lambda text: "\ufeff" + text])
def test_nvm_files_of_other_systems(tmp_path: Path, edit: Callable[..., Any]) -> None:
    agree(read_capture(nvm(tmp_path, 0.0, edit=edit), "nvm"), plain_pixels)


@pytest.mark.parametrize("blank", ['"', " "])
def test_nvm_names_with_blanks(tmp_path: Path, blank: str) -> None:
    nvm(tmp_path, 0.0, edit=lambda text: text.replace("images/", f"C:\\my{blank}photos\\"))
    (tmp_path / "images").rename(tmp_path / "my photos")
    agree(read_capture(tmp_path, "nvm"), plain_pixels)


@pytest.mark.parametrize("header", ["NVM_V3 FixedK 80 31 90 23", "NVM_V3\nFixedK 80 31 90 23"])
def test_a_fixed_calibration_holds_for_all_photographs(tmp_path: Path, header: str) -> None:
    capture = read_capture(nvm(tmp_path, 0.0, header), "nvm")
    agree(capture, lambda i: plain_pixels(i, 80, 90, 31, 23))


def test_nvm_with_matrices_and_translations(tmp_path: Path) -> None:
    nvm(tmp_path)
    rows = [f"{name} {F} {words(pose[:3, :3], pose[:3, 3])} 0 0" for name, pose in zip(NAMES, POSES, strict=True)]
    (tmp_path / "scene.nvm").write_text("\n".join(["NVM_V3_R9T", "4", *rows]))
    agree(read_capture(tmp_path, "nvm"), plain_pixels)


def test_the_largest_model_of_an_nvm_is_used(tmp_path: Path) -> None:
    small = "1\nimages/000.jpg 50 1 0 0 0 1 2 3 0 0\n0\n\n"
    nvm(tmp_path, 0.0, edit=lambda text: text.replace("4  \n", small + "4  \n"))
    capture = read_capture(tmp_path, "nvm")
    agree(capture, plain_pixels)
    assert capture.notes == ("the largest model of scene.nvm with 4 photographs is used; the others have 1",)


def test_one_bad_camera_of_an_nvm_is_lost_alone(tmp_path: Path) -> None:
    nvm(tmp_path, edit=lambda text: text.replace(f"{F} ", "1.#QNAN ", 1))
    loses(tmp_path, "nvm", "scene.nvm, images/000.jpg", "expected 10 numbers")
    nvm(tmp_path, edit=lambda text: text.replace(words(quaternion(ROTATIONS[0])), "0 0 0 0"))
    loses(tmp_path, "nvm", "scene.nvm, images/000.jpg", "quaternion")


def test_damaged_nvm_files_are_named(tmp_path: Path) -> None:
    nvm(tmp_path)
    whole = (tmp_path / "scene.nvm").read_text()
    for text, reason in [
        (whole[:150], "expected a photograph's name and 10 numbers"),
        (whole[: whole.index("images/002")], "truncated"),
        (whole.replace("4  ", "four"), "four"),
        ("NVM_V3\n0\n", "no photographs"),
        ("NVM_V3\n", "no photographs"),
    ]:
        (tmp_path / "scene.nvm").write_text(text)
        fails(tmp_path, "nvm", "scene.nvm", reason, "save it again")


# OpenMVG

OPENMVG_LENSES: dict[str, tuple[dict[str, list[float]], Callable[[np.ndarray], np.ndarray]]] = {
    "pinhole": ({}, lambda xy: xy),
    "pinhole_radial_k1": ({"disto_k1": [0.1]}, lambda xy: brown(xy, (0.1,))),
    "pinhole_radial_k3": ({"disto_k3": [0.1, -0.05, 0.02]}, lambda xy: brown(xy, (0.1, -0.05, 0.02))),
    "pinhole_brown_t2": (
        {"disto_t2": [0.1, -0.05, 0.02, 0.01, -0.02]},
        lambda xy: brown(xy, (0.1, -0.05, 0.02), -0.02, 0.01),
    ),
    "fisheye": ({"fisheye": [0.1, -0.05, 0.02, -0.01]}, lambda xy: fisheye(xy, (0.1, -0.05, 0.02, -0.01))),
}


def fisheye(xy: np.ndarray, k: tuple[float, ...]) -> np.ndarray:
    """Return rays whose angle t becomes t (1 + k1 t^2 + k2 t^4 + ...)."""
    r = np.linalg.norm(xy, axis=1, keepdims=True)
    t = np.arctan(r)
    distorted: np.ndarray = xy / r * t * (1 + sum(term * t ** (2 * i + 2) for i, term in enumerate(k)))
    return distorted


def openmvg(root: Path, model: str = "pinhole_brown_t2", nested: bool = False, absolute: bool = False) -> Path:
    """Write four photographs: 0 and 1 have an intrinsic each, which cereal writes as one object; 2 and 3 share one."""
    base = {"width": WIDTH, "height": HEIGHT, "focal_length": F, "principal_point": [31.0, 23.5]}
    terms = OPENMVG_LENSES[model][0]
    data = {"value0": base, **terms} if nested else {**base, **terms}
    first = 0x80000000
    views = [
        {"local_path": "", "filename": f"{i:03d}.jpg", "width": WIDTH, "height": HEIGHT, "id_view": i}
        | {"id_intrinsic": min(i, 2), "id_pose": 10 + i}
        for i in range(4)
    ]
    kinds: list[dict[str, Any]] = [
        {"polymorphic_id": first + 1, "polymorphic_name": model},
        {"polymorphic_id": 1},
        {"polymorphic_id": 1},
    ]
    pointers = [{"id": first + 9, "data": data}, {"id": 9}, {"id": first + 10, "data": data}]
    content = {
        "sfm_data_version": "0.3",
        "root_path": "C:\\Users\\me\\images" if absolute else "images",
        "views": [
            {"key": i, "value": {"polymorphic_id": 0x40000000, "ptr_wrapper": {"id": first + 1 + i, "data": view}}}
            for i, view in enumerate(views)
        ],
        "intrinsics": [{"key": i, "value": {**kinds[i], "ptr_wrapper": pointers[i]}} for i in range(3)],
        "extrinsics": [
            {"key": 10 + i, "value": {"rotation": ROTATIONS[i].tolist(), "center": CENTERS[i].tolist()}}
            for i in range(4)
        ],
        "structure": [
            {"key": 5, "value": {"X": [0.5, 1.5, -2.5], "observations": []}},
            {"key": 6, "value": {"X": [1, 2]}},
        ],
        "control_points": [],
    }
    (root / "sfm_data.json").write_text(json.dumps(content))
    draw_all(root)
    return root


@pytest.mark.parametrize("model", OPENMVG_LENSES)
@pytest.mark.parametrize("nested", [False, True])
def test_openmvg_projects_as_its_headers_say(tmp_path: Path, model: str, nested: bool) -> None:
    def pixels(i: int) -> np.ndarray:
        rays = local(i)
        distorted: np.ndarray = F * OPENMVG_LENSES[model][1](rays[:, :2] / rays[:, 2:]) + [31, 23.5]
        return distorted

    capture = read_capture(openmvg(tmp_path, model, nested), "openmvg")
    agree(capture, pixels)
    assert capture.points is not None and not capture.notes
    assert capture.points.positions.tolist() == [[0.5, 1.5, -2.5]]


def test_openmvg_paths_of_another_machine(tmp_path: Path) -> None:
    assert len(read_capture(openmvg(tmp_path, absolute=True), "openmvg").photos) == 4


def edit_json(path: Path, change: Callable[[dict[str, Any]], object]) -> None:
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def test_openmvg_views_that_cannot_be_used_are_lost_alone(tmp_path: Path) -> None:
    def lose(change: Callable[[dict[str, Any]], object], *parts: str) -> None:
        edit_json(openmvg(tmp_path) / "sfm_data.json", change)
        loses(tmp_path, "openmvg", "sfm_data.json, view images/000.jpg", *parts)

    lose(lambda content: content["extrinsics"].pop(0), "no pose")
    lose(
        lambda content: content["views"][0]["value"]["ptr_wrapper"]["data"].update(id_intrinsic=4294967295),
        "intrinsics",
    )
    lose(lambda content: content["extrinsics"][0]["value"].update(center=[1, 2]), "center: expected 3 numbers")
    lose(lambda content: content["extrinsics"][0]["value"].update(rotation=5), "rotation: expected 3 rows")


@pytest.mark.parametrize(
    ("model", "cure"), [("spherical", "panorama"), ("pinhole_radial_k1_pba", "ExportUndistortedImages")]
)
def test_openmvg_models_that_are_not_read_are_refused_with_a_cure(tmp_path: Path, model: str, cure: str) -> None:
    edit_json(
        openmvg(tmp_path) / "sfm_data.json",
        lambda content: content["intrinsics"][0]["value"].update(polymorphic_name=model),
    )
    fails(tmp_path, "openmvg", "sfm_data.json, view images/000.jpg", model, cure)


def test_openmvg_without_poses_is_no_scene(tmp_path: Path) -> None:
    edit_json(openmvg(tmp_path) / "sfm_data.json", lambda content: content.update(extrinsics=[]))
    assert not [kind for kind in all_formats() if kind.recognises(tmp_path)]


@pytest.mark.parametrize("part", ["views", "intrinsics", "extrinsics", "structure"])
def test_damaged_openmvg_files_are_named(tmp_path: Path, part: str) -> None:
    path = openmvg(tmp_path) / "sfm_data.json"
    edit_json(path, lambda content: content.update({part: [{"key": 1}, *content[part]] if part != "views" else 7}))
    if part != "extrinsics":  # its first entry is what the format is recognised by
        fails(tmp_path, "openmvg", f"sfm_data.json: {part}: expected a list of objects")
    path.write_text(path.read_text()[:-20])
    fails(tmp_path, "openmvg", "sfm_data.json: not valid JSON")


# Meshroom


def texts(values: ArrayLike) -> list[str]:
    return [repr(float(value)) for value in np.ravel(values)]


def meshroom(root: Path, intrinsic: dict[str, Any] | None = None, version: tuple[int, int, int] = (1, 2, 6)) -> Path:
    given = {"focalLength": repr(F / WIDTH * 36), "principalPoint": ["-1.5", "2"], "type": "pinhole"}
    content = {
        "version": [str(number) for number in version],
        "views": [
            {"viewId": str(20 + i), "poseId": str(30 + i), "intrinsicId": "7", "path": f"/data/me/shots/{i:03d}.jpg"}
            | {"width": str(WIDTH), "height": str(HEIGHT), "metadata": ""}
            for i in range(4)
        ],
        "intrinsics": [
            {"intrinsicId": "7", "width": str(WIDTH), "height": str(HEIGHT), "sensorWidth": "36", "sensorHeight": "24"}
            | {"distortionParams": "", "undistortionParams": "", "locked": "false", **(intrinsic or given)}
        ],
        "poses": [
            {
                "poseId": str(30 + i),
                "pose": {"transform": {"rotation": texts(ROTATIONS[i].T), "center": texts(CENTERS[i])}},
            }
            for i in range(4)
        ],
        "structure": [
            {"landmarkId": "1", "descType": "sift", "color": ["10", "20", "30"], "X": ["0.5", "1.5", "-2.5"]},
            {"landmarkId": "2", "descType": "sift", "color": "", "X": ["1", "2", "3"]},
        ],
    }
    (root / "cameras.sfm").write_text(json.dumps(content, indent=4))
    draw_all(root)
    return root


def test_meshroom_reads_numbers_that_are_texts_and_paths_of_another_machine(tmp_path: Path) -> None:
    capture = read_capture(meshroom(tmp_path), "meshroom")
    agree(capture, lambda i: plain_pixels(i, cx=WIDTH / 2 - 1.5, cy=HEIGHT / 2 + 2))
    assert capture.points is not None
    assert capture.points.positions.tolist() == [[0.5, 1.5, -2.5], [1, 2, 3]]
    assert capture.points.colors.tolist() == [[10, 20, 30], [128, 128, 128]]


# AliceVision's compatibilityData has the same camera in files of every version: 4092x2048 pixels, focal lengths of 1000
# and 2000 pixels, the principal point 26 left of and 16 below the middle.
FEW = {"width": "4092", "height": "2048", "type": "pinhole", "sensorWidth": "36"}
OFFSET = {"principalPoint": ["-26", "16"]}
ABSOLUTE = {"principalPoint": ["2020", "1040"]}
VERSIONS = {
    (1, 0, 0): ({**FEW, **ABSOLUTE, "pxFocalLength": "1000"}, 1000),
    (1, 2, 0): ({**FEW, **ABSOLUTE, "pxFocalLength": ["1000", "2000"]}, 2000),
    (1, 2, 1): ({**FEW, **OFFSET, "pxFocalLength": ["1000", "2000"]}, 2000),
    (1, 2, 4): ({**FEW, **OFFSET, "focalLength": "8.7976539589442808", "pixelRatio": "0.5"}, 2000),
    (1, 2, 6): ({**FEW, **OFFSET, "focalLength": "8.7976539589442808", "pixelRatio": "2"}, 2000),
    (1, 2, 8): (
        {**FEW, **OFFSET, "focalLength": "8.7976539589442808", "pixelRatio": "2", "distortionType": "none"},
        2000,
    ),
    (1, 2, 14): (
        {**FEW, **OFFSET, "focalLength": "17.595307917888562", "pixelRatio": "2", "distortionType": "none"},
        2000,
    ),
}


@pytest.mark.parametrize("version", VERSIONS)
def test_files_of_all_versions_of_alicevision_have_the_same_camera(
    tmp_path: Path, version: tuple[int, int, int]
) -> None:
    intrinsic, fy = VERSIONS[version]
    photo = read_capture(meshroom(tmp_path, intrinsic, version), "meshroom").photos[0]
    np.testing.assert_allclose(photo.K, [[1000, 0, 2020], [0, fy, 1040], [0, 0, 1]], rtol=1e-12)
    assert photo.size == (4092, 2048) and photo.lens is None


RADIAL = (0.1, -0.05, 0.02)


def fov(xy: np.ndarray, omega: float) -> np.ndarray:
    r = np.linalg.norm(xy, axis=1, keepdims=True)
    distorted: np.ndarray = xy / r * np.arctan(2 * r * np.tan(omega / 2)) / omega
    return distorted


MESHROOM_LENSES = [
    ("radial1", "radialk1", [0.1], lambda xy: brown(xy, RADIAL[:1])),
    ("radial3", "radialk3", [*RADIAL], lambda xy: brown(xy, RADIAL)),
    (None, "radialk3pt", [*RADIAL], lambda xy: brown(xy, RADIAL) / (1 + sum(RADIAL))),
    ("brown", "brown", [*RADIAL, 0.01, -0.02], lambda xy: brown(xy, RADIAL, -0.02, 0.01)),
    ("fisheye4", "fisheye4", [*RADIAL, -0.01], lambda xy: fisheye(xy, (*RADIAL, -0.01))),
    ("fisheye1", "fisheye1", [0.8], lambda xy: fov(xy, 0.8)),
]


@pytest.mark.parametrize(("old", "new", "terms", "lens"), MESHROOM_LENSES)
def test_meshroom_lenses_bend_as_alicevision_says(
    tmp_path: Path, old: str | None, new: str, terms: list[float], lens: Callable[..., Any]
) -> None:
    def pixels(i: int) -> np.ndarray:
        rays = local(i)
        distorted: np.ndarray = F * lens(rays[:, :2] / rays[:, 2:]) + [WIDTH / 2, HEIGHT / 2]
        return distorted

    given = {"focalLength": repr(F / WIDTH * 36), "principalPoint": ["0", "0"], "distortionParams": texts(terms)}
    if old:
        agree(read_capture(meshroom(tmp_path, {**given, "type": old}), "meshroom"), pixels)
    newer = {**given, "type": "pinhole", "distortionType": new, "undistortionType": "none"}
    agree(read_capture(meshroom(tmp_path, newer, (1, 2, 14)), "meshroom"), pixels)


def test_a_view_of_a_rig_stands_where_its_rig_and_its_place_say(tmp_path: Path) -> None:
    place = POSES[3]

    def into_rig(content: dict[str, Any]) -> None:
        content["views"][0] |= {"rigId": "5", "subPoseId": "1", "isPoseIndependant": "false"}
        pose = {"rotation": texts(place[:3, :3].T), "center": texts(CENTERS[3])}
        content["rigs"] = [{"rigId": "5", "subPoses": [{"status": "constant", "pose": {}}, {"pose": pose}]}]

    edit_json(meshroom(tmp_path) / "cameras.sfm", into_rig)
    photo = read_capture(tmp_path, "meshroom").photos[0]
    np.testing.assert_allclose(photo.cam_from_world, place @ POSES[0], atol=1e-12)


def test_meshroom_views_that_cannot_be_used_are_lost_alone(tmp_path: Path) -> None:
    def lose(change: Callable[[dict[str, Any]], object], *parts: str) -> None:
        edit_json(meshroom(tmp_path) / "cameras.sfm", change)
        loses(tmp_path, "meshroom", "cameras.sfm, view 0 (images/000.jpg)", *parts)

    lose(lambda content: content["poses"].pop(0), "no pose")
    lose(lambda content: content["views"][0].update(intrinsicId="8"), "lacks its intrinsics '8'; export it again")
    lose(lambda content: content["poses"][0].update(pose=""), "expected a pose with rotation and center")
    lose(
        lambda content: content["poses"][0]["pose"]["transform"].update(center=["nan", "1", "2"]), "center: expected 3"
    )


@pytest.mark.parametrize(
    ("change", "cure"),
    [
        ({"type": "equirectangular"}, "panorama"),
        ({"type": "equidistant"}, "ExportImages"),
        ({"distortionType": "3declassicld"}, "ExportImages"),
        ({"undistortionParams": ["0", "0.1"]}, "ExportImages"),
        ({"sensorWidth": "0"}, "expected pixelRatio and sensorWidth above 0"),
        ({"distortionType": "radialk3", "distortionParams": ["1"]}, "distortionParams: expected 3 numbers"),
    ],
)
def test_meshroom_cameras_that_are_not_read_are_refused_with_a_cure(
    tmp_path: Path, change: dict[str, list[str] | str], cure: str
) -> None:
    edit_json(meshroom(tmp_path) / "cameras.sfm", lambda content: content["intrinsics"][0].update(change))
    fails(tmp_path, "meshroom", "cameras.sfm, view 0", cure)


def test_meshroom_files_without_poses_are_no_scene(tmp_path: Path) -> None:
    edit_json(meshroom(tmp_path) / "cameras.sfm", lambda content: content.update(poses=""))
    assert not [kind for kind in all_formats() if kind.recognises(tmp_path)]


def test_the_meshroom_file_with_landmarks_is_read(tmp_path: Path) -> None:
    meshroom(tmp_path)
    (tmp_path / "cameras.sfm").rename(tmp_path / "sfm.sfm")
    content = json.loads((tmp_path / "sfm.sfm").read_text())
    (tmp_path / "cameras.sfm").write_text(json.dumps({**content, "structure": ""}))
    assert read_capture(tmp_path, "meshroom").file == "sfm.sfm"


def test_damaged_meshroom_files_are_named(tmp_path: Path) -> None:
    path = meshroom(tmp_path) / "cameras.sfm"
    edit_json(path, lambda content: content.update(views={"0": 1}))
    fails(tmp_path, "meshroom", "cameras.sfm: views: expected a list of objects", "export it again")
    meshroom(tmp_path)
    edit_json(path, lambda content: content.update(version="new"))
    fails(tmp_path, "meshroom", "cameras.sfm: version: expected 3 numbers")
    path.write_text(path.read_text()[:-40])
    fails(tmp_path, "meshroom", "cameras.sfm: not valid JSON")


# BlocksExchange

FAR = np.array([651999.7, 6863073.6, 1318.9])  # as in Bentley's example, in Lambert 93


def tags(name: str, values: Mapping[str, object]) -> str:
    return f"<{name}>" + "".join(f"<{key}>{value}</{key}>" for key, value in values.items()) + f"</{name}>"


def matrix_tags(rotation: np.ndarray) -> str:
    return tags("Rotation", {f"M_{i}{j}": repr(float(rotation[i, j])) for i in range(3) for j in range(3)})


def xyz(values: np.ndarray) -> dict[str, str]:
    return {axis: repr(float(value)) for axis, value in zip("xyz", values, strict=True)}


BLOCK_CAMERA = (
    f"<FocalLengthPixels>{F}</FocalLengthPixels><PrincipalPoint><x>30.5</x><y>23</y></PrincipalPoint>"
    "<AspectRatio>1</AspectRatio><Skew>0</Skew>"
    + tags("Distortion", {"K1": 0.1, "K2": -0.05, "K3": 0.02, "P1": 0.01, "P2": -0.02})
)


def blocksexchange(
    root: Path,
    camera: str = BLOCK_CAMERA,
    orientation: str | None = "XRightYDown",
    axes: np.ndarray | None = None,
    edit: Edit = same,
    poses: list[str] | None = None,
) -> Path:
    """Write a BlocksExchange file. axes: the camera's axes as rows, in OpenCV's axes."""
    axes = np.eye(3) if axes is None else axes
    photos = ""
    for i, (name, rotation, center) in enumerate(zip(NAMES, ROTATIONS, CENTERS, strict=True)):
        pose = poses[i] if poses else matrix_tags(axes @ rotation)
        photos += (
            f"<Photo><Id>{i}</Id><ImagePath>{escape(name)}</ImagePath><Component>1</Component>"
            f"<Pose>{pose}{tags('Center', xyz(center + FAR))}<Metadata><Rotation><M_00>7</M_00></Rotation></Metadata>"
            "</Pose><ExifData><FocalLength>8.8</FocalLength></ExifData></Photo>"
        )
    named = f"<CameraOrientation>{orientation}</CameraOrientation>" if orientation else ""
    text = (
        '<?xml version="1.0" encoding="utf-8"?>\n<BlocksExchange version="3.2">\n'
        "<!-- A comment. --><SpatialReferenceSystems><SRS><Id>0</Id><Name>A</Name><Definition>EPSG:2154</Definition>"
        f"</SRS></SpatialReferenceSystems>\n<Block><Name>Block</Name><SRSId>0</SRSId><Photogroups><Photogroup>"
        f"<ImageDimensions><Width>{WIDTH}</Width><Height>{HEIGHT}</Height></ImageDimensions>"
        f"<CameraModelType>Perspective</CameraModelType>{named}{camera}{photos}"
        "</Photogroup></Photogroups><TiePoints><TiePoint>"
        f"{tags('Position', xyz(FAR))}<Color><Red>0.2</Red><Green>1</Green><Blue>0</Blue></Color><Measurement>"
        "<PhotoId>0</PhotoId><x>3</x><y>4</y></Measurement></TiePoint><TiePoint/></TiePoints></Block></BlocksExchange>\n"
    )
    (root / "block.xml").write_text(edit(text), newline="")
    draw_all(root)
    return root


def block_pixels(i: int, cx: float = 31, cy: float = 23.5) -> np.ndarray:
    """Return pixels by Brown's equations as Wikipedia has them, to which Bentley refers: P1 goes with r^2 + 2 x^2."""
    rays = local(i)
    return F * brown(rays[:, :2] / rays[:, 2:], RADIAL, 0.01, -0.02) + [cx, cy]


def test_blocks_project_as_bentley_says_far_from_the_origin(tmp_path: Path) -> None:
    capture = read_capture(blocksexchange(tmp_path), "blocksexchange")
    agree(capture, block_pixels, POINTS + FAR)
    assert capture.points is not None
    np.testing.assert_array_equal(capture.points.positions, [FAR])
    assert capture.points.colors.tolist() == [[51, 255, 0]]


RIGHT, DOWN = np.array([1.0, 0, 0]), np.array([0, 1.0, 0])
ORIENTATIONS = {
    "XRightYDown": (RIGHT, DOWN),
    "XRightYUp": (RIGHT, -DOWN),
    "XLeftYDown": (-RIGHT, DOWN),
    "XLeftYUp": (-RIGHT, -DOWN),
    "XDownYRight": (DOWN, RIGHT),
    "XDownYLeft": (DOWN, -RIGHT),
    "XUpYRight": (-DOWN, RIGHT),
    "XUpYLeft": (-DOWN, -RIGHT),
}


@pytest.mark.parametrize("name", [None, *ORIENTATIONS])
def test_blocks_turn_the_cameras_axes(tmp_path: Path, name: str | None) -> None:
    x, y = ORIENTATIONS[name or "XRightYDown"]
    blocksexchange(tmp_path, orientation=name, axes=np.stack([x, y, np.cross(x, y)]))
    agree(read_capture(tmp_path, "blocksexchange"), block_pixels, POINTS + FAR)


@pytest.mark.parametrize(
    "edit",
    [
        lambda text: text.replace("\n", "\r\n"),
        lambda text: "\ufeff" + text,
        lambda text: text.replace("<BlocksExchange ", '<BlocksExchange xmlns="http://example.org/blocks" '),
        lambda text: text.replace("images/", "D:\\survey 3\\images\\"),
        lambda text: text.replace("images/", "").replace("<Block>", "<BaseImagePath>D:\\images</BaseImagePath><Block>"),
        lambda text: text.replace("<Component>1</Component>", ""),
    ],
)
def test_blocks_of_other_programs(tmp_path: Path, edit: Callable[..., Any]) -> None:
    agree(read_capture(blocksexchange(tmp_path, edit=edit), "blocksexchange"), block_pixels, POINTS + FAR)


def test_a_block_in_utf_16(tmp_path: Path) -> None:
    blocksexchange(tmp_path)
    path = tmp_path / "block.xml"
    path.write_text(path.read_text().replace("utf-8", "utf-16"), encoding="utf-16")
    agree(read_capture(tmp_path, "blocksexchange"), block_pixels, POINTS + FAR)


# Bentley's example gives one camera and one pose in several forms.
BENTLEY_SIZE = "<ImageDimensions><Width>9420</Width><Height>14430</Height></ImageDimensions>"
BENTLEY_MM = "<PrincipalPoint><xmm>-0.1853590176</xmm><ymm>0.06130152144</ymm></PrincipalPoint>"
BENTLEY_PX = "<PrincipalPoint><x>4683.755692</x><y>7223.0141002</y></PrincipalPoint>"
BENTLEY_CAMERAS = [
    f"<SensorSize>103.896</SensorSize><FocalLength>100.735601903992</FocalLength>{BENTLEY_MM}",
    f"<PixelSize>0.0072</PixelSize><FocalLength>100.735601903992</FocalLength>{BENTLEY_PX}",
    f"<FocalLengthPixels>13991.05582</FocalLengthPixels>{BENTLEY_PX}",
]


@pytest.mark.parametrize("camera", BENTLEY_CAMERAS)
def test_bentleys_example_is_one_camera_in_all_its_forms(tmp_path: Path, camera: str) -> None:
    size = f"<ImageDimensions><Width>{WIDTH}</Width><Height>{HEIGHT}</Height></ImageDimensions>"
    blocksexchange(tmp_path, camera, edit=lambda text: text.replace(size, BENTLEY_SIZE))
    photo = read_capture(tmp_path, "blocksexchange").photos[0]
    np.testing.assert_allclose(photo.K[:2], [[13991.05582, 0, 4684.255692], [0, 13991.05582, 7223.5141002]], atol=2e-4)
    assert photo.size == (9420, 14430)


@pytest.mark.parametrize(("x", "y"), [("31.5", "23.5"), ("32", "24")])
def test_the_middle_of_a_blocks_photographs_however_it_is_counted(tmp_path: Path, x: str, y: str) -> None:
    point = f"<PrincipalPoint><x>{x}</x><y>{y}</y></PrincipalPoint>"
    blocksexchange(tmp_path, f"<FocalLengthPixels>{F}</FocalLengthPixels>{point}")
    photo = read_capture(tmp_path, "blocksexchange").photos[0]
    assert photo.K[:2, 2].tolist() == [WIDTH / 2, HEIGHT / 2]


def test_millimetres_run_along_the_cameras_axes(tmp_path: Path) -> None:
    point = "<PixelSize>0.01</PixelSize><PrincipalPoint><xmm>0.02</xmm><ymm>0.03</ymm></PrincipalPoint>"
    camera = f"<FocalLengthPixels>{F}</FocalLengthPixels>{point}"
    blocksexchange(tmp_path, camera, "XDownYLeft")
    photo = read_capture(tmp_path, "blocksexchange").photos[0]
    np.testing.assert_allclose(photo.K[:2, 2], [WIDTH / 2 - 3, HEIGHT / 2 + 2])


def test_bentleys_example_has_one_rotation_as_matrix_and_as_angles(tmp_path: Path) -> None:
    bentley = [
        [-0.9999982912233401, -0.001636319085375301, -0.0008602425863163225],
        [-0.001631068695467463, 0.9999802528616577, -0.00606906089589293],
        [0.0008701565192966738, -0.006067647409696231, -0.9999812130648239],
    ]
    angles = tags("Rotation", {"Omega": 179.6523471469934, "Phi": 0.04985630236313049, "Kappa": 179.9065465708369})
    blocksexchange(tmp_path, poses=[angles] * 4)
    photo = read_capture(tmp_path, "blocksexchange").photos[0]
    np.testing.assert_allclose(photo.cam_from_world[:3, :3], bentley, atol=1e-9)


def test_aspect_and_skew_of_a_block(tmp_path: Path) -> None:
    camera = BLOCK_CAMERA.replace("<AspectRatio>1<", "<AspectRatio>1.1<").replace("<Skew>0<", "<Skew>2<")
    capture = read_capture(blocksexchange(tmp_path, camera), "blocksexchange")

    def pixels(i: int) -> np.ndarray:
        rays = local(i)
        bent = brown(rays[:, :2] / rays[:, 2:], RADIAL, 0.01, -0.02)
        distorted: np.ndarray = bent @ np.array([[F, 2], [0, 1.1 * F]]).T + [31, 23.5]
        return distorted

    agree(capture, pixels, POINTS + FAR)


def test_a_blocks_fisheye_is_a_polynomial_of_the_angle_over_90_degrees(tmp_path: Path) -> None:
    camera = tags("FisheyeFocalMatrix", {"M_00": 90, "M_01": 0, "M_10": 0, "M_11": 95}) + tags(
        "FisheyeDistortion", {"P0": 0, "P1": 1, "P2": 0, "P3": -0.05, "P4": 0}
    )
    blocksexchange(tmp_path, camera, edit=lambda text: text.replace("Perspective", "Fisheye"))

    def pixels(i: int) -> np.ndarray:
        xy = local(i)[:, :2] / local(i)[:, 2:]
        r = np.linalg.norm(xy, axis=1, keepdims=True)
        share = np.arctan(r) / (np.pi / 2)
        distorted: np.ndarray = xy / r * (share - 0.05 * share**3) * [90, 95] + [WIDTH / 2, HEIGHT / 2]
        return distorted

    agree(read_capture(tmp_path, "blocksexchange"), pixels, POINTS + FAR)


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    [
        ("Perspective", "Spherical", ("panorama",)),
        ("Perspective", "Pushbroom", ("expected Perspective or Fisheye",)),
        ("EPSG:2154", "EPSG:4326+5773", ("longitude and latitude", "in a projected")),
        ("XRightYDown", "XUpYDownish", ("CameraOrientation", "XRightYDown")),
        (f"<FocalLengthPixels>{F}</FocalLengthPixels>", "", ("FocalLength", "expected a")),
        (f"<FocalLengthPixels>{F}</FocalLengthPixels>", "<FocalLength>5</FocalLength>", ("SensorSize",)),
        ("M_00>", "N_00>", ("neither a matrix nor Omega",)),
        ("<Pose>", "<NoPose>", ("not valid XML",)),
        ("<BlocksExchange", "<!DOCTYPE x><BlocksExchange", ("DOCTYPE",)),
        ("Photogroup>", "Group>", ("it lists no photographs",)),
    ],
)
def test_blocks_that_cannot_be_used_are_refused_with_a_cure(
    tmp_path: Path, old: str, new: str, parts: tuple[str, ...]
) -> None:
    blocksexchange(tmp_path, edit=lambda text: text.replace(old, new))
    fails(tmp_path, "blocksexchange", "block.xml", *parts)


@pytest.mark.parametrize(
    ("old", "new", "part"),
    [
        ("<Component>1<", "<Component>0<", "main component"),
        ("<Center>", "<Centre/><Center2>", "no pose with Rotation and Center"),
        ("<M_11>", "<M_11>x", "M_11: expected a number"),
    ],
)
def test_one_bad_photograph_of_a_block_is_lost_alone(tmp_path: Path, old: str, new: str, part: str) -> None:
    def edit(text: str) -> str:
        text = text.replace(old, new, 1)
        return text.replace("</Center>", "</Center2>", 1) if "Center2" in new else text

    loses(blocksexchange(tmp_path, edit=edit), "blocksexchange", "block.xml, images/000.jpg", part)


# RealityCapture's .xmp

XCR = 'xmlns:xcr="http://www.capturingreality.com/ns/xcr/1.1#"'
RC_WIDTH, RC_HEIGHT = 48, 64  # upright: lengths are in the larger side


def rc_values(i: int, model: str = "brown4t2", terms: str = "0.1 -0.05 0.02 0.03 -0.02 0.01") -> dict[str, str]:
    return {
        "Version": "3",
        "PosePrior": "locked",
        "Coordinates": "absolute",
        "DistortionModel": model,
        "DistortionCoeficients": terms,
        "FocalLength35mm": repr(F / RC_HEIGHT * 36),
        "Skew": "0",
        "AspectRatio": "1.02",
        "PrincipalPointU": "0.03125",
        "PrincipalPointV": "-0.015625",
        "Rotation": words(ROTATIONS[i]),
        "Position": words(CENTERS[i]),
    }


def xmp(values: dict[str, str], elements: tuple[str, ...] = ()) -> str:
    attributes = " ".join(f'xcr:{name}="{value}"' for name, value in values.items() if name not in elements)
    inner = "".join(f"<xcr:{name}>{values[name]}</xcr:{name}>\n" for name in elements if name in values)
    return (
        '<x:xmpmeta xmlns:x="adobe:ns:meta/">\n<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">\n'
        f'<rdf:Description rdf:about="" {XCR} {attributes}>\n{inner}</rdf:Description>\n</rdf:RDF>\n</x:xmpmeta>\n'
    )


ELEMENTS = ("Rotation", "Position", "DistortionCoeficients")


def realitycapture_xmp(root: Path, elements: tuple[str, ...] = ELEMENTS, edit: Edit = same, **values: str) -> Path:
    draw_all(root, [f"{i:03d}.jpg" for i in range(4)], RC_WIDTH, RC_HEIGHT)
    for i in range(4):
        (root / f"{i:03d}.xmp").write_text(edit(xmp(rc_values(i) | values, elements)), newline="")
    return root


def rc_agree(capture: Capture, lens: Callable[[np.ndarray], np.ndarray]) -> None:
    assert len(capture.photos) == 4 and not capture.lost and not capture.notes
    for i, photo in enumerate(capture.photos):
        rays = local(i)
        expected = lens(rays[:, :2] / rays[:, 2:]) * [F, 1.02 * F] + [RC_WIDTH / 2 + 2, RC_HEIGHT / 2 - 1]
        np.testing.assert_allclose(project(photo, POINTS), expected, atol=1e-7)
        assert photo.image.name == f"{i:03d}.jpg" and photo.size == (RC_WIDTH, RC_HEIGHT)


def rc_brown(xy: np.ndarray) -> np.ndarray:
    return brown(xy, (0.1, -0.05, 0.02, 0.03), -0.02, 0.01)


@pytest.mark.parametrize("elements", [ELEMENTS, (), tuple(rc_values(0))])
@pytest.mark.parametrize(
    "edit",
    [
        same,
        lambda text: "\ufeff" + text.replace("\n", "\r\n"),
        lambda text: f'<?xpacket begin=""?>\n{text}<?xpacket end="w"?>',
    ],
)
def test_xmp_cameras_project_as_realitycapture_says(
    tmp_path: Path, elements: tuple[str, ...], edit: Callable[..., Any]
) -> None:
    rc_agree(read_capture(realitycapture_xmp(tmp_path, elements, edit), "realitycapture_xmp"), rc_brown)


@pytest.mark.parametrize(
    ("model", "terms", "lens"),
    [
        ("perspective", "0 0 0 0 0 0", lambda xy: xy),
        ("division", "0 0 0 0 0 0", lambda xy: xy),
        ("brown3", "0.1 -0.05 0.02 0 0 0", lambda xy: brown(xy, RADIAL)),
        ("brown3", "0.1 -0.05 0.02", lambda xy: brown(xy, RADIAL)),
        ("brown3t2", "0.1 -0.05 0.02 0 -0.02 0.01", lambda xy: brown(xy, RADIAL, -0.02, 0.01)),
    ],
)
def test_xmp_distortion_models(tmp_path: Path, model: str, terms: str, lens: Callable[..., Any]) -> None:
    realitycapture_xmp(tmp_path, DistortionModel=model, DistortionCoeficients=terms)
    rc_agree(read_capture(tmp_path, "realitycapture_xmp"), lens)


def test_xmp_files_by_whole_names_beside_others_and_in_several_folders(tmp_path: Path) -> None:
    realitycapture_xmp(tmp_path)
    for i in range(4):
        (tmp_path / f"cam{i % 2}").mkdir(exist_ok=True)
        (tmp_path / f"{i:03d}.xmp").rename(tmp_path / f"cam{i % 2}/{i:03d}{'.jpg' * (i > 1)}.XMP")
        (tmp_path / f"{i:03d}.jpg").rename(tmp_path / f"cam{i % 2}/{i:03d}.jpg")
    (tmp_path / "cam0/aaa.xmp").write_text("<x:xmpmeta xmlns:x='adobe:ns:meta/'><crs/></x:xmpmeta>")
    capture = read_capture(tmp_path, "realitycapture_xmp")
    assert [photo.image.relative_to(tmp_path).as_posix() for photo in capture.photos] == [
        "cam0/000.jpg", "cam0/002.jpg", "cam1/001.jpg", "cam1/003.jpg",
    ]  # fmt: skip


def test_xmp_files_of_other_programs_are_no_cameras(tmp_path: Path) -> None:
    realitycapture_xmp(tmp_path, edit=lambda text: text.replace("capturingreality", "adobe"))
    assert not [kind for kind in all_formats() if kind.recognises(tmp_path)]
    realitycapture_xmp(tmp_path, edit=lambda text: text.replace("Position", "Place"))
    assert not [kind for kind in all_formats() if kind.recognises(tmp_path)]


@pytest.mark.parametrize(
    ("change", "parts"),
    [
        ({"DistortionModel": "division"}, ("division", "choose Brown")),
        ({"Skew": "0.1"}, ("Skew is 0.1",)),
        ({"FocalLength35mm": "long"}, ("FocalLength35mm: expected a number",)),
        ({"Rotation": "1 2 3"}, ("Rotation: expected 9 numbers",)),
        ({"Position": "1 2 -nan(ind)"}, ("Position: expected 3 numbers",)),
    ],
)
def test_xmp_cameras_that_cannot_be_used_are_refused_with_a_cure(
    tmp_path: Path, change: dict[str, Any], parts: tuple[str, ...]
) -> None:
    fails(realitycapture_xmp(tmp_path, **change), "realitycapture_xmp", "000.xmp", *parts)


def test_one_bad_xmp_is_lost_alone(tmp_path: Path) -> None:
    realitycapture_xmp(tmp_path)
    (tmp_path / "000.xmp").write_text((tmp_path / "000.xmp").read_text()[:-30])
    loses(tmp_path, "realitycapture_xmp", "000.xmp: not valid XML")
    (tmp_path / "000.xmp").write_text(xmp({name: value for name, value in rc_values(0).items() if name != "Position"}))
    loses(tmp_path, "realitycapture_xmp", "000.xmp: it has no Position and Rotation")
    (tmp_path / "000.xmp").write_text("<!DOCTYPE x [<!ENTITY a 'b'>]>" + xmp(rc_values(0)))
    loses(tmp_path, "realitycapture_xmp", "000.xmp: the file has a DOCTYPE")
    realitycapture_xmp(tmp_path)
    (tmp_path / "000.jpg").unlink()
    capture = read_capture(tmp_path, "realitycapture_xmp")
    assert len(capture.photos) == 3 and isinstance(capture.lost[0], MissingPhotoError)


# Kapture


def kapture(root: Path, files: dict[str, Edit] | None = None) -> Path:
    """Write photographs of which 0 to 2 have poses of their own, and 3 that of its rig."""
    place = POSES[0]
    rig = np.linalg.inv(place) @ POSES[3]
    rows = {
        "sensors": [
            "# sensor_device_id, name, sensor_type, [sensor_params]+",
            f"cam0, Hero7, camera, OPENCV, {WIDTH}, {HEIGHT}, 70, 75, 31, 23.5, 0.1, -0.05, 0.01, -0.02",
            "gps1, , gnss, EPSG:4326",
            "depth, , depth, SIMPLE_PINHOLE, 64, 48, 70, 32, 24",
        ],
        "records_camera": [f"{i:04d}, cam0, {i:03d}.jpg" for i in range(4)],
        "trajectories": [
            *[f"       {i}, cam0, {fields(quaternion(ROTATIONS[i]), POSES[i][:3, 3])}" for i in range(3)],
            f"3, rig, {fields(quaternion(rig[:3, :3]), rig[:3, 3])}",
        ],
        "rigs": [f"rig, cam0, {fields(quaternion(place[:3, :3]), place[:3, 3])}", "rig, depth, 1, 0, 0, 0, 0, 0, 0"],
    }
    (root / "sensors").mkdir(exist_ok=True)
    for name, lines in rows.items():
        text = "\n".join(["# kapture format: 1.1", *lines]) + "\n"
        (root / f"sensors/{name}.txt").write_text((files or {}).get(name, same)(text), newline="")
    (root / "reconstruction").mkdir(exist_ok=True)
    (root / "reconstruction/points3d.txt").write_text(
        "# kapture format: 1.1\n0.5, 1.5, -2.5, 10, 20, 30\n1, nan, 2, 0, 0, 0\n"
    )
    draw_all(root, [f"sensors/records_data/{i:03d}.jpg" for i in range(4)])
    return root


def fields(*values: ArrayLike) -> str:
    return words(*values).replace(" ", ", ")


def kapture_pixels(i: int) -> np.ndarray:
    rays = local(i)
    return brown(rays[:, :2] / rays[:, 2:], (0.1, -0.05), -0.02, 0.01) * [70, 75] + [31, 23.5]


@pytest.mark.parametrize("edit", [same, lambda text: "\ufeff" + text.replace("\n", "\r\n")])
def test_kapture_places_sensors_themselves_and_through_rigs(tmp_path: Path, edit: Callable[..., Any]) -> None:
    names = ("sensors", "records_camera", "trajectories", "rigs")
    capture = read_capture(kapture(tmp_path, {name: edit for name in names}), "kapture")
    agree(capture, kapture_pixels)
    assert capture.points is not None and not capture.notes
    assert capture.points.positions.tolist() == [[0.5, 1.5, -2.5]] and capture.points.colors.tolist() == [[10, 20, 30]]


@pytest.mark.parametrize(
    ("file", "old", "new", "parts"),
    [
        ("records_camera", "0000, cam0", "0000, cam1", ("sensors.txt has no camera cam1", "COLMAP")),
        ("records_camera", "0000, cam0", "0009, cam0", ("has no pose of cam0 or its rig at time 0009",)),
        ("trajectories", fields(quaternion(ROTATIONS[0])), ", , , ", ("pose: expected 7 numbers",)),
    ],
)
def test_kapture_records_that_cannot_be_used_are_lost_alone(
    tmp_path: Path, file: str, old: str, new: str, parts: tuple[str, ...]
) -> None:
    kapture(tmp_path, {file: lambda text: text.replace(old, new)})
    loses(tmp_path, "kapture", "sensors/records_camera.txt, 000.jpg", *parts)


@pytest.mark.parametrize(
    ("file", "old", "new", "parts"),
    [
        ("sensors", "OPENCV", "UNKNOWN_CAMERA", ("no camera cam0 with a model",)),
        ("sensors", ", -0.02", "", ("camera model OPENCV: expected 8 parameters, got 7", "fix the file")),
        ("sensors", "OPENCV", "LIGHTFIELD", ("camera model LIGHTFIELD is not supported",)),
        ("trajectories", "3, rig, ", "3 rig ", ("trajectories.txt, line 5: expected at least 9 values",)),
        ("rigs", "rig, cam0", "rig; cam0", ("rigs.txt, line 2",)),
    ],
)
def test_damaged_kapture_files_are_named(tmp_path: Path, file: str, old: str, new: str, parts: tuple[str, ...]) -> None:
    kapture(tmp_path, {file: lambda text: text.replace(old, new)})
    fails(tmp_path, "kapture", "sensors/", *parts)


def test_kapture_without_trajectories_says_so(tmp_path: Path) -> None:
    (kapture(tmp_path) / "sensors/trajectories.txt").unlink()
    fails(tmp_path, "kapture", "lacks sensors/trajectories.txt", "add it")


def test_rigs_that_hold_each_other_end(tmp_path: Path) -> None:
    kapture(tmp_path, {"rigs": lambda text: text + "a, rig, 1, 0, 0, 0, 0, 0, 0\nrig, a, 1, 0, 0, 0, 0, 0, 0\n"})
    agree(read_capture(tmp_path, "kapture"), kapture_pixels)


# Pix4D

PIX4D_HEAD = """fileName imageWidth imageHeight
camera matrix K [3x3]
radial distortion [3x1]
tangential distortion [2x1]
camera position t [3x1]
camera rotation R [3x3]
camera model m = K [R|-Rt] X

"""


def pix4d(root: Path, edit: Edit = same) -> Path:
    text = PIX4D_HEAD
    for name, rotation, center in zip(NAMES, ROTATIONS, CENTERS, strict=True):
        text += f"{Path(name).name} {WIDTH} {HEIGHT}\n{F} 0 31\n0 75 23.5\n0 0 1\n0.1 -0.05 0.02\n0.01 -0.02\n"
        text += words(center) + "\n"
        text += "".join(words(row) + "\n" for row in rotation)
    (root / "site_calibrated_camera_parameters.txt").write_text(edit(text), newline="")
    draw_all(root)
    return root


@pytest.mark.parametrize("edit", [same, lambda text: "\ufeff" + text.replace("\n", "\r\n")])
def test_pix4d_projects_as_its_head_says(tmp_path: Path, edit: Callable[..., Any]) -> None:
    def pixels(i: int) -> np.ndarray:
        """Return pixels by m = K [R | -R t] X, with Brown's terms between."""
        seen = POINTS @ ROTATIONS[i].T - ROTATIONS[i] @ CENTERS[i]
        bent = brown(seen[:, :2] / seen[:, 2:], RADIAL, -0.02, 0.01)
        return bent * [F, 75] + [31, 23.5]

    agree(read_capture(pix4d(tmp_path, edit), "pix4d"), pixels)


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    [
        ("camera model m", "model m", ("got 0 lines in all",)),
        ("0.01 -0.02\n", "", ("expected 10 lines per photograph after the header",)),
        ("0.01 -0.02\n", "0.01\n", ("tangential distortion: expected 2 numbers",)),
        (f".jpg {WIDTH} {HEIGHT}", "", ("expected a photograph's name, width and height",)),
    ],
)
def test_damaged_pix4d_files_are_named(tmp_path: Path, old: str, new: str, parts: tuple[str]) -> None:
    pix4d(tmp_path, lambda text: text.replace(old, new))
    fails(tmp_path, "pix4d", "site_calibrated_camera_parameters.txt", *parts)
