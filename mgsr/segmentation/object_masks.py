"""Masks of the object in photographs that come without any: no clicks, no network weights.

A 2D branch is trained briefly on small photographs of the whole scene. Its surfels that stand on the plane under the
scene's middle, in one piece, are the object to begin with. Their share of each pixel is a mask that all views agree
on. GrabCut moves the masks' contours to where the photographs' colours change, and the surfels take their labels from
the refined masks in turn. After some rounds both agree, or the capture shows no single object.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from mgsr.config import make_config
from mgsr.data.camera import Camera, pixel_size
from mgsr.data.scene import Scene, View
from mgsr.gaussians.surfels import SurfelModel
from mgsr.parallel import map_ahead
from mgsr.segmentation.consensus import completed_masks
from mgsr.segmentation.grab_cut import refined_mask
from mgsr.segmentation.splat_labels import lifted_labels, pieces, rendered_labels
from mgsr.segmentation.support_plane import SupportPlane, find_support_plane
from mgsr.start.starting_points import StartingPoints
from mgsr.training.proxy_model import small_view
from mgsr.training.run import Training

SIDE, FINE_SIDE = 480, 960  # pixels of the photographs that surfels are trained on, and of the last masks
ITERATIONS = 400
SOLID = 0.2  # opacity of the surfels that count
NEAR = 1.5  # radius around the scene's centre, in balls, in which the object stands
MIDDLE = 0.7  # radius, in balls, within which pieces count as lying in the middle
# Distances in pixels of the small photographs, on the object.
FLAT = 3.0  # of points from the plane that holds them
STANDING = 6.0  # over the plane, from where a surfel belongs to what stands on it
RISING = 7.0  # from where the geometry counts more than the colours
LYING = 3.0  # up to where a surfel is the plane's
LINKED = 2.5  # times the usual distance to a third neighbour, by which surfels of one piece are apart at most
BANDS = (0.06, 0.04, 0.03)  # of GrabCut, in each round
BY_COLOR, BY_SHAPE = 0.5, 0.1  # least labels of the object's surfels: of those that colours add, and of those that rise
GROUND = 0.5  # the plane's share of a pixel from which it is surely not the object
LEAST_SPLATS = 50
RIVAL = 0.4  # size of a second piece, against the object's, that makes two objects
LEAST_AGREEMENT = 0.75  # mean intersection over union of the masks and of what the surfels render
DISAGREEING = 0.6  # of one view, below which what the surfels render is its mask
FULL = 0.7  # share of the image that is no single object's any more
CUT = 0.1  # share of a mask's extent that lies on the image's border, from where the object counts as cut off


@dataclass(frozen=True)
class FoundObject:
    """The object that a capture shows.

    train, test: its masks [H,W] uint8 in the scene's views, in their order; agreement [V]: how well each training
    view's mask agrees with the others, as intersection over union with what the labelled surfels render; box [2,3]: the
    least and the largest corner of its surfels and of their feet on the plane, in the scene's frame; plane: what it
    stands on, None where a person said where it lies and no plane is there.
    """

    train: list[np.ndarray]
    test: list[np.ndarray]
    agreement: np.ndarray
    box: np.ndarray
    plane: SupportPlane | None


@dataclass(frozen=True)
class NoObject:
    """Why a capture shows no single object, as a whole sentence without a full stop."""

    reason: str


def find_object(
    scene: Scene,
    start: StartingPoints,
    seed: int,
    box: np.ndarray | None = None,
    should_stop: Callable[[], bool] = lambda: False,
    progress: Callable[[float], None] = lambda done: None,
) -> FoundObject | NoObject:
    """Find the object in a scene without masks; the same seed gives the same masks.

    start: points of the whole scene. box [2,3]: the corners, in the scene's frame, between which a person says that
    the object lies; without one, the object is what stands in the middle. progress: told of the share that is done,
    0..1. Raises Cancelled once should_stop says so, and TrainingError where training goes bad.
    """
    views = [small_view(view, SIDE) for view in scene.train]
    cameras = [view.camera for view in views]
    model = _trained(replace(scene, train=views, test=[]), start, seed, should_stop, lambda done: progress(0.5 * done))
    first = _first_labels(model, cameras, box, np.random.default_rng(seed))
    if isinstance(first, NoObject):
        return first
    labels = first.standing
    ground = rendered_labels(model, first.lying, cameras)
    for number, band in enumerate(BANDS):
        masks = _cut(views, rendered_labels(model, labels, cameras), ground, band)
        labels = first.relabelled(*lifted_labels(model, masks, cameras))
        if labels.sum() < LEAST_SPLATS:
            return NoObject("what stands in the middle has no contour in the photographs")
        progress(0.5 + 0.4 * (number + 1) / len(BANDS))
    rendered = [image > 0.5 for image in rendered_labels(model, labels, cameras)]
    agreement = np.array([_overlap(mask, shown) for mask, shown in zip(masks, rendered, strict=True)])
    if (doubt := _doubt(masks, agreement)) is not None:
        return doubt
    box = first.box(labels)
    train, test = _last_masks(model, labels, first.lying, box, scene)
    progress(1.0)
    return FoundObject(train, test, agreement, box, first.plane)


@dataclass(frozen=True)
class _FirstLabels:
    """What geometry tells of the object.

    centers [N,3] of the surfels; standing [N] bool: the object's; rising [N] bool: those of them so high over the plane
    that geometry counts more than colours; lying [N] bool: the plane's; allowed [N] bool: those that may belong to the
    object; reach: the distance by which surfels of one piece are apart at most; plane: what the object stands on, if
    anything.
    """

    centers: np.ndarray
    standing: np.ndarray
    rising: np.ndarray
    lying: np.ndarray
    allowed: np.ndarray
    reach: float
    plane: SupportPlane | None

    def relabelled(self, lifted: np.ndarray, weight: np.ndarray) -> np.ndarray:
        """Return the object's surfels [N] bool, by the masks' labels (see `lifted_labels`): the largest piece."""
        kept = self.allowed & (weight > 0) & (lifted > np.where(self.rising, BY_SHAPE, BY_COLOR))
        labels = np.zeros(len(kept), bool)
        if kept.any():
            labels[np.flatnonzero(kept)[pieces(self.centers[kept], self.reach) == 0]] = True
        return labels

    def box(self, labels: np.ndarray) -> np.ndarray:
        """Return the corners [2,3] of the box around surfels [N] bool, and around the feet of those near the plane."""
        positions = self.centers[labels]
        if self.plane is not None:
            heights = self.plane.heights(positions)
            low = heights < 2 * heights.min()
            feet = positions[low] - heights[low, None] * self.plane.normal
            positions = np.concatenate([positions, feet])
        return np.stack([positions.min(axis=0), positions.max(axis=0)])


def _first_labels(
    model: SurfelModel, cameras: Sequence[Camera], box: np.ndarray | None, generator: np.random.Generator
) -> _FirstLabels | NoObject:
    """Return which surfels stand on the plane under the middle, in the piece nearest to it; or those in the box."""
    pixel = pixel_size(cameras, np.zeros(3))
    centers = np.asarray(model.means.detach().numpy(), np.float64)
    solid = model.opacities().detach().numpy() > SOLID
    around = np.linalg.norm(centers, axis=1) < NEAR
    plane = find_support_plane(centers[solid & around], cameras, FLAT * pixel, generator)
    inside = around
    if box is not None:
        inside = ((centers > box[0] - FLAT * pixel) & (centers < box[1] + FLAT * pixel)).all(axis=1)
    elif plane is None:
        return NoObject("no level surface lies under what the cameras look at")
    heights = np.full(len(centers), np.inf) if plane is None else plane.heights(centers)
    found = np.flatnonzero(solid & inside & (heights > STANDING * pixel))
    if len(found) < LEAST_SPLATS:
        return NoObject("nothing stands in the middle of what the cameras look at")
    reach = LINKED * float(np.median(cKDTree(centers[found]).query(centers[found], k=4)[0][:, 3]))
    piece = pieces(centers[found], reach)
    middle = np.zeros(3) if box is None else box.mean(axis=0)
    # The cameras look at the object, so what lies near the middle counts more.
    sizes = np.bincount(piece, np.exp(-(((centers[found] - middle) / MIDDLE) ** 2).sum(axis=1)))
    largest = int(np.argmax(sizes))
    if box is None and (np.delete(sizes, largest) > RIVAL * sizes[largest]).any():
        return NoObject("several objects of about one size stand in the middle")
    standing = np.zeros(len(centers), bool)
    standing[found[piece == largest]] = True
    if standing.sum() < LEAST_SPLATS:
        return NoObject("nothing stands in the middle of what the cameras look at")
    rising, lying = standing & (heights > RISING * pixel), heights < LYING * pixel
    allowed = (heights > STANDING * pixel) & (inside if box is not None else True)
    return _FirstLabels(centers, standing, rising, lying, allowed, reach, plane)


def _trained(
    scene: Scene,
    start: StartingPoints,
    seed: int,
    should_stop: Callable[[], bool],
    progress: Callable[[float], None],
) -> SurfelModel:
    """Train the 2D branch alone on the whole scene."""
    stages = [f"warmup.surfel_iterations={ITERATIONS}", "mutual.iterations=0", "stop_rule=none"]
    config = make_config(seed=seed, overrides=["branches=surfels", *stages])
    training = Training(scene, start, config, lambda report: progress(report.done), should_stop)
    found = training.run().model.surfels
    assert found is not None
    return found


def _cut(
    views: Sequence[View], shares: Sequence[np.ndarray], ground: Sequence[np.ndarray], band: float
) -> list[np.ndarray]:
    """Return the views' refined masks [H,W] bool, from the object's and the plane's share of each pixel."""

    def cut(index: int) -> np.ndarray:
        return refined_mask(views[index].image, shares[index] > 0.5, band, ground[index] > GROUND)

    return list(map_ahead(cut, range(len(views)), None))


