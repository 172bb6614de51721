"""The comparison of pairs of photographs with their cameras: matches should lie on each other's epipolar lines."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from mgsr.config.expert import FeatureOptions, InspectionConfig, PairOptions
from mgsr.data.camera import Camera
from mgsr.data.scene import View
from mgsr.inspection.features import Features, match, similarity
from mgsr.parallel import map_ahead


@dataclass(frozen=True)
class Pair:
    """Two photographs.

    Pixels are those of the reduced images in which features are found.

    matches [M,2]: the indices of the matched features.
    own [M] bool: the matches that one epipolar geometry explains, which is fitted without the cameras.
    residuals [M]: Sampson's distance of each match from the epipolar lines of the cameras, in pixels.
    still [M] bool: the matches at the same pixel of both images, although the cameras move them. All other numbers
    leave these matches out.
    moved: the number of matches that a second geometry explains, where the cameras explain others.
    scale: the size of a pixel, in pixels of the photograph.
    """

    one: int
    other: int
    matches: np.ndarray
    own: np.ndarray
    residuals: np.ndarray
    still: np.ndarray
    moved: int
    scale: float

    @property
    def residual(self) -> float:
        """Return the median residual of the matches that share a geometry; NaN without any."""
        return float(np.median(self.residuals[self.own])) if self.own.any() else float("nan")


@dataclass(frozen=True)
class Likeness:
    """The distance of each two cameras and the similarity of their photographs, both [V,V]."""

    apart: np.ndarray
    alike: np.ndarray

    @classmethod
    def of(
        cls, views: Sequence[View], features: Sequence[Features], options: FeatureOptions = FeatureOptions()
    ) -> Likeness:
        """Return the likeness of the photographs with these features."""
        return cls(camera_distances([view.camera for view in views]), similarity(features, options))

    def pairs(self, allowed: np.ndarray, options: PairOptions = PairOptions()) -> list[tuple[int, int]]:
        """Return the pairs to compare, among the allowed ones [V,V] bool, as sorted indices.

        The cameras' distances alone do not suffice. If the cameras see two copies of one structure, the photographs of
        one copy are far from those of the other.
        """
        chosen = set()
        for table, most in ((self.apart, options.nearest), (-self.alike, options.alike)):
            costs = np.where(allowed, table, np.inf)
            nearest = np.argsort(costs, axis=1, kind="stable")[:, :most]
            ranked = ((i, int(j)) for i, row in enumerate(nearest) for j in row if np.isfinite(costs[i, j]))
            chosen |= {(min(pair), max(pair)) for pair in ranked}
        return sorted(chosen)


def camera_distances(cameras: Sequence[Camera]) -> np.ndarray:
    """Return the difference [C,C] of each two cameras: their distance over the spread of all, plus their turn.

    The turn is the angle between their axes, in radians.
    """
    centers = np.array([camera.center for camera in cameras])
    axes = np.array([camera.cam_from_world[2, :3] for camera in cameras])
    spread = np.linalg.norm(centers - centers.mean(axis=0), axis=1).mean() or 1.0
    between = np.linalg.norm(centers[:, None] - centers[None], axis=2) / spread
    return np.asarray(between + np.arccos(np.clip(axes @ axes.T, -1, 1)))


def compare_pairs(
    views: Sequence[View],
    features: Sequence[Features],
    pairs: Sequence[tuple[int, int]],
    progress: Callable[[float], None],
    options: InspectionConfig = InspectionConfig(),
) -> list[Pair]:
    """Return the pairs with their matches and residuals. progress: receives the share that is done."""
    compared = []
    for pair in map_ahead(lambda item: _compare(views, features, item, options), pairs, None):
        compared.append(pair)
        progress(len(compared) / len(pairs))
    return compared


def _compare(
    views: Sequence[View], features: Sequence[Features], pair: tuple[int, int], options: InspectionConfig
) -> Pair:
    (one, other), limits = pair, options.pairs
    matches = match(features[one], features[other], options.features.ratio)
    here, there = features[one].pixels[matches[:, 0]], features[other].pixels[matches[:, 1]]
    scale = max(features[one].scale, features[other].scale)
    residuals = epipolar_residuals(views[one].camera, views[other].camera, here, there) / scale
    still = (np.linalg.norm(here - there, axis=1) < limits.inlier * scale) & (residuals > limits.off)
    own = ~still & (residuals < limits.inlier)  # most pairs agree with their cameras, and need no other geometry
    if own.sum() < max(limits.min_matches, limits.explained * (~still).sum()):
        own = _of_one_geometry(here / scale, there / scale, ~still, limits)
    off = ~still & ~own & (residuals > limits.off)
    moved = _of_one_geometry(here / scale, there / scale, off, limits).sum()
    return Pair(one, other, matches, own, residuals, still, int(moved), scale)


def _of_one_geometry(here: np.ndarray, there: np.ndarray, among: np.ndarray, limits: PairOptions) -> np.ndarray:
    """Return which of the matches `among` [M] bool one epipolar geometry explains, [M] bool.

    here, there [M,2]: the matches' pixels in both images. The result is all False if there are too few matches.
    """
    found = np.zeros(len(among), bool)
    if among.sum() >= limits.min_matches:
        inside = same_geometry(here[among], there[among], limits.inlier)
        if inside.sum() >= limits.min_matches:
            found[among] = inside
    return found


def same_geometry(here: np.ndarray, there: np.ndarray, inlier: float) -> np.ndarray:
    """Return which matches [M] bool the best fundamental matrix explains; all False if no matrix is found.

    here, there [M,2]: the matches' pixels in both images. inlier: the largest distance from an epipolar line, pixels.
    """
    import cv2  # imported here, because training needs no OpenCV

    found, inside = cv2.findFundamentalMat(here, there, cv2.FM_RANSAC, inlier, 0.999, 1000)
    if found is None or found.shape != (3, 3) or inside is None:
        return np.zeros(len(here), bool)
    return np.asarray(inside.ravel() > 0)


def epipolar_residuals(one: Camera, other: Camera, here: np.ndarray, there: np.ndarray) -> np.ndarray:
    """Return Sampson's distance [M], pixels, of matches from the epipolar geometry of two cameras.

    here, there [M,2]: the matches' pixels in both images.
    """
    fundamental = fundamental_matrix(one, other)
    left = np.column_stack([here, np.ones(len(here))])
    right = np.column_stack([there, np.ones(len(there))])
    lines, back = left @ fundamental.T, right @ fundamental
    error = np.abs((right * lines).sum(axis=1))
    return np.asarray(error / np.sqrt((lines[:, :2] ** 2).sum(axis=1) + (back[:, :2] ** 2).sum(axis=1) + 1e-18))


def fundamental_matrix(one: Camera, other: Camera) -> np.ndarray:
    """Return the matrix F [3,3] of unit Frobenius norm with x_other^T F x_one = 0 for the images of one point."""
    relative = other.cam_from_world @ one.world_from_cam
    x, y, z = relative[:3, 3]
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    matrix = np.linalg.inv(other.K).T @ cross @ relative[:3, :3] @ np.linalg.inv(one.K)
    return np.asarray(matrix / max(float(np.linalg.norm(matrix)), 1e-300))
