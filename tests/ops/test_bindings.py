"""The bindings of the CPU kernels: stubs that declare what is there, and arguments that are refused, not converted."""

from __future__ import annotations

import ast
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import torch

from mgsr.config.expert import MatchSettings
from mgsr.native import (
    _adam,
    _environment_map,
    _fusion,
    _gaussians,
    _harmonics,
    _image,
    _lights,
    _mirrored,
    _stereo,
    _surfels,
    _terms,
    structs,
)
from mgsr.native.runtime import FAMILIES
from mgsr.stereo.patch_match import stereo_settings
from tests.ops.splat_scenes import camera

MOST_ARGUMENTS = 6
NATIVE = Path(structs.__file__).parent
COUNT, WIDTH, HEIGHT = 5, 12, 9
CAMERA = camera(WIDTH, HEIGHT)
PLANE, TRIPLE = (HEIGHT, WIDTH), (HEIGHT, WIDTH, 3)


@dataclass(frozen=True)
class Call:
    """A call that is right in everything, and the arrays that it writes, as argument or argument.field."""

    function: Callable[..., Any]
    arguments: dict[str, Any]
    outputs: tuple[str, ...]

    def array(self, path: str) -> Any:
        name, _, field = path.partition(".")
        return getattr(self.arguments[name], field) if field else self.arguments[name]

    def replaced(self, path: str, array: object) -> dict[str, Any]:
        """Return the arguments with one array replaced."""
        name, _, field = path.partition(".")
        return {**self.arguments, name: self.arguments[name]._replace(**{field: array}) if field else array}


def surfels() -> list[Call]:
    shapes = {
        "means": (COUNT, 3),
        "quats": (COUNT, 4),
        "scales": (COUNT, 2),
        "opacities": (COUNT,),
        "colors": (COUNT, 3),
    }
    splats = structs.SurfelSplats(
        **{name: torch.rand(*shape) for name, shape in shapes.items()}, background=torch.rand(3)
    )
    view = structs.SurfelView(camera=CAMERA, near=0.01, far=100.0, low_pass=0.1)
    planes = {name: torch.empty(PLANE) for name in ("alpha", "depth", "median_depth", "distortion")}
    images = structs.SurfelImages(color=torch.empty(TRIPLE), normal=torch.empty(TRIPLE), **planes)
    given: dict[str, Any] = {"splats": splats, "view": view, "images": images}
    frame = _surfels.forward(**given, radii=torch.empty(COUNT))
    v_images = structs.SurfelImageGradients(*(torch.rand_like(image) for image in images if image is not None))
    v_tensors = [torch.zeros_like(each) for each in splats[:-1]]
    v_splats = structs.SurfelGradients._make([*v_tensors, torch.zeros(COUNT, 2)])
    return [
        Call(_surfels.forward, {**given, "radii": torch.empty(COUNT)}, ("radii", *paths("images", images))),
        Call(
            _surfels.backward,
            {"frame": frame, **given, "v_images": v_images, "v_splats": v_splats},
            paths("v_splats", v_splats),
        ),
    ]


def gaussians() -> list[Call]:
    shapes = {
        "means": (COUNT, 3),
        "quats": (COUNT, 4),
        "scales": (COUNT, 3),
        "opacities": (COUNT,),
        "colors": (COUNT, 3),
    }
    shapes |= {"refl_opacities": (COUNT,), "refl_colors": (COUNT, 3), "weights": (COUNT,), "background": (3,)}
    splats = structs.GaussianSplats(**{name: torch.rand(*shape) for name, shape in shapes.items()})
    view = structs.GaussianView(camera=CAMERA, near=0.01, low_pass=0.3, compensate=False)
    planes = {name: torch.empty(PLANE) for name in ("alpha", "depth", "weight")}
    images = structs.GaussianImages(color=torch.empty(TRIPLE), reflected=torch.empty(TRIPLE), **planes)
    given: dict[str, Any] = {"splats": splats, "view": view, "images": images}
    frame = _gaussians.forward(**given, radii=torch.empty(COUNT))
    v_images = structs.GaussianImageGradients(*(torch.rand_like(image) for image in images if image is not None))
    v_tensors = [torch.zeros_like(each) for each in splats[:-1] if each is not None]
    v_splats = structs.GaussianGradients._make([*v_tensors, torch.zeros(COUNT, 2)])
    return [
        Call(_gaussians.forward, {**given, "radii": torch.empty(COUNT)}, ("radii", *paths("images", images))),
        Call(
            _gaussians.backward,
            {"frame": frame, **given, "v_images": v_images, "v_splats": v_splats},
            paths("v_splats", v_splats),
        ),
    ]


