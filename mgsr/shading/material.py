"""The physically based material of a surface: its roughness, and whether it is a metal."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Material:
    """A material's constants, as in glTF's metallic-roughness model.

    roughness: 0..1; its square is the width of the GGX lobe.
    roughness_range: the roughnesses that explain the photographs about as well; None if the photographs do not
    determine the roughness. Then the surface counts as matte.
    metallic: 0 for dielectrics, 1 for metals.
    tint [3]: a metal's reflectance, linear 0..1; None for a dielectric.
    light [H,2H,3]: the environment that a glossy surface mirrors or that shades a matte one, as linear radiance in the
    photographs' unit. Rows are polar angles from the frame's z, columns azimuths from its x. None if it is unknown.
    """

    roughness: float = 1.0
    roughness_range: tuple[float, float] | None = None
    metallic: float = 0.0
    tint: np.ndarray | None = None
    light: np.ndarray | None = None

    @property
    def matte(self) -> bool:
        """Return whether the photographs show no gloss."""
        return self.roughness_range is None

    def mean_light(self) -> np.ndarray | None:
        """Return the mean [3] of the light over all directions; None if the light is unknown."""
        if self.light is None:
            return None
        areas = np.sin((np.arange(len(self.light)) + 0.5) / len(self.light) * np.pi)
        mean: np.ndarray = np.average(self.light.mean(axis=1), axis=0, weights=areas)
        return mean

    def to_json(self) -> dict[str, object]:
        """Return the constants as plain types, for report.json."""
        tint = None if self.tint is None else [float(each) for each in self.tint]
        bounds = None if self.roughness_range is None else list(self.roughness_range)
        return {"roughness": self.roughness, "roughness_range": bounds, "metallic": self.metallic, "tint": tint}


MATTE = Material()
