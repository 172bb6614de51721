"""Build docs/evidence.md and its plots from the result files.

Every figure of the page comes from those files, and each sentence that judges does so by comparing them here.
"""

from __future__ import annotations

from pathlib import Path

from benchmarks.evidence.ablations import ablation_section, choices_section
from benchmarks.evidence.exposures import exposure_section
from benchmarks.evidence.kernel_plot import write_kernel_plot
from benchmarks.evidence.kernels import kernel_section
from benchmarks.evidence.masks import mask_section
from benchmarks.evidence.quality_over_time import PLOT, quality_section, write_quality_plot
from benchmarks.evidence.relighting import relighting_section
from benchmarks.evidence.result_files import IMAGES, Evidence, image, read_evidence
from benchmarks.evidence.scene_needs import need_section
from benchmarks.evidence.scene_sets import sets_section
from benchmarks.evidence.scores import curve_section, light_section, methods_section, surface_section
from benchmarks.evidence.surface_parts import finish_section, start_section
from benchmarks.evidence.training_length import length_section
from benchmarks.evidence.weaknesses import weak_section
from mgsr.bench.plots import write_plots

PAGE = "evidence.md"
COMMAND = "python -m benchmarks.evidence"


def write_evidence(results: Path, docs: Path) -> Path:
    """Write the page and its plots; return its path."""
    evidence = read_evidence(results)
    write_plots(docs / IMAGES, evidence.rows, evidence.curves)
    points = [(row.kernel, row.variant, row.cost, row.error_max) for row in evidence.kernels]
    if points:
        write_kernel_plot(docs / IMAGES / "kernels.svg", points)
    if evidence.quality:
        write_quality_plot(docs / IMAGES / PLOT, evidence.quality)
    (docs / PAGE).write_text(evidence_page(evidence), encoding="utf-8")
    return docs / PAGE


def evidence_page(evidence: Evidence) -> str:
    """Return the page as Markdown."""
    sections = (
        _lead(evidence),
        weak_section(evidence),
        surface_section(evidence),
        sets_section(evidence.sets),
        methods_section(evidence),
        quality_section(evidence.quality, f"![PSNR and Chamfer over the seconds of runs]({image(PLOT)})"),
        curve_section(evidence),
        light_section(evidence),
        _need_section(evidence),
        length_section(evidence.all_rows),
        exposure_section(evidence.exposures),
        mask_section(evidence.masks),
        start_section(evidence.start),
        finish_section(evidence.finish),
        relighting_section(evidence.relighting),
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
        "# Evidence: speed against error\n\nThis page shows how long MGSR takes, how large its errors are, and which "
        f"of its parts are worth their time. It has {len(runs)} runs on the scenes {scenes}, path-traced objects of "
        "known shape. Chamfer is the mean distance between surface and truth, in thousandths of the object's radius. "
        "F is the share of the surface within 0.5% of the radius. The normal error is in degrees, and NC is the "
        f"normal consistency times 100. PSNR is that of views that training never saw, on white. `{COMMAND}` makes "
        "this page, its figures and its judgements alike, from [benchmarks/results](../benchmarks/results): change "
        "the results, not the page."
    )


def _need_section(evidence: Evidence) -> str:
    images = (
        f"![Number of splats of both branches against each score]({image('error_gaussians.svg')})",
        f"![Peak memory of each run]({image('memory.svg')})",
    )
    return need_section(evidence.rows, evidence.behind, [fact.scene for fact in evidence.scenes], images)


def _making_section(evidence: Evidence) -> str:
    machines = dict.fromkeys(row.machine for row in evidence.all_rows if row.machine)
    commits = dict.fromkeys(row.commit for row in evidence.all_rows if row.commit)
    return "\n\n".join(
        (
            "## How this was made",
            f"The machines of the runs are: {'; '.join(machines)}. The program is that of {', '.join(commits)}. Every "
            "row of [runs.csv](../benchmarks/results/runs.csv) has its machine, versions, commit, command and notes "
            "([as a page](../benchmarks/results/runs.md)). These commands make the missing runs, add them to the "
            "results, and make this page again:",
            "<!-- not run: it needs the measurement scenes and hours -->\n```sh\n"
            "mgsr bench ../shared/data/scenes/{spot_soft,teapot_hdr,bunny_flash,wingnut_dark} -o out/bench \\\n"
            "    --methods mgsr,2dgs,3dgs --presets draft,standard --evaluate ../shared/tools/evaluate.py \\\n"
            "    --keep benchmarks/results\n"
            "mgsr bench ../shared/data/scenes/{spot_soft,teapot_hdr} -o out/bench --variant needs \\\n"
            "    --variant time_budget=90 --evaluate ../shared/tools/evaluate.py --keep benchmarks/results\n"
            "mgsr bench ../shared/data/scenes/{spot_soft,bunny_flash} -o out/bench --variant ablations \\\n"
            "    --variant paper-choices --evaluate ../shared/tools/evaluate.py --keep benchmarks/results\n"
            "python -m benchmarks.kernels ../shared/data/raster --keep benchmarks/results\n"
            "python -m benchmarks.kernel_choices ../shared/data/raster --keep benchmarks/results\n"
            f"{COMMAND}\n"
            "```",
        )
    )
