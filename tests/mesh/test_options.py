"""Options of the mesh reach the functions that they are for: another value gives the expected other result."""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mgsr.config import ExpertConfig, MeshConfig, OutputConfig, make_config
from mgsr.config.expert import ColorOptions, MeshOptions, MeshStepOptions
from mgsr.config.expert import mesh_steps as options_folder
from mgsr.geometry.mesh import Mesh
from mgsr.mesh import steps as steps_folder
from mgsr.mesh.colors import vertex_colors
from mgsr.mesh.extract import extract_mesh
from mgsr.mesh.poisson import cell_size
from mgsr.mesh.steps import mesh_steps
from mgsr.mesh.surface import ReconstructedMesh, TexturedMesh
from mgsr.mesh.surface_choice import is_torn
from mgsr.mesh.texture import texture_levels
from mgsr.mesh.views import SurfaceView
from tests.mesh.shapes import as_mesh, ball, cameras_around, views_of

RADIUS = 0.7


@pytest.fixture(scope="module")
def views() -> list[SurfaceView]:
    return views_of(ball(RADIUS), cameras_around(12, side=48))


@pytest.fixture(scope="module")
def mesh() -> Mesh:
    return as_mesh(ball(RADIUS))


def expert(*overrides: str) -> ExpertConfig:
    return make_config(overrides=overrides).expert


def test_colors_far_from_the_mean_count_less(views: list[SurfaceView], mesh: Mesh) -> None:
    """Check it on one green view among others, whose colour is far from theirs."""
    green = replace(views[0], color=np.broadcast_to(np.array([0, 1, 0], np.float32), views[0].color.shape))

    def off(options: ColorOptions) -> float:
        colors = vertex_colors(mesh, [green, *views[1:]], 0.5, 3.0, options=options)
        return float(np.abs(colors - vertex_colors(mesh, views, 0.5, 3.0)).mean())

    others = ColorOptions(deviation=10.0), ColorOptions(rounds=0)
    assert off(ColorOptions()) < 0.9 * min(off(each) for each in others)


def test_the_octrees_margin(views: list[SurfaceView]) -> None:
    assert cell_size(1.0, 5, 2.2) == 2 * cell_size(1.0, 5)
    config = MeshConfig(poisson_depth=5, max_light_residual=None)
    fine, coarse = (extract_mesh(views, config, expert=expert(*each)) for each in ([], ["poisson_margin=2.2"]))
    assert len(coarse.vertices) < 0.5 * len(fine.vertices)


def test_tears(mesh: Mesh) -> None:
    holes = mesh.keep_faces(np.arange(len(mesh.faces)) % 128 != 0)
    assert is_torn(holes, mesh) and not is_torn(holes, mesh, tears=10**6)


def test_the_textured_model(views: list[SurfaceView], mesh: Mesh) -> None:
    full = ReconstructedMesh(mesh.vertices, mesh.faces, np.full(mesh.vertices.shape, 0.5, np.float32))

    def textured(*overrides: str) -> TexturedMesh:
        output = OutputConfig(faces=None, texture=None)
        return texture_levels(full, views, 0.03, output, MeshConfig(), shaded=False, options=expert(*overrides).mesh)[0]

    usual = textured()
    assert max(textured("unwrap.max_side=48").size) < 0.7 * max(usual.size)
    assert max(textured("unwrap.padding=24").size) > max(usual.size)
    assert len(textured("charts.min_cosine=0.9").vertices) != len(usual.vertices), "charts end elsewhere"


def test_options_stand_in_a_file_of_their_steps_name() -> None:
    files, steps = (
        {each.stem for each in Path(part.__path__[0]).glob("*.py")} for part in (options_folder, steps_folder)
    )
    assert files <= steps
    assert {item.name for item in fields(MeshStepOptions)} <= {step.name for step in mesh_steps()}


def changed(node: Any) -> Any:
    """Return options with all numbers a little larger."""
    values = {field.name: getattr(node, field.name) for field in fields(node)}
    return replace(
        node, **{name: changed(each) if is_dataclass(each) else _next(each) for name, each in values.items()}
    )


def _next(value: float) -> float:
    return value + 1 if isinstance(value, int) else value * 1.01 or 0.01


def parts(node: Any) -> list[Any]:
    """Return all dataclasses within a node, itself included."""
    inner = [getattr(node, field.name) for field in fields(node) if is_dataclass(getattr(node, field.name))]
    return [node, *(part for each in inner for part in parts(each))]


def test_every_step_takes_its_options() -> None:
    """Check that what the steps hold is what the settings say, and all of it."""
    steps, shading = changed(MeshOptions().steps), ExpertConfig().shading
    given = ExpertConfig(
        mesh=MeshOptions(steps=steps),
        geometry=changed(ExpertConfig().geometry),
        shading=replace(shading, shape=changed(shading.shape), light=replace(shading.light, edge=9.0)),
    )
    held = [part for step in mesh_steps(given) for part in parts(step)]
    for group in (given.mesh.steps, given.geometry):
        assert all(getattr(group, field.name) in held for field in fields(group))
    assert given.shading.shape in held and given.shading.light in held
    assert given.shading.photometric in held and given.shading.residual in held
    default = [part for step in mesh_steps() for part in parts(step)]
    assert not any(part in default for part in parts(given.mesh.steps))
