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
from worker.cards import all_cards
from worker.rq_worker import work

# Names a child's card, so that the child does not start children too.
_CARD = "MGSR_WORKER_CARD"


def start_workers(gpus: str | None) -> None:
    """Process jobs until a signal.

    gpus: "all", or GPUs by number or uuid, as in CUDA_VISIBLE_DEVICES; None means the CPU. Raises SetupError if there
    is no such GPU.
    """
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
    """Run a worker for each card, restarted if it dies, until a signal to this process ends all of them."""
    settings = Settings()
    settings.need_redis()
    children = [
        Child(
            f"worker of card {card}",
            [sys.executable, "-m", "worker.cli"],
            {_CARD: card, "CUDA_VISIBLE_DEVICES": card},
            settings.stop_grace + 10.0,
        )
        for card in cards
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


def _cards(gpus: str) -> list[str]:
    return all_cards() if gpus == "all" else [card.strip() for card in gpus.split(",")]
