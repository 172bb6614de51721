"""The worth of each part of finding the starting surface and of finishing the trained one, and its evidence sections.

`benchmarks/start_parts.py` and `benchmarks/finish_parts.py` measure it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from mgsr.bench.table import markdown

START_PARTS, FINISH_PARTS = "start_parts.csv", "finish_parts.csv"
ALL = "all parts"


@dataclass(frozen=True)
class PartRow:
    """The surface of a scene with one part left out, or with ALL.

    Chamfer in thousandths of the object's radius, the normal error in degrees; seconds: the processor's, of finding the
    surface.
    """

    scene: str
    without: str
    chamfer: float
    normal_error: float
    seconds: float
    commit: str


def start_section(rows: Sequence[PartRow]) -> str:
    """Return the table of the start's parts; empty without rows."""
    return _section(
        "## The value of the parts of the start",
        "The first surface was reconstructed once with all parts and once without each of them.",
        "Seconds exclude the search of stereo, which is the same in all rows.",
        "start_parts",
        rows,
    )


def finish_section(rows: Sequence[PartRow]) -> str:
    """Return the table of the parts that finish the surface; empty without rows."""
    return _section(
        "## The value of the parts of the refinement",
        "The surface was extracted from the same trained surfels, once with all parts and once without each of them.",
        "Seconds exclude the rendering of the views, which is the same in all rows.",
        "finish_parts",
        rows,
    )


def _section(title: str, what: str, seconds: str, script: str, rows: Sequence[PartRow]) -> str:
    whole = {row.scene: row for row in rows if row.without == ALL}
    parts = list(dict.fromkeys(row.without for row in rows if row.without != ALL))
    if not whole or not parts:
        return ""
    commits = ", ".join(dict.fromkeys(row.commit for row in rows))
    head = ["left out", "Chamfer, mean", "normal error, mean", "helps", "hurts", "helps most", "hurts most", "s"]
    without = [[row for row in rows if row.without == part and row.scene in whole] for part in parts]
    return "\n\n".join(
        (
            title,
            f"{what} The table shows the rise of the Chamfer distance and of the normal error without a part. It is "
            f"the mean over {len(whole)} scenes of the tuning set ({', '.join(whole)}). The table also counts the "
            "scenes on which the part improves or worsens the Chamfer distance by more than 1%, and gives its "
            f"processor seconds. {seconds} The program is that of {commits}. `python -m benchmarks.{script}` makes "
            "these figures.",
            markdown(head, [_part(of_part, whole) for of_part in without if of_part]),
        )
    )


def _part(rows: Sequence[PartRow], whole: dict[str, PartRow]) -> list[str]:
    gains = {row.scene: row.chamfer - whole[row.scene].chamfer for row in rows}
    shares = [gains[row.scene] / whole[row.scene].chamfer for row in rows]
    best, worst = max(gains, key=lambda scene: gains[scene]), min(gains, key=lambda scene: gains[scene])
    return [
        rows[0].without,
        f"{sum(gains.values()) / len(rows):+.2f}",
        f"{sum(row.normal_error - whole[row.scene].normal_error for row in rows) / len(rows):+.1f}",
        str(sum(share > 0.01 for share in shares)),
        str(sum(share < -0.01 for share in shares)),
        f"{best} {gains[best]:+.2f}",
        f"{worst} {gains[worst]:+.2f}",
        f"{sum(whole[row.scene].seconds - row.seconds for row in rows) / len(rows):.1f}",
    ]
