"""`model.usdz`: the textured model for Apple's devices, as a USD package with a UsdPreviewSurface."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from mgsr.errors import MgsrError
from mgsr.export.gltf import PbrMaterial, UpDirection, turn_upright
from mgsr.export.mesh_files import check_mesh, unit_normals
from mgsr.geometry.mesh import Mesh

_MAPS = ("base_color", "normal", "occlusion")


def require_usd() -> None:
    """Check that the optional package usd-core is installed. Raises MgsrError if it is not."""
    if find_spec("pxr") is None:
        raise MgsrError("output.usdz: writing USD needs the package usd-core: pip install 'mgsr[usd]'")


def write_usdz(path: Path, mesh: Mesh, uvs: np.ndarray, material: PbrMaterial, up: UpDirection) -> None:
    """Write a mesh with a textured material as a USDZ package, y up.

    uvs [V,2], and the other arguments and errors as of `write_textured_glb`. Positions are about the mesh's middle, to
    which a transform moves them. Raises MgsrError if usd-core is not installed.
    """
    check_mesh(mesh)
    require_usd()
    from pxr import Sdf, Usd, UsdGeom  # imported here, because the package is optional

    with TemporaryDirectory() as folder:
        for name in _MAPS:
            (Path(folder) / f"{name}.png").write_bytes(getattr(material, name))
        stage = Usd.Stage.CreateNew(str(Path(folder) / "model.usdc"))
        UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
        UsdGeom.SetStageMetersPerUnit(stage, 1.0)
        root = UsdGeom.Xform.Define(stage, "/Model")
        stage.SetDefaultPrim(root.GetPrim())
        shape = _define_mesh(stage, mesh, uvs, turn_upright(up))
        _define_material(stage, material, shape)
        stage.GetRootLayer().Save()
        package = Sdf.ZipFileWriter.CreateNew(str(path))
        for name in ("model.usdc", *(f"{name}.png" for name in _MAPS)):
            package.AddFile(str(Path(folder) / name), name)
        if not package.Save():
            raise MgsrError(f"{path}: the USD package cannot be written; check the path and the free disk space")


def _define_mesh(stage: Any, mesh: Mesh, uvs: np.ndarray, turn: np.ndarray) -> Any:
    """Add the mesh to the stage, turned by a rotation [3,3]; return its schema."""
    from pxr import Gf, Sdf, UsdGeom, Vt

    middle = (mesh.vertices.max(axis=0) + mesh.vertices.min(axis=0)) / 2
    points = np.ascontiguousarray((mesh.vertices - middle) @ turn.T, np.float32)
    shape = UsdGeom.Mesh.Define(stage, "/Model/Surface")
    shape.AddTranslateOp().Set(Gf.Vec3d(*(turn @ middle).tolist()))
    shape.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points))
    shape.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(np.stack([points.min(axis=0), points.max(axis=0)])))
    shape.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(mesh.faces), 3, np.int32)))
    shape.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(mesh.faces.astype(np.int32).ravel()))
    normals = np.ascontiguousarray(unit_normals(mesh.normals) @ turn.T, np.float32)
    shape.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(normals))
    shape.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    shape.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    shape.CreateDoubleSidedAttr(True)
    places = np.stack([uvs[:, 0], 1 - uvs[:, 1]], axis=1).astype(np.float32)  # USD's begin at the lower left
    primvars = UsdGeom.PrimvarsAPI(shape)
    st = primvars.CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.vertex)
    st.Set(Vt.Vec2fArray.FromNumpy(places))
    return shape


def _define_material(stage: Any, material: PbrMaterial, shape: Any) -> None:
    """Add the material with its three maps to the stage, and bind it to the mesh."""
    from pxr import Sdf, UsdShade

    types = Sdf.ValueTypeNames
    defined = UsdShade.Material.Define(stage, "/Model/Material")
    surface = UsdShade.Shader.Define(stage, "/Model/Material/Surface")
    surface.CreateIdAttr("UsdPreviewSurface")
    surface.CreateInput("roughness", types.Float).Set(float(material.roughness))
    surface.CreateInput("metallic", types.Float).Set(float(material.metallic))
    if not material.glossy:
        surface.CreateInput("ior", types.Float).Set(1.0)
    reader = UsdShade.Shader.Define(stage, "/Model/Material/Places")
    reader.CreateIdAttr("UsdPrimvarReader_float2")
    reader.CreateInput("varname", types.String).Set("st")
    places = reader.CreateOutput("result", types.Float2)
    inputs = {
        "base_color": ("diffuseColor", types.Color3f, "rgb", "sRGB"),
        "normal": ("normal", types.Normal3f, "rgb", "raw"),
        "occlusion": ("occlusion", types.Float, "r", "raw"),
    }
    for name, (target, kind, channels, space) in inputs.items():
        picture = UsdShade.Shader.Define(stage, f"/Model/Material/{name}")
        picture.CreateIdAttr("UsdUVTexture")
        picture.CreateInput("file", types.Asset).Set(f"{name}.png")
        picture.CreateInput("sourceColorSpace", types.Token).Set(space)
        for axis in ("wrapS", "wrapT"):
            picture.CreateInput(axis, types.Token).Set("clamp")
        if name == "normal":  # from 0..1 to -1..1
            picture.CreateInput("scale", types.Float4).Set((2.0, 2.0, 2.0, 1.0))
            picture.CreateInput("bias", types.Float4).Set((-1.0, -1.0, -1.0, 0.0))
        picture.CreateInput("st", types.Float2).ConnectToSource(places)
        output = picture.CreateOutput(channels, types.Float if channels == "r" else types.Float3)
        surface.CreateInput(target, kind).ConnectToSource(output)
    defined.CreateSurfaceOutput().ConnectToSource(surface.ConnectableAPI(), "surface")
    UsdShade.MaterialBindingAPI.Apply(shape.GetPrim()).Bind(defined)
