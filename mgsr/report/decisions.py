"""The decisions that were made on the person's behalf, told from the facts in report.json."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from mgsr.report.data import BudgetFacts, Decision, FlashFacts, InputFacts, ReportData, Selection

STAGE_NAMES = {
    "warmup_surfels": "2D alone",
    "warmup_gaussians": "3D alone",
    "mutual": "both",
    "finish": "the branch that renders",
}
STOPS = {
    "iterations": "all planned iterations were spent",
    "converged": "the loss had stopped falling, so more of the same would have gained little",
    "budget": "its share of the time budget was spent",
    "deadline": "the time allowed for this run was over",
}
STARTS = {
    "capture": ("of the capture's own", "they came with the cameras"),
    "hull": (
        "inside the visual hull, where the photographs agree",
        "its outlines bound the object; stereo between neighbours, and shading, tell its hollows",
    ),
    "stereo": ("where the photographs agree", "without masks or points, stereo between neighbours finds the surface"),
    "ball": ("in a ball", "there were neither points nor masks, so any place is as good"),
}
LIGHTS = {
    "flash": (
        "a flash on the camera",
        "it explains how a point's brightness changes from view to view: shading bent the surface",
    ),
    "environment": (
        "an environment map",
        "one map explains how a point changes from view to view: shape from shading bent the first surface, and what "
        "gloss reflects counts less in the photometric refinement",
    ),
    "unknown": ("none", "neither a flash nor an environment map explains how points change from view to view"),
}
SPLATS = {"surfels": "Surfels that give the surface", "gaussians": "Gaussians that give the renders"}
REFLECTIONS = {
    "off": "none",
    "own": "each splat's own",
    "shared": "one environment map that the whole surface reflects",
    "both": "one environment map that the whole surface reflects, and each splat's own",
}
METHODS = {
    "mgsr": "two branches teach each other: flat 2D Gaussians for the shape, 3D Gaussians that split the light",
    "2dgs": "flat 2D Gaussians alone",
    "3dgs": "3D Gaussians alone; the surface comes from their depth",
}


def stage_name(stage: str) -> str:
    """Return a stage's name in words."""
    return STAGE_NAMES.get(stage, stage.replace("_", " "))


def with_decisions(data: ReportData) -> ReportData:
    """Return the same run with its decisions told, unless it brings its own."""
    return data if data.decisions else replace(data, decisions=tell_decisions(data))


def tell_decisions(data: ReportData) -> list[Decision]:
    """Return the decisions that follow from the facts of a run: method, masks, test views, stage ends, surface."""
    return [
        Decision("Method", data.method, METHODS.get(data.method, "as asked for")),
        *_about_budget(data.time_budget),
        *_about_input(data),
        *_about_stages(data),
        *_about_surface(data),
        *_about_flash(None if data.input is None else data.input.flash),
        *_about_light(data),
    ]


def _settings(data: ReportData, *names: str) -> dict[str, Any]:
    """Return a group of the settings, by the names that lead to it; empty if the report has none."""
    group: dict[str, Any] = data.settings or {}
    for name in names:
        group = group.get(name, {})
    return group


def _about_budget(budget: BudgetFacts | None) -> Iterator[Decision]:
    if budget is None:
        return
    choice = f"settings {budget.settings}"
    if budget.image_scale != 1:
        choice += f", photographs at {budget.image_scale:g} of their size"
    planned, spent = (
        ", ".join(f"{step} {times[step]:.0f} s" for step in ("train", "mesh", "evaluate") if step in times)
        for times in (budget.planned, budget.spent)
    )
    why = f"planned {planned}; it came to {spent}, and {budget.used:.0f} s in all"
    if budget.too_small:
        why = f"that is less than the least plan needs, which was run; {why}"
    yield Decision(f"Time budget of {budget.seconds:g} s", choice, why)


def _about_input(data: ReportData) -> Iterator[Decision]:
    given = data.input
    if given is None:
        return
    yes = "every training photograph has a mask: what lies outside is no object and gets no colour"
    no = "no mask is used: the whole of each photograph is explained"
    yield Decision("Masks", "used" if given.masked else "not used", yes if given.masked else no)
    count = f"{len(given.train_views)} to train on, {len(given.test_views)} held back"
    yield Decision("Views", count, "figures named “test” come from photographs that training never saw")
    if given.shown is not None and given.shown < 0.995:
        choice = f"photographs show {given.shown:.0%} of them"
        why = "undoing the lens leaves others at the borders: they are not trained on, and no figure counts them"
        yield Decision("Pixels", choice, why)
    backdrop = _plain_backdrop(data, given)
    if backdrop is not None:
        color = "#" + "".join(f"{round(255 * value):02x}" for value in backdrop)
        why = "the photographs' borders have this one colour: it lies behind the splats, which need not show it"
        yield Decision("Backdrop", f"plain, {color}", why)
    start = given.starting_points
    # Masks that come to nothing leave a start without them.
    if backdrop is not None and (start is None or start.source not in ("stereo", "ball")):
        why = "all that splats need cover is the object: where they are opaque shows where it ends"
        yield Decision("Outlines", "learned, for the start and the surface", why)
    if given.exposures is not None:
        choice = f"differ, up to {given.exposures:.2f} times the light"
        why = "photographs are brought to a common exposure, also those that figures come from; renders have it"
        yield Decision("Exposures", choice, why)
    if start is not None:
        words, why = STARTS.get(start.source, (start.source, ""))
        yield Decision("Starting points", f"{start.count:,} {words}", why)


