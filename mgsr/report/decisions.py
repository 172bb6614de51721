"""The decisions that were made on the person's behalf, told from the facts in report.json."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from mgsr.report.data import Decision, ReportData

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
    """Return the same run with its decisions told, unless it brings its own."""
    return data if data.decisions else replace(data, decisions=tell_decisions(data))


def tell_decisions(data: ReportData) -> list[Decision]:
    """Return the decisions that follow from the facts of a run: method, masks, test views, stage ends, surface."""
    given: dict[str, Any] = data.other.get("input") or {}
    mesh: dict[str, Any] = (data.other.get("settings") or {}).get("mesh") or {}
    told = [Decision("Method", data.method, METHODS.get(data.method, "The settings ask for it."))]
    return [
        *told,
        *_about_budget(data.other.get("time_budget")),
        *_about_input(given, (data.other.get("settings") or {}).get("train") or {}),
        *_about_stages(data),
        *_about_surface(data, mesh),
        *_about_flash(given.get("flash")),
        *_about_light(data),
    ]


def _about_budget(budget: dict[str, Any] | None) -> Iterator[Decision]:
    if not budget:
        return
    choice = f"settings {budget['settings']}"
    if budget["image_scale"] != 1:
        choice += f", photographs reduced to {budget['image_scale']:g} of their size"
    planned, spent = (
        ", ".join(
            f"{step} {budget[kind][step]:.0f} s" for step in ("train", "mesh", "evaluate") if step in budget[kind]
        )
        for kind in ("planned", "spent")
    )
    why = f"The plan was {planned}. The run took {spent}, and {budget['used']:.0f} s in all."
    if budget["too_small"]:
        why = f"The budget is shorter than the shortest plan, which was run. {why}"
    yield Decision(f"Time budget of {budget['seconds']:g} s", choice, why)


def _about_input(given: dict[str, Any], train: dict[str, Any]) -> Iterator[Decision]:
    if "masked" in given:
        yes = "Every training photograph has a mask. Everything outside is background."
        no = "The splats explain the whole of each photograph."
        yield Decision("Masks", "used" if given["masked"] else "not used", yes if given["masked"] else no)
    if "train_views" in given:
        count = f"{len(given['train_views'])} for training, {len(given.get('test_views', []))} held out"
        yield Decision("Views", count, "Figures named “test” come from photographs that training never saw.")
    if given.get("shown", 1) < 0.995:
        choice = f"{given['shown']:.0%} are valid"
        why = "Undistortion leaves invalid pixels at the borders. Training and scores ignore them."
        yield Decision("Pixels", choice, why)
    if _before_plain_backdrop(given, train):
        color = "#" + "".join(f"{round(255 * value):02x}" for value in given["backdrop"])
        why = (
            "The borders of the photographs have this single colour. It lies behind the splats, which need not "
            "reproduce it."
        )
        yield Decision("Backdrop", f"plain, {color}", why)
    if _outlines_learned(given, train):
        why = "Splats need only cover the object, so their opacity shows its silhouettes."
        yield Decision("Silhouettes", "learned for the start and the surface", why)
    if given.get("exposures"):
        choice = f"differ by a factor of up to {given['exposures']:.2f}"
        why = "All photographs, test views included, are brought to a common exposure. Renders have that exposure."
        yield Decision("Exposures", choice, why)
    if given.get("starting_points"):
        source, count = given["starting_points"]["source"], given["starting_points"]["count"]
        words, why = STARTS.get(source, (str(source), ""))
        yield Decision("Starting points", f"{count:,} {words}", why)


def _before_plain_backdrop(given: dict[str, Any], train: dict[str, Any]) -> bool:
    return bool(given.get("backdrop")) and train.get("background", "auto") == "auto"


def _outlines_learned(given: dict[str, Any], train: dict[str, Any]) -> bool:
    """Return whether masks were learned for the start; masks that come to nothing leave a start without them."""
    source = (given.get("starting_points") or {}).get("source")
    return _before_plain_backdrop(given, train) and source not in ("stereo", "ball")


def _about_stages(data: ReportData) -> Iterator[Decision]:
    for name, run in data.iterations.items():
        reason = STOPS.get(run.stopped, run.stopped)
        yield Decision(f"End of stage “{stage_name(name)}”", f"after {run.iterations:,} iterations", reason)
        if run.dropped:
            branch = name.removeprefix("warmup_")
            share = f"{data.other['settings']['train'][branch]['densify']['prune_contribution']:.0%}"
            why = (
                f"{run.dropped:,} were pruned after the warm-up. Together they contributed less than {share} of the "
                "light."
            )
            yield Decision(SPLATS[branch], f"{data.gaussians[branch]:,}", why)


def _about_surface(data: ReportData, mesh: dict[str, Any]) -> Iterator[Decision]:
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


def _about_flash(flash: dict[str, float] | None) -> Iterator[Decision]:
    if not flash:
        return
    across = f"{abs(flash['right']):.2g} to the {'right' if flash['right'] >= 0 else 'left'}"
    choice = f"a lamp {across} of the lens and {abs(flash['down']):.2g} {'below' if flash['down'] >= 0 else 'above'} it"
    why = "Its shading and shadows are computed for each view. Splats hold colours under even light."
    yield Decision("Flash on the camera", choice, why)


def _about_light(data: ReportData) -> Iterator[Decision]:
    asked: dict[str, Any] = data.other.get("settings") or {}
    if asked.get("mesh", {}).get("max_light_residual", 0) is None:
        yield Decision("Light model of the mesh", "not estimated", "The setting max_light_residual turns it off.")
    elif data.other.get("light") in LIGHTS:
        yield Decision("Light model of the mesh", *LIGHTS[data.other["light"]])
        if "mesh_steps" in data.other:
            yield _about_photometric_refinement(data)
        if data.other.get("start_kept"):
            why = "The trained surface is torn, or photographs agree less on it."
            yield Decision("Surface that was refined", "the first surface, on which training started", why)
        if (removed := _removed_area(data)) > 0:
            why = "Photographs under the flash contradict each other there, as they do where the mesh covers a hole."
            yield Decision("Removed area", f"{removed:.1%}", why)
    reflection: dict[str, Any] = data.other.get("reflection") or {}
    if reflection.get("chosen") in REFLECTIONS and data.method == "mgsr":
        settings: dict[str, Any] = asked.get("train", {}).get("gaussians", {})
        why = "The settings ask for it." if settings.get("reflection") != "auto" else _why_reflected(**reflection)
        yield Decision("Reflected light", REFLECTIONS[reflection["chosen"]], why)
        yield from _about_colors(data.other.get("sh_degree") or {}, reflection)


def _removed_area(data: ReportData) -> float:
    """Return the share of the mesh's area that was removed, as photographs contradict it."""
    step = data.other.get("mesh_steps", {}).get("remove_contradicted")
    return 0.0 if step is None else float(step["outcome"]["removed_area"])


