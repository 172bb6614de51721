"""A cache of compiled kernels on disk. If its folder can't be used, kernels are compiled at every start."""

from __future__ import annotations

import hashlib
import logging
import threading
from functools import cache
from pathlib import Path

log = logging.getLogger("mgsr.cuda")

DIGEST_BYTES = hashlib.sha256().digest_size


@cache
def kernel_cache(folder: Path | None) -> KernelCache:
    """Return the cache in a folder, which is made once per process.

    It is shared so that it warns only once if the folder can't be used.
    """
    return KernelCache(folder)


class KernelCache:
    """A cache of machine code by key, on disk.

    Processes may share the folder, because files are written atomically. A file ends with a hash of its key and its
    code. A file that is truncated, altered or renamed is therefore a miss, and is replaced. The hash comes last, so
    that NVIDIA's tools can read the files.

    folder: created if it is missing; None disables the cache. No method raises. The first error of the file system is
    logged.
    """

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder
        self._warned = False
        self._lock = threading.Lock()

    def get(self, key: bytes) -> bytes | None:
        """Return the machine code of a key, or None if there is no intact file of it."""
        from cuda.core.utils import FileStreamProgramCache

        if self._folder is None:
            return None
        try:
            with FileStreamProgramCache(self._folder) as files:
                stored = files.get(key)
        except OSError as error:
            self._warn(error)
            return None
        code, digest = (stored[:-DIGEST_BYTES], stored[-DIGEST_BYTES:]) if stored else (b"", b"")
        return code if digest == _digest(key, code) else None

    def put(self, key: bytes, code: bytes) -> None:
        """Store the machine code of a key, replacing any code stored before."""
        from cuda.core.utils import FileStreamProgramCache

        if self._folder is None:
            self._warn("there is no home folder")
            return
        try:
            with FileStreamProgramCache(self._folder) as files:
                files[key] = code + _digest(key, code)
        except OSError as error:
            self._warn(error)

    def _warn(self, reason: object) -> None:
        with self._lock:
            warned, self._warned = self._warned, True
        if not warned:
            log.warning(
                "compiled CUDA kernels cannot be kept in %s (%s), so every start compiles them again; set "
                "MGSR_CUDA_CACHE to a writable folder",
                self._folder or "a separate folder",
                reason,
            )


def _digest(key: bytes, code: bytes) -> bytes:
    return hashlib.sha256(key + code).digest()
