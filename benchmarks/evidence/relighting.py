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


def relighting_section(rows: Sequence[RelightingRow]) -> str:
    """Return the table, and by how much the model gains; empty without rows."""
    if not rows:
        return ""
    head = ["scene", "material", "model", "photograph colours", "base colour", "photographs", "roughness", "metallic",
            "own light", "splats"]  # fmt: skip
    cells = [
        [row.scene, row.material, f"{row.model:.1f}", f"{row.photographs:.1f}", f"{row.base_color:.1f}",
         f"{row.photograph_color:.1f}", f"{row.roughness:.2f} ({_number(row.true_roughness, 2)})",
         f"{row.metallic:g} ({row.true_metallic:g})", _number(row.own_light, 1), _number(row.splats, 1)]
        for row in rows
    ]  # fmt: skip
    commits = ", ".join(dict.fromkeys(row.commit for row in rows))
    gain = sum(row.model - row.photographs for row in rows) / len(rows)
    behind = ", ".join(row.scene for row in rows if row.model < row.photographs) or "no scene"
    return "\n\n".join(
        (
            "## The textured model in new light",
            "Mitsuba renders `model.glb` and the true surface from test views, under two environments that no "
            "photograph had. The comparison is the same mesh, matte, with the mean colours of the photographs. PSNR is "
            "on the object, after one gain per image.\n\nThe next two columns compare both colours with the true ones. "
            "Roughness and metallic have the true values in brackets. The last columns compare the model in its own "
            "environment, and the splats, with the test photographs.\n\n"
            f"The program is that of {commits}.",
            markdown(head, cells),
            f"On average, the model is {gain:.1f} dB closer to the truth than photograph colours are; it is behind on "
            f"{behind}.{_matte_in_own_light(rows)}",
        )
    )


def _matte_in_own_light(rows: Sequence[RelightingRow]) -> str:
    """Return the sentence about matte scenes in their own light; empty without such scenes."""
    pairs = [
        (row.own_light, row.splats)
        for row in rows
        if row.true_roughness is None and row.own_light is not None and row.splats is not None
    ]
    if not pairs:
        return ""
    ours, splats = (sum(each) / len(pairs) for each in zip(*pairs, strict=True))
    return (
        f"\n\nOn matte scenes, the model in its own light has {ours:.1f} dB, and the splats have {splats:.1f} dB. Its "
        "texture is less sharp."
    )


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"
