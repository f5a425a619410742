"""A transfer as a form: `video`, one or more `reference` files or ids, and options that hold for all looks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pydantic import ValidationError

from service.api.metadata import to_metadata
from service.api.multipart import CURL_SENDS_FILES, Form
from service.api.problems import NO_FIELD, given_twice, invalid, invalid_values
from service.api.schemas import LookOptions, OutputRequest, TransferRequest
from service.api.uploads import ReceivedFile
from service.errors import ServiceError

_OUTPUT_FIELDS = frozenset(OutputRequest.model_fields)
_LOOK_FIELDS = frozenset(LookOptions.model_fields)
#: comma-separated, or given again
_LISTS = frozenset({"protect", "faces", "extras"})
#: those of the body that stand beside its looks
_OWN_FIELDS = frozenset(TransferRequest.model_fields) - {"looks", "output"}

_TEXTS = (_LOOK_FIELDS | _OUTPUT_FIELDS | _OWN_FIELDS) - {"video"}
_NO_FILE = "it takes the id of a video; upload the file to /videos first"
_REFERENCE = f"this is neither a file nor the id of a reference or a video; {CURL_SENDS_FILES}"
_MAKEUP = "it is a number from 0 to 1, or one of each part: lips=1,lids=0.3"

_OWN_WORDS = {"makeup": _MAKEUP, "reference": _REFERENCE}


def to_request(form: Form, uploaded: Sequence[str]) -> TransferRequest:
    """The request that a form stands for; ``uploaded`` are the ids of its files, in their order.

    Its options hold for all of its looks. Raises `ValidationFailedError` with pointers that name the form's fields.
    """
    options: dict[str, Any] = {}
    output: dict[str, Any] = {}
    ids = iter(uploaded)
    references = [part if isinstance(part, str) else next(ids) for part in references_of(form)]
    top: dict[str, Any] = {}
    pairs: list[str] = []
    unknown: list[str] = []
    once = (name for name, _ in form.fields if name not in {"reference", "metadata", *_LISTS})
    if twice := given_twice(once):
        raise invalid_values({f"/{name}": "the field is given more than once" for name in twice})
    for name, text in _joined(form):
        if name == "metadata":
            pairs.append(text)
        elif name in _OWN_FIELDS:
            top[name] = {"url": text} if name == "webhook" else text
        elif name in _LOOK_FIELDS:
            options[name] = _option(name, text)
        elif name in _OUTPUT_FIELDS:
            output[name] = _option(name, text)
        else:
            unknown.append(name)
    if unknown:
        raise invalid_values({f"/{name}": NO_FIELD for name in unknown})
    top["metadata"] = to_metadata(pairs)
    try:
        return TransferRequest.model_validate(
            {**top, "looks": [{"reference": one, **options} for one in references], "output": output}
        )
    except ValidationError as error:
        raise _named_by_field(error) from error


def wrong_file(name: str) -> str:
    """Why a field of this name takes no file; nothing of references."""
    if name == "reference":
        return ""
    return _NO_FILE if name == "video" else "it takes a text" if name in _TEXTS else NO_FIELD


def references_of(form: Form) -> list[str | ReceivedFile]:
    """Its references, ids and files, in their order, which is that of its looks."""
    return [part for name, part in form.parts() if name == "reference"]


def reference_at(number: int) -> str:
    """Where a form has one of its references, counted from 0, as a JSON pointer."""
    return f"/reference/{number}"


def _joined(form: Form) -> list[tuple[str, str]]:
    """The fields but for references; those of a list that is given more than once are one."""
    lists: dict[str, list[str]] = {}
    for name, text in form.fields:
        if name in _LISTS:
            lists.setdefault(name, []).append(text)
    others = [(name, text) for name, text in form.fields if name not in {"reference", *_LISTS}]
    return others + [(name, ",".join(texts)) for name, texts in lists.items()]


def _option(name: str, text: str) -> str | list[str] | dict[str, str]:
    """The value of a field: a list or, as in `lips=1,lids=0.3`, a mapping where the option may be one.

    Raises `ValidationFailedError` for a part of a mapping that is given more than once.
    """
    parts = [part.strip() for part in text.split(",") if part.strip()]
    if name == "makeup" and "=" in text:
        pairs = [(part.strip(), value.strip()) for part, _, value in (one.partition("=") for one in parts)]
        names = [part for part, _ in pairs]
        if not all(names):
            return text  # which is no number either
        if twice := given_twice(names):
            raise invalid_values({f"/{name}/{part}": "it is given more than once" for part in twice})
        return dict(pairs)
    return parts if name in _LISTS and text != "all" else text


def _named_by_field(error: ValidationError) -> ServiceError:
    """The same problem, with the fields named as the form names them."""
    named: dict[str, str] = {}
    refused = invalid(error)
    if not refused.errors:
        return refused
    for item in refused.errors:
        parts = item["pointer"].split("/")[1:]
        # /looks/0/strength -> /strength, /looks/1/reference -> /reference/1, /output/crf -> /crf
        shown = parts[2:] if parts[0] == "looks" else parts[1:] if parts[0] == "output" else parts
        shown = ["webhook"] if parts[0] == "webhook" else shown
        where = reference_at(int(parts[1])) if shown == ["reference"] else "/" + ("/".join(shown) or "reference")
        named.setdefault(where, _OWN_WORDS.get("/".join(shown), item["detail"]))
    return invalid_values(named)
