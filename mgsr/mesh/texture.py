"""The surface as a model for viewers and games: decimated, unwrapped, and textured from the full surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mgsr.config import MIN_TEXTURE, MeshConfig, OutputConfig
from mgsr.config.expert import MeshOptions, TextureOptions
from mgsr.data.images import linear_to_srgb, srgb_to_linear, to_uint8
from mgsr.geometry.decimate import coarser, decimate
from mgsr.geometry.displace import diffuse
from mgsr.geometry.mesh import Mesh
from mgsr.mesh.baking import bake_colors, bake_normals, find_texels
from mgsr.mesh.surface import ReconstructedMesh, TexturedMesh
from mgsr.mesh.unwrap import UnwrappedMesh, unwrap
from mgsr.mesh.views import SurfaceView
from mgsr.shading.ambient_occlusion import trace_hemispheres
from mgsr.shading.material import MATTE, Material
from mgsr.shading.static_light import fit_static_light


def texture_levels(
    full: ReconstructedMesh,
    views: Sequence[SurfaceView],
    pixel: float,
    output: OutputConfig,
    config: MeshConfig,
    shaded: bool = True,
    material: Material = MATTE,
    options: MeshOptions = MeshOptions(),
) -> list[TexturedMesh]:
    """Reduce the full surface, unwrap it, and bake its maps, at each level of detail, the finest first.

    The finest level has `output.faces` faces. Each of up to `output.lods` coarser levels has a share of the faces and
    of the texels of the level before (`TextureOptions`).

    full, views: in one frame. pixel: the size of the photographs' pixels on the surface, in its unit. A texel of the
    finest level is `options.texture.texel` times as large unless `output.texture` gives the number of texels. A metal's
    base colour is its tint; others blend the views' colours, as in `blended_colors`. shaded: whether these colours
    contain the shading of static light. It is divided out, and the light's brightness with it where the material tells
    it. options: all of the mesh's.
    """
    own = options.texture
    lit = _lit_surface(full, pixel, shaded, material, own)
    levels, faces = [], len(full.faces) if output.faces is None else min(output.faces, len(full.faces))
    for level in range(output.lods + 1):
        if level and faces < own.min_level_faces:
            break
        reduced = _reduced(full, faces, own.same_side)
        width = None if output.texture is None else max(MIN_TEXTURE, round(output.texture * own.level_texels**level))
        unwrapped = unwrap(reduced, own.texel * pixel / own.level_texels**level, width, own.unwrap)
        levels.append(_baked(unwrapped, lit, views, config, options))
        faces = round(faces * own.level_faces)
    return levels


@dataclass(frozen=True)
class _LitSurface:
    """A surface with the shading of its colours.

    coarse: the mesh on which occlusion and shading are known. visibility [V]: the share of the sky that its vertices
    see. irradiance [V,3]: of static light at its vertices; None if the colours contain no shading. scale [3]: the
    factors that make albedo of linear colours.
    """

    full: ReconstructedMesh
    coarse: Mesh
    visibility: np.ndarray
    irradiance: np.ndarray | None
    scale: np.ndarray
    material: Material


def _lit_surface(
    full: ReconstructedMesh, pixel: float, shaded: bool, material: Material, options: TextureOptions
) -> _LitSurface:
    """Separate the colours of a surface from their shading; the arguments are those of `texture_levels`."""
    static = options.static_light
    coarse = coarser(Mesh(full.vertices, full.faces), options.edge * pixel, options.max_faces)
    seen = trace_hemispheres(coarse, pixel, static.rays)
    scale, irradiance = np.ones(3), None
    if material.tint is None and shaded:
        scale = _albedo_scale(srgb_to_linear(full.colors), material, options)
        around = scale * srgb_to_linear(full.prolongation(coarse.vertices) @ full.colors)
        light = fit_static_light(coarse, around, seen, options=static)
        irradiance = light.irradiance
        if material.light is None:
            material = replace(material, light=light.environment(static.height, static.freedom))
    visibility = diffuse(seen.visibility[:, None], coarse.laplacian, static.reach)[:, 0]
    return _LitSurface(full, coarse, visibility, irradiance, scale, material)


def _baked(
    unwrapped: UnwrappedMesh,
    lit: _LitSurface,
    views: Sequence[SurfaceView],
    config: MeshConfig,
    options: MeshOptions,
) -> TexturedMesh:
    """Bake the maps of an unwrapped level of detail from the full surface."""
    own = options.texture
    texels = find_texels(unwrapped, lit.full, own.same_side)
    at = lit.coarse.prolongation(texels.points)
    colors = bake_colors(texels, lit.full, views, config, options=options.colors)
    if lit.material.tint is not None:
        colors = np.broadcast_to(linear_to_srgb(lit.material.tint), colors.shape)
    elif lit.irradiance is not None:
        colors = linear_to_srgb(np.clip(lit.scale * srgb_to_linear(colors) / (at @ lit.irradiance), 0, 1))
    textured: TexturedMesh = TexturedMesh(
        unwrapped.vertices,
        unwrapped.faces,
        unwrapped.uvs,
        unwrapped.tangents,
        unwrapped.size,
        base_color=texels.picture(_bytes(colors)),
        normal_map=texels.picture(_bytes(bake_normals(texels, unwrapped, own.min_z) / 2 + 0.5)),
        occlusion=texels.picture(_bytes(at @ lit.visibility)),
        material=lit.material,
    ).with_normals(unwrapped.normals)
    return textured


def _albedo_scale(colors: np.ndarray, material: Material, options: TextureOptions) -> np.ndarray:
    """Return the factors [3] that convert linear colours [V,3], in the photographs' unit, to albedo.

    They are the inverse of the mean light, derived from the gloss of a dielectric, or 1 if the mean light is unknown.
    Clipped lamps hide a part of the light, so the factors are reduced until nearly all albedo is at most `brightest`.
    """
    light = material.mean_light()
    if light is None:
        return np.ones(3)
    scale = 1 / np.maximum(light, 1e-6)
    top = float(np.quantile((scale * colors).max(axis=1), 1 - options.brighter))
    return np.asarray(scale * min(1.0, options.brightest / max(top, 1e-6)))


def _reduced(full: ReconstructedMesh, faces: int, same_side: float) -> Mesh:
    """Return the surface with at most `faces` faces, and with the full surface's normals.

    same_side: as in `find_texels`.
    """
    if len(full.faces) <= faces:
        return Mesh(full.vertices, full.faces).with_normals(full.normals)
    reduced = decimate(Mesh(full.vertices, full.faces), faces)
    normals = full.prolongation(reduced.vertices) @ full.normals
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    alike = (normals * reduced.normals).sum(axis=1, keepdims=True) > same_side
    return reduced.with_normals(np.where(alike, normals, reduced.normals).astype(np.float32))


def _bytes(shares: np.ndarray) -> np.ndarray:
    """Return values 0..1 as uint8."""
    return to_uint8(255 * np.clip(shares, 0, 1))
