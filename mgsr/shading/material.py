"""The physically based material of a surface: how rough it is, and whether it is a metal."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Material:
    """A material's constants, as in glTF's metallic-roughness model.

    roughness: 0..1; its square is the width of the GGX lobe. metallic: 0 for dielectrics, 1 for metals.
    """

    roughness: float = 1.0
    metallic: float = 0.0


MATTE = Material()
