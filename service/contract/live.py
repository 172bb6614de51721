"""The state of running jobs in Redis: leases, progress, events. It may be lost, because the store is authoritative."""

from __future__ import annotations

import json
from typing import Any

from redis import Redis
from redis.typing import EncodableT, FieldT

EVENTS_KEPT = 2000
LIVE_SECONDS = 7 * 86400

# Scripts are atomic. Between separate commands, a lease could expire or change its holder.
_TAKE = """
local holder = redis.call('get', KEYS[1])
if holder and holder ~= ARGV[1] then return 0 end
redis.call('set', KEYS[1], ARGV[1], 'PX', ARGV[2])
return 1
"""
_RELEASE = "if redis.call('get', KEYS[1]) == ARGV[1] then return redis.call('del', KEYS[1]) end return 0"


def lease_key(job: str) -> str:
    """Return the key of a job's lease, which the job's worker holds."""
    return f"mgsr:lease:{job}"


def progress_key(job: str) -> str:
    """Return the key of the job's last progress, as JSON."""
    return f"mgsr:progress:{job}"


def events_key(job: str) -> str:
    """Return the key of the stream of a job's events."""
    return f"mgsr:events:{job}"


def cancel_key(job: str, number: int) -> str:
    """Return the key that is set when round `number` should stop."""
    return f"mgsr:cancel:{job}.{number}"


class Live:
    """The state of running jobs. Every method raises redis.RedisError if the server doesn't answer."""

    def __init__(self, redis: Redis) -> None:
        self.redis = redis
        self._take = redis.register_script(_TAKE)
        self._release = redis.register_script(_RELEASE)

    def take_lease(self, job: str, holder: str, seconds: float) -> bool:
        """Take or renew the job's lease. Returns False if another holder has it.

        The lease lasts for `seconds` from now.
        """
        return bool(self._take(keys=[lease_key(job)], args=[holder, round(seconds * 1000)]))

    def release_lease(self, job: str, holder: str) -> None:
        """Release the lease if `holder` has it."""
        self._release(keys=[lease_key(job)], args=[holder])

    def leased(self, job: str) -> bool:
        """Return whether a worker works on the job."""
        return bool(self.redis.exists(lease_key(job)))

    def ask_cancel(self, job: str, number: int) -> None:
        """Tell the job's worker to stop it."""
        self.redis.set(cancel_key(job, number), 1, ex=LIVE_SECONDS)

    def cancel_asked(self, job: str, number: int) -> bool:
        """Return whether the job's worker should stop it."""
        return bool(self.redis.exists(cancel_key(job, number)))

    def progress(self, job: str) -> dict[str, Any]:
        """Return the job's last known progress."""
        found: dict[str, Any] = json.loads(self.redis.get(progress_key(job)) or "{}")
        return found

    def keep_progress(self, job: str, whole: dict[str, Any], change: dict[str, Any]) -> None:
        """Store the job's whole progress, and publish the change without the long curve."""
        self.redis.set(progress_key(job), json.dumps(whole), ex=LIVE_SECONDS)
        self.publish(job, "progress", {name: value for name, value in change.items() if name != "curve"})

    def forget(self, job: str) -> None:
        """Delete the state of a removed job."""
        self.redis.delete(progress_key(job), events_key(job))

    def publish(self, job: str, kind: str, data: dict[str, Any]) -> None:
        """Append an event to the job's stream."""
        entry: dict[FieldT, EncodableT] = {"event": kind, "data": json.dumps(data)}
        self.redis.xadd(events_key(job), entry, maxlen=EVENTS_KEPT, approximate=True)
        self.redis.expire(events_key(job), LIVE_SECONDS)
