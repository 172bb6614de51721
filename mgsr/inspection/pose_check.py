"""The check for poses that contradict the photographs: single ones, clusters that see a copy of a structure, or all."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from mgsr.config.expert import InspectionConfig, PoseCheckOptions
from mgsr.inspection.findings import Code, Finding, Severity, pick
from mgsr.inspection.pairs import Pair
from mgsr.inspection.verdicts import Judged, Verdict, pairs_by_photo, usual_residual

_LEAVE_OUT = "`--set flawed=drop` leaves them out"
_ANEW = "find the cameras again (`mgsr poses`)"


@dataclass(frozen=True)
class PoseGroups:
    """Photographs in groups; pairs that agree join their photographs.

    group [V]: the number of each photograph's group; the largest group has 0.
    contradictions [V]: the number of the photograph's pairs that contradict a photograph of another group.
    decided [V] bool: whether any of the photograph's pairs agrees or contradicts.
    options: the limits.
    """

    group: np.ndarray
    contradictions: np.ndarray
    decided: np.ndarray
    options: PoseCheckOptions = PoseCheckOptions()

    @property
    def contradictory(self) -> np.ndarray:
        """Return which photographs [V] bool have poses that contradict the largest group.

        The result is all False unless the largest group holds most of the decided photographs.
        """
        if (self.group == 0).sum() < self.options.majority * self.decided.sum():
            return np.zeros(len(self.group), bool)
        against = np.bincount(self.group, weights=self.contradictions)
        least = np.maximum(self.options.min_contradictions, np.bincount(self.group))
        accused = np.bincount(self.group, weights=self.contradictions > 0) / np.bincount(self.group)
        wrong = (against >= least) & (accused >= self.options.accused)
        return np.asarray((self.group > 0) & wrong[self.group])


def group_by_pose(count: int, judged: Judged, options: PoseCheckOptions = PoseCheckOptions()) -> PoseGroups:
    """Group `count` photographs by the pairs that agree."""
    agreeing, against = (
        np.array([(pair.one, pair.other) for pair in judged.of(verdict)], np.int64).reshape(-1, 2)
        for verdict in (Verdict.AGREES, Verdict.CONTRADICTS)
    )
    graph = coo_matrix((np.ones(len(agreeing), bool), (agreeing[:, 0], agreeing[:, 1])), shape=(count, count))
    label = connected_components(graph, directed=False)[1]
    order = [name for name, _ in Counter(label.tolist()).most_common()]
    group = np.argsort(order)[label]
    # Of a contradictory pair, only the photograph outside the largest group is taken to be wrong.
    between = against[(group[against] == 0).sum(axis=1) == 1]
    accused = between[group[between] > 0]
    decided = np.zeros(count, bool)
    decided[agreeing.ravel()] = decided[against.ravel()] = True
    return PoseGroups(group, np.bincount(accused, minlength=count), decided, options)


def check_poses(
    names: Sequence[str], features: Sequence[int], judged: Judged, options: InspectionConfig = InspectionConfig()
) -> list[Finding]:
    """Return the findings on contradictory poses; names, features: the photographs' names and numbers of features."""
    groups = group_by_pose(len(names), judged, options.poses)
    agree, against = len(judged.of(Verdict.AGREES)), judged.of(Verdict.CONTRADICTS)
    if len(against) > max(agree, len(names) // 4):
        return [_all_wrong(len(against), agree, against)]
    found = [
        *_clusters(names, groups, against),
        *_single(names, groups),
        *_less_exact(names, judged.pairs, groups, options),
        *_inaccurate(judged.pairs, len(names), options),
    ]
    if not found:
        found += _separate(names, groups, features, options.pairs.min_matches)
    inside = sum(groups.group[pair.one] == groups.group[pair.other] for pair in judged.off_lines)
    if inside >= max(5, options.poses.repeated * agree):
        found.append(
            Finding(
                Code.SIMILAR_PLACES,
                Severity.WARNING,
                f"{inside} pairs of photographs look alike, but their cameras see different places",
                inside,
                "pairs",
                "if the object has no repeated parts, the poses have drifted, or their ring does not close: " + _ANEW,
            )
        )
    return found


def _all_wrong(against: int, agree: int, pairs: Sequence[Pair]) -> Finding:
    return Finding(
        Code.WRONG_POSES,
        Severity.ERROR,
        f"the cameras do not belong to the photographs: {against} pairs of photographs contradict them, {agree} agree",
        round(float(np.median([pair.residual for pair in pairs])), 1),
        "px",
        "check the order of the photographs, the axes of the poses and the focal length, or " + _ANEW,
    )


def _clusters(names: Sequence[str], groups: PoseGroups, against: Sequence[Pair]) -> list[Finding]:
    """Return a finding for each cluster of photographs that sees a copy of the structure elsewhere."""
    found = []
    sizes = np.bincount(groups.group)
    for number in np.unique(groups.group[groups.contradictory]):
        if sizes[number] < groups.options.cluster:
            continue
        mine = np.flatnonzero(groups.group == number)
        between = [pair for pair in against if (groups.group[[pair.one, pair.other]] == number).sum() == 1]
        off = float(np.median([pair.residual for pair in between]))
        found.append(
            Finding(
                Code.DOUBLED_STRUCTURE,
                Severity.ERROR,
                f"{len(mine)} photographs show a second copy of the structure: they agree among themselves, but their "
                f"matches with the others are off by {off:.0f} px in {len(between)} pairs",
                round(off, 1),
                "px",
                f"{_ANEW}, with more photographs between the two groups, or {_LEAVE_OUT}",
                pick(names, mine),
            )
        )
    return found


def _single(names: Sequence[str], groups: PoseGroups) -> list[Finding]:
    """Return a finding for the photographs, alone or in twos, whose poses contradict the others."""
    sizes = np.bincount(groups.group)
    mine = np.flatnonzero(groups.contradictory & (sizes[groups.group] < groups.options.cluster))
    if not len(mine):
        return []
    severity = Severity.ERROR if len(mine) > groups.options.many * len(names) else Severity.WARNING
    return [
        Finding(
            Code.CONTRADICTORY_POSE,
            severity,
            f"the poses of {len(mine)} of {len(names)} photographs contradict what they show",
            len(mine),
            "photographs",
            f"{_LEAVE_OUT}, or {_ANEW}",
            pick(names, mine),
        )
    ]


def _less_exact(
    names: Sequence[str], pairs: Sequence[Pair], groups: PoseGroups, options: InspectionConfig
) -> list[Finding]:
    """Return a finding for the photographs whose poses are a little wrong, by a degree or two.

    Such a pose fits none of its pairs well. The better quarter of its pairs decides. If parts of the object look alike,
    the other pairs of a correct pose may be wrong too.
    """
    limits, least = options.poses, options.pairs.min_matches
    far = max(limits.less_exact, limits.less_exact_usual * usual_residual(pairs, least))
    residuals = [[pair.residual for pair in mine] for mine in pairs_by_photo(pairs, len(names), least)]
    best = np.array([np.quantile(each, 0.25) if len(each) >= limits.less_exact_pairs else 0.0 for each in residuals])
    found = np.flatnonzero((best > far) & ~groups.contradictory)
    if not len(found):
        return []
    return [
        Finding(
            Code.INACCURATE_POSE,
            Severity.WARNING,
            f"the poses of {len(found)} of {len(names)} photographs are less exact than the others: even their better "
            f"matches are off by up to {best[found].max():.1f} px",
            round(float(best[found].max()), 2),
            "px",
            f"{_LEAVE_OUT}, or {_ANEW}",
            pick(names, found),
        )
    ]


def _inaccurate(pairs: Sequence[Pair], count: int, options: InspectionConfig) -> list[Finding]:
    """Return a finding if the cameras of `count` photographs are not wrong, but less exact than usual."""
    least = options.pairs.min_matches
    matched = sum(pair.own.sum() >= least for pair in pairs)
    middle = usual_residual(pairs, least)
    if matched < max(5, count / 2) or middle < options.poses.inaccurate:
        return []
    return [
        Finding(
            Code.INACCURATE_POSES,
            Severity.WARNING,
            f"the matches of {matched} pairs have a median error of {middle:.1f} px under the cameras",
            round(middle, 2),
            "px",
            f"{_ANEW}; a fit to 0.5 px or better is usual",
        )
    ]


def _separate(names: Sequence[str], groups: PoseGroups, features: Sequence[int], min_matches: int) -> list[Finding]:
    """Return a finding if many photographs with enough features are outside the largest group."""
    rich = np.array(features) >= 4 * min_matches
    others = rich & groups.decided & (groups.group > 0)
    total = int((rich & groups.decided).sum())
    limits = groups.options
    if total < max(2 * limits.cluster, len(names) / 2) or others.sum() <= (1 - limits.connected) * total:
        return []
    return [
        Finding(
            Code.SEPARATE_GROUPS,
            Severity.NOTE,
            f"{others.sum()} of {total} photographs share no features with the largest group, so their poses cannot be "
            "compared",
            int(others.sum()),
            "photographs",
            "add photographs between the groups if the surface is doubled or torn",
            pick(names, np.flatnonzero(others)),
        )
    ]


def check_movement(pairs: Sequence[Pair], options: InspectionConfig = InspectionConfig()) -> list[Finding]:
    """Return a finding if parts of the photographs do not move as the cameras do."""
    least = options.pairs.min_matches
    matched = [pair for pair in pairs if len(pair.matches) >= least]
    if len(matched) < 5:
        return []
    still = np.array([pair.still.sum() for pair in matched])
    moved = np.array([pair.moved for pair in matched])
    counts = np.array([len(pair.matches) for pair in matched])
    share = float(((still + moved) / counts)[(still + moved) >= least // 2].sum() / len(matched))
    if share < options.poses.moving:
        return []
    cause = "stand still in the image (a turntable?)" if still.sum() > moved.sum() else "move by themselves"
    return [
        Finding(
            Code.MOVING_BACKGROUND,
            Severity.WARNING,
            f"{share:.0%} of the matches contradict the cameras' motion: they {cause}",
            round(share, 3),
            "share",
            "add masks of the object, or of the moving things (docs/inputs.md, Masks)",
        )
    ]
