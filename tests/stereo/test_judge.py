"""The score of given planes, in every variant, against exact homographies in float64."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np
import pytest

from mgsr.native import _stereo
from mgsr.stereo.patch_match import MatchSettings
from tests.ops.variants import ISAS, variant
from tests.oracles import stereo as oracle
from tests.stereo.patterned_plane import PatternedPlane, patterned_plane

OTHER_SETTINGS = MatchSettings(radius=1, spacing=2.0, noise=0.05, alike=0.1, reach=2.0, best=2, cover=0.85)
# The kernel takes perspective for linear over a patch. What that changes falls with the distance of the cameras, whose
# field of view is the narrower: scores differ by up to 0.006 at a distance of 3, and by 0.0004 at 48.
TOLERANCE = 0.03  # over the distance


@pytest.mark.parametrize("isa", ISAS)
@pytest.mark.parametrize("settings", [MatchSettings(), OTHER_SETTINGS], ids=["usual", "other"])
@pytest.mark.parametrize("distance", [3.0, 48.0])
def test_scores_are_those_of_exact_homographies(distance: float, settings: MatchSettings, isa: str) -> None:
    plane = patterned_plane(distance, seed=1)
    with variant(_stereo, isa):
        scores = plane.judged(settings)
    shown = plane.photographs.images[0][..., 3] > 0.5
    assert (scores[~shown] == -1).all() and (~shown).any()
    true = exact(plane, settings, shown)
    found, true = scores[shown][true.clear], true.scores[true.clear]
    np.testing.assert_allclose(found, true, rtol=0, atol=TOLERANCE / distance)
    assert len(true) > 2000 and true[true > -1].std() > 0.2 and (true == -1).sum() > 100


@pytest.mark.parametrize("isa", ISAS)
def test_where_no_depth_is_given_there_is_no_score(isa: str) -> None:
    plane = patterned_plane(3.0, seed=1)
    plane.depth[:, ::2] = 0
    with variant(_stereo, isa):
        scores = plane.judged(MatchSettings())
    assert (scores[:, ::2] == -1).all() and (scores[:, 1::2] > 0.5).any()


def test_one_photograph_alone_has_no_score() -> None:
    assert (patterned_plane(3.0, seed=1).judged(MatchSettings(), others=[]) == -1).all()


def exact(plane: PatternedPlane, settings: MatchSettings, shown: np.ndarray) -> oracle.Judged:
    return oracle.judge(
        [image.astype(np.float64) for image in plane.photographs.images],
        plane.photographs.cameras,
        np.argwhere(shown)[:, ::-1],
        plane.depth[shown].astype(np.float64),
        plane.normal[shown].astype(np.float64),
        plane.span,
        asdict(settings),
    )
