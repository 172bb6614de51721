"""Note photographs that a capture's cameras leave out, and refuse the capture where most of them are lost."""

from __future__ import annotations

from collections.abc import Sequence

from mgsr.errors import SceneError, in_short


def check_share(
    kept: int, total: int, least: float, what: str, cure: str, missing: Sequence[str] = ()
) -> tuple[str, ...]:
    """Return a note for the person if fewer than all photographs are used, else nothing.

    what: what the used ones have in common ("have a pose in cameras.xml"). missing: names of photographs that were
    looked for but not found. Raises SceneError, with the cure and the first of those, where the share of the used ones
    is under `least`.
    """
    if kept == total:
        return ()
    text = f"{kept} of {total} photographs {what}"
    if kept < least * total:
        example = f" ({in_short(missing[0])} is missing)" if missing else ""
        raise SceneError(f"only {text}{example}; {cure}")
    return (f"{text}; the others are left out",)
