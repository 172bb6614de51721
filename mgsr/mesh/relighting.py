"""Pictures of a textured mesh in an environment, by ray casting. Like glTF viewers, they show no cast shadows."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from mgsr.data.camera import Camera
from mgsr.data.images import srgb_to_linear
from mgsr.geometry.raycast import pixel_rays
from mgsr.geometry.triangles import unit_vectors
from mgsr.mesh.baking import interpolated
from mgsr.mesh.surface import TexturedMesh
from mgsr.shading.ambient_occlusion import real_harmonics
from mgsr.shading.environment_fit import cell_directions, sample_map
from mgsr.shading.gloss import GgxLobe, mirrored_share
from mgsr.shading.material import Material
from mgsr.shading.observations import sample_image

DIELECTRIC = 0.04  # reflectance of glTF's dielectrics at normal incidence
SAMPLES = 2  # along each side of a pixel
MOST_TEXELS = 1024  # along a side of a map; small pictures show no more detail
# For each soft box: its azimuth and its elevation in degrees, the cosine of its angular radius, and its radiance.
SOFT_BOXES = ((40, 40, 0.92, 9.0), (-75, 15, 0.94, 2.0), (170, 30, 0.95, 4.0))
SOFT_EDGE = 0.03  # the width, in the cosine, of the border over which a soft box fades
# The cosine lobe's share of each spherical harmonic up to degree 2. Source: Ramamoorthi and Hanrahan, 2001.
COSINE_LOBE = np.repeat([1.0, 2 / 3, 1 / 4], [1, 3, 5])


@dataclass(frozen=True)
class SeenSurface:
    """The surface of a textured mesh where the rays of one camera hit it.

    hit [H,W] bool: which rays hit; each pixel has SAMPLES^2 rays. The other arrays are of the P hits.
    albedo [P,3]: linear.
    normals [P,3]: unit, with the normal map.
    eye [P,3]: unit, towards the camera.
    occlusion [P]: the visible share of the sky.
    """

    hit: np.ndarray
    albedo: np.ndarray
    normals: np.ndarray
    eye: np.ndarray
    occlusion: np.ndarray
    material: Material

    def lit(self, light: np.ndarray) -> np.ndarray:
        """Return the picture [H,W,4] in an environment, linear, premultiplied by alpha.

        light [h,2h,3]: linear radiance, rows by the polar angle from the mesh's z, columns by the azimuth from its x.
        """
        shade = self.occlusion[:, None] * (self._matte(light) if self.material.matte else self._glossy(light))
        rays = np.zeros((*self.hit.shape, 4), np.float32)
        rays[self.hit] = np.concatenate([shade, np.ones((len(shade), 1))], axis=1)
        rows, columns = self.hit.shape
        return np.asarray(rays.reshape(rows // SAMPLES, SAMPLES, columns // SAMPLES, SAMPLES, 4).mean(axis=(1, 3)))

    def _matte(self, light: np.ndarray) -> np.ndarray:
        """Return the diffuse radiance [P,3] at the hits."""
        return np.asarray(self.albedo * irradiance(light, self.normals))

    def _glossy(self, light: np.ndarray) -> np.ndarray:
        """Return the light [P,3] that the hits scatter and mirror."""
        metallic, height = self.material.metallic, len(light)
        frontal = DIELECTRIC * (1 - metallic) + metallic * self.albedo
        black, white = (mirrored_share(self._cosines, self.material.roughness, each)[:, None] for each in (0.0, 1.0))
        lobe = GgxLobe(self.material.roughness, height)
        gloss = sample_map(self._mirrored, height) @ lobe.blur(light.reshape(-1, 3))
        mirrored, kept = (black + each * (white - black) for each in (frontal, DIELECTRIC))
        return np.asarray((1 - metallic) * (1 - kept) * self._matte(light) + mirrored * gloss)

    @cached_property
    def _cosines(self) -> np.ndarray:
        return np.asarray(np.clip((self.normals * self.eye).sum(axis=1), 0, 1))

    @cached_property
    def _mirrored(self) -> np.ndarray:
        return unit_vectors(2 * self._cosines[:, None] * self.normals - self.eye)


def look_at_textured(mesh: TexturedMesh, camera: Camera) -> SeenSurface:
    """Cast a camera's rays at a textured mesh in its frame, and read the maps where they hit."""
    rays = pixel_rays(camera.resized(SAMPLES * camera.width, SAMPLES * camera.height))
    hits = mesh.caster.cast_rays(camera.center, rays)
    hit = hits.mask
    corners, shares = mesh.faces[hits.face[hit]], hits.barycentric[hit]
    eye = -unit_vectors(rays[hit].astype(np.float64))
    uvs = interpolated(mesh.uvs, corners, shares)
    axes = np.stack([mesh.tangents[:, :3], mesh.bitangents(), mesh.normals], axis=2)
    frame = np.einsum("pkij,pk->pij", axes[corners], shares)
    turned = 2 * _read(mesh.normal_map, uvs) - 1
    normals = unit_vectors(np.einsum("pij,pj->pi", frame, turned))
    # The surface is two-sided: where a ray hits its back, the normal is flipped towards the camera.
    behind = (mesh.face_crosses[hits.face[hit]] * eye).sum(axis=1, keepdims=True) < 0
    normals = np.where(behind, -normals, normals)
    albedo = srgb_to_linear(_read(mesh.base_color, uvs))
    return SeenSurface(hit, albedo, normals, eye, _read(mesh.occlusion, uvs)[:, 0], mesh.material)


