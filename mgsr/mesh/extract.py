"""Mesh extraction: from rendered views to a clean coloured mesh."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from time import perf_counter

import numpy as np

from mgsr.config import ExpertConfig, Extractor, MeshConfig
from mgsr.errors import MeshError
from mgsr.geometry.mesh import Mesh
from mgsr.mesh.cleanup import drop_unseen, pulled_inside, seen_sides
from mgsr.mesh.colors import vertex_colors
from mgsr.mesh.consistency import SilhouetteHull, compare_views
from mgsr.mesh.pixels import PixelRules, back_project, median_footprint
from mgsr.mesh.points import OrientedPoints, front_views, gather_points, missing_points
from mgsr.mesh.poisson import cell_size, poisson_surface, trim_unsupported
from mgsr.mesh.steps import mesh_steps
from mgsr.mesh.steps.step import MeshStep, StepContext, StepReport, TimeLeft, cure
from mgsr.mesh.surface import ReconstructedMesh
from mgsr.mesh.surface_choice import is_torn, photographs_prefer_start
from mgsr.mesh.tsdf import tsdf_surface
from mgsr.mesh.views import SurfaceView
from mgsr.shading.light_estimate import LightEstimate
from mgsr.shading.photo_set import PhotoSet


def extract_mesh(
    views: Sequence[SurfaceView],
    config: MeshConfig,
    photos: PhotoSet = PhotoSet(),
    go_on: Callable[[], bool] = lambda: True,
    start: Mesh | None = None,
    mirroring: bool = False,
    steps: Sequence[MeshStep] | None = None,
    ground: np.ndarray | None = None,
    expert: ExpertConfig = ExpertConfig(),
) -> ReconstructedMesh:
    """Extract the surface that the views show, in their frame, and finish it in steps (`mgsr.mesh.steps`).

    photos: the training photographs, which refine the mesh. With silhouettes, the mesh lies inside them, and its
    contours coincide with theirs.
    go_on: returns whether there is time for another round of refinement.

    start: the surface on which training began. Poisson reconstruction takes its points where the views have no reliable
    ones, such as on flanks that every view sees at a grazing angle. `start` replaces the trained surface if that is
    torn, or if the photographs clearly prefer `start`.
    mirroring: whether a mirrored environment map explains the photographs on `start`. Such a map then judges between
    the two surfaces, else photo-consistency.
    steps: the steps that finish the mesh; None: all.
    ground [4]: the plane on which the object stands, in the views' frame, where the mesh ends; None if it is unknown.
    expert: the options of all algorithms.

    Raises MeshError, with the reason, if there is no surface.
    """
    footprint = median_footprint(views, config.min_alpha)
    if footprint is None:
        raise MeshError(_nothing_seen(views, config))
    bounded = bool(photos.silhouettes) and config.hull_margin is not None
    hull = (
        SilhouetteHull([each.grown(photos.margin) for each in photos.silhouettes], photos.dissent) if bounded else None
    )
    context = StepContext(views, photos, config, footprint, hull, TimeLeft(go_on), ground, expert.mesh)
    trained = _by_poisson(context, start) if config.extractor is Extractor.POISSON else _by_tsdf(context)
    kept = start if start is not None and _start_is_better(start, trained, context, mirroring, expert) else None
    mesh, light, reports = take_steps(
        trained if kept is None else kept, context, mesh_steps(expert) if steps is None else steps
    )
    colors = vertex_colors(mesh, views, config.min_alpha, _tolerance(context), photos.threads, expert.mesh.colors)
    return ReconstructedMesh(mesh.vertices, mesh.faces, colors, light.kind, kept is not None, reports).with_normals(
        mesh.normals
    )


def take_steps(
    mesh: Mesh, context: StepContext, steps: Sequence[MeshStep]
) -> tuple[Mesh, LightEstimate, dict[str, StepReport]]:
    """Run the steps that apply; return the mesh, the light estimate, and the steps' reports by name."""
    light, reports = LightEstimate(), {}
    for step in steps:
        if step.applies(context, light):
            started_at = perf_counter()
            result = step.run(mesh, light, context)
            mesh, light = result.mesh, result.light
            reports[step.name] = StepReport(round(perf_counter() - started_at, 3), len(mesh.faces), result.outcome)
    return mesh, light, reports


def _start_is_better(start: Mesh, trained: Mesh, context: StepContext, mirroring: bool, expert: ExpertConfig) -> bool:
    """Return whether the surface on which training began replaces the trained one."""
    if not context.photos.views or not len(trained.faces):
        return False
    tears = context.options.choice.tears
    # What no view sees of `start` is dropped later. The trained surface ends there already: its rim is no tear.
    torn = is_torn(trained, start, tears) and is_torn(trained, _seen(start, context), tears)
    return torn or photographs_prefer_start(start, trained, context.photos, mirroring, expert)


