"""A ball with and without dents, held against photographs of the ball: a mirror's, and a painted one's."""

from __future__ import annotations

from unittest.mock import Mock

import numpy as np
import pytest
import trimesh

from mgsr.config import MeshConfig
from mgsr.geometry.mesh import Mesh
from mgsr.mesh import extract
from mgsr.mesh.extract import extract_mesh
from mgsr.mesh.surface_choice import is_torn, photographs_prefer_start
from mgsr.shading.photo_set import PhotoSet
from tests.mesh.shapes import ball, cameras_around, views_of
from tests.shading.balls import RADIUS, mirror_photographs, painted_photographs

CONFIG = MeshConfig(max_light_residual=None, poisson_depth=6)


def surface(depth: float) -> Mesh:
    """Return the ball with dents of this depth."""
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=RADIUS)
    dents = depth * np.clip(np.sin(9 * mesh.vertices).prod(axis=1), 0, 1)
    return Mesh(np.asarray(mesh.vertices * (1 - dents[:, None] / RADIUS)), np.asarray(mesh.faces))


@pytest.mark.parametrize("mirror", [True, False], ids=["mirror", "painted"])
def test_the_surface_that_photographs_speak_for_is_told(mirror: bool) -> None:
    photos = PhotoSet(mirror_photographs(128) if mirror else painted_photographs(128))
    smooth, dented = surface(0), surface(0.06)
    assert photographs_prefer_start(smooth, dented, photos, mirror)
    assert not photographs_prefer_start(dented, smooth, photos, mirror)
    assert not photographs_prefer_start(smooth, smooth, photos, mirror), "training's is taken where both are alike"


@pytest.mark.parametrize(("holes", "torn"), [(0, False), (20, False), (60, True)])
def test_a_surface_full_of_holes_is_torn(holes: int, torn: bool) -> None:
    whole = surface(0)
    apart = np.arange(len(whole.faces)) % 128 == 0  # faces that have no corner in common
    kept = ~(apart & (np.cumsum(apart) <= holes))
    assert (~kept).sum() == holes
    assert is_torn(whole.keep_faces(kept), whole) is torn


def test_a_torn_surface_gives_way_to_the_start(monkeypatch: pytest.MonkeyPatch) -> None:
    views, whole = views_of(ball(RADIUS), cameras_around(12, side=64)), surface(0)
    monkeypatch.setattr(extract, "is_torn", lambda *surfaces: True)
    monkeypatch.setattr(extract, "photographs_prefer_start", lambda *surfaces: False)
    start = whole.moved(0.9 * whole.vertices)
    mesh = extract_mesh(views, CONFIG, PhotoSet(painted_photographs(64)[:3]), start=start)
    assert mesh.start_kept and len(mesh.faces) == len(whole.faces)
    assert abs(np.median(np.linalg.norm(mesh.vertices, axis=1)) - 0.9 * RADIUS) < 0.01


def test_the_rim_of_what_views_see_is_no_tear(monkeypatch: pytest.MonkeyPatch) -> None:
    """Check that the trained surface, which ends where views end, is compared with what views see of the start."""
    above = [camera for camera in cameras_around(40, side=64) if camera.center[2] > 2]
    compared: list[Mesh] = []

    def torn(trained: Mesh, start: Mesh, tears: int) -> bool:
        compared.append(start)
        return len(compared) == 1

    monkeypatch.setattr(extract, "is_torn", torn)
    monkeypatch.setattr(extract, "photographs_prefer_start", lambda *surfaces: False)
    whole = surface(0)
    mesh = extract_mesh(views_of(ball(RADIUS), above), CONFIG, PhotoSet(painted_photographs(64)[:3]), start=whole)
    assert not mesh.start_kept and compared[0] is whole
    # A camera at distance 3 and height 2 sees the ball down to 0.57 of its radius below the centre.
    lowest = compared[1].vertices[compared[1].faces].mean(axis=1)[:, 2].min()
    assert len(above) > 3 and -0.7 * RADIUS < lowest < -0.3 * RADIUS


def test_a_likelier_start_is_what_is_finished(monkeypatch: pytest.MonkeyPatch) -> None:
    views, smaller = views_of(ball(RADIUS), cameras_around(12, side=64)), surface(0.0)
    smaller = smaller.moved(0.9 * smaller.vertices)
    monkeypatch.setattr(extract, "is_torn", lambda *surfaces: False)
    photos = PhotoSet(painted_photographs(64)[:3])
    for kept, radius in ((True, 0.9 * RADIUS), (False, RADIUS)):
        prefer = Mock(return_value=kept)
        monkeypatch.setattr(extract, "photographs_prefer_start", prefer)
        mesh = extract_mesh(views, CONFIG, photos, start=smaller, mirroring=kept)
        assert mesh.start_kept is kept
        assert prefer.call_args.args[3] is kept, "an environment map judges only what mirrors one"
        assert abs(np.median(np.linalg.norm(mesh.vertices, axis=1)) - radius) < 0.01
    assert not extract_mesh(views, CONFIG).start_kept
