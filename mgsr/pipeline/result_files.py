"""Writing and reading of the files in a folder of results: each is written atomically, in the user's frame."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch

from mgsr.config import Config, OutputConfig, Up
from mgsr.config.expert import IrradianceOptions
from mgsr.data.camera import Camera
from mgsr.data.exposure import with_exposures
from mgsr.data.scene import Exposures, Scene, Similarity, View
from mgsr.data.up_direction import up_direction
from mgsr.errors import MgsrError, in_short
from mgsr.export.draco import require_draco
from mgsr.export.environment_map import StoredEnvironmentMap, load_environment_map, write_environment_map
from mgsr.export.far_origin import about_origin, origin_of_frame
from mgsr.export.flash import load_flash, write_flash
from mgsr.export.gltf import PbrMaterial, UpAxis, UpDirection
from mgsr.export.mesh_files import png_bytes, webp_bytes, write_compressed_glb, write_ply, write_textured_glb
from mgsr.export.obj_files import write_obj
from mgsr.export.ply_notes import LOW_PASS, UNIT, read_number, read_origin
from mgsr.export.radiance_map import write_radiance_map
from mgsr.export.renders import write_view
from mgsr.export.splats import load_splats, write_splats
from mgsr.export.usdz import require_usd, write_usdz
from mgsr.gaussians.environment_map import EnvironmentMap
from mgsr.gaussians.gaussians import GaussianModel
from mgsr.gaussians.reflector import Reflector
from mgsr.gaussians.surfels import SurfelModel
from mgsr.gaussians.trained_model import TrainedModel
from mgsr.mesh.surface import ReconstructedMesh, TexturedMesh
from mgsr.pipeline.atomic_write import atomic_write
from mgsr.pipeline.object_files import read_background_color
from mgsr.pipeline.rendering import RenderedView
from mgsr.pipeline.result_paths import (
    ADJUSTED_CAMERAS,
    BACKGROUND,
    ENVIRONMENT,
    ENVIRONMENT_MAP,
    EXPOSURES,
    FLASH,
    GAUSSIANS,
    LEVEL_GLB,
    MESH,
    MESH_OBJ,
    MODEL_DRACO,
    MODEL_GLB,
    MODEL_USDZ,
    RENDERS,
    REPORT,
    REPORT_HTML,
    SURFELS,
)
from mgsr.report.data import ReportData
from mgsr.report.decisions import with_decisions
from mgsr.report.html import write_report_html
from mgsr.report.pictures import ReportPictures
from mgsr.shading.lighting import Lighting, add_irradiance

Read = TypeVar("Read")

COLOR_QUALITY, MAP_QUALITY = 90, 101  # of the compressed model's WebP maps, 1..100; 101 is lossless


def require_packages(output: OutputConfig) -> None:
    """Check that the optional packages of the requested files are installed, so that a run fails before training.

    Raises MgsrError if one is not.
    """
    if output.usdz:
        require_usd()
    if output.draco:
        require_draco()


def clear_reports(out: Path) -> None:
    """Remove an earlier run's reports, because a report marks a finished run."""
    for name in (REPORT, REPORT_HTML):
        (out / name).unlink(missing_ok=True)


def clear_findings(out: Path, with_cameras: bool = True) -> None:
    """Remove an earlier run's findings on its photographs. with_cameras: also the adjusted cameras."""
    for name in (EXPOSURES, FLASH, *([ADJUSTED_CAMERAS] if with_cameras else [])):
        (out / name).unlink(missing_ok=True)


def write_cameras(out: Path, scene: Scene) -> None:
    """Write adjusted_cameras.json.

    It holds the shift in pixels and, by split and the views' names, world-from-camera matrices [4,4] in the user's
    frame, with OpenCV axes.
    """
    table: dict[str, Any] = {
        split: {view.name: scene.user_from_scene.camera_to_user(view.camera).world_from_cam.tolist() for view in views}
        for split, views in (("train", scene.train), ("test", scene.test))
    }
    with atomic_write(out / ADJUSTED_CAMERAS) as path:
        path.write_text(json.dumps({"shift": scene.camera_shift, **table}))


def with_known_cameras(out: Path, scene: Scene) -> Scene:
    """Return the scene with the cameras that the run in `out` adjusted.

    Raises MgsrError for a file that is damaged or belongs to other photographs.
    """
    path = out / ADJUSTED_CAMERAS
    if not path.is_file():
        return scene

    def placed(view: View, pose: list[list[float]]) -> Camera:
        return _placed(view.camera, pose, scene.user_from_scene)

    with _described(path, scene, "a pose"):
        table = json.loads(path.read_text())
        train, test = _of_views(table, scene, placed)
        return scene.with_cameras(train, test, float(table["shift"]))


