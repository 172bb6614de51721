"""Decide what the masks of views mean: silhouettes of the object, regions to ignore, or nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import compress

import numpy as np
from scipy import ndimage

from mgsr.config import Masks
from mgsr.config.expert import MaskUseOptions
from mgsr.data.images import composite_on_white
from mgsr.data.loading import LoadedView
from mgsr.data.mask_use import MaskUse, find_mask_use
from mgsr.data.scene import View
from mgsr.data.valid_mask import whole_part
from mgsr.errors import SceneError


@dataclass(frozen=True)
class SettledViews:
    """Views whose masks are settled: either all training views have a silhouette as alpha, or no view has one.

    notes: messages to the user about omissions. use: the meaning of the masks beside the photographs, None without any.
    ignoring: whether masks make pixels invalid.
    """

    train: list[View]
    test: list[View]
    notes: tuple[str, ...] = ()
    use: MaskUse | None = None
    ignoring: bool = False


def settle_masks(
    train: list[LoadedView], test: list[LoadedView], masks: Masks, options: MaskUseOptions = MaskUseOptions()
) -> SettledViews:
    """Apply the masks of views as the setting `masks` says.

    Masks beside photographs are silhouettes, or they mark regions to ignore; the setting or else `find_mask_use`
    decides. Ignored pixels are invalid in their view. Silhouettes are used only if every training view has one. An
    alpha channel that is 255 in all views is not a mask. If alpha of a photograph itself is not used, its colours are
    composited on white. Views with an empty silhouette, or without any valid pixel, are left out.

    Raises SceneError for requested masks that are missing, for inverted masks, for masks of unclear meaning, and for
    masks that are empty in most training views.
    """
    if masks is Masks.OFF:
        return SettledViews([_bare(item.view, item) for item in train], [_bare(item.view, item) for item in test])
    use = _use(train, masks, options)
    ignoring = use is MaskUse.IGNORE
    unknown = ignoring or any(item.ignored is not None for item in train)
    train, notes = _not_ignored_whole(train, ignoring)
    views, tests = ([_settled(item, ignoring) for item in items] for items in (train, test))
    tests_shown = [_shows(view) for view in tests]
    test, tests = list(compress(test, tests_shown)), list(compress(tests, tests_shown))
    if unknown:
        notes = (*_note_of_ignored(views), *notes)
    if _tell_nothing(views, masks):
        unused = _unused_masks(views, any(item.mask is not None for item in train) and not ignoring)
        views, tests = (list(map(_bare, seen, items)) for seen, items in ((views, train), (tests, test)))
        return SettledViews(views, tests, (*notes, *unused), use, unknown)
    views, empty = _with_an_object(views)
    return SettledViews(views, [view for view in tests if not _empty(view)], (*notes, *empty), use, unknown)


def _use(train: Sequence[LoadedView], masks: Masks, options: MaskUseOptions) -> MaskUse | None:
    """Return the meaning of the masks beside the photographs, or None if there are none or all are white.

    Raises SceneError for masks=ignore without any mask.
    """
    with_masks = [item for item in train if item.mask is not None]
    if masks is Masks.IGNORE and not with_masks and not any(item.ignored is not None for item in train):
        raise SceneError("masks=ignore: no photograph has a mask; copy masks to masks/, named like the photographs")
    if masks in (Masks.OBJECT, Masks.IGNORE):
        return MaskUse(masks.value)
    if not with_masks:
        return None
    if all((item.mask == 255).all() for item in with_masks if item.mask is not None):
        return None
    shown = [whole_part(replace(item.view, alpha=item.mask)) for item in with_masks]
    return find_mask_use([_alpha(view) for view in shown], [view.camera for view in shown], options)


def _alpha(view: View) -> np.ndarray:
    """Return a view's mask [H,W] uint8."""
    assert view.alpha is not None, "only views with masks reach this"
    return view.alpha


def _settled(item: LoadedView, ignoring: bool) -> View:
    """Return the view with its silhouette as alpha, and with ignored pixels marked as invalid."""
    view, mask = item.view, item.mask
    if item.ignored is not None:
        view = _without(view, item.ignored >= 128)
    if mask is None:
        return view
    if ignoring:
        return _without(view, mask < 128)
    return replace(view, alpha=mask if view.alpha is None else np.minimum(view.alpha, mask))


