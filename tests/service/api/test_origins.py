from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from typing import Any
from unittest.mock import Mock

import httpx
import pytest
from sqlalchemy import func, select

from service.api.middleware import relative
from service.api.origins import host_name
from service.api.routers import usage
from service.catalog.models import WebhookSecret
from service.settings import Settings
from tests.promises import Drill
from tests.service.api.test_problems import check
from tests.service.fixtures import PNG, Api, serve

#: what a request wants to change, and how pages of other sites can ask for it without a preflight
FORM = {"files": {"file": ("a.png", PNG)}}
TEXT = {"content": PNG, "headers": {"content-type": "text/plain"}}


@pytest.fixture
def named(settings: Settings) -> Iterator[Api]:
    """An API of a name, whose neighbour may write."""
    names = {"allowed_hosts": "faces.example, Other.Example", "allowed_origins": "https://studio.example/"}
    yield from serve(settings.model_copy(update=names))


@pytest.fixture
def anywhere(settings: Settings) -> Iterator[Api]:
    yield from serve(settings.model_copy(update={"allowed_hosts": "*"}))


@pytest.mark.parametrize("host", ["localhost", "LOCALHOST:8000", "127.0.0.1", "127.0.0.1:1", "[::1]", "[::1]:8000"])
def test_the_names_of_loopback_are_answered(api: Api, host: str) -> None:
    assert api.client.get("/videos", headers={"host": host}).status_code == 200


@pytest.mark.parametrize(
    "host",
    [
        "evil.example",
        "localhost.evil.example",
        "evil.example:8000",
        "127.0.0.1.evil.example",
        "localhost@evil.example",
        "evil.example@localhost",
        "localhost/x",
        "localhost#evil.example",
        "localhost, evil.example",
        "[::1",
        "localhost:x",
        "192.168.1.5",
        "",
    ],
)
def test_any_other_name_is_answered_nothing(api: Api, host: str) -> None:
    for path in ("/videos", "/livez", "/readyz", "/docs", "/openapi.json", "/nowhere"):
        answer = api.client.get(path, headers={"host": host})
        assert (answer.status_code, answer.json()["code"]) == (421, "misdirected")
        assert answer.headers["content-type"] == "application/problem+json"
        assert answer.headers["x-request-id"] == answer.json()["request_id"]


def test_another_name_writes_nothing(api: Api, promise: Callable[..., Drill]) -> None:
    drill = promise("R23", wanted="421 or 403; nothing read, nothing written")
    known = api.client.post("/videos", content=PNG).json()
    before = api.blobs
    name, page = {"host": "evil.example"}, {"origin": "https://evil.example"}
    refused = api.client.post("/references", headers=name, files={"file": ("a.png", PNG)})
    other = api.client.post("/references", headers=page, files={"file": ("a.png", PNG)})
    paths = ("/videos", f"/videos/{known['id']}", f"/videos/{known['id']}/file", f"/jobs/{known['job']}")
    reads = [api.client.get(path, headers=name) for path in paths]
    gone = [api.client.delete(f"/videos/{known['id']}?cancel_jobs=true", headers=one) for one in (name, page)]
    drill.measured = (
        f"writes {refused.status_code} and {other.status_code}, deletes {gone[0].status_code} and "
        f"{gone[1].status_code}, {len(reads)} reads {reads[0].status_code}; {len(api.blobs) - len(before)} files more"
    )
    assert [one.status_code for one in (refused, other, *gone)] == [421, 403, 421, 403]
    assert {one.status_code for one in reads} == {421}
    assert not any(known["id"] in one.text.replace(one.json()["instance"], "") for one in reads)
    assert (api.blobs, api.drafts) == (before, [])
    assert api.client.get("/references").json()["data"] == []
    assert api.client.get(f"/videos/{known['id']}").json() == known


def test_more_names_are_a_setting(named: Api, anywhere: Api) -> None:
    for host in ("faces.example", "other.example:8443", "localhost", "FACES.example."):
        assert named.client.get("/videos", headers={"host": host}).status_code == 200
    assert named.client.get("/videos", headers={"host": "evil.example"}).status_code == 421
    assert anywhere.client.get("/videos", headers={"host": "evil.example"}).status_code == 200


