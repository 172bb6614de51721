"""Pairs of photographs to compare, held to groups of photographs that share features."""

from __future__ import annotations

import importlib
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from mgsr.data.image_pairs import are_ordered, choose_pairs, exhaustive

importlib.import_module("OpenImageIO")  # before pycolmap, as in the program: the two don't bear the other order
pycolmap = pytest.importorskip("pycolmap")

GROUP = 8


def database(path: Path, names: list[str]) -> Path:
    """Write a database in which each eight photographs in turn share their features, up to noise."""
    random = np.random.default_rng(0)
    with pycolmap.Database.open(str(path)) as opened:
        camera = pycolmap.Camera.create_from_model_name(1, "PINHOLE", 100.0, 64, 64)
        opened.write_camera(camera)
        for number, name in enumerate(names):
            if number % GROUP == 0:
                shared = random.integers(0, 160, (120, 128))
            image = opened.write_image(pycolmap.Image(name=name, camera_id=1))
            noisy = np.clip(shared + random.integers(-8, 9, shared.shape), 0, 255).astype(np.uint8)
            kind = pycolmap.FeatureExtractorType.SIFT
            opened.write_keypoints(image, random.random((120, 2)).astype(np.float32) * 64)
            opened.write_descriptors(image, pycolmap.FeatureDescriptors(kind, noisy))
    return path


def test_few_photographs_are_compared_each_with_each(tmp_path: Path) -> None:
    names = [f"{number}.jpg" for number in (3, 1, 2)]
    expected = [("1.jpg", "2.jpg"), ("1.jpg", "3.jpg"), ("2.jpg", "3.jpg")]
    assert choose_pairs(pycolmap, tmp_path / "none.db", names, False, tmp_path, 0) == expected
    assert exhaustive(150, frames=False) and not exhaustive(151, frames=False) and not exhaustive(51, frames=True)


@pytest.mark.slow
def test_many_photographs_without_order_are_compared_with_similar_ones(tmp_path: Path) -> None:
    random = np.random.default_rng(1)
    names = [f"{random.integers(1 << 60):015x}.jpg" for _ in range(160)]
    assert not are_ordered(names)
    pairs = choose_pairs(pycolmap, database(tmp_path / "new.db", names), names, False, tmp_path, 0)
    groups = [names[first : first + GROUP] for first in range(0, 160, GROUP)]
    wanted = {tuple(sorted(pair)) for group in groups for pair in combinations(group, 2)}
    assert len(wanted & set(pairs)) > 0.95 * len(wanted)
    assert len(pairs) < 0.5 * 160 * 159 / 2
    assert all(one < other for one, other in pairs)


def test_frames_are_compared_with_those_that_follow(tmp_path: Path) -> None:
    names = [f"frame_{3 * number:06d}.jpg" for number in range(60)]
    pairs = set(choose_pairs(pycolmap, database(tmp_path / "new.db", names), names, True, tmp_path, 0))
    assert {(names[i], names[i + step]) for i in range(60) for step in (1, 5, 10) if i + step < 60} <= pairs
    assert len(pairs) < 60 * 59 / 2


@pytest.mark.parametrize(
    ("names", "ordered"),
    [
        ([f"IMG_{number:04d}.JPG" for number in range(100, 160)], True),
        ([f"left/DSC{number}.jpg" for number in range(1000, 1060, 2)], True),
        (["front.jpg", "back.jpg", "side.jpg", "top.jpg"], False),
        ([f"{number * 7919 % 100003}.jpg" for number in range(50)], False),
        (["a.jpg"], False),
    ],
)
def test_order_by_names(names: list[str], ordered: bool) -> None:
    assert are_ordered(names) == ordered
