"""The benchmark matrix: its cells, their names and settings."""

from __future__ import annotations

import hashlib
import itertools
import json
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from mgsr.bench.ablations import NEED_ROWS, PAPER_CHOICES, PAPER_ROWS, AblationRow, named_rows
from mgsr.config import Config, make_config
from mgsr.errors import ConfigError

PLAIN = ""
LONGEST = 80  # letters of a variant in a folder's name
GROUPS = {"ablations": PAPER_ROWS, "paper-choices": PAPER_CHOICES, "needs": NEED_ROWS}


@dataclass(frozen=True)
class Variant:
    """Named settings; the plain variant has neither. method: the required method, None for any."""

    name: str = PLAIN
    overrides: tuple[str, ...] = ()
    method: str | None = None


@dataclass(frozen=True)
class Cell:
    """One run of the matrix: a scene's folder or archive, and all that shapes the run."""

    scene: Path
    method: str = "mgsr"
    preset: str = "standard"
    device: str = "cpu"
    seed: int = 0
    variant: Variant = Variant()

    @property
    def name(self) -> str:
        """Return the name of the cell's folder: the scene, then the differences from a plain run on the CPU."""
        parts = [self.scene.name, self.preset, self.method]
        parts += [self.device] if self.device != "cpu" else []
        parts += [f"seed{self.seed}"] if self.seed else []
        parts += [_short(self.variant.name)] if self.variant.name else []
        return "-".join(parts)

    def config(self) -> Config:
        """Return the cell's settings.

        Raises ConfigError.
        """
        return make_config(self.preset, self.method, self.seed, self.variant.overrides)

    def settings(self) -> dict[str, Any]:
        """Return the cell's settings as report.json has them."""
        plain: dict[str, Any] = json.loads(json.dumps(asdict(self.config())))
        return plain

    def arguments(self, out: Path) -> list[str]:
        """Return what follows `mgsr` on the cell's command line."""
        words = ["run", str(self.scene), "-o", str(out), "--preset", self.preset, "--method", self.method]
        words += ["--device", self.device, "--seed", str(self.seed)]
        return words + [word for setting in self.variant.overrides for word in ("--set", setting)]


def matrix(
    scenes: Sequence[Path],
    methods: Sequence[str] = ("mgsr",),
    presets: Sequence[str] = ("standard",),
    devices: Sequence[str] = ("cpu",),
    seeds: Sequence[int] = (0,),
    variants: Sequence[Variant] = (Variant(),),
) -> list[Cell]:
    """Return every combination once, scene by scene, so that a matrix that is stopped early has whole scenes.

    A variant that requires a method runs only with that method.

    Raises ConfigError for invalid settings, before any run starts.
    """
    cells = []
    for scene, preset, device, seed, variant in itertools.product(scenes, presets, devices, seeds, variants):
        for method in methods if variant.method is None else (variant.method,):
            cells.append(Cell(scene, method, preset, device, seed, replace(variant, method=None)))
    for cell in cells:
        cell.config()
    return list(dict.fromkeys(cells))


def read_variants(words: Sequence[str], settings: Sequence[str] = ()) -> list[Variant]:
    """Parse variants as the user names them.

    A word is `plain`, an ablation row (`K`), a group of rows (`ablations`, `paper-choices`, `needs`), or settings
    (`masks=off`, `max_side=200,sh_degree=1`), which become its name. `settings` hold for all of them, below a variant's
    own, and stand in their names.

    Raises ConfigError for another word.
    """
    found: list[Variant] = []
    for word in words:
        found += [of_row(row) for row in GROUPS[word]] if word in GROUPS else [_variant(word)]
    return [_with_settings(variant, settings) for variant in dict.fromkeys(found)]


def _with_settings(variant: Variant, settings: Sequence[str]) -> Variant:
    name = " ".join(word for word in (variant.name, *settings) if word)
    return Variant(name, (*settings, *variant.overrides), variant.method)


def of_row(row: AblationRow) -> Variant:
    """Return the variant that runs an ablation row; for a row without settings, the plain one with its method."""
    return Variant(row.name if row.overrides else PLAIN, row.overrides, row.method)


def _variant(word: str) -> Variant:
    rows = named_rows()
    if word == "plain":
        return Variant()
    if word in rows:
        return of_row(rows[word])
    if "=" in word:
        return Variant(word, tuple(word.split(",")))
    raise ConfigError(
        f"--variant {word}: expected plain, KEY=VALUE[,KEY=VALUE], one of {', '.join(GROUPS)}, or a row: "
        + ", ".join(rows)
    )


def _short(name: str) -> str:
    """Shorten a variant's name to a part of a folder's, which may not be long."""
    plain = re.sub(r"[^\w.=-]+", "_", name)
    return plain if len(plain) <= LONGEST else f"{plain[:LONGEST]}~{hashlib.sha256(name.encode()).hexdigest()[:8]}"
