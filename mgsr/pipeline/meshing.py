"""The surface of the trained branches and its textured model, in the user's frame."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from mgsr.config import Config, MeshColor
from mgsr.config.expert import GlossOptions
from mgsr.data.camera import pixel_size
from mgsr.data.scene import Scene
from mgsr.gaussians.trained_model import TrainedModel
from mgsr.geometry.decimate import coarser
from mgsr.geometry.mesh import Mesh
from mgsr.mesh.extract import extract_mesh
from mgsr.mesh.surface import ReconstructedMesh, TexturedMesh
from mgsr.mesh.texture import texture_levels
from mgsr.pipeline.rendering import masked_scene, scene_silhouettes, surface_views
from mgsr.pipeline.steps import always
from mgsr.shading.gloss import fit_gloss, mirrorings
from mgsr.shading.light_kind import LightKind
from mgsr.shading.material import MATTE, Material
from mgsr.shading.photo_set import PhotoSet
from mgsr.start.points import StartingPoints


def make_mesh(
    model: TrainedModel,
    scene: Scene,
    config: Config,
    go_on: Callable[[], bool] = always,
    start: StartingPoints | None = None,
) -> ReconstructedMesh:
    """Extract the surface, in the user's frame.

    go_on: returns whether there is time for another round of refinement. start: the points on which training began;
    without masks, their surface is not used.

    Raises MeshError, with the reason, if no surface is found.
    """
    views = surface_views(model, scene, config)
    masked = masked_scene(model, scene, config)
    silhouettes = scene_silhouettes(masked, config.expert.mesh.mask_side)
    photos = PhotoSet.of_scene(masked, silhouettes, config.expert.shading.observations)
    surface = start.surface if start is not None and scene.masked else None
    mirroring = start is not None and start.light is LightKind.ENVIRONMENT
    mesh = extract_mesh(
        views, config.mesh, photos, go_on, surface, mirroring, ground=scene.ground, expert=config.expert
    )
    return mesh.in_frame(scene.user_from_scene.to_user(mesh.vertices))


def make_textured(model: TrainedModel, scene: Scene, config: Config, mesh: ReconstructedMesh) -> list[TexturedMesh]:
    """Make the textured model of the surface at each level of detail, the finest first, in the user's frame.

    Its colours come from renders of the training views, as large as the photographs.
    """
    frame = scene.user_from_scene
    full = mesh.in_frame(frame.to_scene(mesh.vertices))
    at_photographs = replace(config, mesh=replace(config.mesh, view_scale=1.0, extra_views=0))
    pixel = pixel_size([view.camera for view in scene.train], full.vertices.mean(axis=0))
    static = all(view.irradiance is None for view in scene.train)
    views = surface_views(model, scene, at_photographs)
    shaded = static and config.mesh.color is MeshColor.TRANSMITTED
    glossy = static and (model.environment_map is not None or mesh.light is LightKind.ENVIRONMENT)
    material = _fit_material(full, scene, pixel, config.expert.mesh.texture.gloss) if glossy else MATTE
    options = config.expert.mesh
    levels = texture_levels(full, views, pixel, config.output, config.mesh, shaded, material, options=options)
    return [textured.in_frame(frame.to_user(textured.vertices)) for textured in levels]


def _fit_material(full: Mesh, scene: Scene, pixel: float, options: GlossOptions) -> Material:
    """Return the material of a glossy surface in the scene's frame; pixel: a photograph's pixel size on it."""
    observed = coarser(Mesh(full.vertices, full.faces), options.edge * pixel, options.max_faces)
    return fit_gloss(mirrorings(observed, scene.train, pixel, options=options), options)