def _without(view: View, ignored: np.ndarray) -> View:
    """Return the view with the pixels `ignored` [H,W] bool and their neighbours marked as invalid.

    The neighbours contain some of the ignored pixels' light.
    """
    if not ignored.any():
        return view
    valid = ~ndimage.binary_dilation(ignored, np.ones((3, 3), bool))
    return replace(view, valid_mask=valid if view.valid_mask is None else valid & view.valid_mask)


def _not_ignored_whole(train: list[LoadedView], ignoring: bool) -> tuple[list[LoadedView], tuple[str, ...]]:
    """Return the views with valid pixels, and a note on the others.

    Raises SceneError if most views have none.
    """
    kept = [item for item in train if _shows(_settled(item, ignoring))]
    if len(kept) == len(train):
        return train, ()
    first = next(item.view.name for item in train if not _shows(_settled(item, ignoring)))
    count = f"the masks of {len(train) - len(kept)} of {len(train)} training views ignore the whole image"
    if len(kept) < max(2, len(train) / 2):
        raise SceneError(f"{count} ({first!r}); make only the areas to ignore black, or run with masks=off")
    return kept, (f"{count} ({first!r}); these views are skipped",)


def _shows(view: View) -> bool:
    return view.valid_mask is None or bool(view.valid_mask.any())


def _note_of_ignored(train: Sequence[View]) -> tuple[str, ...]:
    share = np.mean([0.0 if view.valid_mask is None else 1 - view.valid_mask.mean() for view in train])
    return (
        f"the masks mark areas to ignore, {share:.1%} of the training photographs; with masks=object, their white "
        "would be the object",
    )


def _tell_nothing(train: Sequence[View], masks: Masks) -> bool:
    """Return whether a training view has no silhouette, or every silhouette is completely white.

    Raises SceneError if `masks` asks for silhouettes.
    """
    bare = [view.name for view in train if view.alpha is None]
    solid = all(_solid(view) for view in train)
    if masks is Masks.OBJECT and (bare or solid):
        missing = f"view {bare[0]!r} has none" if bare else "every mask is completely white"
        raise SceneError(f"masks=object: {missing}; add alpha channels or a masks/ folder, or use masks=auto")
    return bool(bare) or solid


def _bare(view: View, item: LoadedView) -> View:
    """Return the view without a silhouette; colours that came with alpha are composited on white."""
    if item.view.alpha is None or view.alpha is None:
        return replace(view, alpha=None)
    return replace(view, image=composite_on_white(view.image, view.alpha), alpha=None)


def _unused_masks(train: Sequence[View], beside: bool) -> tuple[str, ...]:
    """Return a note on masks that are not used because only some views have one, or all are white.

    beside: whether any mask is a file beside the photographs, not an alpha channel.
    """
    bare = [view.name for view in train if view.alpha is None]
    if bare and len(bare) < len(train):
        having = f"{len(train) - len(bare)} of {len(train)} training views have a mask"
        return (f"{having}, but {bare[0]!r} has none, so masks are not used",)
    if not bare and beside and all(_solid(view) for view in train):
        return ("every mask is completely white, so masks are not used",)
    return ()


def _with_an_object(train: list[View]) -> tuple[list[View], tuple[str, ...]]:
    """Return the views with non-empty masks, and a note on the others. Raises SceneError if most are empty."""
    shown = [view for view in train if not _empty(view)]
    if len(shown) == len(train):
        return train, ()
    first = next(view for view in train if _empty(view))
    count = f"the masks of {len(train) - len(shown)} of {len(train)} training views are empty"
    if len(shown) < max(2, len(train) / 2):
        raise SceneError(
            f"{count}: values of 128 and more are the object, and the mask of {first.name!r} has at most "
            f"{_brightest(first)}; make the masks white on the object, or run with masks=off"
        )
    return shown, (f"{count} ({first.name!r}); these views are skipped",)


def _empty(view: View) -> bool:
    return view.alpha is not None and _brightest(view) < 128


def _brightest(view: View) -> int:
    """Return the largest value of the mask over the valid pixels."""
    alpha = _alpha(view)
    return int((alpha if view.valid_mask is None else alpha[view.valid_mask]).max(initial=0))


def _solid(view: View) -> bool:
    """Return whether all valid pixels show the object, as they do in a view without alpha."""
    if view.alpha is None:
        return True
    shown = view.alpha if view.valid_mask is None else view.alpha[view.valid_mask]
    return bool(shown.min(initial=255) == 255)
