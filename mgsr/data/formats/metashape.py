"""Agisoft Metashape: the XML of "Export Cameras", and the photographs.

Source: Metashape's user manual, appendix "Camera models", and its forum's notes on the XML.
"""

from __future__ import annotations

from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from mgsr.data.capture import Capture, Format, Photo
from mgsr.data.files import text_number
from mgsr.data.lens import PANORAMA_CURE, PANORAMAS, Lens
from mgsr.data.photo_files import SceneFolder
from mgsr.data.poses import intrinsics, rigid, split_pose
from mgsr.errors import SceneError, in_short

_LENSES = {"frame": False, "fisheye": True}
_SLAVE = (
    "part of a multi-camera system, which is not supported; add the photographs to Metashape as single cameras, align "
    "them and export them again"
)
_TERMS = ("f", "cx", "cy", "k1", "k2", "k3", "k4", "p1", "p2", "b1", "b2")


def recognises(root: Path) -> str | None:
    """Return the folder's first .xml file that begins like a Metashape document; files with cameras come first."""
    paths = (path for path in sorted(root.glob("[!.]*.[xX][mM][lL]")) if path.is_file())
    documents = [path for path in paths if _is_document(path)]
    best = min(documents, key=lambda path: not _has_cameras(path), default=None)
    return best.name if best else None


def read(folder: SceneFolder) -> Capture:
    """Read every enabled camera, in the chunk's world frame.

    A camera's label names its photograph, which may lie anywhere in the folder. If labels repeat, the labels of the
    camera's groups name the photograph's folder. Slaves of multi-camera systems are left out. Their sensors give their
    place relative to a master, in a convention that no known export confirms.
    """
    name = recognises(folder.root)
    assert name is not None, "read() accepts recognised folders only"
    chunk = _chunk(folder.root / name)
    sensors, worlds = _by_id(chunk, "sensors/sensor"), _worlds(chunk)
    cameras = [(camera, label) for camera, label in _cameras(chunk) if camera.get("enabled") not in ("0", "false")]

    def build(i: int, image: Path) -> Photo:
        camera, label = cameras[i]
        source = f"{name}, camera {label[:80]!r}"
        return _photo(image, camera, sensors.get(camera.get("sensor_id")), _world(camera, worlds, source), source)

    return Capture.of(folder.find_photos(name, [label for _, label in cameras], labels=True), build)


def _cameras(chunk: Element) -> Iterator[tuple[Element, str]]:
    """Yield all cameras in the order of the file, each with its path: the labels of its groups, then its own."""
    waiting = [(item, "") for item in reversed(chunk.findall("cameras"))]
    while waiting:
        item, path = waiting.pop()
        label = item.get("label") or ""
        if item.tag == "camera":
            yield item, path + label
        else:
            inner = f"{path}{label}/" if label else path
            waiting += [(child, inner) for child in reversed(item) if child.tag in ("camera", "group")]


def _is_slave(camera: Element) -> bool:
    return camera.get("master_id") not in (None, camera.get("id"))


