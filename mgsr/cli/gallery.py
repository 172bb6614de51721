"""The pictures of report.html."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mgsr.cli.evaluation import photograph
from mgsr.cli.rendering import ViewImages
from mgsr.data.scene import Scene, View
from mgsr.gaussians.mirrored import MirroredLight
from mgsr.mesh.surface import SurfaceMesh
from mgsr.metrics.truth import TrueSurface
from mgsr.report.html import MOST_VIEWS
from mgsr.report.mirrored import mirrored_pictures
from mgsr.report.pictures import (
    ReportPictures,
    TestViewPictures,
    color_picture,
    depth_picture,
    normal_picture,
    premultiplied_picture,
)
from mgsr.report.shading import MeshPainter, TriangleMesh, surface_pictures, up_direction


def report_pictures(
    rendered: Sequence[ViewImages],
    psnr: Sequence[float],
    mesh: SurfaceMesh,
    truth: TrueSurface | None,
    scene: Scene,
    light: MirroredLight | None,
) -> ReportPictures:
    """The first test views, with their PSNR in dB, the surface (mesh and truth in the user's frame), and the light that
    it mirrors."""
    shown = TriangleMesh(mesh.vertices, mesh.faces, mesh.normals, mesh.colors)
    painter = MeshPainter(shown)
    views = [
        _view_pictures(images, view, value, painter, scene)
        for images, view, value in zip(rendered[:MOST_VIEWS], scene.test, psnr, strict=False)
    ]
    front = (scene.test or scene.train)[0].camera.center
    up = up_direction([view.camera for view in scene.train])
    true_mesh = None if truth is None else TriangleMesh(truth.vertices, truth.faces)
    mirrored = () if light is None else mirrored_pictures(light, up)
    return ReportPictures(views, mirrored, surface_pictures(shown, up, np.asarray(front), true_mesh))


def _view_pictures(images: ViewImages, view: View, psnr: float, painter: MeshPainter, scene: Scene) -> TestViewPictures:
    reflected = None
    if images.reflected is not None and images.weight is not None:
        reflected = color_picture(images.reflected * images.weight[..., None])
    transmitted = None if images.transmitted is None else premultiplied_picture(images.transmitted, images.alpha)
    return TestViewPictures(
        images.name,
        photograph(view),
        premultiplied_picture(images.color, images.alpha),
        transmitted,
        reflected,
        normal_picture(images.normal, images.camera, images.alpha),
        depth_picture(images.depth, images.alpha),
        painter.shaded(scene.user_from_scene.camera_to_user(images.camera)),
        psnr,
    )
