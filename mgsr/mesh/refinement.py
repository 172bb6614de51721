"""Refinement of a mesh by the photographs: shading, parallax, and removal of patches that they contradict."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mgsr.config import MeshConfig
from mgsr.data.camera import pixel_size
from mgsr.data.scene import View
from mgsr.geometry.outlines import Outline
from mgsr.geometry.triangles import face_components, face_crosses, keep_faces
from mgsr.shading.disagreement import disagreement
from mgsr.shading.kinds import Shading
from mgsr.shading.parallax import refine_by_parallax
from mgsr.shading.refine import Light, Pass, Refined, refine_by_shading

# Training knows the large shape better than shading does, which light that hollows throw back again and again flattens.
# A flash tells each point's normal by itself. Mirrored surroundings need the readings of neighbours: they better the
# start on the hull, but no trained surface, of which they only say how far parallax can be believed. Shading and
# parallax take turns: what the one puts right of a hollow lets the other see deeper into it.
_TURNS = (
    {Light.FLASH: (Pass(edge=1.0, rounds=3, reach=60.0),)},
    {Light.FLASH: (Pass(edge=1.0, rounds=2, reach=60.0),)},
)

SMALLEST = 10.0  # pixels that a patch covers which is taken out


@dataclass(frozen=True)
class Held:
    """A mesh refined by the photographs, vertices [V,3] and faces [F,3].

    light: what lit the photographs, as far as they tell; parallax: whether photometric refinement moved the mesh;
    opened: the share of its area that was removed, as the photographs contradict it.
    """

    vertices: np.ndarray
    faces: np.ndarray
    light: Light = Light.UNKNOWN
    parallax: bool = False
    opened: float = 0.0


def hold_against_photographs(
    vertices: np.ndarray,
    faces: np.ndarray,
    photographs: Sequence[View],
    outlines: Sequence[Outline],
    config: MeshConfig,
    threads: int | None,
    go_on: Callable[[], bool],
) -> Held:
    """Refine a mesh by the photographs, as far as `config` allows.

    vertices [V,3]; faces [F,3]; outlines: the masks' contours, none without masks; go_on: asked before each further
    step.
    """
    if not photographs or config.max_light_residual is None:
        return Held(vertices, faces)
    refined, reach, parallax = Refined(vertices, Light.UNKNOWN), config.photometric_reach, False
    for turn, passes in enumerate(_TURNS):
        if turn and not (refined.light in passes and go_on()):
            break
        refined = refine_by_shading(
            refined.vertices, faces, photographs, outlines, config.max_light_residual, passes, threads, go_on=go_on
        )
        if reach is not None and outlines and go_on():
            moved = refine_by_parallax(
                refined.vertices, faces, photographs, outlines, reach, refined.shading, threads, go_on
            )
            refined, parallax = replace(refined, vertices=moved), True
    shading, held = refined.shading, Held(refined.vertices, faces, refined.light, parallax)
    if shading is None or refined.light is not Light.FLASH or config.close_holes or not go_on():
        return held
    return _opened(held, photographs, shading, config.photometric_residual, threads)


def _opened(held: Held, photographs: Sequence[View], shading: Shading, most: float | None, threads: int | None) -> Held:
    """Return the mesh without the patches that the photographs contradict.

    In such a patch the photometric residual is everywhere above half of `most`, and somewhere above it. It covers more
    than SMALLEST pixels.
    """
    if most is None:
        return held
    vertices, faces = held.vertices, held.faces
    differing = disagreement(vertices, faces, photographs, shading, threads)[faces].max(axis=1)
    doubted = np.flatnonzero(differing > most / 2)
    areas = np.linalg.norm(face_crosses(vertices, faces), axis=1) / 2
    count, patches = face_components(faces[doubted], len(vertices))
    certain = np.bincount(patches, differing[doubted] > most, count) > 0
    large = np.bincount(patches, areas[doubted], count) > _area_of_a_pixel(vertices, photographs) * SMALLEST
    gone = doubted[(certain & large)[patches]]
    kept = np.ones(len(faces), bool)
    kept[gone] = False
    opened = float(areas[gone].sum() / areas.sum())
    return Held(*keep_faces(vertices, faces, kept), held.light, held.parallax, opened)


def _area_of_a_pixel(vertices: np.ndarray, photographs: Sequence[View]) -> float:
    return pixel_size([view.camera for view in photographs], vertices.mean(axis=0)) ** 2