def test_the_address_listened_at_is_a_name_too() -> None:
    assert Settings().host_names == {"localhost", "127.0.0.1", "::1"}
    assert "192.168.1.5" in (Settings(host="192.168.1.5").host_names or ())
    assert Settings(host="0.0.0.0").host_names == Settings().host_names


def test_a_name_is_read_without_its_port() -> None:
    assert host_name("A.example:80") == "a.example"
    assert host_name("[::1]:80") == "::1"
    assert host_name("[::1") is None
    assert host_name("a b") is None


@pytest.mark.parametrize(
    "headers",
    [
        {"origin": "https://evil.example"},
        {"origin": "null"},
        {"origin": "http://localhost:3000"},
        {"origin": "http://[broken"},
        {"origin": "file://"},
        {"sec-fetch-site": "cross-site"},
        {"sec-fetch-site": "same-site"},
        {"origin": "https://evil.example", "sec-fetch-site": "cross-site"},
    ],
)
@pytest.mark.parametrize("body", [FORM, TEXT])
def test_pages_of_other_sites_write_nothing(api: Api, headers: dict[str, str], body: dict[str, Any]) -> None:
    sent = headers | body.get("headers", {})
    answer = api.client.post("/references", **(body | {"headers": sent}))
    assert (answer.status_code, answer.json()["code"]) == (403, "forbidden")
    assert api.blobs == api.drafts == []
    assert api.client.get("/references", headers=headers).status_code == 200  # reads are the browser's to guard


def secrets(api: Api) -> int:
    with api.services.database.read() as session:
        return session.scalar(select(func.count()).select_from(WebhookSecret)) or 0


def test_a_picture_on_a_page_of_another_site_makes_no_secret(api: Api, promise: Callable[..., Drill]) -> None:
    drill = promise("R23", wanted="a GET that writes: 403; nothing written")
    picture = {"sec-fetch-site": "cross-site", "sec-fetch-mode": "no-cors", "sec-fetch-dest": "image"}
    answers = [
        api.client.request(method, path, headers=headers)
        for method in ("GET", "HEAD")
        for path in ("/v1/webhooks/secret", "/webhooks/secret", "/webhooks/%73ecret", "/webhooks/secret/")
        for headers in (picture, {"sec-fetch-site": "same-site"}, {"origin": "https://evil.example"})
    ]
    drill.measured = f"{answers[0].status_code}; {secrets(api)} secrets"
    assert {answer.status_code for answer in answers} - {307} == {403}  # one address leads to another
    assert check(answers[0], 403)["code"] == "forbidden"
    assert secrets(api) == 0
    for own in ({}, {"sec-fetch-site": "same-origin"}, {"sec-fetch-site": "none"}):
        assert api.client.get("/webhooks/secret", headers=own).status_code == 200
    assert secrets(api) == 1


def test_an_allowed_origin_may_ask_for_the_secret(named: Api) -> None:
    page = {"origin": "https://studio.example", "sec-fetch-site": "cross-site"}
    assert named.client.get("/webhooks/secret", headers=page).status_code == 200


@pytest.mark.parametrize("method", ["POST", "PUT", "PATCH", "DELETE", "QUERY"])
def test_every_write_is_looked_at(api: Api, method: str) -> None:
    video = api.client.post("/videos", content=PNG).json()["id"]
    for path in (f"/videos/{video}?cancel_jobs=true", "/transfer", "/swap", "/jobs/job_1/cancel", "/nowhere"):
        answer = api.client.request(method, path, headers={"origin": "https://evil.example"})
        assert answer.status_code == 403
    assert api.client.get(f"/videos/{video}").status_code == 200


@pytest.mark.parametrize(
    "headers",
    [
        {},
        {"sec-fetch-site": "same-origin"},
        {"sec-fetch-site": "none"},
        {"origin": "{own}"},
        {"origin": "HTTP://{host}"},
    ],
)
def test_own_pages_and_other_clients_write(api: Api, headers: dict[str, str]) -> None:
    host = f"127.0.0.1:{api.address[1]}"
    sent = {name: value.format(own=f"http://{host}", host=host) for name, value in headers.items()}
    assert api.client.post("/references", content=PNG, headers=sent).status_code == 202


