"""The parts of the evidence page on the scores of runs: surface, methods, curves, and the split of the light."""

from __future__ import annotations

from benchmarks.evidence.comparing import compare, is_busy, plain_runs
from benchmarks.evidence.result_files import Evidence, SceneFacts, image
from mgsr.bench.results import Row
from mgsr.bench.table import markdown, number

NEAR_BEST = 0.1  # dB; a curve that is so near its best has little left to gain
BEFORE_SHADING = "before-shading"


def surface_section(evidence: Evidence) -> str:
    """Return the table of each scene's scores beside the hull's."""
    runs = plain_runs(evidence.rows)
    facts = [fact for fact in evidence.scenes if fact.scene in runs]
    head = ["scene", "difficulty", "Chamfer (hull)", "F (hull)", "normal error (hull)", "NC", "PSNR", "SSIM"]
    cells = [[fact.scene, fact.what, *_beside_the_hull(runs[fact.scene], fact)] for fact in facts]
    ratios = [(runs[f.scene].chamfer or 0) / f.hull_chamfer for f in facts if runs[f.scene].chamfer]
    parts = [
        "## The surface and the visual hull",
        "Masks alone give the visual hull, without any training. On some scenes it is nearly right, so a result "
        "counts if it beats the hull. The runs have the preset `standard` and the method `mgsr`:",
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
    sentences, runs = [], plain_runs(evidence.rows)
    unmasked = plain_runs(evidence.rows, variant="masks=off")
    if unmasked:
        head = ["scene", "Chamfer (with masks)", "F (with masks)", "normal error (with masks)", "PSNR"]
        cells = [[scene, *_beside_masks(row, runs.get(scene))] for scene, row in unmasked.items()]
        sentences += ["Without masks (`masks=off`), before a plain white backdrop:", markdown(head, cells)]
    shading = compare(runs, plain_runs(evidence.rows, variant=BEFORE_SHADING), "chamfer")
    if shading is not None:
        each = ", ".join(f"{scene} {gain:+z.2f}" for scene, gain in shading.gains.items())
        sentences.append(f"Refinement by shading, and all later changes, gain in Chamfer: {each}.")
    return sentences


def _beside_masks(row: Row, masked: Row | None) -> list[str]:
    """Return the cells of a scene without masks, beside those with them."""
    pairs = [("chamfer", ".2f"), ("f_score", ".3f"), ("normal_error", ".1f")]
    beside = ["" if masked is None else f" ({number(getattr(masked, name), form)})" for name, form in pairs]
    own = [number(getattr(row, name), form) + other for (name, form), other in zip(pairs, beside, strict=True)]
    return [*own, number(row.psnr, ".1f")]


def methods_section(evidence: Evidence) -> str:
    """Return the plot of error over seconds, and the rows behind it."""
    plain = [row for row in evidence.rows if not row.variant]
    head = ["scene", "method", "preset", "program", "machine", "seconds", "start", "train", "mesh", "PSNR"]
    head += ["on the object", "Chamfer", "NC"]
    forms = (
        *(("seconds", ".0f"), ("start_seconds", ".0f"), ("train_seconds", ".0f"), ("mesh_seconds", ".0f")),
        *(("psnr", ".2f"), ("psnr_object", ".2f"), ("chamfer", ".2f"), ("normal_consistency", ".2f")),
    )
    cells = [
        [*_run_cells(row), row.commit[:7], row.machine]
        + [
            number(getattr(row, field), form) + ("*" if field == "seconds" and is_busy(row) else "")
            for field, form in forms
        ]
        for row in plain
    ]
    return "\n\n".join(
        (
            "## Speed against error",
            "![Chamfer, normal consistency and PSNR over seconds, one column per scene. A dot is a finished run, a "
            f"dotted line the PSNR of some test views during training]({image('error_seconds.svg')})",
            markdown(head, cells),
            "Compare seconds only between runs on the same machine. Rows of different programs differ in more than the "
            "method and the preset. A star marks runs during which other programs kept the machine busy. Dotted lines "
            "are of two test views and dots of all, so a line need not end at its dot. Chamfer has a logarithmic "
            "scale.",
            *_method_words(evidence),
        )
    )


def _run_cells(row: Row) -> list[str]:
    """Return what tells a run from others of its variant: scene, method and preset, with the seed where it is not 0."""
    return [row.scene, row.method, row.preset + (f", seed {row.seed}" if row.seed else "")]


def _method_words(evidence: Evidence) -> list[str]:
    sentences, mgsr = [], plain_runs(evidence.rows)
    for other, score in (("3dgs", "psnr"), ("3dgs", "chamfer"), ("2dgs", "psnr"), ("2dgs", "chamfer")):
        found = compare(mgsr, plain_runs(evidence.rows, other), score)
        if found is not None:
            sentences.append(f"- `mgsr` beside `{other}`: {found.words()}.")
    return ["\n".join(sentences)] if sentences else []


def curve_section(evidence: Evidence) -> str:
    """Return the table of how soon each plain run was near its best; empty without curves."""
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
    head = ["scene", "method", "preset", "training, s", "near its best after (s)", "share", "best, dB"]
    return "\n\n".join(
        (
            "## Within a run",
            f"The table shows when the PSNR of the curve's two test views first came within {NEAR_BEST} dB of its "
            "best. Later training must improve the surface, or it is wasted. A run that was near its best only at "
            "its end would have gained from more. The two views decide nothing in a run, and no run measures its "
            "Chamfer during training.",
            markdown(head, cells),
        )
    )


def light_section(evidence: Evidence) -> str:
    """Return the table of how true the split of the light is; empty where no run has it."""
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
            "## The accuracy of the light split",
            "The same views were path-traced without gloss. They are compared with the transmitted light of the "
            "render and with the photograph itself, on the object, after one gain per channel. The split gain is "
            "the difference of the two PSNRs. Below zero, the split does harm.",
            markdown(
                ["scene", "method", "preset", "variant", "transmitted, dB", "photograph, dB", "split gain, dB"], cells
            ),
        )
    )
