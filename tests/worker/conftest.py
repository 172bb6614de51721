"""The captures and the service of the service's tests, for the worker's."""

from tests.service.conftest import stack, tiny_archive

__all__ = ["stack", "tiny_archive"]
