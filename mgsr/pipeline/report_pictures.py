"""The pictures of report.html."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mgsr.data.backdrop import Color
from mgsr.data.images import linear_to_srgb
from mgsr.data.scene import Scene, View
from mgsr.data.up_direction import up_direction
from mgsr.export.renders import on_background
from mgsr.gaussians.environment_map import EnvironmentMap
from mgsr.mesh.relighting import look_at_textured, studio_light
from mgsr.mesh.surface import ReconstructedMesh, TexturedMesh
from mgsr.metrics.truth import TrueSurface
from mgsr.pipeline.evaluation import photograph
from mgsr.pipeline.rendering import RenderedView
from mgsr.report.environment_map import environment_map_pictures
from mgsr.report.html import MOST_VIEWS
from mgsr.report.pictures import (
    Picture,
    ReportPictures,
    SurfacePictures,
    TestViewPictures,
    color_picture,
    depth_picture,
    mask_picture,
    normal_picture,
    premultiplied_picture,
)
from mgsr.report.shading import (
    MeshPainter,
    PaintedMesh,
    bounding_ball,
    level_front,
    side_camera,
    surface_pictures,
)

MASKS = 6  # photographs that show a found object's masks
RELIT, RELIT_SIDE = 6, 200  # pictures of the model in new light, and their pixels along a side


@dataclass(frozen=True)
class SurfaceDrawings:
    """The drawings of a surface for the report.

    They show its sides. shaded [H,W,4] uint8: the shaded surface from each of the first test views.
    """

    sides: SurfacePictures
    views: list[np.ndarray]


def draw_surface(mesh: ReconstructedMesh, truth: TrueSurface | None, scene: Scene) -> SurfaceDrawings:
    """Draw the surface for the report; mesh and truth are in the user's frame."""
    shown = PaintedMesh(mesh.vertices, mesh.faces, mesh.colors).with_normals(mesh.normals)
    painter = MeshPainter(shown)
    to_user = scene.user_from_scene.camera_to_user
    views = [painter.shaded(to_user(view.camera)) for view in scene.test[:MOST_VIEWS]]
    front = to_user((scene.test or scene.train)[0].camera).center
    true_mesh = None if truth is None else truth.mesh
    return SurfaceDrawings(surface_pictures(shown, _up(scene), front, true_mesh), views)


def report_pictures(
    rendered: Sequence[RenderedView],
    psnr: Sequence[float],
    drawn: SurfaceDrawings,
    scene: Scene,
    environment_map: EnvironmentMap | None,
    background: Color,
    agreement: Mapping[str, float],
    relit: Sequence[Picture] = (),
) -> ReportPictures:
    """Collect the pictures of the report.

    They show the first test views, the surface, the environment map that it reflects, a found object's masks, and the
    textured model in new light.

    psnr: the PSNR of each test view, dB. background: the colour behind views without masks. agreement: the agreement
    of a found object's masks, by the training view's name; empty if no object was found.
    """
    views = [
        _view_pictures(images, view, value, shaded, background)
        for images, view, value, shaded in zip(rendered, scene.test, psnr, drawn.views, strict=False)
    ]
    maps = () if environment_map is None else environment_map_pictures(environment_map, _up(scene))
    return ReportPictures(views, maps, drawn.sides, _mask_pictures(scene.train, agreement), relit)


def draw_relit(textured: TexturedMesh, scene: Scene) -> list[Picture]:
    """Draw the textured model, which is in the user's frame, in a studio that turns around it."""
    up = _up(scene) / np.linalg.norm(_up(scene))
    viewer = scene.user_from_scene.camera_to_user((scene.test or scene.train)[0].camera).center
    toward = viewer - bounding_ball(textured.vertices)[0]
    seen = look_at_textured(textured, side_camera(textured.vertices, up, toward, 0.0, RELIT_SIDE))
    front = level_front(up, toward)
    pictures = []
    for step in range(RELIT):
        angle = 360 * step / RELIT
        lit = seen.lit(studio_light(up, front, angle))
        alpha = lit[..., 3]
        color = linear_to_srgb(np.clip(lit[..., :3] / np.maximum(alpha, 1e-6)[..., None], 0, 1))
        pictures.append(Picture(f"{angle:.0f}°", color_picture(color, alpha)))
    return pictures


def _up(scene: Scene) -> np.ndarray:
    return up_direction([view.camera for view in scene.train], scene.options.up)


def _mask_pictures(views: Sequence[View], agreement: Mapping[str, float]) -> list[Picture]:
    """Draw MASKS of the masks, from the one that agrees least with the others to the one that agrees most."""
    known = sorted((agreement[view.name], index) for index, view in enumerate(views) if view.name in agreement)
    chosen = {round(place): known[round(place)] for place in np.linspace(0, len(known) - 1, MASKS)} if known else {}
    return [
        Picture(f"{views[index].name}, {value:.0%}", mask_picture(views[index].image, alpha))
        for value, index in chosen.values()
        if (alpha := views[index].alpha) is not None
    ]


def _shown(view: View) -> np.ndarray:
    """Return the photograph [H,W,3] or [H,W,4] uint8, transparent at invalid pixels."""
    pixels = photograph(view)
    if view.valid_mask is None:
        return pixels
    if view.alpha is None:
        pixels = np.dstack([pixels, np.full(view.valid_mask.shape, 255, np.uint8)])
    return np.where(view.valid_mask[..., None], pixels, np.uint8(0))


def _view_pictures(
    images: RenderedView, view: View, psnr: float, shaded: np.ndarray, background: Color
) -> TestViewPictures:
    reflected = None
    if images.reflected is not None and images.weight is not None:
        reflected = color_picture(images.reflected * images.weight[..., None])

    def light(color: np.ndarray) -> np.ndarray:
        """Return a picture uint8 [H,W,3], or [H,W,4] with alpha, of a rendered colour [H,W,3]."""
        if view.alpha is None:
            return color_picture(on_background(color, images.alpha, background))
        return premultiplied_picture(color, images.alpha)

    return TestViewPictures(
        images.name,
        _shown(view),
        light(images.color),
        None if images.transmitted is None else light(images.transmitted),
        reflected,
        normal_picture(images.normal, images.camera, images.alpha),
        depth_picture(images.depth, images.alpha),
        shaded,
        psnr,
        None if images.unlit is None else light(images.unlit),
        None if images.whole is None else color_picture(images.whole),
    )
