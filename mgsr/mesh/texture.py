"""The surface as a model for viewers and games: decimated, unwrapped, and textured from the full surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mgsr.config import MeshConfig, OutputConfig
from mgsr.config.expert import MeshOptions, TextureOptions
from mgsr.data.images import linear_to_srgb, srgb_to_linear, to_uint8
from mgsr.geometry.decimate import coarser, decimate
from mgsr.geometry.displace import diffuse
from mgsr.geometry.mesh import Mesh
from mgsr.mesh.baking import bake_colors, bake_normals, find_texels
from mgsr.mesh.surface import ReconstructedMesh, TexturedMesh
from mgsr.mesh.unwrap import unwrap
from mgsr.mesh.views import SurfaceView
from mgsr.shading.ambient_occlusion import trace_hemispheres
from mgsr.shading.material import MATTE, Material
from mgsr.shading.static_light import fit_static_light


def texture_mesh(
    full: ReconstructedMesh,
    views: Sequence[SurfaceView],
    pixel: float,
    output: OutputConfig,
    config: MeshConfig,
    shaded: bool = True,
    material: Material = MATTE,
    threads: int | None = None,
    options: MeshOptions = MeshOptions(),
) -> TexturedMesh:
    """Reduce the full surface to `output.faces`, unwrap it, and bake its maps.

    The base colour of a metal is its tint. The base colour of other materials blends the views' colours, as in
    `seen_colors`.

    full, views: in the same frame.
    pixel: the size of the photographs' pixels on the surface, in its unit. Texels have this size unless
    `output.texture` gives their number.
    shaded: whether the colours contain the shading of static light. The shading is then divided out. The light's
    brightness is divided out too, if the material determines it.
    options: the options of the mesh.
    """
    own, static = options.texture, options.texture.static_light
    unwrapped = unwrap(_reduced(full, output.faces, own.same_side), pixel, output.texture, own.unwrap)
    texels = find_texels(unwrapped, full, own.same_side)
    colors = bake_colors(texels, full, views, config, threads, options.colors)
    coarse = coarser(Mesh(full.vertices, full.faces), own.edge * pixel, own.max_faces)
    seen = trace_hemispheres(coarse, pixel)
    at = coarse.prolongation(texels.points)
    if material.tint is not None:
        colors = np.broadcast_to(linear_to_srgb(material.tint), colors.shape)
    elif shaded:
        scale = _albedo_scale(srgb_to_linear(full.colors), material, own)
        around = scale * srgb_to_linear(full.prolongation(coarse.vertices) @ full.colors)
        light = fit_static_light(coarse, around, seen, options=static)
        colors = linear_to_srgb(np.clip(scale * srgb_to_linear(colors) / (at @ light.irradiance), 0, 1))
        if material.light is None:
            material = replace(material, light=light.environment(static.height, static.freedom))
    visible = diffuse(seen.visibility[:, None], coarse.laplacian, static.reach)
    textured: TexturedMesh = TexturedMesh(
        unwrapped.vertices,
        unwrapped.faces,
        unwrapped.uvs,
        unwrapped.tangents,
        unwrapped.size,
        base_color=texels.picture(_bytes(colors)),
        normal_map=texels.picture(_bytes(bake_normals(texels, unwrapped, own.min_z) / 2 + 0.5)),
        occlusion=texels.picture(_bytes(at @ visible[:, 0])),
        material=material,
    ).with_normals(unwrapped.normals)
    return textured


def _albedo_scale(colors: np.ndarray, material: Material, options: TextureOptions) -> np.ndarray:
    """Return the factors [3] that convert linear colours [V,3], in the photographs' unit, to albedo.

    They are the inverse of the mean light, which the gloss of a dielectric determines; without it, they are 1. A lamp
    that photographs clip is brighter than the estimate, so the factors may be too large. They are therefore reduced
    until nearly all albedo is at most `brightest`.
    """
    light = material.mean_light()
    if light is None:
        return np.ones(3)
    scale = 1 / np.maximum(light, 1e-6)
    top = float(np.quantile((scale * colors).max(axis=1), 1 - options.brighter))
    return np.asarray(scale * min(1.0, options.brightest / max(top, 1e-6)))


def _reduced(full: ReconstructedMesh, faces: int | None, same_side: float) -> Mesh:
    """Return the surface with at most `faces` faces, None for all, and with the full surface's normals.

    same_side: as in `find_texels`.
    """
    if faces is None or len(full.faces) <= faces:
        return Mesh(full.vertices, full.faces).with_normals(full.normals)
    reduced = decimate(Mesh(full.vertices, full.faces), faces)
    normals = full.prolongation(reduced.vertices) @ full.normals
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    alike = (normals * reduced.normals).sum(axis=1, keepdims=True) > same_side
    return reduced.with_normals(np.where(alike, normals, reduced.normals).astype(np.float32))


def _bytes(shares: np.ndarray) -> np.ndarray:
    """Return values 0..1 as uint8."""
    return to_uint8(255 * np.clip(shares, 0, 1))
