"""The options of the algorithms: their ranges, and how they are set, recorded and listed."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import pytest

from mgsr.bench.cells import Cell, read_variants
from mgsr.config import EXPERT, Config, ExpertConfig, field_types, make_config
from mgsr.config.expert import ConsistencyOptions
from mgsr.config.options import Options, Range, ranges
from mgsr.config.overrides import value_at
from mgsr.data.scene import Scene, Similarity
from mgsr.errors import ConfigError
from mgsr.training.checkpoint import fingerprint
from worker.comments import field_comments


def groups(node: Any, path: str) -> Iterator[tuple[str, Any]]:
    """Yield every dataclass of options below a node, with its path."""
    yield path, node
    for field in fields(node):
        if is_dataclass(value := getattr(node, field.name)):
            yield from groups(value, f"{path}.{field.name}")


GROUPS = dict(groups(ExpertConfig(), "expert"))


@pytest.mark.parametrize("path", GROUPS)
def test_each_option_has_a_meaning_and_a_range_that_holds_its_default(path: str) -> None:
    node = GROUPS[path]
    assert isinstance(node, Options)
    numbers = {field.name for field in fields(node) if not is_dataclass(getattr(node, field.name))}
    assert set(ranges(type(node))) == numbers
    assert not [name for name in numbers if not field_comments(type(node)).get(name)]
    for name, valid in ranges(type(node)).items():
        below = valid.least - 1
        with pytest.raises(ConfigError, match=rf"^{name}: expected {valid}, got {below:g}$"):
            replace(node, **{name: below})


@pytest.mark.parametrize(
    ("valid", "inside", "outside", "text"),
    [
        (Range(1), (1, 1e9), (0, -1, float("inf"), float("nan")), "1 or more"),
        (Range(0, open=True), (1e-9,), (0, float("nan")), "above 0"),
        (Range(0, 1), (0, 0.5, 1), (-0.1, 1.1), "0 to 1"),
        (Range(0, 1, open=True), (0.1, 1), (0, 1.1), "above 0, up to 1"),
    ],
)
def test_ranges(valid: Range, inside: tuple[float, ...], outside: tuple[float, ...], text: str) -> None:
    assert all(map(valid.holds, inside)) and not any(map(valid.holds, outside)) and str(valid) == text


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("fusion.reach=0", r"^expert\.stereo\.fusion\.reach: expected above 0, got 0$"),
        ("match.settings.radius=5", r"^expert\.stereo\.match\.settings\.radius: expected 0 to 4, got 5$"),
        ("fusion.bins=1.5", "a whole number"),
        ("worthless=0.9", r"^expert\.stereo\.consistency\.worthless: expected worthless < perfect, got 0\.9, 0\.8$"),
        ("expert.stereo.fusion.binz=3", r"did you mean expert\.stereo\.fusion\.bins"),
        ("fusion.rounds=none", "a whole number"),
        ("radiu=1", r"did you mean .*mesh\.radius"),
    ],
)
def test_what_is_out_of_range_is_refused_with_its_path(override: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        make_config(overrides=[override])


def test_values_that_belong_together_are_set_together() -> None:
    expected = ConsistencyOptions(worthless=0.85, perfect=0.9)
    for given in (["worthless=0.85", "perfect=0.9"], ["perfect=0.9", "worthless=0.85"]):
        assert make_config(overrides=given).expert.stereo.consistency == expected


def test_bare_names_mean_what_users_set() -> None:
    """Check that a bare name is the user's setting where an option of an algorithm is called the same."""
    names = {path: path.rpartition(".")[2] for path in field_types(Config())}
    options = {name for path, name in names.items() if path.startswith(EXPERT)}
    users = {path: name for path, name in names.items() if not path.startswith(EXPERT)}
    shared = {name: path for path, name in users.items() if name in options and [*users.values()].count(name) == 1}
    assert "radius" in shared
    for name, path in shared.items():
        assert make_config(overrides={name: value_at(Config(), path)}) == Config(), name
    assert make_config(overrides=["radius=0.7"]).mesh.radius == 0.7


def test_a_benchmark_sweeps_and_records_them() -> None:
    plain, finer = read_variants(["plain", "fusion.bins=16"])
    recorded = [Cell(Path("spot"), variant=each).settings() for each in (plain, finer)]
    assert [each["expert"]["stereo"]["fusion"]["bins"] for each in recorded] == [12, 16]
    assert recorded[0]["expert"] == json.loads(json.dumps(asdict(ExpertConfig())))


def test_a_checkpoint_belongs_to_its_options() -> None:
    scene = Scene("none", Path(), "", [], [], None, Similarity())
    overrides: tuple[list[str], ...] = ([], ["expert.mesh.colors.rounds=3"], ["fusion.bins=16"])
    plain, colored, finer = (fingerprint(scene, make_config(overrides=each)) for each in overrides)
    assert plain == colored != finer, "of the mesh, training knows nothing"
