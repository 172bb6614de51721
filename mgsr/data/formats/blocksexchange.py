"""BlocksExchange: the XML in which ContextCapture (iTwin Capture), Metashape, DJI Terra and others exchange cameras.

Source: Bentley's ContextCapture user guide, "BlocksExchange XML/XMLZ format" and its camera models. Rotations map
world coordinates to a camera's axes, which CameraOrientation names. The origin of pixel coordinates is the centre of
the upper left pixel.
"""

from __future__ import annotations

import math
import re
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from mgsr.data.capture import Capture, Format, Photo
from mgsr.data.lens import PANORAMA_CURE, PANORAMAS, Lens
from mgsr.data.number_lists import from_center, numbers, point_cloud
from mgsr.data.photo_files import SceneFolder
from mgsr.data.poses import intrinsics
from mgsr.data.scene import PointCloud
from mgsr.data.xml_files import read_xml
from mgsr.errors import SceneError

# These elements are skipped; they may be most of the file. In a very large file, tie points are skipped too.
_LEFT_OUT = ("Measurement", "Metadata", "ExifData", "ColorModel", "ControlPoints", "PositioningConstraints")
_TIE_POINTS_UP_TO = 300 << 20  # bytes
_COLOR = ("Red", "Green", "Blue")

# The directions of a camera's axes in the image. CameraOrientation combines one name of each table.
_AXES = {"XRight": (1, 0), "XLeft": (-1, 0), "XDown": (0, 1), "XUp": (0, -1)}
_SECOND_AXES = {name.replace("X", "Y"): axis for name, axis in _AXES.items()}
_ORIENTATION = re.compile(r"(X(?:Right|Left|Down|Up))(Y(?:Right|Left|Down|Up))")
# Systems of longitude and latitude: WGS 84 and others whose EPSG codes begin with 4. Geocentric systems have such codes
# too, but are Cartesian.
_GEOGRAPHIC = re.compile(r"EPSG:4\d{3}(?!\d)|WGS ?84$|GEOGCS|GEODCRS|\+proj=(?:longlat|latlong)", re.IGNORECASE)
_GEOCENTRIC = re.compile(r"EPSG:(?:4978|4936|4328|4896)(?!\d)|GEOCCS|PROJCS|PROJCRS", re.IGNORECASE)


def recognises(root: Path) -> str | None:
    """Return the folder's first .xml file with the header of the format."""
    paths = (path for path in sorted(root.glob("[!.]*.[xX][mM][lL]")) if path.is_file())
    return next((path.name for path in paths if _is_exchange(path)), None)


def read(folder: SceneFolder) -> Capture:
    """Read the tie points and all posed photographs of the block with the most photographs."""
    file = recognises(folder.root)
    assert file is not None, "read() accepts recognised folders only"
    path = folder.root / file
    with_points = path.stat().st_size <= _TIE_POINTS_UP_TO
    exchange = _plain(read_xml(path, _LEFT_OUT if with_points else (*_LEFT_OUT, "TiePoint")))
    block, entries = _block(exchange, file)
    found = folder.find_photos(file, [entry.path for entry in entries])
    capture = Capture.of(
        found, lambda i, path: _photo(path, entries[i], exchange, block, f"{file}, {str(entries[i].path)[:200]}")
    )
    notes = () if with_points else (f"the tie points of {file} are ignored because the file is very large",)
    return replace(capture, points=_points(block), notes=(*capture.notes, *notes), least_kept=0.25)


@dataclass(frozen=True)
class _BlockPhoto:
    """A photograph of a block.

    path: its path. photo: its element. group: the element of its photo group, which holds the camera. left_behind:
    whether the photograph is outside the block's main component, so it is not aligned with the others.
    """

    path: str
    photo: Element
    group: Element
    left_behind: bool


def _is_exchange(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            head = file.read(8192)
    except OSError:
        return False
    text = head.decode("utf-16" if head[:2] in (BOM_UTF16_LE, BOM_UTF16_BE) else "utf-8", "ignore")
    return re.search(r"<(?:\w+:)?BlocksExchange\b", text) is not None


def _plain(root: Element) -> Element:
    """Strip the namespaces from the tags of a tree in place, and return it."""
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]
    return root


def _block(exchange: Element, file: str) -> tuple[Element, list[_BlockPhoto]]:
    base = _text(exchange, "BaseImagePath")
    blocks = [(block, _entries(block, base)) for block in exchange.iterfind("Block")]
    block, entries = max(blocks, key=lambda item: len(item[1]), default=(exchange, []))
    if not entries:
        raise SceneError(f"{file}: it lists no photographs; align them and export the block again")
    return block, entries


