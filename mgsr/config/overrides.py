"""Settings by name: ``key=value`` overrides, and the value at a dotted path."""

from __future__ import annotations

import difflib
import re
import types
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from enum import StrEnum
from functools import cache
from typing import Any, Union, get_args, get_origin, get_type_hints

from mgsr.config.run import Config
from mgsr.errors import ConfigError

EXPERT = "expert."  # what the paths of the algorithms' options begin with

# Names and groups of settings in other versions, parts of a dotted path each, and what they are called here.
RENAMED: dict[str, str] = {
    "volumes": "gaussians",
    "volume_iterations": "gaussian_iterations",
    "volume_weight": "gaussian_weight",
    "trial": "model_selection",
    "drop_carrying": "prune_contribution",
    "held_back_views": "validation_views",
    "held_back_every": "validation_every",
    "held_back_patience": "validation_patience",
    "held_back_gain": "validation_gain",
    "mirror": "environment_map",
    "weight_hold": "weight_prior",
    "shading_ratio": "max_light_residual",
    "parallax_reach": "photometric_reach",
    "disagreement": "photometric_residual",
    "wave_angle": "regression_angle",
    "smoothing_angle": "bilateral_angle",
    "outline_smoothing": "silhouette_smoothing",
    "fade_from": "decay_from",
    "final": "final_factor",
    "blurred": "flawed",
    "unmasked_count": "gaussians.densify.max_growth",
    "warmup.stop_rule": "paper.stop_rule",
    "warmup.validation_views": "paper.validation_views",
    "warmup.validation_every": "paper.validation_every",
    "warmup.validation_patience": "paper.validation_patience",
    "warmup.validation_gain": "paper.validation_gain",
    "warmup.paper_range": "paper.loss_range",
    "outlines": "learned_masks",
    "told": "min_known",
    "sure": "certain",
    "wanted": "min_frames",
    "shape.fairing": "shape.bilateral",
    "fairing": "bilateral_angle",
    "choice.mirror_share": "choice.max_start_residual",
    "surface.mirror_share": "surface.max_hull_residual",
    "mirror_share": "surface.max_hull_residual",
    "mattes.beside": "mattes.outside",
    "beside_cost": "outside_cost",
    "search.beside": "search.outer_margin",
    "background.beside": "background.mask_margin",
    "paper_range": "loss_range",
    "train.tv": "train.paper.tv",
    "train.alpha_loss": "train.paper.alpha_loss",
    "mutual.iterations_factor": "paper.iterations_factor",
    "mutual.teaching": "paper.teaching",
    "mutual.depth_unit": "paper.depth_unit",
    "surfels.depth": "paper.surface_depth",
    "surfels.distortion_weight": "paper.distortion_weight",
    "surfels.regularise_from": "paper.regularise_from",
    "gaussians.depth_tv_weight": "paper.gaussian_depth_tv_weight",
}


def override_texts(overrides: Mapping[str, object] | Sequence[str]) -> list[str]:
    """Return overrides as ``key=value`` texts. Raises ConfigError for a single text in place of several."""
    if isinstance(overrides, str):
        raise ConfigError(f"overrides: expected a mapping of settings or a list of key=value texts, got {overrides!r}")
    if not isinstance(overrides, Mapping):
        return list(overrides)
    return [f"{key}={_text(value)}" for key, value in overrides.items()]


def _text(value: object) -> str:
    """Return a setting's value as `_parse` reads it."""
    if isinstance(value, bool):
        return "on" if value else "off"
    return "none" if value is None else str(value)


def apply_overrides(config: Config, overrides: Sequence[str]) -> Config:
    """Return the configuration with ``key=value`` pairs set, later ones last. Raises ConfigError as `make_config`."""
    paths, values = field_types(config), {}
    for override in overrides:
        key, equals, text = override.partition("=")
        if not equals:
            raise ConfigError(f"--set {override}: expected key=value, for example masks=off")
        path = _find_path(key.strip(), list(paths))
        values[path] = _parse(path, text.strip(), paths[path])
    return _replaced(config, values) if values else config