def _plain_backdrop(data: ReportData, given: InputFacts) -> list[float] | None:
    """Return the colour [3] of a plain backdrop that lies behind the splats, None where the settings say otherwise."""
    return given.backdrop if _settings(data, "train").get("background", "auto") == "auto" else None


def _about_stages(data: ReportData) -> Iterator[Decision]:
    for name, run in data.iterations.items():
        reason = STOPS.get(run.stopped, run.stopped)
        yield Decision(f"End of stage “{stage_name(name)}”", f"after {run.iterations:,} iterations", reason)
        if run.dropped:
            branch = name.removeprefix("warmup_")
            share = f"{_settings(data, 'train', branch, 'densify')['prune_contribution']:.0%}"
            why = f"{run.dropped:,} went after the warm-up: together they contributed less than {share} of the light"
            yield Decision(SPLATS[branch], f"{data.gaussians[branch]:,}", why)


def _about_surface(data: ReportData) -> Iterator[Decision]:
    mesh = _settings(data, "mesh")
    extractor = str(mesh.get("extractor", ""))
    if extractor == "poisson":
        yield Decision("Surface", "screened Poisson", "it uses the rendered normals as well as the depths")
    if extractor == "tsdf":
        yield Decision("Surface", "TSDF fusion", "the rendered depths are averaged in a grid")
    if data.mesh is not None and data.mesh.boundary_edges:
        left = "left open" if not mesh.get("close_holes") else "some could not be closed"
        yield Decision("Holes", left, "where no view showed a surface, none is invented")


def _about_flash(flash: FlashFacts | None) -> Iterator[Decision]:
    if flash is None:
        return
    across = f"{abs(flash.right):.2g} to the {'right' if flash.right >= 0 else 'left'}"
    choice = f"a lamp {across} of the lens and {abs(flash.down):.2g} {'below' if flash.down >= 0 else 'above'} it"
    why = "its shading and shadows are computed for each view: the splats' own colours are those under even light"
    yield Decision("Flash on the camera", choice, why)


def _about_light(data: ReportData) -> Iterator[Decision]:
    if _settings(data, "mesh").get("max_light_residual", 0) is None:
        yield Decision("Light model of the mesh", "not looked at", "as the settings have it (max_light_residual)")
    elif data.light in LIGHTS:
        yield Decision("Light model of the mesh", *LIGHTS[data.light])
        if data.mesh_steps is not None:
            yield _about_photometric_refinement(data)
        if data.start_kept:
            why = "the surface that training made is torn, or the photographs agree less about what lies on it"
            yield Decision("Surface that was refined", "the one that training began on", why)
        if (removed := _removed_area(data)) > 0:
            why = "photographs under the flash contradict each other about it, as they do where a hole is covered"
            yield Decision("Removed area", f"{removed:.1%}", why)
    reflection = data.reflection
    if reflection is not None and str(reflection.chosen) in REFLECTIONS and data.method == "mgsr":
        asked = _settings(data, "train", "gaussians").get("reflection")
        why = "as asked for" if asked != "auto" else _why_reflected(reflection)
        yield Decision("Reflected light", REFLECTIONS[str(reflection.chosen)], why)
        if data.sh_degree is not None:
            yield from _about_colors(data.sh_degree, reflection)


def _removed_area(data: ReportData) -> float:
    """Return the share of the mesh's area that was removed, as photographs contradict it."""
    step = (data.mesh_steps or {}).get("remove_contradicted")
    return 0.0 if step is None else float(step.outcome["removed_area"])


def _about_photometric_refinement(data: ReportData) -> Decision:
    what = "Photometric refinement of the surface"
    if "photometric_refinement" in (data.mesh_steps or {}):
        still = "the light stands still" if data.light != "flash" else "the flash's light is known for each"
        return Decision(what, "used", f"{still}, so photographs should agree about each place")
    given = data.input
    if given is None or (not given.masked and _plain_backdrop(data, given) is None):
        return Decision(what, "not used", "it needs outlines, of masks or before a plain backdrop, to hold the surface")
    return Decision(what, "not used", "the settings (photometric_reach) or the time budget have it so")


def _about_colors(degree: Selection, reflection: Selection) -> Iterator[Decision]:
    if not degree.tried:
        return
    reached = "; ".join(f"degree {name} {psnr:.2f} dB" for name, psnr in degree.tried.items())
    whole = f"with all of them {reflection.tried[str(reflection.chosen)]:.2f} dB"
    why = f"lowered while held-out photographs were rendered no worse: {reached}; {whole}"
    yield Decision("Harmonics of the transmitted colour", f"up to degree {degree.chosen}", why)


def _why_reflected(reflection: Selection) -> str:
    if not reflection.tried:
        return "so the start's look at how brightness changes from view to view suggests; it was not tried"
    reached = "; ".join(f"{REFLECTIONS[name]} {psnr:.2f} dB" for name, psnr in reflection.tried.items())
    return f"the simplest that renders held-out photographs as well as the best: {reached}"