def _entries(block: Element, base: str) -> list[_BlockPhoto]:
    pairs = [(photo, group) for group in block.iterfind("Photogroups/Photogroup") for photo in group.iterfind("Photo")]
    main = any(_text(photo, "Component") == "1" for photo, _ in pairs)
    return [
        _BlockPhoto(_joined(base, _text(photo, "ImagePath")), photo, group, main and _text(photo, "Component") == "0")
        for photo, group in pairs
    ]


def _joined(base: str, path: str) -> str:
    absolute = re.match(r"[/\\]|[A-Za-z]:|file:", path)
    return path if absolute or not base or not path else f"{base}/{path}"


def _text(element: Element | None, path: str) -> str:
    return "" if element is None else (element.findtext(path) or "").strip()


def _photo(image: Path, entry: _BlockPhoto, exchange: Element, block: Element, source: str) -> Photo:
    if entry.left_behind:
        raise SceneError(f"{source}: the photograph is outside the block's main component, so it is not aligned")
    pose = entry.photo.find("Pose")
    if pose is None or pose.find("Rotation") is None or pose.find("Center") is None:
        raise SceneError(f"{source}: it has no pose with Rotation and Center, so it is not aligned")
    _check_system(_text(entry.group, "SRSId") or _text(block, "SRSId"), exchange, source)
    K, lens, size = _camera(entry.group, source)
    rotation = _axes(entry.group, source).T @ _rotation(pose, source)
    center = np.array([_number(pose, f"Center/{axis}", source) for axis in "xyz"])
    return Photo(image, K, size, from_center(rotation, center), source, lens=None if lens.flat else lens)


def _check_system(system: str, exchange: Element, source: str) -> None:
    """Raise SceneError if positions are given as longitude and latitude."""
    for entry in exchange.iterfind("SpatialReferenceSystems/SRS"):
        definition = _text(entry, "Definition")
        is_geographic = _GEOGRAPHIC.search(definition) and not _GEOCENTRIC.search(definition)
        if system and _text(entry, "Id") == system and is_geographic:
            raise SceneError(
                f"{source}: its position is in longitude and latitude ({definition[:60]}); export it in a projected "
                "or local coordinate system (UTM, local east-north-up)"
            )


def _rotation(pose: Element, source: str) -> np.ndarray:
    """Return the rotation [3,3] from the world to the camera's axes.

    The file holds either a matrix, or omega, phi and kappa in degrees. Raises SceneError if it holds neither.
    """
    rotation = pose.find("Rotation")
    assert rotation is not None
    if rotation.find("M_00") is not None:
        values = [[_number(rotation, f"M_{row}{column}", source) for column in range(3)] for row in range(3)]
        return np.array(values)
    if rotation.find("Omega") is None:
        raise SceneError(f"{source}: its rotation is neither a matrix nor Omega, Phi and Kappa; export one of these")
    omega, phi, kappa = (math.radians(_number(rotation, name, source)) for name in ("Omega", "Phi", "Kappa"))
    about_x = [[1, 0, 0], [0, math.cos(omega), math.sin(omega)], [0, -math.sin(omega), math.cos(omega)]]
    about_y = [[math.cos(phi), 0, -math.sin(phi)], [0, 1, 0], [math.sin(phi), 0, math.cos(phi)]]
    about_z = [[math.cos(kappa), math.sin(kappa), 0], [-math.sin(kappa), math.cos(kappa), 0], [0, 0, 1]]
    matrix: np.ndarray = np.array(about_z) @ np.array(about_y) @ np.array(about_x)
    return matrix


def _axes(group: Element, source: str) -> np.ndarray:
    """Return the camera's axes in OpenCV's axes, as rows [3,3].

    A group without CameraOrientation has x right and y down. Raises SceneError for unknown names.
    """
    name = _text(group, "CameraOrientation") or "XRightYDown"
    match = _ORIENTATION.fullmatch(name)
    if match is None:
        raise SceneError(
            f"{source}: CameraOrientation: expected a value like XRightYDown, got {name[:80]!r}; fix the file"
        )
    x, y = (*_AXES[match[1]], 0), (*_SECOND_AXES[match[2]], 0)
    return np.array([x, y, np.cross(x, y)], np.float64)


def _camera(group: Element, source: str) -> tuple[np.ndarray, Lens, tuple[int, int]]:
    """Return the intrinsics [3,3], pixels, the lens, and the image size (width, height) of a photo group.

    Raises SceneError for camera types that are not supported.
    """
    kind = _text(group, "CameraModelType") or "Perspective"
    if kind.lower() in PANORAMAS:
        raise SceneError(f"{source}: camera type {kind} is not supported: {PANORAMA_CURE}")
    if kind not in ("Perspective", "Fisheye"):
        raise SceneError(f"{source}: camera type {kind[:80]!r} is not supported; expected Perspective or Fisheye")
    size = tuple(int(_number(group, f"ImageDimensions/{side}", source)) for side in ("Width", "Height"))
    width, height = size
    cx, cy = _principal_point(group, (width, height), source)
    if kind == "Fisheye":
        fx, fy, lens = _fisheye(group, source)
    else:
        fx, fy, lens = _perspective(group, max(width, height), source)
    return intrinsics(fx, fy, cx, cy), lens, (width, height)


