"""The fine detail that photographs show of a surface, and how it changes as the surface moves.

Photographs are compared in one mix of their channels: that whose detail is steepest against the residual. Where paint
differs in hue, that is a difference of channels, from which white light's shades vanish.

Under a flash on the camera every photograph has a light of its own; where that is known, what a photograph shows of a
vertex is divided by the light on it. Where the environment map that gloss mirrors is known, so is how much it disturbs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg, ndimage

from mgsr.data.camera import Camera
from mgsr.data.images import srgb_rate
from mgsr.data.scene import View
from mgsr.geometry.displace import diffuse
from mgsr.geometry.mesh import Mesh
from mgsr.parallel import map_ahead
from mgsr.shading.environment_fit import FittedEnvironmentMap
from mgsr.shading.light_models import LightModel
from mgsr.shading.lighting import DIMMEST, GAMMA, Lighting
from mgsr.shading.observations import CLIPPED, SOLID, lie_within, read_image, seen_frontal

BLUR = 1.0  # pixels; of the photographs, against their noise
DETAIL = 3.0  # pixels; of a wider blur, which is taken off: what is coarser is the light's
MIN_COS = 0.3  # of the tilt; what is seen more grazing is left out
MIN_OBSERVATIONS = 4  # photographs that see a vertex, or they tell nothing of it
MAX_DEVIATIONS = 3.0  # of the residual; observations past this do not count for the mix
GREY = np.full(3, 1 / 3)  # the mix of the channels that is their mean
CLEARER = 1.5  # times the grey's; what another mix must tell at least


@dataclass(frozen=True)
class KnownLight:
    """What is known of the light.

    lighting: of a flash on the camera; mirrors: the environment map that gloss mirrors.
    """

    lighting: Lighting | None = None
    mirrors: FittedEnvironmentMap | None = None

    @classmethod
    def known_by(cls, light_model: LightModel | None, mesh: Mesh) -> KnownLight:
        """Return what a light model tells of the light on a mesh."""
        return cls() if light_model is None else cls(light_model.lighting(mesh), light_model.environment(mesh))


@dataclass(frozen=True)
class ObservedMesh:
    """A mesh under refinement; pixel: the size of a photograph's pixel there."""

    mesh: Mesh
    pixel: float

    def around(self, values: np.ndarray, reach: float) -> np.ndarray:
        """Smooth values [V,...] over about `reach` pixels of the surface."""
        return diffuse(values, self.mesh.laplacian, reach * self.pixel / self.mesh.edge_length)

    def detail(self, values: np.ndarray, known: np.ndarray) -> np.ndarray:
        """Return values [N,V] less their mean over DETAIL pixels around, and 0 where they are not known.

        known [V] bool: the vertices that count. All known ones count alike, so that photographs which see the same
        places take the same means.
        """
        around = self.around(np.stack([*(values * known), known], axis=1), DETAIL)
        return np.asarray(known * (values - around[:, :-1].T / np.maximum(around[:, -1], 1e-6)))


@dataclass(frozen=True)
class ChannelMix:
    """A photograph in one mix of its channels.

    image [H,W,3] uint8; mix [3]: the channels' weights; mixed [H,W] float32: the mixed channels, blurred; usable [H,W]
    bool: the pixels that are of use.
    """

    camera: Camera
    image: np.ndarray
    mix: np.ndarray
    mixed: np.ndarray
    usable: np.ndarray

    def slopes(self, pixels: np.ndarray) -> np.ndarray:
        """Return how the mix changes a pixel to the right, and a pixel down, [P,2], at pixel coordinates [P,2]."""
        sides = np.eye(2)
        ahead, behind = ([read_image(self.mixed, pixels + sign * side) for side in sides] for sign in (1, -1))
        return np.stack(ahead, axis=1) / 2 - np.stack(behind, axis=1) / 2

    def rates(self, pixels: np.ndarray) -> np.ndarray:
        """Return how fast the mix rises with white light, [P], at pixel coordinates [P,2]."""
        columns, rows = np.clip(pixels.astype(int), 0, (self.camera.width - 1, self.camera.height - 1)).T
        return np.asarray(srgb_rate(self.image[rows, columns] / 255) @ self.mix)


def mix_channels(views: Sequence[View], mix: np.ndarray, threads: int | None) -> list[ChannelMix]:
    """Mix the channels of the views by weights [3], in sRGB, whose noise is more even than linear light's."""

    def mixed(view: View) -> ChannelMix:
        inside = view.image.max(axis=-1) <= CLIPPED * 255
        if view.alpha is not None:
            inside &= view.alpha >= SOLID * 255
        if view.valid_mask is not None:
            inside &= view.valid_mask
        share = ndimage.gaussian_filter(inside.astype(np.float32), BLUR)
        values = view.image @ (mix / 255).astype(np.float32)
        blurred = ndimage.gaussian_filter(values * inside, BLUR) / np.maximum(share, 1e-6)
        usable = ndimage.binary_erosion(inside, iterations=round(2 * BLUR))
        return ChannelMix(view.camera, view.image, mix, blurred, usable)

    return list(map_ahead(mixed, views, threads))


