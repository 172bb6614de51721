"""The fit of gloss, against photographs that are computed with GGX by sampling microfacets."""

from __future__ import annotations

import numpy as np
import pytest

from mgsr.config.expert import GlossOptions
from mgsr.shading.gloss import Mirrorings, fit_gloss, ggx_lobes, mirrored_share
from mgsr.shading.material import MATTE

HEIGHT = GlossOptions().height
POINTS, SEEN, FACETS = 1200, 12, 96
LAMPS = ((0.3, 0.8, 0.5), (-0.7, -0.2, 0.6), (0.5, -0.8, -0.1), (-0.4, 0.6, -0.6), (0.1, 0.1, 1.0))


def environment(directions: np.ndarray) -> np.ndarray:
    """Return the gray light [...] of a dim room with lamps of 8 degrees and a window."""
    lamps = np.array(LAMPS) / np.linalg.norm(LAMPS, axis=1, keepdims=True)
    lit = (directions @ lamps.T > np.cos(np.radians(8))).sum(axis=-1)
    window = (directions[..., 0] > 0.75) & (np.abs(directions[..., 2]) < 0.3)
    return np.asarray(0.1 + 0.6 * lit + 0.4 * window)


def blurred(mirrored: np.ndarray, roughness: float, random: np.random.Generator) -> np.ndarray:
    """Return the light [Q] that rough mirrors, seen head-on, send along `mirrored` [Q,3], by sampled microfacets."""
    total, weight = np.zeros(len(mirrored)), np.zeros(len(mirrored))
    helper = np.where(np.abs(mirrored[:, 2:]) < 0.9, [[0, 0, 1.0]], [[1.0, 0, 0]])
    first = np.cross(helper, mirrored)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(mirrored, first)
    for _ in range(FACETS):
        chance, turn = random.random((2, len(mirrored)))
        tilt = np.arctan(roughness**2 * np.sqrt(chance / (1 - chance)))[:, None]
        turn = 2 * np.pi * turn[:, None]
        facet = np.sin(tilt) * (np.cos(turn) * first + np.sin(turn) * second) + np.cos(tilt) * mirrored
        towards = 2 * (facet * mirrored).sum(axis=1, keepdims=True) * facet - mirrored
        cosine = np.maximum((towards * mirrored).sum(axis=1), 0)
        total += cosine * environment(towards)
        weight += cosine
    return np.asarray(total / weight)


def photographed(roughness: float, metallic: bool, tint: np.ndarray, gloss: float = 1.0) -> Mirrorings:
    """Return observations of points with matte parts of their own, unless they are of metal."""
    random = np.random.default_rng(3)
    owners = np.repeat(np.arange(POINTS), SEEN)
    mirrored = random.normal(size=(len(owners), 3))
    mirrored /= np.linalg.norm(mirrored, axis=1, keepdims=True)
    cosines = random.uniform(0.35, 1, len(owners))
    fresnel = 1.0 if metallic else 0.04 + 0.96 * (1 - cosines) ** 5
    light = gloss * fresnel * blurred(mirrored, roughness, random)
    if not metallic:
        light = 8 * light  # lamps are bright beside what a matte surface sends out
    matte = 0.0 if metallic else random.uniform(0.05, 0.5, (POINTS, 3))[owners]
    colors = np.clip(light[:, None] * tint + matte + random.normal(0, 0.004, (len(owners), 3)), 0, 1)
    training = np.tile(np.arange(SEEN) % 4 != 3, POINTS)
    return Mirrorings(owners, mirrored, cosines, colors.astype(np.float32), cosines, training)


def angles() -> tuple[np.ndarray, np.ndarray]:
    """Return the polar angles [HEIGHT] and the azimuths [2 HEIGHT] of a map's cells."""
    return (np.arange(HEIGHT) + 0.5) / HEIGHT * np.pi, (np.arange(2 * HEIGHT) + 0.5) / HEIGHT * np.pi


def direction(cells: np.ndarray) -> np.ndarray:
    """Return the unit directions [N,3] of polar angles and azimuths [N,2]."""
    polar, azimuth = cells.T
    return np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], axis=-1)


def test_a_rough_coat_is_told() -> None:
    material = fit_gloss(photographed(0.3, False, np.ones(3)))
    assert material.metallic == 0 and material.tint is None
    assert material.roughness == pytest.approx(0.3, abs=0.1)
    assert material.roughness_range is not None and material.roughness_range[0] <= 0.3
    assert material.light is not None and material.light.shape == (HEIGHT, 2 * HEIGHT, 3)
    around = np.random.default_rng(0).normal(size=(20_000, 3))
    mean = 8 * environment(around / np.linalg.norm(around, axis=1, keepdims=True)).mean()
    areas = np.sin((np.arange(HEIGHT) + 0.5) / HEIGHT * np.pi)[:, None, None]
    found = (material.light * areas).mean() / areas.mean()
    cells = np.stack(np.meshgrid(*angles(), indexing="ij"), axis=-1).reshape(-1, 2)
    shape = np.corrcoef(material.light.mean(axis=-1).ravel(), environment(direction(cells)))[0, 1]
    assert shape > 0.8
    # The scale follows from the reflectance. Schlick's term, which made the observations, is stronger at grazing angles
    # than that of a rough surface.
    assert found == pytest.approx(mean, rel=0.5)


def test_options_reach_the_fit() -> None:
    seen = photographed(0.3, False, np.ones(3))
    assert fit_gloss(seen, GlossOptions(matte_deviation=0.0)) is MATTE
    coarse = fit_gloss(seen, GlossOptions(height=8, worse=1.0))
    assert coarse.light is not None and coarse.light.shape == (8, 16, 3)


def test_a_metal_has_its_tint() -> None:
    tint = np.array([0.9, 0.6, 0.35])
    material = fit_gloss(photographed(0.4, True, tint))
    assert material.metallic == 1 and material.tint is not None
    assert material.roughness == pytest.approx(0.4, abs=0.1)
    np.testing.assert_allclose(material.tint / material.tint.max(), tint / tint.max(), atol=0.03)


def test_a_matte_surface_is_matte() -> None:
    assert fit_gloss(photographed(0.3, False, np.ones(3), gloss=0.0)) is MATTE


def test_a_surface_that_no_photograph_shows_is_matte() -> None:
    nothing = np.zeros(0)
    unseen = Mirrorings(nothing.astype(int), np.zeros((0, 3)), nothing, np.zeros((0, 3)), nothing, nothing > 0)
    assert fit_gloss(unseen) is MATTE


def test_lobes_blur_as_microfacets_do() -> None:
    lobes = ggx_lobes(0.5)
    cells = direction(np.stack(np.meshgrid(*angles(), indexing="ij"), axis=-1).reshape(-1, 2))
    some = np.random.default_rng(0).choice(len(cells), 200, replace=False)
    truth = blurred(cells[some], 0.5, np.random.default_rng(1))
    assert np.abs((lobes @ environment(cells))[some] - truth).mean() < 0.02


def test_smooth_surfaces_follow_schlick() -> None:
    cosines = np.linspace(0.2, 1, 9)
    for reflectance in (0.04, 0.8):
        schlick = reflectance + (1 - reflectance) * (1 - cosines) ** 5
        np.testing.assert_allclose(mirrored_share(cosines, 0.05, reflectance), schlick, atol=0.06)
