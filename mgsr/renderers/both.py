"""Rendering of both branches from one camera, the 3D branch with the light that the 2D branch's surface mirrors."""

from __future__ import annotations

from torch import Tensor

from mgsr.data.camera import Camera
from mgsr.gaussians.gaussians import GaussianModel
from mgsr.gaussians.mirrored import MirroredLight
from mgsr.gaussians.surfels import SurfelModel
from mgsr.renderers.gaussians import render_gaussians
from mgsr.renderers.mirrored import mirrored_light
from mgsr.renderers.outputs import GaussianOutputs, SurfelOutputs
from mgsr.renderers.surfels import render_surfels


def render_both(
    surfels: SurfelModel | None,
    gaussians: GaussianModel | None,
    light: MirroredLight | None,
    camera: Camera,
    background: Tensor | None = None,
    depth: bool = True,
    lit: Tensor | None = None,
) -> tuple[SurfelOutputs | None, GaussianOutputs | None]:
    """Render each branch from one camera; None for one that is not there.

    depth: of the 3D branch; off saves its time; lit: as for `render_gaussians`.
    """
    flat = None if surfels is None else render_surfels(surfels, camera, background, lit=lit)
    if gaussians is None:
        return flat, None
    mirrored = None
    if light is not None and (flat is not None or light.reflector is not None):
        mirrored = mirrored_light(light, camera, None if flat is None else flat.normal)
    return flat, render_gaussians(gaussians, camera, background, depth=depth, mirrored=mirrored, lit=lit)
