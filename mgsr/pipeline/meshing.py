"""The surface of the trained branches, in the user's frame."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from mgsr.config import Config
from mgsr.data.scene import Scene
from mgsr.gaussians.trained_model import TrainedModel
from mgsr.geometry.mesh import Mesh
from mgsr.mesh.extract import extract_mesh
from mgsr.mesh.surface import ReconstructedMesh
from mgsr.mesh.texture import texture_mesh
from mgsr.pipeline.rendering import outlined_scene, scene_silhouettes, surface_views
from mgsr.pipeline.steps import always


def make_mesh(
    model: TrainedModel,
    scene: Scene,
    config: Config,
    go_on: Callable[[], bool] = always,
    start: Mesh | None = None,
) -> ReconstructedMesh:
    """Extract the surface, in the user's frame.

    go_on: whether there is time for another round of refinement; start: as for `extract_mesh`. Raises MeshError, with
    the reason, where no surface is found.
    """
    views = surface_views(model, scene, config)
    outlined = outlined_scene(model, scene, config)
    silhouettes = scene_silhouettes(outlined)
    mesh = extract_mesh(
        views,
        config.mesh,
        silhouettes,
        outlined.train,
        go_on=go_on,
        start=start,
        ground=scene.ground,
        expert=config.expert,
    )
    to_user = scene.user_from_scene.to_user
    textured = None
    if config.output.texture is not None:
        side, faces, colors = config.output.texture, config.output.texture_faces, config.expert.mesh.colors
        textured = texture_mesh(mesh, views, side, faces, config.mesh, options=colors)
        textured = textured.in_frame(to_user(textured.vertices))
    mesh = mesh.in_frame(to_user(mesh.vertices))
    return replace(mesh, textured=textured).with_normals(mesh.normals)
