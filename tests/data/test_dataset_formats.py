"""Record3D and the layouts of research data sets.

Each is written as its documentation says and compared in pixels with its equations, which are written out here. The
same twelve cameras are also compared in several of these forms.
"""

from __future__ import annotations

import codecs
import json
import os
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mgsr.data.capture import Capture, Split
from mgsr.data.photo_files import SceneFolder
from mgsr.data.poses import intrinsics
from mgsr.data.safe_pickle import read_pickled_arrays
from mgsr.data.unread import unread_cameras
from mgsr.data.usable import usable_photos
from mgsr.errors import SceneError
from mgsr.open3d_library import load_open3d
from tests.data.captures import SIDE, BallCapture
from tests.data.reading import draw, project, read_capture
from tests.optional import present

BALL = BallCapture(views=4, center=np.array([1.0, -2, 3]))
POINTS = BALL.center + np.random.default_rng(0).uniform(-0.5, 0.5, (20, 3))
MIDDLE = intrinsics(85.0, 85.0, SIDE / 2, SIDE / 2)  # what formats without a principal point can say


def pixels(pose: np.ndarray, K: np.ndarray = BALL.K) -> np.ndarray:
    """Return where a camera (world to camera, OpenCV axes) sees the points, with pixels' centres at +0.5."""
    local = POINTS @ pose[:3, :3].T + pose[:3, 3]
    projected: np.ndarray = (local @ K.T)[:, :2] / local[:, 2:]
    return projected


def assert_sees(capture: Capture, K: np.ndarray = BALL.K, tolerance: float = 1e-6) -> None:
    """Check that all of the ball's cameras are there, in order, and see the points where they are."""
    for photo, pose in zip(capture.photos, BALL.poses(), strict=True):
        np.testing.assert_allclose(project(photo, POINTS), pixels(pose, K), atol=tolerance)


def world_from_cam(pose: np.ndarray) -> np.ndarray:
    return np.linalg.inv(pose)


def matrix_text(matrix: np.ndarray) -> str:
    return "\n".join(" ".join(f"{value:.12g}" for value in row) for row in matrix) + "\n"


def write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")


# Small captures of every format; tests change what they need.


def record3d(root: Path, names: str = "rgb/{}.jpg", file: str = "metadata.json", **more: object) -> Path:
    poses = []
    for i, pose in enumerate(BALL.poses()):
        draw(root / names.format(i))
        axes = world_from_cam(pose) @ np.diag([1, -1, -1, 1])  # OpenGL's camera looks along its -z, with y up
        poses.append([*Rotation.from_matrix(axes[:3, :3]).as_quat(), *axes[:3, 3]])  # SciPy has w last, as Record3D
    content = {"w": SIDE, "h": SIDE, "fps": 60, "dw": 8, "dh": 8, "K": BALL.K.T.ravel().tolist(), "poses": poses}
    write(root / file, json.dumps(content | more))
    return root


def mvsnet(root: Path, cams: str = "cams", photographs: str = "images/{:08d}.jpg", scale: float = 1.0) -> Path:
    for i, pose in enumerate(BALL.poses()):
        draw(root / photographs.format(i))
        K = np.diag([scale, scale, 1]) @ BALL.K
        text = f"extrinsic\n{matrix_text(pose)}\nintrinsic\n{matrix_text(K)}\n425.0 2.5\n"
        write(root / f"{cams}/{i:08d}_cam.txt", text)
    return root


def llff(root: Path, photographs: str = "images/{:03d}.png") -> Path:
    rows = []
    for i, pose in enumerate(BALL.poses()):
        draw(root / photographs.format(i))
        right, down, forward = pose[:3, :3]  # the camera's axes in the world
        center = world_from_cam(pose)[:3, 3]
        matrix = np.stack([down, right, -forward, center, [SIDE, SIDE, 85.0]], axis=1)
        rows.append([*matrix.ravel(), 1.5, 6.0])
    np.save(root / "poses_bounds.npy", np.array(rows))
    return root


def gaussians(root: Path, names: str = "{:03d}", photographs: str = "images/{:03d}.png") -> Path:
    cameras = []
    for i, pose in enumerate(BALL.poses()):
        draw(root / photographs.format(i))
        back = world_from_cam(pose)
        camera = {"id": i, "img_name": names.format(i), "width": SIDE, "height": SIDE, "position": back[:3, 3].tolist()}
        cameras.append(camera | {"rotation": back[:3, :3].tolist(), "fy": 85.0, "fx": 85.0})
    write(root / "cameras.json", json.dumps(cameras))
    write(root / "cfg_args", "Namespace(sh_degree=3, source_path='/data/spot', images='images', eval=True)")
    return root


def nero(root: Path, protocol: int = 4) -> Path:
    for i, pose in enumerate(BALL.poses()):
        draw(root / f"{i}.png")
        draw(root / f"{i}-depth.png")
        (root / f"{i}-camera.pkl").write_bytes(pickle.dumps((pose[:3], BALL.K), protocol=protocol))
    return root


