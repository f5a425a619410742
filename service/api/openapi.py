"""The schema, as far as FastAPI does not see it: bodies that endpoints read themselves, header fields and examples.

An operation has one type of body: generators of clients take the first they know, or make a choice of them that is no
one's. So a form has an address of its own, besides that of the file or the JSON, which takes it as well.
"""

from __future__ import annotations

import re
import threading
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any, Final

from fastapi import FastAPI
from pydantic import BaseModel

from service.api import examples, tus
from service.api.preview_request import PreviewRequest
from service.api.schemas import (
    MAX_METADATA,
    METADATA_PAIR,
    RECEIVER_URL,
    LookOptions,
    OptionsBody,
    OutputRequest,
    Problem,
    ReferenceByUrl,
    ReferenceOptions,
    ResultLinkRequest,
    SwapRequest,
    TransferRequest,
    UploadLinkRequest,
    VideoByUrl,
)
from service.errors import ALSO_OF_FAILED, OF_FAILED, PROBLEM_JSON, PROBLEMS, MediaFailedError, ProblemType

#: those that FastAPI does not see, because routes read their bodies themselves
_MODELS: Final[tuple[type[BaseModel], ...]] = (
    *(PreviewRequest, Problem, ReferenceByUrl, ResultLinkRequest, SwapRequest),
    *(TransferRequest, UploadLinkRequest, VideoByUrl),
)
BINARY: Final = {"type": "string", "format": "binary"}
_OCTETS: Final = {"contentType": "application/octet-stream"}
_PAIRS = {
    "type": "array",
    "items": {"type": "string", "pattern": METADATA_PAIR},
    "maxItems": MAX_METADATA,
    "description": "`name:value`, each name once: your own data, returned and never interpreted",
}
_RECEIVER = {
    "type": "string",
    "pattern": RECEIVER_URL,
    "maxLength": 2048,
    "description": "URL of a receiver that is told when the work has ended",
}
_REF = "#/components/schemas/{model}"
_JSON: Final = "application/json"
#: those whose pictures are made on request; small ones that are kept are not, and say no frame
_SHOW_FRAMES: Final = frozenset(
    {
        *("create_preview", "get_video_frame", "get_reference_frame", "get_video_poster", "get_reference_poster"),
        *("get_video_face_thumbnail", "get_reference_face_thumbnail"),
    }
)
_SAFE: Final = frozenset({"get", "head", "options"})
#: those that take a file by its URL
_FETCH: Final = frozenset(f"create_{role}{way}" for role in ("video", "reference") for way in ("", "_from_url"))
#: those that may name a receiver of webhooks
_NAME_RECEIVERS: Final = frozenset(
    {
        *("create_video_from_form", "create_reference_from_form", "create_upload", "create_upload_link"),
        *("create_transfer", "create_transfer_from_form", "create_swap"),
    }
)
#: those that are refused because a medium that they name has failed
_NAME_MEDIA: Final = _SHOW_FRAMES | {"create_transfer", "create_transfer_from_form", "create_swap"}
#: what FastAPI says of an answer of which a route says nothing
_UNSAID: Final = "Successful Response"
_SUCCESSES: Final = {
    "200": "OK",
    "201": "made",
    "202": "accepted: a job does the work",
    "204": "done; the answer is empty",
}

_TAGS: Final = {
    "videos": "Clips and still pictures that get new colours. Each is vectorised once.",
    "references": "Pictures and clips that provide skin colours.",
    "uploads": "Uploads in pieces (tus 1.0), which resume after a broken connection, and by a link that needs no key.",
    "transfer": "Requests for recoloured files. Each makes a job.",
    "preview": "Single pictures of a look, for sliders.",
    "jobs": "States, progress, results and errors of the work.",
    "webhooks": "Deliveries of events to your receivers, and the secret that signs them.",
    "results": "Finished files, whole or in ranges.",
    "service": "Limits and usage of the caller.",
    "health": "For process supervisors, load balancers and Prometheus.",
}

