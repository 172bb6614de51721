"""The settings of a scene that was read before."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from mgsr.config import DataConfig, Exposure, Masks, make_config
from mgsr.config.expert import DataOptions, SharpnessOptions
from mgsr.data.scene import Scene, Similarity
from mgsr.errors import ConfigError
from mgsr.pipeline.preprocess import as_read

READ = DataConfig(masks=Masks.OFF, max_side=800)
SCENE = Scene("cup", Path("cup"), "plain", [], [], None, Similarity(), read_with=READ)


@pytest.mark.parametrize("overrides", [{}, {"masks": "off"}, {"max_side": 800}])
def test_they_are_the_scenes(overrides: dict[str, object]) -> None:
    assert as_read(SCENE, make_config(overrides=overrides)).data == READ


def test_exposures_are_dealt_with_later() -> None:
    kept = make_config(overrides={"exposure": "keep"})
    assert as_read(SCENE, kept).data == replace(READ, exposure=Exposure.KEEP)
    reported = replace(SCENE, read_with=replace(READ, exposure=Exposure.KEEP))
    assert as_read(reported, make_config()).data.exposure is Exposure.KEEP


def test_others_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"data\.max_side: cup is loaded with 800, got 400"):
        as_read(SCENE, make_config(overrides={"max_side": 400}))


def test_options_of_the_reading_are_the_scenes() -> None:
    scene = replace(SCENE, options=DataOptions(sharpness=SharpnessOptions(max_loss=0.7)))
    for overrides in ({}, {"expert.data.sharpness.max_loss": 0.7}):
        assert as_read(scene, make_config(overrides=overrides)).expert.data == scene.options
    with pytest.raises(ConfigError, match=r"expert\.data: cup is loaded with other options"):
        as_read(SCENE, make_config(overrides={"expert.data.sharpness.max_loss": 0.7}))
