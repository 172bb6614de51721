"""COLMAP models that pycolmap wrote, held to pycolmap's own projection."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import map_coordinates

from mgsr.config import DataConfig
from mgsr.data.formats import all_formats
from mgsr.data.readers import load_scene
from mgsr.data.scene import Scene
from mgsr.errors import SceneError
from tests.data.captures import BallCapture
from tests.data.reading import draw, read_capture

pycolmap = pytest.importorskip("pycolmap")

WIDTH, HEIGHT = 96, 64
PARAMS = {
    "SIMPLE_PINHOLE": [110, 45, 30],
    "PINHOLE": [110, 120, 45, 30],
    "SIMPLE_RADIAL": [110, 47, 31, -0.12],
    "RADIAL": [110, 47, 31, 0.15, -0.05],
    "OPENCV": [110, 120, 47, 31, -0.2, 0.06, 0.01, -0.008],
    "OPENCV_FISHEYE": [110, 120, 47, 31, 0.05, -0.02, 0.01, -0.005],
    "FULL_OPENCV": [110, 120, 47, 31, -0.2, 0.06, 0.01, -0.008, 0.02, 0.03, 0.01, 0.005],
}


def paint(camera: Any) -> np.ndarray:
    """Return a smooth picture of the rays' directions, as the camera with its lens sees it.

    The undistorted image is then known in closed form.
    """
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    rays = camera.cam_from_img(np.stack([x.ravel(), y.ravel()], axis=1))
    return pattern(rays).reshape(HEIGHT, WIDTH, 3)


def pattern(rays: np.ndarray) -> np.ndarray:
    u, v = rays[:, 0], rays[:, 1]
    colors = np.stack([np.sin(9 * u), np.cos(11 * v), np.sin(7 * (u + v))], axis=-1)
    return np.rint(127.5 + 100 * colors).astype(np.uint8)


def write(root: Path, model: str, text: bool = False, place: str = "sparse/0") -> Any:
    reconstruction = pycolmap.Reconstruction()
    camera = pycolmap.Camera.create_from_model_name(1, model, 100.0, WIDTH, HEIGHT)
    camera.params = PARAMS.get(model, camera.params)
    reconstruction.add_camera_with_trivial_rig(camera)
    (root / "images").mkdir(parents=True, exist_ok=True)
    for i, pose in enumerate(BallCapture(views=10, center=np.array([1.0, 2, 3])).poses(), start=1):
        name = f"photo {i:02d}.png"
        image = pycolmap.Image(name=name, camera_id=1, image_id=i)
        reconstruction.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pose[:3]))
        picture = paint(camera) if model in PARAMS else np.zeros((HEIGHT, WIDTH, 3), np.uint8)
        Image.fromarray(picture).save(root / "images" / name)
    points = np.random.default_rng(0).normal(size=(40, 3)) * 0.3 + [1, 2, 3]
    for point in points:
        reconstruction.add_point3D(point, pycolmap.Track(), np.array([10, 20, 30], np.uint8))
    folder = root / place
    folder.mkdir(parents=True, exist_ok=True)
    (reconstruction.write_text if text else reconstruction.write_binary)(str(folder))
    return reconstruction


def check_cameras(scene: Scene, reconstruction: Any, model: str) -> None:
    """Check that undistorted pinholes see the same rays as pycolmap's cameras, on which its lens then acts."""
    points = np.random.default_rng(2).normal(size=(30, 3)) * 0.2 + [1, 2, 3]
    images = {Path(image.name).stem: image for image in reconstruction.images.values()}
    for view in scene.train + scene.test:
        rigid = images[view.name].cam_from_world()
        local = points @ rigid.rotation.matrix().T + rigid.translation
        pixels, depth = view.camera.project(scene.user_from_scene.to_scene(points))
        np.testing.assert_allclose(depth * scene.user_from_scene.scale, local[:, 2], atol=1e-6)
        if "PINHOLE" in model:
            camera = reconstruction.cameras[1]
            np.testing.assert_allclose(pixels, camera.img_from_cam(local), atol=1e-6)
        else:
            rays = (pixels - view.camera.K[:2, 2]) / view.camera.K[[0, 1], [0, 1]]
            np.testing.assert_allclose(rays, local[:, :2] / local[:, 2:], atol=1e-9)


