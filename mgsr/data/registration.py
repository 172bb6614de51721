"""Notes on photographs without a usable camera; a capture is refused if most of its photographs have none."""

from __future__ import annotations

from collections.abc import Sequence

from mgsr.errors import SceneError, in_short


def check_share(
    kept: int, total: int, least: float, what: str, cure: str, missing: Sequence[str] = ()
) -> tuple[str, ...]:
    """Return a note to the user if not all photographs are used, else none.

    what: the property of the used photographs ("have a pose in cameras.xml"). missing: names of photographs that were
    not found. Raises SceneError, with the cure and the first missing name, where the share of used photographs is under
    `least`.
    """
    if kept == total:
        return ()
    text = f"{kept} of {total} photographs {what}"
    if kept < least * total:
        example = f" ({in_short(missing[0])} is missing)" if missing else ""
        raise SceneError(f"only {text}{example}; {cure}")
    return (f"{text}; the others are skipped",)
