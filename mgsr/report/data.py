"""The contents of report.json and report.html, as named fields."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, is_dataclass
from types import NoneType
from typing import Any, get_args, get_origin, get_type_hints


@dataclass(frozen=True)
class StageRun:
    """A training stage.

    It has the number of iterations and the reason of its end (iterations, converged, budget or deadline). dropped: the
    number of splats that were pruned at the end because of their low contribution.
    """

    iterations: int
    stopped: str
    dropped: int = 0


@dataclass(frozen=True)
class CurvePoint:
    """A row of the training curve.

    It has the seconds of training, the PSNR of each branch on held-out views in dB, and the number of splats of each
    branch. A PSNR is None without such views or without the branch.
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
    """Counts of the surface. boundary_edges: edges of only one face. holes: the loops of boundary edges."""

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
class FrameFacts:
    """The transform to the frame of the written files: point = scale * (point of the normalised scene) + offset [3]."""

    scale: float
    offset: list[float]


@dataclass(frozen=True)
class FlashFacts:
    """The flash's offset from the lens, along the camera's x and y axes, in the written files' unit."""

    right: float
    down: float


@dataclass(frozen=True)
class StartFacts:
    """The starting points: their source (capture, hull, stereo or ball) and their number."""

    source: str
    count: int


@dataclass(frozen=True)
class InputFacts:
    """The capture. A field that is None does not apply and is not written.

    image_size: width and height of the first training view. points: the number of points in the capture. splats_origin
    [3]: the origin of positions in splat files, if the frame's own origin is far away. shown: the share of valid pixels
    in the training images, if it is not 1. backdrop [3]: the colour, sRGB 0..1, of a plain backdrop in photographs
    without masks. exposures: the ratio of the brightest exposure to the darkest. masks_found: True if the masks are
    those of an object that was found in the photographs. mask_error: the `Scene.mask_error`, pixels, of inexact masks
    that were given. camera_shift: the `Scene.camera_shift`, pixels, of adjusted cameras.
    """

    path: str
    format: str
    train_views: list[str]
    test_views: list[str]
    image_size: list[int]
    masked: bool
    points: int
    user_from_scene: FrameFacts
    splats_origin: list[float] | None = None
    shown: float | None = None
    backdrop: list[float] | None = None
    exposures: float | None = None
    notes: list[str] | None = None
    warning: str | None = None
    flash: FlashFacts | None = None
    starting_points: StartFacts | None = None
    masks_found: bool | None = None
    mask_error: float | None = None
    camera_shift: float | None = None

    def to_json(self) -> dict[str, Any]:
        """Return the fields that apply, by name, as plain types."""
        return {name: value for name, value in asdict(self).items() if value is not None}


@dataclass(frozen=True)
class MeshStepRun:
    """A step that finished the mesh: its duration in seconds, the faces after it, and its own figures by name."""

    seconds: float
    faces: int
    outcome: dict[str, float | bool | str]


@dataclass(frozen=True)
class Selection:
    """The result of model selection, and the PSNR in dB of each candidate on held-out photographs."""

    chosen: str | int | None
    tried: dict[str, float]


@dataclass(frozen=True)
class MachineFacts:
    """The machine: the system, the processor's architecture, its cores, and the instruction set of the kernels."""

    system: str
    processor: str
    cores: int | None
    kernels: str


@dataclass(frozen=True)
class BudgetFacts:
    """The time budget and its use, in seconds; planned and spent are by step.

    place: the place of the settings on the line of presets. settings: the same in words. image_scale: the factor of the
    training photographs' sides. too_small: whether even the shortest plan needs more time.
    """

    seconds: float
    used: float
    place: float | None
    settings: str
    image_scale: float
    too_small: bool
    planned: dict[str, float]
    spent: dict[str, float]


@dataclass(frozen=True)
class SplitFacts:
    """The scores of the light split, dB (see `mgsr.metrics.split`)."""

    split_psnr: float
    split_photo: float
    split_gain: float


@dataclass(frozen=True)
class ReportData:
    """A whole run.

    seconds: by step and stage, with `total`. gaussians: splats by branch. gt: scores against the true surface by
    name, in the units of `mgsr.metrics`; None if no truth lies beside the scene. Fields with the default None stand
    in report.json only where the run has them.

    light: the kind of light in the photographs. start_kept: whether the
    surface on which training began replaced the trained one. mesh_steps: by name, in their order. settings: the whole
    `Config` as plain types. psnr_fg_test, psnr_fg_gain_test: PSNR, dB, on the object's pixels, as they are and after
    the best gain of each channel. psnr_whole_test: PSNR, dB, of the object before its background. views: the scores of
    each test view, by its name. material: the textured model's constants. inspection: the findings of the check before
    training.
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
    input: InputFacts | None = None
    light: str | None = None
    start_kept: bool | None = None
    mesh_steps: dict[str, MeshStepRun] | None = None
    reflection: Selection | None = None
    sh_degree: Selection | None = None
    settings: dict[str, Any] | None = None
    machine: MachineFacts | None = None
    time_budget: BudgetFacts | None = None
    psnr_fg_test: float | None = None
    psnr_fg_gain_test: float | None = None
    psnr_whole_test: float | None = None
    views: dict[str, dict[str, float]] | None = None
    split: SplitFacts | None = None
    material: dict[str, Any] | None = None
    inspection: dict[str, Any] | None = None

    def to_json(self) -> dict[str, Any]:
        """Return the object of report.json: only plain types, with None for numbers that are not finite."""
        plain = asdict(self)
        optional = {each.name: plain.pop(each.name) for each in fields(self) if each.default is None}
        if self.input is not None:
            optional["input"] = self.input.to_json()
        written: dict[str, Any] = finite({name: item for name, item in optional.items() if item is not None} | plain)
        return written

    @staticmethod
    def from_json(report: Mapping[str, Any]) -> ReportData:
        """Build the run from the JSON object of a report; entries without a field are left out.

        psnr_test, ssim_test, mesh and gt may be missing, which means None. Raises KeyError, with the name, where
        another field without default is missing, and TypeError where a part lacks one.
        """
        known: dict[str, Any] = {**dict.fromkeys(("psnr_test", "ssim_test", "mesh", "gt")), **report}
        for name in REQUIRED:
            if name not in known:
                raise KeyError(name)
        read: ReportData = _read(ReportData, known)
        return read


REQUIRED = (
    *("scene", "preset", "method", "device", "seed", "versions"),
    *("seconds", "iterations", "gaussians", "curve", "peak_memory_mib"),
)


def finite(value: Any) -> Any:
    """Return a copy of nested plain types with None for NaN and infinities, which JSON does not have."""
    if isinstance(value, Mapping):
        return {str(key): finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value


def _read(kind: Any, value: Any) -> Any:
    """Build a value of a type from plain types; entries that a dataclass does not know are left out."""
    inner = get_args(kind)
    if NoneType in inner:
        return None if value is None else _read(inner[0], value)
    if isinstance(kind, type) and is_dataclass(kind):
        hints = get_type_hints(kind)
        return kind(**{name: _read(hints[name], item) for name, item in value.items() if name in hints})
    if get_origin(kind) is list:
        return [_read(inner[0], item) for item in value]
    if get_origin(kind) is dict:
        return {name: _read(inner[1], item) for name, item in value.items()}
    return value
