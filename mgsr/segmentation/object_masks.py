"""Object masks for photographs without any, found without user input and without a neural network.

A 2D branch is trained briefly on small photographs of the whole scene. At most 64 of them, spread over all, are
searched: what the object hides in one frame of a video, it hides in the next frames, too. The object's first surfels
are the connected piece that stands on the support plane near the scene's centre. A few rounds then refine masks and
surfels in turn:

1. Each photograph is compared with its expected background and with the object's rendered surfels. Where the
   background is unknown, photo-consistency and the colours of object and support plane decide. A random walker turns
   both costs into a matte.
2. The visual hull of the mattes tolerates errors in a few of them. Its surface gives each view's silhouette.
3. The surfels in the hull that certainly hide the background become the object's.

The last mattes are those of all photographs.
The capture shows no single object if the masks and the hull's silhouettes still disagree afterwards.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy import ndimage
from scipy.spatial import cKDTree

from mgsr.config import make_config
from mgsr.config.expert import ObjectSearchOptions, SegmentationConfig
from mgsr.data.camera import Camera, pixel_size
from mgsr.data.hull import Hull, hull_surface
from mgsr.data.scene import Scene, View, some_of
from mgsr.errors import Cancelled
from mgsr.gaussians.surfels import SurfelModel
from mgsr.geometry.mesh import Mesh
from mgsr.parallel import map_ahead
from mgsr.renderers.surfels import render_surfels
from mgsr.segmentation.background import BackgroundSources
from mgsr.segmentation.color_models import ColorModels, color_models, near_on_plane
from mgsr.segmentation.consensus import silhouette_distance, tolerant_hull
from mgsr.segmentation.mattes import Matte, first_region, hull_region, matte
from mgsr.segmentation.splat_labels import lifted_sums, pieces, some_surfels
from mgsr.segmentation.support_plane import SupportPlane, find_support_plane
from mgsr.start.points import StartingPoints
from mgsr.training.control import TrainingControl
from mgsr.training.proxy_model import small_view
from mgsr.training.run import Training


@dataclass(frozen=True)
class FoundObject:
    """The object that a capture shows.

    train, test: its masks [H,W] uint8, 0..255, in the order of the scene's views.
    agreement [V]: the intersection over union of each training view's matte and the hull's silhouette.
    box [2,3]: the least and the largest corner of its hull, in the scene's frame.
    plane: the support plane, None if the user gave a box and no plane was found.
    """

    train: list[np.ndarray]
    test: list[np.ndarray]
    agreement: np.ndarray
    box: np.ndarray
    plane: SupportPlane | None


@dataclass(frozen=True)
class NoObject:
    """The reason why a capture shows no single object, as a sentence without a full stop."""

    reason: str


def find_object(
    scene: Scene,
    start: StartingPoints,
    seed: int,
    box: np.ndarray | None = None,
    ground: np.ndarray | None = None,
    should_stop: Callable[[], bool] = lambda: False,
    progress: Callable[[float], None] = lambda done: None,
    options: SegmentationConfig = SegmentationConfig(),
) -> FoundObject | NoObject:
    """Find the object in a scene without masks; the same seed gives the same masks.

    start: points of the whole scene.
    box [2,3]: the least and the largest corner of the user's box around the object, in the scene's frame; None: the
    object stands in the middle of the scene.
    ground [4]: the user's plane on which the object stands, in the scene's frame (see `Scene.ground`); None: the plane
    is searched for.
    progress: receives the share of the work that is done, 0..1.

    Raises Cancelled once should_stop returns True, and TrainingError if training fails.
    """
    views, own = [small_view(view, options.search.side) for view in some_of(scene.train)], options.search
    small = replace(scene, train=views, test=[])
    model = _trained(small, start, seed, own.iterations, should_stop, lambda done: progress(0.4 * done))
    cameras, generator = [view.camera for view in views], np.random.default_rng(seed)
    plane = None if ground is None else SupportPlane(ground[:3], float(ground[3]))
    first = _first_labels(model, cameras, box, plane, generator, options)
    if isinstance(first, NoObject):
        return first
    search = _Search(model, first, views, options)
    for number, dissent in enumerate(np.linspace(own.first_dissent, own.last_dissent, own.rounds)):
        search.refine(float(dissent))
        if should_stop():
            raise Cancelled
        if search.labels.sum() < own.min_surfels:
            return NoObject("what stands in the middle has no contour in the photographs")
        progress(0.4 + 0.45 * (number + 1) / own.rounds)
    agreement = np.array(
        [_overlap(mask, inside > 0) for mask, inside in zip(search.masks, search.silhouettes or (), strict=True)]
    )
    if (doubt := _doubt(search.masks, agreement, own)) is not None:
        return doubt
    last = search.last_masks(scene.train, scene.test)
    progress(1.0)
    masks, count = [mask for mask, _ in last], len(scene.train)
    agreement = np.array([overlap for _, overlap in last[:count]])
    return FoundObject(masks[:count], masks[count:], agreement, search.box(), first.plane)


@dataclass(frozen=True)
class _FirstLabels:
    """The object's first surfels, from geometry alone.

    standing [N] bool: the object's surfels.
    box [2,3]: the user's box, else the box around these surfels and their feet on the plane, in the scene's frame.
    heights [N]: the heights of all surfels above the plane, in the scene's unit; infinite without a plane.
    plane: the support plane, None without one.
    """

    standing: np.ndarray
    box: np.ndarray
    heights: np.ndarray
    plane: SupportPlane | None


class _Search:
    """The alternating refinement of masks, hull and surfel labels.

    labels [N] bool: the object's surfels.
    masks [H,W] bool: the masks in the small photographs.
    silhouettes [H,W]: signed distances to the hull's silhouettes, in pixels of the small photographs, positive inside;
    None before the first round.
    """

    def __init__(
        self, model: SurfelModel, first: _FirstLabels, views: Sequence[View], options: SegmentationConfig
    ) -> None:
        self._model, self._first, self._options = model.detached(), first, options
        self._cameras = [view.camera for view in views]
        self._views = list(views)
        self._pixel = pixel_size(self._cameras, np.zeros(3))
        self._hull: Hull | None = None
        self._models: ColorModels | None = None
        self.labels = first.standing
        self.silhouettes: list[np.ndarray] | None = None
        columns = _columns(some_surfels(self._model, first.standing), first.plane, options.search.copies)
        self.masks = [ndimage.binary_fill_holes(_covered(columns, camera)) for camera in self._cameras]
        # The pixels that are not background, the surfels' sums of blending weights, and the shares in such pixels.
        self._blocked = self._not_background()
        self._weights, hidden = self._lifted([np.ones_like(mask) for mask in self._blocked], self._blocked)
        self._weights = self._weights.clip(1e-6)
        self._hidden = hidden / self._weights

    def refine(self, dissent: float) -> None:
        """Update the masks from the labels, the hull from the masks, and the labels from the hull.

        dissent: the share of the masks that may exclude a place of the hull.
        """
        sources, surfels = self._sources(), some_surfels(self._model, self.labels)
        own, mattes = self._options.search, self._options.mattes

        def made(index: int) -> Matte:
            view, mask = self._views[index], self.masks[index]
            if self.silhouettes is None:
                return matte(view, first_region(mask, mattes), surfels, sources, options=mattes)
            inside = self.silhouettes[index]
            return matte(view, hull_region(mask, inside, mattes), surfels, sources, inside, mattes, self._models)

        found = list(map_ahead(made, range(len(self._views)), None))
        self.masks = [each.share > 0.5 for each in found]
        first, shares = self._first, [each.share for each in found]
        self._hull = tolerant_hull(shares, self._cameras, first.box, first.plane, dissent, self._options.hull)
        if not (self._hull.field > 0).any():
            self.labels = np.zeros_like(self.labels)
            return
        caster = Mesh(*hull_surface(self._hull)).caster
        self.silhouettes = [silhouette_distance(caster, camera) for camera in self._cameras]
        inside = self._hull.values(self._model.means.numpy().astype(np.float64)) > -own.around * self._pixel
        self._blocked = self._not_background()
        self._models = self._color_models(found)
        masks = [each.certain for each in found], [each.background_known for each in found], self._blocked
        certain, known, self._hidden = self._lifted(*masks) / self._weights
        # Most of an object surfel's pixels certainly hide the background, where that is known.
        hides = (certain > own.certain * known) & (known > own.known)
        self.labels = inside & (first.heights > own.raised * self._pixel) & hides

    def last_masks(self, train: Sequence[View], test: Sequence[View]) -> list[tuple[np.ndarray, float]]:
        """Return the final masks [H,W] uint8, 0..255, of the training and then the test views.

        With each comes the intersection over union of its matte and the hull's silhouette. Masks are computed in
        photographs of `fine_side` pixels and resized to the views.
        """
        import cv2  # imported here, because training needs no OpenCV

        own, mattes = self._options.search, self._options.mattes
        fine = [small_view(view, own.fine_side) for view in [*train, *test]]
        sources, surfels = self._sources(some_of(fine[: len(train)])), some_surfels(self._model, self.labels)
        hull = self._hull
        assert hull is not None
        caster = Mesh(*hull_surface(hull)).caster

        def made(pair: tuple[View, View]) -> tuple[np.ndarray, float]:
            view, camera = pair[0], pair[1].camera
            longest = max(camera.width, camera.height)
            inside = silhouette_distance(caster, camera) / max(
                1.0, longest / own.side
            )  # in pixels of the small photographs
            region = hull_region(inside > 0, inside, mattes)
            found = matte(pair[1], region, surfels, sources, inside, mattes, self._models)
            outer = np.where(inside > -own.outer_margin, found.share, 0)
            share = np.where((inside > own.filled) & ~found.gaps, 1, outer).astype(np.float32)
            size = view.camera.width, view.camera.height
            mask = (255 * cv2.resize(share, size, interpolation=cv2.INTER_LINEAR)).round().astype(np.uint8)
            return mask, _overlap(found.share > 0.5, inside > 0)

        return list(map_ahead(made, zip([*train, *test], fine, strict=True), None))

    def box(self) -> np.ndarray:
        """Return the least and the largest corner [2,3] of the hull, in the scene's frame."""
        assert self._hull is not None
        return self._hull.box()

    def _lifted(self, *masks: Sequence[np.ndarray]) -> np.ndarray:
        """Lift up to three masks [H,W] bool of each small photograph to the surfels; see `lifted_sums`."""
        stacked = [np.stack(each, axis=-1) for each in zip(*masks, strict=True)]
        return lifted_sums(self._model, stacked, self._cameras).T

    def _sources(self, larger: Sequence[View] | None = None) -> BackgroundSources:
        """Return the sources of the background: whatever lies outside the masks and the hull's silhouettes.

        larger: the same photographs at a larger size, to sample in place of the small ones.
        """
        import cv2  # imported here, because training needs no OpenCV

        own, background = self._options.search, self._options.background
        behind = ~self.labels & (self._hidden < 0.5) & (self._first.heights > -own.reflected * self._pixel)
        surfels = some_surfels(self._model, behind)
        views = self._views if larger is None else larger
        clear = [
            cv2.resize(
                255 * (~mask).astype(np.uint8), (view.camera.width, view.camera.height), interpolation=cv2.INTER_NEAREST
            )
            for mask, view in zip(self._blocked, views, strict=True)
        ]
        return BackgroundSources(views, clear, surfels, self._first.plane, background)

    def _not_background(self) -> list[np.ndarray]:
        """Return the pixels [H,W] bool of each photograph that do not count as background: mask and silhouette."""
        import cv2  # imported here, because training needs no OpenCV

        around = np.ones((2 * self._options.search.blocked + 1,) * 2, np.uint8)
        wide: list[np.ndarray] = self.masks
        if self.silhouettes is not None:
            wide = [mask | (inside > -1) for mask, inside in zip(self.masks, self.silhouettes, strict=True)]
        return [np.asarray(ndimage.binary_fill_holes(cv2.dilate(mask.astype(np.uint8), around) > 0)) for mask in wide]

    def _color_models(self, found: Sequence[Matte]) -> ColorModels | None:
        """Return the colour models, from the small photographs and their mattes; None without a support plane."""
        box, plane, silhouettes = self._first.box, self._first.plane, self.silhouettes
        if plane is None or silhouettes is None:
            return None
        own, deep = self._options.colors, self._options.search.filled
        reach = own.reach * float(np.linalg.norm(box[1] - box[0]))
        objects = [
            each.certain & mask & (inside > deep)
            for each, mask, inside in zip(found, self.masks, silhouettes, strict=True)
        ]
        supports = [
            near_on_plane(camera, plane, box.mean(axis=0), reach) & ~blocked
            for camera, blocked in zip(self._cameras, self._blocked, strict=True)
        ]
        return color_models([view.image for view in self._views], objects, supports, own)


