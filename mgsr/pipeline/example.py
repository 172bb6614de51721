"""The example capture that comes with the package."""

from __future__ import annotations

from pathlib import Path

from mgsr.errors import MgsrError

EXAMPLE = Path("examples/glossy_knot")


def find_example() -> Path:
    """Find the example capture, inside an installed package or beside it in the sources.

    Raises MgsrError where there is none.
    """
    package = Path(__file__).resolve().parents[1]
    for folder in (package, package.parent):
        if (folder / EXAMPLE).is_dir():
            return folder / EXAMPLE
    raise MgsrError(
        f"the example capture {EXAMPLE} is neither in {package} nor in {package.parent}; reinstall MGSR, or "
        "reconstruct photographs of your own with `mgsr run`"
    )
