"""Start one worker in this process, or one per GPU."""

from __future__ import annotations

import logging
import os
import signal
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress

from service.contract.children import Child, Stop, keep_alive, stop_on_signals
from service.contract.queue import CPU, GPU
from service.contract.settings import Settings
from worker.gpus import all_gpus
from worker.rq_worker import work

# Names a child's GPU, so that the child does not start children too.
_GPU = "MGSR_WORKER_GPU"


def start_workers(gpus: str | None) -> None:
    """Process jobs until a signal.

    gpus: "all", or GPUs by number or uuid, as in CUDA_VISIBLE_DEVICES; None means the CPU. Raises SetupError if there
    is no such GPU.
    """
    if _GPU in os.environ:
        _work(on_gpu=True)
    elif gpus is None:
        _work(on_gpu=False)
    else:
        _one_for_each(_gpus(gpus))


def _work(on_gpu: bool) -> None:
    settings = Settings()
    settings.need_redis()
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(name)s %(message)s")
    work([GPU, CPU] if on_gpu else [CPU], settings)


def _one_for_each(gpus: list[str]) -> None:
    """Run a worker for each GPU, restarted if it dies, until a signal to this process ends all of them."""
    settings = Settings()
    settings.need_redis()
    children = [
        Child(
            f"worker of GPU {gpu}",
            [sys.executable, "-m", "worker.cli"],
            {_GPU: gpu, "CUDA_VISIBLE_DEVICES": gpu},
            settings.stop_grace + 10.0,
        )
        for gpu in gpus
    ]
    stop_on_signals()
    try:
        with suppress(Stop):
            for child in children:
                child.start()
            keep_alive(children)
    finally:
        for number in (signal.SIGTERM, signal.SIGINT):  # further signals must not interrupt the end
            signal.signal(number, signal.SIG_IGN)
        # The workers stop simultaneously, because each may have to write a checkpoint.
        with ThreadPoolExecutor(len(children)) as pool:
            list(pool.map(lambda child: child.stop(at_once=False), children))


def _gpus(gpus: str) -> list[str]:
    return all_gpus() if gpus == "all" else [gpu.strip() for gpu in gpus.split(",")]
