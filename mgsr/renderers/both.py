"""Rendering of both branches from one camera, the 3D branch with the environment map's reflection in the surface."""

from __future__ import annotations

from torch import Tensor

from mgsr.data.camera import Camera
from mgsr.gaussians.trained_model import TrainedModel
from mgsr.renderers.environment_map import reflected_environment
from mgsr.renderers.gaussians import render_gaussians
from mgsr.renderers.outputs import GaussianOutputs, SurfelOutputs
from mgsr.renderers.surfels import render_surfels


def render_both(
    model: TrainedModel,
    camera: Camera,
    background: Tensor | None = None,
    depth: bool = True,
    shading: Tensor | None = None,
) -> tuple[SurfelOutputs | None, GaussianOutputs | None]:
    """Render each branch of a model from one camera; None for a missing branch.

    background [3]: as for `render_gaussians`.
    depth: whether to render the 3D branch's depth; shading [H,W]: as for `render_gaussians`.
    """
    flat = None if model.surfels is None else render_surfels(model.surfels, camera, background, shading=shading)
    if model.gaussians is None:
        return flat, None
    environment, light = None, model.environment_map
    if light is not None and (flat is not None or light.reflector is not None):
        environment = reflected_environment(light, camera, None if flat is None else flat.normal)
    return flat, render_gaussians(
        model.gaussians, camera, background, depth=depth, environment=environment, shading=shading
    )
