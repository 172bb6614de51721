"""The contents of report.json and report.html, as named fields."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any


@dataclass(frozen=True)
class StageRun:
    """A training stage.

    Its iterations, why it ended (iterations, converged, budget or deadline), and how many splats were dropped then,
    since they contributed next to nothing to the light.
    """

    iterations: int
    stopped: str
    dropped: int = 0


@dataclass(frozen=True)
class CurvePoint:
    """One row of the curve.

    Seconds of training; PSNR in dB on views that no branch trains on, None without such views or for a branch that is
    not there; splats in each branch.
    """

    seconds: float
    stage: str
    iteration: int
    psnr: float | None
    psnr_surfels: float | None = None
    psnr_gaussians: float | None = None
    surfels: int = 0
    gaussians: int = 0


@dataclass(frozen=True)
class MeshFacts:
    """Counts of the surface; boundary_edges belong to one face only, holes are the loops that they form."""

    vertices: int
    faces: int
    components: int
    boundary_edges: int
    holes: int | None = None


@dataclass(frozen=True)
class Decision:
    """An automatic choice: its subject, its outcome, and the reason."""

    what: str
    choice: str
    why: str


@dataclass(frozen=True)
class ReportData:
    """A whole run.

    seconds: by step and stage, with `total`. gaussians: splats by branch. gt: scores against the true surface by
    name, in the units of `mgsr.metrics`; None where no truth lies beside the scene. other: further fields from the
    writer of report.json; it is written out at the top level and read back from there.
    """

    scene: str
    preset: str
    method: str
    device: str
    seed: int
    versions: dict[str, str]
    seconds: dict[str, float]
    iterations: dict[str, StageRun]
    gaussians: dict[str, int]
    psnr_test: float | None
    ssim_test: float | None
    curve: list[CurvePoint]
    mesh: MeshFacts | None
    gt: dict[str, float] | None
    peak_memory_mib: float
    command: str = ""
    decisions: list[Decision] = field(default_factory=list)
    other: dict[str, Any] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """Return the object of report.json: only plain types, with None for numbers that are not finite."""
        plain = asdict(self)
        other = plain.pop("other")
        written: dict[str, Any] = finite(other | plain)
        return written

    @staticmethod
    def from_json(report: Mapping[str, Any]) -> ReportData:
        """Build the run from the JSON object of a report.

        psnr_test, ssim_test, mesh and gt may be missing, which means None. Raises KeyError, with the name, where
        another field without default is missing.
        """
        names = {each.name for each in fields(ReportData)} - {"other"}
        known: dict[str, Any] = dict.fromkeys(("psnr_test", "ssim_test", "mesh", "gt"))
        known |= {name: value for name, value in report.items() if name in names}
        for name in REQUIRED:
            if name not in known:
                raise KeyError(name)
        known["iterations"] = {name: _pick(StageRun, stage) for name, stage in known["iterations"].items()}
        known["curve"] = [_pick(CurvePoint, row) for row in known["curve"]]
        known["mesh"] = None if known["mesh"] is None else _pick(MeshFacts, known["mesh"])
        known["decisions"] = [_pick(Decision, decision) for decision in known.get("decisions", [])]
        return ReportData(**known, other={name: value for name, value in report.items() if name not in names})


REQUIRED = (
    *("scene", "preset", "method", "device", "seed", "versions"),
    *("seconds", "iterations", "gaussians", "curve", "peak_memory_mib"),
)


def finite(value: Any) -> Any:
    """Return the same nest of plain types, with None for NaN and infinities, which JSON does not know."""
    if isinstance(value, Mapping):
        return {str(key): finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value


def _pick(kind: type, values: Any) -> Any:
    """Build a dataclass from the entries that it knows."""
    if isinstance(values, kind):
        return values
    names = {each.name for each in fields(kind)}
    return kind(**{name: value for name, value in values.items() if name in names})
