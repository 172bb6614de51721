"""The fine detail of a surface in photographs, and its derivative with respect to displacements of the surface.

Photographs are compared in one mix of their channels: the mix with the steepest detail relative to the residual. If the
paint varies in hue, this mix is a difference of channels, which cancels the shading of white light.

A flash lights every photograph differently. If its light is known, brightness is divided by the irradiance. If the
environment map is known, so is the mirrored detail. Observations weigh less where mirrored detail is strong.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg, ndimage

from mgsr.config.expert import DetailOptions
from mgsr.data.images import srgb_rate
from mgsr.data.photograph import Photograph
from mgsr.data.robust import robust_deviation
from mgsr.geometry.displace import diffuse
from mgsr.geometry.mesh import Mesh
from mgsr.geometry.vectors import dots, lengths
from mgsr.parallel import map_ahead
from mgsr.shading.environment_fit import FittedEnvironmentMap
from mgsr.shading.light_models import LightModel
from mgsr.shading.lighting import GAMMA, Lighting
from mgsr.shading.observations import lie_within, sample_image, seen_frontal

GREY = np.full(3, 1 / 3)  # the mean of the channels
TOGETHER = 8  # photographs whose detail is smoothed together
DIFFERENCE = 0.1  # pixels; the displacement for derivatives by finite differences


@dataclass(frozen=True)
class KnownLight:
    """The known light.

    lighting: of a flash on the camera. mirrors: the environment map that the surface mirrors. Each is None if unknown.
    """

    lighting: Lighting | None = None
    mirrors: FittedEnvironmentMap | None = None

    @classmethod
    def known_by(cls, light_model: LightModel | None, mesh: Mesh) -> KnownLight:
        """Return the light on a mesh according to a light model, if there is one."""
        return cls() if light_model is None else cls(light_model.lighting(mesh), light_model.environment(mesh))


@dataclass(frozen=True)
class ObservedMesh:
    """A mesh under refinement.

    pixel: the size of a photograph's pixel on it, in the scene's unit. options: of the detail.
    """

    mesh: Mesh
    pixel: float
    options: DetailOptions = DetailOptions()

    def around(self, values: np.ndarray, reach: float) -> np.ndarray:
        """Smooth values [V,...] over about `reach` pixels of the surface."""
        return diffuse(values, self.mesh.laplacian, reach * self.pixel / self.mesh.edge_length)

    def detail(self, values: np.ndarray, known: np.ndarray) -> np.ndarray:
        """Return values [N,V,G] of G photographs minus their mean over some pixels around, and 0 at unknown vertices.

        known [V,G] bool: the vertices that count, all with the same weight, so that photographs of the same vertices
        subtract the same means.
        """
        around = self.around(np.stack([*(values * known), known.astype(np.float32)], axis=1), self.options.coarse)
        return np.asarray(known * (values - around[:, :-1].swapaxes(0, 1) / np.maximum(around[:, -1], 1e-6)))


@dataclass(frozen=True)
class ChannelMix:
    """One mix of a photograph's channels.

    mix [3]: the channels' weights. mixed [H,W]: float32, the mix of the blurred channels, in sRGB 0..1. usable [H,W]
    bool: the pixels that show the object alone and are not clipped.
    """

    photograph: Photograph
    mix: np.ndarray
    mixed: np.ndarray
    usable: np.ndarray

    def slopes(self, pixels: np.ndarray) -> np.ndarray:
        """Return the mix's gradient [P,2], to the right and down, per pixel, at pixel coordinates [P,2]."""
        sides = np.eye(2)
        ahead, behind = ([sample_image(self.mixed, pixels + sign * side) for side in sides] for sign in (1, -1))
        return np.stack(ahead, axis=1) / 2 - np.stack(behind, axis=1) / 2

    def rates(self, pixels: np.ndarray) -> np.ndarray:
        """Return the derivative [P] of the mix by white linear light at pixel coordinates [P,2]."""
        camera = self.photograph.camera
        columns, rows = np.clip(pixels.astype(int), 0, (camera.width - 1, camera.height - 1)).T
        return np.asarray(srgb_rate(self.photograph.view.image[rows, columns] / 255) @ self.mix)


def mix_channels(
    photographs: Sequence[Photograph],
    mix: np.ndarray,
    threads: int | None,
    options: DetailOptions = DetailOptions(),
) -> list[ChannelMix]:
    """Mix the channels of photographs by weights [3], in sRGB, whose noise is more uniform than linear light's."""

    def mixed(photograph: Photograph) -> ChannelMix:
        inside = photograph.opaque
        share = ndimage.gaussian_filter(inside.astype(np.float32), options.blur)
        values = photograph.view.image @ (mix / 255).astype(np.float32)
        blurred = ndimage.gaussian_filter(values * inside, options.blur) / np.maximum(share, 1e-6)
        usable = ndimage.binary_erosion(inside, iterations=round(2 * options.blur))
        return ChannelMix(photograph, mix, blurred, usable)

    return list(map_ahead(mixed, photographs, threads))


