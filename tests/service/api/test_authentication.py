"""One server with keys for the whole module: each test makes keys of its own."""

from __future__ import annotations

import socket
import uuid
from collections.abc import Generator, Iterator
from dataclasses import dataclass
from typing import Any

import httpx
import pytest
from fastapi.routing import APIRoute

from service.api.routers import ROUTERS
from service.catalog import Key, amounts, jobs, keys
from service.catalog.keys import Limits
from service.settings import Settings
from tests.service.fixtures import MP4, PNG, Api, claim, make_ready, make_results, serve


@pytest.fixture(scope="module")
def keyed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Api]:
    settings = Settings(data_dir=tmp_path_factory.mktemp("keyed") / "data", reap_interval_s=3600)
    for api in serve(settings):
        add_key(api)
        yield api


class Bearer(httpx.Auth):
    """Sends a key with a request of the module's client."""

    def __init__(self, text: str) -> None:
        self.text = text

    def auth_flow(self, request: httpx.Request) -> Generator[httpx.Request, httpx.Response, None]:
        request.headers.setdefault("Authorization", f"Bearer {self.text}")
        yield request


@dataclass(frozen=True)
class Holder:
    """A key, and requests with it."""

    id: str
    text: str
    anyone: httpx.Client

    def send(self, method: str, path: str, **options: Any) -> httpx.Response:
        return self.anyone.request(method, path, auth=Bearer(self.text), **options)

    def get(self, path: str, **options: Any) -> httpx.Response:
        return self.send("GET", path, **options)

    def post(self, path: str, **options: Any) -> httpx.Response:
        return self.send("POST", path, **options)

    def delete(self, path: str, **options: Any) -> httpx.Response:
        return self.send("DELETE", path, **options)

    def upload(self, path: str = "/videos", content: bytes = MP4) -> httpx.Response:
        return self.post(path, content=content)

    def transfer(self, video: str, reference: str, **more: object) -> httpx.Response:
        return self.post("/transfer", json={"video": video, "looks": [{"reference": reference}], **more})


def add_key(api: Api, limits: Limits | None = None) -> tuple[Key, str]:
    database = api.services.database
    with database.write() as session:
        return keys.create(session, uuid.uuid4().hex, limits or Limits(), now=database.now())


def holder(api: Api, limits: Limits | None = None) -> Holder:
    key, text = add_key(api, limits)
    return Holder(key.id, text, api.client)


def test_without_keys_everybody_is_nobody_and_with_the_first_one_a_key_is_needed(api: Api) -> None:
    video = api.client.post("/videos", content=MP4).json()
    assert "ratelimit" not in api.client.get("/videos").headers
    # a key that is sent must be a good one, so that nothing is kept for nobody by mistake
    wrong = {"Authorization": "Bearer pvg_x"}
    refused = api.client.get("/videos", headers=wrong)
    assert (refused.status_code, "has no keys" in refused.json()["detail"]) == (401, True)
    first = holder(api)
    assert "malformed" in api.client.get("/videos", headers=wrong).json()["detail"]
    assert api.client.get("/videos").status_code == 401
    assert first.get("/videos").json()["data"] == []
    with api.services.background.write() as session:
        keys.adopt(session, session.get_one(Key, first.id))
    assert first.get(f"/videos/{video['id']}").json()["id"] == video["id"]
    assert first.get(f"/jobs/{video['job']}").status_code == 200


@pytest.mark.parametrize("path", ["/livez", "/readyz", "/docs", "/redoc", "/docs/assets/favicon.png", "/openapi.json"])
def test_pages_and_health_need_no_key(keyed: Api, path: str) -> None:
    answer = keyed.client.get(path)
    assert answer.status_code == 200
    assert "ratelimit" not in answer.headers


