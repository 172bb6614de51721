"""Build docs/evidence.md and its plots from the result files.

    python -m mgsr.bench.evidence [benchmarks/results] [docs]

Every figure of the page comes from those files, and each sentence that judges does so by comparing them here.
"""

from __future__ import annotations

import csv
import sys
from dataclasses import dataclass, field
from pathlib import Path

from mgsr.bench.ablation_page import ablation_section, choices_section
from mgsr.bench.comparing import compare, is_busy, plain_runs
from mgsr.bench.csv_rows import read_csv
from mgsr.bench.exposure_page import EXPOSURES, ExposureRow, exposure_section
from mgsr.bench.kernel_page import kernel_section
from mgsr.bench.kernel_results import CHOICES, KERNELS, KernelRow, read_kernels
from mgsr.bench.length_page import early_ends, length_section
from mgsr.bench.need_page import need_section
from mgsr.bench.parts_page import FINISH_PARTS, START_PARTS, PartRow, finish_section, start_section
from mgsr.bench.plots import write_kernel_plot, write_plots
from mgsr.bench.results import CURVES, DONE, RUNS, Curve, Row, latest, read_curves, read_rows
from mgsr.bench.sets_page import SETS, SetRow, sets_section
from mgsr.bench.table import markdown, number

PAGE, IMAGES = "evidence.md", Path("images") / "evidence"
COMMAND = "python -m mgsr.bench.evidence"
SCENES = "scenes.csv"
NEAR_BEST = 0.1  # dB; a curve that is so near its best has little left to gain
BEFORE_SHADING = "before-shading"


@dataclass(frozen=True)
class SceneFacts:
    """The facts of a scene, and what the visual hull of its masks alone scores."""

    scene: str
    what: str
    hull_chamfer: float
    hull_f_score: float
    hull_normal_error: float


@dataclass(frozen=True)
class Evidence:
    """All result files.

    rows: of each cell the newest; behind: those that gave way to newer ones, which variants of their commit are
    compared with. choices: kernels in which something was chosen otherwise.
    """

    rows: list[Row]
    curves: list[Curve]
    scenes: list[SceneFacts]
    kernels: list[KernelRow]
    exposures: list[ExposureRow] = field(default_factory=list)
    behind: list[Row] = field(default_factory=list)
    choices: list[KernelRow] = field(default_factory=list)
    sets: list[SetRow] = field(default_factory=list)
    start: list[PartRow] = field(default_factory=list)
    finish: list[PartRow] = field(default_factory=list)

    @property
    def all_rows(self) -> list[Row]:
        return [*self.rows, *self.behind]


def read_evidence(results: Path) -> Evidence:
    """Read the files of a results folder."""
    with open(results / SCENES, newline="", encoding="utf-8") as file:
        scenes = [
            SceneFacts(row.pop("scene"), row.pop("what"), *(float(text) for text in row.values()))
            for row in csv.DictReader(file)
        ]
    rows = [row for row in read_rows(results / RUNS) if row.state == DONE]
    newest = latest(rows)
    kernels, choices = (read_kernels(results / name) for name in (KERNELS, CHOICES))
    exposures = read_csv(results / EXPOSURES, ExposureRow)
    curves, behind = read_curves(results / CURVES), [row for row in rows if row not in newest]
    sets = read_csv(results / SETS, SetRow)
    start, finish = (read_csv(results / name, PartRow) for name in (START_PARTS, FINISH_PARTS))
    return Evidence(newest, curves, scenes, kernels, exposures, behind, choices, sets, start, finish)


def write_evidence(results: Path, docs: Path) -> Path:
    """Write the page and its plots; return its path."""
    evidence = read_evidence(results)
    write_plots(docs / IMAGES, evidence.rows, evidence.curves)
    points = [(row.kernel, row.variant, row.cost, row.error_max) for row in evidence.kernels]
    if points:
        write_kernel_plot(docs / IMAGES / "kernels.svg", points)
    (docs / PAGE).write_text(evidence_page(evidence), encoding="utf-8")
    return docs / PAGE


def evidence_page(evidence: Evidence) -> str:
    """Return the page as Markdown."""
    sections = (
        _lead(evidence),
        _weak_section(evidence),
        _surface_section(evidence),
        sets_section(evidence.sets),
        _methods_section(evidence),
        _curve_section(evidence),
        _light_section(evidence),
        _need_section(evidence),
        length_section(evidence.all_rows),
        exposure_section(evidence.exposures),
        start_section(evidence.start),
        finish_section(evidence.finish),
        ablation_section(evidence.all_rows),
        choices_section(evidence.all_rows),
        kernel_section(evidence.kernels, evidence.choices),
        _making_section(evidence),
    )
    return "\n\n".join(section for section in sections if section) + "\n"


