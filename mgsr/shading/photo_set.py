"""The photographs of a capture, with derived data for refinement that is computed once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mgsr.config.expert import ObservationOptions
from mgsr.data.camera import pixel_size
from mgsr.data.photograph import Photograph
from mgsr.data.scene import Scene, View, some_of
from mgsr.data.silhouettes import Silhouette
from mgsr.geometry.contours import SilhouetteContour, find_contour
from mgsr.geometry.decimate import coarser
from mgsr.geometry.mesh import Mesh
from mgsr.shading.observations import Observations, observe_photographs


@dataclass(frozen=True, eq=False)
class PhotoSet:
    """The photographs of a capture.

    views: the training views. silhouettes: of their masks, at any size; empty without masks. threads: the cores to use;
    None: all. options: of the observations. dissent: the number of silhouettes that may exclude a part of the object.
    margin: pixels by which a part of the object may lie outside silhouettes. masks_inexact: whether the contours of the
    masks are inaccurate.
    """

    views: Sequence[View] = ()
    silhouettes: Sequence[Silhouette] = ()
    threads: int | None = None
    options: ObservationOptions = ObservationOptions()
    dissent: int = 0
    margin: float = 0.0
    masks_inexact: bool = False

    @classmethod
    def of_scene(
        cls, scene: Scene, silhouettes: Sequence[Silhouette], options: ObservationOptions = ObservationOptions()
    ) -> PhotoSet:
        """Return the training photographs of a scene. silhouettes: of their masks, at any size."""
        return cls(scene.train, silhouettes, None, options, scene.mask_dissent, scene.mask_margin, scene.masks_inexact)

    @cached_property
    def photographs(self) -> list[Photograph]:
        """Return the views as photographs, which share their derived images among all steps of a refinement."""
        return [Photograph(view, self.options.min_alpha, self.options.clipped) for view in self.views]

    @cached_property
    def contours(self) -> list[SilhouetteContour]:
        """Return the contours of the silhouettes."""
        return [find_contour(silhouette) for silhouette in self.silhouettes]

    def pixel_on(self, mesh: Mesh) -> float:
        """Return the size of a pixel at a mesh's centroid, in the scene's unit."""
        return pixel_size([view.camera for view in self.views], mesh.vertices.mean(axis=0))

    def observer(self, pixel: float) -> Observer:
        """Return an observer of meshes on which a pixel has the size `pixel`, in the scene's unit."""
        return Observer(self, pixel)


@dataclass(frozen=True)
class Observer:
    """Photographs that observe meshes; pixel: a pixel's size on the meshes, in the scene's unit."""

    photos: PhotoSet
    pixel: float

    @property
    def photographs(self) -> list[Photograph]:
        """Return as many of the photographs as examine a surface."""
        return some_of(self.photos.photographs)

    def observe(self, mesh: Mesh, lamps: np.ndarray | None = None) -> Observations:
        """Sample the photographs at a mesh's vertices. lamps [N,3]: as for `observe_photographs`."""
        photos = self.photos
        return observe_photographs(mesh, self.photographs, self.pixel, photos.threads, lamps, photos.options)

    def coarser(self, mesh: Mesh, edge: float, max_faces: int) -> Mesh:
        """Simplify a mesh to edges of `edge` pixels or longer, and to `max_faces` faces at most."""
        return coarser(mesh, edge * self.pixel, max_faces)
