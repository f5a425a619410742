"""HEAD is answered wherever GET is: with the same status and header fields, and without a body."""

from __future__ import annotations

import time
from pathlib import Path

import httpx

from service.api import docs, page
from tests.contract.fuzzing import TOKEN, open_service, things
from tests.service.api.test_media import upload
from tests.service.declared import Declared
from tests.service.fixtures import Api

#: of the moment, of how much a key has left, and of a body that is written anew each time
_PASSING = {"date", "x-request-id", "ratelimit"}
#: sent where it is asked for
_OF_PREFERENCES = {"preference-applied"}
#: HEAD has an answer of its own, see tus
_OWN = "/v1/uploads/{upload_id}"


def test_head_is_get_without_its_body_and_both_have_the_fields_of_the_schema(tmp_path: Path) -> None:
    with open_service(tmp_path) as (api, key):
        ids, paths = things(api, key), api.client.get("/openapi.json").json()["paths"]
        places = [path for path, methods in paths.items() if "get" in methods and path != _OWN]
        assert len(places) > 20
        for place in places:
            path = place.format(**ids, number=0, face=0)
            headers = {"Authorization": f"Bearer {TOKEN if place == '/metrics' else key}"}
            _compare(api, path, headers)
            _compare(api, path.removeprefix("/v1") if path.startswith("/v1") else f"/v1{path}", headers)
            _compare(api, path, {})
            got = api.client.get(path, headers=headers)
            assert got.is_success, (place, got.text)
            assert (Declared(api.app).fields(got) or frozenset()) - {*got.headers} <= _OF_PREFERENCES, place
        assert len({one["operationId"] for methods in paths.values() for one in methods.values()}) == sum(
            len(methods) for methods in paths.values()
        )


def _compare(api: Api, path: str, headers: dict[str, str]) -> None:
    got, head = api.client.get(path, headers=headers), api.client.head(path, headers=headers)
    assert head.status_code == got.status_code != 405, path
    assert head.content == b"", path
    passing = _PASSING | ({"content-length"} if path.endswith(("/metrics", "/usage")) else set())
    assert _fields(head, passing) == _fields(got, passing), path


def _fields(answer: httpx.Response, passing: set[str]) -> dict[str, str]:
    return {name: value for name, value in answer.headers.items() if name not in passing}


def test_the_documentation_and_the_page_have_heads(api: Api) -> None:
    assets = [f"/docs/assets/{name}" for name in docs.ASSETS]
    for path in ("/", "/docs", "/redoc", "/docs/problems", "/openapi.json", "/v1/openapi.json", *assets):
        _compare(api, path, {})
    assert api.client.head("/").headers["content-security-policy"] == page.POLICY


def test_a_head_waits_for_no_job(api: Api) -> None:
    job_id = upload(api, "/videos")["job"]
    began = time.monotonic()  # each of these waits would be longer than all the rest may take
    stream = api.client.head(f"/jobs/{job_id}/events")
    assert (stream.status_code, stream.headers["content-type"]) == (200, "text/event-stream; charset=utf-8")
    assert api.services.streams.open == 0
    assert "etag" in api.client.head(f"/jobs/{job_id}?wait=60").headers
    assert "preference-applied" not in api.client.head(f"/jobs/{job_id}", headers={"Prefer": "wait=60"}).headers
    assert time.monotonic() - began < 50


def test_where_there_is_no_get_there_is_no_head_and_allow_says_both(api: Api) -> None:
    assert api.client.head("/transfer").status_code == 405
    assert api.client.put("/videos").headers["allow"] == "GET, HEAD, POST"
    assert api.client.delete("/livez").headers["allow"] == "GET, HEAD"
