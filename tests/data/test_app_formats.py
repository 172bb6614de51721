"""Exports of photogrammetry programs, built by hand from their documentation, held to its formulas."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mgsr.data.capture import Photo
from mgsr.data.photo_files import SceneFolder
from mgsr.data.usable import usable_photos
from mgsr.errors import SceneError
from tests.data.captures import BallCapture
from tests.data.reading import draw, project, read_capture, read_strictly

BALL = BallCapture(views=4, center=np.array([1.0, -2, 3]))
POINTS = BALL.center + np.random.default_rng(3).uniform(-0.8, 0.8, (30, 3))


# Metashape


TERMS = {"f": 70, "cx": -3, "cy": 2.5, "k1": -0.1, "k2": 0.05, "k3": 0.02, "k4": 0.01}
TERMS |= {"p1": 0.004, "p2": -0.003, "b1": 1.5, "b2": 0.7}


def metashape(
    root: Path,
    terms: dict[str, float] = TERMS,
    kind: str = "frame",
    chunk: str = "",
    camera: Callable[[int], str] = lambda i: "",
    aligned: Sequence[int] = range(4),
) -> Path:
    """Write cameras.xml with world-from-camera transforms, OpenCV axes; `camera` adds attributes."""
    cameras = []
    for i, pose in enumerate(BALL.poses()):
        draw(root / f"photos/IMG_{i}.JPG", 96, 64)
        numbers = " ".join(map(str, np.linalg.inv(pose).ravel()))
        transform = f"<transform>{numbers}</transform>" if i in aligned else ""
        cameras.append(f'<camera id="{i}" sensor_id="0" label="IMG_{i}" {camera(i)}>{transform}</camera>')
    calibration = "".join(f"<{name}>{value}</{name}>" for name, value in terms.items())
    (root / "cameras.xml").write_text(
        f"""<?xml version="1.0" encoding="UTF-8"?><document version="2.0.0"><chunk label="Chunk 1">
        <sensors><sensor id="0" type="{kind}"><resolution width="96" height="64"/>
        <calibration type="{kind}" class="initial"><f>1</f></calibration>
        <calibration type="{kind}" class="adjusted"><resolution width="96" height="64"/>{calibration}</calibration>
        </sensor></sensors>
        <cameras><group id="0">{"".join(cameras[:2])}</group>{"".join(cameras[2:])}</cameras>{chunk}</chunk>
        </document>"""
    )
    return root


def metashape_pixels(pose: np.ndarray, points: np.ndarray, fisheye: bool = False, **terms: float) -> np.ndarray:
    """Return pixels by the user manual's formulas, appendix "Camera models", letter by letter."""
    t = SimpleNamespace(**terms)
    X, Y, Z = (points @ pose[:3, :3].T + pose[:3, 3]).T
    x, y = X / Z, Y / Z
    if fisheye:
        r0 = np.sqrt(x**2 + y**2)
        x, y = x / r0 * np.arctan(r0), y / r0 * np.arctan(r0)
    r = np.sqrt(x**2 + y**2)
    radial = 1 + t.k1 * r**2 + t.k2 * r**4 + t.k3 * r**6 + t.k4 * r**8
    xd = x * radial + (t.p1 * (r**2 + 2 * x**2) + 2 * t.p2 * x * y)
    yd = y * radial + (t.p2 * (r**2 + 2 * y**2) + 2 * t.p1 * x * y)
    pixels: np.ndarray = np.c_[96 * 0.5 + t.cx + xd * t.f + xd * t.b1 + yd * t.b2, 64 * 0.5 + t.cy + yd * t.f]
    return pixels


@pytest.mark.parametrize("kind", ["frame", "fisheye"])
def test_metashape_projects_as_its_manual_says(tmp_path: Path, kind: str) -> None:
    capture = read_capture(metashape(tmp_path, kind=kind), "metashape")
    assert [photo.image.name for photo in capture.photos] == [f"IMG_{i}.JPG" for i in range(4)]
    for photo, pose in zip(capture.photos, BALL.poses(), strict=True):
        expected = metashape_pixels(pose, POINTS, fisheye=kind == "fisheye", **TERMS)
        np.testing.assert_allclose(project(photo, POINTS), expected, atol=1e-9)
        assert photo.size == (96, 64)