def colors() -> list[Call]:
    splats = structs.Harmonics(
        coeffs=torch.rand(COUNT, 4, 3), means=torch.rand(COUNT, 3), center=torch.zeros(3), degree=1
    )
    rgb, v_means = torch.rand(COUNT, 3), torch.zeros(COUNT, 3)
    lookup = structs.EnvironmentMapLookup(
        maps=torch.rand(2, 4, 4, 3), normals=torch.rand(TRIPLE), samples=None, pixels=None, camera=CAMERA
    )
    fine = lookup._replace(normals=None, samples=torch.rand(2, 3, 3, 3), pixels=torch.tensor([1, 0]))
    gradients = {"v_maps": torch.empty(2, 4, 4, 3), "v_normals": torch.empty(TRIPLE)}
    return [
        Call(_harmonics.forward, {"splats": splats, "rgb": rgb}, ("rgb",)),
        Call(
            _harmonics.backward,
            {"splats": splats, "rgb": rgb, "v_rgb": rgb, "v_coeffs": torch.empty(COUNT, 4, 3), "v_means": v_means},
            ("v_coeffs", "v_means"),
        ),
        Call(_environment_map.forward, {"lookup": lookup, "light": torch.empty(TRIPLE)}, ("light",)),
        Call(
            _environment_map.backward, {"lookup": lookup, "v_light": torch.rand(TRIPLE), **gradients}, tuple(gradients)
        ),
        Call(_environment_map.forward, {"lookup": fine, "light": torch.empty(TRIPLE)}, ("light",)),
        Call(
            _environment_map.backward,
            {"lookup": fine, "v_light": torch.rand(TRIPLE), **gradients, "v_normals": None},
            ("v_maps",),
        ),
    ]


def images() -> list[Call]:
    image, target = torch.rand(TRIPLE), torch.rand(TRIPLE)
    pair = structs.ImagePair(image=image, target=target, mask=None, l1_weight=0.8, clip=False)
    surface = structs.DepthSurface(depth=torch.rand(PLANE) + 1, alpha=None, camera=CAMERA)
    gradients = {"v_image": torch.empty(TRIPLE), "v_target": torch.empty(TRIPLE)}
    parameter = structs.AdamParameter(
        values=torch.zeros(4, 3), first=torch.zeros(4, 3), second=torch.zeros(4, 3), column_scales=torch.ones(3)
    )
    update = {"parameter": parameter, "gradients": torch.rand(4, 3), "rate": 0.1, "step": 1}
    return [
        Call(_image.image_loss, {"pair": pair, **gradients}, tuple(gradients)),
        Call(
            _image.tv, {"values": image, "guide": target, "mask": None, "v_values": torch.empty(TRIPLE)}, ("v_values",)
        ),
        Call(_image.depth_normals, {"surface": surface, "normals": torch.empty(TRIPLE)}, ("normals",)),
        Call(
            _image.depth_normals_vjp,
            {"surface": surface, "v_normals": image, "v_depth": torch.empty(PLANE)},
            ("v_depth",),
        ),
        Call(
            _adam.AdamBatch(0.9, 0.999, 1e-15).add, update, ("parameter.values", "parameter.first", "parameter.second")
        ),
    ]


def terms() -> list[Call]:
    in_bytes, alpha, color = torch.zeros(TRIPLE, dtype=torch.uint8), torch.rand(PLANE), torch.rand(TRIPLE)
    photograph = structs.ImageInBytes(image=in_bytes, mask=in_bytes[..., 0].contiguous(), off_edge=alpha > 0.5)
    out = structs.CompositedImage(color=torch.empty(TRIPLE), alpha=torch.empty(PLANE), weights=torch.empty(PLANE))
    difference = structs.WeightedDifference(a=alpha, b=alpha, first=alpha, second=alpha, offset=0.5)
    silhouettes = {"alpha": alpha, "mask": alpha, "weights": alpha, "entropy": False, "v_alpha": torch.empty(PLANE)}
    maps = torch.rand(2, 4, 4, 3)
    return [
        Call(
            _terms.composite,
            {"photograph": photograph, "background": torch.rand(3), "out": out},
            ("out.color", "out.alpha", "out.weights"),
        ),
        Call(_terms.covered, {"alpha": alpha, "mask": alpha, "covered": torch.empty(PLANE)}, ("covered",)),
        Call(_terms.silhouette, silhouettes, ("v_alpha",)),
        Call(_terms.squares, {"difference": difference, "differences": torch.empty(PLANE)}, ("differences",)),
        Call(_terms.product, {"weight": alpha, "color": color, "v_weight": torch.empty(PLANE)}, ("v_weight",)),
        Call(_terms.steps, {"maps": maps, "v_maps": torch.empty_like(maps)}, ("v_maps",)),
        Call(_terms.gradient, {"slopes": [alpha, color], "scales": [1.0, 2.0], "out": torch.empty(TRIPLE)}, ("out",)),
    ]