def nsvf(root: Path, prefixes: str = "0122", first: str | None = None) -> Path:
    for i, (prefix, pose) in enumerate(zip(prefixes, BALL.poses(), strict=True)):
        draw(root / f"rgb/{prefix}_{i:04d}.png")
        write(root / f"pose/{prefix}_{i:04d}.txt", matrix_text(world_from_cam(pose)))
    write(root / "intrinsics.txt", first or matrix_text(np.pad(BALL.K, (0, 1)) + np.diag([0, 0, 0, 1])))
    write(root / "bbox.txt", "-1 -1 -1 1 1 1 0.4\n")
    return root


def scannet(root: Path, K: np.ndarray = MIDDLE, folder: str = "color", size: tuple[int, int] = (SIDE, SIDE)) -> Path:
    for i, pose in enumerate(BALL.poses()):
        draw(root / f"{folder}/{i}.jpg", *size)
        write(root / f"pose/{i}.txt", matrix_text(world_from_cam(pose)))
    write(root / "intrinsic/intrinsic_color.txt", matrix_text(np.pad(K, (0, 1)) + np.diag([0, 0, 0, 1])))
    return root


def tanks(root: Path, photographs: str = "images/{:06d}.jpg", header: str = "{0} {0} 0") -> Path:
    lines = []
    for i, pose in enumerate(BALL.poses()):
        draw(root / photographs.format(i + 1))
        lines.append(f"{header.format(i)}\n{matrix_text(world_from_cam(pose))}")
    write(root / "Ball_COLMAP_SfM.log", "".join(lines))
    write(root / "intrinsics.txt", "80 90 30 35\n")
    return root


# The same cameras in several forms


@pytest.mark.parametrize(
    ("folder", "name"), [("blendedmvs", "mvsnet"), ("nero_glossy", "nero"), ("record3d", "record3d")]
)
def test_the_same_twelve_cameras(shared_data: Path, folder: str, name: str) -> None:
    """Check that all formats have the cameras of NeRO's pickles.

    The pickles are read without the reader; another program wrote them as single floats.
    """
    cases = shared_data / "cases/04_unread_formats"
    capture = read_capture(cases / folder, name)
    photos, notes = usable_photos(capture, SceneFolder.at(cases / folder))
    assert len(photos) == 12 and not notes and not capture.notes
    for photo in photos:
        number = int(photo.image.stem)
        pose, K = pickle.loads((cases / f"nero_glossy/{number}-camera.pkl").read_bytes())
        np.testing.assert_allclose(photo.cam_from_world[:3], pose, atol=1e-6)
        np.testing.assert_allclose(photo.K, K, atol=1e-4)
        assert photo.size == (128, 128)
        assert "masked" not in photo.image.name and "depth" not in photo.image.name


def test_gaussian_splatting_without_its_photographs(shared_data: Path) -> None:
    with pytest.raises(
        SceneError, match=r"cameras\.json: this file has the cameras of 3D Gaussian Splatting, but its 12 photo"
    ):
        read_capture(shared_data / "cases/04_unread_formats/3dgs_output", "gaussians")


# Record3D


def test_record3d_cameras(tmp_path: Path) -> None:
    assert_sees(read_capture(record3d(tmp_path), "record3d"))


@pytest.mark.parametrize("names", ["EXR_RGBD/rgb/{:05d}.png", "rgbd/{}.jpg", "{:03d}.jpg"])
def test_record3d_photographs_by_number(tmp_path: Path, names: str) -> None:
    draw(tmp_path / "EXR_RGBD/depth/0.exr".replace(".exr", ".png"))
    capture = read_capture(record3d(tmp_path, names, file="metadata"), "record3d")
    assert [photo.image for photo in capture.photos] == [tmp_path / names.format(i) for i in range(4)]


def test_record3d_photographs_numbered_from_one(tmp_path: Path) -> None:
    record3d(tmp_path)
    for i in reversed(range(4)):
        (tmp_path / f"rgb/{i}.jpg").rename(tmp_path / f"rgb/{i + 1}.jpg")
    assert [photo.image.stem for photo in read_capture(tmp_path, "record3d").photos] == ["1", "2", "3", "4"]


def test_record3d_intrinsics_of_each_frame(tmp_path: Path) -> None:
    frames = [[80.0 + i, 90.0, 30.0, 35.0] for i in range(3)]
    photos = read_capture(record3d(tmp_path, perFrameIntrinsicCoeffs=frames), "record3d").photos
    assert [photo.K[0, 0] for photo in photos] == [80, 81, 82, 80]


def test_record3d_frames_that_can_not_be_used(tmp_path: Path) -> None:
    """Check that one frame without a pose costs that frame, and that a video without any is refused with the cure."""
    path = record3d(tmp_path) / "metadata.json"
    content = json.loads(path.read_text())
    content["poses"][1] = [0] * 7
    content["poses"][2] = [1, 2]
    path.write_text(json.dumps(content))
    capture = read_capture(tmp_path, "record3d")
    assert len(capture.photos) == 2
    assert "frame 1: the pose has the invalid quaternion [0.0, 0.0, 0.0, 0.0]" in str(capture.lost[0])
    assert "frame 2: pose: expected 7 numbers, got '[1, 2]'" in str(capture.lost[1])
    path.write_text(json.dumps(content | {"poses": []}))
    with pytest.raises(SceneError, match=r"metadata\.json: the file has no poses; record with the LiDAR camera"):
        read_capture(tmp_path, "record3d")


