"""What the client and the interface both state, tied together: a field that one of them has alone fails here."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Collection
from dataclasses import fields
from typing import Any

import pytest
from fastapi import APIRouter
from fastapi.routing import APIRoute
from pydantic import BaseModel

import pvg_client
from pvg_client import Client
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
