"""Rendered images, read back by Pillow."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from mgsr.errors import SceneError
from mgsr.export.renders import Rendering, straight_color, write_view


def view() -> Rendering:
    random = np.random.default_rng(0)
    alpha = random.random((5, 7))
    alpha[0, :3] = (0, 1, 0.002)
    normal = random.normal(size=(5, 7, 3))
    return Rendering(
        color=random.random((5, 7, 3)),
        alpha=alpha,
        transmitted=random.random((5, 7, 3)),
        reflected=1.5 * random.random((5, 7, 3)),
        weight=random.random((5, 7)),
        depth=np.where(alpha > 0.5, 3 + alpha, 0),
        normal=alpha[..., None] * normal / np.linalg.norm(normal, axis=-1, keepdims=True),
    )


def read(path: Path) -> np.ndarray:
    return np.asarray(Image.open(path))


def test_all_maps_come_back(tmp_path: Path) -> None:
    given = view()
    paths = write_view(tmp_path, "folder/r_0", given)
    names = ["r_0", *(f"r_0_{kind}" for kind in ("transmitted", "reflected", "weight", "depth", "normal"))]
    assert paths == [tmp_path / "folder" / f"{name}.png" for name in names]
    for path, color in ((paths[0], given.color), (paths[1], given.transmitted)):
        stored = read(path) / 255
        assert stored.shape == (5, 7, 4)
        # Straight: the colour is as given also where alpha is small, and was not multiplied or divided on the way.
        assert color is not None
        np.testing.assert_allclose(stored[..., :3], color, atol=0.5 / 255 + 1e-9)
        np.testing.assert_allclose(stored[..., 3], given.alpha, atol=0.5 / 255 + 1e-9)
    assert given.reflected is not None
    np.testing.assert_allclose(read(paths[2]) / 255, np.clip(given.reflected, 0, 1), atol=0.5 / 255 + 1e-9)
    assert given.weight is not None
    np.testing.assert_allclose(read(paths[3]) / 255, given.weight, atol=0.5 / 255 + 1e-9)
    normal = read(paths[5])[..., :3] / 127.5 - 1
    np.testing.assert_allclose(normal * given.alpha[..., None], given.normal, atol=0.01)


def test_depth_is_in_the_users_unit(tmp_path: Path) -> None:
    given = view()
    path = write_view(tmp_path, "r_0", given)[4]
    image = Image.open(path)
    assert np.asarray(image).dtype in (np.uint16, np.int32)
    depth = np.asarray(image).astype(np.float64) * float(image.info["depth_scale"])
    np.testing.assert_allclose(depth, given.depth, atol=4 / 65535)
    assert (depth[given.depth == 0] == 0).all()


def test_only_what_is_there_is_written(tmp_path: Path) -> None:
    bare = Rendering(*(np.zeros(shape) for shape in ((2, 3, 3), (2, 3), (2, 3), (2, 3, 3))))
    assert [path.name for path in write_view(tmp_path, "r_0", bare)] == ["r_0.png", "r_0_depth.png", "r_0_normal.png"]
    assert (read(tmp_path / "r_0_depth.png") == 0).all()


def test_names_stay_in_the_folder(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="a name inside"):
        write_view(tmp_path / "renders", "../r_0", view())


def test_straight_color_undoes_the_black_background() -> None:
    given = view()
    recovered = straight_color(given.color * given.alpha[..., None], given.alpha)
    visible = given.alpha >= 0.5 / 255
    np.testing.assert_allclose(recovered[visible], given.color[visible], atol=1e-9)
    assert (recovered[~visible] == 0).all()
