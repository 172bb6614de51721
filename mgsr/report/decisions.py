"""The decisions that a run makes for the user, as report.json records them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from mgsr.report.data import BudgetFacts, Decision, FlashFacts, InputFacts, ReportData, Selection

STAGE_NAMES = {
    "warmup_surfels": "2D branch",
    "warmup_gaussians": "3D branch",
    "mutual": "both",
    "finish": "the branch that renders",
}
STOPS = {
    "iterations": "All planned iterations were spent.",
    "converged": "The loss had stopped falling, so more iterations would have gained little.",
    "budget": "The stage had spent its share of the time budget.",
    "deadline": "The run had reached its deadline.",
}
STARTS = {
    "capture": ("of the capture", "The capture provides them with its cameras."),
    "hull": (
        "inside the visual hull, where photographs agree",
        "Silhouettes bound the object. Stereo and shading reveal its concavities.",
    ),
    "stereo": (
        "where photographs agree",
        "Without masks and points, stereo between neighbouring photographs finds the surface.",
    ),
    "ball": ("in a ball", "There were neither points nor masks, so the points are random."),
}
LIGHTS = {
    "flash": (
        "a flash on the camera",
        "A flash explains how brightness changes between views, so shading refined the surface.",
    ),
    "environment": (
        "an environment map",
        "One map explains how brightness changes between views. Shape from shading refined the first surface, and "
        "reflected detail counts less in photometric refinement.",
    ),
    "unknown": ("none", "Neither a flash nor an environment map explains how brightness changes between views."),
}
SPLATS = {"surfels": "Surfels of the 2D branch", "gaussians": "Gaussians of the 3D branch"}
REFLECTIONS = {
    "off": "none",
    "own": "each splat's own reflection",
    "shared": "environment maps of the whole surface",
    "both": "environment maps of the whole surface, and each splat's own reflection",
}
METHODS = {
    "mgsr": "Two branches teach each other. Surfels learn the shape, and Gaussians split the light.",
    "2dgs": "Surfels are trained alone.",
    "3dgs": "Gaussians are trained alone. The surface comes from their depth.",
}


def stage_name(stage: str) -> str:
    """Return a stage's name in words."""
    return STAGE_NAMES.get(stage, stage.replace("_", " "))


def with_decisions(data: ReportData) -> ReportData:
    """Fill in the decisions of a report that has none."""
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
        choice += f", photographs reduced to {budget.image_scale:g} of their size"
    planned, spent = (
        ", ".join(f"{step} {times[step]:.0f} s" for step in ("train", "mesh", "evaluate") if step in times)
        for times in (budget.planned, budget.spent)
    )
    why = f"The plan was {planned}. The run took {spent}, and {budget.used:.0f} s in all."
    if budget.too_small:
        why = f"The budget is shorter than the shortest plan, which was run. {why}"
    yield Decision(f"Time budget of {budget.seconds:g} s", choice, why)


def _about_input(data: ReportData) -> Iterator[Decision]:
    given = data.input
    if given is None:
        return
    traced = " The opacity of the 3D branch outlines the final surface." if data.gaussians.get("gaussians") else ""
    if given.masks_found:
        why = f"One object stands out in the photographs. Everything around it is background.{traced}"
        yield Decision("Masks", "found", why)
    elif given.mask_error is not None:
        why = (
            f"Their contours contradict each other by {given.mask_error:.1f} pixels, so the surface follows them less."
            f"{traced}"
        )
        yield Decision("Masks", "used as inexact", why)
    elif given.masked:
        yield Decision("Masks", "used", "Every training photograph has a mask. Everything outside is background.")
    else:
        yield Decision("Masks", "not used", "The splats explain the whole of each photograph.")
    count = f"{len(given.train_views)} for training, {len(given.test_views)} held out"
    yield Decision("Views", count, "Figures named “test” come from photographs that training never saw.")
    if given.shown is not None and given.shown < 0.995:
        choice = f"{given.shown:.0%} are valid"
        why = "Undistortion leaves invalid pixels at the borders. Training and scores ignore them."
        yield Decision("Pixels", choice, why)
    backdrop = _plain_backdrop(data, given)
    if backdrop is not None:
        color = "#" + "".join(f"{round(255 * value):02x}" for value in backdrop)
        why = (
            "The borders of the photographs have this single colour. It lies behind the splats, which need not "
            "reproduce it."
        )
        yield Decision("Backdrop", f"plain, {color}", why)
    start = given.starting_points
    # If no masks could be learned, the start does without them.
    if backdrop is not None and (start is None or start.source not in ("stereo", "ball")):
        why = "Splats need only cover the object, so their opacity shows its silhouettes."
        yield Decision("Silhouettes", "learned for the start and the surface", why)
    if given.camera_shift is not None:
        choice = f"adjusted by {given.camera_shift:.2f} pixels in the median"
        yield Decision("Cameras", choice, "The photographs agree better about the scene's surfaces with these cameras.")
    if given.exposures is not None:
        choice = f"differ by a factor of up to {given.exposures:.2f}"
        why = "All photographs, test views included, are brought to a common exposure. Renders have that exposure."
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
            why = (
                f"{run.dropped:,} were pruned after the warm-up. Together they held less than {share} of all "
                "contributions."
            )
            yield Decision(SPLATS[branch], f"{data.gaussians[branch]:,}", why)


