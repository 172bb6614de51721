"""The machine knows every instruction of every kernel, and a test of each family passes on it: the quick part of what
tests/cuda has for it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from mgsr.native.cuda.compiler import SOURCES
from tests.cuda import (
    test_adam,
    test_environment_map,
    test_gaussians,
    test_harmonics,
    test_image,
    test_statistics,
    test_surfels,
)
from tests.cuda.machines import PTX
from tests.ops import test_activations, test_lights, test_terms
from tests.ptx_machine.library import ptx_of
from tests.ptx_machine.nvrtc import ARCH, missing_tools
from tests.ptx_machine.translator import translate

FAMILIES = sorted(SOURCES.glob("kernels/*/*.cu"))
ARCHS = ("sm_75", "sm_80", "sm_90", "sm_100", "sm_120")
QUICK: dict[str, tuple[Callable[..., None], dict[str, Any]]] = {
    "activations": (test_activations.test_values_and_gradients, {"logits": 3}),
    "adam": (test_adam.test_matches_the_algorithm, {"n": 111}),
    "harmonics": (test_harmonics.test_matches_scipy, {"n": 64, "degree": 3, "stored": 16}),
    "image_loss": (test_image.test_loss, {"size": (7, 8), "masked": True}),
    "total_variation": (test_image.test_total_variation, {"size": (17, 33), "channels": 3, "masked": True}),
    "depth_normals": (test_image.test_normals_of_depth, {"size": (9, 7), "with_alpha": True}),
    "judge": (test_adam.test_what_is_bad_is_seen, {"bad": float("inf")}),
    "lights": (test_lights.test_reflected_light_is_added, {"lights": ("own", "environment_map"), "added": True}),
    "environment_map": (test_environment_map.test_matches_the_oracle, {"size": (9, 8), "side": 2, "chosen": True}),
    "statistics": (test_statistics.test_matches_torch, {}),
    "normal_agreement": (test_terms.test_agreement_of_normals, {}),
    "squares": (test_terms.test_squares, {}),
    "sums_of_terms": (test_terms.test_many_terms_of_one_image_add_up, {}),
    "surfels": (test_surfels.test_matches_brute_force, {}),
    "gaussians": (test_gaussians.test_matches_brute_force, {"dual": True}),
}


@pytest.fixture(autouse=True)
def tools() -> None:
    if reason := missing_tools():
        pytest.skip(reason)


@pytest.mark.parametrize("name", QUICK)
def test_a_family_passes(name: str) -> None:
    test, arguments = QUICK[name]
    test(PTX, **arguments)


@pytest.mark.slow
@pytest.mark.parametrize("name", QUICK)
def test_a_family_passes_with_less_exact_instructions(name: str) -> None:
    """Check a family where ex2, and division where it is approximate, are off by two units in the last place.

    They may be on a GPU.
    """
    test, arguments = QUICK[name]
    test(replace(PTX, noise_ulps=2), **arguments)


@pytest.mark.parametrize("arch", [pytest.param(a, marks=[] if a == ARCH else pytest.mark.slow) for a in ARCHS])
@pytest.mark.parametrize("source", FAMILIES, ids=lambda path: path.stem)
def test_every_instruction_is_known(source: Path, arch: str) -> None:
    """Check that every instruction is known, also where no test executes it.

    Gpus whose PTX the tests don't execute are among them.
    """
    assert f"run_{source.stem.partition('_')[0]}" in translate(ptx_of(source, SOURCES, arch))
