"""A capture whose images are larger than the memory that they may take."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from mgsr.config import DataConfig
from mgsr.data import loading
from mgsr.data.capture import Photo
from mgsr.data.loading import LoadedView, load_views
from mgsr.data.pixels import PixelStore
from mgsr.parallel import core_count

COUNT = 1000
WIDTH, HEIGHT = 1633, 1225  # 2 megapixels, 6 MB
MEMORY = 256 << 20
# A photograph in work in each thread: decoded, with what the decoder needs, and copied.
IN_WORK = min(loading._MOST_THREADS, core_count(None)) * (48 << 20)

STATUS = Path("/proc/self/status")


def own_memory() -> int:
    """Return the bytes of this process's memory that lie in no file; the system can drop pages of files."""
    line = next(line for line in STATUS.read_text().splitlines() if line.startswith("RssAnon:"))
    return int(line.split()[1]) * 1024


@contextmanager
def most_memory() -> Iterator[list[int]]:
    """Yield a list whose one number is the peak memory held inside, beyond what was held before."""
    before, most, done = own_memory(), [0], threading.Event()

    def watch() -> None:
        while not done.wait(0.02):
            most[0] = max(most[0], own_memory() - before)

    watcher = threading.Thread(target=watch)
    watcher.start()
    try:
        yield most
    finally:
        done.set()
        watcher.join()


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.skipif(not STATUS.exists(), reason="memory is measured by Linux's /proc")
def test_a_thousand_photographs_in_bounded_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    coarse = np.random.default_rng(3).integers(0, 256, (24, 32, 3), dtype=np.uint8)
    Image.fromarray(coarse).resize((WIDTH, HEIGHT), Image.Resampling.BICUBIC).save(tmp_path / "0000.jpg")
    images = [tmp_path / f"{number:04d}.jpg" for number in range(COUNT)]
    for image in images[1:]:
        os.link(images[0], image)
    K = np.array([[WIDTH, 0, WIDTH / 2], [0, WIDTH, HEIGHT / 2], [0, 0, 1.0]])
    photos = [Photo(image, K, (WIDTH, HEIGHT), np.eye(4), image.name) for image in images]
    monkeypatch.setattr(loading, "PixelStore", lambda: PixelStore(memory=MEMORY))
    monkeypatch.setattr(loading, "_REPORT_EVERY", 0.0)
    reported: list[tuple[int, int]] = []
    with most_memory() as most:
        loaded = load_views(
            photos, [image.stem for image in images], DataConfig(max_side=4000), lambda *now: reported.append(now)
        )
    assert most[0] < MEMORY + IN_WORK < COUNT * WIDTH * HEIGHT * 3 / 4
    assert reported == [(number, COUNT) for number in range(1, COUNT + 1)]
    views = [item.view for item in loaded if isinstance(item, LoadedView)]
    assert [view.name for view in views] == [image.stem for image in images]
    for place in (0, COUNT // 2, -1):
        np.testing.assert_array_equal(views[place].image, views[0].image)
    print(f"{COUNT} images of {WIDTH}x{HEIGHT}: {most[0] / 2**20:.0f} MiB at most")
