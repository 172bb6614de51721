"""The textured models in new light, as `benchmarks/relighting.py` measures them, and their section of the evidence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from mgsr.bench.table import markdown

RELIGHTING = "relighting.csv"


@dataclass(frozen=True)
class RelightingRow:
    """The scores of one run's model.glb; PSNR in dB, on the object, after one gain for each image.

    material: the true one. model, photographs: of the model, and of the same mesh with the photographs' mean colours,
    in new light. base_color, photograph_color: of both colours against the true ones. true_roughness: None for a matte
    surface. own_light, splats: of the model in its own environment and of the splats' renders, against photographs that
    training never saw; None where the run wrote no environment.
    """

    scene: str
    material: str
    model: float
    photographs: float
    base_color: float
    photograph_color: float
    roughness: float
    true_roughness: float | None
    metallic: float
    true_metallic: float
    own_light: float | None
    splats: float | None
    commit: str
