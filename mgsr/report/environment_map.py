"""Draw the environment maps that the surface reflects: the scene's map as a panorama, and the camera's map."""

from __future__ import annotations

import numpy as np
import torch
from torch.nn.functional import grid_sample

from mgsr.data.images import to_uint8
from mgsr.gaussians.environment_map import EnvironmentMap
from mgsr.renderers.environment_map import octahedral
from mgsr.report.pictures import Picture

HEIGHT = 180  # pixels
BRIGHTEST = 99.8  # percent of texels that are no brighter than white in the picture
DARK = 0.1  # of the other map's brightness; a darker map gets no picture


def environment_map_pictures(environment_map: EnvironmentMap, up: np.ndarray) -> list[Picture]:
    """Draw the environment maps, both brightened by the same factor so that lamps are white.

    The scene's map becomes a panorama with `up` [3] at the top. The camera's map shows the half towards the camera,
    with the camera in the middle. A map that is much darker than the other is left out.
    """
    still, held = environment_map.maps().detach()
    around = _looked_up(still, _around(np.asarray(up, np.float64)))
    disk, inside = _half()
    camera = _looked_up(held, disk) * inside[..., None]
    brightness = [float(np.percentile(image, BRIGHTEST)) for image in (around, camera)]
    white = max(*brightness, 1e-3)
    pictures = [
        Picture("all around the object", _picture(around / white)),
        Picture("at the camera", np.dstack([_picture(camera / white), np.where(inside, 255, 0).astype(np.uint8)])),
    ]
    return [picture for picture, own in zip(pictures, brightness, strict=True) if own >= DARK * white]


def _around(up: np.ndarray) -> np.ndarray:
    """Return the directions [H,2H,3] of an equirectangular picture: columns are longitudes, rows latitudes."""
    side = np.cross(up, np.eye(3)[np.abs(up).argmin()])
    side /= np.linalg.norm(side)
    rows, columns = (np.mgrid[:HEIGHT, : 2 * HEIGHT] + 0.5) / HEIGHT * np.pi
    flat = np.cos(columns)[..., None] * side + np.sin(columns)[..., None] * np.cross(up, side)
    directions: np.ndarray = np.cos(rows)[..., None] * up + np.sin(rows)[..., None] * flat
    return directions


def _half() -> tuple[np.ndarray, np.ndarray]:
    """Return the directions [H,H,3] of the half of a map around its middle, seen from afar, and its pixels [H,H]."""
    y, x = (np.mgrid[:HEIGHT, :HEIGHT] + 0.5) / HEIGHT * 2 - 1
    square = x * x + y * y
    return np.dstack([x, y, np.sqrt(np.maximum(1 - square, 0))]), square < 1


def _looked_up(light: torch.Tensor, directions: np.ndarray) -> np.ndarray:
    """Return the values of a map [3,S,S] at directions [H,W,3]."""
    height, width = directions.shape[:2]
    places = octahedral(torch.from_numpy(directions.reshape(-1, 3).T.astype(np.float32)))
    shown = grid_sample(light[None], places[None, None], padding_mode="border", align_corners=False)
    return shown[0, :, 0].T.reshape(height, width, 3).numpy()


def _picture(image: np.ndarray) -> np.ndarray:
    """Return an image [H,W,3] of 0..1 as uint8."""
    return to_uint8(np.clip(image, 0, 1) * 255)
