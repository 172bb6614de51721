"""/options: the options of jobs."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter
from pydantic import BaseModel, Field

from service.contract.options import EXPERT, METHODS, PRESETS, SETTINGS, JobOptions
from service.parts import OwnerDep, PartsDep
from service.problems import answers

# Prefixes of settings that no form needs: those that only reproduce the paper's rows, and the options of algorithms.
UNLISTED = ("train.paper.", EXPERT)

router = APIRouter(tags=["options"])


class OptionsView(BaseModel):
    """The options of jobs, with presets, methods and settings."""

    options: dict[str, Any] = Field(description="The JSON schema of JobOptions.")
    presets: dict[str, dict[str, str]] = Field(description="The settings that each preset changes.")
    methods: dict[str, dict[str, str]] = Field(description="The settings that each method changes.")
    settings: dict[str, dict[str, Any]] = Field(
        description="The JSON schema of each setting, without `train.paper` and `expert`."
    )
    max_upload: int = Field(description="The largest size of an archive, in bytes.")


@router.get("/options", responses=answers())
async def get_options(owner: OwnerDep, parts: PartsDep) -> OptionsView:
    """Get the options' schema, the presets, every setting with its default, and the size limit of archives."""
    return OptionsView(
        options=JobOptions.model_json_schema(),
        presets=PRESETS,
        methods=METHODS,
        settings={path: schema for path, schema in SETTINGS.items() if not path.startswith(UNLISTED)},
        max_upload=parts.settings.max_upload,
    )
