"""The steps of the three parts, most valuable first."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

from benchmarks.gpu_check.results import BENCHMARK, LOG, PROFILE, ROWS, TESTS
from benchmarks.gpu_check.runner import LeftOutError, Place, Step
from benchmarks.gpu_check.wheels import find_wheel

ROOT = Path(__file__).resolve().parents[2]
# Seconds of a part: a machine's limit of ten minutes a command leaves room for its own start.
PART_LIMIT = 540.0
PAPERS, BALL = "nefertiti_hdr_800", "ball"  # the object of the paper's size, and what stands in for it
# More splats than an object needs.
LARGER = ("surfels.densify.max_count=150000", "gaussians.densify.max_count=300000")
MEMCHECKED = ("gaussians", "surfels", "image")


def parts() -> dict[int, list[Step]]:
    """Return the steps of each part, by its number."""
    return {1: _first(), 2: _second(), 3: _third()}


def _first() -> list[Step]:
    return [
        _own("facts", 60, LOG, "facts"),
        _build_gsplat("gsplat", 530, behind=True),
        _own("build", 120, LOG, "build_kernels"),
        _own("kernels", 90, LOG, "compile_kernels"),
        Step("tests", 150, TESTS, _tests("tests/cuda", "-k", "cuda]"), _environment),
        *(Step(f"memcheck-{family}", 100, TESTS, _memcheck(family), _without_cache) for family in MEMCHECKED),
    ]


def _second() -> list[Step]:
    return [
        _own("build", 120, LOG, "build_kernels"),
        Step("benchmark", 90, BENCHMARK, _benchmark(beside=False), _with_gsplat, echo=True),
        Step("profile", 170, PROFILE, _profile, _environment, echo=True),
        _own("ncu", 90, LOG, "hardware_counters"),
        _build_gsplat("gsplat", 300),
        Step("benchmark-beside-gsplat", 90, BENCHMARK, _benchmark(beside=True), _with_gsplat, echo=True),
    ]


def _third() -> list[Step]:
    return [
        _own("build", 120, LOG, "build_kernels"),
        _training("nefertiti", PAPERS, "high", 150),
        _training("spot_soft", "spot_soft", "standard", 60, "--bring-home"),
        _training("bunny_flash", "bunny_flash", "standard", 60, "--bring-home"),
        # Its splats come last: if not all fit into a file, those of the others do.
        _training("nefertiti-again", PAPERS, "high", 150, "--bring-home", "--same-as", "nefertiti"),
        _own("memory", 100, LOG, "memory"),
        _own("illegal-address", 60, LOG, "fault"),
        _training("lego", "lego", "high", 160, *(f"--set={setting}" for setting in LARGER)),
    ]


def _own(name: str, limit: float, file: str, module: str) -> Step:
    """Return a step that is a module of this package."""
    return Step(name, limit, file, lambda place: [*_module(place, module), *_standard(place)], _environment)


def _module(place: Place, name: str) -> list[str]:
    return [place.python, "-m", f"benchmarks.gpu_check.{name}"]


def _standard(place: Place) -> list[str]:
    return ["--results", str(place.results.folder), "--work", str(place.work), "--device", place.device]


def _training(name: str, scene: str, preset: str, limit: float, *more: str) -> Step:
    def command(place: Place) -> list[str]:
        packed = packed_or_ball(place, scene) if scene == PAPERS else packed_scene(place, scene)
        words = [*_module(place, "train"), *_standard(place), "--step", name, "--preset", preset]
        # What follows training takes some seconds: it ends before the step's limit does.
        return [*words, "--deadline", str(limit - 20), *more, *_settings(), str(packed)]

    return Step(name, limit, LOG, command, _environment)


def _settings() -> list[str]:
    return [f"--set={setting}" for setting in os.environ.get("SETTINGS", "").split()]


def packed_scene(place: Place, name: str) -> Path:
    """Return the packed scene of that name among what was brought.

    Raises LeftOutError where it is not there.
    """
    files = [file for each in place.brought for file in ([each] if each.is_file() else sorted(each.glob("*.npz")))]
    found = next((file for file in files if file.stem == name), None)
    if found is None:
        raise LeftOutError(f"{name}.npz was not packed (scripts/gpu_pack.sh)")
    return found


def packed_or_ball(place: Place, name: str) -> str:
    """Return the packed scene of that name, or, where it was not brought, the ball."""
    try:
        return str(packed_scene(place, name))
    except LeftOutError:
        return BALL


def _tests(*words: str) -> Callable[[Place], list[str]]:
    return lambda place: [*_module(place, "gpu_tests"), "--device", place.device, "--", *words]


def _memcheck(family: str) -> Callable[[Place], list[str]]:
    def command(place: Place) -> list[str]:
        sanitizer = shutil.which("compute-sanitizer")
        if sanitizer is None:
            raise FileNotFoundError("compute-sanitizer is not installed; skip the step with SKIP")
        tested = _tests(f"tests/cuda/test_{family}.py", "-x", "-k", "cuda] and not reference")(place)
        words = [sanitizer, "--tool", "memcheck", "--error-exitcode", "9", "--target-processes", "all"]
        # cuda-bindings asks the driver for functions that it may lack, which is no error.
        return [*words, "--report-api-errors", "no", *tested]

    return command


def _benchmark(beside: bool) -> Callable[[Place], list[str]]:
    """Return a function that gives the benchmark's command.

    beside: only where gsplat has come to be there since the benchmark before, which went without it.
    """

    def command(place: Place) -> list[str]:
        built, done = _built_gsplat(place), place.work / "measured_beside_gsplat"
        if beside and built is None:
            raise LeftOutError("gsplat is missing")
        if beside and done.exists():
            raise LeftOutError("the benchmark already included gsplat")
        done.unlink(missing_ok=True)
        if built is not None:
            done.touch()
        # As a module: beside a script cuda.py, torch would take that for NVIDIA's package of the same name.
        words = [place.python, "-m", "benchmarks.rasterizers", "--runs", os.environ.get("RUNS", "20")]
        words += ["--device", place.device, "--json", str(place.results.folder / ROWS)]
        return [*words, *([] if built else ["--ours"]), *(["--sizes", "2k/64"] if place.device == "cpu" else [])]

    return command


def _profile(place: Place) -> list[str]:
    words = [*_module(place, "profile_training"), *_standard(place), "--preset", "high", "--after", "120"]
    return [*words, *_settings(), packed_or_ball(place, PAPERS)]


def _build_gsplat(name: str, limit: float, behind: bool = False) -> Step:
    def command(place: Place) -> list[str]:
        if _built_gsplat(place) is not None:
            raise LeftOutError("gsplat exists")
        wheel = find_wheel(place.brought, "gsplat")
        return [*_module(place, "build_gsplat"), *_standard(place), *([] if wheel is None else ["--wheel", str(wheel)])]

    return Step(name, limit, LOG, command, _environment, behind=behind)


def _built_gsplat(place: Place) -> dict[str, str] | None:
    """Return what a process needs of the environment to import gsplat as it was built; None where it was not."""
    built = place.work / "gsplat.json"
    return json.loads(built.read_text()) if built.is_file() else None


def _environment(place: Place) -> dict[str, str]:
    """Return the environment in which Python finds the project and the packages that were brought.

    The path has the interpreter's cmake and ninja, and the toolkit's programs, which images leave out of it.
    """
    path = (str(Path(place.python).parent), os.environ.get("PATH", ""), "/usr/local/cuda/bin")
    return {"PYTHONPATH": _joined([str(ROOT), *sites(place)]), "PATH": os.pathsep.join(path)}


def _without_cache(place: Place) -> dict[str, str]:
    """Return the environment in which each of torch's tensors is an allocation of its own.

    So reading past one shows.
    """
    return {**_environment(place), "PYTORCH_NO_CUDA_MEMORY_CACHING": "1"}


def _with_gsplat(place: Place) -> dict[str, str]:
    built = _built_gsplat(place)
    if built is None:
        return _environment(place)
    own = _environment(place)
    return {**own, **built, "PYTHONPATH": _joined([own["PYTHONPATH"], built.get("PYTHONPATH", "")])}


def sites(place: Place) -> list[str]:
    """Return the folders of packages that were brought and that the interpreter lacks (see `bring_packages`)."""
    return [str(folder) for folder in sorted(place.work.glob("site-*"))]


def _joined(folders: Sequence[str]) -> str:
    return os.pathsep.join([*filter(None, folders), *filter(None, [os.environ.get("PYTHONPATH", "")])])