def test_the_default_port_need_not_be_named(named: Api) -> None:
    for origin, host in (("https://faces.example", "faces.example"), ("http://faces.example", "faces.example:80")):
        answer = named.client.post("/references", content=PNG, headers={"origin": origin, "host": host})
        assert answer.status_code in {200, 202}


def test_an_allowed_origin_writes_and_its_browser_is_told(named: Api) -> None:
    page = {"origin": "https://studio.example", "sec-fetch-site": "cross-site"}
    preflight = {"access-control-request-method": "POST", "access-control-request-headers": "content-type"}
    asked = named.client.options("/transfer", headers=page | preflight)
    assert (asked.status_code, asked.headers["access-control-allow-origin"]) == (200, "https://studio.example")
    answer = named.client.post("/references", content=PNG, headers=page)
    assert (answer.status_code, answer.headers["access-control-allow-origin"]) == (202, "https://studio.example")
    other = page | {"origin": "https://evil.example"}
    refused = named.client.options("/transfer", headers=other | preflight)
    assert check(refused, 403)["code"] == "forbidden"
    assert "Disallowed CORS origin" in refused.json()["detail"]
    assert "access-control-allow-origin" not in refused.headers
    assert "Origin" in refused.headers["vary"]
    tracing = page | {"access-control-request-method": "TRACE"}
    assert "CORS method" in check(named.client.options("/transfer", headers=tracing), 403)["detail"]
    assert named.client.post("/references", content=PNG, headers=other).status_code == 403


def test_errors_that_no_route_has_made_are_told_an_allowed_origin_too(
    named: Api, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = {"origin": "https://studio.example", "sec-fetch-site": "cross-site"}

    def told(answer: httpx.Response, status: int) -> None:
        check(answer, status)
        assert answer.headers["access-control-allow-origin"] == "https://studio.example"
        assert "X-Request-ID" in answer.headers["access-control-expose-headers"]
        assert answer.headers["x-content-type-options"] == "nosniff"

    told(named.client.get("/videos", headers=page | {"host": "evil.example"}), 421)
    for error, status in ((RuntimeError("broken"), 500), (asyncio.CancelledError(), 503)):
        monkeypatch.setattr(usage.ledger, "months", Mock(side_effect=error))
        told(named.client.get("/usage", headers=page), status)


def test_a_preflight_has_what_every_answer_has(named: Api) -> None:
    for origin, status in (("https://studio.example", 200), ("https://evil.example", 403)):
        asked = {"origin": origin, "access-control-request-method": "POST", "x-request-id": "mine"}
        answer = named.client.options("/transfer", headers=asked)
        assert answer.status_code == status
        assert answer.headers["x-request-id"] == "mine"
        assert answer.headers["x-content-type-options"] == "nosniff"


def test_nobody_else_is_told_anything(api: Api) -> None:
    answer = api.client.get("/videos", headers={"origin": "https://evil.example"})
    assert not [name for name in answer.headers if name.startswith("access-control")]


@pytest.mark.parametrize(
    ("location", "expected"),
    [
        ("http://evil.example/videos?limit=1", "/videos?limit=1"),
        ("http://x//evil.example/y", "/evil.example/y"),
        ("//evil.example", "/"),
        ("/jobs/job_1", "/jobs/job_1"),
    ],
)
def test_a_location_is_a_path(location: str, expected: str) -> None:
    assert relative(location, "") == expected
    assert relative(location, "/api") == f"/api{expected}"
    assert relative(f"/api{expected}", "/api") == f"/api{expected}"


def test_redirects_name_no_host(api: Api) -> None:
    answer = api.client.get("/videos/?limit=1", headers={"host": "localhost:1234"}, follow_redirects=False)
    assert (answer.status_code, answer.headers["location"]) == (307, "/videos?limit=1")


def test_a_preflight_is_refused_where_no_other_site_may_write(api: Api) -> None:
    asked = {"origin": "https://evil.example", "access-control-request-method": "POST"}
    for path in ("/transfer", "/uploads", "/videos/vid_0"):
        refused = check(api.client.options(path, headers=asked), 403)
        assert "PVG_ALLOWED_ORIGINS" in refused["detail"]
    assert api.client.options("/uploads", headers={"origin": "https://evil.example"}).status_code == 204
    assert api.client.options("/transfer").status_code == 405