def test_another_programs_metadata_is_not_record3ds(tmp_path: Path) -> None:
    write(tmp_path / "metadata.json", json.dumps({"000001": {"warp_id": 0, "appearance_id": 0, "camera_id": 0}}))
    with pytest.raises(StopIteration):
        read_capture(tmp_path, "record3d")


# MVSNet


@pytest.mark.parametrize("cams", ["cams", "cams_1", "Cameras"])
@pytest.mark.parametrize("photographs", ["images/{:08d}.jpg", "blended_images/{:08d}.jpg", "{:08d}.png"])
def test_mvsnet_cameras(tmp_path: Path, cams: str, photographs: str) -> None:
    mvsnet(tmp_path, cams, photographs)
    draw(tmp_path / photographs.replace(".", "_masked.").format(0))
    write(tmp_path / cams / "pair.txt", "1\n0\n0\n")
    assert_sees(read_capture(tmp_path, "mvsnet"))


def test_mvsnet_intrinsics_of_the_reduced_training_set(tmp_path: Path) -> None:
    """Check DTU's training set: its intrinsics are for a quarter of the photographs, which have seven lights."""
    mvsnet(tmp_path, "Cameras/train", "Rectified/scan1_train/rect_{:03d}_3_r5000.png", scale=0.25)
    for path in sorted((tmp_path / "Rectified/scan1_train").iterdir(), reverse=True):
        number = int(path.name[5:8]) + 1  # counted from 1
        path.rename(path.with_name(f"rect_{number:03d}_3_r5000.png"))
        draw(path.with_name(f"rect_{number:03d}_0_r5000.png"))
    photos = read_capture(tmp_path, "mvsnet").photos
    assert [photo.image.name for photo in photos] == [f"rect_{i:03d}_3_r5000.png" for i in range(1, 5)]
    assert all(photo.size == (SIDE // 4, SIDE // 4) for photo in photos)
    np.testing.assert_allclose(photos[0].K[:2], BALL.K[:2] / 4)


def test_mvsnet_reduced_photographs(tmp_path: Path) -> None:
    photos = read_capture(mvsnet(tmp_path, scale=2), "mvsnet").photos
    assert all(photo.size == (2 * SIDE, 2 * SIDE) for photo in photos)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("extrinsic\n1 0 0 0\n", "expected a line 'intrinsic' and 3 rows of numbers after it"),
        ("extrinsic\n1 0 0 0\n\n\n\nintrinsic\n1 0 0\n0 1 0\n0 0 1\n", "extrinsic: expected a 4x4 or 3x4 matrix"),
        ("extrinsic\nfoo\nintrinsic\n", "expected numbers: could not convert"),
        ("", "00000001_cam.txt is an empty file"),
    ],
)
def test_mvsnet_one_damaged_camera_costs_one_photograph(tmp_path: Path, text: str, message: str) -> None:
    mvsnet(tmp_path)
    write(tmp_path / "cams/00000001_cam.txt", text)
    capture = read_capture(tmp_path, "mvsnet")
    assert len(capture.photos) == 3
    assert message in str(capture.lost[0]) and "00000001_cam.txt" in str(capture.lost[0])


# LLFF


def test_llff_cameras(tmp_path: Path) -> None:
    assert_sees(read_capture(llff(tmp_path), "llff"), MIDDLE)


def test_llff_reduced_photographs(tmp_path: Path) -> None:
    """Check that the focal length is for the size in the file, although the photographs of images_8 are smaller."""
    llff(tmp_path, "images_8/image{:03d}.png")
    photos = read_capture(tmp_path, "llff").photos
    assert [photo.image.name for photo in photos] == [f"image{i:03d}.png" for i in range(4)]
    assert all(photo.size == (SIDE, SIDE) for photo in photos)


def test_llff_takes_the_folder_with_as_many_photographs_as_poses(tmp_path: Path) -> None:
    llff(tmp_path, "images_4/{:03d}.png")
    draw(tmp_path / "images/other.png")
    assert read_capture(tmp_path, "llff").photos[0].image == tmp_path / "images_4/000.png"


def test_llff_photographs_that_have_poses_are_listed(tmp_path: Path) -> None:
    llff(tmp_path)
    draw(tmp_path / "images/001a.png")
    with pytest.raises(SceneError, match=r"it has 4 cameras, but images has 5 photographs; .*view_imgs\.txt"):
        read_capture(tmp_path, "llff")
    write(tmp_path / "view_imgs.txt", "\n".join(f"{i:03d}.png" for i in range(4)))
    assert_sees(read_capture(tmp_path, "llff"), MIDDLE)