@contextmanager
def _described(path: Path, scene: Scene, what: str) -> Iterator[None]:
    """Raise MgsrError in place of the errors of reading a file that holds something, `what`, for each photograph."""
    try:
        yield
    except (OSError, ValueError, LookupError, TypeError) as error:
        raise MgsrError(
            f"{path}: expected {what} per photograph of {scene.name}: {in_short(error)}; run `mgsr train SCENE -o "
            f"{path.parent}` again"
        ) from error


def _of_views(
    table: dict[str, dict[str, Any]], scene: Scene, read: Callable[[View, Any], Read]
) -> tuple[list[Read], list[Read]]:
    """Read the entries of the training and of the test views from a table by split and by the views' names."""
    train, test = (
        [read(view, table[split][view.name]) for view in views]
        for split, views in (("train", scene.train), ("test", scene.test))
    )
    return train, test


def _placed(camera: Camera, pose: list[list[float]], user_from_scene: Similarity) -> Camera:
    """Return the camera at a world-from-camera pose [4,4] of the user's frame. Raises ValueError for another shape."""
    world_from_cam = np.array(pose, np.float64)
    if world_from_cam.shape != (4, 4) or not np.isfinite(world_from_cam).all():
        raise ValueError(f"expected 4 x 4 finite numbers, got {pose}")
    rotation = world_from_cam[:3, :3].T
    cam_from_world = np.eye(4)
    cam_from_world[:3, :3], cam_from_world[:3, 3] = rotation, -rotation @ world_from_cam[:3, 3]
    return user_from_scene.camera_to_scene(replace(camera, cam_from_world=cam_from_world))


def write_exposures(out: Path, scene: Scene, exposures: Exposures) -> None:
    """Write exposures.json: by split and the views' names, the factors [3] of the photographs' linear light."""
    splits = {"train": (scene.train, exposures.train), "test": (scene.test, exposures.test)}
    table = {
        split: {view.name: factor.tolist() for view, factor in zip(views, factors, strict=True)}
        for split, (views, factors) in splits.items()
    }
    with atomic_write(out / EXPOSURES) as path:
        path.write_text(json.dumps(table))


def at_known_exposures(out: Path, scene: Scene) -> Scene:
    """Return the scene at the exposures that the run in `out` found.

    Raises MgsrError for a file that is damaged or belongs to other photographs.
    """
    if not (out / EXPOSURES).is_file():
        return scene
    with _described(out / EXPOSURES, scene, "three factors"):
        both = _of_views(json.loads((out / EXPOSURES).read_text()), scene, lambda view, factors: factors)
        train, test = (np.array(factors, np.float64).reshape(len(factors), 3) for factors in both)
    factors = np.concatenate([train, test])
    if not (np.isfinite(factors) & (factors > 0)).all():
        raise MgsrError(f"{out / EXPOSURES}: expected factors above 0; run `mgsr train SCENE -o {out}` again")
    return with_exposures(scene, Exposures(train, test))


def write_lighting(out: Path, lighting: Lighting, scene: Scene) -> None:
    """Write flash.npz: the surface that a flash lights, and its lamp, in the user's frame."""
    with atomic_write(out / FLASH) as path:
        write_flash(path, lighting.moved(scene.user_from_scene), origin_of_frame(scene.user_from_scene))


def with_irradiance(out: Path, scene: Scene, config: Config) -> Scene:
    """Return the scene with the irradiance of the flash that the run in `out` found, if it found one.

    Raises SceneError for a file that is damaged.
    """
    lighting = read_lighting(out, config.expert.shading.light.flash.irradiance)
    return scene if lighting is None else add_irradiance(scene, lighting.moved(scene.user_from_scene.inverse))


def read_lighting(out: Path, options: IrradianceOptions) -> Lighting | None:
    """Read the flash that the run in `out` found, in the user's frame; None if it found none.

    Raises SceneError for a damaged file.
    """
    return replace(load_flash(out / FLASH), options=options) if (out / FLASH).is_file() else None


def write_models(out: Path, model: TrainedModel, scene: Scene, output: OutputConfig) -> None:
    """Write the branches as splat files, and the environment maps.

    For a missing branch or map, an earlier run's file is removed. Splats are in the output's unit, relative to the
    frame's origin or to an origin near the scene (see `origin_of_frame`).
    """
    for name, splats in ((SURFELS, model.surfels), (GAUSSIANS, model.gaussians)):
        if splats is None:
            (out / name).unlink(missing_ok=True)
        else:
            _write_model(out / name, splats, scene, output)
    if model.environment_map is None:
        (out / ENVIRONMENT_MAP).unlink(missing_ok=True)
        return
    with atomic_write(out / ENVIRONMENT_MAP) as path:
        write_environment_map(path, _stored(model.environment_map, scene), origin_of_frame(scene.user_from_scene))