def _last_masks(
    model: SurfelModel, labels: np.ndarray, lying: np.ndarray, box: np.ndarray, scene: Scene
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Return the object's masks [H,W] uint8 in the training and test views, cut once more, in larger photographs."""
    import cv2  # late: training needs no OpenCV

    views = [*scene.train, *scene.test]
    fine = [small_view(view, FINE_SIDE) for view in views]
    cameras = [view.camera for view in fine]
    shares, ground = (rendered_labels(model, part, cameras) for part in (labels, lying))
    cut = _cut(fine, shares, ground, BANDS[-1])
    kept = [
        mask if _overlap(mask, share > 0.5) > DISAGREEING else share > 0.5
        for mask, share in zip(cut, shares, strict=True)
    ]
    masks = [
        cv2.resize(255 * mask.astype(np.uint8), (view.camera.width, view.camera.height), interpolation=cv2.INTER_LINEAR)
        for view, mask in zip(views, completed_masks(kept, cameras, box), strict=True)
    ]
    return masks[: len(scene.train)], masks[len(scene.train) :]


def _overlap(one: np.ndarray, other: np.ndarray) -> float:
    """Return the intersection over union of two masks; 1 where both are empty."""
    union = (one | other).sum()
    return float((one & other).sum() / union) if union else 1.0


def _doubt(masks: Sequence[np.ndarray], agreement: np.ndarray) -> NoObject | None:
    """Return what speaks against masks [H,W] bool that all show one object; None where nothing does."""
    if np.mean([mask.any() for mask in masks]) < 0.8:
        return NoObject("many photographs do not show the object")
    if np.median([mask.mean() for mask in masks]) > FULL:
        return NoObject("the object fills the photographs")
    if np.mean([_cut_off(mask) for mask in masks]) > 0.5:
        return NoObject("most photographs cut the object off")
    if agreement.mean() < LEAST_AGREEMENT:
        return NoObject("the object's contours in the photographs do not agree")
    return None


def _cut_off(mask: np.ndarray) -> bool:
    """Return whether the image's border cuts through a mask [H,W] bool."""
    border = sum(int(line.sum()) for line in (mask[0], mask[-1], mask[:, 0], mask[:, -1]))
    cut: bool = border > CUT * float(mask.sum()) ** 0.5
    return cut
