"""Splat files: the viewers' layout, and back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.lib.recfunctions import drop_fields
from plyfile import PlyData, PlyElement
from scipy.spatial.transform import Rotation

from mgsr.data.scene import Similarity
from mgsr.errors import SceneError
from mgsr.export.splats import SURFEL_THICKNESS, load_splats, write_splats


def splats(axes: int = 3, coefficients: int = 9, split: bool = False, count: int = 17) -> dict[str, np.ndarray]:
    random = np.random.default_rng(1)
    shapes: dict[str, tuple[int, ...]] = {
        "means": (3,),
        "quats": (4,),
        "log_scales": (axes,),
        "opacity_logits": (),
        "sh": (coefficients, 3),
    }
    if split:
        shapes |= {"refl_opacity_logits": (), "weight_logits": (), "refl_sh": (4, 3)}
    return {name: random.normal(size=(count, *shape)).astype(np.float32) for name, shape in shapes.items()}


@pytest.mark.parametrize("coefficients", [1, 4, 9, 16])
@pytest.mark.parametrize(("axes", "split"), [(2, False), (3, False), (3, True)])
def test_reading_returns_the_same_bits(tmp_path: Path, axes: int, split: bool, coefficients: int) -> None:
    given = splats(axes, coefficients, split)
    write_splats(tmp_path / "splats.ply", given)
    read = load_splats(tmp_path / "splats.ply")
    assert read.keys() == given.keys()
    for name, array in given.items():
        np.testing.assert_array_equal(read[name], array, err_msg=name)
        assert read[name].dtype == np.float32


def test_the_layout_is_the_viewers(tmp_path: Path) -> None:
    given = splats(axes=2, coefficients=4)
    write_splats(tmp_path / "splats.ply", given)
    vertex = PlyData.read(str(tmp_path / "splats.ply"))["vertex"]
    wanted = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", *(f"f_rest_{i}" for i in range(45))]
    wanted += ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    assert [item.name for item in vertex.properties] == wanted
    # All of red first: coefficient k of channel c is f_rest_(15 c + k - 1).
    np.testing.assert_array_equal(vertex["f_rest_2"], given["sh"][:, 3, 0])
    np.testing.assert_array_equal(vertex["f_rest_15"], given["sh"][:, 1, 1])
    np.testing.assert_array_equal(vertex["f_rest_31"], given["sh"][:, 2, 2])
    np.testing.assert_array_equal(vertex["rot_0"], given["quats"][:, 0])
    np.testing.assert_allclose(np.exp(vertex["scale_2"]), SURFEL_THICKNESS, rtol=1e-5)


def test_a_surfels_normal_is_its_third_axis(tmp_path: Path) -> None:
    given = splats(axes=2)
    write_splats(tmp_path / "splats.ply", given)
    vertex = PlyData.read(str(tmp_path / "splats.ply"))["vertex"]
    wanted = Rotation.from_quat(given["quats"], scalar_first=True).as_matrix()[:, :, 2]
    np.testing.assert_allclose(np.stack([vertex[name] for name in ("nx", "ny", "nz")], 1), wanted, atol=1e-6)


def test_the_reflected_half_is_appended(tmp_path: Path) -> None:
    given = splats(split=True)
    write_splats(tmp_path / "splats.ply", given)
    vertex = PlyData.read(str(tmp_path / "splats.ply"))["vertex"]
    names = [item.name for item in vertex.properties]
    extra = ["refl_opacity", "refl_weight", *(f"refl_dc_{i}" for i in range(3)), *(f"refl_rest_{i}" for i in range(9))]
    assert names[names.index("rot_3") + 1 :] == extra
    np.testing.assert_array_equal(vertex["refl_weight"], given["weight_logits"])
    np.testing.assert_array_equal(vertex["refl_rest_4"], given["refl_sh"][:, 2, 1])
    assert (vertex["nz"] == 0).all()
    kept = PlyElement.describe(drop_fields(vertex.data, "refl_weight"), "vertex")
    PlyData([kept]).write(str(tmp_path / "half.ply"))
    with pytest.raises(SceneError, match="the file lacks refl_weight"):
        load_splats(tmp_path / "half.ply")


def test_the_frame_is_the_users(tmp_path: Path) -> None:
    given, frame = splats(split=True), Similarity(2.5, np.array([1.0, -20.0, 3.0]))
    write_splats(tmp_path / "splats.ply", given, frame)
    read = load_splats(tmp_path / "splats.ply")
    np.testing.assert_allclose(read["means"], given["means"] * 2.5 + [1, -20, 3], rtol=1e-6)
    np.testing.assert_allclose(np.exp(read["log_scales"]), 2.5 * np.exp(given["log_scales"]), rtol=1e-6)
    np.testing.assert_array_equal(read["quats"], given["quats"])
    np.testing.assert_array_equal(read["refl_sh"], given["refl_sh"])


def test_no_splats_and_one(tmp_path: Path) -> None:
    for count in (0, 1):
        write_splats(tmp_path / "splats.ply", splats(split=True, count=count))
        assert load_splats(tmp_path / "splats.ply")["sh"].shape == (count, 9, 3)


def test_bad_arrays_are_refused(tmp_path: Path) -> None:
    given = splats(split=True)
    del given["weight_logits"]
    with pytest.raises(SceneError, match="all or none"):
        write_splats(tmp_path / "splats.ply", given)
    with pytest.raises(SceneError, match=r"quats: expected \[N=17, 4\], got \[17, 3\]"):
        write_splats(tmp_path / "splats.ply", splats() | {"quats": np.zeros((17, 3), np.float32)})


def test_other_files_are_refused(tmp_path: Path) -> None:
    (tmp_path / "text.ply").write_text("no ply")
    with pytest.raises(SceneError, match=r"text\.ply: expected a PLY file of splats"):
        load_splats(tmp_path / "text.ply")
    with pytest.raises(SceneError, match=r"none\.ply"):
        load_splats(tmp_path / "none.ply")