def test_every_other_route_asks_for_a_key_and_says_so_in_the_schema(keyed: Api) -> None:
    paths = keyed.client.get("/openapi.json").json()["paths"]
    for path, operations in paths.items():
        for method, operation in operations.items():
            answer = keyed.client.request(method, path.format_map(dict.fromkeys(_names(path), "x")))
            if path in {"/livez", "/readyz"}:
                assert "security" not in operation
                assert answer.status_code == 200
            else:
                by_link = [{}] if any(one["name"] == "signature" for one in operation.get("parameters", [])) else []
                assert operation["security"] == [{"metrics" if path == "/metrics" else "key": []}, *by_link], path
                assert answer.status_code == 401
                assert answer.json()["code"] == "unauthorized"
                assert answer.headers["www-authenticate"] == 'Bearer realm="pvg"'


def _names(path: str) -> list[str]:
    return [part[1:-1] for part in path.split("/") if part.startswith("{")]


def test_no_route_has_its_body_read_before_the_key_is_looked_at() -> None:
    """FastAPI reads the bodies that routes declare before it calls their dependencies."""
    routes = [route for router in ROUTERS for route in router.routes if isinstance(route, APIRoute)]
    assert len(routes) > 10
    assert [route.path for route in routes if route.body_field is not None] == []


def test_a_wrong_or_revoked_key_is_an_invalid_token(keyed: Api) -> None:
    one = holder(keyed)
    assert one.get("/jobs").status_code == 200
    assert one.get("/jobs", headers={"Authorization": f"Bearer {one.text[:-2]}xx"}).status_code == 401
    assert one.get("/jobs", headers={"Authorization": "Basic YTpi"}).status_code == 401
    with keyed.services.background.write() as session:
        keys.revoke(session, session.get_one(Key, one.id), now=keyed.services.database.now())
    refused = one.get("/jobs")
    assert refused.status_code == 401
    assert refused.headers["www-authenticate"] == 'Bearer realm="pvg", error="invalid_token"'


def test_an_upload_without_a_key_is_not_received(keyed: Api) -> None:
    with socket.create_connection(keyed.address, timeout=30) as sender:
        head = (
            "POST /videos HTTP/1.1\r\nHost: localhost\r\nContent-Length: 1000000000\r\nContent-Type: video/mp4\r\n\r\n"
        )
        sender.sendall(head.encode() + MP4)
        answer = sender.recv(4096)
        assert answer.startswith(b"HTTP/1.1 401 ")
        assert b"connection: close" in answer.lower()
    assert keyed.drafts == []


def test_the_same_bytes_of_two_keys_are_two_media(keyed: Api) -> None:
    one, other = holder(keyed), holder(keyed)
    first, second = one.upload(), other.upload()
    assert (first.status_code, second.status_code) == (202, 202)  # a 200 would tell that another key has them
    assert first.json()["id"] != second.json()["id"]
    assert one.upload().status_code == 200
    assert [video["id"] for video in one.get("/videos").json()["data"]] == [first.json()["id"]]


def test_what_belongs_to_another_key_is_as_unknown_as_what_is_not_there(keyed: Api) -> None:
    one, other = holder(keyed), holder(keyed)
    video, reference = one.upload().json(), one.upload("/references", PNG).json()
    for made in (video, reference):
        make_ready(keyed.services, made["id"])
    job = one.transfer(video["id"], reference["id"], output={"extras": ["cube"]}).json()
    (result,) = make_results(keyed.services, job["id"], [b"result"], parts=[("look.cube", 1, b"cube")])
    paths = [f"/videos/{video['id']}", f"/references/{reference['id']}", f"/jobs/{job['id']}", f"/jobs/{video['job']}"]
    paths += [f"/results/{result}", f"/results/{result}/look.cube"]
    for path in paths:
        assert one.get(path).status_code == 200
        hidden = other.get(path)
        unknown = other.get(path[: path.rindex("_") + 1] + "0" * 32) if "cube" not in path else hidden
        assert hidden.status_code == unknown.status_code == 404
        assert other.delete(path).status_code in {404, 405}
    assert other.post(f"/jobs/{job['id']}/cancel").status_code == 404
    mine = other.upload("/references", PNG).json()
    for looked in (
        other.transfer(video["id"], mine["id"]),
        other.transfer(other.upload().json()["id"], reference["id"]),
    ):
        assert (looked.status_code, looked.json()["code"]) == (404, "not-found")
    assert other.post("/swap", json={"a": video["id"], "faces": [0, 1]}).status_code == 404
    assert other.get("/jobs", params={"id": f"{job['id']},{video['job']}"}).json()["data"] == []
    listed = other.get("/jobs", params={"video": video["id"]}).json()["data"]
    assert listed == []
    assert one.get(f"/results/{result}").content == b"result"