def field_types(config: Any, prefix: str = "") -> dict[str, Any]:
    """Return the type of every plain field of a nested dataclass, by its dotted path."""
    kind: Any = type(config)
    hints = _type_hints(kind)
    found: dict[str, Any] = {}
    for item in fields(config):
        value, path = getattr(config, item.name), prefix + item.name
        found.update(field_types(value, path + ".") if is_dataclass(value) else {path: hints[item.name]})
    return found


@cache
def _type_hints(kind: Any) -> Mapping[str, Any]:
    """Return the types of a dataclass's fields, without their ranges."""
    return get_type_hints(kind)


def _find_path(key: str, paths: list[str]) -> str:
    """Return the one field that a key names: its full path, or parts of it in order that end in the field's name.

    Options of algorithms give way to settings that users set.
    """
    if key in paths:
        return key
    parts = key.split(".")
    hits = [path for path in paths if path.split(".")[-1] == parts[-1] and _in_order(parts, path.split("."))]
    hits = [path for path in hits if not path.startswith(EXPERT)] or hits
    if len(hits) == 1:
        return hits[0]
    if hits:
        raise ConfigError(f"option {key!r} is ambiguous: use one of {', '.join(hits)}")
    if (name := _renamed(key)) != key:
        raise ConfigError(f"option {key!r} does not exist: use {name!r}")
    # The first ones, which users set, are named before options of algorithms that are called the same.
    names = {".".join(path.split(".")[-len(parts) :]): path for path in reversed(paths)}
    near = [names[name] for name in difflib.get_close_matches(key, names, n=3, cutoff=0.5)]
    hint = f"; did you mean {', '.join(near)}?" if near else f"; the top sections are {', '.join(_sections(paths))}"
    raise ConfigError(f"option {key!r} does not exist{hint}")


def _renamed(key: str) -> str:
    """Return a key with each name of RENAMED in it replaced; the key itself where it has none."""
    for name, new in RENAMED.items():
        key = re.sub(rf"(?<![^.]){re.escape(name)}(?![^.])", new, key)
    return key


def _in_order(parts: list[str], path: list[str]) -> bool:
    rest = iter(path)
    return all(part in rest for part in parts)


def _sections(paths: list[str]) -> list[str]:
    return sorted({path.split(".")[0] for path in paths})


def _parse(path: str, text: str, kind: Any) -> Any:
    """Return the text as a value of the field's type."""
    if get_origin(kind) in (Union, types.UnionType):
        if text.lower() == "none":
            return None
        kind = next(part for part in get_args(kind) if part is not type(None))
    if kind is bool:
        return _parse_switch(path, text)
    try:
        return kind(text)
    except ValueError as error:
        raise ConfigError(f"{path}: expected {_expected(kind)}, got {text!r}") from error


def _parse_switch(path: str, text: str) -> bool:
    switches = {"on": True, "true": True, "yes": True, "1": True, "off": False, "false": False, "no": False, "0": False}
    if text.lower() not in switches:
        raise ConfigError(f"{path}: expected on or off, got {text!r}")
    return switches[text.lower()]


def _expected(kind: Any) -> str:
    if issubclass(kind, StrEnum):
        return "one of " + ", ".join(kind)
    words: str = {int: "a whole number", float: "a number"}.get(kind, kind.__name__)
    return words


def _replaced(node: Any, values: Mapping[str, Any], prefix: str = "") -> Any:
    """Return a nested dataclass with the values at dotted paths. Raises ConfigError for values that it refuses.

    All values of a dataclass are set at once, as its `__post_init__` may compare them. prefix: its own path.
    """
    groups: dict[str, dict[str, Any]] = {}
    for path, value in values.items():
        head, _, rest = path.partition(".")
        groups.setdefault(head, {})[rest] = value
    changed = {
        head: below[""] if "" in below else _replaced(getattr(node, head), below, f"{prefix}{head}.")
        for head, below in groups.items()
    }
    try:
        return replace(node, **changed)
    except ConfigError as error:
        raise ConfigError(f"{prefix}{error}") from error


def value_at(node: Any, path: str) -> Any:
    """Return the value of a nested dataclass at a dotted path."""
    for part in path.split("."):
        node = getattr(node, part)
    return node
