"""RealityCapture / RealityScan: the .xmp files that it writes beside the photographs ("Metadata (XMP)").

Source: "RealityCapture XMP Camera Math" in its knowledge base. The rotation maps the world to the camera's axes, and is
written row by row. The position is the camera's centre. The focal length refers to film 36 mm wide. The principal
point is relative to the middle of the image, in units of its larger side. RealityCapture also adds its values to .xmp
files of other programs, as attributes or as elements.
"""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from mgsr.data.capture import Capture, Format, Photo
from mgsr.data.images import image_size
from mgsr.data.lens import Lens
from mgsr.data.number_lists import from_center, numbers
from mgsr.data.photo_files import SceneFolder
from mgsr.data.poses import intrinsics
from mgsr.data.xml_files import read_xml
from mgsr.errors import SceneError

_MARK = b"capturingreality.com/ns/xcr"
_POSE = re.compile(rb"\bPosition\b")
_HEAD = 1 << 18  # bytes that are searched, as the metadata is near the beginning
_LOOKED_AT = 100
_FILM = 36.0
_BROWN = ("brown3", "brown4", "brown3t2", "brown4t2")


def recognises(root: Path) -> str | None:
    """Return the folder's first .xmp file with a pose; else the first in its subfolders, if two or more have one."""
    if found := _first(root):
        return found.name
    try:
        folders = sorted(path for path in root.iterdir() if path.is_dir() and not path.name.startswith("."))
    except OSError:
        return None
    inner = [found for folder in folders if (found := _first(folder))]
    return inner[0].relative_to(root).as_posix() if len(inner) > 1 else None


def read(folder: SceneFolder) -> Capture:
    """Read every photograph that has an .xmp file of RealityCapture beside it."""
    sidecars = [path for path in _sidecars(folder.root) if _is_camera(path)]
    names = [path.relative_to(folder.root).with_suffix("").as_posix() for path in sidecars]
    found = folder.find_photos("the .xmp files", names, labels=True)
    return Capture.of(found, lambda i, path: _photo(path, sidecars[i], folder.shown(sidecars[i])))


def _first(folder: Path) -> Path | None:
    paths = sorted(folder.glob("[!.]*.[xX][mM][pP]"))[:_LOOKED_AT]
    return next((path for path in paths if _is_camera(path, _POSE)), None)


def _sidecars(root: Path) -> list[Path]:
    """Return every .xmp file of the folder, or of its subfolders if none of the folder has a camera."""
    direct = sorted(root.glob("[!.]*.[xX][mM][pP]"))
    return direct if _first(root) else sorted(root.glob("[!.]*/[!.]*.[xX][mM][pP]"))


def _is_camera(path: Path, also: re.Pattern[bytes] = re.compile(b"")) -> bool:
    """Return whether the file has RealityCapture's values and matches `also`."""
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD).replace(b"\0", b"")  # so that UTF-16 reads like ASCII
    except OSError:
        return False
    return _MARK in head and also.search(head) is not None


def _photo(image: Path, sidecar: Path, source: str) -> Photo:
    values = _values(read_xml(sidecar))
    if "Position" not in values or "Rotation" not in values:
        raise SceneError(f"{source}: it has no Position and Rotation, so the photograph is not aligned")
    size = image_size(image, source)
    side = max(size)
    focal = _number(values, "FocalLength35mm", source) / _FILM * side
    u, v = (_number(values, f"PrincipalPoint{axis}", source, 0.0) * side for axis in "UV")
    if _number(values, "Skew", source, 0.0):
        raise SceneError(f"{source}: Skew is {values['Skew'][:20]}, but MGSR supports only 0; align without skew")
    lens = _lens(values, source)
    rotation = numbers(values["Rotation"], 9, "Rotation", source).reshape(3, 3)
    return Photo(
        image=image,
        K=intrinsics(focal, focal * _number(values, "AspectRatio", source, 1.0), size[0] / 2 + u, size[1] / 2 + v),
        size=size,
        cam_from_world=from_center(rotation, numbers(values["Position"], 3, "Position", source)),
        source=source,
        lens=None if lens.flat else lens,
    )


def _values(root: Element) -> dict[str, str]:
    """Return RealityCapture's values by their names, from attributes and from elements."""
    found: dict[str, str] = {}
    for element in root.iter():
        for tag, text in ((element.tag, element.text or ""), *element.attrib.items()):
            space, _, name = tag.rpartition("}")
            if _MARK.decode() in space:
                found.setdefault(name, text.strip())
    return found


def _number(values: dict[str, str], name: str, source: str, default: float | None = None) -> float:
    if name not in values and default is not None:
        return default
    return float(numbers([values.get(name, "")], 1, name, source)[0])


def _lens(values: dict[str, str], source: str) -> Lens:
    """Return the lens. Raises SceneError for unsupported models.

    The file's tangential terms are OpenCV's p2 and p1, in this order.
    """
    text = values.get("DistortionCoeficients", values.get("DistortionCoefficients", ""))
    terms = numbers(text, len(text.split()), "DistortionCoeficients", source)
    model = values.get("DistortionModel", "perspective").lower()
    if model == "perspective" or not terms.any():
        return Lens()
    if model not in _BROWN or len(terms) > 6:
        raise SceneError(
            f"{source}: distortion model {model[:40]!r} with {len(terms)} values is not supported; choose Brown in the "
            "alignment settings, align again and export again"
        )
    k1, k2, k3, k4, t1, t2 = np.pad(terms, (0, 6 - len(terms))).tolist()
    return Lens(k1, k2, p1=t2, p2=t1, higher=(k3, k4))


FORMAT = Format("realitycapture_xmp", ".xmp files with cameras beside the photographs", recognises, read, rank=150)