def test_requests_over_the_rate_are_refused_until_the_minute_is_over(keyed: Api) -> None:
    one = holder(keyed, Limits(requests_per_minute=3))
    answers = [one.get("/jobs/unknown") for _ in range(7)]  # at most one end of a minute lies between them
    policy = {answer.headers["ratelimit-policy"] for answer in answers}
    assert policy == {'"requests";q=3;w=60'}
    assert answers[0].headers["ratelimit"].startswith('"requests";r=2;t=')
    refused = next(answer for answer in answers if answer.status_code == 429)
    assert refused.json()["code"] == "quota-exceeded"
    assert 1 <= int(refused.headers["retry-after"]) <= 60
    assert refused.headers["ratelimit"] == f'"requests";r=0;t={refused.headers["retry-after"]}'
    assert keyed.client.get("/livez").status_code == 200


def test_a_key_has_so_many_unfinished_jobs_and_no_more(keyed: Api) -> None:
    one = holder(keyed, Limits(active_jobs=2))
    video = one.upload().json()
    reference = one.upload("/references", PNG).json()
    refused = one.transfer(video["id"], reference["id"])
    assert (refused.status_code, refused.json()["code"]) == (429, "quota-exceeded")
    assert '"active-jobs";q=2' in refused.headers["ratelimit-policy"]
    assert '"active-jobs";r=0' in refused.headers["ratelimit"]
    assert refused.headers["retry-after"] == "10"
    assert one.upload(content=MP4 + b"2").status_code == 429
    assert one.upload().status_code == 200  # known bytes make no job
    make_ready(keyed.services, video["id"])
    assert one.transfer(video["id"], reference["id"]).status_code == 202
    assert holder(keyed).upload().status_code == 202


def test_a_key_keeps_so_many_bytes_and_no_more(keyed: Api) -> None:
    one = holder(keyed, Limits(stored_bytes=len(MP4) + 10))
    video = one.upload().json()
    over = one.upload(content=MP4 + b"more")
    assert over.status_code == 429
    assert '"stored-bytes"' in over.headers["ratelimit-policy"]
    assert int(over.headers["retry-after"]) > 0
    assert one.post("/videos", content=iter([MP4, b"no length"])).status_code == 429
    assert one.delete(f"/videos/{video['id']}", params={"cancel_jobs": True}).status_code == 204
    assert one.upload(content=MP4 + b"more").status_code == 202
    assert keyed.drafts == []


def test_a_result_belongs_to_the_key_of_its_job(keyed: Api) -> None:
    one = holder(keyed)
    video = one.upload().json()
    make_ready(keyed.services, video["id"])
    job = one.transfer(video["id"], video["id"]).json()
    make_results(keyed.services, job["id"], [b"12345"])
    with keyed.services.database.read() as session:
        found = jobs.get(session, job["id"], owner=one.id)
        assert found is not None
        assert amounts.stored_bytes(session, one.id) == len(MP4) + 30 + 5


def test_claims_of_a_key_are_counted_for_its_jobs_alone(keyed: Api) -> None:
    one = holder(keyed)
    video = one.upload(content=MP4 + b"claims").json()
    claim(keyed.services.database, video["job"])
    with keyed.services.database.read() as session:
        assert amounts.active_jobs(session, one.id) == 1
