"""EXIF of photographs: the camera, the lens and the focal length."""

from __future__ import annotations

import math
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mgsr.data.images import is_heif

# The diagonal of a frame of 36 x 24 mm, by which equivalent focal lengths are given (CIPA DCG-001), as COLMAP has it.
_DIAGONAL_35MM = 43.27
_LONGEST_SEGMENT = 65533


@dataclass(frozen=True)
class CameraTags:
    """A photograph's EXIF data on its camera; absent fields are empty or None.

    serial: the body's number. focal: mm. focal_35mm: mm, the focal length with the same view on a frame of 36 x 24 mm.
    zoom: the factor of the digital zoom.
    """

    make: str = ""
    model: str = ""
    lens: str = ""
    serial: str = ""
    focal: float | None = None
    focal_35mm: float | None = None
    zoom: float = 1.0

    @property
    def known(self) -> bool:
        """Return whether the EXIF says anything about the camera or its lens."""
        return self != CameraTags()

    @property
    def camera(self) -> str:
        """Return the camera's name for people, without a maker that the model's name already begins with."""
        maker = self.make.split(maxsplit=1)[:1]
        if maker and self.model.casefold().startswith(maker[0].casefold()):
            return self.model
        return f"{self.make} {self.model}".strip()

    def focal_pixels(self, size: tuple[int, int]) -> float | None:
        """Return the focal length in pixels of a photograph of a size (width, height), from the 35 mm equivalent.

        Returns None where the EXIF has no equivalent.
        """
        return None if self.focal_35mm is None else self.focal_35mm / _DIAGONAL_35MM * math.hypot(*size)


def read_tags(path: Path) -> CameraTags:
    """Read the EXIF of a photograph that can be decoded, without decoding it (Exif 2.32, 4.6)."""
    header = _heif_header(path) if is_heif(path) else _header(path)
    if header is None:
        return CameraTags()
    return CameraTags(
        make=_text(header, "Make"),
        model=_text(header, "Model"),
        lens=_text(header, "Exif:LensModel"),
        serial=_text(header, "Exif:BodySerialNumber"),
        focal=_length(header, "Exif:FocalLength"),
        focal_35mm=_length(header, "Exif:FocalLengthIn35mmFilm"),
        zoom=_length(header, "Exif:DigitalZoomRatio") or 1.0,
    )


def _header(path: Path) -> Any:
    """Return OpenImageIO's header of a file; None where the file can't be opened."""
    import OpenImageIO  # imported here, because training needs no OpenImageIO

    handle = OpenImageIO.ImageInput.open(str(path))
    if handle is None:
        OpenImageIO.geterror()  # clears the error, which it would otherwise print
        return None
    header = handle.spec()
    handle.close()
    return header


def _heif_header(path: Path) -> Any:
    """Return OpenImageIO's header of a one-pixel JPEG that carries a HEIC's EXIF.

    OpenImageIO reads EXIF from JPEG but not from HEIC. Returns None where the EXIF is missing or too long.
    """
    import cv2
    import pillow_heif

    exif = pillow_heif.open_heif(path).info.get("exif")
    if not exif or len(exif) > _LONGEST_SEGMENT:
        return None
    pixel = cv2.imencode(".jpg", np.zeros((1, 1, 3), np.uint8))[1].tobytes()
    segment = b"\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif  # APP1, Exif 2.32, 4.7.2
    with tempfile.TemporaryDirectory(prefix="mgsr-exif-") as folder:
        carrier = Path(folder, "exif.jpg")
        carrier.write_bytes(pixel[:2] + segment + pixel[2:])
        return _header(carrier)


def _text(header: Any, name: str) -> str:
    try:
        return " ".join(str(header.getattribute(name) or "").replace("\0", " ").split())
    except UnicodeDecodeError as error:  # cameras write names in encodings of their own
        return error.object.decode(errors="replace").strip()


def _length(header: Any, name: str) -> float | None:
    """Return a header's number if it is finite and above 0, else None: cameras write 0 for unknown values."""
    value = header.getattribute(name)
    return float(value) if isinstance(value, (int, float)) and math.isfinite(value) and value > 0 else None