@pytest.mark.parametrize("where", ["chunk", "component"])
def test_metashape_results_go_to_the_chunks_world(tmp_path: Path, where: str) -> None:
    turn, offset, scale = Rotation.from_euler("xyz", [0.3, -0.5, 1.0]).as_matrix(), np.array([10.0, 20, -5]), 2.5
    transform = (
        f"<transform><rotation>{' '.join(map(str, turn.ravel()))}</rotation>"
        f"<translation>{' '.join(map(str, offset))}</translation><scale>{scale}</scale></transform>"
    )
    if where == "component":
        transform = f'<components><component id="0">{transform}</component></components>'
    capture = read_capture(metashape(tmp_path, chunk=transform, camera=lambda i: 'component_id="0"'), "metashape")
    moved = scale * POINTS @ turn.T + offset
    for photo, pose in zip(capture.photos, BALL.poses(), strict=True):
        np.testing.assert_allclose(project(photo, moved), metashape_pixels(pose, POINTS, False, **TERMS), atol=1e-8)


def test_metashape_cameras_that_are_not_aligned_or_not_enabled(tmp_path: Path) -> None:
    def usable(**values: Any) -> tuple[list[Photo], tuple[str, ...]]:
        folder = SceneFolder.at(metashape(tmp_path, **values))
        return usable_photos(read_capture(folder.root, "metashape"), folder)

    photos, notes = usable(aligned=(0, 1, 2))
    assert len(photos) == 3
    assert notes == (
        "1 of 4 photographs skipped: cameras.xml, camera 'IMG_3': the photograph is not aligned; align the cameras in "
        "Metashape and export them again",
    )
    photos, notes = usable(camera=lambda i: 'enabled="false"' if i == 3 else "")
    assert len(photos) == 3 and notes == ()
    with pytest.raises(
        SceneError, match=r"3 of 4 photographs cannot be used; the first: .*'IMG_1': the photograph is not aligned"
    ):
        usable(aligned=(0,))
    metashape(tmp_path)
    for i in (0, 2, 3):
        (tmp_path / f"photos/IMG_{i}.JPG").unlink()
    folder = SceneFolder.at(tmp_path)
    with pytest.raises(SceneError, match=r"only 1 of the 4 .* \(IMG_0 is missing\); copy them anywhere into"):
        usable_photos(read_capture(tmp_path, "metashape"), folder)


def test_metashape_slaves_of_multi_camera_systems(tmp_path: Path) -> None:
    def pairs(i: int) -> str:
        return f'master_id="{i - i % 2}"'

    capture = read_capture(metashape(tmp_path, camera=pairs), "metashape")
    assert [photo.image.name for photo in capture.photos] == ["IMG_0.JPG", "IMG_2.JPG"]
    assert [str(error) for error in capture.lost] == [
        f"cameras.xml, camera 'IMG_{i}': it is part of a multi-camera system, which is not supported; add the "
        "photographs to Metashape as single cameras, align them and export them again"
        for i in (1, 3)
    ]


@pytest.mark.parametrize("label", ["cam0", "Rig/cam0", "left"])
def test_metashape_groups_tell_photographs_of_one_name_apart(tmp_path: Path, label: str) -> None:
    """Check that groups named as the folders find the photographs, and that other names are refused."""
    path = metashape(tmp_path) / "cameras.xml"
    text = path.read_text().replace('<group id="0">', f'<group id="0" label="{label}">')
    text = text.replace('label="IMG_1"', 'label="IMG_2"').replace('label="IMG_0"', 'label="IMG_3"')
    path.write_text(text)
    for i in range(2):
        (tmp_path / f"photos/IMG_{i}.JPG").unlink()
        draw(tmp_path / f"cam0/IMG_{i + 2}.JPG", 96, 64)
    capture = read_capture(tmp_path, "metashape")
    names = [photo.image.relative_to(tmp_path).as_posix() for photo in capture.photos]
    if label == "left":
        assert names == [] and len(capture.lost) == 4
        with pytest.raises(
            SceneError, match=r"cameras\.xml: the photograph '.*' may be cam0/.*; write its folder as well"
        ):
            usable_photos(capture, SceneFolder.at(tmp_path))
    else:
        assert sorted(names)[:2] == ["cam0/IMG_2.JPG", "cam0/IMG_3.JPG"]


