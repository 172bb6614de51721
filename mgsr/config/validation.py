"""Checks of settings that parse but can not work together."""

from __future__ import annotations

import math

from mgsr.config.capture import object_box
from mgsr.config.overrides import field_types, value_at
from mgsr.config.run import Config
from mgsr.config.surface import MAX_LODS, MIN_TEXTURE, OutputConfig
from mgsr.config.train import Branches, Reflection
from mgsr.errors import ConfigError


def validate(config: Config) -> None:
    """Raise ConfigError for values that parse but can't work together."""
    train = config.train
    for path in field_types(config):
        value = value_at(config, path)
        if isinstance(value, (int, float)) and not 0 <= value < math.inf:
            raise ConfigError(f"{path}: expected a finite number of at least 0, got {value}")
    _validate_output(config.output)
    object_box(config.data.object_box)
    for path, degree in (
        ("train.surfels.sh_degree", train.surfels.sh_degree),
        ("train.gaussians.sh_degree", train.gaussians.sh_degree),
        ("train.gaussians.reflected_sh_degree", train.gaussians.reflected_sh_degree),
    ):
        if degree > 3:
            raise ConfigError(f"{path}: expected 0 to 3, got {degree}")
    between = ("surfels.start_opacity", "gaussians.start_opacity", "gaussians.start_weight", "environment_map.start")
    for path in (*between, "gaussians.densify.new_opacity"):
        value = value_at(config.train, path)
        if not 0 < value < 1:
            raise ConfigError(f"train.{path}: expected a value between 0 and 1, got {value}")
    if train.branches is not Branches.BOTH and train.gaussians.reflection in (Reflection.SHARED, Reflection.BOTH):
        kind = train.gaussians.reflection
        raise ConfigError(f"train.gaussians.reflection={kind} needs both branches, got train.branches={train.branches}")
    if train.warmup.coarse > train.model_selection.start:
        raise ConfigError(
            f"train.warmup.coarse: expected at most train.model_selection.start ({train.model_selection.start}), "
            f"because model selection uses photographs of full size; got {train.warmup.coarse}"
        )
    if train.model_selection.start > train.warmup.stop_after:
        raise ConfigError(
            f"train.model_selection.start: expected at most train.warmup.stop_after ({train.warmup.stop_after}), "
            f"before which no warm-up ends; got {train.model_selection.start}"
        )
    for path in field_types(config):
        if ".rates." in path and value_at(config, path) == 0:
            raise ConfigError(f"{path}: expected more than 0, got 0; use 1e-12 to keep a parameter constant")
        if path == "time_budget" and value_at(config, path) == 0:
            raise ConfigError(f"{path}: expected more than 0 seconds, got 0")
        if path.endswith("prune_contribution") and value_at(config, path) >= 1:
            raise ConfigError(f"{path}: expected a share below 1, got {value_at(config, path):g}")
        if path.endswith(("every", "epoch_span")) and value_at(config, path) == 0:
            raise ConfigError(f"{path}: expected at least 1, got 0")


def _validate_output(output: OutputConfig) -> None:
    if not (math.isfinite(output.scale) and output.scale > 0):
        raise ConfigError(f"output.scale: expected a number above 0, got {output.scale:g}")
    if output.texture is not None and not MIN_TEXTURE <= output.texture <= 16384:
        raise ConfigError(f"output.texture: expected {MIN_TEXTURE} to 16384 texels, got {output.texture}")
    if not 0 <= output.lods <= MAX_LODS:
        raise ConfigError(f"output.lods: expected 0 to {MAX_LODS} coarser levels of detail, got {output.lods}")
    if output.faces is not None and output.faces < 100:
        raise ConfigError(f"output.faces: expected at least 100, got {output.faces}")
