"""Keep a job's lease while its worker is alive."""

from __future__ import annotations

import threading
from types import TracebackType

from redis import RedisError

from service.contract.live import Live


class LeaseKeeper:
    """A context manager that renews a lease in a thread, so that no upload and no slow store lets it expire.

    While Redis is unavailable, no other worker can take the lease. If Redis returns without the lease, the keeper takes
    it again.
    """

    def __init__(self, live: Live, job: str, holder: str, seconds: float) -> None:
        self._live, self._job, self._holder, self._seconds = live, job, holder, seconds
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._keep, daemon=True, name="lease")
        self.lost = False  # whether another worker has taken the job

    def __enter__(self) -> LeaseKeeper:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._done.set()
        self._thread.join()
        try:
            self._live.release_lease(self._job, self._holder)
        except RedisError:
            return  # the lease expires by itself

    def _keep(self) -> None:
        while not self._done.wait(min(3.0, self._seconds / 5)):
            try:
                self.lost = not self._live.take_lease(self._job, self._holder, self._seconds)
            except RedisError:
                continue
