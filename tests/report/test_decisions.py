"""Tests of the decisions that a report tells from a run's facts."""

from __future__ import annotations

from dataclasses import replace

import pytest

from mgsr.report.data import BudgetFacts, Decision, FlashFacts, MeshStepRun, Selection, StageRun, StartFacts
from mgsr.report.decisions import tell_decisions, with_decisions
from tests.optional import present
from tests.report.samples import bare_report, sample_report


def test_every_stage_says_why_it_ended() -> None:
    reported = {each.what: each for each in tell_decisions(sample_report())}
    assert "stopped falling" in reported["End of stage “2D branch”"].why
    assert "All planned" in reported["End of stage “both”"].why
    assert reported["Starting points"].choice.startswith("9,000 inside the visual hull, where")
    assert reported["Masks"].choice == "used" and reported["Holes"].choice == "left open"


def test_the_light_is_told() -> None:
    sample = sample_report()
    reported = tell_decisions(replace(sample, light="flash"))
    assert [each.choice for each in reported if each.what == "Light model of the mesh"] == ["a flash on the camera"]
    reported = tell_decisions(replace(sample, light="unknown", settings={"mesh": {"max_light_residual": None}}))
    assert [each.choice for each in reported if each.what == "Light model of the mesh"] == ["not estimated"]


@pytest.mark.parametrize("kept", [True, False])
def test_a_start_that_was_kept_is_told(kept: bool) -> None:
    reported = tell_decisions(replace(bare_report(), light="environment", start_kept=kept))
    assert [each.choice for each in reported if each.what == "Surface that was refined"] == (
        ["the first surface, on which training started"] if kept else []
    )


def test_a_flash_is_told_with_its_place() -> None:
    sample = sample_report()
    given = replace(present(sample.input), flash=FlashFacts(-0.1041, -0.23))
    reported = {each.what: each for each in tell_decisions(replace(sample, input=given))}
    flash = reported["Flash on the camera"]
    assert flash.choice == "a lamp 0.1 to the left of the lens and 0.23 above it" and "even light" in flash.why
    assert "Flash on the camera" not in {each.what for each in tell_decisions(sample)}


@pytest.mark.parametrize(
    ("light", "masks", "moved", "choice", "why"),
    [
        ("environment", "given", True, "used", "does not move"),
        ("flash", "given", True, "used", "flash"),
        ("unknown", "none", False, "not used", "needs silhouettes, from masks"),
        ("unknown", "given", False, "not used", "photometric_reach"),
        ("unknown", "found", False, "not used", "photometric_reach"),
        ("unknown", "inexact", False, "not used", "inaccurate"),
    ],
)
def test_photometric_refinement_has_its_reason(light: str, masks: str, moved: bool, choice: str, why: str) -> None:
    steps = {"photometric_refinement": MeshStepRun(1.0, 900, {})} if moved else {}
    given = replace(
        present(sample_report().input),
        masked=masks != "none",
        masks_found=masks == "found" or None,
        mask_error=0.8 if masks == "inexact" else None,
    )
    run = replace(bare_report(), light=light, input=given, mesh_steps=steps)
    reported = {each.what: each for each in tell_decisions(run)}
    decision = reported["Photometric refinement"]
    assert decision.choice == choice and why in decision.why
    choices = {"given": "used", "found": "found", "inexact": "used as inexact", "none": "not used"}
    assert reported["Masks"].choice == choices[masks]
    assert ("opacity of the 3D branch" in reported["Masks"].why) == (masks in ("found", "inexact"))
    alone = {each.what: each for each in tell_decisions(replace(run, gaussians={"surfels": 900}))}
    assert "opacity" not in alone["Masks"].why


def test_the_reflected_light_is_told_with_its_reason() -> None:
    def reported(chosen: str, asked: str, tried: dict[str, float]) -> Decision:
        settings = {"train": {"gaussians": {"reflection": asked}}}
        run = replace(bare_report(), method="mgsr", reflection=Selection(chosen, tried), settings=settings)
        return next(each for each in tell_decisions(run) if each.what == "Reflected light")

    tried = reported("shared", "auto", {"off": 30.0, "shared": 30.614, "both": 30.5})
    assert tried.choice == "environment maps of the whole surface"
    assert "none 30.00 dB; environment maps of the whole surface 30.61 dB" in tried.why
    assert reported("off", "auto", {}).choice == "none" and "No candidates" in reported("off", "auto", {}).why
    assert reported("own", "own", {}).why == "The settings ask for it."


