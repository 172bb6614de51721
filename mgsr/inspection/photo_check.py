"""Checks of single photographs, of their masks and of their lenses."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mgsr.config.expert import PhotoCheckOptions, SharpnessOptions
from mgsr.data.mask_error import find_mask_errors
from mgsr.data.odd_masks import left_out_shares
from mgsr.data.scene import Scene, View
from mgsr.data.sharpness import lost_sharpness
from mgsr.data.silhouettes import view_silhouettes
from mgsr.inspection.findings import Code, Finding, Severity, pick


def check_sharpness(
    views: Sequence[View], names: Sequence[str], options: SharpnessOptions = SharpnessOptions()
) -> list[Finding]:
    """Return a finding on photographs that are much less sharp than their neighbours."""
    lost = lost_sharpness(views, options)
    less = np.flatnonzero(lost > options.max_loss)
    if not len(less):
        return []
    return [
        Finding(
            Code.BLURRED,
            Severity.WARNING,
            f"{len(less)} of {len(views)} photographs are much less sharp than their neighbours",
            round(float(2 ** np.median(lost[less])), 2),
            "times",
            "take them again, or leave them out with `--set flawed=drop`",
            pick(names, less),
        )
    ]


def check_object_size(
    scene: Scene, views: Sequence[View], options: PhotoCheckOptions = PhotoCheckOptions()
) -> list[Finding]:
    """Return a finding if the object covers a small part of the photographs, or few pixels."""
    if scene.masked:
        diameters = np.array([_larger_side(view.alpha > 127) for view in views if view.alpha is not None])
    else:
        # Without masks, the unit ball is the object or the place that most cameras look at.
        far = [float(np.linalg.norm(view.camera.center)) for view in views]
        focal = [view.camera.K[0, 0] for view in views]
        diameters = 2 * np.array(focal) / np.maximum(far, 1e-9)
    sides = np.array([min(view.camera.width, view.camera.height) for view in views[: len(diameters)]])
    pixels, share = float(np.median(diameters)), float(np.median(diameters / sides))
    if share >= options.small_share and pixels >= options.small_pixels:
        return []
    return [
        Finding(
            Code.SMALL_OBJECT,
            Severity.WARNING,
            f"the object is {pixels:.0f} pixels wide, {share:.0%} of the shorter side of the image",
            round(pixels, 1),
            "px",
            "come nearer, zoom in, or use larger photographs",
        )
    ]


def _larger_side(mask: np.ndarray) -> float:
    """Return the larger side, pixels, of the box around a mask [H,W] bool; 0 for an empty one."""
    return float(max((np.ptp(np.flatnonzero(mask.any(axis=axis))) + 1 for axis in (0, 1) if mask.any()), default=0))


def check_masks(scene: Scene, names: Sequence[str], options: PhotoCheckOptions = PhotoCheckOptions()) -> list[Finding]:
    """Return findings on masks that cut the object off, contradict the others, or are inexact.

    scene: with masks. names: those of its training views.
    """
    views, odd_masks = scene.train, scene.options.odd_masks
    silhouettes = view_silhouettes(views, options.contour_side)
    found = []
    cut = np.array([not silhouette.whole for silhouette in silhouettes])
    if cut.mean() >= options.cut_off:
        found.append(
            Finding(
                Code.CUT_OFF,
                Severity.NOTE,
                f"{cut.sum()} of {len(views)} photographs cut off a part of the object",
                int(cut.sum()),
                "photographs",
                "if parts of the surface are missing, take some photographs from farther away",
                pick(names, np.flatnonzero(cut)),
            )
        )
    if len(views) < odd_masks.min_views:
        return found
    shares = left_out_shares(views, silhouettes, options.left_out, odd_masks)
    incomplete, error = _mask_errors(scene)
    odd = np.union1d(np.flatnonzero(shares > options.left_out), np.array(incomplete, int))
    if len(odd):
        found.append(
            Finding(
                Code.CONTRADICTORY_MASK,
                Severity.WARNING,
                f"the masks of {len(odd)} of {len(views)} photographs miss a part of the object that the others show",
                round(float(shares[odd].max()), 3),
                "share",
                "correct or remove these masks; if all look right, the poses are wrong",
                pick(names, odd),
            )
        )
    if error > scene.options.mask_error.exact:
        found.append(
            Finding(
                Code.INEXACT_MASKS,
                Severity.WARNING,
                f"the contours of the masks contradict each other by {error:.1f} pixels in the median",
                round(error, 2),
                "px",
                "make the masks more exact; if they look right, the poses are inexact",
            )
        )
    return found


def _mask_errors(scene: Scene) -> tuple[list[int], float]:
    """Return the indices of incomplete masks, and the error of the others if they are given and inexact."""
    if scene.masks_found or scene.mask_error is not None:
        return [], scene.mask_margin  # a scene whose masks have been measured has lost the incomplete ones
    return find_mask_errors(scene.train, scene.options.mask_error)


def check_lenses(
    views: Sequence[View], names: Sequence[str], options: PhotoCheckOptions = PhotoCheckOptions()
) -> list[Finding]:
    """Return findings on focal lengths and image sizes."""
    cameras = [view.camera for view in views]
    found = []
    # Relative to the diagonal, so that portrait and landscape photographs of a lens agree.
    focal = np.array([camera.K[0, 0] / np.hypot(camera.width, camera.height) for camera in cameras])
    other = np.flatnonzero(np.abs(focal / np.median(focal) - 1) > options.focal)
    if len(other):
        found.append(
            Finding(
                Code.MIXED_LENSES,
                Severity.NOTE,
                f"{len(other)} of {len(views)} photographs have another focal length than the others",
                round(float(focal.max() / focal.min()), 2),
                "times",
                "if they were neither zoomed nor cropped, their cameras are wrong: `mgsr poses`",
                pick(names, other),
            )
        )
    across = [2 * np.degrees(np.arctan(max(camera.width, camera.height) / 2 / camera.K[0, 0])) for camera in cameras]
    if (widest := float(np.median(across))) > options.wide:
        found.append(
            Finding(
                Code.WIDE_LENS,
                Severity.NOTE,
                f"the images are {widest:.0f} degrees wide, so the object covers few of their pixels",
                round(widest, 1),
                "deg",
                "use the main lens of the camera, or come nearer",
            )
        )
    side = float(np.median([max(camera.width, camera.height) for camera in cameras]))
    if side < options.small_side:
        found.append(
            Finding(
                Code.SMALL_IMAGES,
                Severity.NOTE,
                f"the photographs have {side:.0f} pixels along their longer side",
                side,
                "px",
                "larger photographs, up to 1600 pixels, give finer detail",
            )
        )
    return found
