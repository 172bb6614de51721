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
    _paper_row("C", "a larger weight of the 3D branch"),
    _paper_row("D", "a larger weight of the 2D branch"),
    _paper_row("E", "the method itself (I and M are the same)"),
    _paper_row("F", "a larger weight of the mutual depth loss"),
    _paper_row("G", "a quarter of the mutual phase"),
    _paper_row("H", "half of the mutual phase"),
    _paper_row("J", "one and a half times the mutual phase"),
    _paper_row("K", "gradients into the taught branch only"),
    _paper_row("L", "the warm-up never stops early"),
    _paper_row("N", "no TV losses"),
)

# Where a default differs from the paper's: the run that takes the paper's choice instead.
PAPER_CHOICES = (
    AblationRow(
        "paper-photo", "the photograph's share in the 2D target is 0.5 (default 0.3)", "mgsr", ("photo_weight=0.5",)
    ),
    AblationRow(
        "paper-light",
        "each splat has its own reflection (default: model selection decides)",
        "mgsr",
        ("reflection=own",),
    ),
    AblationRow(
        "paper-flash",
        "colours include the shading of a flash (default: colours under even light)",
        "mgsr",
        ("flash=off",),
    ),
    AblationRow(
        "paper-rates",
        "learning rates stay constant (default: they decay in the second half)",
        "mgsr",
        ("surfels.rates.final_factor=1", "gaussians.rates.final_factor=1"),
    ),
    AblationRow(
        "paper-depth-tv",
        "the weight of the 2D depth's total variation is 1 (default 0.1)",
        "mgsr",
        ("surfels.depth_tv_weight=1",),
    ),
    AblationRow(
        "paper-tran-tv",
        "the weight of the transmitted image's total variation is 1 (default 0.05)",
        "mgsr",
        ("transmitted_tv_weight=1",),
    ),
    AblationRow("paper-reflected", "reflected light has no cost (default 0.15)", "mgsr", ("reflected_cost=0",)),
    AblationRow(
        "paper-stop", "a warm-up ends by the last 100 losses (default: by whole epochs)", "mgsr", ("stop_rule=paper",)
    ),
    AblationRow(
        "paper-depth-unit",
        "depths are divided by their maximum (default: by the camera's distance)",
        "mgsr",
        ("depth_unit=maximum",),
    ),
    AblationRow("paper-low-pass", "the low-pass filter of 3DGS, 0.3 px² (default 0.05)", "mgsr", ("low_pass=0.3",)),
    AblationRow("paper-depth", "expected depth (default: median depth)", "mgsr", ("surface_depth=expected",)),
    AblationRow("paper-mesh", "TSDF fusion (default: screened Poisson)", "mgsr", ("extractor=tsdf",)),
    AblationRow(
        "paper-parallax",
        "no photometric refinement (default: with silhouettes)",
        "mgsr",
        ("photometric_reach=none",),
    ),
    AblationRow(
        "paper-holes",
        "contradicted patches stay in the mesh (default: removed under a flash)",
        "mgsr",
        ("photometric_residual=none",),
    ),
    AblationRow(
        "paper-shading",
        "neither shape from shading nor photometric refinement (default: both where they apply)",
        "mgsr",
        ("max_light_residual=none",),
    ),
    AblationRow(
        "paper-smoothing",
        "waves and noise stay in the mesh (default: smoothed, with creases kept)",
        "mgsr",
        ("regression_angle=none", "bilateral_angle=none"),
    ),
)

# Where a run takes no more than its scene needs: the run that takes more.
NEED_ROWS = (
    AblationRow(
        "need-light", "environment maps and each splat's own reflection in every scene", "mgsr", ("reflection=both",)
    ),
    AblationRow(
        "need-colors",
        "the same, with SH degree 3 in both branches",
        "mgsr",
        ("reflection=both", "gaussians.sh_degree=3", "surfels.sh_degree=3"),
    ),
    AblationRow(
        "need-contribution",
        "no pruning by contribution",
        "mgsr",
        ("surfels.densify.prune_contribution=0", "gaussians.densify.prune_contribution=0"),
    ),
    AblationRow(
        "need-count",
        "no pruning by contribution and no limit of the number of splats, as in 3DGS",
        "mgsr",
        (
            "surfels.densify.prune_contribution=0",
            "gaussians.densify.prune_contribution=0",
            "surfels.densify.max_count=200000",
            "gaussians.densify.max_count=200000",
        ),
    ),
    AblationRow("need-pixels", "pixels far outside the masks count as well", "mgsr", ("crop_margin=none",)),
    AblationRow("need-size", "warm-ups use photographs of full size from the beginning", "mgsr", ("warmup.coarse=0",)),
    AblationRow("L", "warm-ups never stop early", "mgsr", ("stop_rule=none",)),
)


def named_rows() -> dict[str, AblationRow]:
    """Return every row by its name, I and M among them."""
    rows = {row.name: row for row in (*NEED_ROWS, *PAPER_CHOICES, *PAPER_ROWS)}
    return rows | {"I": rows["E"], "M": rows["E"]}
