"""Depth maps of a ball with a bowl pressed into its cap, fused inside the hull of its silhouettes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import trimesh

from mgsr.data.camera import pixel_size
from mgsr.data.hull import Hull, carve, hull_surface
from mgsr.geometry.raycast import RayCaster
from mgsr.stereo import fusion
from mgsr.stereo.fusion import fuse
from mgsr.stereo.patch_match import DepthMap
from mgsr.stereo.photographs import StereoPhotographs
from tests.mesh.shapes import cameras_around, silhouettes_of
from tests.stereo.pressed_ball import pressed

COUNT, SIDE = 20, 64
CAMERAS = cameras_around(COUNT, side=SIDE)
PHOTOGRAPHS = StereoPhotographs([np.zeros((SIDE, SIDE, 4), np.float32)] * COUNT, CAMERAS)

Change = Callable[[np.ndarray], np.ndarray]  # of depths [P]


@pytest.fixture(scope="module")
def ball() -> trimesh.Trimesh:
    return pressed()


@pytest.fixture(scope="module")
def hull(ball: trimesh.Trimesh) -> Hull:
    return carve(silhouettes_of(ball, CAMERAS), np.zeros(3), 1.05, 64)


def perfect(ball: trimesh.Trimesh, change: Change = lambda depths: depths) -> list[DepthMap]:
    """What each camera sees of the ball, its depths changed."""
    caster, maps = RayCaster(ball.vertices, ball.faces), []
    for camera in CAMERAS:
        hits = caster.cast(camera)
        depth = hits.depth.copy()
        depth[hits.mask] = change(depth[hits.mask])
        maps.append(DepthMap(depth, hits.normal, hits.mask.astype(np.float32)))
    return maps


def heavy(maps: list[DepthMap], weight: float = 1.0) -> list[np.ndarray]:
    return [weight * (found.depth > 0).astype(np.float32) for found in maps]


def distances(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """How far [P] points lie from a mesh."""
    face, shares = RayCaster(vertices, faces).nearest(points)
    return np.asarray(np.linalg.norm((vertices[faces[face]] * shares[..., None]).sum(axis=1) - points, axis=1))


def apart(fused: Hull, ball: trimesh.Trimesh) -> tuple[np.ndarray, np.ndarray]:
    """Distances in voxels: from the surface's vertices to the ball, and from the ball's to the surface."""
    vertices, faces = hull_surface(fused)
    forth, back = distances(vertices, ball.vertices, ball.faces), distances(ball.vertices, vertices, faces)
    return forth / fused.voxel, back / fused.voxel


def test_perfect_depths_give_the_surface(ball: trimesh.Trimesh, hull: Hull) -> None:
    maps = perfect(ball)
    before = apart(fuse(PHOTOGRAPHS, maps, heavy(maps, 0), hull), ball)
    after = apart(fuse(PHOTOGRAPHS, maps, heavy(maps), hull), ball)
    # The grid rounds the crease around the cap by a little more.
    assert all(np.percentile(found, 97) < 0.5 and found.max() < 1 for found in after)
    in_bowl = np.linalg.norm(ball.vertices[:, :2], axis=1) < 0.25
    in_bowl &= ball.vertices[:, 2] > 0
    assert before[1][in_bowl].min() > 1 and np.median(before[1][in_bowl]) > 2.5
    assert after[1][in_bowl].max() < 0.3


def test_maps_that_say_nothing_leave_the_hull(ball: trimesh.Trimesh, hull: Hull) -> None:
    maps = perfect(ball, lambda depths: depths + 0.1)
    fused = fuse(PHOTOGRAPHS, maps, heavy(maps, 0), hull)
    vertices, faces = hull_surface(fused)
    outer = hull_surface(hull)
    for found in (distances(vertices, *outer), distances(outer[0], vertices, faces)):
        assert np.percentile(found, 95) < 0.3 * fused.voxel and found.max() < 0.6 * fused.voxel


@pytest.mark.parametrize("nearer", [0.0, 0.05])
def test_nothing_lies_outside_the_hull(nearer: float, ball: trimesh.Trimesh, hull: Hull) -> None:
    maps = perfect(ball, lambda depths: depths - nearer)
    fused = fuse(PHOTOGRAPHS, maps, heavy(maps), hull)
    inside = np.argwhere(fused.field > 0) * fused.voxel + fused.origin
    assert len(inside) > 10_000 and (hull.values(inside) > 0).all()


def test_wild_depths_hardly_matter(ball: trimesh.Trimesh, hull: Hull) -> None:
    """A third of them, up to twelve voxels off to either side."""
    random = np.random.default_rng(0)

    def wild(depths: np.ndarray) -> np.ndarray:
        return np.where(random.random(len(depths)) < 1 / 3, depths + random.uniform(-0.3, 0.3, len(depths)), depths)

    maps = perfect(ball, wild)
    forth, back = apart(fuse(PHOTOGRAPHS, maps, heavy(maps), hull), ball)
    assert np.percentile(forth, 90) < 0.6 and np.percentile(back, 97) < 0.6 and back.max() < 1.2


def test_heavier_words_count_more(ball: trimesh.Trimesh, hull: Hull) -> None:
    """Of two maps that each camera has, one is right and the other puts all two voxels deeper along its rays."""
    maps, deeper = perfect(ball), perfect(ball, lambda depths: depths + 0.05)
    both = StereoPhotographs(PHOTOGRAPHS.images * 2, CAMERAS * 2)
    right, wrong = (
        apart(fuse(both, maps + deeper, heavy(maps, one) + heavy(deeper, 1 - one), hull), ball)[1] for one in (0.8, 0.2)
    )
    assert np.median(right) < 0.3 and np.median(wrong) > 0.6


def test_the_grid_is_as_fine_as_pixels_and_no_larger_than_it_may(
    ball: trimesh.Trimesh, hull: Hull, monkeypatch: pytest.MonkeyPatch
) -> None:
    maps = perfect(ball)
    fused = fuse(PHOTOGRAPHS, maps, heavy(maps), hull)
    assert fused.voxel == pytest.approx(fusion.FINEST * pixel_size(CAMERAS, np.zeros(3)))
    monkeypatch.setattr(fusion, "RESOLUTION", 30)
    fused = fuse(PHOTOGRAPHS, maps, heavy(maps), hull)
    assert max(fused.field.shape) == 31
    # All of the hull lies in it, and a margin around.
    assert (hull.reached().min(axis=0) > fused.origin).all()
    assert (hull.reached().max(axis=0) < fused.origin + fused.voxel * (np.array(fused.field.shape) - 1)).all()
