"""Options of the step `shape_from_shading`: the rounds of its two turns."""

from __future__ import annotations

from mgsr.config.expert.shading import ShadingPass

FIRST_TURN = ShadingPass(edge=1.0, rounds=3, reach=60.0)
SECOND_TURN = ShadingPass(edge=1.0, rounds=2, reach=60.0)