def _seen(mesh: Mesh, context: StepContext) -> Mesh:
    """Return the part of a mesh that the step `KeepSeen` keeps."""
    seen = seen_sides(mesh, context.views, context.footprint) != 0
    return drop_unseen(mesh, seen, whole_pieces=context.config.close_holes)


def _tolerance(context: StepContext) -> float:
    """Return the depth tolerance between views, in pixel footprints."""
    return context.config.consistency or context.options.colors.tolerance


def _rules(config: MeshConfig) -> PixelRules:
    return PixelRules(config.min_alpha, config.min_cos, config.max_jump, config.radius)


def _by_poisson(context: StepContext, start: Mesh | None) -> Mesh:
    views, config, hull, threads = context.views, context.config, context.hull, context.photos.threads
    options = context.options
    cell = cell_size(_extent(views, config, options.outliers), config.poisson_depth, options.poisson_margin)
    spacing = max(config.cell * cell, context.footprint)
    points = gather_points(views, spacing, _rules(config), threads)
    supporting = np.ones(len(points), bool)
    if start is not None:
        # All added points shape the surface. Those that few views see, such as the underside, do not keep it from being
        # trimmed.
        added = missing_points(points, start, spacing, config.trim * cell)
        seen = front_views(added, start, views, spacing) >= options.supporting_views
        points, supporting = points.joined(added), np.append(supporting, seen)
    if config.consistency is not None:
        reach = options.confirm_reach
        agreement = compare_views(points, views, _rules(config), config.consistency, threads, reach)
        points, supporting = agreement.moved.where(agreement.agreed), supporting[agreement.agreed]
    if hull is not None:
        points, supporting = _inside(points, supporting, hull, context, config.trim * cell)
    if len(points) < 4:
        raise MeshError(_all_dropped(config))
    mesh = poisson_surface(points, config.poisson_depth, options.poisson_margin)
    return mesh if config.close_holes else trim_unsupported(mesh, points.where(supporting), config.trim * cell)


def _inside(
    points: OrientedPoints, supporting: np.ndarray, hull: SilhouetteHull, context: StepContext, reach: float
) -> tuple[OrientedPoints, np.ndarray]:
    """Return the points inside the silhouettes, and which of them support the surface.

    supporting [P] bool: the points that support it. Where all points within `reach`, in the scene's unit, lie outside,
    those that are near enough are pulled inside: a mask that is a little too small would leave a hole.
    """
    margin = context.config.hull_margin or 0
    excess = hull.excess(points.positions, margin)
    inside, alone = excess == 0, (excess > 0) & (excess <= context.config.hull_reach * context.footprint)
    kept = points.where(inside)
    alone[alone] = ~kept.near(points.positions[alone], reach)
    lost = points.where(alone)
    pulled = OrientedPoints(pulled_inside(lost.positions, lost.normals, hull, margin), lost.normals)
    return kept.joined(pulled), np.append(supporting[inside], supporting[alone])


def _extent(views: Sequence[SurfaceView], config: MeshConfig, outliers: float) -> float:
    """Return the longest side of the surface's bounding box, in the scene's unit, without outliers.

    outliers: the percentage of the points that are outliers at each end of an axis.
    """
    points_of_views = [back_project(view)[::4, ::4][view.usable(config.min_alpha)[::4, ::4]] for view in views]
    points = np.concatenate(points_of_views)
    if config.radius is not None:
        points = points[np.linalg.norm(points, axis=1) <= config.radius]
    if len(points) == 0:
        raise MeshError(_all_dropped(config))
    low, high = np.percentile(points, [outliers, 100 - outliers], axis=0)
    return float((high - low).max())


def _by_tsdf(context: StepContext) -> Mesh:
    config = context.config
    voxel = config.voxel * context.footprint
    return tsdf_surface(context.views, voxel, config.truncation, config.min_weight, _rules(config))


def _nothing_seen(views: Sequence[SurfaceView], config: MeshConfig) -> str:
    if not views:
        return "empty mesh: expected at least two rendered views, got none"
    best = max(float(view.alpha.max()) for view in views)
    return (
        f"empty mesh: no pixel of the {len(views)} rendered views has a depth and an alpha of "
        f"mesh.min_alpha={config.min_alpha} (the largest alpha is {best:.2f}); the 2D branch shows no surface, so "
        "train it longer or check its opacities"
    )


def _all_dropped(config: MeshConfig) -> str:
    reason = "every point was dropped as grazing, blended, contradicted or too far away"
    return f"empty mesh: {reason}; {cure(config)}"