def _lead(evidence: Evidence) -> str:
    runs = evidence.rows
    scenes = ", ".join(dict.fromkeys(row.scene for row in runs))
    return (
        "# Evidence: speed against error\n\n"
        f"How long MGSR takes, how wrong its results are, and which of its parts earn their time: {len(runs)} runs on "
        f"the scenes {scenes}, path-traced objects whose true shape is known. Chamfer is the mean distance between "
        "surface and truth, in thousandths of the object's radius; F the share of the surface within 0.5% of the "
        "radius; the normal error in degrees; NC the normal consistency times 100; PSNR of views that training never "
        f"saw, on white. This page is made by `{COMMAND}` from [benchmarks/results](../benchmarks/results), its "
        "figures and its judgements alike: change the results, not the page."
    )


def _weak_section(evidence: Evidence) -> str:
    """Tell what speaks against the program, before anything that speaks for it."""
    points = [*_weak_scores(evidence), *_weak_measurements(evidence)]
    return "## What is weak\n\n" + "\n".join(f"- {point}" for point in points) if points else ""


def _weak_scores(evidence: Evidence) -> list[str]:
    mgsr, points = plain_runs(evidence.rows), []
    surfels = plain_runs(evidence.rows, "2dgs")
    for score in ("chamfer", "normal_error"):
        found = compare(mgsr, surfels, score)
        if found is not None and len(found.worse) > len(found.better):
            points.append(f"The surface is no better than that of the 2D branch alone: {found.words()}.")
    harmed = [row for row in evidence.rows if row.split_gain is not None and row.split_gain < 0]
    if harmed:
        told = ", ".join(f"{_label(row)} {row.split_gain:.2f} dB" for row in harmed)
        points.append(f"The light split does harm (the photograph itself is nearer to the matte look): {told}.")
    low = [row for row in mgsr.values() if row.f_score is not None and row.f_score < 0.8]
    points += [f"On {row.scene} only {row.f_score:.0%} of the surface lies within 0.5% (F)." for row in low]
    ways = early_ends(evidence.all_rows)
    if ways and not any(way.pays for way in ways):
        most = max(ways, key=lambda way: way.saved)
        points.append(f"No way to end earlier pays. The most that one saves is {most.words}: {most.meaning}.")
    return points


def _weak_measurements(evidence: Evidence) -> list[str]:
    rows, points = evidence.rows, []
    busy = [row for row in rows if row.seconds is not None and is_busy(row)]
    timed = [row for row in rows if row.seconds is not None]
    if busy:
        points.append(
            f"{len(busy)} of {len(timed)} runs shared the machine with other work: their seconds are too many by an "
            "unknown share, and no two of them can be compared."
        )
    presets = {row.preset for row in rows}
    if missing := [name for name in ("draft", "standard", "high") if name not in presets]:
        points.append(f"Presets without any run here: {', '.join(missing)}. So there is no front of presets yet.")
    if len({row.seed for row in rows}) == 1:
        points.append("One seed each: nothing here says how much a result changes by chance.")
    if not any(row.device == "cuda" for row in rows):
        points.append("No run on this page is on a card; benchmarks/results/cuda.md has some.")
    if len({row.commit for row in timed}) > 1:
        points.append("The runs are of several commits; each row of the results names its own.")
    return points


def _surface_section(evidence: Evidence) -> str:
    """Return the table of each scene's scores beside the hull's."""
    runs = plain_runs(evidence.rows)
    facts = [fact for fact in evidence.scenes if fact.scene in runs]
    head = ["scene", "what is hard", "Chamfer (hull)", "F (hull)", "normal error (hull)", "NC", "PSNR", "SSIM"]
    cells = [[fact.scene, fact.what, *_beside_the_hull(runs[fact.scene], fact)] for fact in facts]
    ratios = [(runs[f.scene].chamfer or 0) / f.hull_chamfer for f in facts if runs[f.scene].chamfer]
    parts = [
        "## The surface, beside what the masks alone give",
        "The visual hull, which the masks give without any training, nearly solves such scenes: a result counts where "
        "it beats the hull. `standard`, method `mgsr`:",
        markdown(head, cells),
    ]
    if ratios:
        parts.append(f"Chamfer is {min(ratios):.0%} to {max(ratios):.0%} of the hull's.")
    return "\n\n".join([*parts, *_with_one_change(evidence)])


