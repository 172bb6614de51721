"""The fit of gloss, against photographs that are computed by sampling microfacets (Walter et al., 2007)."""

from __future__ import annotations

import numpy as np
import pytest

from mgsr.config.expert import GlossOptions
from mgsr.shading.gloss import GgxLobe, Mirrorings, fit_gloss, mirrored_share
from mgsr.shading.material import MATTE

HEIGHT = GlossOptions().height
POINTS, SEEN, FACETS = 1200, 12, 96
LAMPS_TO_MATTE = 8  # how bright the lamps are beside what a matte surface sends out
LAMPS = ((0.3, 0.8, 0.5), (-0.7, -0.2, 0.6), (0.5, -0.8, -0.1), (-0.4, 0.6, -0.6), (0.1, 0.1, 1.0))


def environment(directions: np.ndarray) -> np.ndarray:
    """Return the gray light [...] of a dim room with lamps of 8 degrees and a window."""
    lamps = np.array(LAMPS) / np.linalg.norm(LAMPS, axis=1, keepdims=True)
    lit = (directions @ lamps.T > np.cos(np.radians(8))).sum(axis=-1)
    window = (directions[..., 0] > 0.75) & (np.abs(directions[..., 2]) < 0.3)
    return np.asarray(0.1 + 0.6 * lit + 0.4 * window)


