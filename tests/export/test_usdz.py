"""model.usdz, read back and checked by OpenUSD."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom, UsdShade, UsdValidation

from mgsr.errors import MgsrError
from mgsr.export.gltf import UpAxis
from mgsr.export.usdz import require_usd, write_usdz
from tests.export.test_mesh_files import square


def test_the_package_holds_mesh_and_material(tmp_path: Path) -> None:
    mesh, uvs, _, material = square(np.full((8, 8, 3), 90, np.uint8))
    write_usdz(tmp_path / "model.usdz", mesh, uvs, material, UpAxis.Z)
    assert list(Sdf.ZipFile.Open(str(tmp_path / "model.usdz")).GetFileNames()) == [
        *("model.usdc", "base_color.png", "normal.png", "occlusion.png"),
    ]
    stage = Usd.Stage.Open(str(tmp_path / "model.usdz"))
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    found = UsdValidation.ValidationContext(validators).Validate(stage)
    assert [str(each.GetErrorString()) for each in found] == []
    shape = UsdGeom.Mesh(stage.GetPrimAtPath("/Model/Surface"))
    places = UsdGeom.Xformable(shape).ComputeLocalToWorldTransform(Usd.TimeCode.Default())
    points = np.array([places.Transform(point) for point in shape.GetPointsAttr().Get()])
    turned = np.stack([mesh.vertices[:, 0], mesh.vertices[:, 2], -mesh.vertices[:, 1]], axis=1)
    np.testing.assert_allclose(points, turned, atol=1e-6)
    surface = UsdShade.Shader(stage.GetPrimAtPath("/Model/Material/Surface"))
    assert surface.GetInput("roughness").Get() == 0.25 and surface.GetInput("metallic").Get() == 1.0
    assert not surface.GetInput("ior")
    write_usdz(tmp_path / "matte.usdz", mesh, uvs, replace(material, metallic=0.0, glossy=False), UpAxis.Z)
    other = Usd.Stage.Open(str(tmp_path / "matte.usdz"))
    matte = UsdShade.Shader(other.GetPrimAtPath("/Model/Material/Surface"))
    assert matte.GetInput("ior").Get() == 1.0  # the reflectance at normal incidence is then 0
    st = np.array(UsdGeom.PrimvarsAPI(shape).GetPrimvar("st").Get())
    np.testing.assert_allclose(st, uvs * [1, -1] + [0, 1], atol=1e-6)


def test_without_usd_the_message_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pxr", None)
    with pytest.raises(MgsrError, match=r"pip install 'mgsr\[usd\]'"):
        require_usd()