def write_background(out: Path, model: GaussianModel, scene: Scene, output: OutputConfig) -> None:
    """Write the Gaussians around a found object, as `write_models` writes the branches."""
    _write_model(out / BACKGROUND, model, scene, output)


def with_background(out: Path, model: TrainedModel, user_from_scene: Similarity) -> TrainedModel:
    """Add the Gaussians around a found object, and the colour behind them, to a model in the scene's frame.

    The model is returned unchanged if the run left none in `out`.
    """
    if not (out / BACKGROUND).exists():
        return model
    background = _read_gaussians(out / BACKGROUND, user_from_scene)
    return replace(model, background=background, background_color=read_background_color(out))


def _read_gaussians(path: Path, user_from_scene: Similarity) -> GaussianModel:
    return GaussianModel(**_read_tensors(path, user_from_scene), low_pass=read_number(path, LOW_PASS))


def _write_model(to: Path, splats: SurfelModel | GaussianModel, scene: Scene, output: OutputConfig) -> None:
    origin = origin_of_frame(scene.user_from_scene, output.scale)
    file_from_scene = about_origin(scene.user_from_scene, output.scale, origin)
    arrays = {key: tensor.numpy() for key, tensor in splats.parameters().items()}
    with atomic_write(to) as path:
        low_pass = splats.low_pass if isinstance(splats, GaussianModel) else None
        write_splats(path, arrays, file_from_scene, output.scale, low_pass, origin)


def read_models(out: Path, user_from_scene: Similarity) -> TrainedModel:
    """Read the branches that a run left in `out`, and the Gaussians around a found object, in the scene's frame.

    Raises MgsrError if there are no branches.
    """
    if not any((out / name).exists() for name in (SURFELS, GAUSSIANS)):
        raise MgsrError(
            f"{out}: the folder has neither {SURFELS} nor {GAUSSIANS}; run `mgsr train SCENE -o {out}` first"
        )
    surfels = SurfelModel(**_read_tensors(out / SURFELS, user_from_scene)) if (out / SURFELS).exists() else None
    gaussians = _read_gaussians(out / GAUSSIANS, user_from_scene) if (out / GAUSSIANS).exists() else None
    environment_map = (
        _read_environment_map(out / ENVIRONMENT_MAP, user_from_scene) if (out / ENVIRONMENT_MAP).exists() else None
    )
    return with_background(out, TrainedModel(surfels, gaussians, environment_map), user_from_scene)


def _stored(environment_map: EnvironmentMap, scene: Scene) -> StoredEnvironmentMap:
    """Return an environment map in the user's frame."""
    mesh = None if environment_map.reflector is None else environment_map.reflector.mesh
    placed = None if mesh is None else mesh.moved(scene.user_from_scene.to_user(mesh.vertices))
    return StoredEnvironmentMap(environment_map.maps().numpy(), environment_map.bounce().numpy(), placed)


def _read_environment_map(path: Path, user_from_scene: Similarity) -> EnvironmentMap:
    """Return a file's environment map in the scene's frame."""
    stored = load_environment_map(path)
    reflector = None
    if stored.surface is not None:
        mesh = stored.surface
        reflector = Reflector(mesh.moved(user_from_scene.to_scene(mesh.vertices)))
    return EnvironmentMap.of(stored.maps, stored.bounce, reflector)


def write_mesh(out: Path, mesh: ReconstructedMesh, output: OutputConfig) -> None:
    """Write mesh.ply, and mesh.obj if the settings ask for it; otherwise remove an earlier run's mesh.obj.

    The mesh is in the user's frame. The files' lengths are in the output's unit.
    """
    scaled = mesh.in_frame(mesh.vertices * output.scale)
    with atomic_write(out / MESH) as path:
        write_ply(path, scaled, mesh.colors, output.scale)
    if not output.obj:
        (out / MESH_OBJ).unlink(missing_ok=True)
        return
    with atomic_write(out / MESH_OBJ) as path:
        write_obj(path, scaled, mesh.colors)