def test_metashape_panoramas_without_a_calibration(tmp_path: Path) -> None:
    path = metashape(tmp_path, kind="spherical") / "cameras.xml"
    path.write_text(re.sub("<calibration.*</calibration>", "", path.read_text(), flags=re.DOTALL))
    with pytest.raises(SceneError, match="'IMG_0': camera type 'spherical' is not supported: a panorama"):
        read_strictly(tmp_path, "metashape")
    path.write_text(path.read_text().replace("spherical", "frame"))
    with pytest.raises(SceneError, match="'IMG_0': its sensor has no calibration; export"):
        read_strictly(tmp_path, "metashape")


def test_metashape_in_utf_16_beside_other_documents(tmp_path: Path) -> None:
    path = metashape(tmp_path) / "cameras.xml"
    path.write_text(path.read_text().replace("UTF-8", "UTF-16"), encoding="utf-16")
    (tmp_path / "._a.xml").write_bytes(b"\0\5\x16\7 Mac OS X <document><chunk><camera /></chunk></document>")
    (tmp_path / "a.xml").write_text("<document><chunk label='empty'></chunk></document>")
    assert len(read_capture(tmp_path, "metashape").photos) == 4


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (
            {"kind": "spherical"},
            "'IMG_0': camera type 'spherical' is not supported: a panorama",
        ),
        ({"terms": {"cx": 1}}, "camera 'IMG_0': f: expected 1 numbers, got ''"),
        ({"terms": {"f": "nan"}}, "camera 'IMG_0': f: expected 1 numbers, got 'nan'"),
        ({"terms": TERMS | {"p3": 0, "p4": 0.5}}, "camera 'IMG_0': distortion p4 is 0.5, but MGSR supports only 0"),
        ({"camera": lambda i: 'sensor_id="7"'}, "not valid XML: duplicate attribute"),
        ({"chunk": "<transform><scale>0</scale></transform>"}, "expected a scale of the chunk above 0, got 0"),
        ({"chunk": "<transform><rotation>1 2</rotation></transform>"}, "rotation: expected 9 numbers, got '1 2'"),
    ],
)
def test_metashape_refusals(tmp_path: Path, values: dict[str, Any], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        read_strictly(metashape(tmp_path, **values), "metashape")


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_metashape_entities_are_refused(tmp_path: Path, encoding: str) -> None:
    path = metashape(tmp_path) / "cameras.xml"
    text = path.read_text().replace("<document", '<!DOCTYPE d [<!ENTITY a "aaaa">]><document', 1)
    path.write_text(text, encoding=encoding)
    with pytest.raises(SceneError, match="has a DOCTYPE, which Metashape never writes; MGSR refuses it"):
        read_capture(tmp_path, "metashape")


def test_of_two_photographs_for_one_label_the_folder_with_most_of_them_has_it(tmp_path: Path) -> None:
    draw(metashape(tmp_path) / "more/IMG_2.png")
    assert {photo.image.parent.name for photo in read_strictly(tmp_path, "metashape").photos} == {"photos"}


# RealityCapture

HEADER = "#name,x,y,alt,heading,pitch,roll,f,px,py,k1,k2,k3,k4,t1,t2"
REALITYSCAN_HEADER = "#name,x,y,alt,yaw,pitch,roll,f_35mm,px_norm,py_norm,k1,k2,k3,k4,t1,t2"


def realitycapture(root: Path, *rows: str, header: str = HEADER, first: str = "") -> Path:
    for row in rows:
        draw(root / "images" / row.split(",")[0], 96, 64)
    (root / "export.csv").write_text("\n".join([*([first] if first else []), header, *rows]) + "\n")
    return root


def test_realitycapture_looks_down_with_north_up(tmp_path: Path) -> None:
    """Check the angles of RealityCapture: x is east, y north, z up.

    A camera without angles at height 10 has the nadir in its middle and north at the top; heading 90 has east at the
    top; pitch 90 looks at the horizon, to the north.
    """
    rows = ["a.jpg,1,2,10,0,0,0,18,0,0,0,0,0,0,0,0", "b.jpg,1,2,10,90,0,0,18,0,0,0,0,0,0,0,0"]
    rows += ["c.jpg,1,2,10,0,90,0,18,0,0,0,0,0,0,0,0"]
    a, b, c = read_capture(realitycapture(tmp_path, *rows, first="#cameras 3"), "realitycapture").photos
    focal = 18 * 96 / 36
    for photo in (a, b, c):
        assert photo.K[0, 0] == photo.K[1, 1] == focal and photo.lens is None
    below, north, east, horizon = [1, 2, 0], [1, 3, 0], [2, 2, 0], [1, 12, 10]
    np.testing.assert_allclose(project(a, np.array([below, north])), [[48.0, 32.0], [48.0, 32 - focal / 10]], atol=1e-9)
    np.testing.assert_allclose(project(b, np.array([below, east])), [[48.0, 32.0], [48.0, 32 - focal / 10]], atol=1e-9)
    np.testing.assert_allclose(project(c, np.array([horizon])), [[48, 32]], atol=1e-9)


@pytest.mark.parametrize("header", [HEADER, REALITYSCAN_HEADER])
def test_realitycapture_lens_and_principal_point(tmp_path: Path, header: str) -> None:
    """Check the lens and the principal point against RealityScan's own template for OpenCV.

    The template writes the terms as k1, k2, t2, t1, k3. It writes the principal point in pixels as half the image's
    side and px times the larger side.
    """
    row = "a.jpg,0,0,10,0,0,0,18,0.01,-0.02,0.1,-0.05,0.01,0,0.002,-0.003"
    (photo,) = read_capture(realitycapture(tmp_path, row, header=header), "realitycapture").photos
    K = np.array([[48, 0, 48 + 0.96], [0, 48, 32 - 1.92], [0, 0, 1]])
    points = np.array([[1.0, 2, 0], [-2, 0.5, 1]])
    turn = np.diag([1.0, -1, -1])
    terms = np.array([0.1, -0.05, -0.003, 0.002, 0.01])
    expected, _ = cv2.projectPoints(points, cv2.Rodrigues(turn)[0], np.array([0, 0, 10.0]), K, terms)
    np.testing.assert_allclose(project(photo, points), expected[:, 0], atol=1e-9)


def test_realitycapture_upright_photographs_have_the_principal_point_in_their_height(tmp_path: Path) -> None:
    draw(tmp_path / "a.jpg", 64, 96)
    (tmp_path / "export.csv").write_text(HEADER + "\na.jpg,0,0,10,0,0,0,18,0.01,-0.02,0,0,0,0,0,0\n")
    (photo,) = read_capture(tmp_path, "realitycapture").photos
    np.testing.assert_allclose(photo.K, [[48.0, 0.0, 32 + 0.96], [0.0, 48.0, 48 - 1.92], [0.0, 0.0, 1.0]])


def test_realitycapture_left_out_columns_and_photographs(tmp_path: Path) -> None:
    rows = [f"{name}.jpg,0,0,{i},0,0,0,18" for i, name in enumerate("abc")]
    realitycapture(tmp_path, *rows, header="#name,x,y,alt,heading,pitch,roll,f")
    (tmp_path / "images/b.jpg").unlink()
    folder = SceneFolder.at(tmp_path)
    _, notes = usable_photos(read_capture(tmp_path, "realitycapture"), folder)
    assert notes == ("1 of 3 photographs of export.csv skipped: b.jpg is missing",)
    (tmp_path / "images/c.jpg").unlink()
    with pytest.raises(SceneError, match=r"only 1 of the 3 .* by export\.csv exist \(b\.jpg is missing\); copy"):
        usable_photos(read_capture(tmp_path, "realitycapture"), SceneFolder.at(tmp_path))


def test_realitycapture_paths_of_another_machine_and_other_tables(tmp_path: Path) -> None:
    """Check that photographs count by their file names.

    AppleDouble files and tables of another kind hide no good one.
    """
    realitycapture(tmp_path, "a.jpg,0,0,10,0,0,0,18", header="#name,x,y,alt,heading,pitch,roll,f", first="#cameras 1")
    table = tmp_path / "export.csv"
    table.write_text(table.read_text().replace("a.jpg", r"C:\photos\a.jpg"))
    (tmp_path / "._a.csv").write_text(HEADER)
    (tmp_path / "a.csv").write_text("#name,x,y,alt\na.jpg,0,0,10\n")
    (photo,) = read_capture(tmp_path, "realitycapture").photos
    assert photo.image == tmp_path / "images/a.jpg"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (HEADER + "\n", "export.csv: the table has no rows; align the photographs"),
        (HEADER.replace(",", ";"), r"export\.csv: expected the columns .*, separated by commas, got #name;x;y;alt"),
        ("#cameras 1\n#name,x,y,alt\na,0,0,1\n", r"expected the columns #name,x,.* got #name,x,y,alt; .*External"),
    ],
)
def test_realitycapture_tables_of_other_kinds_name_the_right_export(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "export.csv").write_text(text)
    with pytest.raises(SceneError, match=message):
        read_capture(tmp_path, "realitycapture")


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("a.jpg,0,0,10,0,0,0,nan,0,0,0,0,0,0,0,0", r"row 1 \(a\.jpg\): f: expected a number, got 'nan'"),
        ("a.jpg,0,0,10,0,north,0,18,0,0,0,0,0,0,0,0", r"pitch: expected a number, got 'north'"),
        ("a.jpg,0,0", "row 1: expected 16 values, got 3"),
    ],
)
def test_realitycapture_refusals(tmp_path: Path, row: str, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        read_strictly(realitycapture(tmp_path, row), "realitycapture")


# Polycam


def polycam(root: Path, part: str = "") -> Path:
    for i, pose in enumerate(BALL.poses()):
        draw(root / f"keyframes/{part}images/{100 + i}.jpg", 96, 64)
        opengl = np.linalg.inv(pose) @ np.diag([1.0, -1, -1, 1])
        camera = {f"t_{row}{col}": opengl[row, col] for row in range(3) for col in range(4)}
        camera |= {"fx": 80, "fy": 90, "cx": 30, "cy": 35, "width": 96, "height": 64, "blur_score": 9}
        path = root / f"keyframes/{part}cameras/{100 + i}.json"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(camera))
    return root