@pytest.mark.parametrize("text", [False, True], ids=["binary", "text"])
@pytest.mark.parametrize("model", PARAMS)
def test_cameras_agree_with_pycolmap(tmp_path: Path, model: str, text: bool) -> None:
    reconstruction = write(tmp_path, model, text)
    scene = load_scene(tmp_path, DataConfig())
    assert scene.format == "colmap" and (len(scene.train), len(scene.test)) == (8, 2)
    assert scene.points is not None
    positions = scene.user_from_scene.to_user(scene.points.positions)
    expected = np.array([point.xyz for point in reconstruction.points3D.values()])
    np.testing.assert_allclose(np.sort(positions, axis=0), np.sort(expected, axis=0), atol=1e-6)
    assert (scene.points.colors == [10, 20, 30]).all()
    check_cameras(scene, reconstruction, model)


@pytest.mark.parametrize("model", ["SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE", "FULL_OPENCV"])
def test_images_are_undistorted(tmp_path: Path, model: str) -> None:
    """Check that each pixel shows what a pinhole sees along its ray: the pattern in closed form.

    2 grey levels are the rounding of both images and the bicubic interpolation.
    """
    write(tmp_path, model)
    view = load_scene(tmp_path, DataConfig()).train[0]
    height, width = view.image.shape[:2]
    y, x = np.mgrid[:height, :width] + 0.5
    K = view.camera.K
    rays = np.stack([(x - K[0, 2]) / K[0, 0], (y - K[1, 2]) / K[1, 1]], axis=-1).reshape(-1, 2)
    expected = pattern(rays).reshape(height, width, 3).astype(int)
    error = np.abs(view.image - expected)[1:-1, 1:-1]
    assert error.max() <= 3 and error.mean() < 0.7
    assert width > 0.8 * WIDTH and height > 0.8 * HEIGHT


def test_resampling_agrees_with_scipys_spline(tmp_path: Path) -> None:
    from mgsr.data.lens import Lens
    from mgsr.data.undistortion import resample, undistortion

    K = np.array([[60.0, 0, 47], [0, 60, 31], [0, 0, 1]])
    image = np.random.default_rng(0).random((HEIGHT, WIDTH, 3)).astype(np.float32)
    for _ in range(3):  # smooth: the kernels of the two differ on noise
        image = np.sum([np.roll(image, shift, axis) for shift in (-1, 0, 1) for axis in (0, 1)], axis=0) / 6
    how = undistortion(Lens(k1=0.05), K, WIDTH, HEIGHT, "test")
    expected = map_coordinates(image[..., 0], [how.map_y, how.map_x], order=3, mode="nearest")
    np.testing.assert_allclose(resample(image, how)[3:-3, 3:-3, 0], expected[3:-3, 3:-3], atol=0.02)


def test_a_lens_that_folds_is_cut_before_the_fold() -> None:
    from mgsr.data.lens import Lens
    from mgsr.data.undistortion import undistortion

    K = np.array([[30.0, 0, 48], [0, 30, 32], [0, 0, 1]])
    how = undistortion(Lens(k1=-0.3), K, WIDTH, HEIGHT, "test")
    known = how.valid_mask
    assert known is not None and 0.2 < known.mean() < 1
    assert (np.diff(how.map_x, axis=1)[known[:, 1:] & known[:, :-1]] > 0).all()
    assert (np.diff(how.map_y, axis=0)[known[1:] & known[:-1]] > 0).all()


def test_rigs_of_two_cameras_have_their_images_own_poses(tmp_path: Path) -> None:
    """Check that images of a rig have their own poses.

    Newer models keep poses by frame; COLMAP's images file still has each image's, the sensor's place included.
    """
    rig = pycolmap.Rig(rig_id=1)
    cameras = [pycolmap.Camera.create_from_model_name(i, "PINHOLE", 100.0, WIDTH, HEIGHT) for i in (1, 2)]
    right = pycolmap.Rigid3d(pycolmap.Rotation3d(np.array([0.0, 0.1, 0.0, 0.995])), np.array([-0.3, 0.05, 0.02]))
    rig.add_ref_sensor(cameras[0].sensor_id)
    rig.add_sensor(cameras[1].sensor_id, right)
    reconstruction = pycolmap.Reconstruction()
    for camera in cameras:
        reconstruction.add_camera(camera)
    reconstruction.add_rig(rig)
    (tmp_path / "images").mkdir()
    for i, pose in enumerate(BallCapture(views=4).poses(), start=1):
        frame = pycolmap.Frame(frame_id=i, rig_id=1, rig_from_world=pycolmap.Rigid3d(pose[:3]))
        images = [pycolmap.Image(name=f"{side}{i}.png", camera_id=side, image_id=2 * i + side) for side in (1, 2)]
        for image in images:
            draw(tmp_path / "images" / image.name)
            image.frame_id = i
            frame.add_data_id(image.data_id)
        reconstruction.add_frame(frame)
        for image in images:
            reconstruction.add_image(image)
        reconstruction.register_frame(i)
    (tmp_path / "sparse/0").mkdir(parents=True)
    reconstruction.write_binary(str(tmp_path / "sparse/0"))
    assert (tmp_path / "sparse/0/rigs.bin").is_file() and (tmp_path / "sparse/0/frames.bin").is_file()
    photos = {photo.image.name: photo for photo in read_capture(tmp_path, "colmap").photos}
    assert len(photos) == 8
    for image in reconstruction.images.values():
        np.testing.assert_allclose(photos[image.name].cam_from_world[:3], image.cam_from_world().matrix(), atol=1e-9)


