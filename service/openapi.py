"""Complete the OpenAPI document: add shared schemas, and give validation errors the form of all other errors."""

from __future__ import annotations

from typing import Any

from fastapi import FastAPI

from service.contract.options import JobOptions
from service.problems import MEDIA_TYPE, ProblemDetails


def describe(app: FastAPI) -> None:
    """Make the app add the schemas that no route's signature mentions to its document."""
    plain = app.openapi

    def document() -> dict[str, Any]:
        if app.openapi_schema is None:
            _complete(plain())
        assert app.openapi_schema is not None
        return app.openapi_schema

    app.openapi = document  # type: ignore[method-assign]


def _complete(schema: dict[str, Any]) -> None:
    schemas = schema["components"]["schemas"]
    for model in (ProblemDetails, JobOptions):
        found = model.model_json_schema(ref_template="#/components/schemas/{model}")
        schemas |= found.pop("$defs", {})
        schemas[model.__name__] = found
    problem = {MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/ProblemDetails"}}}
    for path in schema["paths"].values():
        for operation in path.values():
            if "422" in operation["responses"]:
                operation["responses"]["422"]["content"] = problem
    for name in ("HTTPValidationError", "ValidationError"):
        schemas.pop(name, None)