_INTEGER: Final = {"type": "integer", "minimum": 0}
_TEXT: Final = {"type": "string"}
_OFFSET: Final = {"type": "integer", "minimum": 0, "maximum": 10**18 - 1}
_LENGTH: Final = {**_OFFSET, "minimum": 1}
#: the header fields of tus 1.0 that requests have, and answers too
_TUS: Final[dict[str, tuple[dict[str, Any], str]]] = {
    # no constant: generators take none in a header
    "Tus-Resumable": (
        {"type": "string", "pattern": f"^{re.escape(tus.VERSION)}$"},
        f"version of tus: {tus.VERSION}",
    ),
    "Upload-Length": (_LENGTH, "size of the whole file in bytes"),
    "Upload-Offset": (_OFFSET, "number of bytes that have arrived"),
    "Upload-Metadata": (
        {"type": "string", "maxLength": tus.MAX_METADATA, "examples": ["filename Y2xpcC5tcDQ=,role dmlkZW8="]},
        "names with values in base64: `role`, `filename`, `webhook`, the settings, `metadata.NAME` for your own data",
    ),
    "Upload-Checksum": (
        {"type": "string", "pattern": f"^({'|'.join(tus.ALGORITHMS)}) [A-Za-z0-9+/]+={{0,2}}$"},
        "`sha256` or `sha1`, a space, and the digest of these bytes in base64; other bytes get 460",
    ),
}
_ASKED: Final = _TUS | {
    "Prefer": (_TEXT, "`wait=20`, as the parameter `wait` (RFC 7240)"),
    "X-HTTP-Method-Override": (_TEXT, "`PATCH`, `DELETE` or `HEAD` of tus, for clients that have only POST"),
}
_OPTIONAL: Final = frozenset({"Upload-Metadata", "Upload-Checksum", "Prefer", "X-HTTP-Method-Override"})
#: the header fields of answers
_FIELDS: Final[dict[str, tuple[dict[str, Any], str]]] = {
    "X-Request-ID": (_TEXT, "id of the request, also in the logs; one that you send is kept"),
    "RateLimit": (_TEXT, "what is left of the key's rate (draft-ietf-httpapi-ratelimit-headers-10)"),
    "RateLimit-Policy": (_TEXT, "the key's rate (draft-ietf-httpapi-ratelimit-headers-10)"),
    "Retry-After": (_INTEGER, "seconds to wait before another try"),
    "WWW-Authenticate": (_TEXT, "how to send a key (RFC 6750)"),
    "Accept-Encoding": (_TEXT, "`identity`, if the body was compressed (RFC 9110, 15.5.16)"),
    "Location": ({"type": "string", "format": "uri-reference"}, "address of what was made"),
    "Idempotent-Replayed": (
        {"type": "string", "const": "true"},
        "this is the stored answer to an earlier request with the same Idempotency-Key",
    ),
    "Preference-Applied": (_TEXT, "the `Prefer: wait=` that was applied (RFC 7240)"),
    "ETag": (
        _TEXT,
        "strong for JSON, files and stored pictures (a hash of the content); weak for pictures made on request",
    ),
    "Repr-Digest": (_TEXT, "sha-256 of the whole file (RFC 9530)"),
    "Accept-Ranges": ({"type": "string", "const": "bytes"}, "Range is supported"),
    "Content-Range": (_TEXT, "which bytes these are, and the size of the whole file"),
    "Content-Disposition": (_TEXT, "name of the file"),
    "Pvg-Frame": (_INTEGER, "number of the frame that the picture shows; missing for stored posters and thumbnails"),
    "Pvg-Media": (_TEXT, "id of the video or reference that the file has become"),
    "Upload-Expires": (_TEXT, "when what has arrived of the file will be deleted (a date of RFC 9110, 5.6.7)"),
    **{name: _TUS[name] for name in ("Tus-Resumable", "Upload-Offset", "Upload-Length", "Upload-Metadata")},
    "Tus-Version": (_TEXT, "supported versions of tus"),
    "Tus-Extension": (_TEXT, "supported extensions of tus"),
    "Tus-Max-Size": (_INTEGER, "largest size of a file in bytes"),
    "Tus-Checksum-Algorithm": (_TEXT, "algorithms for Upload-Checksum"),
}


