"""What the pages say, held to the code: options that exist, programs that run, a site that builds."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image

from mgsr.config import PRESETS, Config, DataConfig, field_types, make_config
from mgsr.data import find_scene
from mgsr.data.formats import all_formats
from mgsr.data.readers import load_scene
from mgsr.geometry.mesh import Mesh
from mgsr.shading.light_estimate import LightEstimate
from scripts.options_page import expert_markdown, paper_markdown, settings_markdown
from tests.cli.spheres import write_spheres
from tests.docs.blocks import PAGES, ROOT, program
from tests.mesh.shapes import ball

CONTRIBUTING = ROOT / "docs/contributing.md"
PYTHON = ROOT / "docs/python.md"
# What stands for a setting: the example of contributing.md, and README's form.
EXAMPLES = {"decided_weight=0.1", "KEY=VALUE"}


def _settings() -> list[str]:
    """Return every KEY=VALUE that a page gives to --set, or shows as a setting."""
    text = "\n".join(page.read_text(encoding="utf-8") for page in PAGES)
    given = re.findall(r"--set ([\w.]+=[\w.]+)", text)
    shown = re.findall(r"`([a-z_][\w.]*=[\w.\-]+)`", text)
    return sorted({*given, *shown} - EXAMPLES)


@pytest.mark.parametrize("setting", _settings())
def test_a_setting_that_a_page_names_can_be_set(setting: str) -> None:
    make_config(overrides=[setting])


def test_the_weights_of_the_formulas_are_settings() -> None:
    text = (ROOT / "docs/how-it-works.md").read_text(encoding="utf-8")
    table = text.split("| in the formulas | setting |")[1].split("\n\n")[0]
    names = re.findall(r"`([\w.]+)`", table)
    assert len(names) == 11
    for name in names:
        make_config(overrides=[f"{name}=0.3"])


def test_the_table_of_settings_has_every_one_with_its_default() -> None:
    pages = (settings_markdown(), paper_markdown(), expert_markdown())
    tables = "\n".join(markdown.split("### What the")[0] for markdown in pages)
    rows = re.findall(r"^\| `(\w+)` \| `([^`]*)` \|", tables, re.M)
    assert len(rows) == len(field_types(Config())) - 4  # preset, method, seed and time_budget are options of their own
    assert ("normal_weight", "0.05") in rows and ("close_holes", "off") in rows


def test_comments_that_go_on_belong_to_their_setting() -> None:
    table = settings_markdown()
    assert "There, soft edges of splats would make the object smaller." in table
    assert "an environment map leaves at most this share of the residual" in table
    assert "Positions move slowly" not in table


def test_the_added_step_smooths_a_mesh() -> None:
    names: dict[str, Any] = {"__name__": __name__}
    exec(compile(program(CONTRIBUTING, "step"), "step", "exec", dont_inherit=True), names)
    shape = ball(0.7)
    rough = shape.vertices * np.random.default_rng(0).uniform(0.99, 1.01, (len(shape.vertices), 1))
    result = names["SmoothOnce"]().run(Mesh(rough, np.asarray(shape.faces)), LightEstimate(), None)
    before, after = (np.linalg.norm(each, axis=1).std() for each in (rough, result.mesh.vertices))
    assert after < 0.6 * before and result.outcome == {"share": 0.5}


def test_the_first_loss_is_a_loss() -> None:
    names: dict[str, Any] = {}
    exec(program(CONTRIBUTING, "loss"), names)
    names["test_undecided"]()


def test_the_first_reader_reads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Check that the spheres, with cameras in the example's file, give the scene that their own format gives."""
    spheres = write_spheres(tmp_path / "spheres", size=32, train=8, test=1)
    theirs = json.loads((spheres / "transforms_train.json").read_text())
    known = load_scene(spheres, DataConfig())
    flip = np.diag([1.0, -1.0, -1.0, 1.0])
    lines = []
    for frame in theirs["frames"]:
        name = frame["file_path"].removeprefix("./")
        name += "" if name.endswith(".png") else ".png"
        cam_from_world = np.linalg.inv(np.array(frame["transform_matrix"]) @ flip)
        focal = 16 / np.tan(theirs["camera_angle_x"] / 2)
        lines.append(",".join([name, repr(float(focal)), *map(repr, cam_from_world.ravel().tolist())]))
    for path in spheres.glob("transforms*.json"):
        path.unlink()
    (spheres / "poses.csv").write_text("\n".join(lines) + "\n")
    names: dict[str, Any] = {}
    exec(program(CONTRIBUTING, "reader"), names)
    formats = [*all_formats(), names["FORMAT"]]
    monkeypatch.setattr(find_scene, "all_formats", lambda: formats)
    read = load_scene(spheres, DataConfig(test_every=100))
    ours = {view.name.split("/")[-1]: view.camera for view in [*read.train, *read.test]}
    same = {view.name.split("/")[-1]: view.camera for view in known.train if view.name.split("/")[-1] in ours}
    assert len(ours) == 8 and len(same) >= 7
    for name, camera in same.items():
        assert np.allclose(camera.cam_from_world, ours[name].cam_from_world, atol=0.02), name
        assert np.allclose(camera.K, ours[name].K)


@pytest.mark.slow
def test_the_example_in_python(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a small capture, and with so few iterations that it is soon over."""
    photos = write_spheres(tmp_path / "photos", size=48, train=12, test=2)
    (photos / "mesh_gt.ply").unlink()
    few = {"warmup.surfel_iterations": "30", "warmup.gaussian_iterations": "30", "mutual.iterations": "20"}
    monkeypatch.setitem(PRESETS, "draft", PRESETS["draft"] | few | {"mesh.poisson_depth": "5"})
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    exec(program(PYTHON, "python"), names)
    assert Image.open("out/beside.png").size == (320, 320)
    assert {path.name for path in Path("out").iterdir()} == {"photos", "small", "beside.png"}
    assert len(trimesh.load_mesh("out/small/mesh.obj").faces) <= 2000


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the documentation strictly: a dead link or anchor is an error."""
    folder = tmp_path_factory.mktemp("site")
    ran = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "-q", "--strict", "-d", str(folder)],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert ran.returncode == 0, ran.stderr[-3000:]
    return folder


def test_the_site_asks_no_other_host(site: Path) -> None:
    for page in site.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        loaded = re.findall(r"<(?:script|img|iframe|source)[^>]*\ssrc=\"([^\"]+)\"", text)
        loaded += re.findall(r"<link[^>]*rel=\"(?:stylesheet|preconnect|icon)\"[^>]*href=\"([^\"]+)\"", text)
        loaded += re.findall(r"<link[^>]*href=\"([^\"]+)\"[^>]*rel=\"(?:stylesheet|preconnect|icon)\"", text)
        assert loaded and not [address for address in loaded if re.match(r"(https?:)?//", address)], page.name


def test_formulas_are_shown_without_scripts(site: Path) -> None:
    text = (site / "how-it-works.html").read_text(encoding="utf-8")
    assert text.count("<math") > 20 and "arithmatex" not in text and "\\frac" not in text.split("<math")[0]


def test_the_settings_stand_on_their_page(site: Path) -> None:
    text = (site / "options.html").read_text(encoding="utf-8")
    users, paper = text.split("Settings for comparison with the paper")[-2:]
    paper, algorithms = paper.split("Options of the algorithms")[-2:]
    for name, part in {"poisson_depth": users, "validation_patience": paper, "half_depth": algorithms}.items():
        assert all((name in each) == (each is part) for each in (users, paper, algorithms)), name
    assert "settings of mgsr/config" not in text.replace("`", "")
