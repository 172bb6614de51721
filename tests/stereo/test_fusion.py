"""Depth maps of shapes that are known exactly, fused: a ball with a bowl pressed into its cap inside the hull of its
silhouettes, a sheet, and a deep cavity of a block."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from mgsr.config.expert import FusionOptions
from mgsr.data.camera import Camera, pixel_size
from mgsr.data.hull import Hull, carve, hull_surface
from mgsr.geometry.mesh import Mesh
from mgsr.geometry.raycast import RayCaster
from mgsr.stereo import fusion
from mgsr.stereo.fusion import fuse, fuse_roughly
from mgsr.stereo.patch_match import DepthMap
from tests.mesh.shapes import as_mesh, cameras_around, looking_at_origin, silhouettes_of
from tests.stereo.pressed_ball import cameras_above, pressed

COUNT, SIDE = 20, 64
CAMERAS = cameras_around(COUNT, side=SIDE)
TWICE = CAMERAS[::2] * 2  # every second camera, with two maps each
PIXEL = pixel_size(CAMERAS, np.zeros(3))
OPTIONS = FusionOptions()

Change = Callable[[np.ndarray], np.ndarray]  # of depths [P]


@pytest.fixture(scope="module")
def ball() -> trimesh.Trimesh:
    return pressed()


@pytest.fixture(scope="module")
def hull(ball: trimesh.Trimesh) -> Hull:
    return carve(silhouettes_of(ball, CAMERAS), np.zeros(3), 1.05, 64)


def perfect(ball: trimesh.Trimesh, change: Change = lambda depths: depths) -> list[DepthMap]:
    """Return what each camera sees of the ball, its depths changed."""
    caster, maps = RayCaster(ball.vertices, ball.faces), []
    for camera in CAMERAS:
        hits = caster.cast(camera)
        depth = hits.depth.copy()
        depth[hits.mask] = change(depth[hits.mask])
        maps.append(DepthMap(depth, hits.normal, hits.mask.astype(np.float32)))
    return maps


def grid_of(hull: Hull, options: FusionOptions = OPTIONS) -> fusion._Grid:
    return fusion._Grid.around(hull, PIXEL, options)


def votes_of(maps: list[DepthMap]) -> fusion._Votes:
    return fusion._Votes(CAMERAS, maps, heavy(maps), OPTIONS.reach * PIXEL, OPTIONS)


def block(half: np.ndarray, voxel: float = 0.03) -> Hull:
    """Return the exact hull of a block of these half sizes [3]."""
    count = int(np.ceil(half.max() / voxel)) + 3
    places = np.stack(np.meshgrid(*[np.arange(-count, count + 1) * voxel] * 3, indexing="ij"), axis=-1)
    inside = half - np.abs(places)
    field = np.maximum(inside.min(axis=-1), 0) - np.linalg.norm(np.minimum(inside, 0), axis=-1)
    return Hull(field.astype(np.float32), np.full(3, -count * voxel), voxel)


def as_trimesh(mesh: Mesh) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


def heavy(maps: list[DepthMap], weight: float = 1.0) -> list[np.ndarray]:
    return [weight * (found.depth > 0).astype(np.float32) for found in maps]


def distances(points: np.ndarray, mesh: Mesh) -> np.ndarray:
    """Return how far [P] points lie from a mesh."""
    face, shares = mesh.caster.nearest(points)
    return np.asarray(
        np.linalg.norm((mesh.vertices[mesh.faces[face]] * shares[..., None]).sum(axis=1) - points, axis=1)
    )


def apart(mesh: Mesh, ball: trimesh.Trimesh, voxel: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the distances in voxels from the surface's vertices to the ball, and from the ball's to the surface."""
    forth, back = distances(mesh.vertices, as_mesh(ball)), distances(ball.vertices, mesh)
    return forth / voxel, back / voxel


@pytest.fixture(scope="module")
def fused(ball: trimesh.Trimesh, hull: Hull) -> Mesh:
    """Fuse perfect depths."""
    maps = perfect(ball)
    return fuse(CAMERAS, maps, heavy(maps), hull, PIXEL)


@pytest.fixture(scope="module")
def untold(ball: trimesh.Trimesh, hull: Hull) -> Mesh:
    """Fuse depths without weight."""
    maps = perfect(ball, lambda depths: depths + 0.1)
    return fuse(CAMERAS, maps, heavy(maps, 0), hull, PIXEL)