def file_body(description: str, content_type: str = "application/octet-stream") -> dict[str, Any]:
    """One file, or a piece of one: the body itself."""
    content = {content_type: {"schema": BINARY}}
    return {"requestBody": {"required": True, "description": description, "content": content}}


def file_form(description: str, **others: Any) -> dict[str, Any]:
    """One file: the field `file` of a form, beside others that it may have."""
    properties = {"file": BINARY, **others}
    schema = {"type": "object", "properties": properties, "required": ["file"], "additionalProperties": False}
    content = {"multipart/form-data": {"schema": schema, "encoding": {"file": _OCTETS}}}
    return {"requestBody": {"required": True, "description": description, "content": content}}


def fields(*names: str) -> dict[str, Any]:
    """Header fields that a route reads itself: what is wrong with them is passed over, or has an answer of tus."""
    return {
        "parameters": [
            {"name": name, "in": "header", "required": name not in _OPTIONAL, "description": text, "schema": schema}
            for name, (schema, text) in ((name, _ASKED[name]) for name in names)
        ]
    }


def form_body(description: str, options: type[ReferenceOptions]) -> dict[str, Any]:
    """One file: the field `file` of a form, which may hold the options too."""
    fields = options.model_json_schema()["properties"]
    return file_form(description, **fields, metadata=_PAIRS, webhook=_RECEIVER)


def json_body(model: type[BaseModel], *, required: bool = True) -> dict[str, Any]:
    """A JSON body."""
    content = {_JSON: {"schema": {"$ref": _REF.format(model=model.__name__)}}}
    return {"requestBody": {"required": required, "content": content}}


def file_content(*content_types: str) -> dict[str, Any]:
    """The content of an answer that is a file of one of these types."""
    return {one: {"schema": _TEXT if one.startswith("text/") else BINARY} for one in content_types}


def _words(*words: str) -> str:
    """A pattern for some of these words, with commas."""
    one = "|".join(words)
    return f"^({one})(,({one}))*$"


_FACES: Final = r"^(all|\d{1,3}(,\d{1,3}){0,63})$"
_SHARE: Final = r"(0(\.\d{1,6})?|1)"
_PART: Final = f"(lips|lids|cheeks|brows)={_SHARE}"
#: what a form writes otherwise than a JSON body: as text, with commas
_AS_TEXT: Final[dict[str, dict[str, Any]]] = {
    "contrast": {"anyOf": [{"const": "auto"}, {"type": "number", "minimum": 0.7, "maximum": 1.5}]},
    "match": {"type": "string", "enum": ["semantic", "color"]},
    "protect": {"type": "string", "pattern": _words("eyes", "teeth"), "description": "comma-separated"},
    "faces": {"type": "string", "pattern": _FACES, "description": "all, or comma-separated indices"},
    "makeup": {
        "type": "string",
        "pattern": rf"^({_SHARE}|{_PART}(,{_PART}){{0,3}})$",
        "description": "a number, or comma-separated by part, each once: lips=1,lids=0.3; others have 0.75",
    },
    "extras": {"type": "string", "pattern": _words("cube", "matte"), "description": "comma-separated: cube, matte"},
    "webhook": _RECEIVER,
    "metadata": _PAIRS,
}
_IN_FORM: Final = ("type", "minimum", "exclusiveMinimum", "maximum", "maxLength", "pattern", "enum")


