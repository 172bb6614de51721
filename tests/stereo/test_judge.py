"""The score of given planes, in every variant, against exact homographies in float64."""

from __future__ import annotations

import numpy as np
import pytest

from mgsr.native import _stereo
from mgsr.native.structs import StereoSettings
from tests.ops.variants import ISAS, variant
from tests.oracles import stereo as oracle
from tests.stereo.patterned_plane import SIDE, PatternedPlane, patterned_plane

OTHER_SETTINGS = StereoSettings(radius=1, spacing=2.0, noise=0.05, alike=0.1, reach=2.0, best=2, cover=0.85)
# The kernel takes perspective for linear over a patch. What that changes falls with the distance of the cameras, whose
# field of view is the narrower: scores differ by up to 0.006 at a distance of 3, and by 0.0004 at 48.
TOLERANCE = 0.03  # over the distance


@pytest.mark.parametrize("isa", ISAS)
@pytest.mark.parametrize("settings", [StereoSettings(), OTHER_SETTINGS], ids=["usual", "other"])
@pytest.mark.parametrize("distance", [3.0, 48.0])
def test_scores_are_those_of_exact_homographies(distance: float, settings: StereoSettings, isa: str) -> None:
    plane = patterned_plane(distance, seed=1)
    with variant(_stereo, isa):
        scores = plane.judged(settings)
    shown = plane.photographs.images[0][..., 3] > 0.5
    assert (scores[~shown] == -1).all() and (~shown).any()
    true = exact(plane, settings, shown)
    assert_alike(scores[shown], true, TOLERANCE / distance)
    clear = true.scores[true.clear]
    assert len(clear) > 2000 and clear[clear > -1].std() > 5 * TOLERANCE / distance and (clear == -1).sum() > 100


@pytest.mark.parametrize("isa", ISAS)
@pytest.mark.parametrize("settings", [StereoSettings(), StereoSettings(best=1)], ids=["three", "one"])
def test_neighbours_that_do_not_show_a_patch_are_left_out(settings: StereoSettings, isa: str) -> None:
    """Check that neighbours that do not show a patch are left out, as in a hollow, or at an image's border.

    Most of five neighbours show the left half of the plane alone.
    """
    plane = patterned_plane(48.0, seed=1)
    for blind in plane.photographs.images[3:]:
        blind[:, SIDE // 2 :, 3] = 0
    with variant(_stereo, isa):
        scores = plane.judged(settings)
    shown = plane.photographs.images[0][..., 3] > 0.5
    true = exact(plane, settings, shown)
    # One neighbour's error is larger than the mean of three neighbours' errors.
    assert_alike(scores[shown], true, np.sqrt(3) * TOLERANCE / 48)
    found = [scores[shown][true.clear & (true.seen == seen)] for seen in range(4)]
    assert all(len(each) > 50 for each in found), "all numbers of neighbours occur"
    assert (found[0] == -1).all()
    assert (found[1] == -1).all() if settings.best > 1 else np.median(found[1]) > 0
    # The planes nearly fit; a neighbour that counted as -1 would draw the mean of three below a third.
    assert (found[2] > 0.5).sum() > 50


@pytest.mark.parametrize("isa", ISAS)
def test_where_no_depth_is_given_there_is_no_score(isa: str) -> None:
    plane = patterned_plane(3.0, seed=1)
    plane.depth[:, ::2] = 0
    with variant(_stereo, isa):
        scores = plane.judged(StereoSettings())
    assert (scores[:, ::2] == -1).all() and (scores[:, 1::2] > 0.5).any()


def test_one_photograph_alone_has_no_score() -> None:
    assert (patterned_plane(3.0, seed=1).judged(StereoSettings(), others=[]) == -1).all()


def assert_alike(found: np.ndarray, true: oracle.Judged, tolerance: float) -> None:
    """Check that the scores [P] are the true ones where the rules decide clearly."""
    np.testing.assert_allclose(found[true.clear], true.scores[true.clear], rtol=0, atol=tolerance)


def exact(plane: PatternedPlane, settings: StereoSettings, shown: np.ndarray) -> oracle.Judged:
    return oracle.judge(
        [image.astype(np.float64) for image in plane.photographs.images],
        plane.photographs.cameras,
        np.argwhere(shown)[:, ::-1],
        plane.depth[shown].astype(np.float64),
        plane.normal[shown].astype(np.float64),
        plane.span,
        settings._asdict(),
    )