def _about_photometric_refinement(data: ReportData) -> Decision:
    what = "Photometric refinement"
    if "photometric_refinement" in data.other["mesh_steps"]:
        still = (
            "The light does not move"
            if data.other["light"] != "flash"
            else "The irradiance of the flash is known in each photograph"
        )
        return Decision(what, "used", f"{still}, so photographs should agree about each place.")
    given, train = data.other.get("input") or {}, (data.other.get("settings") or {}).get("train") or {}
    if not given.get("masked") and not _before_plain_backdrop(given, train):
        return Decision(what, "not used", "It needs silhouettes, from masks or a plain backdrop, to hold the surface.")
    return Decision(what, "not used", "The setting photometric_reach or the time budget turns it off.")


def _about_colors(degree: dict[str, Any], reflection: dict[str, Any]) -> Iterator[Decision]:
    if not degree.get("tried"):
        return
    reached = "; ".join(f"degree {name} {psnr:.2f} dB" for name, psnr in degree["tried"].items())
    whole = f"the original degree {reflection['tried'][reflection['chosen']]:.2f} dB"
    why = f"The degree was lowered while held-out photographs were rendered no worse: {reached}; {whole}."
    yield Decision("SH degree of the transmitted colour", f"{degree['chosen']}", why)


def _why_reflected(chosen: str, tried: dict[str, float]) -> str:
    if not tried:
        return "The change of brightness between views at the start suggests it. No candidates were compared."
    reached = "; ".join(f"{REFLECTIONS[name]} {psnr:.2f} dB" for name, psnr in tried.items())
    return f"It is the simplest that renders held-out photographs as well as the best: {reached}."
