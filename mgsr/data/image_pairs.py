"""Choose the pairs of photographs whose features COLMAP compares."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import combinations, pairwise
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from mgsr.config.expert import ImagePairOptions

Pair = tuple[str, str]


def exhaustive(count: int, frames: bool, options: ImagePairOptions = ImagePairOptions()) -> bool:
    """Return whether all pairs of so many photographs, or frames of videos, are compared.

    Frames of a video need fewer pairs, because they overlap with their neighbours.
    """
    return count <= (options.exhaustive_frames if frames else options.exhaustive)


def pair_count(count: int, frames: bool, options: ImagePairOptions = ImagePairOptions()) -> int:
    """Return about how many pairs are compared."""
    if exhaustive(count, frames, options):
        return count * (count - 1) // 2
    return count * (3 * options.following // 2 + (options.similar_frames if frames else options.similar))


def choose_pairs(
    colmap: Any,
    database: Path,
    names: Sequence[str],
    frames: bool,
    work: Path,
    seed: int,
    options: ImagePairOptions = ImagePairOptions(),
) -> list[Pair]:
    """Return the pairs of names to compare, sorted.

    database: COLMAP's, with the features of all photographs. frames: whether they are a video's. work: a folder for a
    temporary file.
    """
    if exhaustive(len(names), frames, options):
        return list(combinations(sorted(names), 2))
    pairing: Any
    generators = []
    with colmap.Database.open(str(database)) as opened:
        images = {image.image_id: image.name for image in opened.read_all_images()}
        vocabulary = _vocabulary(colmap, opened, list(images), work, seed, options)
        if vocabulary is not None:
            similar = options.similar_frames if frames else options.similar
            pairing = colmap.VocabTreePairingOptions(vocab_tree_path=vocabulary, num_images=similar + 1)
            generators.append(colmap.VocabTreePairGenerator(pairing, opened))
        if frames or vocabulary is None or are_ordered(names, options):
            for by_powers_of_two in (False, True):
                pairing = colmap.SequentialPairingOptions(overlap=options.following, quadratic_overlap=by_powers_of_two)
                generators.append(colmap.SequentialPairGenerator(pairing, opened))
        pairs = {
            tuple(sorted((images[one], images[other])))
            for generator in generators
            for one, other in generator.all_pairs()
            if one != other
        }
    return sorted((one, other) for one, other in pairs)


def are_ordered(names: Sequence[str], options: ImagePairOptions = ImagePairOptions()) -> bool:
    """Return whether the names are numbered in the order of taking, as cameras and video tools number them."""
    places = [(PurePosixPath(name).parent, *_number(PurePosixPath(name).stem)) for name in sorted(names)]
    follows = [one[:2] == other[:2] and 0 < other[2] - one[2] <= options.following for one, other in pairwise(places)]
    return bool(follows) and sum(follows) >= options.ordered * len(follows)


def _number(stem: str) -> tuple[str, int]:
    """Return a name's text before its last number, and that number; -1 without one."""
    match = re.fullmatch(r"(.*?)(\d{1,18})\D*", stem)
    return (match[1], int(match[2])) if match else (stem, -1)


def _vocabulary(
    colmap: Any, opened: Any, images: Sequence[int], work: Path, seed: int, options: ImagePairOptions
) -> Path | None:
    """Learn a vocabulary of the capture's features and return its file; None where there are too few features.

    No vocabulary has to be downloaded, and one of the capture's own features tells its photographs apart better.
    """
    random = np.random.default_rng(seed)
    each = max(1, options.sample // len(images))
    found = []
    for image in images:
        descriptors = opened.read_descriptors(image)
        kind, rows = descriptors.type, np.asarray(descriptors.data)
        found.append(rows[np.sort(random.permutation(len(rows))[:each])])
    learned = np.concatenate(found).astype(np.float32)
    words = min(options.words, len(learned) // 40)
    if words < 2 * learned.shape[1]:
        return None
    index = colmap.VisualIndex.create(learned.shape[1], learned.shape[1] // 2)
    build = colmap.VisualIndex.BuildOptions()
    build.num_visual_words = words
    index.build(build, colmap.FeatureDescriptorsFloat(kind, learned))
    path = work / "vocabulary.bin"
    index.write(str(path))
    return path