def _about_surface(data: ReportData) -> Iterator[Decision]:
    mesh = _settings(data, "mesh")
    extractor = str(mesh.get("extractor", ""))
    if extractor == "poisson":
        yield Decision(
            "Surface", "screened Poisson", "Poisson reconstruction uses the rendered normals as well as the depths."
        )
    if extractor == "tsdf":
        yield Decision("Surface", "TSDF fusion", "A voxel grid averages the rendered depths.")
    if data.mesh is not None and data.mesh.boundary_edges:
        left = "left open" if not mesh.get("close_holes") else "some remain open"
        yield Decision("Holes", left, "Where no view shows a surface, MGSR invents none.")


def _about_flash(flash: FlashFacts | None) -> Iterator[Decision]:
    if flash is None:
        return
    across = f"{abs(flash.right):.2g} to the {'right' if flash.right >= 0 else 'left'}"
    choice = f"a lamp {across} of the lens and {abs(flash.down):.2g} {'below' if flash.down >= 0 else 'above'} it"
    why = "Its shading and shadows are computed for each view. Splats hold colours under even light."
    yield Decision("Flash on the camera", choice, why)


def _about_light(data: ReportData) -> Iterator[Decision]:
    if _settings(data, "mesh").get("max_light_residual", 0) is None:
        yield Decision("Light model of the mesh", "not estimated", "The setting max_light_residual turns it off.")
    elif data.light in LIGHTS:
        yield Decision("Light model of the mesh", *LIGHTS[data.light])
        if data.mesh_steps is not None:
            yield _about_photometric_refinement(data)
        if data.start_kept:
            why = "The trained surface is torn, or photographs agree less on it."
            yield Decision("Surface that was refined", "the first surface, on which training started", why)
        if (removed := _removed_area(data)) > 0:
            why = "Photographs under the flash contradict each other there, as they do where the mesh covers a hole."
            yield Decision("Removed area", f"{removed:.1%}", why)
    reflection = data.reflection
    if reflection is not None and str(reflection.chosen) in REFLECTIONS and data.method == "mgsr":
        asked = _settings(data, "train", "gaussians").get("reflection")
        why = "The settings ask for it." if asked != "auto" else _why_reflected(reflection)
        yield Decision("Reflected light", REFLECTIONS[str(reflection.chosen)], why)
        if data.sh_degree is not None:
            yield from _about_colors(data.sh_degree, reflection)


def _removed_area(data: ReportData) -> float:
    """Return the share of the mesh's area that was removed because photographs contradict it."""
    step = (data.mesh_steps or {}).get("remove_contradicted")
    return 0.0 if step is None else float(step.outcome["removed_area"])


def _about_photometric_refinement(data: ReportData) -> Decision:
    what = "Photometric refinement"
    if "photometric_refinement" in (data.mesh_steps or {}):
        still = (
            "The light does not move"
            if data.light != "flash"
            else "The irradiance of the flash is known in each photograph"
        )
        return Decision(what, "used", f"{still}, so photographs should agree about each place.")
    given = data.input
    if given is None or (not given.masked and _plain_backdrop(data, given) is None):
        return Decision(what, "not used", "It needs silhouettes, from masks or a plain backdrop, to hold the surface.")
    if given.mask_error is not None:
        return Decision(what, "not used", "The contours of the masks are too inaccurate to hold the trained surface.")
    return Decision(what, "not used", "The setting photometric_reach or the time budget turns it off.")


def _about_colors(degree: Selection, reflection: Selection) -> Iterator[Decision]:
    if not degree.tried:
        return
    reached = "; ".join(f"degree {name} {psnr:.2f} dB" for name, psnr in degree.tried.items())
    whole = f"the original degree {reflection.tried[str(reflection.chosen)]:.2f} dB"
    why = f"The degree was lowered while held-out photographs were rendered no worse: {reached}; {whole}."
    yield Decision("SH degree of the transmitted colour", f"{degree.chosen}", why)


def _why_reflected(reflection: Selection) -> str:
    if not reflection.tried:
        return "The change of brightness between views at the start suggests it. No candidates were compared."
    reached = "; ".join(f"{REFLECTIONS[name]} {psnr:.2f} dB" for name, psnr in reflection.tried.items())
    return f"It is the simplest that renders held-out photographs as well as the best: {reached}."
