"""Concavities that no silhouette shows: the hull is carved further, to where the photographs agree on the colour.

Around each vertex a small patch is looked at in the views that see it, once for each depth along the normal; at the
true depth the views show the same pattern (Furukawa and Ponce 2010 measure it alike). Only what matte paint does
counts: colours are made linear and white is projected out of them, so that highlights of white lamps, which seem to
lie behind a surface, vanish (the dichromatic model, Shafer 1985), and of each patch the mean and the slope are
taken off, so that a flash's falloff and smooth shading vanish too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as functional
from torch import Tensor

from mgsr.data.camera import Camera, pixel_size
from mgsr.data.images import reduce_area, srgb_to_linear
from mgsr.data.known import filled, known_mean
from mgsr.data.scene import View
from mgsr.geometry.displace import edge_length, mean_normals, smooth_displacements, spread, umbrella
from mgsr.geometry.raycast import RayCaster
from mgsr.geometry.triangles import tangents, vertex_normals
from mgsr.parallel import map_ahead, one_torch_thread

MAX_SIDE = 400  # images are reduced to this side
OFFSETS = np.arange(-8.0, 1.5)  # pixels along the outward normal
NEAR = 1.1  # offsets up to this are "the surface is where the hull is"
PATCH_SIDE, PATCH_STEP = 5, 1.6  # samples a side of a patch, and the pixels between them
VIEWS = 10  # the most frontal views of a vertex that are compared; at least 3
MIN_COS = 0.25  # of the angle between a vertex normal and the direction to a view that is compared
POOL = 4.0  # pixels over which neighbouring patches are averaged
GAIN = 0.03  # correlation by which a deeper place must beat the hull's; without a concavity noise rarely reaches it
STAY = 0.2  # how much the rest of the surface holds against being pulled along
SPREAD = 1.2  # edges over which a displacement spreads
CHUNK = 1000  # vertices at a time, so that their patches stay in the cache
SOLID = 0.9  # pixels with less alpha mix object and background
MIN_NOISE = 1e-3  # linear light: rounding to 8 bits

_SIDE = (np.arange(PATCH_SIDE) - (PATCH_SIDE - 1) / 2) * PATCH_STEP
_GRID = np.stack(np.meshgrid(_SIDE, _SIDE, indexing="ij"), axis=-1).reshape(-1, 2)  # a patch's points [P,2] in pixels
_SLOPES = torch.from_numpy(_GRID / np.linalg.norm(_GRID, axis=0)).float()  # two slopes [P,2] over them, orthonormal
# From a patch's middle and the two steps along its sides [6] to all its points, x and y in turn [2P].
_SPREAD_OUT = torch.from_numpy(np.kron(np.column_stack([np.ones(len(_GRID)), _GRID]).T, np.eye(2))).float()


def carve_by_color(
    vertices: np.ndarray,
    faces: np.ndarray,
    views: Sequence[View],
    progress: Callable[[float], None] = lambda done: None,
) -> np.ndarray:
    """The vertices [V,3] of a hull, those moved inwards that the photographs show deeper.

    A surface without colour pattern stays as it is. progress: told of the share of the vertices that are done.
    """
    looks = [_look(view) for view in views]
    noise = max(float(np.median([look.noise for look in looks])), MIN_NOISE)
    laplacian = umbrella(faces, len(vertices))
    normals = mean_normals(vertex_normals(vertices, faces), laplacian, rounds=3)
    pixel = pixel_size([look.camera for look in looks], vertices.mean(axis=0))
    chosen = _frontal_views(RayCaster(vertices, faces), vertices, normals, looks, gap=pixel)
    agreement = _agreement(vertices, normals, looks, chosen, pixel, noise, progress)
    wanted, sure = _deeper(spread(agreement, laplacian, POOL * pixel / edge_length(vertices, faces)))
    moves = smooth_displacements(laplacian, np.where(sure, wanted * pixel, 0), np.where(sure, 1, STAY), SPREAD)
    return vertices + np.clip(moves, OFFSETS[0] * pixel, 0)[:, None] * normals


@dataclass(frozen=True)
class _Look:
    """A view as it is compared: image [3,h,w], two colour channels without white, in linear light, and where the pixel
    is solid object (0 or 1); noise: their noise; known [h,w] bool: the pixels that the photograph shows, None for
    all."""

    camera: Camera
    image: Tensor
    noise: float
    known: np.ndarray | None


def _look(view: View) -> _Look:
    camera, image, known = view.camera, view.image, view.known
    solid = np.full(image.shape[:2], 255, np.uint8) if view.alpha is None else view.alpha
    shrink = MAX_SIDE / max(camera.width, camera.height)
    if shrink < 1:
        camera = camera.resized(max(1, round(camera.width * shrink)), max(1, round(camera.height * shrink)))
        image, known = known_mean(image.astype(np.float32), view.known, lambda pixels: _reduced(pixels, camera))
        solid = known_mean(solid.astype(np.float32)[..., None], view.known, lambda pixels: _reduced(pixels, camera))[0]
        solid = solid[..., 0]
    red, green, blue = np.moveaxis(srgb_to_linear(filled(image, known).astype(np.float32) / 255), -1, 0)
    channels = np.stack([(red - green) / 2**0.5, (red + green - 2 * blue) / 6**0.5])
    inside = solid > SOLID * 255 if known is None else (solid > SOLID * 255) & known
    packed = np.concatenate([channels, inside[None]]).astype(np.float32)
    return _Look(camera, torch.from_numpy(packed), _noise(channels, inside), known)


def _reduced(pixels: np.ndarray, camera: Camera) -> np.ndarray:
    return reduce_area(pixels, camera.width, camera.height)


def _noise(channels: np.ndarray, inside: np.ndarray) -> float:
    """The standard deviation of the pixels' noise, over both channels, from the median second difference."""
    middle = channels[:, 1:-1, 1:-1]
    around = channels[:, :-2, 1:-1] + channels[:, 2:, 1:-1] + channels[:, 1:-1, :-2] + channels[:, 1:-1, 2:]
    rough = np.abs(4 * middle - around)[:, inside[1:-1, 1:-1]]
    if rough.shape[1] == 0:
        return 0.0
    deviations = np.median(rough, axis=1) / 0.6745 / 20**0.5  # 20: the second difference's sum of squares
    return float(np.linalg.norm(deviations))