def _columns(surfels: SurfelModel, plane: SupportPlane | None, copies: int) -> SurfelModel:
    """Return the surfels, and copies of them that are lowered in steps down to the plane.

    The copies cover the object's sides. The surfels of a shiny side may be missing, because they lie where its
    reflections seem to be.
    """
    if plane is None:
        return surfels
    down = torch.from_numpy((plane.heights(surfels.means.numpy())[:, None] * plane.normal).astype(np.float32))
    lowered = [replace(surfels, means=surfels.means - share * down) for share in np.linspace(0, 1, copies)]
    return SurfelModel(
        **{name: torch.cat([part.parameters()[name] for part in lowered]) for name in surfels.parameters()}
    )


def _covered(surfels: SurfelModel, camera: Camera) -> np.ndarray:
    """Return where surfels cover a camera's image, [H,W] bool."""
    with torch.no_grad():
        return render_surfels(surfels, camera, torch.zeros(3), 0).alpha.numpy() > 0.5


def _first_labels(
    model: SurfelModel,
    cameras: Sequence[Camera],
    box: np.ndarray | None,
    plane: SupportPlane | None,
    generator: np.random.Generator,
    options: SegmentationConfig,
) -> _FirstLabels | NoObject:
    """Label the largest connected piece of surfels that stands on the support plane; those near the middle weigh more.

    box [2,3]: the box in the scene's frame that holds the object; None: the object stands near the scene's centre. It
    may extend farther if most of it is near: the centre is where the cameras look, which need not be the object's.
    plane: the support plane; None: it is searched for.
    """
    own, pixel = options.search, pixel_size(cameras, np.zeros(3))
    centers = np.asarray(model.means.detach().numpy(), np.float64)
    solid = model.opacities().detach().numpy() > own.solid
    distances = np.linalg.norm(centers, axis=1)
    around = distances < own.near
    if plane is None:
        plane = find_support_plane(centers[solid & around], cameras, own.flat * pixel, generator, options.plane)
    inside = around
    if box is not None:
        margin = own.flat * pixel
        inside = ((centers > box[0] - margin) & (centers < box[1] + margin)).all(axis=1)
    elif plane is None:
        return NoObject("no level surface lies under what the cameras look at")
    heights = np.full(len(centers), np.inf) if plane is None else plane.heights(centers)
    upright = solid & (heights > own.standing * pixel)
    found = np.flatnonzero(upright & inside)
    if len(found) < own.min_surfels:
        return NoObject("nothing stands in the middle of what the cameras look at")
    reach = own.linked * float(np.median(cKDTree(centers[found]).query(centers[found], k=4)[0][:, 3]))
    if box is None:
        found = np.flatnonzero(upright & (distances < own.farthest))
    piece = pieces(centers[found], reach)
    middle = np.zeros(3) if box is None else box.mean(axis=0)
    # The cameras look at the object, so surfels near the middle weigh more.
    sizes = np.bincount(piece, np.exp(-(((centers[found] - middle) / own.middle) ** 2).sum(axis=1)))
    largest = int(np.argmax(sizes))
    if box is None and (np.delete(sizes, largest) > own.rival * sizes[largest]).any():
        return NoObject("several objects of about one size stand in the middle")
    standing = np.zeros(len(centers), bool)
    standing[found[piece == largest]] = True
    if inside[standing].mean() < own.mostly_near:
        standing &= inside  # it is connected to what lies around it
    if standing.sum() < own.min_surfels:
        return NoObject("nothing stands in the middle of what the cameras look at")
    around_it = _box_with_feet(centers[standing], plane) if box is None else box
    return _FirstLabels(standing, around_it, heights, plane)