def test_few_registered_photographs(tmp_path: Path) -> None:
    """Check that 87 photographs of which COLMAP kept 10 are refused as a failed reconstruction."""
    write(tmp_path, "PINHOLE")
    for i in range(20):
        Image.new("L", (8, 8)).save(tmp_path / f"images/more{i}.png")
    assert read_capture(tmp_path, "colmap").notes == (
        "10 of 30 photographs are registered in sparse/0; the others are skipped",
    )
    for i in range(20, 77):
        Image.new("L", (8, 8)).save(tmp_path / f"images/more{i}.png")
    with pytest.raises(SceneError, match="only 10 of 87 photographs are registered in sparse/0; register more"):
        read_capture(tmp_path, "colmap")


@pytest.mark.parametrize(
    ("place", "photographs"),
    [
        ("sparse", "images"),
        ("sparse/0", "input"),
        ("sparse/0", "."),
        ("sparse/1", "images"),
        ("colmap/sparse/0", "images"),
        ("distorted/sparse/0", "input"),
        (".", "images"),
    ],
)
def test_layouts_of_other_programs(tmp_path: Path, place: str, photographs: str) -> None:
    reconstruction = write(tmp_path, "PINHOLE", place=place)
    if photographs != "images":
        for path in (tmp_path / "images").iterdir():
            (tmp_path / photographs).mkdir(exist_ok=True)
            path.rename(tmp_path / photographs / path.name)
    capture = read_capture(tmp_path, "colmap")
    images = {image.name: image for image in reconstruction.images.values()}
    assert len(capture.photos) == len(images) == 10 and capture.notes == ()
    for photo in capture.photos:
        assert photo.image == tmp_path / photographs / photo.image.name
        expected = images[photo.image.name].cam_from_world().matrix()
        np.testing.assert_allclose(photo.cam_from_world[:3], expected, atol=1e-12)


def test_distorted_models_belong_to_the_photographs_that_were_undistorted(tmp_path: Path) -> None:
    write(tmp_path, "OPENCV", place="distorted/sparse/0")
    (tmp_path / "images").rename(tmp_path / "input")
    for path in (tmp_path / "input").iterdir():
        draw(tmp_path / "images" / path.name)
    assert {photo.image.parent.name for photo in read_capture(tmp_path, "colmap").photos} == {"input"}


def test_transforms_json_that_was_made_from_a_model_goes_before_it(tmp_path: Path) -> None:
    write(tmp_path, "PINHOLE", place="colmap/sparse/0")
    matrix = np.eye(4).tolist()
    frames = [{"file_path": f"images/photo {i:02d}.png", "transform_matrix": matrix} for i in range(1, 11)]
    (tmp_path / "transforms.json").write_text(json.dumps({"fl_x": 100, "frames": frames}))
    assert len(read_capture(tmp_path, "nerfstudio").photos) == 10


@pytest.mark.parametrize("text", [False, True], ids=["binary", "text"])
def test_the_model_with_most_photographs_is_used(tmp_path: Path, text: bool) -> None:
    """Check that the largest model is used, as the mapper numbers models in the order in which it began them."""
    reconstruction = write(tmp_path, "PINHOLE", text, place="sparse/10")
    for number, kept in ((0, 2), (1, 7)):
        part = pycolmap.Reconstruction(reconstruction)
        for image in list(part.images)[kept:]:
            part.deregister_frame(part.images[image].frame_id)
        folder = tmp_path / f"sparse/{number}"
        folder.mkdir()
        (part.write_text if text else part.write_binary)(str(folder))
    capture = read_capture(tmp_path, "colmap")
    assert len(capture.photos) == 10
    assert capture.notes == ("the model sparse/10 with 10 photographs is used; sparse/0 has 2, sparse/1 has 7",)


