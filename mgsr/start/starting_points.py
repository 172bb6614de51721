"""Starting points of the splats, from the capture's own points, the visual hull, stereo or a random ball."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from mgsr.config import Background, ExpertConfig
from mgsr.config.expert import StartConfig, ViewColorOptions
from mgsr.data.hull import Hull, carve, cut_at, hull_surface
from mgsr.data.scene import PointCloud, Scene, View
from mgsr.data.silhouettes import Silhouette, view_silhouettes
from mgsr.geometry.mesh import Mesh
from mgsr.shading.photo_set import PhotoSet
from mgsr.start.background_points import background_points
from mgsr.start.masked_surface import find_surface
from mgsr.start.points import StartingPoints, StartSource
from mgsr.start.scene_depths import DepthMaps, scene_depths
from mgsr.start.scene_points import scene_points
from mgsr.start.view_colors import median_colors


def starting_points(
    scene: Scene,
    count: int,
    seed: int,
    progress: Callable[[float], None] = lambda done: None,
    background: Background = Background.AUTO,
    expert: ExpertConfig = ExpertConfig(),
    depths: DepthMaps | None = None,
) -> StartingPoints:
    """Choose the points to start from; the same seed gives the same points.

    progress: receives the share of the work that is done, 0..1. background: the setting for the search for a plain
    backdrop. expert: the options of all algorithms.

    With masks, the points lie evenly on the surface that stereo, shading and photometric refinement find inside the
    visual hull, where a view sees it. That surface is more accurate than the capture's own points (COLMAP). There are
    `count` of them, and more where the photographs show the surface with many pixels (`StartConfig.detail`).

    Without masks, the points come from the capture and from stereo, with background points in directions without other
    points, and none on a plain backdrop. Their number follows from the photographs' resolution. If stereo alone finds
    too few points, `count` random points fill the unit ball.

    depths: the scene's `scene_depths`, which are found here if they are None.
    """
    generator = np.random.default_rng(seed)
    if scene.masked:
        silhouettes = view_silhouettes(scene.train, expert.start.mask_side)
        return _surface_points(scene, silhouettes, count, seed, generator, progress, expert)
    own = _own_points(scene.points, expert.start.max_distance) if scene.points is not None else None
    if depths is None:
        depths = scene_depths(scene.train, seed, progress, expert.start.stereo, expert.stereo)
    return _unmasked_points(scene, own, depths, count, seed, background, expert.start)


def ball_points(
    views: Sequence[View], count: int, seed: int, options: ViewColorOptions = ViewColorOptions()
) -> StartingPoints:
    """Draw `count` random points evenly in the unit ball, with the colours that the views show at them."""
    generator = np.random.default_rng(seed)
    directions = generator.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    positions = directions * np.cbrt(generator.random(count))[:, None]
    return StartingPoints(positions, median_colors(views, positions, options=options), StartSource.BALL)


def hull_points(
    scene: Scene, count: int, seed: int, resolution: int, options: StartConfig = StartConfig()
) -> StartingPoints:
    """Spread `count` points evenly over the surface of the visual hull of a scene with masks.

    resolution: voxels along a side of the grid. Raises SceneError if the hull is empty.
    """
    silhouettes = view_silhouettes(scene.train, options.mask_side)
    mesh = Mesh(*hull_surface(_carved(scene, silhouettes, resolution, options)))
    positions, normals = _sample(mesh, count, np.random.default_rng(seed))
    return _seen_on_hull(scene.train, positions, normals, resolution, options)


def _carved(scene: Scene, silhouettes: Sequence[Silhouette], resolution: int, options: StartConfig) -> Hull:
    """Carve the visual hull with `resolution` voxels along a side. It tolerates the errors of inexact masks."""
    grown = [silhouette.grown(scene.mask_margin) for silhouette in silhouettes]
    return carve(grown, np.zeros(3), options.carved, resolution, scene.mask_dissent)


def _own_points(points: PointCloud, max_distance: float) -> PointCloud:
    """Return the capture's points that are finite and near enough."""
    good = np.isfinite(points.positions).all(axis=1) & (np.abs(points.positions) < max_distance).all(axis=1)
    return points.rows(good)


