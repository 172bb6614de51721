"""Rendering of the trained branches: the test views for the user, the training views for the surface."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from mgsr.config import Config, MeshColor, SurfaceDepth
from mgsr.config.expert import MeshOptions
from mgsr.data.backdrop import Color
from mgsr.data.camera import Camera
from mgsr.data.images import to_uint8
from mgsr.data.masks import leave_borders_free, with_masks
from mgsr.data.pixels import PixelStore
from mgsr.data.scene import Scene, View
from mgsr.data.silhouettes import Silhouette, view_silhouettes
from mgsr.export.renders import Rendering, on_background, straight_color
from mgsr.gaussians.trained_model import TrainedModel
from mgsr.mesh.cameras import surface_cameras
from mgsr.mesh.views import SurfaceView
from mgsr.ops.depth_normals import depth_to_normals
from mgsr.renderers.both import render_both
from mgsr.renderers.gaussians import render_gaussians
from mgsr.renderers.outputs import GaussianOutputs, SurfelOutputs
from mgsr.renderers.surfels import render_surfels


@dataclass(frozen=True)
class RenderedView:
    """One camera's images, float32, rendered over black, so colours are premultiplied by alpha.

    color [H,W,3], alpha [H,W]: the object.
    depth [H,W]: camera z in the scene's unit; 0 where nothing is.
    normal [H,W,3]: in the world frame, towards the camera, of length alpha.
    transmitted [H,W,3], reflected [H,W,3], weight [H,W]: None without a light split.
    unlit [H,W,3]: the transmitted colour under even light, or the colour without a light split; None without a flash.
    whole [H,W,3]: the object before its background; None if no object was found.
    """

    name: str
    camera: Camera
    color: np.ndarray
    alpha: np.ndarray
    depth: np.ndarray
    normal: np.ndarray
    transmitted: np.ndarray | None = None
    reflected: np.ndarray | None = None
    weight: np.ndarray | None = None
    unlit: np.ndarray | None = None
    whole: np.ndarray | None = None

    def straight(self, unit: float) -> Rendering:
        """Return the images with straight colours and with depth times `unit`, which converts the scene's unit."""
        color = straight_color(self.color, self.alpha)
        transmitted, unlit = (
            None if each is None else straight_color(each, self.alpha) for each in (self.transmitted, self.unlit)
        )
        light = (transmitted, self.reflected, self.weight, unlit)
        whole = None if self.whole is None else np.clip(self.whole, 0, 1)
        return Rendering(color, self.alpha, self.depth * unit, self.normal, *light, whole)


def render_views(model: TrainedModel, views: Sequence[View], config: Config) -> Iterator[RenderedView]:
    """Render the branches from each view's camera, one after the other.

    The 3D branch gives the colours, and the 2D branch depth and normal. A single branch gives all of them.
    """
    for view in views:
        yield render_camera(model, view.camera, config.train.paper.surface_depth, view.irradiance, view.name)


@torch.no_grad()
def render_camera(
    model: TrainedModel, camera: Camera, depth: SurfaceDepth, shading: np.ndarray | None = None, name: str = ""
) -> RenderedView:
    """Render the branches from any camera in their frame.

    depth: the kind of the 2D branch's depth that defines the surface. shading [H,W] uint8: the flash's shading of the
    view (see `View`); None is even light.
    """
    images = _render_object(model, camera, depth, shading, name)
    if model.background is None:
        return images
    color = torch.tensor(model.background_color, device=model.device)
    behind = _numpy(render_gaussians(model.background, camera, color).color)
    return replace(images, whole=images.color + (1 - images.alpha[..., None]) * behind)


def _render_object(
    model: TrainedModel, camera: Camera, depth: SurfaceDepth, shading: np.ndarray | None, name: str
) -> RenderedView:
    """Render the branches, without a background; the arguments are those of `render_camera`."""
    light = None if shading is None else torch.from_numpy(shading).to(model.device) / 255
    flat, full = render_both(model, camera, depth=True, shading=light)
    images = _surface(flat, full, camera, depth)
    if full is None:
        assert flat is not None
        unlit = None if flat.unlit is None else _numpy(flat.unlit)
        return RenderedView(name, camera, _numpy(flat.color), _numpy(flat.alpha), *images, unlit=unlit)
    transmitted = None if full.reflected is None else full.transmitted
    lights = (transmitted, full.reflected, full.weight, full.unlit)
    shown = (_numpy(full.color), _numpy(full.alpha), *images)
    return RenderedView(name, camera, *shown, *(None if each is None else _numpy(each) for each in lights))


def surface_views(model: TrainedModel, scene: Scene, config: Config) -> list[SurfaceView]:
    """Render the views for surface extraction.

    The cameras are the training cameras and the intermediate ones that `config.mesh` asks for. Invalid pixels of
    photographs are left out, because no loss supervised them.
    """
    cameras = surface_cameras([view.camera for view in scene.train], config.mesh)
    valid = [view.valid_mask for view in scene.train] + [None] * (len(cameras) - len(scene.train))
    if config.mesh.color is MeshColor.TRANSMITTED:
        model = replace(model, environment_map=None)  # its reflection would take time and not be seen
    with torch.no_grad():
        return [
            _surface_view(model, camera, config, _resized(shown, camera))
            for camera, shown in zip(cameras, valid, strict=True)
        ]