def _beside_the_hull(row: Row, fact: SceneFacts) -> list[str]:
    return [
        f"{number(row.chamfer, '.2f')} ({fact.hull_chamfer:.2f})",
        f"{number(row.f_score, '.3f')} ({fact.hull_f_score:.3f})",
        f"{number(row.normal_error, '.1f')} ({fact.hull_normal_error:.1f})",
        *(
            number(value, form)
            for value, form in ((row.normal_consistency, ".1f"), (row.psnr, ".1f"), (row.ssim, ".4f"))
        ),
    ]


def _with_one_change(evidence: Evidence) -> list[str]:
    """Compare runs without masks, and those before shading refined the surface."""
    told, runs = [], plain_runs(evidence.rows)
    unmasked = plain_runs(evidence.rows, variant="masks=off")
    if unmasked:
        head = ["scene", "Chamfer (with masks)", "F (with masks)", "normal error (with masks)", "PSNR"]
        cells = [[scene, *_beside_masks(row, runs.get(scene))] for scene, row in unmasked.items()]
        told += ["Without masks (`masks=off`), before the plain white that they then have:", markdown(head, cells)]
    shading = compare(runs, plain_runs(evidence.rows, variant=BEFORE_SHADING), "chamfer")
    if shading is not None:
        each = ", ".join(f"{scene} {gain:+z.2f}" for scene, gain in shading.gains.items())
        told.append(f"What came with refining the surface by shading (and with all else since): Chamfer gains {each}.")
    return told


def _beside_masks(row: Row, masked: Row | None) -> list[str]:
    """Return the cells of a scene without masks, beside those with them."""
    pairs = [("chamfer", ".2f"), ("f_score", ".3f"), ("normal_error", ".1f")]
    beside = ["" if masked is None else f" ({number(getattr(masked, name), form)})" for name, form in pairs]
    own = [number(getattr(row, name), form) + other for (name, form), other in zip(pairs, beside, strict=True)]
    return [*own, number(row.psnr, ".1f")]


def _methods_section(evidence: Evidence) -> str:
    """Return the plot of error over seconds, and the rows behind it."""
    plain = [row for row in evidence.rows if not row.variant]
    head = ["scene", "method", "preset", "seconds", "start", "train", "mesh", "PSNR", "on the object", "Chamfer", "NC"]
    forms = (
        *(("seconds", ".0f"), ("start_seconds", ".0f"), ("train_seconds", ".0f"), ("mesh_seconds", ".0f")),
        *(("psnr", ".2f"), ("psnr_object", ".2f"), ("chamfer", ".2f"), ("normal_consistency", ".2f")),
    )
    cells = [
        _run_cells(row)
        + [
            number(getattr(row, field), form) + ("*" if field == "seconds" and is_busy(row) else "")
            for field, form in forms
        ]
        for row in plain
    ]
    return "\n\n".join(
        (
            "## Speed against error",
            "![Chamfer, normal consistency and PSNR over seconds, a column for each scene; a dot is a finished run, a "
            f"dotted line the PSNR of some test views while it trained]({_image('error_seconds.svg')})",
            markdown(head, cells),
            "A star: others kept the machine busy meanwhile. The dotted lines are of two test views and the dots of "
            "all, so a line need not end at its dot; Chamfer is drawn on a logarithmic scale.",
            *_method_words(evidence),
        )
    )


def _run_cells(row: Row) -> list[str]:
    """Return what tells a run from others of its variant: scene, method and preset, with the seed where it is not 0."""
    return [row.scene, row.method, row.preset + (f", seed {row.seed}" if row.seed else "")]


def _method_words(evidence: Evidence) -> list[str]:
    told, mgsr = [], plain_runs(evidence.rows)
    for other, score in (("3dgs", "psnr"), ("3dgs", "chamfer"), ("2dgs", "psnr"), ("2dgs", "chamfer")):
        found = compare(mgsr, plain_runs(evidence.rows, other), score)
        if found is not None:
            told.append(f"- `mgsr` beside `{other}`: {found.words()}.")
    return ["\n".join(told)] if told else []