def test_perfect_depths_give_the_surface(ball: trimesh.Trimesh, hull: Hull, fused: Mesh, untold: Mesh) -> None:
    before, after = (apart(mesh, ball, grid_of(hull).voxel) for mesh in (untold, fused))
    # The grid rounds the crease around the cap by a little more.
    assert all(np.percentile(found, 97) < 0.5 and found.max() < 1 for found in after)
    in_bowl = np.linalg.norm(ball.vertices[:, :2], axis=1) < 0.25
    in_bowl &= ball.vertices[:, 2] > 0
    assert before[1][in_bowl].min() > 1 and np.median(before[1][in_bowl]) > 2.5
    # A voxel outside a bowl, votes and distances are smoothed over more of its curve than in its place.
    assert after[1][in_bowl].max() < 0.5


def test_maps_that_say_nothing_leave_the_hull(hull: Hull, untold: Mesh) -> None:
    outer, voxel = Mesh(*hull_surface(hull)), grid_of(hull).voxel
    for found in (distances(untold.vertices, outer), distances(outer.vertices, untold)):
        assert np.percentile(found, 95) < 0.3 * voxel and found.max() < 0.6 * voxel


def test_nothing_lies_outside_the_hull(ball: trimesh.Trimesh, hull: Hull) -> None:
    """Check that nothing lies outside the hull, with depths that would put all two voxels before its place."""
    maps, grid = perfect(ball, lambda depths: depths - 0.05), grid_of(hull)
    fused = fusion._fused(votes_of(maps), grid, hull, None)
    inside = np.argwhere(fused.field > 0) * fused.voxel + fused.origin
    assert len(inside) > 10_000 and (hull.values(inside) > 0).all()
    # Along mean normals, the surface does not come all the way back at the crease.
    beyond = -hull.values(fuse(CAMERAS, maps, heavy(maps), hull, PIXEL).vertices) / grid.voxel
    assert np.percentile(beyond, 99) < 0.3 and beyond.max() < 0.5


def test_wild_depths_hardly_matter(ball: trimesh.Trimesh, hull: Hull) -> None:
    """Check that a third of wild depths, up to twelve voxels off to either side, hardly matter."""
    random = np.random.default_rng(0)

    def wild(depths: np.ndarray) -> np.ndarray:
        return np.where(random.random(len(depths)) < 1 / 3, depths + random.uniform(-0.3, 0.3, len(depths)), depths)

    maps = perfect(ball, wild)
    forth, back = apart(fuse(CAMERAS, maps, heavy(maps), hull, PIXEL), ball, grid_of(hull).voxel)
    assert np.percentile(forth, 90) < 0.6 and np.percentile(back, 97) < 0.6 and back.max() < 1.2


@pytest.mark.slow
def test_heavier_words_count_more(ball: trimesh.Trimesh, hull: Hull) -> None:
    """Check that the heavier of two maps counts more.

    Of two maps that each camera has, one is right and the other puts all two voxels deeper along its rays.
    """
    maps, deeper = perfect(ball)[::2], perfect(ball, lambda depths: depths + 0.05)[::2]
    right, wrong = (
        apart(
            fuse(TWICE, maps + deeper, heavy(maps, one) + heavy(deeper, 1 - one), hull, PIXEL),
            ball,
            grid_of(hull).voxel,
        )[1]
        for one in (0.8, 0.2)
    )
    assert np.median(right) < 0.3 and np.median(wrong) > 0.8


@pytest.mark.slow
def test_what_many_see_before_it_is_solid(ball: trimesh.Trimesh, hull: Hull) -> None:
    """Check that the ball stays solid where each camera has a right map, and a faint one that looks into its middle."""
    maps, through = perfect(ball)[::2], perfect(ball, lambda depths: depths + 0.6)[::2]

    weights, grid = heavy(maps) + heavy(through, 0.06), grid_of(hull)

    def volume(options: FusionOptions) -> float:
        votes = fusion._Votes(TWICE, maps + through, weights, options.reach * PIXEL, options)
        inside = (fusion._fused(votes, grid, hull, None).field > 0).sum()
        return float(inside * grid.voxel**3 / ball.volume)

    assert 0.95 < volume(OPTIONS) < 1.02
    rough = FusionOptions(variation=1e-6)  # total variation would close the middle too
    assert 0.95 < volume(rough) < 1.02
    faint = replace(rough, solid_weight=0.0)
    assert volume(faint) < 0.9, "the faint maps alone tell of the middle"
    # No photograph sees the void, and the surface has none.
    mesh = as_trimesh(fuse(TWICE, maps + through, weights, hull, PIXEL, faint))
    assert len(mesh.split(only_watertight=False)) == 1