def _form_fields(model: type[BaseModel], names: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Options of a JSON body as a form has them: numbers and words by the same bounds, others by `_AS_TEXT`."""
    properties = model.model_json_schema()["properties"]
    return {name: _AS_TEXT.get(name) or _one_value(properties[name]) for name in names}


def _one_value(schema: dict[str, Any]) -> dict[str, Any]:
    """A number or a word; null, which a form cannot write, is left out."""
    (kind,) = (kind for kind in schema.get("anyOf", [schema]) if kind != {"type": "null"})
    return {name: kind[name] for name in _IN_FORM if name in kind}


#: of a transfer in JSON, what its form has above, or by its parts
_ELSEWHERE: Final = frozenset({"video", "looks", "output"})
TRANSFER_FORM: dict[str, Any] = {
    "type": "object",
    "required": ["video", "reference"],
    "additionalProperties": False,
    "properties": {
        **_form_fields(TransferRequest, ("video",)),
        "reference": {
            "type": "array",
            "items": BINARY,
            "minItems": 1,
            "description": "files or, as fields without a file name and a type, ids of references and videos; one look "
            "each, in this order",
        },
        **_form_fields(LookOptions, OptionsBody.model_fields),
        **_form_fields(OutputRequest, OutputRequest.model_fields),
        **_form_fields(TransferRequest, (name for name in TransferRequest.model_fields if name not in _ELSEWHERE)),
    },
}


def form(schema: dict[str, Any]) -> dict[str, Any]:
    """A form of these fields."""
    content = {"multipart/form-data": {"schema": schema, "encoding": {"reference": _OCTETS}}}
    return {"requestBody": {"required": True, "content": content}}


def install(app: FastAPI) -> None:
    """Complete the schema that FastAPI makes."""
    generate, one_at_a_time = app.openapi, threading.Lock()

    def openapi() -> dict[str, Any]:
        with one_at_a_time:  # others would get it half done
            if app.openapi_schema is None:
                _complete(generate())
        assert app.openapi_schema is not None  # noqa: S101 - filled by generate()
        return app.openapi_schema

    app.openapi = openapi  # type: ignore[method-assign]


def _complete(described: dict[str, Any]) -> None:
    components = described.setdefault("components", {})
    schemas = components.setdefault("schemas", {})
    for model in _MODELS:
        schema = model.model_json_schema(ref_template=_REF)
        schemas.update(schema.pop("$defs", {}))
        schemas[model.__name__] = schema
    for unused in ("HTTPValidationError", "ValidationError"):
        schemas.pop(unused, None)
    schemas["Problem"]["properties"]["code"]["examples"] = sorted(PROBLEMS)
    components["headers"] = {name: {"description": text, "schema": schema} for name, (schema, text) in _FIELDS.items()}
    described["tags"] = [{"name": name, "description": text} for name, text in _TAGS.items()]
    for path, method, operation in _operations(described):
        _complete_operation(path, method, operation)


def _operations(described: dict[str, Any]) -> Iterator[tuple[str, str, dict[str, Any]]]:
    for path, methods in described["paths"].items():
        for method, operation in methods.items():
            yield path, method, operation


def _complete_operation(path: str, method: str, operation: dict[str, Any]) -> None:
    operation_id = operation["operationId"]
    if any(parameter["name"] == "signature" for parameter in operation.get("parameters", [])):
        operation["security"].append({})  # by a link no key is needed
    # what stands before every route may answer so
    for status in (421,) if method in _SAFE else (403, 408, 421):
        operation["responses"].setdefault(str(status), {"description": "", "content": {PROBLEM_JSON: {}}})
    for content in operation.get("requestBody", {}).get("content", {}).values():
        _show(content, operation_id)
    for status, answer in operation["responses"].items():
        if answer["description"] == _UNSAID:
            answer["description"] = _SUCCESSES[status]
        if PROBLEM_JSON in answer.get("content", {}):
            kinds = examples.of_problems(_kinds(int(status), operation), path)
            answer["description"] = ", ".join(f"`{code}`" for code in kinds)
            answer["content"] = {
                PROBLEM_JSON: {
                    "schema": {"$ref": _REF.format(model=Problem.__name__)},
                    "examples": {code: {"value": value} for code, value in kinds.items()},
                }
            }
        for content in answer.get("content", {}).values():
            _show(content, operation_id)
        names = _fields_of(int(status), method, operation, answer)
        answer["headers"] = {name: {"$ref": f"#/components/headers/{name}"} for name in names}


def _kinds(status: int, operation: dict[str, Any]) -> list[ProblemType]:
    """The kinds of problems that an operation may answer with a status."""
    operation_id = operation["operationId"]
    asks = {parameter["name"].lower() for parameter in operation.get("parameters", [])}
    left_out = set() if "idempotency-key" in asks else {"idempotency-key-reused", "idempotency-key-in-use"}
    if operation_id not in _FETCH:
        left_out |= {"fetch-failed"}
    if operation_id not in _FETCH | _NAME_RECEIVERS:
        left_out |= {"url-not-allowed"}
    kinds = [kind for kind in PROBLEMS.values() if kind.status == status and kind.type not in left_out]
    if status != MediaFailedError.kind.status:
        return kinds
    if operation_id not in _NAME_MEDIA:
        return [kind for kind in kinds if kind.type not in OF_FAILED]
    return kinds + [replace(PROBLEMS[code], status=status) for code in ALSO_OF_FAILED]


def _show(content: dict[str, Any], operation_id: str) -> None:
    """Add the examples there are of a content."""
    schema = content.get("schema", {})
    model = str(schema.get("$ref", "")).rpartition("/")[2]
    if model in examples.EXAMPLES:
        content["examples"] = {name: {"value": value} for name, value in examples.EXAMPLES[model].items()}
    elif operation_id in examples.TEXTS:
        content["example"] = examples.TEXTS[operation_id]


def _fields_of(status: int, method: str, operation: dict[str, Any], answer: dict[str, Any]) -> list[str]:
    """The header fields of an answer."""
    names = ["X-Request-ID"]
    asks = {parameter["name"].lower() for parameter in operation.get("parameters", [])}
    content = answer.get("content", {})
    # a file is answered in ranges, and as what it is
    is_file = "range" in asks
    # a key that ends while it waits, or before what it sends is recorded, has been counted
    uncounted = {403, 408, 421} if "wait" in asks or method in {"post", "patch"} else {401, 403, 408, 421}
    if any("key" in scheme for scheme in operation.get("security", [])) and status not in uncounted:
        names += ["RateLimit", "RateLimit-Policy"]
    if status < 300 and method == "post":
        names += ["Idempotent-Replayed"] if "idempotency-key" in asks else []
        names += ["Location"] if _makes_a_place(operation) else []
    if status < 400 and "304" in operation["responses"]:
        names += ["ETag"]
        names += ["Preference-Applied"] if "wait" in asks else []
    if is_file and status < 400:
        names += ["Accept-Ranges", "Repr-Digest"] + (["Content-Disposition"] if content else [])
    if is_file and status in {206, 416}:
        names += ["Content-Range"]
    if status in {409, 429, 503} and PROBLEM_JSON in content:
        names += ["Retry-After"]
    if status == 415 and "requestBody" in operation:
        names += ["Accept-Encoding"]
    if status == 401:
        names += ["WWW-Authenticate"]
    return names + _fields_of_uploads(status, operation) + _fields_of_pictures(status, operation)


def _makes_a_place(operation: dict[str, Any]) -> bool:
    """What it makes has an address of its own: links and previews are the answer themselves."""
    operation_id = operation["operationId"]
    return operation_id.startswith("create_") and not operation_id.endswith(("_link", "_preview"))


def _fields_of_pictures(status: int, operation: dict[str, Any]) -> list[str]:
    return ["Pvg-Frame"] if status == 200 and operation["operationId"] in _SHOW_FRAMES else []


def _fields_of_uploads(status: int, operation: dict[str, Any]) -> list[str]:
    """Those of tus."""
    operation_id = operation["operationId"]
    speaks = "uploads" in operation["tags"]
    names = ["Tus-Resumable"] if speaks and status != 421 else []
    if speaks and status == 412:
        names += ["Tus-Version"]
    if operation_id == "get_upload_protocol" and status == 204:
        names += ["Tus-Version", "Tus-Extension", "Tus-Max-Size", "Tus-Checksum-Algorithm"]
    if operation_id == "create_upload" and status == 201:
        names += ["Upload-Expires"]
    if operation_id in {"append_to_upload", "send_upload_as_form"} and status == 204:
        names += ["Upload-Offset", "Upload-Expires", "Pvg-Media"]
    if operation_id == "send_upload_as_form" and status == 201:
        names += ["Location", "Upload-Offset", "Upload-Expires"]
    if operation_id == "send_upload_as_form" and status == 200:  # of HEAD
        names += ["Upload-Offset", "Upload-Length", "Upload-Metadata", "Upload-Expires", "Pvg-Media"]
    return names
