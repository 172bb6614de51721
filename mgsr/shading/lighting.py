"""Irradiance of a surface by a flash, for any camera.

A lamp on the camera moves with it, and so do shading and shadows. Once lamp and surface are known, shading and shadows
can be computed for each photograph. Training learns the remaining brightness, which changes little between views.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.ndimage import distance_transform_edt

from mgsr.config.expert import IrradianceOptions
from mgsr.data.camera import Camera
from mgsr.data.images import to_uint8
from mgsr.data.pixels import PixelStore
from mgsr.data.scene import Scene, Similarity, View
from mgsr.geometry.mesh import Mesh
from mgsr.geometry.vectors import dots, lengths
from mgsr.parallel import map_ahead

GAMMA = 2.4  # of sRGB, away from black
BAND = 1 << 18  # approximate number of rays in a batch


@dataclass(frozen=True)
class Lighting:
    """A surface and the lamp that lights it.

    lamp and ambient are relative to the brightest irradiance in the photographs.

    right, down: the lamp's offset from the lens along the camera's x and y axes, in the scene's unit.
    lamp: the irradiance of a surface that faces the lamp at a distance of 1.
    ambient [V]: the other irradiance of each vertex.
    proxy_vertex [V]: the vertex that replaces each vertex in the lighting. A visible vertex is its own proxy. Another
    vertex has the nearest visible one, because the unseen surface may be folded.
    options: the options of the irradiance.
    """

    mesh: Mesh
    ambient: np.ndarray
    proxy_vertex: np.ndarray
    right: float
    down: float
    lamp: float
    options: IrradianceOptions = IrradianceOptions()

    def seen_by(self, camera: Camera) -> np.ndarray:
        """Return the irradiance [H,W] uint8 of the surface in a camera's image, encoded as `View.irradiance`.

        Pixels without surface take the value of the nearest pixel with one.
        """
        light, seen = np.zeros((camera.height, camera.width)), np.zeros((camera.height, camera.width), np.intp)
        for part, pixels in self._parts(camera):
            light[part], seen[part] = self._light_at(camera, pixels)
        if not seen.any():
            return np.full(light.shape, 255, np.uint8)
        nearest = distance_transform_edt(seen == 0, return_distances=False, return_indices=True)
        mean = (light / np.maximum(seen, 1))[tuple(nearest)]
        return to_uint8(255 * np.clip(mean, self.options.dimmest, 1) ** (1 / GAMMA))

    def falling_on(self, camera: Camera, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """Return the irradiance [P] of points [P,3] near the surface, in a camera's photograph.

        normals [P,3]: unit. In the lamp's shadow the irradiance is 0.
        """
        face, shares = self.mesh.caster.nearest(points)
        ambient = (self.ambient[self.proxy_vertex[self.mesh.faces[face]]] * shares).sum(axis=1)
        place = self._lamp(camera)
        reached = self.mesh.caster.reached(place, points + self.mesh.edge_length * normals, self.mesh.edge_length)
        return np.asarray(reached * (self.lamp * lamp_light(place - points, normals) + ambient))

    def moved(self, to: Similarity) -> Lighting:
        """Return the lighting in the user's frame, which the similarity `to` defines."""
        longer = to.scale
        return replace(
            self,
            mesh=self.mesh.moved(to.to_user(self.mesh.vertices)),
            right=longer * self.right,
            down=longer * self.down,
            lamp=longer**2 * self.lamp,
        )

    def _lamp(self, camera: Camera) -> np.ndarray:
        """Return the lamp's position [3] for a camera, in the scene's frame."""
        return np.asarray(camera.center + np.array([self.right, self.down]) @ camera.cam_from_world[:2, :3])

    @cached_property
    def _attributes(self) -> np.ndarray:
        """Return the interpolated attributes [V,7] float32 of each vertex: position, normal, and ambient irradiance."""
        attributes = np.concatenate([self.mesh.vertices, self.mesh.normals, self.ambient[:, None]], axis=1)
        values: np.ndarray = attributes[self.proxy_vertex].astype(np.float32)
        return values

    def _parts(self, camera: Camera) -> Iterator[tuple[tuple[slice, slice], np.ndarray]]:
        """Yield the parts of an image that may show the surface, a few rows at a time.

        Each comes with the pixel coordinates [H,n,W,n,2] of n x n rays in each of its H x W pixels.
        """
        size, rays = (camera.width, camera.height), self.options.rays
        fine = max(1, round(rays / max(camera.width, camera.height)))
        places, depths = camera.project(self.mesh.vertices)
        first, last = np.zeros(2, np.intp), np.array(size)
        if (depths > 0).all():
            first = np.clip(np.floor(places.min(axis=0)), 0, size).astype(np.intp)
            last = np.clip(np.ceil(places.max(axis=0)), first, size).astype(np.intp)
        wide = last[0] - first[0]
        across = (np.arange(first[0] * fine, last[0] * fine) + 0.5) / fine
        high = max(1, BAND // max(1, wide * fine**2))
        for top in range(first[1], last[1], high):
            end = min(top + high, last[1])
            down = (np.arange(top * fine, end * fine) + 0.5) / fine
            pixels = np.stack(np.meshgrid(across, down), axis=-1).reshape(end - top, fine, wide, fine, 2)
            yield (slice(top, end), slice(first[0], last[0])), pixels

    def _light_at(self, camera: Camera, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the summed irradiance [H,W] of each pixel's rays that hit the surface, and their number [H,W].

        pixels [H,n,W,n,2]: the rays' pixel coordinates.
        """
        hits = self.mesh.caster.cast_pixels(camera, pixels)
        met = hits.mask
        there = np.einsum("pki,pk->pi", self._attributes[self.mesh.faces[hits.face[met]]], hits.barycentric[met])
        points, normals, ambient = there[:, :3], there[:, 3:6], there[:, 6]
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
        place = self._lamp(camera).astype(np.float32)
        reached = self.mesh.caster.reached(place, points + self.mesh.edge_length * normals, self.mesh.edge_length)
        light = np.zeros(met.shape)
        light[met] = self.lamp * reached * lamp_light(place - points, normals) + ambient
        return light.sum(axis=(1, 3)), met.sum(axis=(1, 3))


def lamp_light(to_lamp: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Return the irradiance [...] by a point light at offsets to_lamp [...,3] from points with unit normals [...,3].

    It is 1 for a surface that faces the lamp at a distance of 1 (Lambert).
    """
    cosines = np.maximum(dots(to_lamp, normals), 0)
    return np.asarray(cosines / lengths(to_lamp) ** 3)


def add_irradiance(scene: Scene, lighting: Lighting | None, threads: int | None = None) -> Scene:
    """Return the scene with the flash's irradiance in each of its views; unchanged without a flash."""
    if lighting is None:
        return scene
    pixels = PixelStore()

    def lit(view: View) -> View:
        return replace(view, irradiance=pixels.hold(lighting.seen_by(view.camera)))

    train, test = (list(map_ahead(lit, views, threads)) for views in (scene.train, scene.test))
    return replace(scene, train=train, test=test)
