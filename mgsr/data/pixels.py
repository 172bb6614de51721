"""Where a scene's images lie: in memory, or beyond a limit in memory-mapped files."""

from __future__ import annotations

import tempfile
import threading

import numpy as np

# Images up to this total stay in memory. A run on 1,000 photographs of 2 megapixels then fits in 12 GiB, although the
# photographs with their masks take 8 GB.
MEMORY_BYTES = 4 << 30

# The least size of a file; each file holds many images.
_FILE_BYTES = 1 << 30
_ALIGNED = 64  # alignment of arrays in a file, bytes


class PixelStore:
    """Holds decoded images. Its files have no names and vanish with their last array. Many threads may share it."""

    def __init__(self, memory: int = MEMORY_BYTES, file: int = _FILE_BYTES) -> None:
        self._memory, self._file = memory, file
        self._lock = threading.Lock()
        self._mapped = np.empty(0, np.uint8)
        self._used = 0

    def hold(self, array: np.ndarray) -> np.ndarray:
        """Return the array [...] itself while memory remains, else a copy in a mapped file; both are writable."""
        with self._lock:
            if array.nbytes <= self._memory:
                self._memory -= array.nbytes
                return array
            if self._used + array.nbytes > len(self._mapped):
                self._mapped, self._used = _map_file(max(self._file, array.nbytes)), 0
            place = self._mapped[self._used : self._used + array.nbytes].view(array.dtype).reshape(array.shape)
            self._used += -(-array.nbytes // _ALIGNED) * _ALIGNED
        place[...] = array
        return place


def _map_file(size: int) -> np.ndarray:
    """Return bytes [size] uint8 that lie in a temporary file in place of memory."""
    with tempfile.TemporaryFile(prefix="mgsr-pixels-") as file:
        file.truncate(size)  # a sparse file: it takes no disk space before it is written
        return np.asarray(np.memmap(file, np.uint8, "r+", shape=(size,)))
