"""The ablation rows that `mgsr bench --variant` takes by name: the paper's, and ours."""

from __future__ import annotations

from dataclasses import dataclass

from mgsr.config import ABLATIONS, METHODS


@dataclass(frozen=True)
class AblationRow:
    """One ablation row: its name, its change, and its run, a method with ``key=value`` overrides.

    Rows of one run share it: E, I and M are the method itself, B is the method `2dgs`.
    """

    name: str
    meaning: str
    method: str
    overrides: tuple[str, ...]


def _paper_row(name: str, meaning: str) -> AblationRow:
    settings = tuple(f"{key}={value}" for key, value in ABLATIONS[name].items())
    if ABLATIONS[name] == METHODS["2dgs"]:
        return AblationRow(name, meaning, "2dgs", ())
    return AblationRow(name, meaning, "mgsr", settings)


PAPER_ROWS = (
    _paper_row("A", "no 2D branch: 3D Gaussians with the light split alone"),
    _paper_row("B", "no 3D branch: 2D Gaussians alone"),
    _paper_row("C", "more weight on the 3D branch"),
    _paper_row("D", "more weight on the 2D branch"),
    _paper_row("E", "the method (I and M are the same)"),
    _paper_row("F", "more weight on the mutual depth loss"),
    _paper_row("G", "a quarter of the mutual phase"),
    _paper_row("H", "half of the mutual phase"),
    _paper_row("J", "one and a half times the mutual phase"),
    _paper_row("K", "gradients into the taught branch only"),
    _paper_row("L", "no auto-stop of the warm-up"),
    _paper_row("N", "no TV losses"),
)

# Where a default differs from the paper's: the run that takes the paper's choice instead.
PAPER_CHOICES = (
    AblationRow("paper-photo", "photograph's share in the 2D target 0.5 (ours 0.3)", "mgsr", ("photo_weight=0.5",)),
    AblationRow(
        "paper-light",
        "each splat has its own reflection (ours what model selection finds)",
        "mgsr",
        ("reflection=own",),
    ),
    AblationRow("paper-flash", "colours as a flash shows them (ours as under even light)", "mgsr", ("flash=off",)),
    AblationRow(
        "paper-rates",
        "rates do not fade (ours do in the second half)",
        "mgsr",
        ("surfels.rates.final_factor=1", "gaussians.rates.final_factor=1"),
    ),
    AblationRow("paper-depth-tv", "TV of the 2D depth 1 (ours 0.1)", "mgsr", ("surfels.depth_tv_weight=1",)),
    AblationRow("paper-tran-tv", "TV of the transmitted image 1 (ours 0.05)", "mgsr", ("transmitted_tv_weight=1",)),
    AblationRow("paper-reflected", "reflected light costs nothing (ours 0.15)", "mgsr", ("reflected_cost=0",)),
    AblationRow("paper-stop", "warm-up ends by the last 100 losses (ours by epochs)", "mgsr", ("stop_rule=paper",)),
    AblationRow(
        "paper-depth-unit", "depths over their maximum (ours over the distance)", "mgsr", ("depth_unit=maximum",)
    ),
    AblationRow("paper-low-pass", "3DGS's low-pass of 0.3 px² (ours 0.05)", "mgsr", ("low_pass=0.3",)),
    AblationRow("paper-depth", "expected depth (ours median)", "mgsr", ("surface_depth=expected",)),
    AblationRow("paper-mesh", "TSDF fusion (ours screened Poisson)", "mgsr", ("extractor=tsdf",)),
    AblationRow(
        "paper-parallax",
        "no parallax in the mesh (ours where there are outlines)",
        "mgsr",
        ("photometric_reach=none",),
    ),
    AblationRow(
        "paper-holes",
        "nothing is taken out of the mesh (ours what photographs under a flash differ about)",
        "mgsr",
        ("photometric_residual=none",),
    ),
    AblationRow(
        "paper-shading",
        "neither shading nor parallax in the mesh (ours where photographs tell them)",
        "mgsr",
        ("max_light_residual=none",),
    ),
    AblationRow(
        "paper-smoothing",
        "waves and noise stay in the mesh (ours takes them, but not creases)",
        "mgsr",
        ("regression_angle=none", "bilateral_angle=none"),
    ),
)

# Where a run takes no more than its scene needs: the run that takes more.
NEED_ROWS = (
    AblationRow(
        "need-light", "environment map, and a reflection of each splat's own, everywhere", "mgsr", ("reflection=both",)
    ),
    AblationRow(
        "need-colors",
        "those, and colours of degree 3 in both branches",
        "mgsr",
        ("reflection=both", "gaussians.sh_degree=3", "surfels.sh_degree=3"),
    ),
    AblationRow(
        "need-contribution",
        "splats that carry next to nothing stay",
        "mgsr",
        ("surfels.densify.prune_contribution=0", "gaussians.densify.prune_contribution=0"),
    ),
    AblationRow(
        "need-count",
        "splats that carry next to nothing stay, and densification has no limit, as in 3DGS",
        "mgsr",
        (
            "surfels.densify.prune_contribution=0",
            "gaussians.densify.prune_contribution=0",
            "surfels.densify.max_count=200000",
            "gaussians.densify.max_count=200000",
        ),
    ),
    AblationRow("need-pixels", "pixels far outside the masks count too", "mgsr", ("crop_margin=none",)),
    AblationRow("need-size", "warm-ups begin with whole photographs", "mgsr", ("warmup.coarse=0",)),
    AblationRow("L", "warm-ups end with their iterations alone", "mgsr", ("stop_rule=none",)),
)


def named_rows() -> dict[str, AblationRow]:
    """Return every row by its name, I and M among them."""
    rows = {row.name: row for row in (*NEED_ROWS, *PAPER_CHOICES, *PAPER_ROWS)}
    return rows | {"I": rows["E"], "M": rows["E"]}
