"""What a run's caller controls, and what the parts of a run share."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from mgsr.budget.budget import TimeBudget
from mgsr.config import Config
from mgsr.data.scene import Scene
from mgsr.gaussians.trained_model import TrainedModel
from mgsr.inspection.findings import Inspection
from mgsr.pipeline import result_files
from mgsr.pipeline.device import Device
from mgsr.pipeline.progress import EventCallback, ignore
from mgsr.pipeline.steps import Steps, StopCheck, never
from mgsr.start.points import StartingPoints
from mgsr.training.progress import TrainResult


@dataclass(frozen=True)
class RunControl:
    """The caller's control of a run.

    resume: continue from the checkpoint in the folder of the results, if there is one.
    progress: called with each event.
    should_stop: called between iterations and between steps. Once it returns True, the run raises Cancelled.
    started_at: the value of time.perf_counter() from which a time budget (config.time_budget) counts; None is now.
    reuse_object: if an object is looked for, take the masks that a run with the same settings of `data` left in the
    folder of the results, if there are any.
    """

    resume: bool = False
    progress: EventCallback = ignore
    should_stop: StopCheck = never
    started_at: float | None = None
    reuse_object: bool = False


@dataclass(frozen=True)
class RunContext:
    """The objects that the parts of a run share once its starting points are known."""

    scene: Scene
    start: StartingPoints
    config: Config
    out: Path
    step: Steps
    device: Device
    budget: TimeBudget | None = None
    inspection: Inspection | None = None

    def model(self, trained: TrainResult) -> TrainedModel:
        """Return the trained model on the device, with the background of a found object."""
        model = result_files.with_background(self.out, trained.model, self.scene.user_from_scene)
        return model.to(self.device.torch)