def rendered_scene(model: TrainedModel, scene: Scene, config: Config) -> Scene:
    """Replace the scene's photographs, and its masks if it has any, by renders.

    If there is a light split and `mesh.color` asks for it, the renders show transmitted light, without highlights.
    """
    behind = scene.backdrop(config.train.background).color
    return replace(
        scene,
        train=[_as_photograph(model, view, config, behind) for view in scene.train],
        test=[_as_photograph(model, view, config, behind) for view in scene.test],
    )


def _as_photograph(model: TrainedModel, view: View, config: Config, behind: Color) -> View:
    (images,) = render_views(model, [view], config)
    color = images.color
    if images.transmitted is not None and config.mesh.color is MeshColor.TRANSMITTED:
        color = images.transmitted
    if view.alpha is None:
        return replace(view, image=to_uint8(on_background(color, images.alpha, behind) * 255))
    pixels = to_uint8(straight_color(color, images.alpha) * 255)
    return replace(view, image=pixels, alpha=to_uint8(images.alpha * 255))


def masked_scene(model: TrainedModel, scene: Scene, config: Config) -> Scene:
    """Return the scene with the masks for surface extraction: its own, or the opacity of the branch that renders.

    Before a plain backdrop, opacity covers only the object. Inexact masks err differently in each photograph. The 3D
    branch learned from all of them, so its opacity errs less and agrees between the views. All other scenes are
    unchanged: those with exact masks, those without masks or backdrop, and inexact masks without a 3D branch.
    """
    inexact = scene.masks_inexact and model.gaussians is not None
    if not (inexact or scene.backdrop(config.train.background).plain):
        return scene
    store = PixelStore()
    with torch.no_grad():
        masks = [store.hold(to_uint8(255 * _opacity(model, view.camera))) for view in scene.train]
    return with_masks(scene, masks) if inexact or leave_borders_free(masks, scene.options.mask_use) else scene


def scene_silhouettes(scene: Scene, side: int = MeshOptions().mask_side) -> list[Silhouette]:
    """Return the silhouettes of the training photographs' masks; an empty list without masks."""
    if not scene.masked:
        return []
    return view_silhouettes(scene.train, side)


def _opacity(model: TrainedModel, camera: Camera) -> np.ndarray:
    """Return the alpha [H,W] of the branch that renders."""
    if model.gaussians is not None:
        return _numpy(render_gaussians(model.gaussians, camera, depth=False).alpha)
    assert model.surfels is not None
    return _numpy(render_surfels(model.surfels, camera).alpha)


def _resized(valid: np.ndarray | None, camera: Camera) -> np.ndarray | None:
    """Resample valid pixels [H,W] bool to a camera of another image size; None stays None."""
    if valid is None:
        return None
    rows = (np.arange(camera.height) + 0.5) * valid.shape[0] / camera.height
    columns = (np.arange(camera.width) + 0.5) * valid.shape[1] / camera.width
    return np.asarray(valid[np.ix_(rows.astype(np.intp), columns.astype(np.intp))])


def _surface_view(model: TrainedModel, camera: Camera, config: Config, mask: np.ndarray | None) -> SurfaceView:
    """Render what a camera shows of the surface, with the photograph's mask [H,W] or None."""
    flat, full = render_both(model, camera, depth=model.surfels is None)
    depth, normal = _surface(flat, full, camera, config.train.paper.surface_depth)
    shape = flat if flat is not None else full
    assert shape is not None
    return SurfaceView(camera, depth, normal, _numpy(shape.alpha), _surface_color(flat, full, config.mesh.color), mask)


def _surface(
    flat: SurfelOutputs | None, full: GaussianOutputs | None, camera: Camera, kind: SurfaceDepth
) -> tuple[np.ndarray, np.ndarray]:
    """Return depth [H,W] and normal [H,W,3] of the 2D branch; if there is none, of the 3D branch's depth."""
    if flat is not None:
        median = kind is SurfaceDepth.MEDIAN
        return _numpy(flat.median_depth if median else flat.depth), _numpy(flat.normal)
    assert full is not None and full.depth is not None
    return _numpy(full.depth), _numpy(depth_to_normals(full.depth, camera, full.alpha))


def _surface_color(flat: SurfelOutputs | None, full: GaussianOutputs | None, kind: MeshColor) -> np.ndarray:
    """Return the straight colour [H,W,3], so that the mesh has no dark rim where opacity is low."""
    outputs = full if full is not None else flat
    assert outputs is not None
    color = full.transmitted if full is not None and kind is MeshColor.TRANSMITTED else outputs.color
    return straight_color(_numpy(color), _numpy(outputs.alpha))


def _numpy(image: Tensor) -> np.ndarray:
    """Return an image [H,W] or [H,W,C] as an array."""
    return image.cpu().numpy()