def choose_mix(surface: ObservedMesh, views: Sequence[View], light: KnownLight, threads: int | None) -> np.ndarray:
    """Find the channel weights [3] whose detail locates the surface best.

    The mix is steepest against the residual: the leading eigenvector of the slopes' covariance against that of the
    residual. Unless it is CLEARER times as informative as the mean of the channels, the latter is returned.
    """
    single = [mix_channels(views, channel, threads) for channel in np.eye(3)]
    channels = [read_details(surface, photographs, light, threads) for photographs in single]
    weights = channels[0].weights
    residual = np.stack([centered(channel.mixed, weights)[weights > 0] for channel in channels])
    change = np.stack([centered(channel.change, weights)[weights > 0] for channel in channels])
    residual_energy = np.abs(GREY @ residual)
    usual = residual_energy <= MAX_DEVIATIONS * 1.4826 * np.median(residual_energy) if weights.any() else []
    weighed = weights[weights > 0] * usual
    noise, steep = ((weighed * part) @ part.T for part in (residual, change))
    noise += (1e-6 * np.trace(noise) + 1e-12) * np.eye(3)
    mix = linalg.eigh(steep, noise)[1][:, -1]
    gain, grey_gain = (axis @ steep @ axis / (axis @ noise @ axis) for axis in (mix, GREY))
    return mix / np.abs(mix).sum() if gain > CLEARER * grey_gain else GREY


@dataclass(frozen=True)
class Details:
    """The detail of V vertices in K photographs, each [V,K] float32.

    mixed: the mix at the vertex less its mean around; change: of `mixed`, for each pixel's size that the vertex moves
    along its normal; mirrored: how much detail gloss mirrors there and around, as normals are only known roughly;
    weights: 0 where the vertex is not seen.
    """

    mixed: np.ndarray
    change: np.ndarray
    mirrored: np.ndarray
    weights: np.ndarray


def read_details(
    surface: ObservedMesh, photographs: Sequence[ChannelMix], light: KnownLight, threads: int | None
) -> Details:
    """Read the detail of the surface's vertices in all photographs."""
    rows = map_ahead(lambda each: _read_one(surface, each, light), photographs, threads)
    details = Details(*(np.stack(columns, axis=1) for columns in zip(*rows, strict=True)))
    details.weights[(details.weights > 0).sum(axis=1) < MIN_OBSERVATIONS] = 0
    return details


def _read_one(surface: ObservedMesh, photograph: ChannelMix, light: KnownLight) -> np.ndarray:
    """Read one photograph's column [4,V] of `Details`, in the order of its fields."""
    camera, places, normals = photograph.camera, surface.mesh.vertices, surface.mesh.double_normals
    samples = sample_view(surface, photograph, light)
    step = 0.1 * surface.pixel * normals[samples.seen]
    moved = 10 * (camera.project(places[samples.seen] + step)[0] - samples.pixels)
    column = np.zeros((4, len(places)), np.float32)
    column[0, samples.seen] = read_image(photograph.mixed, samples.pixels) / samples.lit
    column[1, samples.seen] = (photograph.slopes(samples.pixels) * moved).sum(axis=1) / samples.lit
    column[3, samples.seen] = samples.weights
    column[:2] = surface.detail(column[:2], column[3] > 0)
    if light.mirrors is not None:
        shine = light.mirrors.mirrored(normals, samples.view_directions)
        fine = shine - surface.around(shine, DETAIL)
        fine = np.sqrt(fine**2 + surface.around(fine**2, DETAIL))
        column[2, samples.seen] = fine[samples.seen] * photograph.rates(samples.pixels)
    return column


@dataclass(frozen=True)
class ViewSamples:
    """A surface's vertices in one photograph.

    view_directions [V,3]: unit directions from each vertex to the camera; seen [S]: the vertices that it sees; pixels
    [S,2]: their pixel coordinates; lit [S]: the factor by which a flash on the camera scales their sRGB, 1 without;
    weights [S]: 0 where they are of no use.
    """

    view_directions: np.ndarray
    seen: np.ndarray
    pixels: np.ndarray
    lit: np.ndarray
    weights: np.ndarray


def sample_view(surface: ObservedMesh, photograph: ChannelMix, light: KnownLight) -> ViewSamples:
    """Find where a photograph shows the surface's vertices, and how much each counts."""
    camera, places, normals = photograph.camera, surface.mesh.vertices, surface.mesh.double_normals
    offsets = camera.center - places
    view_directions = offsets / np.linalg.norm(offsets, axis=1, keepdims=True)
    cosines = (view_directions * normals).sum(axis=1)
    seen = seen_frontal(surface.mesh.caster, camera, places, normals, cosines > MIN_COS, surface.pixel)
    pixels, _ = camera.project(places[seen])
    weights, lit = cosines[seen] * lie_within(photograph.usable, pixels), np.ones(len(seen))
    if light.lighting is not None:
        falling = light.lighting.falling_on(camera, places[seen], normals[seen])
        lit = np.maximum(falling, DIMMEST) ** (1 / GAMMA)
        weights *= lit**2 * (falling >= DIMMEST)
    return ViewSamples(view_directions, seen, pixels, lit, weights)


def centered(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return values [V,K] less their mean over the K photographs, by weights [V,K]."""
    total = np.maximum(weights.sum(axis=1, keepdims=True), 1e-9)
    centred: np.ndarray = values - (weights * values).sum(axis=1, keepdims=True) / total
    return centred