def test_coarse_to_fine_is_as_good_as_fine_alone(ball: trimesh.Trimesh, hull: Hull, fused: Mesh) -> None:
    grid = grid_of(hull)
    alone = fusion._surface(fusion._fused(votes_of(perfect(ball)), grid, hull, None), OPTIONS)
    for found in (distances(alone.vertices, fused), distances(fused.vertices, alone)):
        assert np.percentile(found, 97) < 0.15 * grid.voxel and found.max() < 0.25 * grid.voxel


def test_a_rough_fusion_is_right_to_its_own_voxel(ball: trimesh.Trimesh, hull: Hull) -> None:
    maps, voxel = perfect(ball), OPTIONS.coarser * grid_of(hull).voxel
    mesh = fuse_roughly(CAMERAS, maps, heavy(maps), hull, PIXEL)
    assert all(np.percentile(found, 95) < 0.6 and found.max() < 1.5 for found in apart(mesh, ball, voxel))
    assert len(mesh.vertices) < 0.4 * len(fuse(CAMERAS, maps, heavy(maps), hull, PIXEL).vertices)


@pytest.fixture
def plate() -> trimesh.Trimesh:
    """Return a square without thickness, askew to the grid."""
    corners = 0.45 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    mesh = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)
    return mesh.apply_transform(trimesh.transformations.rotation_matrix(0.3, [1, 2, 0.5]))


def in_a_room(sheet: trimesh.Trimesh) -> list[DepthMap]:
    """Return perfect maps of a sheet before far walls."""
    return [DepthMap(np.where(found.score > 0, found.depth, 6), found.normal, found.score) for found in perfect(sheet)]


def test_a_sheet_thinner_than_a_voxel_keeps_both_sides(plate: trimesh.Trimesh) -> None:
    solid, maps = block(np.array([0.55, 0.55, 0.35])), in_a_room(plate)
    mesh, voxel = fuse(CAMERAS, maps, heavy(maps), solid, PIXEL), grid_of(solid).voxel
    shell = as_trimesh(mesh)
    assert mesh.components[0] == 1 and shell.is_watertight and shell.euler_number == 2
    away = distances(mesh.vertices, as_mesh(plate)) / voxel
    assert np.percentile(away, 95) < 0.5 and away.max() < 0.75
    # The rim is moved back by a voxel as well as the sides, and smoothing rounds it, most of all at the corners.
    missed = distances(trimesh.sample.sample_surface(plate, 4000, seed=0)[0], mesh) / voxel
    assert np.percentile(missed, 75) < 0.5 and missed.max() < 4
    torn = as_trimesh(fuse(CAMERAS, maps, heavy(maps), solid, PIXEL, FusionOptions(outside=0.5)))
    assert torn.euler_number < 2
    assert not len(fuse(CAMERAS, maps, heavy(maps), solid, PIXEL, FusionOptions(outside=0.0)).faces)


WELL, FLOOR, HALF = 0.2, -0.25, np.array([0.5, 0.5, 0.45])


@pytest.fixture
def well() -> RayCaster:
    """Return the top of a block with a square cavity, 0.4 wide and 0.7 deep."""
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    rings = [np.c_[size * square, np.full(4, height)] for size, height in ((0.5, 0.45), (WELL, 0.45), (WELL, FLOOR))]
    sides = [[ring + k, ring + (k + 1) % 4, ring + 4 + k] for ring in (0, 4) for k in range(4)]
    sides += [[ring + (k + 1) % 4, ring + 4 + (k + 1) % 4, ring + 4 + k] for ring in (0, 4) for k in range(4)]
    return RayCaster(np.concatenate(rings), np.array([*sides, [8, 9, 10], [8, 10, 11]]))


