"""The rendered pixels that are believed, and their places in space."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mgsr.geometry.raycast import pixel_rays
from mgsr.mesh.views import SurfaceView


@dataclass(frozen=True)
class PixelRules:
    """The rules by which a pixel is believed.

    Its alpha is at least min_alpha, it is seen under a cosine of at least min_cos, it lies no farther than max_jump
    footprints off any neighbour's tangent plane, and within `radius` of the scene's centre.
    """

    min_alpha: float
    min_cos: float
    max_jump: float | None = None
    radius: float | None = None


@dataclass(frozen=True)
class SurfacePixels:
    """A view in space.

    positions [H,W,3] and unit normals [H,W,3] in the scene's frame, cosines [H,W] between normal and ray, believed
    [H,W] bool; the first three mean nothing where it is False.
    """

    positions: np.ndarray
    normals: np.ndarray
    cosines: np.ndarray
    believed: np.ndarray


def surface_pixels(view: SurfaceView, rules: PixelRules) -> SurfacePixels:
    """Back-project a view's pixels, and judge by the rules which of them to believe."""
    rays = pixel_rays(view.camera)
    normals = view.normal / np.maximum(_lengths(view.normal), 1e-9)[..., None]
    cosines = -np.einsum("hwc,hwc->hw", normals, rays) / _lengths(rays)
    positions = back_project(view, rays)
    usable = view.usable(rules.min_alpha)
    believed = usable & (cosines >= rules.min_cos)
    if rules.radius is not None:
        believed &= _lengths(positions) <= rules.radius
    if rules.max_jump is not None:
        believed &= ~_on_edge(usable, positions, normals, rules.max_jump * footprint(view))
    return SurfacePixels(positions, normals, cosines, believed)


def back_project(view: SurfaceView, rays: np.ndarray | None = None) -> np.ndarray:
    """Return the points [H,W,3] at each pixel's depth, in the scene's frame.

    rays: as of `pixel_rays`, if they are known already.
    """
    rays = pixel_rays(view.camera) if rays is None else rays
    points: np.ndarray = view.camera.center.astype(np.float32) + rays * view.depth[..., None]
    return points


def footprint(view: SurfaceView) -> np.ndarray:
    """Return the size [H,W] of a pixel on the surface it shows, in the scene's unit."""
    sizes: np.ndarray = view.depth / np.sqrt(view.camera.K[0, 0] * view.camera.K[1, 1]).astype(np.float32)
    return sizes


def median_footprint(views: Sequence[SurfaceView], min_alpha: float) -> float | None:
    """Return the median pixel footprint on the surface; None where no view shows any surface.

    It is the median over the views of each view's median, in the scene's unit.
    """
    medians = [np.median(footprint(view)[usable]) for view in views if (usable := view.usable(min_alpha)).any()]
    return float(np.median(medians)) if medians else None


def _lengths(vectors: np.ndarray) -> np.ndarray:
    lengths: np.ndarray = np.sqrt(np.einsum("hwc,hwc->hw", vectors, vectors))
    return lengths


_ALL, _HEAD, _TAIL = slice(None), slice(None, -1), slice(1, None)
_NEIGHBOURS = [
    ((_HEAD, _ALL), (_TAIL, _ALL)),
    ((_TAIL, _ALL), (_HEAD, _ALL)),
    ((_ALL, _HEAD), (_ALL, _TAIL)),
    ((_ALL, _TAIL), (_ALL, _HEAD)),
]


def _on_edge(usable: np.ndarray, positions: np.ndarray, normals: np.ndarray, limit: np.ndarray) -> np.ndarray:
    """Return the pixels [H,W] bool at an edge, where splats of both sides are blended.

    Such a pixel has a neighbour that is empty or lies more than `limit` [H,W] off its tangent plane.
    """
    edge = np.zeros(usable.shape, bool)
    for here, there in _NEIGHBOURS:
        off = np.abs(np.einsum("hwc,hwc->hw", positions[there] - positions[here], normals[here]))
        edge[here] |= (off > limit[here]) | ~usable[there]
    return edge
