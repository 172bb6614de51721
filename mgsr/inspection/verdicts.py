"""Verdicts on pairs of photographs: whether their matches agree with their cameras.

Epipolar lines do not reveal that a camera has moved along them. Three photographs of the same points do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from mgsr.config.expert import InspectionConfig, PairOptions
from mgsr.data.camera import Camera
from mgsr.inspection.features import Features
from mgsr.inspection.pairs import Pair
from mgsr.inspection.triangulation import spread


class Verdict(StrEnum):
    """The verdict of a pair's matches on its cameras."""

    AGREES = "agrees"
    CONTRADICTS = "contradicts"
    UNKNOWN = "unknown"


@dataclass(frozen=True)
class Judged:
    """Pairs with their verdicts. lines: the verdicts by the epipolar lines alone."""

    pairs: tuple[Pair, ...]
    verdicts: tuple[Verdict, ...]
    lines: tuple[Verdict, ...]

    def of(self, verdict: Verdict) -> list[Pair]:
        """Return the pairs with this verdict."""
        return [pair for pair, given in zip(self.pairs, self.verdicts, strict=True) if given is verdict]

    @property
    def off_lines(self) -> list[Pair]:
        """Return the pairs whose matches are far from the epipolar lines."""
        return [pair for pair, given in zip(self.pairs, self.lines, strict=True) if given is Verdict.CONTRADICTS]


def usual_residual(pairs: Sequence[Pair], min_matches: int = PairOptions().min_matches) -> float:
    """Return the median residual of the pairs with enough matches, pixels of the images of the features; 0 without."""
    residuals = [pair.residual for pair in pairs if pair.own.sum() >= min_matches]
    return float(np.median(residuals)) if residuals else 0.0


def pairs_by_photo(pairs: Sequence[Pair], count: int, min_matches: int) -> list[list[Pair]]:
    """Return, for each of `count` photographs, its pairs in which at least `min_matches` matches share a geometry."""
    mine: list[list[Pair]] = [[] for _ in range(count)]
    for pair in pairs:
        if pair.own.sum() >= min_matches:
            mine[pair.one].append(pair)
            mine[pair.other].append(pair)
    return mine


def judge(
    cameras: Sequence[Camera],
    features: Sequence[Features],
    pairs: Sequence[Pair],
    options: InspectionConfig = InspectionConfig(),
) -> Judged:
    """Return the pairs with their verdicts: by the epipolar lines, and by the points that three photographs share.

    A pair agrees if it belongs to three photographs whose rays meet. A pair contradicts if the rays miss each other in
    all triples that contain it, and if no other pairs prove it. A triple whose third photograph contradicts both others
    by the epipolar lines says nothing about their pair, if that pair is as near to its lines as most. A photograph
    that no triple proves, and several pairs contradict, agrees with others by the lines alone only in such exact pairs.
    """
    limits = options.verdicts
    usual = min(usual_residual(pairs, options.pairs.min_matches), limits.max_usual)
    lines = [_by_lines(pair, usual, options) for pair in pairs]
    close = max(limits.meets, limits.meets_usual * usual)
    triples = _triples(cameras, features, pairs, limits.min_shared)
    meets = {triple: rays < close for triple, rays in triples if rays is not None}
    met = {edge for triple, good in meets.items() if good for edge in _edges(triple)}
    off = {(pair.one, pair.other) for pair, line in zip(pairs, lines, strict=True) if line is Verdict.CONTRADICTS}
    exact = {(pair.one, pair.other) for pair in pairs if pair.residual <= usual}
    missed = {edge for triple, good in meets.items() if not good for edge in _suspects(triple, off, exact)} - met
    against = missed | off
    unproven = {photo for edge in against for photo in edge} - {photo for edge in met for photo in edge}
    doubted = {photo for photo in unproven if sum(photo in edge for edge in against) > limits.tolerated}
    verdicts = []
    for pair, line in zip(pairs, lines, strict=True):
        edge = (pair.one, pair.other)
        if edge in against:
            verdicts.append(Verdict.CONTRADICTS)
        elif edge in met:
            verdicts.append(Verdict.AGREES)
        else:
            weak = line is Verdict.AGREES and edge not in exact and not doubted.isdisjoint(edge)
            verdicts.append(Verdict.UNKNOWN if weak else line)
    return Judged(tuple(pairs), tuple(verdicts), tuple(lines))


def _by_lines(pair: Pair, usual: float, options: InspectionConfig) -> Verdict:
    limits = options.verdicts
    if pair.own.sum() < options.pairs.min_matches:
        return Verdict.UNKNOWN
    if pair.residual < max(limits.agrees, limits.agrees_usual * usual):
        return Verdict.AGREES
    far = max(limits.contradicts, limits.contradicts_usual * usual)
    return Verdict.CONTRADICTS if pair.residual > far else Verdict.UNKNOWN


Triple = tuple[int, int, int]
Edge = tuple[int, int]


def _edges(triple: Triple) -> tuple[Edge, ...]:
    i, j, k = triple
    return (i, j), (i, k), (j, k)


def _suspects(triple: Triple, off: set[Edge], exact: set[Edge]) -> list[Edge]:
    """Return the pairs of a triple that may be the reason why its rays miss each other.

    off, exact: the pairs whose matches are far from the epipolar lines, and no farther than usual. If two pairs of the
    triple are off, the photograph that they share is the reason, and an exact third pair is no suspect.
    """
    edges = _edges(triple)
    explained = sum(edge in off for edge in edges) == 2
    return [edge for edge in edges if not (explained and edge in exact)]


def _triples(
    cameras: Sequence[Camera], features: Sequence[Features], pairs: Sequence[Pair], least: int
) -> list[tuple[Triple, float | None]]:
    """Return all triples of photographs that were compared with each other, with the distance of their rays, in pixels.

    The distance is None if a triple shares fewer than `least` points.
    """
    tables = {(pair.one, pair.other): _table(pair, len(features[pair.one])) for pair in pairs if pair.own.any()}
    after: dict[int, set[int]] = {}
    for one, other in tables:
        after.setdefault(one, set()).add(other)
    found: list[tuple[Triple, float | None]] = []
    for i, j in tables:
        for k in after.get(i, set()) & after.get(j, set()):
            found.append(((i, j, k), _rays_miss(cameras, features, tables, (i, j, k), least)))
    return found


def _table(pair: Pair, count: int) -> np.ndarray:
    """Return the match of each of the first photograph's features in the other, [N]; -1 without one."""
    table = np.full(count, -1)
    kept = pair.matches[pair.own]
    table[kept[:, 0]] = kept[:, 1]
    return table


def _rays_miss(
    cameras: Sequence[Camera],
    features: Sequence[Features],
    tables: dict[tuple[int, int], np.ndarray],
    triple: Triple,
    least: int,
) -> float | None:
    """Return the distance, in pixels, by which the rays of three photographs miss each other.

    Returns None if the photographs share fewer than `least` points. tables [N]: for each pair, the match of each
    feature of the first photograph, -1 without a match.
    """
    i, j, k = triple
    first = np.flatnonzero((tables[i, j] >= 0) & (tables[i, k] >= 0))
    second, third = tables[i, j][first], tables[i, k][first]
    same = tables[j, k][second] == third
    if same.sum() < least:
        return None
    indices = (first[same], second[same], third[same])
    pixels = [features[photo].pixels[index] for photo, index in zip(triple, indices, strict=True)]
    scale = max(features[photo].scale for photo in triple)
    return spread([cameras[photo] for photo in triple], pixels) / scale
