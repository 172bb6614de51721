"""Mesh extraction: from rendered views to a clean coloured mesh."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from mgsr.config import Extractor, MeshConfig
from mgsr.data.camera import pixel_size
from mgsr.data.scene import View
from mgsr.data.silhouettes import Silhouette
from mgsr.errors import MeshError
from mgsr.geometry.decimate import decimate
from mgsr.geometry.fairing import smooth_noise
from mgsr.geometry.outlines import find_outline, fit_outlines
from mgsr.geometry.triangles import Triangles, drop_degenerate, drop_small_pieces, vertex_normals
from mgsr.geometry.waves import smooth_waves
from mgsr.mesh import cleanup
from mgsr.mesh.bending import bend_to_views
from mgsr.mesh.colors import TOLERANCE, vertex_colors
from mgsr.mesh.consistency import Hull, compare_views
from mgsr.mesh.likelier import is_torn, start_is_likelier
from mgsr.mesh.pixels import PixelRules, back_project, median_footprint
from mgsr.mesh.points import gather_points
from mgsr.mesh.poisson import cell_size, poisson_surface, trim_unsupported
from mgsr.mesh.refinement import hold_against_photographs
from mgsr.mesh.surface import Mesh
from mgsr.mesh.tsdf import tsdf_surface
from mgsr.mesh.views import SurfaceView
from mgsr.shading.refine import Light


def extract_mesh(
    views: Sequence[SurfaceView],
    config: MeshConfig,
    silhouettes: Sequence[Silhouette] = (),
    photographs: Sequence[View] = (),
    threads: int | None = None,
    go_on: Callable[[], bool] = lambda: True,
    start: Triangles | None = None,
) -> Mesh:
    """Extract the surface that the views show, in their frame.

    silhouettes: the training photographs' masks, if the scene has them; nothing of the mesh then lies outside them, and
    its contours fall on theirs.
    photographs: the training views; where a flash on the camera explains their shading, it refines the mesh; where
    there are silhouettes, so does their parallax. Under a flash, patches with a large photometric residual are removed;
    without one, the surface's shallow waves are smoothed.
    threads: cores to use; None is all of them. go_on: whether there is time for another round of refinement.
    start: the surface that training began on, which replaces the views' where the photographs clearly speak for it; it
    is bent to the views' where theirs is torn.

    Raises MeshError, with the reason, where no surface comes out.
    """
    size = median_footprint(views, config.min_alpha)
    if size is None:
        raise MeshError(_nothing_seen(views, config))
    hull = Hull(silhouettes) if silhouettes and config.hull_margin is not None else None
    extract = {Extractor.POISSON: _by_poisson, Extractor.TSDF: _by_tsdf}[config.extractor]
    vertices, faces = extract(views, config, size, hull, threads)
    if start is None or not photographs or not len(faces):
        chosen = None
    elif is_torn((vertices, faces), start):
        chosen = bend_to_views(*start, views, _rules(config), _tolerance(config), threads), start[1]
    else:
        chosen = start if start_is_likelier(start, (vertices, faces), photographs) else None
    surface = (vertices, faces) if chosen is None else chosen
    mesh = _finish(*surface, views, config, size, hull, silhouettes, photographs, threads, go_on)
    return replace(mesh, start_kept=chosen is not None)


def _tolerance(config: MeshConfig) -> float:
    """Return the pixel footprints by which views may differ about a place."""
    return config.consistency or TOLERANCE


def _rules(config: MeshConfig) -> PixelRules:
    return PixelRules(config.min_alpha, config.min_cos, config.max_jump, config.radius)


def _by_poisson(
    views: Sequence[SurfaceView], config: MeshConfig, size: float, hull: Hull | None, threads: int | None
) -> Triangles:
    cell = cell_size(_extent(views, config), config.poisson_depth)
    points = gather_points(views, max(config.cell * cell, size), _rules(config), threads)
    if config.consistency is not None:
        agreement = compare_views(points, views, _rules(config), config.consistency, threads)
        points = agreement.moved.where(agreement.agreed)
    if hull is not None:
        points = points.where(hull.excess(points.positions, config.hull_margin or 0) == 0)
    if len(points) < 4:
        raise MeshError(_all_dropped(config))
    vertices, faces = poisson_surface(points, config.poisson_depth)
    if config.close_holes:
        return vertices, faces
    return trim_unsupported(vertices, faces, points, config.trim * cell)


def _extent(views: Sequence[SurfaceView], config: MeshConfig) -> float:
    """Return the longest side of the box that holds the surface, without the outermost 0.1% at each end."""
    looks = [back_project(view)[::4, ::4][view.usable(config.min_alpha)[::4, ::4]] for view in views]
    points = np.concatenate(looks)
    if config.radius is not None:
        points = points[np.linalg.norm(points, axis=1) <= config.radius]
    if len(points) == 0:
        raise MeshError(_all_dropped(config))
    low, high = np.percentile(points, [0.1, 99.9], axis=0)
    return float((high - low).max())


def _by_tsdf(
    views: Sequence[SurfaceView], config: MeshConfig, size: float, hull: Hull | None, threads: int | None
) -> Triangles:
    return tsdf_surface(views, config.voxel * size, config.truncation, config.min_weight, _rules(config))


def _finish(
    vertices: np.ndarray,
    faces: np.ndarray,
    views: Sequence[SurfaceView],
    config: MeshConfig,
    size: float,
    hull: Hull | None,
    silhouettes: Sequence[Silhouette],
    photographs: Sequence[View],
    threads: int | None,
    go_on: Callable[[], bool],
) -> Mesh:
    """Clean, orient, refine, decimate and colour a raw surface; `size` is the views' footprint."""
    if hull is not None and len(faces):
        vertices, faces = cleanup.pull_into_hull(
            vertices, faces, hull, config.hull_margin or 0, config.hull_reach * size
        )
    vertices, faces = drop_degenerate(vertices, faces)
    _require_faces(faces, "no pixel's surface survived the fusion", config)
    vertices, faces = drop_small_pieces(vertices, faces, config.min_piece)
    sides = cleanup.seen_sides(vertices, faces, views, gap=size)
    faces = cleanup.turn_outwards(faces, sides)
    vertices, faces = cleanup.drop_unseen(vertices, faces, sides != 0, whole_pieces=config.close_holes)
    _require_faces(faces, "no camera sees any of the surface", config)
    outlines = [find_outline(silhouette) for silhouette in silhouettes]
    if outlines and config.silhouette_smoothing is not None:
        vertices = fit_outlines(vertices, faces, outlines, config.silhouette_smoothing)
    held = hold_against_photographs(vertices, faces, photographs, outlines, config, threads, go_on)
    vertices, faces = held.vertices, held.faces
    if held.opened:
        vertices, faces = drop_small_pieces(vertices, faces, config.min_piece)
    if config.regression_angle and photographs and held.light is not Light.FLASH:
        pixel = pixel_size([view.camera for view in photographs], vertices.mean(axis=0))
        vertices = smooth_waves(vertices, faces, pixel, config.regression_angle)
    if config.bilateral_angle:
        vertices = smooth_noise(vertices, faces, config.bilateral_angle)
    if config.close_holes:
        vertices, faces = cleanup.close_loops(vertices, faces)
    if config.max_faces is not None:
        vertices, faces = decimate(vertices, faces, config.max_faces)
    normals = vertex_normals(vertices, faces)
    colors = vertex_colors(vertices, normals, views, config.min_alpha, _tolerance(config), threads)
    return Mesh(vertices, faces, normals, colors, held.light, held.parallax, held.opened)


def _require_faces(faces: np.ndarray, reason: str, config: MeshConfig) -> None:
    if len(faces) == 0:
        raise MeshError(f"empty mesh: {reason}; {_CURE.format(config=config)}")


_CURE = (
    "look at the rendered depth of the 2D branch: train it longer, or relax mesh.min_alpha={config.min_alpha}, "
    "mesh.min_cos={config.min_cos}, mesh.consistency={config.consistency} or mesh.radius={config.radius}"
)


def _nothing_seen(views: Sequence[SurfaceView], config: MeshConfig) -> str:
    if not views:
        return "empty mesh: no views were rendered; give at least two"
    best = max(float(view.alpha.max()) for view in views)
    return (
        f"empty mesh: no pixel of the {len(views)} rendered views has a depth and an alpha of "
        f"mesh.min_alpha={config.min_alpha} (the largest alpha is {best:.2f}): the 2D branch shows no surface; "
        "train it longer or look at its opacities"
    )


def _all_dropped(config: MeshConfig) -> str:
    reason = "every pixel's point was dropped as grazing, blended, contradicted or too far"
    return f"empty mesh: {reason}; {_CURE.format(config=config)}"
