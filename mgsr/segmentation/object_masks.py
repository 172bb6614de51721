"""Masks of the object in photographs that come without any: no clicks, no network weights.

A 2D branch is trained briefly on small photographs of the whole scene. Its surfels that stand on the plane under the
scene's middle, in one piece, are the object to begin with. Each photograph is then compared with the background that
the other photographs show at the same places, and with the object's surfels; a random walker makes a soft mask of both.
The hull of these masks, which a few may contradict, says which surfels are the object's and where each mask is wrong.
After some rounds masks and hull agree, or the capture shows no single object.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy import ndimage
from scipy.spatial import cKDTree

from mgsr.config import make_config
from mgsr.data.camera import Camera, pixel_size
from mgsr.data.hull import Hull, hull_surface
from mgsr.data.scene import Scene, View
from mgsr.errors import Cancelled
from mgsr.gaussians.surfels import SurfelModel
from mgsr.geometry.mesh import Mesh
from mgsr.parallel import map_ahead
from mgsr.renderers.surfels import render_surfels
from mgsr.segmentation.background import BackgroundSources
from mgsr.segmentation.consensus import silhouette, tolerant_hull
from mgsr.segmentation.mattes import Matte, first_region, hull_region, matte
from mgsr.segmentation.splat_labels import lifted_labels, pieces, some_surfels
from mgsr.segmentation.support_plane import SupportPlane, find_support_plane
from mgsr.start.starting_points import StartingPoints
from mgsr.training.proxy_model import small_view
from mgsr.training.run import Training

SIDE, FINE_SIDE = 480, 960  # pixels of the photographs that surfels are trained on, and of the last masks
ITERATIONS = 400
DISSENT = (0.1, 0.08, 0.06)  # share of the views that may have a place of the hull outside their masks, by round
SOLID = 0.2  # opacity of the surfels that count
NEAR = 1.5  # radius around the scene's centre, in balls, in which the object stands
MIDDLE = 0.7  # radius, in balls, within which pieces count as lying in the middle
# Distances in pixels of the small photographs, on the object.
FLAT = 3.0  # of points from the plane that holds them
STANDING = 6.0  # over the plane, from where a surfel belongs to what stands on it
RAISED = 3.0  # over the plane, from where a surfel in the hull is the object's
BELOW = 3.0  # under the plane, from where a surfel is a reflection and not the background
AROUND = 1.5  # around the hull, up to where a surfel is the object's
COPIES = 8  # of a surfel between the object's surface and the plane, which fill the first masks
LINKED = 2.5  # times the usual distance to a third neighbour, by which surfels of one piece are apart at most
BLOCKED = 2  # around a mask, in which a photograph does not show the background for certain
SURE = 0.5  # share of its pixels with a known background in which an object's surfel is surely not that
TOLD = 0.03  # least share of a surfel's pixels that have a known background
LEAST_SPLATS = 50
RIVAL = 0.4  # size of a second piece, against the object's, that makes two objects
LEAST_AGREEMENT = 0.75  # mean intersection over union of the masks and of the hull's silhouettes
BESIDE = 3.0  # pixels outside the hull's silhouette where masks end
FILLED = 2.0  # pixels inside the hull's silhouette from where masks have no holes
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
    model = _trained(replace(scene, train=views, test=[]), start, seed, should_stop, lambda done: progress(0.4 * done))
    first = _first_labels(model, [view.camera for view in views], box, np.random.default_rng(seed))
    if isinstance(first, NoObject):
        return first
    search = _Search(model, first, views)
    for number, dissent in enumerate(DISSENT):
        search.refine(dissent)
        if should_stop():
            raise Cancelled
        if search.labels.sum() < LEAST_SPLATS:
            return NoObject("what stands in the middle has no contour in the photographs")
        progress(0.4 + 0.45 * (number + 1) / len(DISSENT))
    agreement = np.array(
        [_overlap(mask, inside > 0) for mask, inside in zip(search.masks, search.silhouettes or (), strict=True)]
    )
    if (doubt := _doubt(search.masks, agreement)) is not None:
        return doubt
    masks = search.last_masks(scene.train, scene.test)
    progress(1.0)
    return FoundObject(masks[: len(views)], masks[len(views) :], agreement, search.box(), first.plane)


@dataclass(frozen=True)
class _FirstLabels:
    """What geometry tells of the object.

    standing [N] bool: the surfels that stand on the plane in the middle; box [2,3]: the corners of the box around them
    and their feet; heights [N] of all surfels over the plane, in the scene's unit; plane: what the object stands on, if
    anything.
    """

    standing: np.ndarray
    box: np.ndarray
    heights: np.ndarray
    plane: SupportPlane | None


class _Search:
    """The rounds in which masks and hull learn from each other.

    labels [N] bool: the object's surfels; masks [H,W] bool of the small photographs; silhouettes: signed distances
    [H,W] to the hull's, None before the first round.
    """

    def __init__(self, model: SurfelModel, first: _FirstLabels, views: Sequence[View]) -> None:
        self._model, self._first = model.detached(), first
        self._cameras = [view.camera for view in views]
        self._images = [view.image for view in views]
        self._pixel = pixel_size(self._cameras, np.zeros(3))
        self._hull: Hull | None = None
        self.labels = first.standing
        self.silhouettes: list[np.ndarray] | None = None
        columns = _columns(some_surfels(self._model, first.standing), first.plane)
        self.masks = [ndimage.binary_fill_holes(_covered(columns, camera)) for camera in self._cameras]

    def refine(self, dissent: float) -> None:
        """Make masks from the present labels, a hull from the masks, and labels from the hull.

        dissent: the share of the views that may have a place of the hull outside their masks.
        """
        sources, surfels = self._sources(), some_surfels(self._model, self.labels)

        def made(index: int) -> Matte:
            image, camera, mask = self._images[index], self._cameras[index], self.masks[index]
            if self.silhouettes is None:
                return matte(image, camera, first_region(mask), surfels, sources)
            inside = self.silhouettes[index]
            return matte(image, camera, hull_region(mask, inside), surfels, sources, inside)

        found = list(map_ahead(made, range(len(self._images)), None))
        self.masks = [each.share > 0.5 for each in found]
        first = self._first
        self._hull = tolerant_hull([each.share for each in found], self._cameras, first.box, first.plane, dissent)
        if not (self._hull.field > 0).any():
            self.labels = np.zeros_like(self.labels)
            return
        caster = Mesh(*hull_surface(self._hull)).caster
        self.silhouettes = [silhouette(caster, camera) for camera in self._cameras]
        inside = self._hull.values(self._model.means.numpy().astype(np.float64)) > -AROUND * self._pixel
        self.labels = inside & (first.heights > RAISED * self._pixel) & self._sure(found)

    def last_masks(self, train: Sequence[View], test: Sequence[View]) -> list[np.ndarray]:
        """Return the masks [H,W] uint8 of the training and the test views, made once more in larger photographs."""
        import cv2  # late: training needs no OpenCV

        fine = [small_view(view, FINE_SIDE) for view in [*train, *test]]
        sources, surfels = self._sources(fine[: len(train)]), some_surfels(self._model, self.labels)
        hull = self._hull
        assert hull is not None
        caster = Mesh(*hull_surface(hull)).caster

        def made(pair: tuple[View, View]) -> np.ndarray:
            view, camera = pair[0], pair[1].camera
            longest = max(camera.width, camera.height)
            inside = silhouette(caster, camera) / max(1.0, longest / SIDE)  # in pixels of the small photographs
            found = matte(pair[1].image, camera, hull_region(inside > 0, inside), surfels, sources, inside)
            share = np.where(inside > FILLED, 1, np.where(inside > -BESIDE, found.share, 0)).astype(np.float32)
            size = view.camera.width, view.camera.height
            return np.asarray((255 * cv2.resize(share, size, interpolation=cv2.INTER_LINEAR)).round().astype(np.uint8))

        return list(map_ahead(made, zip([*train, *test], fine, strict=True), None))

    def box(self) -> np.ndarray:
        """Return the corners [2,3] of the box around the hull."""
        assert self._hull is not None
        places = np.argwhere(self._hull.field > 0) * self._hull.voxel + self._hull.origin
        return np.stack([places.min(axis=0), places.max(axis=0)])

    def _sources(self, larger: Sequence[View] | None = None) -> BackgroundSources:
        """Return what tells of the background: whatever lies outside the masks and the hull's silhouettes.

        larger: the same photographs at another size, to look at in place of the small ones.
        """
        import cv2  # late: training needs no OpenCV

        around = np.ones((2 * BLOCKED + 1,) * 2, np.uint8)
        wide = self.masks
        if self.silhouettes is not None:
            wide = [mask | (inside > -1) for mask, inside in zip(self.masks, self.silhouettes, strict=True)]
        blocked = [ndimage.binary_fill_holes(cv2.dilate(mask.astype(np.uint8), around) > 0) for mask in wide]
        lifted, _ = lifted_labels(self._model, blocked, self._cameras)
        behind = ~self.labels & (lifted < 0.5) & (self._first.heights > -BELOW * self._pixel)
        surfels = some_surfels(self._model, behind)
        clear = [255 * (~mask).astype(np.uint8) for mask in blocked]
        if larger is None:
            return BackgroundSources(self._cameras, self._images, clear, surfels, self._first.plane)
        cameras, images = [view.camera for view in larger], [view.image for view in larger]
        clear = [
            cv2.resize(mask, (camera.width, camera.height), interpolation=cv2.INTER_NEAREST)
            for mask, camera in zip(clear, cameras, strict=True)
        ]
        return BackgroundSources(cameras, images, clear, surfels, self._first.plane)

    def _sure(self, found: Sequence[Matte]) -> np.ndarray:
        """Return which surfels [N] bool photographs show where they surely do not show the background."""
        sure, told = (
            lifted_labels(self._model, masks, self._cameras)[0]
            for masks in ([each.sure for each in found], [each.told for each in found])
        )
        return np.asarray((sure > SURE * told) & (told > TOLD))


def _columns(surfels: SurfelModel, plane: SupportPlane | None) -> SurfelModel:
    """Return surfels and copies of them on their way down to the plane, which fill what lies below the surface.

    Shiny sides show what they reflect, so that surfels of them may lie anywhere.
    """
    if plane is None:
        return surfels
    down = torch.from_numpy((plane.heights(surfels.means.numpy())[:, None] * plane.normal).astype(np.float32))
    lowered = [replace(surfels, means=surfels.means - share * down) for share in np.linspace(0, 1, COPIES)]
    return SurfelModel(
        **{name: torch.cat([part.parameters()[name] for part in lowered]) for name in surfels.parameters()}
    )


def _covered(surfels: SurfelModel, camera: Camera) -> np.ndarray:
    """Return where surfels cover a camera's image, [H,W] bool."""
    with torch.no_grad():
        return render_surfels(surfels, camera, torch.zeros(3), 0).alpha.numpy() > 0.5


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
    around_it = _box_with_feet(centers[standing], plane) if box is None else box
    return _FirstLabels(standing, around_it, heights, plane)


def _box_with_feet(positions: np.ndarray, plane: SupportPlane | None) -> np.ndarray:
    """Return the corners [2,3] of the box around positions [P,3], and around the feet of those near the plane."""
    if plane is not None:
        heights = plane.heights(positions)
        low = heights < 2 * heights.min()
        positions = np.concatenate([positions, positions[low] - heights[low, None] * plane.normal])
    return np.stack([positions.min(axis=0), positions.max(axis=0)])


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