def _is_document(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            head = _decoded(file.read(8192), errors="ignore")
    except OSError:
        return False
    return "<document" in head and "<chunk" in head


def _has_cameras(path: Path) -> bool:
    try:
        return "<camera " in _decoded(path.read_bytes(), errors="ignore")
    except OSError:
        return False


def _decoded(data: bytes, errors: str = "strict") -> str:
    """Decode an XML document: UTF-16 with a byte order mark, or UTF-8."""
    return data.decode("utf-16" if data[:2] in (BOM_UTF16_LE, BOM_UTF16_BE) else "utf-8-sig", errors)


def _chunk(path: Path) -> Element:
    try:
        text = _decoded(path.read_bytes())
        if "<!DOCTYPE" in text or "<!ENTITY" in text:
            raise SceneError(f"{path.name}: the file has a DOCTYPE, which Metashape never writes; MGSR refuses it")
        chunk = ElementTree.fromstring(text).find("chunk")
    except (ElementTree.ParseError, OSError, RecursionError, ValueError, LookupError) as error:
        raise SceneError(f"{path.name}: not valid XML: {in_short(error)}; export it again") from error
    if chunk is None:
        raise SceneError(f"{path.name}: the document has no chunk; export the cameras again")
    return chunk


def _by_id(chunk: Element, path: str) -> dict[str | None, Element]:
    return {item.get("id"): item for item in chunk.iterfind(path)}


def _worlds(chunk: Element) -> dict[str | None, Element]:
    """Return the world transforms of the chunk's components by their ids. The key None stands for the chunk itself."""
    found = {item.get("id"): item.find("transform") for item in chunk.iterfind("components/component")}
    return {key: item for key, item in (found | {None: chunk.find("transform")}).items() if item is not None}


def _world(camera: Element, worlds: dict[str | None, Element], source: str) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the rotation [3,3], translation [3] and scale from the camera's component to the world.

    Raises SceneError if the scale is not above 0.
    """
    item = worlds.get(camera.get("component_id"), worlds.get(None))
    if item is None:
        return np.eye(3), np.zeros(3), 1.0
    rotation = _numbers(item, "rotation", 9, source, np.eye(3).ravel()).reshape(3, 3)
    scale = float(_numbers(item, "scale", 1, source, np.ones(1))[0])
    if scale <= 0:
        raise SceneError(f"{source}: expected a scale of the chunk above 0, got {scale:g}")
    return rotation, _numbers(item, "translation", 3, source, np.zeros(3)), scale


def _photo(
    image: Path,
    camera: Element,
    sensor: Element | None,
    world: tuple[np.ndarray, np.ndarray, float],
    source: str,
) -> Photo:
    if camera.find("transform") is None:
        raise SceneError(
            f"{source}: the photograph is not aligned; align the cameras in Metashape and export them again"
        )
    if _is_slave(camera):
        raise SceneError(f"{source}: it is {_SLAVE}")
    K, lens, size = _intrinsics(sensor, source)
    own, center, _ = split_pose(_numbers(camera, "transform", 16, source).reshape(4, 4), source)
    rotation, translation, scale = world
    turned = rotation @ own
    pose = rigid(turned.T, -turned.T @ (scale * rotation @ center + translation))
    return Photo(image, K, size, pose, source, lens=lens)


def _intrinsics(sensor: Element | None, source: str) -> tuple[np.ndarray, Lens | None, tuple[int, int]]:
    """Return K [3,3] in pixels, the lens, and the image size (width, height).

    They come from the adjusted calibration, or else from the first one. Metashape's p1 and p2 are OpenCV's p2 and p1.
    Raises SceneError for a missing calibration, and for unsupported camera types and terms.
    """
    if sensor is None:
        raise SceneError(f"{source}: the file lacks its sensor; export the cameras again")
    found = sensor.findall("calibration")
    item = next((entry for entry in found if entry.get("class") == "adjusted"), found[0] if found else None)
    kind = (None if item is None else item.get("type")) or sensor.get("type") or ""
    if kind in PANORAMAS:  # checked before the calibration, because panoramas have none
        raise SceneError(f"{source}: camera type {kind!r} is not supported: {PANORAMA_CURE}")
    if kind not in _LENSES:
        raise SceneError(f"{source}: camera type {kind!r} is not supported; expected one of {', '.join(_LENSES)}")
    if item is None:
        raise SceneError(f"{source}: its sensor has no calibration; export the cameras again")
    for name in ("p3", "p4"):
        value = _numbers(item, name, 1, source, np.zeros(1))[0]
        if value:
            raise SceneError(
                f"{source}: distortion {name} is {value:g}, but MGSR supports only 0; optimise the cameras in "
                "Metashape without p3 and p4, and export them again"
            )
    size = _size(item.find("resolution"), sensor.find("resolution"), source)
    f, cx, cy, k1, k2, k3, k4, p1, p2, b1, b2 = (
        float(_numbers(item, name, 1, source, None if name == "f" else np.zeros(1))[0]) for name in _TERMS
    )
    skew = b2 / (f + b1) if f + b1 else 0.0
    lens = Lens(k1, k2, p2, p1, (k3, k4), skew=skew, fisheye=_LENSES[kind])
    K = intrinsics(f + b1, f, size[0] / 2 + cx, size[1] / 2 + cy)
    return K, None if lens.flat else lens, size


def _size(own: Element | None, shared: Element | None, source: str) -> tuple[int, int]:
    item = own if own is not None else shared
    values = ("", "") if item is None else (item.get("width", ""), item.get("height", ""))
    if not all(value.isdecimal() and len(value) < 10 for value in values):
        raise SceneError(f"{source}: resolution: expected width and height in pixels, got {values}")
    return int(values[0]), int(values[1])


def _numbers(item: Element, name: str, count: int, source: str, default: np.ndarray | None = None) -> np.ndarray:
    """Return the finite numbers [count] in an element's child, or `default` if there is no such child.

    Raises SceneError for anything else.
    """
    child = item.find(name)
    if child is None and default is not None:
        return default
    text = "" if child is None else child.text or ""
    try:
        values = np.array([text_number(word) for word in text.split()])
    except ValueError:
        values = np.zeros(0)
    if len(values) != count or not np.isfinite(values).all():
        raise SceneError(f"{source}: {name}: expected {count} numbers, got {text.strip()[:80]!r}")
    return values


FORMAT = Format("metashape", "an .xml with cameras and sensors (Metashape)", recognises, read, rank=85)
