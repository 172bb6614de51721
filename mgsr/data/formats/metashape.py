"""Agisoft Metashape: the XML of "Export Cameras", and the photographs.

Source: Metashape's user manual, appendix "Camera models", and its forum's notes on the XML.
"""

from __future__ import annotations

from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from mgsr.data.capture import Capture, Format, Photo
from mgsr.data.files import ImageIndex
from mgsr.data.lens import PANORAMA_CURE, PANORAMAS, Lens
from mgsr.data.poses import check_pose, intrinsics
from mgsr.data.registration import check_share
from mgsr.errors import SceneError, in_short

_LENSES = {"frame": False, "fisheye": True}
_SLAVES = (
    "are slaves of multi-camera systems, which is not supported: add the photographs to Metashape as single cameras, "
    "align and export them again"
)
_TERMS = ("f", "cx", "cy", "k1", "k2", "k3", "k4", "p1", "p2", "b1", "b2")


def recognises(root: Path) -> str | None:
    """The first .xml of the folder that begins as Metashape's documents do and has cameras, else the first that
    begins so."""
    paths = (path for path in sorted(root.glob("[!.]*.xml")) if path.is_file())
    documents = [path for path in paths if _is_document(path)]
    best = min(documents, key=lambda path: not _has_cameras(path), default=None)
    return best.name if best else None


def read(root: Path) -> Capture:
    """Every aligned camera's photograph, found by its label anywhere in the folder, in the chunk's world frame.

    Slaves of multi-camera systems are left out: their sensors say where they stand from a master, in a convention that
    no export has confirmed yet. Raises SceneError where fewer than half of the cameras are used.
    """
    name = recognises(root)
    assert name is not None, "read() is for folders that were recognised"
    chunk = _chunk(root / name)
    index, sensors, worlds = ImageIndex(root), _by_id(chunk, "sensors/sensor"), _worlds(chunk)
    cameras = [camera for camera in chunk.iterfind("cameras//camera") if camera.get("enabled") not in ("0", "false")]
    photos, missing = [], []
    for camera in cameras:
        label = camera.get("label") or ""
        source = f"{name}, camera {label[:80]!r}"
        image = index.find(label, source)
        if image is None:
            missing.append(label)
        elif camera.find("transform") is not None and not _is_slave(camera):
            sensor = sensors.get(camera.get("sensor_id"))
            photos.append(_photo(image, camera, sensor, _world(camera, worlds, source), source))
    slaves = sum(_is_slave(camera) for camera in cameras)
    cure = _cure(root, slaves, missing)
    notes = check_share(len(photos), len(cameras), 0.5, f"are aligned in {name} and there", cure, missing)
    return Capture(photos, notes=(*notes, f"{slaves} of the others {_SLAVES}") if slaves else notes)


def _is_slave(camera: Element) -> bool:
    return camera.get("master_id") not in (None, camera.get("id"))


def _cure(root: Path, slaves: int, missing: list[str]) -> str:
    """What to do where most cameras can't be used."""
    if slaves:
        return f"{slaves} {_SLAVES}"
    if missing:
        return f"put the photographs into {root.name} under the names of the cameras, in any folder of it"
    return "align the cameras in Metashape and export them again"


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
    """XML's text: UTF-16 with a byte order mark, or UTF-8."""
    return data.decode("utf-16" if data[:2] in (BOM_UTF16_LE, BOM_UTF16_BE) else "utf-8-sig", errors)


def _chunk(path: Path) -> Element:
    try:
        text = _decoded(path.read_bytes())
        if "<!DOCTYPE" in text or "<!ENTITY" in text:
            raise SceneError(f"{path.name}: has a DOCTYPE, which Metashape doesn't write; refused")
        chunk = ElementTree.fromstring(text).find("chunk")
    except (ElementTree.ParseError, OSError, RecursionError, ValueError, LookupError) as error:
        raise SceneError(f"{path.name}: not valid XML: {in_short(error)}; export it again") from error
    if chunk is None:
        raise SceneError(f"{path.name}: no chunk in the document; export the cameras again")
    return chunk


