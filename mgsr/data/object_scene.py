"""A scene of one object, made of a scene without masks and the masks that were found in its photographs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import compress

import numpy as np

from mgsr.data.normalise import normalisation
from mgsr.data.odd_masks import agreeing_masks
from mgsr.data.scene import PointCloud, Scene, View
from mgsr.data.silhouettes import view_silhouettes


def with_object(
    scene: Scene, train: Sequence[np.ndarray], test: Sequence[np.ndarray], ground: np.ndarray | None = None
) -> Scene:
    """Return the scene with masks, in the frame in which the unit ball holds the object.

    train, test: masks [H,W] uint8 of the views, in their order. Views with an empty mask are left out. So are the few
    training views with masks that contradict the others; a note names them. Raises SceneError if no object fits the
    masks. Found masks err in places, so a small share of them may exclude a point of the object. ground [4]: the plane
    on which the object stands, in the user's frame, None if it is unknown.
    """
    old, options = scene.user_from_scene, scene.options
    views, tests = (
        [replace(view, camera=old.camera_to_user(view.camera)) for view in _masked(part, masks)]
        for part, masks in ((scene.train, train), (scene.test, test))
    )
    silhouettes = view_silhouettes(views, options.normalisation.contour_side)
    agreeing, odd = agreeing_masks(views, silhouettes, options.odd_masks)
    views = list(compress(views, agreeing))
    frame = normalisation(views, None, list(compress(silhouettes, agreeing)), options.normalisation)
    points = scene.points
    if points is not None:
        points = PointCloud(frame.to_scene(old.to_user(points.positions)), points.colors)
    if ground is not None:
        ground = frame.inverse.plane_to_user(ground)
    return replace(
        scene,
        train=[replace(view, camera=frame.camera_to_scene(view.camera)) for view in views],
        test=[replace(view, camera=frame.camera_to_scene(view.camera)) for view in tests],
        points=points,
        user_from_scene=frame,
        ground=ground,
        masks_found=True,
        notes=(*scene.notes, *odd),
    )


def _masked(views: Sequence[View], masks: Sequence[np.ndarray]) -> list[View]:
    """Return the views with their masks, except views with an empty mask."""
    pairs = zip(views, masks, strict=True)
    return [replace(view, alpha=mask) for view, mask in pairs if (mask > 127).any()]
