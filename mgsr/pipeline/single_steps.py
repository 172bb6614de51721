"""Single steps of a run. Each reads the results of earlier steps from the folder of results."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mgsr.config import Config
from mgsr.data.scene import Scene
from mgsr.mesh.surface import ReconstructedMesh
from mgsr.parallel import one_library_thread
from mgsr.pipeline.device import pick_device
from mgsr.pipeline.evaluation import find_truth, image_scores, surface_scores
from mgsr.pipeline.meshing import make_mesh, make_textured
from mgsr.pipeline.object_files import with_found_object
from mgsr.pipeline.preprocess import load_again
from mgsr.pipeline.rendering import render_views, rendered_scene
from mgsr.pipeline.result_files import (
    at_known_exposures,
    read_mesh,
    read_models,
    require_packages,
    with_irradiance,
    write_mesh,
    write_renders,
    write_textured,
)
from mgsr.pipeline.result_paths import MESH
from mgsr.pipeline.scene_folder import require_new_folder, write_scene_folder
from mgsr.report.data import finite
from mgsr.start.starting_points import starting_points


@one_library_thread()
def mesh_again(path: Path, out: Path, config: Config, device: str = "auto") -> ReconstructedMesh:
    """Extract the surface from the splats in `out`, write its files there, and return it in the user's frame.

    Raises ConfigError, SceneError, GpuError, MeshError, and MgsrError if there are no splats.
    """
    require_packages(config.output)
    chosen = pick_device(device)
    scene = with_found_object(out, at_known_exposures(out, load_again(path, out, config)))
    model = read_models(out, scene.user_from_scene).to(chosen.torch)
    # The run compared its surface with the starting surface, which the same seed reproduces.
    start = starting_points(scene, 1, config.seed, expert=config.expert) if scene.masked else None
    mesh = make_mesh(model, scene, config, start=start)
    write_mesh(out, mesh, config.output)
    write_textured(out, make_textured(model, with_irradiance(out, scene, config), config, mesh), scene, config.output)
    return mesh


def render_again(path: Path, out: Path, config: Config, device: str = "auto", as_scene: Path | None = None) -> Scene:
    """Render the test views from the splats in `out`, write their pictures there, and return the scene.

    as_scene: a new folder for a separate scene of the renders and cameras of all views.

    Raises ConfigError if that folder is not empty, SceneError, GpuError, and MgsrError if there are no splats.
    """
    chosen = pick_device(device)
    if as_scene is not None:
        require_new_folder(as_scene)
    scene = with_irradiance(out, with_found_object(out, load_again(path, out, config)), config)
    models = read_models(out, scene.user_from_scene).to(chosen.torch)
    if as_scene is not None:
        write_scene_folder(as_scene, rendered_scene(models, scene, config), config.output.scale)
    write_renders(out, list(render_views(models, scene.test, config)), scene, config.output)
    return scene


def score_again(path: Path, out: Path, config: Config, device: str = "auto") -> dict[str, Any]:
    """Score the splats in `out`, and the mesh if it is there; return the scores as JSON types.

    Raises ConfigError, SceneError, GpuError, and MgsrError if there are no splats.
    """
    chosen = pick_device(device)
    scene = with_irradiance(out, with_found_object(out, at_known_exposures(out, load_again(path, out, config))), config)
    models = read_models(out, scene.user_from_scene).to(chosen.torch)
    behind = scene.backdrop(config.train.background)
    scores = image_scores(list(render_views(models, scene.test, config)), scene, behind.color).to_json()
    if (out / MESH).is_file():
        scores["gt"] = surface_scores(read_mesh(out), find_truth(scene), scene)
    plain: dict[str, Any] = finite(scores)
    return plain
