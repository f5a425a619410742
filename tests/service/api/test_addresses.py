"""Everything is under /v1; the same without it is an alias that no answer names."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from service.settings import Settings
from tests.service.api.test_media import upload
from tests.service.fixtures import MP4, Api, make_ready, make_results, serve


@pytest.fixture
def proxied(settings: Settings) -> Iterator[Api]:
    """An API behind a proxy that adds a path."""
    yield from serve(settings.model_copy(update={"root_path": "/faces"}))


def addresses(api: Api, prefix: str) -> list[str]:
    """What the answers to calls at this prefix name."""
    sent = api.client.post(f"{prefix}/videos", content=MP4)
    video = sent.json()["id"]
    make_ready(api.services, video)
    asked = api.client.post(f"{prefix}/transfer", json={"video": video, "looks": [{"reference": video}], "force": True})
    make_results(api.services, asked.json()["id"], [b"one"], parts=[("look.cube", 1, b"cube")])
    (look,) = api.client.get(f"{prefix}/jobs/{asked.json()['id']}").json()["looks"]
    return [sent.headers["location"], asked.headers["location"], look["url"], look["extras"][0]["url"]]


@pytest.mark.parametrize("prefix", ["/v1", ""])
def test_answers_name_addresses_with_the_version_and_they_lead_there(api: Api, prefix: str) -> None:
    found = addresses(api, prefix)
    assert [address.split("/")[1:3] for address in found] == [
        ["v1", "videos"],
        ["v1", "jobs"],
        ["v1", "results"],
        ["v1", "results"],
    ]
    assert [api.client.get(address).status_code for address in found] == [200] * 4


def test_the_path_of_a_proxy_stands_before_the_version(proxied: Api) -> None:
    assert all(address.startswith("/faces/v1/") for address in addresses(proxied, ""))


def test_the_schema_names_every_operation_once(api: Api) -> None:
    paths = api.client.get("/v1/openapi.json").json()["paths"]
    rooted = {path for path in paths if not path.startswith("/v1/")}
    assert rooted == {"/livez", "/readyz", "/metrics"}
    assert api.client.get("/v1/livez").json() == api.client.get("/livez").json()
    assert api.client.get("/v1/docs").text == api.client.get("/docs").text


def test_one_idempotency_key_is_of_both_addresses(api: Api) -> None:
    video = upload(api, "/videos")["id"]
    body, headers = {"video": video, "looks": [{"reference": video}], "force": True}, {"Idempotency-Key": "order-42"}
    first = api.client.post("/transfer", json=body, headers=headers)
    again = api.client.post("/v1/transfer", json=body, headers=headers)
    assert again.headers["idempotent-replayed"] == "true"
    assert again.json() == first.json()
