"""NeuS, IDR and their DTU scenes: cameras_sphere.npz with projection matrices, image/ and mask/."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.linalg import rq

from mgsr.data.capture import Capture, Format, Photo
from mgsr.data.files import images_below
from mgsr.data.images import image_size
from mgsr.data.mask_files import MaskIndex
from mgsr.data.npz import read_arrays
from mgsr.data.photo_files import FoundPhotos, SceneFolder
from mgsr.errors import SceneError, in_short

_FILES = ("cameras_sphere.npz", "cameras.npz")
_FOLDERS = ("image", "images")

# A matrix takes 256 bytes; the limit stops files that are made to fill the memory.
_MAX_MATRIX = 1 << 16
# Factorising a rounded projection matrix leaves up to this much skew, relative to the focal length: a tenth of a pixel.
_ROUNDING = 1e-4


def recognises(root: Path) -> str | None:
    """Return cameras_sphere.npz, else cameras.npz, else None."""
    return next((name for name in _FILES if (root / name).is_file()), None)


def read(folder: SceneFolder) -> Capture:
    """Read the photographs of image/ in the order of their names, with world_mat_0, world_mat_1, ..., in their frame.

    `scale_mat` holds the normalisation of other programs and is not needed. Raises SceneError if the numbers of images
    and cameras differ.
    """
    root, name = folder.root, recognises(folder.root)
    assert name is not None, "read() accepts recognised folders only"
    matrices = _matrices(root / name)
    images = _images(root, name)
    if len(images) != len(matrices):
        raise SceneError(
            f"{name}: it has {len(matrices)} cameras (world_mat_0...), but {images[0].parent.name}/ has {len(images)} "
            "images; provide one image per camera"
        )
    masks = _masks(folder, images)
    found = FoundPhotos(name, list(images))
    return Capture.of(found, lambda i, path: _photo(path, masks[i], matrices[i], f"{name}, world_mat_{i}"))


def _matrices(path: Path) -> list[np.ndarray]:
    """Return the consecutive matrices world_mat_0, world_mat_1, ..., each [3,4] or [4,4].

    Raises SceneError for damaged files.
    """
    try:
        arrays = read_arrays(path, largest=_MAX_MATRIX)
        count = sum(name.startswith("world_mat_") and name[10:].isdecimal() for name in arrays)
        return [arrays[f"world_mat_{i}"].astype(np.float64) for i in range(count)]
    except (ValueError, KeyError) as error:
        raise SceneError(
            f"{path.name}: the file is damaged or lacks world_mat_0, world_mat_1, ...: {in_short(error)}"
        ) from error


def _images(root: Path, name: str) -> list[Path]:
    folder = next((root / folder for folder in _FOLDERS if (root / folder).is_dir()), None)
    images = images_below(folder) if folder else []
    if not images:
        raise SceneError(
            f"{name}: there are no images in {' or '.join(f'{folder}/' for folder in _FOLDERS)}; copy them there"
        )
    return images


def _masks(folder: SceneFolder, images: list[Path]) -> list[Path | None]:
    """Find each image's mask by name, else by order, since DTU pairs 000000.png with 000.png."""
    index = MaskIndex(folder)
    masks = [index.find(image) for image in images]
    in_order = images_below(folder.root / "mask")
    if not any(masks) and len(in_order) == len(images):
        return list(in_order)
    return masks


def _photo(image: Path, mask: Path | None, matrix: np.ndarray, source: str) -> Photo:
    source = f"{source} ({image.name})"
    if matrix.shape not in ((3, 4), (4, 4)):
        raise SceneError(f"{source}: expected a 4x4 projection matrix, got shape {list(matrix.shape)}")
    K, pose = _factorise(matrix[:3], source)
    return Photo(image, K, image_size(image, source), pose, source, mask)


def _factorise(projection: np.ndarray, source: str) -> tuple[np.ndarray, np.ndarray]:
    """Return K [3,3] and cam_from_world [4,4] of a projection matrix [3,4] that is known up to a factor.

    Source: Hartley and Zisserman, 6.2.4. Raises SceneError if the matrix has NaN or is singular.
    """
    singular = SceneError(f"{source}: the projection matrix has NaN or is singular; export it again")
    with np.errstate(all="ignore"):  # damaged numbers are refused below
        determinant = np.linalg.det(projection[:, :3])
        if not np.isfinite(projection).all() or determinant == 0:
            raise singular
        projection = projection * np.sign(determinant)
        K, rotation = rq(projection[:, :3])
        turn = np.diag(np.sign(np.diag(K)))
        K, rotation = K @ turn, turn @ rotation
        pose = np.eye(4)
        try:
            pose[:3, :3], pose[:3, 3] = rotation, np.linalg.solve(K, projection[:, 3])
        except np.linalg.LinAlgError as error:
            raise singular from error
        K = K / K[2, 2]
    if abs(K[0, 1]) < _ROUNDING * K[0, 0]:
        K[0, 1] = 0
    # These matrices have pixel centres at 0; MGSR has them at +0.5.
    K[:2, 2] += 0.5
    return K, pose


FORMAT = Format("neus", f"{_FILES[0]} with image/ and mask/ (NeuS, DTU)", recognises, read, rank=60)