def test_llff_videos_in_place_of_photographs(tmp_path: Path) -> None:
    llff(tmp_path)
    for path in (tmp_path / "images").iterdir():
        path.rename(tmp_path / f"cam{path.stem}.mp4")
    with pytest.raises(SceneError, match="but there are no photographs; extract one frame of each video"):
        read_capture(tmp_path, "llff")


def npy(header: str) -> bytes:
    text = header.ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text.encode()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is an empty file"),
        (b"PK\3\4", "damaged"),
        (
            npy("{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000, 17), }"),
            "damaged: expected an array of numbers, got float64",
        ),
        (npy("{'descr': '<f8', 'fortran_order': False, 'shape': (4, 17),"), "damaged: .*EOF in multi-line"),
        (
            npy("{'descr': '|O', 'fortran_order': False, 'shape': (1,), }"),
            "damaged: expected an array of numbers, got object",
        ),
        (npy("{'descr': '<f8', 'fortran_order': False, 'shape': (0, 17), }"), r"got an array of shape \[0, 17\]"),
    ],
)
def test_llff_damaged_arrays(tmp_path: Path, content: bytes, message: str) -> None:
    (llff(tmp_path) / "poses_bounds.npy").write_bytes(content)
    with pytest.raises(SceneError, match=rf"poses_bounds\.npy.*{message}"):
        read_capture(tmp_path, "llff")


# 3D Gaussian Splatting


@pytest.mark.parametrize("names", ["{:03d}", "{:03d}.png", "/data/spot/images/{:03d}.jpg"])
def test_gaussian_splatting_cameras(tmp_path: Path, names: str) -> None:
    assert_sees(read_capture(gaussians(tmp_path, names), "gaussians"), MIDDLE)


def test_gaussian_splatting_principal_point_of_its_forks(tmp_path: Path) -> None:
    path = gaussians(tmp_path) / "cameras.json"
    path.write_text(json.dumps([camera | {"cx": 30.0, "cy": 35.0} for camera in json.loads(path.read_text())]))
    assert_sees(read_capture(tmp_path, "gaussians"), intrinsics(85, 85, 30, 35))


def test_gaussian_splatting_numbers_without_bounds_lose_one_camera(tmp_path: Path) -> None:
    """Check that a whole number too large for any float, which JSON may hold, loses one camera."""
    path = gaussians(tmp_path) / "cameras.json"
    cameras = json.loads(path.read_text())
    cameras[1]["rotation"][0][0] = 10**400
    path.write_text(json.dumps(cameras))
    capture = read_capture(tmp_path, "gaussians")
    assert len(capture.photos) == 3
    assert "cameras.json, camera 1: rotation: expected 3 numbers" in str(capture.lost[0])


def test_gaussian_splatting_renders_are_no_photographs(tmp_path: Path) -> None:
    """Check that renders are not taken for photographs.

    Renders and their references are numbered, in another order than the cameras; the source is only named.
    """
    gaussians(tmp_path, "{:05d}", "train/ours_30000/gt/{:05d}.png")
    with pytest.raises(SceneError, match=r"trained on /data/spot\); copy them to images/ beside cameras\.json"):
        read_capture(tmp_path, "gaussians")