def test_the_colours_harmonics_are_told_where_fewer_were_tried() -> None:
    def reported(tried: dict[str, float]) -> list[Decision]:
        reflection = Selection("shared", {"off": 33.13, "shared": 33.78})
        run = replace(bare_report(), method="mgsr", reflection=reflection, sh_degree=Selection(1, tried))
        return [each for each in tell_decisions(run) if each.what.startswith("SH degree")]

    (lowered,) = reported({"1": 34.44, "0": 33.738})
    assert lowered.choice == "1"
    assert "degree 1 34.44 dB; degree 0 33.74 dB; the original degree 33.78 dB" in lowered.why
    assert reported({}) == []


def test_pixels_that_no_photograph_shows_are_told() -> None:
    sample = sample_report()
    given = replace(present(sample.input), shown=0.8174)
    reported = {each.what: each for each in tell_decisions(replace(sample, input=given))}
    assert reported["Pixels"].choice == "82% are valid"
    assert "Pixels" not in {each.what for each in tell_decisions(sample)}


def test_dropped_gaussians_are_counted() -> None:
    settings = {"train": {"gaussians": {"densify": {"prune_contribution": 0.06}}}}
    data = replace(sample_report(), settings=settings)
    data.iterations["warmup_gaussians"] = StageRun(2000, "converged", dropped=8123)
    reported = next(each for each in tell_decisions(data) if each.what == "Gaussians of the 3D branch")
    assert reported.choice == "21,877" and "8,123 were pruned" in reported.why and "6%" in reported.why


def test_a_runs_own_decisions_stay() -> None:
    own = [Decision("Seed", "0", "asked for")]
    assert with_decisions(replace(sample_report(), decisions=own)).decisions == own
    assert with_decisions(sample_report()).to_json()["decisions"][0]["what"] == "Method"


def test_few_facts_are_enough() -> None:
    data = replace(bare_report(), iterations={}, mesh=None)
    assert [each.what for each in tell_decisions(data)] == ["Method"]


def test_a_time_budget_is_told() -> None:
    budget = BudgetFacts(
        seconds=120.0,
        used=117.2,
        place=0.4,
        settings="between draft and standard (0.40)",
        image_scale=0.5,
        too_small=False,
        planned={"before": 20.0, "train": 60.0, "mesh": 12.0, "evaluate": 5.0, "report": 2.0},
        spent={"load": 1.0, "train": 64.0, "mesh": 10.0, "evaluate": 6.0},
    )
    reported = tell_decisions(replace(sample_report(), time_budget=budget))[1]
    assert reported.what == "Time budget of 120 s" and reported.choice.endswith(
        "photographs reduced to 0.5 of their size"
    )
    assert (
        "The plan was train 60 s" in reported.why
        and "took train 64 s" in reported.why
        and "117 s in all" in reported.why
    )
    short = replace(sample_report(), time_budget=replace(budget, too_small=True))
    assert "shorter than the shortest plan" in tell_decisions(short)[1].why


def test_a_plain_backdrop_is_told_unless_the_settings_say_what_lies_behind() -> None:
    sample = sample_report()

    def reported(background: str, source: str = "hull") -> dict[str, Decision]:
        points = StartFacts(source, 9000)
        given = replace(present(sample.input), masked=False, backdrop=[0.0, 0.502, 1.0], starting_points=points)
        run = replace(sample, input=given, settings={"train": {"background": background}})
        return {each.what: each for each in tell_decisions(run)}

    assert (
        reported("auto")["Backdrop"].choice == "plain, #0080ff" and "learned" in reported("auto")["Silhouettes"].choice
    )
    assert not {"Backdrop", "Silhouettes"} & set(reported("white"))
    assert "Silhouettes" not in reported("auto", "stereo"), "those that come to nothing"
