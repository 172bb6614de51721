"""Checks of the cameras' places around the object: sides that no camera sees, and too little parallax for depth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mgsr.config.expert import CoverageOptions
from mgsr.data.camera import Camera
from mgsr.data.scene import Similarity
from mgsr.inspection.findings import Code, Finding, Severity


def check_sides(
    cameras: Sequence[Camera],
    names: Sequence[str],
    user: Similarity,
    options: CoverageOptions = CoverageOptions(),
) -> list[Finding]:
    """Return findings on sides of the object that no camera sees, with places for further photographs.

    cameras: in the scene's frame, in which the object lies around the origin. user: converts places to the user's
    frame.
    """
    centers = np.array([camera.center for camera in cameras])
    distances = np.linalg.norm(centers, axis=1)
    views = centers / np.maximum(distances, 1e-9)[:, None]
    sides = _sphere(options.directions)
    angles = np.degrees(np.arccos(np.clip(sides @ views.T, -1, 1)))
    unseen = angles.min(axis=1) > options.seen
    up = _up(cameras)
    below = sides @ up < -options.underside
    found = []
    above = unseen & ~below
    if above.mean() >= options.min_gap:
        where = _spread_places(sides[above], options)
        nearest = angles[np.argmax(np.where(above, angles.min(axis=1), -1))].argsort()[:2]
        places = user.to_user(where * float(np.median(distances)))
        found.append(_gap(float(above.mean()), options.seen, places, [names[i] for i in nearest]))
    if not above.any() and (unseen & below).mean() >= options.min_gap:
        found.append(_underside(float((unseen & below).mean())))
    return found


def _gap(share: float, seen: float, places: np.ndarray, nearest: Sequence[str]) -> Finding:
    """Return the finding on a gap, with places [P,3] for further photographs, in the user's frame."""
    return Finding(
        Code.UNSEEN_SIDE,
        Severity.WARNING,
        f"no photograph shows {share:.0%} of the object's sides from less than {seen:.0f} degrees off; the largest gap "
        f"lies between {' and '.join(nearest)}",
        round(4 * np.pi * share, 2),
        "sr",
        f"add photographs around {_placed(places[0])}" + (f" and {len(places) - 1} more places" * (len(places) > 1)),
        tuple(nearest),
        tuple((float(x), float(y), float(z)) for x, y, z in places.round(4)),
    )


def _placed(place: np.ndarray) -> str:
    return "(" + ", ".join(f"{value:.3g}" for value in place) + ")"


def _underside(share: float) -> Finding:
    return Finding(
        Code.UNSEEN_SIDE,
        Severity.NOTE,
        "no photograph shows the underside",
        round(4 * np.pi * share, 2),
        "sr",
        "if you need the underside, turn the object over and photograph it as a separate capture",
    )


def _up(cameras: Sequence[Camera]) -> np.ndarray:
    """Return the mean unit direction [3] to which the tops of the images point."""
    up = -np.mean([camera.cam_from_world[1, :3] for camera in cameras], axis=0)
    return np.asarray(up / max(float(np.linalg.norm(up)), 1e-9))


def _spread_places(sides: np.ndarray, options: CoverageOptions) -> np.ndarray:
    """Choose directions [P,3] for cameras that together would see all unseen sides [S,3].

    The choice repeatedly takes the unseen direction that is farthest from all chosen ones. Each result is the mean of
    the unseen directions around it.
    """
    chosen: list[np.ndarray] = []
    left = sides
    while len(left) and len(chosen) < options.max_places:
        near = left @ left.T > np.cos(np.radians(options.seen / 2))
        middle = left[near[near.sum(axis=1).argmax()]].mean(axis=0)
        chosen.append(middle / np.linalg.norm(middle))
        left = left[left @ chosen[-1] < np.cos(np.radians(options.seen))]
    return np.array(chosen)


def check_parallax(
    centers: np.ndarray, target: np.ndarray, options: CoverageOptions = CoverageOptions()
) -> list[Finding]:
    """Return a finding if the cameras at `centers` [C,3] all see `target` [3] from nearly the same direction."""
    rays = centers - target
    rays /= np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), 1e-12)
    widest = float(np.degrees(np.arccos(np.clip(rays @ rays.T, -1, 1))).max())
    if widest >= options.small_angle:
        return []
    return [
        Finding(
            Code.LITTLE_PARALLAX,
            Severity.ERROR if widest < options.error_angle else Severity.WARNING,
            f"the cameras span only {widest:.1f} degrees around the object, too little to measure depth",
            round(widest, 2),
            "deg",
            "walk around the object; turning the camera on the spot does not help",
        )
    ]


def _sphere(count: int) -> np.ndarray:
    """Return `count` directions [N,3], spread evenly over the sphere (a Fibonacci spiral)."""
    index = np.arange(count) + 0.5
    height, turn = 1 - 2 * index / count, np.pi * (1 + 5**0.5) * index
    across = np.sqrt(1 - height**2)
    return np.stack([across * np.cos(turn), across * np.sin(turn), height], axis=1)