def test_polycam_cameras_and_its_corrected_ones_first(tmp_path: Path) -> None:
    polycam(tmp_path)
    for folder in ("", "corrected_"):
        polycam(tmp_path, folder)
        capture = read_capture(tmp_path, "polycam")
        for photo, pose in zip(capture.photos, BALL.poses(), strict=True):
            assert photo.image.parent.name == f"{folder}images"
            np.testing.assert_allclose(photo.cam_from_world, pose, atol=1e-12)
            np.testing.assert_array_equal(photo.K, BALL.K)


def test_polycam_files_of_macos_are_no_cameras(tmp_path: Path) -> None:
    (polycam(tmp_path) / "keyframes/cameras/._100.json").write_bytes(b"\0\5\x16\7 Mac OS X")
    assert len(read_capture(tmp_path, "polycam").photos) == 4


@pytest.mark.parametrize(
    ("text", "message"),
    [("[]", "expected an object with fx"), ('{"t_00": 1}', r"cameras/101\.json: t_01: expected a number, got 'None'")],
)
def test_polycam_refusals(tmp_path: Path, text: str, message: str) -> None:
    (polycam(tmp_path) / "keyframes/cameras/101.json").write_text(text)
    with pytest.raises(SceneError, match=message):
        read_strictly(tmp_path, "polycam")


