"""The kinds of light in a capture."""

from __future__ import annotations

from enum import StrEnum


class LightKind(StrEnum):
    """The kind of light in a capture.

    flash: a lamp on the camera. environment: static light that the surface mirrors. unknown: neither explains the
    photographs well enough.
    """

    FLASH = "flash"
    ENVIRONMENT = "environment"
    UNKNOWN = "unknown"
