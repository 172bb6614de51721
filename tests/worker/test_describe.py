"""The service's description of the library matches what the library says of itself."""

from __future__ import annotations

import json

import pytest

from mgsr.config import Config, field_types, make_config
from mgsr.errors import ConfigError
from service.contract.options import SETTINGS, JobOptions, find_setting, parse_setting
from worker.describe import LIBRARY, as_text, describe_library


def test_the_file_is_current() -> None:
    assert LIBRARY.read_text(encoding="utf-8") == as_text(describe_library()), "run: python -m worker.describe"


def test_every_default_passes_through_the_service_unchanged() -> None:
    settings = {path: schema["default"] for path, schema in SETTINGS.items()}
    for first in range(0, len(settings), 200):  # as many as a job may have
        some = dict(list(settings.items())[first : first + 200])
        options = JobOptions.model_validate_json(json.dumps({"settings": some}))
        assert make_config(overrides=options.overrides()) == Config()


def test_every_setting_of_the_library_can_be_set() -> None:
    assert set(SETTINGS) == set(field_types(Config())) - {"preset", "method", "seed"}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("masks=off", ("data.masks", "off")),
        ("max_side=800", ("data.max_side", 800)),
        ("mesh.max_faces=none", ("mesh.max_faces", None)),
        ("close_holes=on", ("mesh.close_holes", True)),
        ("mesh.trim=2.5", ("mesh.trim", 2.5)),
        ("train.gaussians.densify.every=50", ("train.gaussians.densify.every", 50)),
        ("fusion.bins=16", ("expert.stereo.fusion.bins", 16)),
        ("radius=0.7", ("mesh.radius", 0.7)),  # not that of stereo's patches
        ("object_box=-1,-1,0,1,1,2", ("data.object_box", "-1,-1,0,1,1,2")),
        ("object_box=-.5, -1e-1,0.,+1,1,2E3", ("data.object_box", "-.5, -1e-1,0.,+1,1,2E3")),
    ],
)
def test_settings_from_the_command_line(text: str, expected: tuple[str, object]) -> None:
    assert parse_setting(text) == expected
    path, value = expected
    shown = {"None": "none", "True": "on"}.get(str(value), str(value))
    assert make_config(overrides=[f"{path}={shown}"]) == make_config(overrides=[text])


@pytest.mark.parametrize("text", ["max_side", "max_side=many", "trim=nan", "trim=inf", "masks=maybe", "every=3", "x=1"])
def test_settings_that_can_not_be(text: str) -> None:
    with pytest.raises(ValueError):
        parse_setting(text)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("stereo.fusion.reach=0", "number of more than 0, got 0"),
        ("match.settings.best=9", "integer of at least 1 and at most 8, got 9"),
        ("mesh.trim=-1", "number of at least 0, got -1"),
        ("object_box=1,2,3", 'data.object_box: expected a string such as "-1,-1,0,1,1,2" or null, got "1,2,3"'),
        ("object_box=0,0,0,1,1,nan", "expected a string such as"),
        ("object_box=0,0,0,1,1,1,1", "expected a string such as"),
    ],
)
def test_values_out_of_range_or_of_another_form(text: str, expected: str) -> None:
    with pytest.raises(ValueError, match=expected):
        parse_setting(text)
    with pytest.raises(ConfigError):
        make_config(overrides=[text])


def test_a_name_is_found_by_its_end() -> None:
    assert find_setting("surfels.densify.every") == "train.surfels.densify.every"
    with pytest.raises(ValueError, match=r"ambiguous: use one of .*train\.surfels\.densify\.every"):
        find_setting("densify.every")