def basis(axes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return two unit directions [Q,3] that make a frame with unit axes [Q,3]."""
    helper = np.where(np.abs(axes[:, 2:]) < 0.9, [[0, 0, 1.0]], [[1.0, 0, 0]])
    first = np.cross(helper, axes)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return first, np.cross(axes, first)


def facets(normals: np.ndarray, roughness: float, random: np.random.Generator) -> np.ndarray:
    """Draw the normals [Q,3] of microfacets of surfaces with normals [Q,3], by their projected area."""
    first, second = basis(normals)
    chance, turn = random.random((2, len(normals)))
    tilt = np.arctan(roughness**2 * np.sqrt(chance / (1 - chance)))[:, None]
    turn = 2 * np.pi * turn[:, None]
    return np.asarray(np.sin(tilt) * (np.cos(turn) * first + np.sin(turn) * second) + np.cos(tilt) * normals)


def dot(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return np.asarray((first * second).sum(axis=1))


def reflected(
    normals: np.ndarray, eyes: np.ndarray, roughness: float, reflectance: float, random: np.random.Generator
) -> np.ndarray:
    """Return the light [Q] that rough surfaces with normals [Q,3] reflect to unit directions `eyes` [Q,3].

    reflectance: at normal incidence, in Schlick's term. Facets hide each other by Smith's term.
    """

    def shown(towards: np.ndarray) -> np.ndarray:
        cosine = np.clip(dot(normals, towards), 1e-6, 1)
        return np.asarray(2 / (1 + np.sqrt(1 + roughness**4 * (1 / cosine**2 - 1))))

    total = np.zeros(len(normals))
    for _ in range(FACETS):
        facet = facets(normals, roughness, random)
        met = dot(eyes, facet)
        towards = 2 * met[:, None] * facet - eyes
        above = (met > 0) & (dot(normals, towards) > 0)
        fresnel = reflectance + (1 - reflectance) * (1 - np.clip(met, 0, 1)) ** 5
        weight = fresnel * shown(eyes) * shown(towards) * met / (dot(normals, eyes) * dot(normals, facet))
        total += np.where(above, weight * environment(towards), 0)
    return total / FACETS


def blurred(mirrored: np.ndarray, roughness: float, random: np.random.Generator) -> np.ndarray:
    """Return the light [Q] that rough mirrors, seen head-on, send along `mirrored` [Q,3], by sampled microfacets."""
    total, weight = np.zeros(len(mirrored)), np.zeros(len(mirrored))
    for _ in range(FACETS):
        facet = facets(mirrored, roughness, random)
        towards = 2 * (facet * mirrored).sum(axis=1, keepdims=True) * facet - mirrored
        cosine = np.maximum((towards * mirrored).sum(axis=1), 0)
        total += cosine * environment(towards)
        weight += cosine
    return np.asarray(total / weight)


def photographed(
    roughness: float, metallic: bool, tint: np.ndarray, gloss: float = 1.0, albedo: float = 0.5
) -> Mirrorings:
    """Return observations of points with matte parts of their own, unless they are of metal.

    albedo: the largest of the matte parts.
    """
    random = np.random.default_rng(3)
    owners = np.repeat(np.arange(POINTS), SEEN)
    normals = random.normal(size=(POINTS, 3))
    normals = (normals / np.linalg.norm(normals, axis=1, keepdims=True))[owners]
    cosines, turn = random.uniform(0.35, 1, len(owners)), random.uniform(0, 2 * np.pi, len(owners))[:, None]
    first, second = basis(normals)
    flat = np.sqrt(1 - cosines**2)[:, None]
    eyes = cosines[:, None] * normals + flat * (np.cos(turn) * first + np.sin(turn) * second)
    light = gloss * reflected(normals, eyes, roughness, 1.0 if metallic else 0.04, random)
    if not metallic:
        light = LAMPS_TO_MATTE * light
    matte = 0.0 if metallic else random.uniform(0.1 * albedo, albedo, (POINTS, 3))[owners]
    colors = np.clip(light[:, None] * tint + matte + random.normal(0, 0.004, (len(owners), 3)), 0, 1)
    training = np.tile(np.arange(SEEN) % 4 != 3, POINTS)
    mirrored = 2 * cosines[:, None] * normals - eyes
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
    mean = LAMPS_TO_MATTE * environment(around / np.linalg.norm(around, axis=1, keepdims=True)).mean()
    areas = np.sin((np.arange(HEIGHT) + 0.5) / HEIGHT * np.pi)[:, None, None]
    found = (material.light * areas).mean() / areas.mean()
    cells = np.stack(np.meshgrid(*angles(), indexing="ij"), axis=-1).reshape(-1, 2)
    shape = np.corrcoef(material.light.mean(axis=-1).ravel(), environment(direction(cells)))[0, 1]
    assert shape > 0.8
    assert found == pytest.approx(mean, rel=0.15)  # the scale follows from the reflectance
    brightness = material.mean_light()
    assert brightness is not None and brightness.mean() == pytest.approx(found, rel=0.05)


def test_options_reach_the_fit() -> None:
    seen = photographed(0.3, False, np.ones(3))
    assert fit_gloss(seen, GlossOptions(matte_deviation=0.0)) is MATTE
    coarse = fit_gloss(seen, GlossOptions(height=8, worse=1.0))
    assert coarse.light is not None and coarse.light.shape == (8, 16, 3)


@pytest.mark.slow
def test_a_black_dielectric_is_no_metal() -> None:
    material = fit_gloss(photographed(0.3, False, np.ones(3), albedo=0.01))
    assert material.metallic == 0 and material.tint is None
    assert material.roughness == pytest.approx(0.3, abs=0.1)


@pytest.mark.slow
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
    lobe = GgxLobe(0.5, HEIGHT)
    cells = direction(np.stack(np.meshgrid(*angles(), indexing="ij"), axis=-1).reshape(-1, 2))
    some = np.random.default_rng(0).choice(len(cells), 200, replace=False)
    truth = blurred(cells[some], 0.5, np.random.default_rng(1))
    assert np.abs(lobe.blur(environment(cells))[some] - truth).mean() < 0.02


@pytest.mark.parametrize("reflectance", [0.04, 0.8])
def test_mirrored_shares_are_those_of_microfacets(reflectance: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.shading.test_gloss.environment", lambda towards: np.ones(len(towards)))
    normals = np.tile([0, 0, 1.0], (2000, 1))
    for roughness in (0.2, 0.5):
        for cosine in (0.35, 0.6, 0.95):
            eyes = np.tile([np.sqrt(1 - cosine**2), 0, cosine], (len(normals), 1))
            truth = reflected(normals, eyes, roughness, reflectance, np.random.default_rng(2)).mean()
            assert mirrored_share(np.array(cosine), roughness, reflectance) == pytest.approx(truth, rel=0.03)


def test_smooth_surfaces_follow_schlick() -> None:
    cosines = np.linspace(0.2, 1, 9)
    for reflectance in (0.04, 0.8):
        schlick = reflectance + (1 - reflectance) * (1 - cosines) ** 5
        np.testing.assert_allclose(mirrored_share(cosines, 0.05, reflectance), schlick, atol=0.06)
