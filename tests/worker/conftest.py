"""The captures of the service's tests, for the worker's."""

from tests.service.conftest import tiny_archive

__all__ = ["tiny_archive"]
