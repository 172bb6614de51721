"""Refinement of a mesh by the photographs: shading, parallax, and removal of patches that they contradict."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mgsr.config import MeshConfig
from mgsr.data.camera import pixel_size
from mgsr.data.scene import View
from mgsr.geometry.contours import SilhouetteContour
from mgsr.geometry.triangles import face_components, face_crosses, keep_faces
from mgsr.shading.light_models import LightModel
from mgsr.shading.photometric_refinement import refine_photometrically
from mgsr.shading.photometric_residual import photometric_residual
from mgsr.shading.shape_from_shading import Light, ShadingPass, ShadingResult, shape_from_shading

# Training knows the large shape better than shading does, which light that hollows throw back again and again flattens.
# A flash tells each point's normal by itself. Mirrored surroundings need the readings of neighbours: they better the
# start on the hull, but no trained surface, of which they only say how far parallax can be believed. Shading and
# parallax take turns: what the one puts right of a hollow lets the other see deeper into it.
_TURNS = (
    {Light.FLASH: (ShadingPass(edge=1.0, rounds=3, reach=60.0),)},
    {Light.FLASH: (ShadingPass(edge=1.0, rounds=2, reach=60.0),)},
)

SMALLEST = 10.0  # pixels that a patch covers which is taken out


@dataclass(frozen=True)
class RefinedMesh:
    """A mesh refined by the photographs, vertices [V,3] and faces [F,3].

    light: what lit the photographs, as far as they tell; parallax: whether photometric refinement moved the mesh;
    removed_area: the share of its area that was removed, as the photographs contradict it.
    """

    vertices: np.ndarray
    faces: np.ndarray
    light: Light = Light.UNKNOWN
    parallax: bool = False
    removed_area: float = 0.0


def refine_mesh(
    vertices: np.ndarray,
    faces: np.ndarray,
    photographs: Sequence[View],
    contours: Sequence[SilhouetteContour],
    config: MeshConfig,
    threads: int | None,
    go_on: Callable[[], bool],
) -> RefinedMesh:
    """Refine a mesh by the photographs, as far as `config` allows.

    vertices [V,3]; faces [F,3]; contours: the masks' contours, none without masks; go_on: asked before each further
    step.
    """
    if not photographs or config.shading_ratio is None:
        return RefinedMesh(vertices, faces)
    refined, reach, parallax = ShadingResult(vertices, Light.UNKNOWN), config.photometric_reach, False
    for turn, passes in enumerate(_TURNS):
        if turn and not (refined.light in passes and go_on()):
            break
        refined = shape_from_shading(
            refined.vertices, faces, photographs, contours, config.shading_ratio, passes, threads, go_on=go_on
        )
        if reach is not None and contours and go_on():
            moved = refine_photometrically(
                refined.vertices, faces, photographs, contours, reach, refined.light_model, threads, go_on
            )
            refined, parallax = replace(refined, vertices=moved), True
    light_model, held = refined.light_model, RefinedMesh(refined.vertices, faces, refined.light, parallax)
    if light_model is None or refined.light is not Light.FLASH or config.close_holes or not go_on():
        return held
    return _without_contradicted(held, photographs, light_model, config.max_photometric_residual, threads)


def _without_contradicted(
    held: RefinedMesh, photographs: Sequence[View], light_model: LightModel, most: float | None, threads: int | None
) -> RefinedMesh:
    """Return the mesh without the patches that the photographs contradict.

    In such a patch the photometric residual is everywhere above half of `most`, and somewhere above it. It covers more
    than SMALLEST pixels.
    """
    if most is None:
        return held
    vertices, faces = held.vertices, held.faces
    differing = photometric_residual(vertices, faces, photographs, light_model, threads)[faces].max(axis=1)
    doubted = np.flatnonzero(differing > most / 2)
    areas = np.linalg.norm(face_crosses(vertices, faces), axis=1) / 2
    count, patches = face_components(faces[doubted], len(vertices))
    certain = np.bincount(patches, differing[doubted] > most, count) > 0
    large = np.bincount(patches, areas[doubted], count) > _area_of_a_pixel(vertices, photographs) * SMALLEST
    gone = doubted[(certain & large)[patches]]
    kept = np.ones(len(faces), bool)
    kept[gone] = False
    removed_area = float(areas[gone].sum() / areas.sum())
    return RefinedMesh(*keep_faces(vertices, faces, kept), held.light, held.parallax, removed_area)


def _area_of_a_pixel(vertices: np.ndarray, photographs: Sequence[View]) -> float:
    return pixel_size([view.camera for view in photographs], vertices.mean(axis=0)) ** 2
