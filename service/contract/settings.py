"""The settings of service and worker, read from the environment: MGSR_STORE is `store`, and so on."""

from __future__ import annotations

import os
from pathlib import Path

from pydantic import ByteSize, Field
from pydantic_settings import BaseSettings, SettingsConfigDict

from service.contract.errors import SetupError

GIB = 1 << 30


def default_home() -> Path:
    """Return the folder in which a user's own service keeps its data: ~/.local/share/mgsr, by the XDG rules."""
    return Path(os.environ.get("XDG_DATA_HOME") or Path.home() / ".local/share") / "mgsr"


def machine_memory() -> int:
    """Return the memory in bytes of this machine, or of this process's container."""
    physical = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    try:
        limit = Path("/sys/fs/cgroup/memory.max").read_text().strip()
    except OSError:
        return physical
    return min(physical, int(limit)) if limit.isdigit() else physical


class Settings(BaseSettings):
    """The settings of service and worker. Sizes are in bytes and may have a unit (8GiB); times are in seconds."""

    model_config = SettingsConfigDict(env_prefix="MGSR_", frozen=True)

    home: Path = Field(default_factory=default_home)
    redis_url: str | None = None  # the queue's server; none: `mgsr serve` starts one
    store: str | None = None  # a folder or s3://bucket/prefix; none: home/store
    scratch: Path | None = None  # the folder in which workers unpack and train; none: home/scratch
    signed_urls: bool = True  # whether callers get results directly from a bucket (307), not through the service
    allowed_hosts: str = ""  # comma-separated host names under which a service without keys may be addressed

    max_upload: ByteSize = ByteSize(8 * GIB)
    upload_idle: float = 30.0  # time without a byte after which an upload is stopped
    upload_grace: float = 30.0  # time before the rate of an upload is checked
    upload_rate: ByteSize = ByteSize(1024)  # least average rate of an upload, per second
    upload_lifetime: float = 24 * 3600.0  # time from the last byte of a resumable upload to its deletion
    min_free_disk: ByteSize = ByteSize(GIB)  # free space that a submit and a run must leave
    max_open_jobs: int = 1000  # most jobs of one owner that are queued, running or being uploaded
    max_stored: ByteSize | None = None  # most data of one owner's jobs and uploads, with results; none: no limit
    retention: float | None = Field(default=None, gt=0)  # time from a job's end to its deletion; none: jobs stay

    max_members: int = 20_000  # most files in an archive
    max_unpacked: ByteSize = ByteSize(32 * GIB)
    max_ratio: float = 200.0  # largest ratio of an archive's unpacked to packed bytes, checked from 64 MiB on
    max_pixels: int = 120_000_000  # most pixels of one image

    job_deadline: float = 12 * 3600.0  # the default deadline of a job, and the largest that a job may name
    job_memory: ByteSize = Field(default_factory=lambda: ByteSize(int(machine_memory() * 0.8)))
    checkpoint_seconds: float = 20.0  # time between two checkpoints
    stop_grace: float = 20.0  # time in which a job must write its checkpoint before it is killed
    lease: float = 15.0  # time after which a silent worker counts as dead
    max_attempts: int = 6  # attempts of a submit or retry that may die before the job counts as failed
    webhook_private: bool = False  # whether webhooks may go to this machine and its network
    publish_patience: float = 900.0  # time for which a worker tries to send results to a store that doesn't answer

    def need_redis(self) -> str:
        """Return the queue server's address. Raises SetupError if none is set."""
        if self.redis_url is None:
            raise SetupError(
                "MGSR_REDIS_URL is not set; set it to the address of the Redis server (redis://host:6379/0), or use "
                "`mgsr serve`, which starts its own server and worker"
            )
        return self.redis_url

    @property
    def store_url(self) -> str:
        """Return the store's folder or address."""
        return self.store or str(self.home / "store")

    @property
    def scratch_folder(self) -> Path:
        """Return the folder for the attempts' files."""
        return self.scratch or self.home / "scratch"