def test_gaussian_splatting_points_of_the_start(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    gaussians(tmp_path)
    trimesh.PointCloud(np.eye(3)).export(tmp_path / "input.ply")
    np.testing.assert_allclose(present(read_capture(tmp_path, "gaussians").points).positions, np.eye(3))
    (tmp_path / "input.ply").write_bytes(b"ply\nnot really")
    assert "the points are ignored: input.ply" in read_capture(tmp_path, "gaussians").notes[0]


@pytest.mark.parametrize("content", ["[]", "[1]", '{"views": []}', "[{}]"])
def test_other_lists_are_not_gaussian_splattings(tmp_path: Path, content: str) -> None:
    from mgsr.data.formats import gaussians as reader

    write(tmp_path / "cameras.json", content)
    assert reader.recognises(tmp_path) is None


# NeRO


@pytest.mark.parametrize("protocol", range(6))
def test_nero_cameras(tmp_path: Path, protocol: int) -> None:
    capture = read_capture(nero(tmp_path, protocol), "nero")
    assert_sees(capture)
    assert [photo.image.name for photo in capture.photos] == ["0.png", "1.png", "2.png", "3.png"]


@pytest.mark.parametrize(
    "value",
    [
        np.arange(12, dtype=">f4").reshape(3, 4),
        np.asfortranarray(np.arange(12.0).reshape(3, 4)),
        [[1, 2.5], [3, 4]],
        [np.float64(2), np.int32(3)],
    ],
)
@pytest.mark.parametrize("protocol", range(6))
def test_pickled_arrays(
    tmp_path: Path, value: list[list[float] | np.float64 | np.int32] | np.ndarray, protocol: int
) -> None:
    path = tmp_path / "a.pkl"
    path.write_bytes(pickle.dumps((value, value), protocol=protocol))
    if isinstance(value, list) and isinstance(value[0], np.float64):
        path.write_bytes(pickle.dumps(value, protocol=protocol))
        assert [float(array) for array in read_pickled_arrays(path, "a.pkl")] == [2, 3]
        return
    for array in read_pickled_arrays(path, "a.pkl"):
        np.testing.assert_array_equal(array, np.asarray(value))


def test_arrays_pickled_under_numpys_older_names(tmp_path: Path) -> None:
    """Check old pickles: numpy 1 has numpy.core where numpy 2 has numpy._core; Python 2 has bytes as text."""
    data = pickle.dumps((np.eye(3), np.eye(3)), protocol=2)
    old = data.replace(b"cnumpy._core.multiarray", b"cnumpy.core.multiarray")
    assert old != data
    (tmp_path / "a.pkl").write_bytes(old)
    np.testing.assert_array_equal(read_pickled_arrays(tmp_path / "a.pkl", "a.pkl")[1], np.eye(3))


class Call:
    """An object that pickles to a call of any function."""

    def __init__(self, function: object, *arguments: object) -> None:
        self.call = (function, arguments)

    def __reduce__(self) -> tuple[object, tuple[object, ...]]:
        return self.call


def bomb(depth: int) -> tuple[Any, ...]:
    """Return nested tuples that take little space in a file, but that never end when printed."""
    value: tuple[Any, ...] = ()
    for _ in range(depth):
        value = (value, value)
    return value


HOSTILE = {
    "system": pickle.dumps(Call(os.system, "touch ran")),
    "eval": pickle.dumps((Call(eval, "open('ran', 'w')"), np.eye(3))),
    "old_system": b"cos\nsystem\n(S'touch ran'\ntR.",
    "nested": pickle.dumps((np.eye(3), [Call(os.system, "touch ran")])),
    "codec": pickle.dumps((Call(codecs.encode, "a" * 10, "zip_codec"), np.eye(3))),
    "numpy_load": pickle.dumps(Call(np.fromfile, "/etc/passwd")),
    "huge_array": pickle.dumps((Call(np.zeros, 10**12), np.eye(3))),
    "huge_shape": b"cnumpy._core.multiarray\n_reconstruct\n(cnumpy\nndarray\n(I1000000000000\ntS'b'\ntR.",
    "huge_memo": b"\x80\x02]r\xff\xff\xff\x7f.",
    "huge_bytes": b"\x80\x04\x8e\xff\xff\xff\xff\xff\xff\xff\x7fa.",
    "huge_text": b"\x80\x04X\xff\xff\xff\x7fa.",
    "bomb": pickle.dumps(bomb(100)),
    "key_bomb": b"\x80\x02}" + pickle.dumps(bomb(60), protocol=2)[2:-1] + b"K\x01s.",  # whoever hashes it never ends
    "itself": b"\x80\x02]q\x00h\x00a.",
    "deep": b"\x80\x02" + b"(" * 30_000 + b"t" * 30_000 + b".",
    "objects": pickle.dumps((np.array([None, {}], dtype=object), np.eye(3))),
    "no_pickle": b"hello",
    "truncated": pickle.dumps((np.eye(3), np.eye(3)))[:60],
    "other_state": b"\x80\x02cnumpy\ndtype\n)R(I1\nI2\nI3\ntb.",
    "state_of_a_class": b"\x80\x02cnumpy\ndtype\n(I1\ntb.",
    "method": b"\x80\x04\x8c\x05numpy\x8c\x0fndarray.tofile\x93.",
    "large": pickle.dumps((np.zeros(20_000), np.eye(3))),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_pickles_run_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """Check that each costs its photograph alone, with a short message, and no time or memory."""
    nero(tmp_path)
    (tmp_path / "1-camera.pkl").write_bytes(HOSTILE[name])
    monkeypatch.chdir(tmp_path)  # where they would write
    capture = read_capture(tmp_path, "nero")
    assert len(capture.photos) == 3 and len(capture.lost) == 1
    message = str(capture.lost[0])
    assert message.startswith("1-camera.pkl: expected a pickled tuple of numeric arrays: ") and len(message) < 400
    assert message.endswith("copy it again")
    assert not (tmp_path / "ran").exists()


def test_a_pickle_that_would_run_a_program_runs_none(tmp_path: Path) -> None:
    """Check that reading runs nothing, although unpickling the same file does."""
    nero(tmp_path)
    ran = tmp_path / "ran"
    data = pickle.dumps((Call(os.system, f"touch {ran}"), np.eye(3)))
    (tmp_path / "1-camera.pkl").write_bytes(data)
    read_capture(tmp_path, "nero")
    assert not ran.exists()
    pickle.loads(data)
    assert ran.exists()


# NSVF


def test_nsvf_cameras_and_split(tmp_path: Path) -> None:
    capture = read_capture(nsvf(tmp_path), "nsvf")
    assert [photo.split for photo in capture.photos] == [Split.TRAIN, Split.TEST, Split.TEST]
    assert capture.notes == ("1 validation views are ignored because there are test views",)
    for photo in capture.photos:
        pose = BALL.poses()[int(photo.image.stem.split("_")[1])]
        np.testing.assert_allclose(project(photo, POINTS), pixels(pose), atol=1e-6)


def test_nsvf_validation_is_the_test_where_there_is_no_other(tmp_path: Path) -> None:
    capture = read_capture(nsvf(tmp_path, "0001"), "nsvf")
    assert_sees(capture)
    assert [photo.split for photo in capture.photos] == [Split.TRAIN] * 3 + [Split.TEST]


@pytest.mark.parametrize(
    ("text", "K", "size"),
    [
        ("85 32 32 0.\n0. 0. 0.\n0.\n1.\n64 64\n", MIDDLE, (64, 64)),
        ("85 32 32\n0 0 0\n1\n64 64\n", MIDDLE, (64, 64)),
        ("85 0 32\n0 85 32\n0 0 1\n", MIDDLE, (64, 64)),
        ("85 32 32 0.\n", MIDDLE, (64, 64)),
        ("85 85 32 32\n", MIDDLE, (64, 64)),
        ("170 0 64 0 0 170 64 0 0 0 1 0 0 0 0 1\n", intrinsics(170, 170, 64, 64), (128, 128)),
        ("437.5 256 256 0.\n0 0 0\n0\n1\n512 512\n", intrinsics(437.5, 437.5, 256, 256), (512, 512)),
    ],
)
def test_nsvf_forms_of_intrinsics(tmp_path: Path, text: str, K: np.ndarray, size: tuple[int, int]) -> None:
    photos = read_capture(nsvf(tmp_path, "0000", text), "nsvf").photos
    np.testing.assert_allclose(photos[0].K, K)
    assert photos[0].size == size


def test_nerf_plus_plus_has_intrinsics_for_each_photograph(tmp_path: Path) -> None:
    for part, numbers in (("train", range(3)), ("test", [3])):
        for i in numbers:
            draw(tmp_path / part / f"rgb/{i % 3:06d}.png")
            for folder, matrix in (("pose", world_from_cam(BALL.poses()[i])), ("intrinsics", np.pad(BALL.K, (0, 1)))):
                matrix = matrix + (0 if folder == "pose" else np.diag([0, 0, 0, 1]))
                write(tmp_path / part / folder / f"{i % 3:06d}.txt", " ".join(map(str, matrix.ravel())))
    capture = read_capture(tmp_path, "nsvf")
    assert_sees(capture)
    assert [photo.split for photo in capture.photos] == [Split.TRAIN] * 3 + [Split.TEST]
    assert capture.photos[3].image == tmp_path / "test/rgb/000000.png"


def test_nsvf_one_damaged_pose_costs_one_photograph(tmp_path: Path) -> None:
    nsvf(tmp_path, "0000")
    write(tmp_path / "pose/0_0001.txt", "1 2 3\n")
    write(tmp_path / "pose/0_0002.txt", "1 0 0 -nan(ind)\n0 1 0 0\n0 0 1 0\n0 0 0 1\n")
    capture = read_capture(tmp_path, "nsvf")
    assert len(capture.photos) == 2
    assert "0_0001.txt: expected a pose of 3x4 or 4x4 numbers, got 3; fix the file" in str(capture.lost[0])
    assert "NaN or infinite" in str(capture.lost[1])


def test_nsvf_damaged_intrinsics(tmp_path: Path) -> None:
    nsvf(tmp_path, "0000", "1 2\n")
    capture = read_capture(tmp_path, "nsvf")
    with pytest.raises(SceneError, match=r"intrinsics\.txt: expected intrinsics as a 3x3 or 4x4 matrix"):
        usable_photos(capture, SceneFolder.at(tmp_path))


# ScanNet


def test_scannet_cameras(tmp_path: Path) -> None:
    assert_sees(read_capture(scannet(tmp_path), "scannet"), MIDDLE)


@pytest.mark.parametrize("beside", [0.0, -0.25, -0.5])
def test_scannet_principal_point_is_the_middle(tmp_path: Path, beside: float) -> None:
    """Check that principal points near the middle are the middle.

    They are (W-1)/2 of the photograph, or a half of that of a photograph twice as large: 647.75 for 1296 pixels.
    """
    K = intrinsics(85, 85, 32 + beside, 32 + beside)
    assert_sees(read_capture(scannet(tmp_path, K), "scannet"), MIDDLE)


def test_scannet_other_principal_points_count_from_the_middle_of_the_first_pixel(tmp_path: Path) -> None:
    K = intrinsics(80, 90, 29.5, 34.5)
    assert_sees(read_capture(scannet(tmp_path, K), "scannet"))


def test_scannet_reduced_photographs(tmp_path: Path) -> None:
    """Check photographs of 640x480 with the intrinsics of 1296x968, which has nearly the same shape."""
    K = intrinsics(1170.19, 1170.19, 647.75, 483.75)
    photo = read_capture(scannet(tmp_path, K, size=(640, 480)), "scannet").photos[0]
    np.testing.assert_allclose(photo.K, intrinsics(1170.19 * 640 / 1296, 1170.19 * 480 / 968, 320, 240))
    assert photo.size == (640, 480)


def test_scannet_frames_without_tracking_are_left_out(tmp_path: Path) -> None:
    scannet(tmp_path)
    for i in (1, 2, 3):
        write(tmp_path / f"pose/{i}.txt", "-inf -inf -inf -inf\n" * 4)
    capture = read_capture(tmp_path, "scannet")
    photos, notes = usable_photos(capture, SceneFolder.at(tmp_path))
    assert [photo.image.name for photo in photos] == ["0.jpg"]
    assert notes == ("3 of 4 photographs skipped: pose/1.txt: the frame has no pose, because tracking was lost",)


# Tanks and Temples


@pytest.mark.parametrize("photographs", ["images/{:06d}.jpg", "Ball/{:06d}.jpg", "{:06d}.png", "frames/f{:02d}.png"])
@pytest.mark.parametrize("header", ["{0} {0} 0", "{0} {0} 4", "0 0 5"])
def test_tanks_cameras(tmp_path: Path, photographs: str, header: str) -> None:
    assert_sees(read_capture(tanks(tmp_path, photographs, header), "tanks"))


def test_tanks_log_agrees_with_open3d(tmp_path: Path) -> None:
    log = tanks(tmp_path) / "Ball_COLMAP_SfM.log"
    trajectory = load_open3d().io.read_pinhole_camera_trajectory(str(log))
    for photo, camera in zip(read_capture(tmp_path, "tanks").photos, trajectory.parameters, strict=True):
        np.testing.assert_allclose(photo.cam_from_world, camera.extrinsic, atol=1e-9)


def test_tanks_photographs_without_a_pose(tmp_path: Path) -> None:
    """Check that photographs without a pose are left out.

    The toolbox writes the identity for what COLMAP left out, and -1 above it.
    """
    log = tanks(tmp_path) / "Ball_COLMAP_SfM.log"
    lines = log.read_text().splitlines()
    lines[5:10] = ["1 -1 0", *matrix_text(np.eye(4)).splitlines()]
    log.write_text("\n".join(lines))
    capture = read_capture(tmp_path, "tanks")
    assert [photo.image.name for photo in capture.photos] == ["000001.jpg", "000003.jpg", "000004.jpg"]
    assert capture.notes == ("Ball_COLMAP_SfM.log has no pose of 1 of 4 photographs",)


def test_tanks_photographs_that_were_taken_out(tmp_path: Path) -> None:
    (tanks(tmp_path) / "images/000002.jpg").unlink()
    capture = read_capture(tmp_path, "tanks")
    assert [photo.image.name for photo in capture.photos] == ["000001.jpg", "000003.jpg", "000004.jpg"]
    np.testing.assert_allclose(capture.photos[1].cam_from_world, BALL.poses()[2], atol=1e-9)
    assert "000002 is missing" in str(capture.missing[0])


def test_tanks_log_and_photographs_cut_alike(tmp_path: Path) -> None:
    """Check every second entry and photograph: their numbers have gaps, but their order is the same."""
    log = tanks(tmp_path) / "Ball_COLMAP_SfM.log"
    lines = log.read_text().splitlines()
    log.write_text("\n".join(lines[:5] + lines[10:15]))
    for number in (2, 4):
        (tmp_path / f"images/{number:06d}.jpg").unlink()
    capture = read_capture(tmp_path, "tanks")
    assert [photo.image.name for photo in capture.photos] == ["000001.jpg", "000003.jpg"]
    np.testing.assert_allclose(capture.photos[1].cam_from_world, BALL.poses()[2], atol=1e-9)


def test_tanks_count_of_photographs(tmp_path: Path) -> None:
    draw(tanks(tmp_path, "images/a{:03d}.jpg") / "images/b.jpg")
    with pytest.raises(
        SceneError,
        match="it has 4 poses, but images has 5 photographs; poses follow the order of the photo",
    ):
        read_capture(tmp_path, "tanks")


def test_tanks_without_intrinsics(tmp_path: Path) -> None:
    """Check that missing intrinsics are refused.

    The 0.7 widths that the benchmark suggests do not fit its own models.
    """
    (tanks(tmp_path) / "intrinsics.txt").unlink()
    with pytest.raises(
        SceneError, match=r"Ball_COLMAP_SfM\.log: it has poses but no intrinsics; write .* to intrinsics\.txt"
    ):
        read_capture(tmp_path, "tanks")


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("camera_primesense.param", "80\n90\n30\n35\n2.5\n2.5\n"),
        ("intrinsic.json", json.dumps({"width": SIDE, "height": SIDE, "intrinsic_matrix": BALL.K.T.ravel().tolist()})),
        ("camera.json", json.dumps({"fx": 80, "fy": 90, "cx": 30, "cy": 35})),
        ("K.txt", matrix_text(BALL.K)),
    ],
)
def test_tanks_forms_of_intrinsics(tmp_path: Path, name: str, text: str) -> None:
    (tanks(tmp_path) / "intrinsics.txt").unlink()
    write(tmp_path / name, text)
    assert_sees(read_capture(tmp_path, "tanks"))


