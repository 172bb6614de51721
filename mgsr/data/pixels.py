"""Where a scene's decoded images lie: in memory, or past a limit in a file that the system pages in and out."""

from __future__ import annotations

import tempfile
import threading

import numpy as np

# Images up to this lie in memory. 1,000 photographs of 2 megapixels take 6 GB.
MEMORY_BYTES = 8 << 30

# A block holds many images, so that small ones don't cost a page each.
_BLOCK = 256 << 20


class PixelStore:
    """Hands out arrays from large blocks, which live as long as any array of theirs. For many threads at once."""

    def __init__(self, memory: int = MEMORY_BYTES, block: int = _BLOCK) -> None:
        self._memory, self._block_size = memory, block
        self._lock = threading.Lock()
        self._block = np.empty(0, np.uint8)
        self._used = 0

    def hold(self, image: np.ndarray) -> np.ndarray:
        """A copy of an uint8 array, in the store."""
        with self._lock:
            if self._used + image.nbytes > len(self._block):
                self._begin_block(max(self._block_size, image.nbytes))
            place = self._block[self._used : self._used + image.nbytes].reshape(image.shape)
            self._used += image.nbytes
        place[...] = image
        return place

    def _begin_block(self, size: int) -> None:
        self._used = 0
        if size <= self._memory:
            self._memory -= size
            # Memory that is never written to is never taken from the system.
            self._block = np.empty(size, np.uint8)
            return
        with tempfile.TemporaryFile(prefix="mgsr-pixels-") as file:
            file.truncate(size)
            # The mapping keeps the file alive, which has no name any more: it is gone with the last array.
            self._block = np.asarray(np.memmap(file, np.uint8, "r+", shape=(size,)))
