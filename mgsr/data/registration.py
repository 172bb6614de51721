"""Photographs that a capture's cameras leave out: noticed, and refused where most of them are lost."""

from __future__ import annotations

from mgsr.errors import SceneError


def check_share(kept: int, total: int, least: float, what: str, cure: str) -> tuple[str, ...]:
    """A note for the person if fewer than all photographs are used, else nothing.

    what: what the used ones have in common ("have a pose in cameras.xml"). Raises SceneError, with the cure, where the
    share of those is under `least`.
    """
    if kept == total:
        return ()
    text = f"{kept} of {total} photographs {what}"
    if kept < least * total:
        raise SceneError(f"only {text}; {cure}")
    return (f"{text}; the others are left out",)