def test_tanks_truncated_log(tmp_path: Path) -> None:
    log = tanks(tmp_path) / "Ball_COLMAP_SfM.log"
    log.write_text("\n".join(log.read_text().splitlines()[:-2]))
    with pytest.raises(
        SceneError, match=r"Ball_COLMAP_SfM\.log: entry 3: expected three numbers and four rows of four"
    ):
        read_capture(tmp_path, "tanks")


def test_another_log_is_no_trajectory(tmp_path: Path) -> None:
    from mgsr.data.formats import tanks as reader

    write(tmp_path / "train.log", "iteration 1\n1 2 3\n")
    assert reader.recognises(tmp_path) is None


# Cameras that are named and not read

UNREAD = {
    "Stray Scanner": ["camera_matrix.csv", "odometry.csv", "rgb.mp4"],
    "3D Scanner App": ["frame_00000.json", "frame_00000.jpg", "info.json"],
    "ARKitScenes": ["41048190_frames/lowres_wide.traj"],
    "Project Aria": ["recording.vrs"],
    "ScanNet++": ["iphone/pose_intrinsic_imu.json"],
    "Metashape": ["project.psx", "project.files/project.zip"],
    "RealityCapture": ["project.rcproj", "photographs/1.jpg"],
    "Pix4D": ["project.p4d", "photographs/1.jpg"],
    "OpenMVG": ["sfm_data.bin", "images/1.jpg"],
    "Meshroom": ["sfm.abc", "images/1.jpg"],
    "OpenMVS": ["scene.mvs"],
    "MVE": ["views/view_0000.mve/meta.ini", "synth_0.out"],
    "COLMAP, without poses": ["database.db", "images/1.jpg"],
    "ScanNet": ["scene0000_00.sens"],
    "SDFStudio": ["meta_data.json"],
    "Nerfies or HyperNeRF": ["camera/000001.json", "dataset.json"],
    "CO3D": ["apple/frame_annotations.jgz"],
    "MegaDepth": ["dense0/imgs/1.jpg", "dense0/depths/1.h5"],
    "DTU": ["Calibration/cal18/pos_001.txt"],
    "TUM RGB-D": ["groundtruth.txt", "rgb.txt", "rgb/1.png"],
    "7-Scenes": ["seq-01/frame-000000.pose.txt"],
    "Replica": ["traj.txt", "results/frame000000.jpg"],
    "KITTI": ["poses.txt", "calib.txt"],
    "Blender": ["scene.blend"],
    "Mitsuba": ["scene.xml"],
    "a USD file": ["cameras.usda"],
}
CONTENTS = {
    "frame_00000.json": '{"cameraPoseARFrame": []}',
    "database.db": "SQLite format 3\0 CREATE TABLE cameras (camera_id INTEGER)",
    "meta_data.json": '{"frames": [{"camtoworld": []}]}',
    "scene.xml": '<scene version="3.0.0"><sensor type="perspective"/></scene>',
    "cameras.usda": '#usda 1.0\ndef Camera "one" {}',
}


