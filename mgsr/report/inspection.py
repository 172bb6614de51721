"""The findings of the check before training as rows of a table, and a map of the cameras."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import numpy as np

_NAMED = 12  # the most photographs that a row names
_WIDTH, _HEIGHT, _MARGIN = 620.0, 420.0, 24.0


def finding_rows(inspection: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """Return for each finding its severity, its amount, and a sentence with the photographs and the remedy."""
    return [
        (str(found["severity"]), f"{found['amount']:g} {found['unit']}", _sentence(found))
        for found in inspection["findings"]
    ]


def _sentence(found: Mapping[str, Any]) -> str:
    names = list(found["photographs"])
    listed = ", ".join(names[:_NAMED]) + (f" and {len(names) - _NAMED} more" if len(names) > _NAMED else "")
    text = str(found["text"])
    return f"{text[:1].upper()}{text[1:]}{f' ({listed})' if names else ''}. What to do: {found['cure']}."


def camera_map(inspection: Mapping[str, Any]) -> str:
    """Draw the cameras' places as an SVG, seen along the direction in which they vary least.

    Cameras that an error or a warning names are filled. Crosses mark places where photographs are missing. Returns
    empty text for fewer than three photographs.
    """
    photographs = inspection["photographs"]
    if len(photographs) < 3:
        return ""
    centers = np.array([photo["center"] for photo in photographs], np.float64)
    missing = [place for found in inspection["findings"] for place in found["places"]]
    places = np.array(missing, np.float64).reshape(-1, 3)
    flat = _flattened(centers, np.concatenate([centers, places]))
    named = {name for found in inspection["findings"] if found["severity"] != "note" for name in found["photographs"]}
    marks = [
        _dot(point, photo["name"], photo["name"] in named) for point, photo in zip(flat, photographs, strict=False)
    ]
    marks += [_cross(point) for point in flat[len(centers) :]]
    return (
        f'<svg class="chart cameras" viewBox="0 0 {_WIDTH:.0f} {_HEIGHT:.0f}" role="img" '
        f'aria-label="The cameras, and where photographs are missing">{"".join(marks)}</svg>'
    )


def _flattened(cameras: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Project points [P,3] to the picture [P,2], along the two directions in which the cameras [C,3] vary most."""
    middle = cameras.mean(axis=0)
    axes = np.linalg.svd(cameras - middle, full_matrices=False)[2][:2]
    flat = (points - middle) @ axes.T
    low, high = flat.min(axis=0), flat.max(axis=0)
    scale = ((np.array([_WIDTH, _HEIGHT]) - 2 * _MARGIN) / np.maximum(high - low, 1e-12)).min()
    return np.asarray((flat - (low + high) / 2) * scale + np.array([_WIDTH, _HEIGHT]) / 2)


def _dot(point: Sequence[float] | np.ndarray, name: str, bad: bool) -> str:
    kind = "camera bad" if bad else "camera"
    return (
        f'<circle class="{kind}" cx="{point[0]:.1f}" cy="{point[1]:.1f}" r="5"><title>{escape(name)}</title></circle>'
    )


def _cross(point: Sequence[float] | np.ndarray) -> str:
    x, y = float(point[0]), float(point[1])
    return (
        f'<path class="missing" d="M{x - 6:.1f} {y - 6:.1f}l12 12m0 -12l-12 12"><title>a photograph is missing here'
        "</title></path>"
    )