@pytest.mark.parametrize("points", ["", "1 2 -1", "7 20 -1 9 10 -1 3 4 5 6 7 8", "1.5 2.5 -1 3e1 4 7"])
@pytest.mark.parametrize("keep", [True, False], ids=["as written", "empty lines left out"])
def test_lines_of_points_are_no_images(tmp_path: Path, points: str, keep: bool) -> None:
    """Check that such lines are skipped: another program's file may have none, or names that are numbers."""
    reconstruction = write(tmp_path, "PINHOLE", text=True)
    path = tmp_path / "sparse/0/images.txt"
    lines = path.read_text().replace("photo 03.png", "3").splitlines()
    (tmp_path / "images/photo 03.png").rename(tmp_path / "images/3")
    empty = [i for i, line in enumerate(lines) if not line]
    assert len(empty) == 10
    for i in empty[::3]:
        lines[i] = points
    path.write_text("".join(line + "\n" for line in lines if line or keep), encoding="utf-8-sig")
    photos = read_capture(tmp_path, "colmap").photos
    expected = [image.name.replace("photo 03.png", "3") for image in reconstruction.images.values()]
    assert sorted(photo.image.name for photo in photos) == sorted(expected)


def test_text_models_with_a_byte_order_mark(tmp_path: Path) -> None:
    write(tmp_path, "PINHOLE", text=True)
    for path in (tmp_path / "sparse/0").glob("*.txt"):
        path.write_text("".join(path.read_text().splitlines(keepends=True)[3:]), encoding="utf-8-sig")
    capture = read_capture(tmp_path, "colmap")
    assert len(capture.photos) == 10 and capture.points is not None


def test_other_programs_images_txt_is_no_model(tmp_path: Path) -> None:
    (tmp_path / "images.txt").write_text("a.png\n")
    draw(tmp_path / "a.png")
    assert not any(kind.recognises(tmp_path) for kind in all_formats())


def test_a_model_alone_lacks_its_photographs(tmp_path: Path) -> None:
    write(tmp_path, "PINHOLE")
    for path in (tmp_path / "images").iterdir():
        path.unlink()
    with pytest.raises(
        SceneError, match=r"only 0 of the 10 photographs named by 0/images\.bin exist \(photo 01\.png is"
    ):
        load_scene(tmp_path / "sparse/0", DataConfig())


def test_unsupported_camera_model_names_the_cure(tmp_path: Path) -> None:
    write(tmp_path, "EQUIRECTANGULAR")
    with pytest.raises(SceneError, match=r"EQUIRECTANGULAR is not supported: a panorama .* perspective photographs"):
        load_scene(tmp_path, DataConfig())


@pytest.mark.parametrize("name", ["cameras.bin", "images.bin", "points3D.bin"])
def test_truncated_binary_model(tmp_path: Path, name: str) -> None:
    write(tmp_path, "PINHOLE")
    path = tmp_path / "sparse/0" / name
    path.write_bytes(path.read_bytes()[:-9])
    with pytest.raises(SceneError, match=rf"sparse/0/{name}: damaged COLMAP model"):
        load_scene(tmp_path, DataConfig())


def test_damaged_text_model(tmp_path: Path) -> None:
    write(tmp_path, "PINHOLE", text=True)
    (tmp_path / "sparse/0/cameras.txt").write_text("1 PINHOLE ninety 64 1 2 3 4\n")
    with pytest.raises(SceneError, match=r"sparse/0/cameras\.txt: damaged COLMAP model"):
        load_scene(tmp_path, DataConfig())


def test_missing_cameras_file(tmp_path: Path) -> None:
    write(tmp_path, "PINHOLE")
    (tmp_path / "sparse/0/cameras.bin").unlink()
    with pytest.raises(SceneError, match=r"lacks cameras\.bin"):
        load_scene(tmp_path, DataConfig())


@pytest.mark.slow
def test_real_photographs(shared_data: Path) -> None:
    root = shared_data / "real" / "beercan_colmap"
    scene = load_scene(root, DataConfig(max_side=640))
    assert (len(scene.train), len(scene.test)) == (62, 9)
    reconstruction = pycolmap.Reconstruction(str(root / "sparse/0"))
    check_points_are_seen_where_colmap_saw_them(scene, reconstruction)


def check_points_are_seen_where_colmap_saw_them(scene: Scene, reconstruction: Any) -> None:
    image = next(image for image in reconstruction.images.values() if Path(image.name).stem == scene.train[0].name)
    camera, view = reconstruction.cameras[image.camera_id], scene.train[0]
    seen = [point for point in image.points2D if point.has_point3D()]
    points = np.array([reconstruction.points3D[point.point3D_id].xyz for point in seen])
    rays = camera.cam_from_img(np.array([point.xy for point in seen]))
    pixels, _ = view.camera.project(scene.user_from_scene.to_scene(points))
    expected = rays * view.camera.K[[0, 1], [0, 1]] + view.camera.K[:2, 2]
    assert np.median(np.linalg.norm(pixels - expected, axis=1)) < 1.0
