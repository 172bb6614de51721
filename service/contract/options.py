"""The options of a job, checked without loading the library.

`library.json` describes the library's settings. `python -m worker.describe` writes it, and a test compares it with the
library. Errors that only the library can find reach the user from the worker, as `bad_option`.
"""

from __future__ import annotations

import difflib
import json
import math
import re
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any
from urllib.parse import urlsplit

from pydantic import BaseModel, ConfigDict, Field, field_validator

LIBRARY: dict[str, Any] = json.loads(Path(__file__).with_name("library.json").read_text(encoding="utf-8"))
PRESETS: dict[str, dict[str, str]] = LIBRARY["presets"]
METHODS: dict[str, dict[str, str]] = LIBRARY["methods"]
RENAMED: dict[str, str] = LIBRARY["renamed"]
SETTINGS: dict[str, dict[str, Any]] = LIBRARY["settings"]
EXPERT = "expert."  # the prefix of the algorithms' options

Preset = StrEnum("Preset", {name.upper(): name for name in PRESETS})  # type: ignore[misc]
Method = StrEnum("Method", {"M_" + name.upper(): name for name in METHODS})  # type: ignore[misc]
SettingValue = bool | int | float | str | None

_KINDS: dict[str, tuple[type, ...]] = {"boolean": (bool,), "integer": (int,), "number": (int, float), "string": (str,)}
_SWITCHES = {"on": True, "true": True, "off": False, "false": False}


class Device(StrEnum):
    """auto: any worker, on the GPU if it has one. cuda: only a worker with a GPU."""

    AUTO = "auto"
    CPU = "cpu"
    CUDA = "cuda"


class JobOptions(BaseModel):
    """The options of a job."""

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        json_schema_extra={
            "examples": [
                {"preset": "draft"},
                {"preset": "standard", "name": "vase", "settings": {"data.max_side": 800, "mesh.max_faces": 100000}},
            ]
        },
    )

    name: Annotated[str | None, Field(max_length=200, pattern=r"^[^\x00-\x1f\x7f]*$")] = None
    preset: Preset = Preset("standard")
    method: Method = Method("mgsr")
    seed: Annotated[int, Field(ge=0, le=2**31 - 1)] = 0
    device: Device = Device.AUTO
    deadline_seconds: Annotated[
        float | None, Field(gt=0, le=1e7, description="The seconds after which an attempt fails.")
    ] = None
    webhook: Annotated[
        str | None,
        Field(
            max_length=2000,
            pattern=r"^https?://[A-Za-z0-9.\-\[\]:]+([/?][!-~]*)?$",
            description="The address that receives a POST when the job ends. `GET /webhook-secret` has the secret of "
            "its Standard Webhooks signature.",
        ),
    ] = None
    dry_run: Annotated[
        bool,
        Field(
            description="Only check the photographs, and estimate the seconds and the memory of each preset. There are "
            "no results."
        ),
    ] = False
    settings: Annotated[
        dict[str, SettingValue],
        Field(max_length=200, description="Single settings, by their names in `GET /options`. null means none."),
    ] = {}

    @field_validator("settings")
    @classmethod
    def _known_settings(cls, settings: dict[str, SettingValue]) -> dict[str, SettingValue]:
        return {find_setting(key): _checked(key, value) for key, value in settings.items()}

    @field_validator("webhook")
    @classmethod
    def _callable_address(cls, webhook: str | None) -> str | None:
        if webhook is not None and (not urlsplit(webhook).hostname or urlsplit(webhook).port == 0):
            raise ValueError("expected an address such as https://host/path")
        return webhook

    def overrides(self) -> list[str]:
        """Return the settings in the form that the library takes."""
        return [f"{key}={_as_text(value)}" for key, value in self.settings.items()]