def _by_id(chunk: Element, path: str) -> dict[str | None, Element]:
    return {item.get("id"): item for item in chunk.iterfind(path)}


def _worlds(chunk: Element) -> dict[str | None, Element]:
    """Where the components of the chunk, and (by None) the chunk itself, say how they lie in the world."""
    found = {item.get("id"): item.find("transform") for item in chunk.iterfind("components/component")}
    return {key: item for key, item in (found | {None: chunk.find("transform")}).items() if item is not None}


def _world(camera: Element, worlds: dict[str | None, Element], source: str) -> tuple[np.ndarray, np.ndarray, float]:
    """Rotation [3,3], translation [3] and scale from the camera's component to the world."""
    item = worlds.get(camera.get("component_id"), worlds.get(None))
    if item is None:
        return np.eye(3), np.zeros(3), 1.0
    rotation = _numbers(item, "rotation", 9, source, np.eye(3).ravel()).reshape(3, 3)
    scale = float(_numbers(item, "scale", 1, source, np.ones(1))[0])
    if scale <= 0:
        raise SceneError(f"{source}: the chunk's scale is {scale:g}; expected a number above 0")
    return rotation, _numbers(item, "translation", 3, source, np.zeros(3)), scale


def _photo(
    image: Path,
    camera: Element,
    sensor: Element | None,
    world: tuple[np.ndarray, np.ndarray, float],
    source: str,
) -> Photo:
    K, lens, size = _intrinsics(sensor, source)
    pose = check_pose(_numbers(camera, "transform", 16, source).reshape(4, 4), source)
    rotation, translation, scale = world
    turned = rotation @ pose[:3, :3]
    cam_from_world = np.eye(4)
    cam_from_world[:3, :3] = turned.T
    cam_from_world[:3, 3] = -turned.T @ (scale * rotation @ pose[:3, 3] + translation)
    return Photo(image, K, size, cam_from_world, source, lens=lens)


def _intrinsics(sensor: Element | None, source: str) -> tuple[np.ndarray, Lens | None, tuple[int, int]]:
    """The adjusted calibration, else the first one. Metashape's p1 and p2 are OpenCV's p2 and p1."""
    if sensor is None:
        raise SceneError(f"{source}: its sensor is not in the file; export the cameras again")
    found = sensor.findall("calibration")
    item = next((entry for entry in found if entry.get("class") == "adjusted"), found[0] if found else None)
    kind = (None if item is None else item.get("type")) or sensor.get("type") or ""
    if kind in PANORAMAS:  # these have no calibration, as there is nothing to calibrate
        raise SceneError(f"{source}: camera type {kind!r} is not supported: {PANORAMA_CURE}")
    if kind not in _LENSES:
        raise SceneError(f"{source}: camera type {kind!r} is not supported; expected one of {', '.join(_LENSES)}")
    if item is None:
        raise SceneError(f"{source}: its sensor has no calibration; export the cameras again")
    for name in ("p3", "p4"):
        value = _numbers(item, name, 1, source, np.zeros(1))[0]
        if value:
            raise SceneError(
                f"{source}: distortion {name} is {value:g}, which is not supported; optimise the cameras in Metashape "
                "without p3 and p4, and export them again"
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
    """The numbers of an element's child; `default` where there is no such child."""
    child = item.find(name)
    if child is None and default is not None:
        return default
    text = "" if child is None else child.text or ""
    try:
        values = np.array(text.split(), dtype=np.float64)
    except ValueError:
        values = np.zeros(0)
    if len(values) != count or not np.isfinite(values).all():
        raise SceneError(f"{source}: {name}: expected {count} numbers, got {text.strip()[:80]!r}")
    return values


FORMAT = Format("metashape", "an .xml with cameras and sensors (Metashape)", recognises, read, rank=85)
