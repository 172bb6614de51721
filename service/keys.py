"""Bearer keys. The store holds only their SHA-256, so a key is shown only once, when it is created."""

from __future__ import annotations

import hashlib
import secrets
import time
from datetime import datetime

from service.contract.records import Document, now
from service.contract.store import Store

CACHE_SECONDS = 5.0


class Key(Document):
    """The record of a key. id: the owner of jobs that are submitted with the key."""

    id: str
    name: str
    created: datetime


class Keys:
    """The keys of one store, cached for a few seconds."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._known: dict[str, tuple[float, Key | None]] = {}
        self._any: tuple[float, bool] = (float("-inf"), False)

    def create(self, name: str) -> tuple[str, Key]:
        """Create a key, and return its token and its record."""
        token = "mgsr_" + secrets.token_urlsafe(32)
        key = Key(id=secrets.token_hex(8), name=name, created=now())
        self._store.create(_path(token), key.to_bytes())
        return token, key

    def all(self) -> list[Key]:
        """Return every key, the oldest first."""
        found = [self._store.read(entry.key) for entry in self._store.entries("keys")]
        return sorted(
            (Key.model_validate_json(data) for data in found if data is not None), key=lambda key: key.created
        )

    def revoke(self, key_id: str) -> bool:
        """Revoke a key by its id, and return whether it existed."""
        for entry in list(self._store.entries("keys")):
            data = self._store.read(entry.key)
            if data is not None and Key.model_validate_json(data).id == key_id:
                self._store.delete(entry.key)
                return True
        return False

    def find(self, token: str) -> Key | None:
        """Return the key of a caller's token, or None if it is unknown."""
        path = _path(token)
        read_at, key = self._known.get(path, (float("-inf"), None))
        if time.monotonic() - read_at > CACHE_SECONDS:
            data = self._store.read(path)
            key = None if data is None else Key.model_validate_json(data)
            if len(self._known) > 10_000:  # this many tokens can only be guesses
                self._known.clear()
            self._known[path] = (time.monotonic(), key)
        return key

    def cached(self, token: str) -> Key | None:
        """Return the result of `find` if it is cached, else None."""
        read_at, key = self._known.get(_path(token), (float("-inf"), None))
        return key if time.monotonic() - read_at <= CACHE_SECONDS else None

    def needed(self) -> bool:
        """Return whether callers must show a key.

        They must as soon as this process has seen a key, so that a service does not become open when its last key is
        revoked.
        """
        read_at, found = self._any
        if not found and time.monotonic() - read_at > CACHE_SECONDS:
            found = next(iter(self._store.entries("keys")), None) is not None
            self._any = (time.monotonic(), found)
        return found

    @property
    def needed_cached(self) -> bool | None:
        """Return the result of `needed` if it is cached, else None."""
        read_at, found = self._any
        return found if found or time.monotonic() - read_at <= CACHE_SECONDS else None


def _path(token: str) -> str:
    return f"keys/{hashlib.sha256(token.encode()).hexdigest()}.json"
