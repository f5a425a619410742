"""What the client and the interface both state, tied together: a field that one of them has alone fails here."""

from __future__ import annotations

import base64
import inspect
from collections.abc import Callable, Collection, Iterator
from contextlib import suppress
from dataclasses import fields
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import httpx
import pytest
from fastapi import APIRouter
from fastapi.routing import APIRoute
from pydantic import BaseModel

import pvg_client
from pvg_client import ApiError, Client
from service.api.query import parameters_of
from service.api.routers import jobs, references, uploads, videos, webhooks
from service.api.schemas import (
    ExtraBody,
    FaceBody,
    JobBody,
    LookBody,
    LookOptions,
    MediaBody,
    MediaInfo,
    OpenUploadBody,
    ProgressBody,
    SwapRequest,
    TransferRequest,
    UploadLinkRequest,
    UsageBody,
)
from service.api.webhook_bodies import DeliveryBody

#: what the client has under another name, or leaves to `raw`
ELSEWHERE = {
    JobBody: {"queue"},  # `queue_position`
    LookBody: {"url", "size_bytes", "content_type", "sha256", "expires_at", "extras"},  # of `result`
    MediaBody: {"poster"},  # `poster()` fetches it
    FaceBody: {"thumbnail"},  # so does `thumbnail()`
    MediaInfo: {"color_primaries", "color_transfer"},
}


def names_of(kind: type[Any]) -> set[str]:
    return {one.name for one in fields(kind)}


def parameters(call: Callable[..., Any]) -> set[str]:
    return set(inspect.signature(call).parameters) - {"self"}


@pytest.mark.parametrize(
    ("ours", "body"),
    [
        (pvg_client.Job, JobBody),
        (pvg_client.JobLook, LookBody),
        (pvg_client.Extra, ExtraBody),
        (pvg_client.Progress, ProgressBody),
        (pvg_client.Medium, MediaBody),
        (pvg_client.Picture, MediaInfo),
        (pvg_client.Face, FaceBody),
        (pvg_client.Upload, OpenUploadBody),
        (pvg_client.Webhook, DeliveryBody),
        (pvg_client.Usage, UsageBody),
    ],
    ids=lambda one: one.__name__,
)
def test_the_client_has_every_field_of_an_answer(ours: type[Any], body: type[BaseModel]) -> None:
    assert names_of(ours) >= body.model_fields.keys() - ELSEWHERE.get(body, set())


def test_a_result_has_what_its_look_tells_of_it() -> None:
    assert names_of(pvg_client.Result) >= ELSEWHERE[LookBody]


@pytest.mark.parametrize(
    ("call", "request_body", "others"),
    [
        (Client.transfer, TransferRequest, {"reference"}),
        # the options of a look are one mapping
        (Client.swap, SwapRequest, {"options"}),
        (Client.upload_link, UploadLinkRequest, set()),
    ],
    ids=["transfer", "swap", "upload_link"],
)
def test_the_client_asks_for_all_that_may_be_asked_for(
    call: Callable[..., Any], request_body: type[BaseModel], others: Collection[str]
) -> None:
    wanted = set(request_body.model_fields)
    if request_body is SwapRequest:
        wanted -= LookOptions.model_fields.keys()
    assert parameters(call) == wanted | {*others} | {"idempotency_key"}


@pytest.mark.parametrize(
    ("call", "router", "route"),
    [
        (Client.jobs, jobs.router, jobs.list_jobs),
        (Client.videos, videos.router, videos.list_videos),
        (Client.references, references.router, references.list_references),
        (Client.webhooks, webhooks.router, webhooks.list_webhooks),
        (Client.uploads, uploads.router, uploads.list_uploads),
    ],
    ids=lambda one: getattr(one, "__name__", ""),
)
def test_the_client_lists_by_every_filter(
    call: Callable[..., Any], router: APIRouter, route: Callable[..., Any]
) -> None:
    found = next(one for one in router.routes if isinstance(one, APIRoute) and one.endpoint is route)  # HEAD: another
    wanted = {name for name, _ in parameters_of(found.dependant)}
    # `Listing` sees to pages, and `id` is a word of Python's
    assert parameters(call) == {"ids" if one == "id" else one for one in wanted} - {"cursor", "limit"}


#: of arguments that go to the service as they are, a value, and how it is said there
SAID: dict[str, tuple[Any, str]] = {
    "mask": ("ycbcr", "ycbcr"),
    "matching": ("chain", "chain"),
    "input_color": ("slog3", "slog3"),
    "webhook": ("https://studio.example/hook", "studio.example"),
    "metadata": ({"order": "forty-two"}, "forty-two"),
    "output": ({"codec": "hevc"}, "hevc"),
    "force": (True, "true"),
    "max_bytes": (7654321, "7654321"),
    "expires_in_s": (4321, "4321"),
    "state": (["failed"], "failed"),
    "kind": (["swap"], "swap"),
    "job": ("job_1", "job_1"),
    "video": ("vid_1", "vid_1"),
    "reference": ("ref_1", "ref_1"),
    "ids": (["job_1", "job_2"], "job_2"),
    "options": ({"strength": 0.125}, "0.125"),
    "role": ("reference", "reference"),
    "idempotency_key": ("order-42", "order-42"),
}


def first_request(call: Callable[..., Any], *given: Any, **arguments: Any) -> str:
    """All that the first request of a call says, with what stands in it in base64."""
    asked: list[str] = []

    def refuse(request: httpx.Request) -> httpx.Response:
        said = [str(request.url), *request.headers.values(), request.read().decode(errors="replace")]
        pairs = request.headers.get("upload-metadata", "").split(",")
        asked.append(" ".join([*said, *(base64.b64decode(pair.partition(" ")[2]).decode() for pair in pairs)]))
        return httpx.Response(400)

    with Client(transport=httpx.MockTransport(refuse), retries=0) as client, suppress(ApiError):
        done = call(client, *given, **arguments)
        if isinstance(done, Iterator):
            next(done)
    return unquote(asked[0])


@pytest.mark.parametrize("way", ["whole", "in pieces", "by URL"])
def test_an_upload_says_all_that_it_is_given(tmp_path: Path, way: str) -> None:
    file = tmp_path / "clip.mp4"
    file.write_bytes(b"clip")
    given = (
        {"url": "https://media.example/clip.mp4"} if way == "by URL" else {"file": file, "resume": way == "in pieces"}
    )
    for name in parameters(Client.upload) - {"file", "url", "resume"}:
        value, said = SAID[name]
        assert said in first_request(Client.upload, **given, **{name: value}), name


@pytest.mark.parametrize(
    ("call", "given"),
    [
        (Client.transfer, {"video": "vid_1", "looks": "ref_1"}),
        (Client.swap, {"a": "vid_1", "b": "vid_2"}),
        (Client.upload_link, {}),
        (Client.jobs, {}),
        (Client.videos, {}),
        (Client.webhooks, {}),
    ],
    ids=lambda one: getattr(one, "__name__", ""),
)
def test_a_call_says_all_that_it_is_given(call: Callable[..., Any], given: dict[str, Any]) -> None:
    for name in parameters(call) - given.keys() - ({"reference"} if "looks" in given else set()):
        value, said = SAID[name]
        assert said in first_request(call, **given, **{name: value}), name