def choose_mix(
    surface: ObservedMesh, photographs: Sequence[Photograph], light: KnownLight, threads: int | None
) -> np.ndarray:
    """Find the channel weights [3] whose detail locates the surface best.

    The mix maximises the ratio of slope to residual: it is the leading generalised eigenvector of the covariances of
    the slopes and of the residuals. The result is GREY unless the mix is `min_gain` times as informative.
    """
    options = surface.options
    single = [mix_channels(photographs, channel, threads, options) for channel in np.eye(3)]
    channels = [read_details(surface, mixes, light, threads) for mixes in single]
    weights = channels[0].weights
    residual = np.stack([centered(channel.mixed, weights)[weights > 0] for channel in channels])
    change = np.stack([centered(channel.change, weights)[weights > 0] for channel in channels])
    residual_energy = np.abs(GREY @ residual)
    usual = residual_energy <= options.max_deviations * robust_deviation(residual_energy) if weights.any() else []
    weighed = weights[weights > 0] * usual
    noise, steep = ((weighed * part) @ part.T for part in (residual, change))
    noise += (1e-6 * np.trace(noise) + 1e-12) * np.eye(3)
    mix = linalg.eigh(steep, noise)[1][:, -1]
    gain, grey_gain = (axis @ steep @ axis / (axis @ noise @ axis) for axis in (mix, GREY))
    return mix / np.abs(mix).sum() if gain > options.min_gain * grey_gain else GREY


@dataclass(frozen=True)
class Details:
    """The detail of V vertices in K photographs, each [V,K] float32.

    mixed: the mix at the vertex minus its mean around the vertex.
    change: the derivative of `mixed` by displacements of the vertex along its normal, in pixels.
    mirrored: the mirrored detail at the vertex and around it, because normals are inaccurate.
    weights: the weight of the observation, 0 where the vertex is not visible.
    """

    mixed: np.ndarray
    change: np.ndarray
    mirrored: np.ndarray
    weights: np.ndarray

    def after(self, move: np.ndarray) -> Details:
        """Return the details after small displacements [V] of the vertices along their normals, in pixels."""
        return replace(self, mixed=self.mixed + self.change * move[:, None].astype(np.float32))


def read_details(surface: ObservedMesh, mixes: Sequence[ChannelMix], light: KnownLight, threads: int | None) -> Details:
    """Sample the detail of the surface's vertices in all photographs."""
    groups = [mixes[start : start + TOGETHER] for start in range(0, len(mixes), TOGETHER)]
    parts = map_ahead(lambda group: _read_some(surface, group, light), groups, threads)
    details = Details(*np.concatenate(list(parts), axis=2))
    details.weights[(details.weights > 0).sum(axis=1) < surface.options.min_observations] = 0
    return details


def _read_some(surface: ObservedMesh, mixes: Sequence[ChannelMix], light: KnownLight) -> np.ndarray:
    """Sample G photographs: return their columns [4,V,G] of `Details`, in the order of the fields."""
    places, normals = surface.mesh.vertices, surface.mesh.double_normals
    columns, shine = np.zeros((4, len(places), len(mixes)), np.float32), np.zeros((len(places), len(mixes)), np.float32)
    rates = np.zeros_like(shine)
    for number, mix in enumerate(mixes):
        samples = sample_view(surface, mix, light)
        seen, step = samples.seen, DIFFERENCE * surface.pixel * normals[samples.seen]
        moved = 1 / DIFFERENCE * (mix.photograph.camera.project(places[seen] + step)[0] - samples.pixels)
        columns[0, seen, number] = sample_image(mix.mixed, samples.pixels) / samples.irradiance_factor
        columns[1, seen, number] = dots(mix.slopes(samples.pixels), moved) / samples.irradiance_factor
        columns[3, seen, number] = samples.weights
        if light.mirrors is not None:
            shine[:, number] = light.mirrors.mirrored(normals, samples.view_directions)
            rates[seen, number] = mix.rates(samples.pixels)
    columns[:2] = surface.detail(columns[:2], columns[3] > 0)
    if light.mirrors is not None:
        fine = shine - surface.around(shine, surface.options.coarse)
        columns[2] = rates * np.sqrt(fine**2 + surface.around(fine**2, surface.options.coarse))
    return columns


@dataclass(frozen=True)
class ViewSamples:
    """A surface's vertices in one photograph.

    view_directions [V,3]: unit directions from each vertex to the camera. seen [S]: the indices of the visible
    vertices. pixels [S,2]: their pixel coordinates. irradiance_factor [S]: the factor by which a flash scales their
    sRGB values, 1 without a flash. weights [S]: 0 where a vertex is unusable.
    """

    view_directions: np.ndarray
    seen: np.ndarray
    pixels: np.ndarray
    irradiance_factor: np.ndarray
    weights: np.ndarray


def sample_view(surface: ObservedMesh, mix: ChannelMix, light: KnownLight) -> ViewSamples:
    """Find the vertices that a photograph shows, their pixels and their weights."""
    camera, places, normals = mix.photograph.camera, surface.mesh.vertices, surface.mesh.double_normals
    offsets = camera.center - places
    view_directions = offsets / lengths(offsets)[:, None]
    cosines = dots(view_directions, normals)
    seen = seen_frontal(
        surface.mesh.caster, camera, places, normals, cosines > surface.options.min_cosine, surface.pixel
    )
    pixels, _ = camera.project(places[seen])
    weights, irradiance_factor = cosines[seen] * lie_within(mix.usable, pixels), np.ones(len(seen))
    if light.lighting is not None:
        falling = light.lighting.falling_on(camera, places[seen], normals[seen])
        dimmest = light.lighting.options.dimmest
        irradiance_factor = np.maximum(falling, dimmest) ** (1 / GAMMA)
        weights *= irradiance_factor**2 * (falling >= dimmest)
    return ViewSamples(view_directions, seen, pixels, irradiance_factor, weights)


def centered(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return values [V,K] minus their mean over the K photographs, weighted by weights [V,K]."""
    total = np.maximum(weights.sum(axis=1, keepdims=True), 1e-9)
    centred: np.ndarray = values - (weights * values).sum(axis=1, keepdims=True) / total
    return centred