# OpenSfM and OpenDroneMap

BROWN = {"projection_type": "brown", "focal_x": 0.8, "focal_y": 0.9, "c_x": 0.01, "c_y": -0.02}
BROWN |= {"k1": -0.1, "k2": 0.05, "k3": 0.01, "p1": 0.002, "p2": -0.003}


def opensfm(
    root: Path,
    camera: dict[str, Any] = BROWN,
    place: str = "reconstruction.json",
    change: Callable[[list[dict[str, Any]]], object] = lambda parts: None,
) -> Path:
    shots = {}
    for i, pose in enumerate(BALL.poses()):
        draw(root / f"images/{i}.jpg", 96, 64)
        axis = cv2.Rodrigues(pose[:3, :3])[0][:, 0]
        shots[f"{i}.jpg"] = {"rotation": axis.tolist(), "translation": pose[:3, 3].tolist(), "camera": "c"}
    points = {str(i): {"coordinates": point.tolist(), "color": [i, 0, 9.0]} for i, point in enumerate(POINTS)}
    part = {"cameras": {"c": {"width": 96, "height": 64, **camera}}, "shots": shots, "points": points}
    parts: list[dict[str, Any]] = [{"cameras": {}, "shots": {}}, part]
    change(parts)
    (root / place).parent.mkdir(exist_ok=True)
    (root / place).write_text(json.dumps(parts))
    return root


