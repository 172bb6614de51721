"""Selection of reliable rendered pixels, and their back-projection."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mgsr.data.camera import Camera
from mgsr.geometry.raycast import pixel_rays
from mgsr.geometry.vectors import dots, lengths
from mgsr.mesh.views import SurfaceView

STEEPEST = 0.3  # cosine between normal and view direction below which the depth tolerance grows no further


@dataclass(frozen=True)
class PixelRules:
    """Conditions that a reliable pixel meets.

    min_alpha: least alpha. min_cos: least cosine between normal and view direction. max_jump: largest distance of a
    neighbour from the pixel's tangent plane, in pixel footprints; None: any. radius: largest distance from the scene's
    centre, in its unit; None: any.
    """

    min_alpha: float
    min_cos: float
    max_jump: float | None = None
    radius: float | None = None


@dataclass(frozen=True)
class SurfacePixels:
    """A view's pixels, back-projected to the surface.

    positions [H,W,3]: in the scene's frame. normals [H,W,3]: unit, in the scene's frame. cosines [H,W]: between the
    normal and the view direction. believed [H,W] bool: the reliable pixels; the other arrays are undefined elsewhere.
    """

    positions: np.ndarray
    normals: np.ndarray
    cosines: np.ndarray
    believed: np.ndarray


def surface_pixels(view: SurfaceView, rules: PixelRules) -> SurfacePixels:
    """Back-project a view's pixels, and select the reliable ones by the rules."""
    rays = pixel_rays(view.camera)
    normals = view.normal / np.maximum(lengths(view.normal), 1e-9)[..., None]
    cosines = -dots(normals, rays) / lengths(rays)
    positions = back_project(view, rays)
    usable = view.usable(rules.min_alpha)
    believed = usable & (cosines >= rules.min_cos)
    if rules.radius is not None:
        believed &= lengths(positions) <= rules.radius
    if rules.max_jump is not None:
        believed &= ~_on_edge(usable, positions, normals, rules.max_jump * footprint(view))
    return SurfacePixels(positions, normals, cosines, believed)


def back_project(view: SurfaceView, rays: np.ndarray | None = None) -> np.ndarray:
    """Return the point [H,W,3] at each pixel's depth, in the scene's frame.

    rays [H,W,3]: the result of `pixel_rays` for the camera; computed if None.
    """
    rays = pixel_rays(view.camera) if rays is None else rays
    points: np.ndarray = view.camera.center.astype(np.float32) + rays * view.depth[..., None]
    return points


def footprint(view: SurfaceView) -> np.ndarray:
    """Return the footprint [H,W] of each pixel: its size on the surface that it shows, in the scene's unit."""
    sizes: np.ndarray = view.depth / np.sqrt(view.camera.K[0, 0] * view.camera.K[1, 1]).astype(np.float32)
    return sizes


def depth_limits(tolerance: float, depths: np.ndarray, cosines: np.ndarray, camera: Camera) -> np.ndarray:
    """Return by how much a view's depths may differ from those of points of the same surface, [P].

    tolerance: in pixel footprints; it grows where the view looks along the surface. depths [P]: camera z of the points.
    cosines [P]: between their normals and the view directions.
    """
    limits: np.ndarray = tolerance * depths / np.float32(camera.K[0, 0]) / np.maximum(cosines, STEEPEST)
    return limits


def median_footprint(views: Sequence[SurfaceView], min_alpha: float) -> float | None:
    """Return the median pixel footprint, in the scene's unit; None if no view shows a surface.

    It is the median over the views of each view's median.
    """
    medians = [np.median(footprint(view)[usable]) for view in views if (usable := view.usable(min_alpha)).any()]
    return float(np.median(medians)) if medians else None


_ALL, _HEAD, _TAIL = slice(None), slice(None, -1), slice(1, None)
_NEIGHBOURS = [
    ((_HEAD, _ALL), (_TAIL, _ALL)),
    ((_TAIL, _ALL), (_HEAD, _ALL)),
    ((_ALL, _HEAD), (_ALL, _TAIL)),
    ((_ALL, _TAIL), (_ALL, _HEAD)),
]


def _on_edge(usable: np.ndarray, positions: np.ndarray, normals: np.ndarray, limit: np.ndarray) -> np.ndarray:
    """Return the pixels [H,W] bool at a depth edge, where splats of both sides blend.

    Such a pixel has a neighbour that is not usable, or that lies more than `limit` off the pixel's tangent plane.
    usable [H,W] bool. positions [H,W,3], normals [H,W,3]: in the scene's frame. limit [H,W]: in the scene's unit.
    """
    edge = np.zeros(usable.shape, bool)
    for here, there in _NEIGHBOURS:
        off = np.abs(dots(positions[there] - positions[here], normals[here]))
        edge[here] |= (off > limit[here]) | ~usable[there]
    return edge