def _curve_section(evidence: Evidence) -> str:
    """Return the table of how soon each plain run was near its best."""
    rows, cells = {row.key: row for row in evidence.rows}, []
    for curve in evidence.curves:
        row = rows.get(curve.key)
        if row is None or row.variant or not curve.points:
            continue
        best, end = max(y for _, y in curve.points), curve.points[-1][0]
        near = next(x for x, y in curve.points if y >= best - NEAR_BEST)
        cells.append([*_run_cells(row), f"{end:.0f}", f"{near:.0f}", f"{near / end:.0%}", f"{best:.2f}"])
    if not cells:
        return ""
    head = ["scene", "method", "preset", "training, s", "near its best after, s", "share", "best, dB"]
    return "\n\n".join(
        (
            "## Within a run",
            f"When the PSNR of the two test views that the curve watches first came within {NEAR_BEST} dB of its best. "
            "What training does after that must show in the surface, or it is wasted; a run that was near its best "
            "only at its end would have gained from more. The two views decide nothing in the run itself, and no run "
            "measures its Chamfer on the way.",
            markdown(head, cells),
        )
    )


def _light_section(evidence: Evidence) -> str:
    rows = [row for row in evidence.rows if row.split_gain is not None and row.split_psnr is not None]
    if not rows:
        return ""
    cells = [
        [*_run_cells(row), row.variant or "-", f"{row.split_psnr:.2f}", f"{row.split_psnr - row.split_gain:.2f}",
         f"{row.split_gain:+.2f}"]
        for row in rows if row.split_psnr is not None and row.split_gain is not None
    ]  # fmt: skip
    return "\n\n".join(
        (
            "## How true the light split is",
            "The same views path-traced without any gloss, against the transmitted half of the render and against the "
            "photograph itself, on the object, after a gain of each channel. Below zero, the split does harm.",
            markdown(
                ["scene", "method", "preset", "variant", "transmitted, dB", "photograph, dB", "split gain, dB"], cells
            ),
        )
    )


def _need_section(evidence: Evidence) -> str:
    images = (
        f"![Gaussians of both branches against each score]({_image('error_gaussians.svg')})",
        f"![The most memory that each run held]({_image('memory.svg')})",
    )
    return need_section(evidence.rows, evidence.behind, [fact.scene for fact in evidence.scenes], images)


def _making_section(evidence: Evidence) -> str:
    machines = dict.fromkeys(row.machine for row in evidence.all_rows if row.machine)
    commits = dict.fromkeys(row.commit for row in evidence.all_rows if row.commit)
    return "\n\n".join(
        (
            "## How this was made",
            f"Runs on {'; '.join(machines)}; program at {', '.join(commits)}. Every row of "
            "[runs.csv](../benchmarks/results/runs.csv) has its machine, versions, commit, command and notes "
            "([as a page](../benchmarks/results/runs.md)). To run what is missing, take it into the results and make "
            "this page anew:",
            "<!-- not run: it needs the measurement scenes and hours -->\n```sh\n"
            "mgsr bench ../shared/data/scenes/{spot_soft,teapot_hdr,bunny_flash,wingnut_dark} -o out/bench \\\n"
            "    --methods mgsr,2dgs,3dgs --presets draft,standard --evaluate ../shared/tools/evaluate.py \\\n"
            "    --keep benchmarks/results\n"
            "mgsr bench ../shared/data/scenes/{spot_soft,teapot_hdr} -o out/bench --variant needs \\\n"
            "    --variant time_budget=90 --evaluate ../shared/tools/evaluate.py --keep benchmarks/results\n"
            "mgsr bench ../shared/data/scenes/{spot_soft,bunny_flash} -o out/bench --variant ablations \\\n"
            "    --variant paper-choices --evaluate ../shared/tools/evaluate.py --keep benchmarks/results\n"
            "PYTHONPATH=. python benchmarks/kernels.py ../shared/data/raster --keep benchmarks/results\n"
            "PYTHONPATH=. python benchmarks/kernel_choices.py ../shared/data/raster --keep benchmarks/results\n"
            f"{COMMAND}\n"
            "```",
        )
    )


def _label(row: Row) -> str:
    return " ".join(word for word in (row.scene, row.variant) if word)


def _image(name: str) -> str:
    return (IMAGES / name).as_posix()


if __name__ == "__main__":
    given = [Path(word) for word in sys.argv[1:]]
    print(write_evidence(*given, *[Path("benchmarks/results"), Path("docs")][len(given) :]))
