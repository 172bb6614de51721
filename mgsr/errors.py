"""The errors that MGSR raises. Each message names the thing, what was expected, what came, and what to do."""


class MgsrError(Exception):
    """Anything that MGSR refuses or can't do; its text is meant for the user."""

    code = "error"


class SceneError(MgsrError):
    """The input capture can't be used: a missing file, a bad pose, too few views."""

    code = "bad_scene"


class MissingPhotoError(SceneError):
    """A photograph that a file of the scene names is not there."""


class ArchiveError(SceneError):
    """An archive is refused.

    code: archive_unsupported, archive_damaged, archive_unsafe_member, archive_too_many_members, archive_too_large or
    archive_ratio; for one of its images image_too_large.
    """

    def __init__(self, code: str, message: str) -> None:
        super().__init__(message)
        self.code = code


class ConfigError(MgsrError, ValueError):
    """An option doesn't exist or its value is out of range."""

    code = "bad_option"


class TensorError(MgsrError, ValueError):
    """An argument has the wrong shape, dtype, device or range."""

    code = "bad_tensor"


class CheckpointError(MgsrError):
    """A checkpoint can't be read or belongs to another scene or configuration."""

    code = "bad_checkpoint"


class TrainingError(MgsrError):
    """Training can't go on."""

    code = "training_failed"


class GpuError(MgsrError):
    """The GPU can't be used: no or an old driver, an unsupported GPU, too little memory."""

    code = "gpu_failed"


class LostGpuError(GpuError):
    """The GPU failed and answers nothing any more in this process.

    Even taking down torch's tensors ends the process with an abort, so that it is best left by `os._exit`.
    """


class MeshError(MgsrError):
    """No usable surface came out; the text says why."""

    code = "empty_mesh"


class Cancelled(MgsrError):
    """The caller asked to stop; a checkpoint was written first."""

    code = "cancelled"


def in_short(reason: object) -> str:
    """Shorten what another library says, for a message of ours: its first line, cut where it gets long.

    Some put thousands of lines, or bytes of the file, into theirs.
    """
    line = next(iter(str(reason).strip().splitlines()), "")
    return line if len(line) <= 200 else f"{line[:200]}..."