def _box_with_feet(positions: np.ndarray, plane: SupportPlane | None) -> np.ndarray:
    """Return the least and the largest corner [2,3] of positions [P,3] and of their feet, in the scene's frame.

    The feet are the projections of the lowest positions onto the plane.
    """
    if plane is not None:
        heights = plane.heights(positions)
        low = heights < 2 * heights.min()
        positions = np.concatenate([positions, positions[low] - heights[low, None] * plane.normal])
    return np.stack([positions.min(axis=0), positions.max(axis=0)])


def _trained(
    scene: Scene,
    start: StartingPoints,
    seed: int,
    iterations: int,
    should_stop: Callable[[], bool],
    progress: Callable[[float], None],
) -> SurfelModel:
    """Train the 2D branch alone on the whole scene."""
    stages = [f"warmup.surfel_iterations={iterations}", "mutual.iterations=0", "stop_rule=none"]
    # Before the photographs' mean colour, surfaces of about that colour would need no surfels.
    config = make_config(seed=seed, overrides=["branches=surfels", "background=white", *stages])
    training = Training(scene, start, config, TrainingControl(lambda report: progress(report.done), should_stop))
    found = training.run().model.surfels
    assert found is not None
    return found


def _overlap(one: np.ndarray, other: np.ndarray) -> float:
    """Return the intersection over union of two masks [H,W] bool; 1 if both are empty."""
    union = (one | other).sum()
    return float((one & other).sum() / union) if union else 1.0


def _doubt(masks: Sequence[np.ndarray], agreement: np.ndarray, options: ObjectSearchOptions) -> NoObject | None:
    """Return why the masks [H,W] bool do not show a single object; None if they do.

    agreement [V]: the intersection over union of each mask and the hull's silhouette.
    """
    if np.mean([mask.any() for mask in masks]) < options.min_shown:
        return NoObject("many photographs do not show the object")
    if np.median([mask.mean() for mask in masks]) > options.full:
        return NoObject("the object fills the photographs")
    if np.mean([_cut_off(mask, options.cut) for mask in masks]) > options.max_cut:
        return NoObject("most photographs cut the object off")
    if agreement.mean() < options.min_agreement:
        return NoObject("the object's contours in the photographs do not agree")
    return None


def _cut_off(mask: np.ndarray, least: float) -> bool:
    """Return whether the image's border cuts through a mask [H,W] bool.

    least: the threshold on the number of the mask's border pixels, divided by the square root of the mask's area.
    """
    border = sum(int(line.sum()) for line in (mask[0], mask[-1], mask[:, 0], mask[:, -1]))
    cut: bool = border > least * float(mask.sum()) ** 0.5
    return cut