def write_textured(out: Path, levels: Sequence[TexturedMesh], scene: Scene, output: OutputConfig) -> None:
    """Write the textured model, and environment.exr if its material has a light.

    levels: of detail, the finest first, in the user's frame. The first becomes model.glb, and model.usdz if it is asked
    for, and model_draco.glb if compression is; the others become model_lod1.glb and so on. All are y up, and lengths
    are in the output's unit. An earlier run's files are removed.
    """
    up = _up(scene, output)
    for old in (out / MODEL_USDZ, out / MODEL_DRACO, out / ENVIRONMENT, *out.glob(LEVEL_GLB.format("*"))):
        old.unlink(missing_ok=True)
    for level, textured in enumerate(levels):
        scaled, material = textured.in_frame(textured.vertices * output.scale), _pbr_material(textured)
        with atomic_write(out / (LEVEL_GLB.format(level) if level else MODEL_GLB)) as path:
            write_textured_glb(path, scaled, scaled.uvs, scaled.tangents, material, up)
        if level == 0 and output.usdz:
            with atomic_write(out / MODEL_USDZ) as path:
                write_usdz(path, scaled, scaled.uvs, material, up)
        if level == 0 and output.draco:
            with atomic_write(out / MODEL_DRACO) as path:
                write_compressed_glb(path, scaled, scaled.uvs, _pbr_material(textured, webp=True), up)
    if (light := levels[0].material.light) is not None:
        with atomic_write(out / ENVIRONMENT) as path:
            write_radiance_map(path, light, up)


def _pbr_material(textured: TexturedMesh, webp: bool = False) -> PbrMaterial:
    """Return a model's maps as PNG files, or as WebP files of COLOR_QUALITY and MAP_QUALITY, with its constants."""
    color, normal, occlusion, constants = (
        textured.base_color,
        textured.normal_map,
        textured.occlusion,
        textured.material,
    )
    return PbrMaterial(
        webp_bytes(color, COLOR_QUALITY) if webp else png_bytes(color),
        webp_bytes(normal, MAP_QUALITY) if webp else png_bytes(normal),
        webp_bytes(occlusion, MAP_QUALITY) if webp else png_bytes(occlusion),
        constants.roughness,
        constants.metallic,
        glossy=not constants.matte,
        webp=webp,
    )


def _up(scene: Scene, output: OutputConfig) -> UpDirection:
    """Return the up axis, or the up direction [3] in the user's frame, whose axes are parallel to the scene's."""
    if output.up is not Up.AUTO:
        return UpAxis(output.up.value)
    return up_direction([view.camera for view in scene.train], scene.options.up)


def read_mesh(out: Path) -> ReconstructedMesh:
    """Read the mesh that an earlier run left in `out`, in the user's frame and unit.

    Raises MgsrError where there is none.
    """
    import trimesh

    if not (out / MESH).is_file():
        raise MgsrError(f"{out}: the folder has no {MESH}; run `mgsr mesh SCENE -o {out}` first")
    mesh: Any = trimesh.load(out / MESH, process=False, force="mesh")
    colors = np.asarray(mesh.visual.vertex_colors[:, :3], np.float32) / 255
    normals = np.asarray(mesh.vertex_normals, np.float32)
    vertices = np.asarray(mesh.vertices, np.float64) / read_number(out / MESH, UNIT)
    return ReconstructedMesh(vertices, np.asarray(mesh.faces, np.int64), colors).with_normals(normals)


def write_renders(out: Path, rendered: Sequence[RenderedView], scene: Scene, output: OutputConfig) -> None:
    """Write all pictures of each test view to renders/test (see mgsr/export/renders.py).

    Depths are in the output's unit.
    """
    with atomic_write(out / RENDERS) as folder:
        folder.mkdir()
        for view in rendered:
            write_view(folder, view.name, view.straight(scene.user_from_scene.scale * output.scale))


def write_reports(out: Path, report: ReportData, pictures: ReportPictures) -> None:
    """Write report.html, then report.json, which marks the run as finished."""
    report = with_decisions(report)
    with atomic_write(out / REPORT_HTML) as path:
        write_report_html(path, report, pictures)
    with atomic_write(out / REPORT) as path:
        path.write_text(json.dumps(report.to_json(), indent=2) + "\n", encoding="utf-8")


def read_report(out: Path) -> ReportData:
    """Read the report of the run in `out`. Raises MgsrError if it is missing or damaged."""
    path = out / REPORT
    if not path.is_file():
        raise MgsrError(f"{path}: expected the report of a finished run, found none; resume the run first")
    try:
        return ReportData.from_json(json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError, LookupError, TypeError, AttributeError) as error:
        raise MgsrError(f"{path}: this file is not the report of a run ({in_short(error)}); run again") from error


def _read_tensors(path: Path, user_from_scene: Similarity) -> dict[str, torch.Tensor]:
    """Read a splat file's arrays [N,...], converted from the file's unit and origin to the scene's frame."""
    arrays, unit, origin = load_splats(path), read_number(path, UNIT), read_origin(path)
    file_from_scene = about_origin(user_from_scene, unit, origin)
    arrays["means"] = file_from_scene.to_scene(arrays["means"].astype(np.float64))
    arrays["log_scales"] = arrays["log_scales"] - math.log(file_from_scene.scale)
    return {name: torch.from_numpy(np.ascontiguousarray(array, np.float32)) for name, array in arrays.items()}
