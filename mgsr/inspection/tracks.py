"""Tracks: points that several photographs share, triangulated with the given cameras and projected back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from mgsr.config.expert import InspectionConfig
from mgsr.data.camera import Camera
from mgsr.inspection.features import Features
from mgsr.inspection.pairs import Pair
from mgsr.inspection.triangulation import nearest_points, unit_rays


@dataclass(frozen=True)
class Tracks:
    """Observations of points. points [P,3], in the cameras' frame.

    of_point [O], of_photo [O]: the indices of each observation's point and photograph. pixels [O,2]: its place.
    """

    points: np.ndarray
    of_point: np.ndarray
    of_photo: np.ndarray
    pixels: np.ndarray

    def reprojection(self, cameras: Sequence[Camera]) -> np.ndarray:
        """Return each photograph's median reprojection error [V] in pixels; NaN without observations."""
        medians = np.full(len(cameras), np.nan)
        for index, camera in enumerate(cameras):
            mine = self.of_photo == index
            if mine.any():
                projected, _ = camera.project(self.points[self.of_point[mine]])
                medians[index] = np.median(np.linalg.norm(projected - self.pixels[mine], axis=1))
        return medians


def find_tracks(
    cameras: Sequence[Camera],
    features: Sequence[Features],
    pairs: Sequence[Pair],
    least: int = InspectionConfig().track,
) -> Tracks:
    """Find the points that at least `least` photographs share, from the matches of the pairs."""
    first = np.concatenate([[0], np.cumsum([len(one) for one in features])]).astype(np.int64)
    links = [pair.matches[pair.own] + (first[pair.one], first[pair.other]) for pair in pairs if pair.own.any()]
    edges = np.concatenate(links) if links else np.zeros((0, 2), np.int64)
    total = int(first[-1])
    graph = coo_matrix((np.ones(len(edges), bool), (edges[:, 0], edges[:, 1])), shape=(total, total))
    label = connected_components(graph, directed=False)[1]
    photo = np.repeat(np.arange(len(features)), np.diff(first))
    sizes = np.bincount(label, minlength=1)
    # A track with two features of one photograph is a mistake.
    distinct = np.unique(np.stack([label, photo]), axis=1)[0]
    good = (sizes >= least) & (np.bincount(distinct, minlength=len(sizes)) == sizes)
    used = np.flatnonzero(good[label]) if total else np.zeros(0, np.int64)
    names, of_point = np.unique(label[used], return_inverse=True)
    pixels = np.concatenate([one.pixels for one in features])[used]
    rays, origins = np.empty((len(used), 3)), np.array([camera.center for camera in cameras])[photo[used]]
    for index, camera in enumerate(cameras):
        mine = photo[used] == index
        rays[mine] = unit_rays(camera, pixels[mine])
    points = nearest_points(origins, rays, of_point, len(names))
    return Tracks(points, of_point, photo[used], pixels)