@pytest.mark.parametrize("place", ["reconstruction.json", "opensfm/reconstruction.json"])
def test_opensfm_cameras_agree_with_opencv(tmp_path: Path, place: str) -> None:
    capture = read_capture(opensfm(tmp_path, place=place), "opensfm")
    K = np.array([[0.8 * 96, 0, 48 + 0.96], [0, 0.9 * 96, 32 - 1.92], [0, 0, 1]])
    terms = np.array([-0.1, 0.05, 0.002, -0.003, 0.01])
    for photo, pose in zip(capture.photos, BALL.poses(), strict=True):
        expected, _ = cv2.projectPoints(POINTS, cv2.Rodrigues(pose[:3, :3])[0], pose[:3, 3], K, terms)
        np.testing.assert_allclose(project(photo, POINTS), expected[:, 0], atol=1e-9)
    assert capture.points is not None
    np.testing.assert_allclose(capture.points.positions, POINTS)
    np.testing.assert_array_equal(capture.points.colors[5], [5, 0, 9])


def test_opensfm_fisheye(tmp_path: Path) -> None:
    camera = {"projection_type": "fisheye", "focal": 0.7, "k1": 0.05, "k2": -0.02}
    photo = read_capture(opensfm(tmp_path, camera), "opensfm").photos[0]
    local = np.array([[0.6, 0.0, 1.0]])
    world = (local - photo.cam_from_world[:3, 3]) @ photo.cam_from_world[:3, :3]
    angle = math.atan(0.6)
    expected = 48 + 0.7 * 96 * (angle + 0.05 * angle**3 - 0.02 * angle**5)
    np.testing.assert_allclose(project(photo, world), [[expected, 32]], atol=1e-9)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda parts: parts.clear(), "expected a list of reconstructions with 'cameras' and 'shots'"),
        (lambda parts: parts[1]["cameras"].clear(), r"shot 0\.jpg: the file lacks camera 'c'; export it again"),
        (
            lambda parts: parts[1]["cameras"]["c"].update(projection_type="spherical"),
            "'spherical' is not supported: a pano",
        ),
        (lambda parts: parts[1]["shots"]["1.jpg"].update(rotation=[1, 2]), r"shot 1\.jpg: rotation: expected a 1x3"),
        (
            lambda parts: parts[1]["shots"]["1.jpg"].update(rotation=[math.nan] * 3),
            r"1\.jpg: the rotation has NaN",
        ),
        (lambda parts: parts[1]["points"]["3"].update(coordinates="here"), "coordinates of points: expected"),
    ],
)
def test_opensfm_refusals(tmp_path: Path, change: Callable[..., Any], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        read_strictly(opensfm(tmp_path, change=change), "opensfm")