@pytest.mark.parametrize(("weight", "variation"), [(0.05, 1e-6), (1 / 12, OPTIONS.variation)])
def test_faint_words_empty_a_deep_cavity(weight: float, variation: float, well: RayCaster) -> None:
    """Check that faint words of the few cameras that see its floor empty a deep cavity.

    Under total variation, which prefers the short way across its mouth, they must say more.
    """
    cameras = cameras_above(COUNT, SIDE)
    hits = [well.cast(camera) for camera in cameras]
    maps = [DepthMap(hit.depth, hit.normal, hit.mask.astype(np.float32)) for hit in hits]
    pixel = pixel_size(cameras, np.zeros(3))
    above = looking_at_origin(np.array([0, 0.01, 3.0]), SIDE)
    floor = (true := well.cast(above).depth) > 3.2

    def depth(options: FusionOptions) -> float:
        seen = fuse(cameras, maps, heavy(maps, weight), block(HALF), pixel, options).caster.cast(above).depth
        share: float = float(np.median((seen - 3 + HALF[2])[floor])) / (HALF[2] - FLOOR)
        return share

    assert floor.sum() > 100 and np.median((true - 3 + HALF[2])[floor]) == pytest.approx(HALF[2] - FLOOR, abs=0.01)
    assert 0.8 < depth(FusionOptions(variation=variation)) < 1.02
    assert depth(FusionOptions(variation=variation, fading=1e9)) < 0.6, "all of the hull's vote holds out"


def test_small_pieces_are_dropped() -> None:
    """Check that a piece of a tenth of a block's size is dropped, and that one of a fifth stays."""
    field = np.full((60, 40, 40), -0.03, np.float32)
    for low, size in ((5, 20), (30, 4), (40, 2)):
        field[low : low + size, 10 : 10 + size, 10 : 10 + size] = 0.03
    hull = Hull(field, np.full(3, -0.6), 0.03)
    maps = [DepthMap(*(np.zeros((SIDE, SIDE, *more), np.float32) for more in ((), (3,), ())))] * COUNT
    mesh = fuse(CAMERAS, maps, heavy(maps), hull, PIXEL)
    assert mesh.components[0] == 2
    assert mesh.vertices[:, 0].max() < hull.origin[0] + 38 * hull.voxel, "the smallest is gone"


def test_the_grid_is_as_fine_as_pixels_and_no_larger_than_it_may(hull: Hull) -> None:
    assert grid_of(hull).voxel == pytest.approx(OPTIONS.finest * PIXEL)
    grid = grid_of(hull, FusionOptions(resolution=30))
    assert max(grid.shape) == 31
    # All of the hull lies in it, and a margin around.
    assert (hull.reached().min(axis=0) > grid.origin).all()
    assert (hull.reached().max(axis=0) < grid.origin + grid.voxel * (np.array(grid.shape) - 1)).all()


def rod(radius: float, half: float, voxel: float = 0.02) -> Hull:
    """Return the exact hull of a round rod along x of this radius, with flat ends at +-half."""
    count = np.array([int(np.ceil(size / voxel)) + 3 for size in (half, radius, radius)])
    places = np.stack(np.meshgrid(*[np.arange(-n, n + 1) * voxel for n in count], indexing="ij"), axis=-1)
    inside = np.minimum(half - np.abs(places[..., 0]), radius - np.linalg.norm(places[..., 1:], axis=-1))
    return Hull(inside.astype(np.float32), -count * voxel, voxel)


def test_a_rod_that_only_silhouettes_tell_stays() -> None:
    """Check that a rod of about two pixels across stays, though the least surface would be none."""
    maps = [DepthMap(*(np.zeros((SIDE, SIDE, *more), np.float32) for more in ((), (3,), ())))] * COUNT
    thin = rod(PIXEL, 0.6)

    def length(options: FusionOptions) -> float:
        vertices = fuse(CAMERAS, maps, heavy(maps), thin, PIXEL, options).vertices
        return float(np.ptp(vertices[:, 0])) if len(vertices) else 0.0

    assert 1.0 < length(OPTIONS) < 1.25
    assert length(FusionOptions(thinnest=1.0)) < 0.2


def test_contradicting_words_give_a_calm_surface(hull: Hull) -> None:
    """Check that depths that scatter behind the hull give a surface about as large as its own convex hull's."""
    random = np.random.default_rng(0)
    outer = Mesh(*hull_surface(hull)).caster

    def scattered(camera: Camera) -> DepthMap:
        hit = outer.cast(camera)
        return DepthMap(
            np.where(hit.mask, hit.depth + random.uniform(0, 0.6, hit.depth.shape), 0).astype(np.float32),
            hit.normal,
            hit.mask.astype(np.float32),
        )

    maps = [scattered(camera) for camera in CAMERAS]

    def roughness(options: FusionOptions) -> float:
        mesh = as_trimesh(fuse(CAMERAS, maps, heavy(maps, 0.2), hull, PIXEL, options))
        return float(mesh.area / mesh.convex_hull.area)

    assert roughness(OPTIONS) < 1.1
    assert roughness(FusionOptions(variation=1e-6)) > 1.5