def _perspective(group: Element, side: int, source: str) -> tuple[float, float, Lens]:
    """Return fx and fy in pixels, and the lens. The file's P1 and P2 are OpenCV's p2 and p1."""
    focal = _focal_length(group, side, source)
    ratio, skew = _number(group, "AspectRatio", source, 1.0), _number(group, "Skew", source, 0.0)
    if focal == 0:
        raise SceneError(f"{source}: expected a focal length above 0, got 0; export it again")
    k1, k2, k3, p1, p2 = (_number(group, f"Distortion/{name}", source, 0.0) for name in ("K1", "K2", "K3", "P1", "P2"))
    return focal, focal * ratio, Lens(k1, k2, p2, p1, higher=(k3,), skew=skew / focal)


def _focal_length(group: Element, side: int, source: str) -> float:
    """Return the focal length in pixels.

    side: the larger side of the image in pixels, to which SensorSize refers.
    """
    if group.find("FocalLengthPixels") is not None:
        return _number(group, "FocalLengthPixels", source)
    return _number(group, "FocalLength", source) / _pixel(group, side, source)


def _pixel(group: Element, side: int, source: str) -> float:
    """Return the size of a pixel in millimetres. Raises SceneError if it is not above 0."""
    given = group.find("PixelSize") is not None
    size = _number(group, "PixelSize", source) if given else _number(group, "SensorSize", source) / max(side, 1)
    if size <= 0:
        raise SceneError(f"{source}: expected SensorSize and PixelSize in millimetres, got {size:g}; export it again")
    return size


def _principal_point(group: Element, size: tuple[int, int], source: str) -> tuple[float, float]:
    """Return the principal point in pixels, with pixel centres at +0.5.

    The file gives it in pixels, in millimetres from the middle along the camera's axes, or not at all. A point at
    exactly half the image's sides comes from a program that counts from the corner, so it is the middle.
    """
    middle = size[0] / 2, size[1] / 2
    point = group.find("PrincipalPoint")
    if point is None:
        return middle
    if point.find("x") is not None:
        x, y = _number(point, "x", source), _number(point, "y", source)
        return middle if (x, y) == middle else (x + 0.5, y + 0.5)
    given = np.array([_number(point, "xmm", source), _number(point, "ymm", source), 0.0])
    right, down, _ = given @ _axes(group, source) / _pixel(group, max(size), source)
    return middle[0] + right, middle[1] + down


def _fisheye(group: Element, source: str) -> tuple[float, float, Lens]:
    """Return fx and fy in pixels, and the fisheye lens.

    The file's radius is a polynomial of the ray's angle, in units of 90 degrees, multiplied by the focal matrix. Raises
    SceneError for terms that MGSR's lens does not have.
    """
    f00, f01, f10, f11 = (_number(group, f"FisheyeFocalMatrix/M_{index}", source) for index in ("00", "01", "10", "11"))
    p0, p1, p2, p3, p4 = (
        _number(group, f"FisheyeDistortion/P{power}", source, float(power == 1)) for power in range(5)
    )
    if any((f01, f10, p0, p2, p4)) or p1 <= 0:
        raise SceneError(
            f"{source}: MGSR reads fisheye lenses only with a diagonal focal matrix and the terms P1 and P3; export "
            "undistorted photographs with their block"
        )
    per_radian = 2 / math.pi
    scale = p1 * per_radian
    return f00 * scale, f11 * scale, Lens(p3 / p1 * per_radian**2, fisheye=True)


def _number(element: Element, path: str, source: str, default: float | None = None) -> float:
    """Return the number in the element at `path`, or `default` if there is no such element."""
    text = element.findtext(path)
    if text is None and default is not None:
        return default
    return float(numbers([text or ""], 1, path, source)[0])


def _points(block: Element) -> PointCloud | None:
    """Return the tie points that have a position. Colours in the file range from 0 to 1."""
    places, colors = [], []
    for tie in block.iterfind("TiePoints/TiePoint"):
        position, color = tie.find("Position"), tie.find("Color")
        if position is not None:
            places.append([position.findtext(axis) or "" for axis in "xyz"])
            colors.append([math.nan if color is None else _shade(color.findtext(name)) for name in _COLOR])
    return point_cloud(places, colors)


def _shade(text: str | None) -> float:
    try:
        return 255 * float(text or "")
    except ValueError:
        return math.nan


FORMAT = Format(
    "blocksexchange", "an .xml of BlocksExchange (ContextCapture, Metashape, DJI Terra)", recognises, read, rank=140
)
