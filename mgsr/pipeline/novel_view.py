"""Rendering of a reconstruction from any camera."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mgsr.data.camera import Camera
from mgsr.data.scene import View
from mgsr.errors import ConfigError, TensorError
from mgsr.export.renders import Rendering
from mgsr.pipeline.reconstruction import Reconstruction
from mgsr.pipeline.rendering import render_camera

# The largest deviation of a pose's rotation matrix from a rotation. Files keep seven digits.
_RIGID = 1e-4


def render(result: Reconstruction, camera: Camera | View) -> Rendering:
    """Render the splats of a reconstruction on the device where they are (see `Reconstruction.to`).

    camera: a camera in the capture's frame and unit, at any size, or a View of the reconstructed scene. A View is
    rendered as its photograph was taken; its camera is in the scene's normalised frame. The images are float32, depth
    is in the capture's unit, and normals are unit vectors.

    Raises ConfigError for an argument of another type, and for a View if an object was found. Raises TensorError for
    an invalid camera: a pose that is not rigid, numbers that are not finite, or an empty image.
    """
    if not isinstance(result, Reconstruction):
        raise ConfigError(f"result: expected a Reconstruction, got {type(result).__name__}")
    if isinstance(camera, View):
        if result.paths.object.is_file():
            raise ConfigError(
                "camera: the View is in the frame of the whole scene, but the found object has its own frame; use "
                "scene.user_from_scene.camera_to_user(view.camera)"
            )
        seen_by = camera.camera
    elif isinstance(camera, Camera):
        seen_by = result.normalisation.camera_to_scene(_checked(camera))
    else:
        raise ConfigError(f"camera: expected a Camera or a View, got {type(camera).__name__}")
    flash = result.normalised_flash
    shading = None if flash is None else flash.seen_by(seen_by)
    images = render_camera(result.normalised_model, seen_by, result.surface_depth, shading)
    shown = images.straight(result.normalisation.scale)
    return replace(shown, depth=shown.depth.astype(np.float32), normal=_unit(images.normal))


def _checked(camera: Camera) -> Camera:
    """Return the camera with float64 arrays. Raises TensorError if it is invalid."""
    K, pose = np.asarray(camera.K, np.float64), np.asarray(camera.cam_from_world, np.float64)
    for name, array, shape in (("K", K, (3, 3)), ("cam_from_world", pose, (4, 4))):
        if array.shape != shape or not np.isfinite(array).all():
            raise TensorError(f"camera.{name}: expected {list(shape)} of finite numbers, got {array.tolist()}")
    rotation = pose[:3, :3]
    if not np.allclose(rotation @ rotation.T, np.eye(3), atol=_RIGID) or np.linalg.det(rotation) < 0:
        raise TensorError(f"camera.cam_from_world: expected a rotation and a translation, got {pose.tolist()}")
    if min(K[0, 0], K[1, 1]) <= 0 or min(camera.width, camera.height) < 1:
        raise TensorError(
            f"camera: expected focal lengths above 0 and an image of at least 1 x 1 pixels, got {K[0, 0]:g} and "
            f"{K[1, 1]:g}, {camera.width} x {camera.height}"
        )
    return Camera(K, pose, int(camera.width), int(camera.height))


def _unit(normal: np.ndarray) -> np.ndarray:
    """Return unit normals [H,W,3] float32; 0 stays 0."""
    lengths = np.linalg.norm(normal, axis=-1, keepdims=True)
    return np.where(lengths > 0, normal / np.maximum(lengths, 1e-12), 0).astype(np.float32)
