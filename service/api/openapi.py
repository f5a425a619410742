"""Documents the bodies that endpoints read themselves: streamed files, and JSON or a form at the same address."""

from __future__ import annotations

from typing import Any

from fastapi import FastAPI
from pydantic import BaseModel

from service.api.schemas import Problem, ReferenceOptions, SwapRequest, TransferRequest

_FILE = {"type": "string", "format": "binary"}
_REF = "#/components/schemas/{model}"


def file_body(description: str, options: type[ReferenceOptions]) -> dict[str, Any]:
    """One file: the raw body, or the field `file` of a form, which may hold the options too."""
    fields = options.model_json_schema()["properties"]
    form = {"type": "object", "properties": {"file": _FILE, **fields}, "required": ["file"]}
    return {
        "requestBody": {
            "required": True,
            "description": description,
            "content": {
                "application/octet-stream": {"schema": _FILE},
                "multipart/form-data": {"schema": form},
            },
        }
    }


def json_body(model: type[BaseModel], form: dict[str, Any] | None = None) -> dict[str, Any]:
    """A JSON body, and possibly a form that says the same."""
    content: dict[str, Any] = {"application/json": {"schema": {"$ref": _REF.format(model=model.__name__)}}}
    if form is not None:
        content["multipart/form-data"] = {"schema": form}
    return {"requestBody": {"required": True, "content": content}}


TRANSFER_FORM: dict[str, Any] = {
    "type": "object",
    "required": ["video", "reference"],
    "properties": {
        "video": {"type": "string"},
        "reference": {"type": "array", "items": _FILE, "description": "files, or ids, one look each"},
        "strength": {"type": "number"},
        "contrast": {"type": "string"},
        "match": {"type": "string"},
        "protect": {"type": "string", "description": "comma-separated"},
        "faces": {"type": "string", "description": "all, or comma-separated indices"},
        "makeup": {"type": "string", "description": "a number, or comma-separated by part: lips=1,lids=0.3"},
        "light": {"type": "number"},
        "reference_face": {"type": "integer"},
        "beta": {"type": "number"},
        "iterations": {"type": "integer"},
        "seed": {"type": "integer"},
        "container": {"type": "string"},
        "codec": {"type": "string"},
        "crf": {"type": "integer"},
        "preset": {"type": "string"},
        "audio": {"type": "string"},
    },
}


def install(app: FastAPI) -> None:
    """Add the schemas that no endpoint declares to FastAPI itself."""
    generate = app.openapi

    def openapi() -> dict[str, Any]:
        if app.openapi_schema is None:
            schemas = generate().setdefault("components", {}).setdefault("schemas", {})
            for model in (Problem, SwapRequest, TransferRequest):
                schema = model.model_json_schema(ref_template=_REF)
                schemas.update(schema.pop("$defs", {}))
                schemas[model.__name__] = schema
        assert app.openapi_schema is not None  # noqa: S101 - filled by generate()
        return app.openapi_schema

    app.openapi = openapi  # type: ignore[method-assign]