def _frontal_views(
    caster: RayCaster, vertices: np.ndarray, normals: np.ndarray, looks: Sequence[_Look], gap: float
) -> np.ndarray:
    """Which views [L,V] bool are compared at each vertex."""
    cosines = np.full((len(looks), len(vertices)), -1.0)
    for row, look in zip(cosines, looks, strict=True):
        towards = look.camera.center - vertices
        facing = (towards * normals).sum(1) / np.linalg.norm(towards, axis=1)
        index = np.flatnonzero(facing > MIN_COS)
        index = index[caster.sees(look.camera, vertices[index] + normals[index] * gap, gap, look.known)]
        row[index] = facing[index]
    if len(looks) > VIEWS:
        cosines[cosines < np.sort(cosines, axis=0)[-VIEWS]] = -1
    return cosines > 0


def _agreement(
    vertices: np.ndarray,
    normals: np.ndarray,
    looks: Sequence[_Look],
    chosen: np.ndarray,
    pixel: float,
    noise: float,
    progress: Callable[[float], None],
) -> np.ndarray:
    """The mean correlation [V,D] of the patches in the chosen views, for each of the OFFSETS; 0 with under 3 views.

    A patch counts by its contrast against the noise, so that flat patches correlate with nothing.
    """
    patches = _Patches.at(vertices, normals, pixel)
    parts = np.array_split(np.arange(len(vertices)), -(-len(vertices) // CHUNK))
    agreements = []
    with one_torch_thread():
        for part in map_ahead(lambda at: _part(patches.some(at), looks, chosen[:, at], noise), parts, None):
            agreements.append(part)
            progress(len(agreements) / len(parts))
    return np.concatenate(agreements)


def _part(patches: _Patches, looks: Sequence[_Look], chosen: np.ndarray, noise: float) -> np.ndarray:
    views, count = torch.from_numpy(chosen), chosen.shape[1]
    sums, squares = torch.zeros(count, len(OFFSETS), 2, len(_GRID)), torch.zeros(count, len(OFFSETS))
    for look, at in zip(looks, views, strict=True):
        index = at.nonzero()[:, 0]
        features = _normalised(_sample(look, patches.some(index)), noise)
        sums[index] += features
        squares[index] += features.square().sum((2, 3))
    seen = views.sum(dim=0)
    pairs = (seen * (seen - 1)).clamp(min=1)[:, None]
    return torch.where(seen[:, None] >= 3, (sums.square().sum((2, 3)) - squares) / pairs, 0.0).numpy()


@dataclass(frozen=True)
class _Patches:
    """Where the patches lie: their centres [V,3] at offset 0, and the steps [V,3] of a pixel along the normal and along
    the patch's two sides."""

    centers: Tensor
    outwards: Tensor
    across: Tensor
    along: Tensor

    @classmethod
    def at(cls, vertices: np.ndarray, normals: np.ndarray, pixel: float) -> _Patches:
        across, along = tangents(normals)
        return cls(*(torch.from_numpy(a).float() for a in (vertices, normals * pixel, across * pixel, along * pixel)))

    def some(self, index: Tensor | np.ndarray) -> _Patches:
        return _Patches(self.centers[index], self.outwards[index], self.across[index], self.along[index])


def _sample(look: _Look, patches: _Patches) -> Tensor:
    """The image's values [3,Q,D,P] at the patches' points, at each of the OFFSETS.

    A patch is so small that perspective is linear over it.
    """
    camera = look.camera
    pose = torch.from_numpy(camera.cam_from_world).float()
    scale = torch.tensor([camera.K[0, 0] / camera.width, camera.K[1, 1] / camera.height]).float() * 2
    shift = torch.tensor([camera.K[0, 2] / camera.width, camera.K[1, 2] / camera.height]).float() * 2 - 1
    offsets = torch.from_numpy(OFFSETS).float()[:, None]
    turned = [step @ pose[:3, :3].T for step in (patches.centers, patches.outwards, patches.across, patches.along)]
    local = (turned[0] + pose[:3, 3])[:, None] + offsets * turned[1][:, None]
    depths = local[..., 2:].clamp(min=1e-6)  # [Q,D,1]
    rays = local[..., :2] / depths
    slopes = [(side[:, None, :2] - rays * side[:, None, 2:]) / depths * scale for side in turned[2:]]
    affine = torch.cat([rays * scale + shift, *slopes], dim=-1)  # [Q,D,6]
    places = (affine.reshape(-1, 6) @ _SPREAD_OUT).reshape(1, 1, -1, 2)
    values = functional.grid_sample(look.image[None], places, padding_mode="border", align_corners=False)
    return values.reshape(3, *depths.shape[:2], len(_GRID))


def _normalised(values: Tensor, noise: float) -> Tensor:
    """Patches [Q,D,2,P] without mean and slope, as long as their contrast is above the noise, at most 1."""
    channels, solid = values[:2], (values[2:] > SOLID).float()
    mean = (channels * solid).sum(-1, keepdim=True) / solid.sum(-1, keepdim=True).clamp(min=1)
    left = (channels - mean) * solid
    left = left - (left @ _SLOPES) @ _SLOPES.T
    variance = left.square().sum((0, 3)) / len(_SLOPES)
    scaled = left * (len(_SLOPES) * (variance + noise**2)).rsqrt()[None, ..., None]
    return scaled.permute(1, 2, 0, 3)


def _deeper(agreement: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The offset [V] in pixels of the best place behind the hull, and where it beats the hull's own [V] bool."""
    behind = OFFSETS < -NEAR
    best = np.where(behind, agreement, -np.inf).argmax(axis=1)
    index = np.arange(len(agreement))
    own = agreement[:, np.abs(OFFSETS) <= NEAR].max(axis=1)
    sure = agreement[index, best] - own > GAIN
    before, after = agreement[index, np.maximum(best - 1, 0)], agreement[index, best + 1]
    bend = np.maximum(2 * agreement[index, best] - before - after, 1e-6)
    step = np.where(best > 0, np.clip((after - before) / (2 * bend), -0.5, 0.5), 0)  # a parabola's top
    return OFFSETS[best] + step, sure
