"""The kernels' benchmark on tiny sizes: every kernel has its float64 witness, and an error is seen."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from benchmarks.evidence.kernels import AS_IT_IS, KERNELS, kernel_section, read_kernels
from benchmarks.kernel_choices import CHOICES, ROOT, Choice, changed_sources
from benchmarks.kernels import Case, errors, image_cases, keep, raster_cases, rows_of, splat_cases
from tests.ops.splat_scenes import camera, random_splats

pytestmark = pytest.mark.usefixtures("kernel_settings_come_back")


@pytest.fixture(scope="module")
def cases(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Case]:
    """Build all cases, on a scene of the raster folder's form with a reference that is the tests' own."""
    torch.manual_seed(0)
    folder, view = tmp_path_factory.mktemp("raster"), camera()
    splats: dict[str, Any] = {name: tensor.float().numpy() for name, tensor in random_splats(40, 3).items()}
    splats["rgb"] = splats.pop("colors")
    extra: dict[str, Any] = {"K": view.K, "viewmat": view.cam_from_world, "width": view.width, "height": view.height}
    np.savez(folder / "tiny.npz", **splats, **extra, background=np.zeros(3, np.float32))
    cases = raster_cases(folder / "tiny.npz") + image_cases(32) + splat_cases(50)
    return {case.name: case for case in cases}


def test_every_kernel_agrees_with_its_witness(cases: dict[str, Case]) -> None:
    for case in cases.values():
        found = errors(case, case.compared.compute, "cpu")
        # Rounding of float32; gradients of surfels seen edge-on lose more digits.
        assert 0 < found.error_max < 1e-4 and found.error_mean <= found.error_max, case.name
        assert (found.gradient_max is None) is case.name.startswith("Adam")
        assert found.gradient_max is None or found.gradient_max < 1e-3, case.name


def test_an_error_is_seen(cases: dict[str, Case]) -> None:
    case = cases["TV of depth"]

    def wrong(*inputs: Tensor) -> list[Tensor]:
        return [1.5 * case.compared.compute(*inputs)[0]]

    found, true = errors(case, wrong, "cpu"), case.compared.compute(*case.compared.inputs)[0]
    assert found.error_max == pytest.approx(0.5 * float(true), rel=1e-3)
    assert found.gradient_max == pytest.approx(0.5, rel=1e-3)


def test_the_scenes_own_reference_judges_the_3d_image(cases: dict[str, Case]) -> None:
    case = cases["3D, one colour"]
    image = case.timed.compute(*case.timed.inputs)[0]
    assert errors(replace(case, reference=[image.double() + 0.25]), case.timed.compute, "cpu").error_max == (
        pytest.approx(0.25, rel=1e-5)
    )


def test_rows_are_kept_and_replaced_and_told(cases: dict[str, Case], tmp_path: Path) -> None:
    rows = rows_of(cases["TV of 3 channels"], ["baseline"], 2, "a note")
    assert [row.variant for row in rows] == ["baseline", "torch"] and all(row.cost > 0 for row in rows)
    keep(tmp_path / KERNELS, rows)
    other = [replace(rows[0], forward=9.0), replace(rows[0], variant="cuda")]
    keep(tmp_path / KERNELS, other)
    kept = read_kernels(tmp_path / KERNELS)
    assert [(row.variant, row.forward == 9.0) for row in kept] == [
        ("baseline", True),
        ("torch", False),
        ("cuda", False),
    ]
    page = kernel_section(kept)
    assert "a note" in page and "No machine was available to measure avx512." in page
    assert kernel_section([]) == ""


def test_choices_are_held_against_the_kernels_as_they_are(cases: dict[str, Case]) -> None:
    usual = replace(rows_of(cases["TV of 3 channels"], ["baseline"], 1, "")[0], variant=AS_IT_IS, cpu=2.0)
    other = replace(usual, variant="larger", cpu=3.0, error_max=0.5, gradient_max=None)
    page = kernel_section([usual], [usual, other])
    assert f"| {usual.kernel} | larger | 3.00 (+50%) | 5.0e-01 ({usual.error_max:.1e}) | - (" in page
    assert "larger" not in kernel_section([usual], [other])


@pytest.mark.parametrize("choice", CHOICES, ids=lambda choice: choice.name)
def test_what_is_chosen_otherwise_is_in_the_sources(choice: Choice, tmp_path: Path) -> None:
    changed_sources(choice, tmp_path)
    differing = {
        str(file.relative_to(tmp_path))
        for file in tmp_path.rglob("*.h")
        if file.read_text() != (ROOT / file.relative_to(tmp_path)).read_text()
    }
    assert differing == {change.file for change in choice.changes}