def irradiance(light: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Return the irradiance [P,3], over pi, of a matte surface with unit normals [P,3] in an environment.

    light [h,2h,3]: as in `SeenSurface.lit`.
    """
    directions = cell_directions(len(light)).reshape(-1, 3)
    areas = np.sqrt(1 - directions[:, 2] ** 2)
    harmonics = real_harmonics(directions).T @ (areas[:, None] * light.reshape(-1, 3)) / areas.sum()
    return np.asarray(np.maximum(real_harmonics(normals) @ (COSINE_LOBE[:, None] * harmonics), 0))


def studio_light(up: np.ndarray, front: np.ndarray, angle: float, height: int = 32) -> np.ndarray:
    """Return a studio's light [height,2*height,3]: a grey room with one bright soft box and two weaker ones.

    up, front: unit directions [3], perpendicular to each other.
    angle: the degrees by which the studio is turned around `up`, anticlockwise as seen from above. At 0, the bright
    box is on the right of a viewer in front of the object.
    """
    directions, side = cell_directions(height), np.cross(up, front)
    light = 0.1 + 0.1 * np.maximum(directions @ up, 0)
    for turn, elevation, cosine, radiance in SOFT_BOXES:
        around, above = np.radians(turn + angle), np.radians(elevation)
        box_direction = np.cos(above) * (np.cos(around) * front + np.sin(around) * side) + np.sin(above) * up
        light += radiance * np.clip((directions @ box_direction - cosine) / SOFT_EDGE + 0.5, 0, 1)
    return np.repeat(light[..., None], 3, axis=2).astype(np.float32)


def _read(picture: np.ndarray, uvs: np.ndarray) -> np.ndarray:
    """Interpolate a picture [H,W,C] uint8 bilinearly at texture coordinates `uvs` [P,2]; return values [P,C] in 0..1.

    A picture with more than MOST_TEXELS along a side is reduced first.
    """
    factor = MOST_TEXELS / max(picture.shape[:2])
    if factor < 1:
        picture = cv2.resize(picture, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    height, width = picture.shape[:2]
    layers = np.atleast_3d(picture).astype(np.float32) / 255
    return np.stack([sample_image(layers[..., each], uvs * (width, height)) for each in range(layers.shape[2])], axis=1)