def find_setting(key: str) -> str:
    """Return the full name of a setting, given its full name or the end of it (`data.max_side`, `max_side`).

    If the end of a name fits both a user setting and an option of an algorithm, it means the user setting.

    Raises ValueError for a setting that does not exist, with similar names, or that is ambiguous.
    """
    hits = [key] if key in SETTINGS else [path for path in SETTINGS if path.endswith("." + key)]
    hits = [path for path in hits if not path.startswith(EXPERT)] or hits
    if len(hits) == 1:
        return hits[0]
    if hits:
        raise ValueError(f"setting {key!r} is ambiguous: use one of {', '.join(hits)}")
    if (name := _renamed(key[:100])) != key[:100]:
        raise ValueError(f"setting {key[:100]!r} does not exist; use {name!r}")
    last = {path.rpartition(".")[2]: path for path in reversed(SETTINGS)}  # reversed, as user settings come first
    near = [last[name] for name in difflib.get_close_matches(key.rpartition(".")[2], last, n=3, cutoff=0.5)]
    hint = f"did you mean {', '.join(near)}?" if near else "GET /options lists all settings"
    raise ValueError(f"setting {key[:100]!r} does not exist; {hint}")


def _renamed(key: str) -> str:
    """Replace each name of RENAMED in a key."""
    for name, new in RENAMED.items():
        key = re.sub(rf"(?<![^.]){re.escape(name)}(?![^.])", new, key)
    return key


def parse_setting(text: str) -> tuple[str, SettingValue]:
    """Parse a command line's KEY=VALUE into full name and value. Raises ValueError if it is invalid."""
    key, equals, value = text.partition("=")
    if not equals:
        raise ValueError(f"{text}: expected KEY=VALUE, for example masks=off")
    path = find_setting(key.strip())
    return path, _checked(path, _parse(value.strip(), _alternatives(path)))


def _parse(text: str, schemas: list[dict[str, Any]]) -> SettingValue:
    """Convert the text by the first schema that can read it. If none can, return the text itself."""
    for schema in schemas:
        try:
            match schema["type"]:
                case "null" if text.lower() == "none":
                    return None
                case "boolean" if text.lower() in _SWITCHES:
                    return _SWITCHES[text.lower()]
                case "integer":
                    return int(text)
                case "number":
                    return float(text)
        except ValueError:
            continue
    return text


def _checked(key: str, value: SettingValue) -> SettingValue:
    """Return the value if it is valid for the setting. Raises ValueError with the expected values otherwise."""
    schemas = _alternatives(find_setting(key))
    if any(_fits(value, schema) for schema in schemas):
        return value
    expected = " or ".join(_say(schema) for schema in schemas)
    raise ValueError(f"{key}: expected {expected}, got {json.dumps(value)[:100]}")


def _alternatives(path: str) -> list[dict[str, Any]]:
    schema = SETTINGS[path]
    found: list[dict[str, Any]] = schema.get("anyOf", [schema])
    return found


def _fits(value: SettingValue, schema: dict[str, Any]) -> bool:
    if schema["type"] == "null" or value is None:
        return schema["type"] == "null" and value is None
    if isinstance(value, bool) and schema["type"] != "boolean":
        return False
    if not isinstance(value, _KINDS[schema["type"]]) or ("enum" in schema and value not in schema["enum"]):
        return False
    if isinstance(value, str):
        return re.search(schema.get("pattern", ""), value) is not None
    return _within(value, schema)


def _within(value: float, schema: dict[str, Any]) -> bool:
    low = value > schema["exclusiveMinimum"] if "exclusiveMinimum" in schema else value >= schema.get("minimum", 0)
    return low and value <= schema.get("maximum", math.inf) and value < math.inf


def _say(schema: dict[str, Any]) -> str:
    if "enum" in schema:
        return "one of " + ", ".join(schema["enum"])
    if "pattern" in schema:
        return "a string such as " + json.dumps(schema["examples"][0])
    words = {"minimum": "at least", "exclusiveMinimum": "more than", "maximum": "at most"}
    bounds = " and ".join(f"{word} {schema[key]:g}" for key, word in words.items() if key in schema)
    kind = {"null": "null", "boolean": "true or false"}.get(schema["type"], schema["type"])
    return f"{kind} of {bounds}" if bounds else kind


def _as_text(value: SettingValue) -> str:
    if value is None:
        return "none"
    return ("on" if value else "off") if isinstance(value, bool) else str(value)