def lights() -> list[Call]:
    color, plane, behind = torch.rand(TRIPLE), torch.rand(PLANE), torch.rand(3)
    given = {"transmitted": color, "weight": plane, "own": color, "environment": color}
    reflection = {**given, "color": torch.empty(TRIPLE), "reflected": torch.empty(TRIPLE)}
    gradients = [torch.empty(TRIPLE), torch.empty(PLANE), torch.empty(TRIPLE), torch.empty(TRIPLE)]
    before = {"v_color": color, "reflected": color, "weight": plane, "before": [color, plane, None]}
    lit = {"unlit": color, "alpha": plane, "background": behind, "shading": plane, "offset": 0.055}
    v_lit = {"v_image": color, "background": behind, "shading": plane, "offset": 0.055, "add_alpha": plane}
    out = structs.UnlitGradients(v_unlit=torch.empty(TRIPLE), v_alpha=torch.empty(PLANE))
    return [
        Call(_lights.add_reflection, reflection, ("color", "reflected")),
        Call(_lights.add_reflection_vjp, {**before, "out": gradients}, ()),
        Call(_lights.light_up, {**lit, "image": torch.empty(TRIPLE)}, ("image",)),
        Call(_lights.light_up_vjp, {**v_lit, "out": out}, ("out.v_unlit", "out.v_alpha")),
    ]


def surfaces() -> list[Call]:
    def planes() -> structs.StereoPlanes:
        return structs.StereoPlanes(depth=np.ones(PLANE, np.float32), normal=np.ones(TRIPLE, np.float32))

    views = structs.StereoViews(
        images=[np.ones((*PLANE, 4), np.float32)] * 2,
        cameras=np.ones((2, 16), np.float32),
        view=0,
        neighbours=[1],
        range=(1.0, 2.0),
    )
    settings, score = stereo_settings(MatchSettings(rounds=0)), np.zeros(PLANE, np.float32)
    search = {"views": views, "start": planes(), "settings": settings, "seed": 0, "found": planes(), "score": score}
    judge = {"views": views, "planes": planes(), "settings": settings, "score": score}
    depths = [np.ones(PLANE, np.float32)]
    maps = structs.VotingMaps(cameras=np.ones((1, 16)), depths=depths, weights=depths)
    histograms, grid = np.zeros((4, 6), np.float32), np.zeros((2, 2, 1), np.float32)
    solid = {"solid_weight": 0.2, "solid_depth": 4.0}
    vote = {"points": np.zeros((4, 3)), "maps": maps, "reach": 0.1, **solid, "votes": histograms}
    fused = {"votes": histograms, "voxels": np.arange(4), "most": grid + 1, "strength": 0.4, "rounds": 1, "field": grid}
    read = structs.MirroredObservations(
        view_directions=np.ones((4, 2, 3), np.float32),
        brightness=np.ones((4, 2), np.float32),
        weights=np.ones((4, 2), np.float32),
    )
    light, tilts = np.ones((2, 2, 2), np.float32), np.zeros(3, np.float32)
    axes, costs = np.ones((4, 3, 3), np.float32), np.zeros((4, 3, 3), np.float32)
    tilt = {"observations": read, "table": light, "frames": axes, "tilts": tilts, "outlier": 0.1, "costs": costs}
    return [
        Call(_stereo.search, search, ("found.depth", "found.normal", "score")),
        Call(_stereo.judge, judge, ("score",)),
        Call(_fusion.vote, vote, ("votes",)),
        Call(_fusion.regularise, fused, ("field",)),
        Call(_mirrored.tilt_costs, tilt, ("costs",)),
    ]


def paths(name: str, struct: Any) -> tuple[str, ...]:
    return tuple(f"{name}.{field}" for field in struct._fields)


@pytest.mark.parametrize("calls", [surfels, gaussians, colors, images, terms, lights, surfaces])
def test_an_output_of_another_kind_is_refused(calls: Callable[[], list[Call]]) -> None:
    """Check that no kernel writes to a copy: another dtype, layout, type or size is an error that names the output."""
    for call in calls():
        call.function(**call.arguments)
        for path in call.outputs:
            right = torch.as_tensor(call.array(path))
            sparse = torch.zeros(*right.shape, 2)[..., 0]
            with pytest.raises(TypeError, match=rf"^{path}: expected .*float32.*, got float64 \["):
                call.function(**call.replaced(path, right.double()))
            with pytest.raises(TypeError, match=rf"^{path}: expected .*, got float32 .*, not contiguous$"):
                call.function(**call.replaced(path, sparse))
            with pytest.raises(TypeError, match=rf"^{path}: expected .*, got str$"):
                call.function(**call.replaced(path, "an array"))
            with pytest.raises((ValueError, TypeError), match="expected"):
                call.function(**call.replaced(path, torch.zeros(right.shape[0] + 1, *right.shape[1:])))


