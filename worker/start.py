"""Starts one worker in this process, or one for each card."""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import sys
from pathlib import Path
from types import FrameType

from service.contract.errors import SetupError
from service.contract.queue import CPU, GPU
from service.contract.settings import Settings
from worker.rq_worker import work

# Tells a child which card is its own, so that it starts no children again.
_CARD = "MGSR_WORKER_CARD"
# The driver's own list of cards: asking CUDA would load it into this process.
_DRIVERS_LIST = Path("/proc/driver/nvidia/gpus")


def start_workers(gpus: str | None) -> None:
    """Work until a signal. gpus: "all", or numbers of cards; None: on the CPU. Raises SetupError."""
    if _CARD in os.environ:
        _work(on_card=True)
    elif gpus is None:
        _work(on_card=False)
    else:
        _one_for_each(_cards(gpus))


def _work(on_card: bool) -> None:
    settings = Settings()
    settings.need_redis()
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(name)s %(message)s")
    work([GPU, CPU] if on_card else [CPU], settings)


def _one_for_each(cards: list[str]) -> None:
    """A child for each card; a signal to this process goes to all of them."""
    command = [sys.executable, "-m", "service.contract.lifeline", str(os.getpid()), sys.executable, "-m", "worker.cli"]
    children = [
        subprocess.Popen(command, env=os.environ | {_CARD: card, "CUDA_VISIBLE_DEVICES": card}) for card in cards
    ]

    def pass_on(number: int, frame: FrameType | None) -> None:
        for child in children:
            child.send_signal(number)

    signal.signal(signal.SIGTERM, pass_on)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal sends it to the children too
    if any([child.wait() for child in children]):
        raise SetupError("a worker ended by an error; see above")


def _cards(gpus: str) -> list[str]:
    if gpus != "all":
        return [card.strip() for card in gpus.split(",")]
    visible = os.environ.get("CUDA_VISIBLE_DEVICES")
    cards = [str(i) for i, _ in enumerate(_DRIVERS_LIST.glob("*"))] if visible is None else visible.split(",")
    if not any(cards):
        raise SetupError("--gpus all: no NVIDIA driver or card on this machine; leave it out to work on the CPU")
    return cards