def _unmasked_points(
    scene: Scene,
    own: PointCloud | None,
    depths: DepthMaps,
    count: int,
    seed: int,
    background: Background,
    options: StartConfig,
) -> StartingPoints:
    points, source = scene_points(scene.train, depths, options.stereo), StartSource.STEREO
    if own is not None and len(own):
        points, source = own.joined(points), StartSource.CAPTURE
    last = scene.backdrop(background)
    points = points.rows(~last.hides(points.colors))
    if source is StartSource.STEREO and len(points) < options.min_points:
        return ball_points(scene.train, count, seed, options.colors)
    points = _without_isolated(points, options)
    if not last.plain:
        points = points.joined(background_points(scene.train, points.positions, options.background))
    return StartingPoints(points.positions, points.colors, source)


def _without_isolated(points: PointCloud, options: StartConfig) -> PointCloud:
    """Drop isolated points in the ball, as their splats would become huge floating disks."""
    inside = np.linalg.norm(points.positions, axis=1) <= options.ball
    if not inside.any():
        return points
    spacing = cKDTree(points.positions).query(points.positions, k=4)[0][:, 1:].mean(axis=1)
    kept = ~inside | (spacing <= options.max_spacing * np.median(spacing[inside]))
    return points.rows(kept)


def _surface_points(
    scene: Scene,
    silhouettes: Sequence[Silhouette],
    count: int,
    seed: int,
    generator: np.random.Generator,
    progress: Callable[[float], None],
    expert: ExpertConfig,
) -> StartingPoints:
    side = max(max(silhouette.distance.shape) for silhouette in silhouettes)
    resolution, options = expert.start.resolution, expert.start
    resolution = resolution if side >= resolution else resolution // 2  # small images have no finer detail
    hull = _carved(scene, silhouettes, resolution, options)
    if scene.ground is not None:
        hull = cut_at(hull, scene.ground)
    photos = PhotoSet.of_scene(scene, silhouettes, expert.shading.observations)
    found = find_surface(photos, hull, seed, progress, expert)
    pixel = photos.pixel_on(found.mesh)
    seen = _seen(found.mesh, scene.train, pixel)
    pixels = seen.area / pixel**2
    positions, normals = _sample(seen, round(options.detail(pixels) * count), generator)
    return replace(
        _seen_on_hull(scene.train, positions, normals, resolution, options),
        light=found.light,
        lighting=found.lighting,
        surface=found.mesh,
        surface_pixels=pixels,
    )


def _seen(mesh: Mesh, views: Sequence[View], gap: float) -> Mesh:
    """Return the faces of a mesh that a view sees; all if the views see none.

    gap: the distance before a vertex, in the scene's unit, within which nothing occludes it.
    """
    seen = np.zeros(len(mesh.vertices), bool)
    for view in views:
        left = np.flatnonzero(~seen)
        seen[left] = mesh.caster.sees(view.camera, mesh.vertices[left], gap, _shown(view))
    faces = seen[mesh.faces].any(axis=1)
    return mesh.keep_faces(faces) if faces.any() else mesh


def _shown(view: View) -> np.ndarray | None:
    """Return the valid pixels [H,W] bool that show the object; None if all do."""
    masks = [view.valid_mask, None if view.alpha is None else view.alpha > 127]
    known = [mask for mask in masks if mask is not None]
    return np.logical_and.reduce(known) if known else None


def _seen_on_hull(
    views: Sequence[View], positions: np.ndarray, normals: np.ndarray, resolution: int, options: StartConfig
) -> StartingPoints:
    """Return starting points at positions [P,3] with normals [P,3] on the hull, with the colours that views show."""
    tolerance = options.occluding * options.carved / resolution
    colors = median_colors(views, positions, normals, tolerance, options.colors)
    return StartingPoints(positions, colors, StartSource.HULL, normals)


def _sample(mesh: Mesh, count: int, generator: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Draw `count` points evenly on a mesh: positions [count,3], and their faces' unit normals [count,3]."""
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    across = mesh.face_crosses
    area = np.linalg.norm(across, axis=1)
    sums = np.cumsum(area)
    # Stratified sampling: one point in each of `count` equal parts of the area leaves no part empty.
    place = (np.arange(count) + generator.random(count)) / count * sums[-1]
    chosen = np.minimum(np.searchsorted(sums, place), len(mesh.faces) - 1)
    u, v = generator.random((2, count))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    positions = a[chosen] + u[:, None] * (b - a)[chosen] + v[:, None] * (c - a)[chosen]
    return positions, across[chosen] / np.maximum(area[chosen], 1e-20)[:, None]