def test_an_output_of_numpy_is_written_in_place() -> None:
    image, v_values = np.random.default_rng(0).random(TRIPLE, np.float32), np.full(TRIPLE, np.nan, np.float32)
    _image.tv(torch.from_numpy(image), torch.from_numpy(image), None, torch.from_numpy(v_values))
    assert np.isfinite(v_values).all()


def test_swapped_structs_are_refused() -> None:
    """Check that structs in each other's place are errors, also for the type checker, which knows unused ignores."""
    given = surfels()[0].arguments
    splats: structs.SurfelSplats = given["splats"]
    view: structs.SurfelView = given["view"]
    made: structs.SurfelImages = given["images"]
    with pytest.raises(TypeError, match=r"^splats: expected a struct with the field means, got .*SurfelView$"):
        _surfels.forward(view, splats, made, given["radii"])  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="incompatible"):
        _surfels.forward(splats, view, made)  # type: ignore[call-arg]
    with pytest.raises(TypeError, match="missing"):
        structs.SurfelView(camera=CAMERA, near=0.01, far=100.0)  # type: ignore[call-arg]
    with pytest.raises(TypeError, match=r"^view\.near: expected a value of another type, got 'near'$"):
        _surfels.forward(splats, view._replace(near="near"), made, given["radii"])  # type: ignore[arg-type]


def test_a_camera_of_any_numbers_is_read() -> None:
    """Check that a camera's few numbers are converted, with the same result."""
    call = surfels()[0]
    rough = camera(WIDTH, HEIGHT)
    object.__setattr__(rough, "K", np.asfortranarray(np.round(rough.K), np.float32))
    exact = camera(WIDTH, HEIGHT)
    object.__setattr__(exact, "K", np.round(exact.K))
    found = []
    for each in (rough, exact):
        call.function(**call.replaced("view.camera", each))
        found.append(call.arguments["images"].color.clone())
    assert torch.equal(*found)


def test_callers_fill_the_fields_by_name() -> None:
    """Check that no caller relies on the order of a struct's fields."""
    names = {name for name, value in vars(structs).items() if hasattr(value, "_fields")}
    made = 0
    for path in NATIVE.parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in names:
                assert not node.args, f"{path.name}:{node.lineno}: expected the fields of {node.func.id} by name"
                made += 1
    assert made > 20


def declared(body: list[ast.stmt], owner: str = "") -> dict[str, list[str]]:
    """Return the names of the arguments of each function of a stub."""
    found: dict[str, list[str]] = {}
    for node in body:
        if isinstance(node, ast.FunctionDef):
            found[owner + node.name] = [argument.arg for argument in node.args.args]
            assert not node.args.vararg and not node.args.kwarg, f"{node.name}: expected named arguments"
        elif isinstance(node, ast.ClassDef):
            found |= declared(node.body, f"{node.name}.")
    return found


def compiled(owner: Any, prefix: str = "") -> dict[str, list[str]]:
    """Return the same of a compiled module, from what nanobind knows."""
    found: dict[str, list[str]] = {}
    for name, value in vars(owner).items():
        if isinstance(value, type):
            found |= compiled(value, f"{name}.")
        elif hasattr(value, "__nb_signature__"):
            ((signature, *_),) = value.__nb_signature__
            plain = re.sub(r"ndarray\[[^\]]*\]", "ndarray", signature)
            (function,) = ast.parse(f"{plain}: ...").body
            assert isinstance(function, ast.FunctionDef)
            found[prefix + name] = [argument.arg for argument in function.args.args]
    return found


@pytest.mark.parametrize("family", FAMILIES, ids=lambda family: family.__name__.rsplit(".")[-1])
def test_the_stub_declares_what_is_there(family: ModuleType) -> None:
    stub = NATIVE / f"{family.__name__.rsplit('.')[-1]}.pyi"
    names = declared(ast.parse(stub.read_text(encoding="utf-8")).body)
    assert names == compiled(family)
    assert max(len(set(arguments) - {"self"}) for arguments in names.values()) <= MOST_ARGUMENTS


@pytest.mark.parametrize(
    "path", sorted((Path(structs.__file__).parent / "cuda").glob("*.py")), ids=lambda each: each.name
)
def test_no_function_of_the_gpu_takes_more_arguments(path: Path) -> None:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef):
            names = {each.arg for each in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)}
            assert len(names - {"self"}) <= MOST_ARGUMENTS, f"{node.name}: group them in structs.py"
