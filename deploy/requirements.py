"""Print the requirements of an image beside MGSR itself, from pyproject.toml, for `pip install -r`.

python requirements.py service|worker-cpu|worker-gpu [PYPROJECT]

The service's image omits the library's dependencies, such as torch, and the extra `poses`, since it never imports them.
"""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path
from typing import Any

# The extras of each image, and whether it runs the library.
IMAGES = {
    "service": (("service", "telemetry"), False),
    "worker-cpu": (("worker", "telemetry"), True),
    "worker-gpu": (("worker", "telemetry", "cuda"), True),
}
# The library's dependencies that the console programs and the service also import.
SHARED = ("pydantic", "typer", "rich")


def requirements(image: str, project: dict[str, Any]) -> list[str]:
    """Return the requirements of an image. Raises KeyError for an image that does not exist."""
    extras, with_library = IMAGES[image]
    base: list[str] = project["dependencies"]
    chosen = [line for line in base if with_library or line.startswith(SHARED)]
    known: dict[str, list[str]] = project["optional-dependencies"]
    if not with_library:
        known = known | {"poses": []}
    return chosen + [line for extra in extras for line in _of_extra(extra, known)]


def _of_extra(extra: str, all_extras: dict[str, list[str]]) -> list[str]:
    """Return the requirements of an extra. `mgsr[other]` in it is replaced by the requirements of the other extra."""
    found: list[str] = []
    for line in all_extras[extra]:
        own = line.startswith("mgsr[")
        found += _of_extra(line[len("mgsr[") : -1], all_extras) if own else [line]
    return found


if __name__ == "__main__":
    pyproject = Path(sys.argv[2] if len(sys.argv) > 2 else "pyproject.toml")
    print("\n".join(requirements(sys.argv[1], tomllib.loads(pyproject.read_text(encoding="utf-8"))["project"])))
