"""Training of a scene's branches: the public interface of this package."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch

from mgsr.config import Config
from mgsr.data.scene import Scene
from mgsr.errors import GpuError, LostGpuError
from mgsr.gaussians.reflector import Reflector
from mgsr.geometry.mesh import Mesh
from mgsr.parallel import one_torch_thread
from mgsr.start.points import StartingPoints
from mgsr.training.checkpoint import fingerprint
from mgsr.training.control import TrainingControl
from mgsr.training.plan import make_plan
from mgsr.training.progress import TrainResult
from mgsr.training.stage_scheduler import FINISH
from mgsr.training.trainer import Trainer
from mgsr.training.views import CPU

# What torch raises once a GPU has failed; versions before 2.8 have no name for it.
GPU_FAILED: type[Exception] | tuple[()] = getattr(torch, "AcceleratorError", ())


@contextmanager
def gpu_explained() -> Iterator[None]:
    """Convert a GPU's errors inside the block into a GpuError or a LostGpuError that says what to do."""
    try:
        yield
    except torch.OutOfMemoryError as error:
        raise GpuError(
            f"the GPU's memory cannot hold this training ({error}); use smaller images (max_side=...), fewer splats "
            "(max_count=...) or --device cpu"
        ) from error
    except GPU_FAILED as error:
        reason = str(error).strip().splitlines()[0]
        raise LostGpuError(
            f"the GPU failed ({reason}), and its memory is lost; resume from the last checkpoint with --resume, or "
            "use --device cpu; if it fails again, report the output with CUDA_LAUNCH_BLOCKING=1"
        ) from error


class Training:
    """A scene's training, from starting points in the scene's frame.

    control: the callbacks, the checkpoint and the limits of the training.
    device: where images, masks and splats are kept; a GPU is much faster. The result is on the CPU, and a checkpoint
    serves any device.

    The run has one more stage, FINISH, in two cases: with a scheduler, or with an environment map that the finished
    mesh may reflect (`set_reflector`).

    The constructor and `run` raise these errors:

    - TrainingError: too few views or points, numbers that are not finite, or a branch without splats.
    - Cancelled: should_stop returned True.
    - CheckpointError: the checkpoint is damaged, or belongs to another scene or other settings.
    - GpuError: the GPU can't be used, or has too little memory for the scene.
    """

    def __init__(
        self,
        scene: Scene,
        start: StartingPoints,
        config: Config,
        control: TrainingControl = TrainingControl(),
        device: torch.device = CPU,
    ) -> None:
        with one_torch_thread(), gpu_explained():
            plan = make_plan(scene, start, config, device, finish=control.scheduler is not None)
            self._trainer = Trainer(plan, config.train, fingerprint(scene, config), control)
            if control.resume and control.checkpoint_path is not None and control.checkpoint_path.exists():
                self._trainer.resume()

    def set_reflector(self, mesh: Mesh) -> bool:
        """Attach the finished mesh, which reflects the environment map, and return whether the stage FINISH will run.

        mesh: in the scene's frame. Call this before that stage.
        """
        with one_torch_thread(), gpu_explained():
            return self._trainer.plan.set_reflector(Reflector(mesh))

    def run(self, finish: bool = True) -> TrainResult:
        """Train all stages and return the branches; without `finish`, stop before the stage FINISH.

        The stage FINISH has iterations only with a scheduler or after `set_reflector`.
        """
        plan, scheduled = self._trainer.plan, self._trainer.control.scheduler is not None
        with one_torch_thread(), gpu_explained():
            self._trainer.run(before=None if finish and (scheduled or plan.stages[-1].iterations) else FINISH)
        return _result(self._trainer)


def _result(trainer: Trainer) -> TrainResult:
    selection = trainer.plan.selection
    return TrainResult(
        model=trainer.plan.train_state.model.detached().to(CPU),
        stages=list(trainer.reports),
        curve=list(trainer.curve),
        seconds=trainer.seconds,
        incidents=list(trainer.incidents),
        tried={} if selection is None else selection.psnr,
        degrees={} if selection is None else selection.degrees,
    )
