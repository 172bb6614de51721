"""The true materials of the scenes that ../shared/tools/render_scene.py renders, for Mitsuba and for glTF's model."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import mitsuba
import numpy as np
import trimesh

VERTEX_COLOR = "vertex_color"
COLORED_FACES, MOST_FACES, LONGEST_EDGE = 150_000, 600_000, 0.03


@dataclass(frozen=True)
class TrueMaterial:
    """What a scene's object is made of.

    name: of the kind of material. bsdf: Mitsuba's. base_color: Mitsuba's texture, linear. roughness: as in glTF, None
    for a matte surface. metallic: 0..1.
    """

    name: str
    bsdf: dict[str, Any]
    base_color: dict[str, Any]
    roughness: float | None
    metallic: float


def true_material(args: dict[str, Any]) -> TrueMaterial:
    """Return the material that the renderer's arguments name; colours come from the mesh where they have a pattern.

    Raises ValueError where the colours come from a picture, and for a metal with a pattern.
    """
    kind, width = args["material"], args["roughness"]
    patterned = args["solid"] != "none"
    if args["texture"] is not None:
        raise ValueError(f"expected one colour or a pattern, got the picture {args['texture']}")
    if kind == "conductor" and patterned:
        raise ValueError(f"expected a metal of one colour, got the pattern {args['solid']}")
    color: dict[str, Any] = {"type": "rgb", "value": _numbers(args["color"])}
    if patterned:
        color = {"type": "mesh_attribute", "name": VERTEX_COLOR}
    if kind == "diffuse":
        return TrueMaterial(kind, {"type": "diffuse", "reflectance": color}, color, None, 0.0)
    if kind == "conductor":
        metal = {"type": "roughconductor", "material": args["metal"], "alpha": width or 0.1, "distribution": "ggx"}
        tint = {"type": "rgb", "value": frontal_reflectance(args["metal"])}
        return TrueMaterial(f"metal {args['metal']}", metal, tint, math.sqrt(width or 0.1), 1.0)
    if kind == "plastic":
        rough = math.sqrt(width or 0.1)
        plain = {"type": "roughplastic", "diffuse_reflectance": color, "alpha": width or 0.1, "nonlinear": True}
        colored = {"type": "principled", "base_color": color, "roughness": rough, "specular": 0.5}
        return TrueMaterial(kind, colored if patterned else plain, color, rough, 0.0)
    if kind == "satin":
        satin = {"type": "principled", "base_color": color, "roughness": width or 0.35, "metallic": 0.6}
        return TrueMaterial(kind, satin | {"specular": 0.5}, color, width or 0.35, 0.6)
    if kind == "clearcoat":
        coat = {"specular": 0.5, "clearcoat": 1.0, "clearcoat_gloss": 0.97}
        base = {"type": "principled", "base_color": color, "roughness": width or 0.5}
        return TrueMaterial("clear coat", base | coat, color, width or 0.5, 0.0)
    raise ValueError(f"expected diffuse, conductor, plastic, satin or clearcoat, got {kind}")


def frontal_reflectance(metal: str) -> list[float]:
    """Return the reflectance [3] at normal incidence of a metal that Mitsuba knows by this name."""
    smooth = mitsuba.load_dict({"type": "conductor", "material": metal})
    place = mitsuba.SurfaceInteraction3f()
    place.wi = [0, 0, 1]
    _, weight = smooth.sample(mitsuba.BSDFContext(), place, 0.5, [0.5, 0.5])
    return [float(each) for each in np.asarray(weight).ravel()]


def true_surface(mesh: trimesh.Trimesh, args: dict[str, Any]) -> tuple[trimesh.Trimesh, np.ndarray | None]:
    """Return the true surface, and the colours [V,3] of its vertices, linear, where they have a pattern.

    It is divided until the vertices carry the pattern, and its vertex normals are those of the undivided surface.
    """
    if args["solid"] == "none":
        if not args["shading"].startswith("crease"):
            return mesh, None
        angle = math.radians(float(args["shading"].split(":")[1]))
        return trimesh.graph.smooth_shade(mesh, angle=angle), None
    points, faces = np.hstack([mesh.vertices, mesh.vertex_normals]), np.asarray(mesh.faces)
    while len(faces) <= MOST_FACES and (len(faces) < COLORED_FACES or _longest_edge(points, faces) > LONGEST_EDGE):
        points, faces = trimesh.remesh.subdivide(points, faces)
    normals = points[:, 3:] / np.maximum(np.linalg.norm(points[:, 3:], axis=1, keepdims=True), 1e-12)
    divided = trimesh.Trimesh(points[:, :3], faces, vertex_normals=normals, process=False)
    return divided, pattern(points[:, :3], args)


def pattern(places: np.ndarray, args: dict[str, Any]) -> np.ndarray:
    """Return the colours [P,3], linear, of places [P,3] in a pattern of the renderer."""
    frequency, seed = args["freq"], args["seed"]
    if args["solid"] == "marble":
        waves = frequency * 3 * places[:, 0] + 8 * _fractal(places * frequency, seed + 11)
        share = 0.5 + 0.5 * np.sin(waves)
    elif args["solid"] == "blobs":
        share = np.clip((_fractal(places * frequency + 31.7, seed + 11) - 0.47) * 12, 0, 1)
    elif args["solid"] == "stripes":
        waves = frequency * np.pi * places[:, 2] + 2 * _fractal(places * 2, seed)
        share = np.clip(np.sin(waves) * 6 + 0.5, 0, 1)
    elif args["solid"] == "checker":
        share = (np.floor(places * frequency + 0.37).sum(axis=1) % 2).astype(float)
    else:
        raise ValueError(f"expected marble, blobs, stripes or checker, got {args['solid']}")
    first, second = np.array(_numbers(args["color"])), np.array(_numbers(args["color2"]))
    fine = 0.85 + 0.3 * _fractal(places * frequency * 4, seed + 77)
    colors: np.ndarray = np.clip((first * share[:, None] + second * (1 - share[:, None])) * fine[:, None], 0, 0.95)
    return colors


def _numbers(text: str) -> list[float]:
    return [float(each) for each in text.split(",")]


def _longest_edge(points: np.ndarray, faces: np.ndarray) -> float:
    corners = points[faces, :3]
    return float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max())


def _fractal(places: np.ndarray, seed: int) -> np.ndarray:
    """Return the renderer's value noise [P] of four octaves, 0..1."""
    octaves = [0.5 ** (each + 1) * _noise(places * 2**each, seed + each) for each in range(4)]
    return np.asarray(sum(octaves) / (1 - 0.5**4))


def _noise(places: np.ndarray, seed: int) -> np.ndarray:
    """Return one octave of the renderer's value noise [P]: smooth between the hashed corners of a lattice."""
    cells = np.floor(places).astype(np.int64)
    within = places - cells
    within = within * within * (3 - 2 * within)
    total = np.zeros(len(places))
    for corner in np.ndindex(2, 2, 2):
        x, y, z = (cells + np.array(corner)).T
        value = (x * 73856093 ^ y * 19349663 ^ z * 83492791 ^ seed * 2654435761) & 0xFFFFFFFF
        value = (value * 2246822519 & 0xFFFFFFFF) ^ (value >> 13)
        value = value * 3266489917 & 0xFFFFFFFF
        value ^= value >> 16
        weight = np.prod(np.where(np.array(corner), within, 1 - within), axis=1)
        total += weight * (value % 65536) / 65535
    return total