@pytest.mark.parametrize("program", UNREAD)
def test_cameras_that_are_not_read_are_named(tmp_path: Path, program: str) -> None:
    for name in UNREAD[program]:
        write(tmp_path / name, CONTENTS.get(Path(name).name, "x"))
    said = unread_cameras(tmp_path)
    assert said is not None and said.startswith(f"the cameras are of {program} (")
    assert "), which MGSR does not read; " in said and len(said) < 400
    named = said.split("(", 1)[1].split(")")[0]
    assert (tmp_path / named).exists()


@pytest.mark.parametrize(
    ("name", "content", "parts"),
    [
        ("sfm_data.bin", "x", ("OpenMVG", "`openMVG_main_ConvertSfM_DataFormat -i sfm_data.bin -o sfm_data.json`")),
        ("sfm.abc", "x", ("Meshroom", "ConvertSfMFormat, with sfm as the format")),
        ("aligned.abc", "mvg_intrinsicType", ("Meshroom", "ConvertSfMFormat, with sfm as the format")),
        ("scan.abc", "camera", ("an Alembic file", "export them from its program")),
    ],
)
def test_how_to_convert_cameras_is_said(tmp_path: Path, name: str, content: str, parts: tuple[str, str]) -> None:
    write(tmp_path / "inner" / name, content)
    said = unread_cameras(tmp_path)
    assert said is not None and f"(inner/{name})" in said
    for part in parts:
        assert part in said


@pytest.mark.parametrize(
    "names",
    [[], ["1.jpg", "info.json"], ["scan.usdz", "scan.fbx", "scan.abc", "notes.xml"], ["a.db"], ["meta_data.json"]],
)
def test_files_that_are_no_cameras(tmp_path: Path, names: list[str]) -> None:
    for name in names:
        write(tmp_path / name, "x")
    assert unread_cameras(tmp_path) is None


def test_unread_cameras_of_a_folder_that_is_not_there(tmp_path: Path) -> None:
    assert unread_cameras(tmp_path / "none") is None
