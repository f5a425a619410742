"""What is asked again, when, and what is not: answers and breaks in an order that is set here."""

from __future__ import annotations

import asyncio
import json
import os
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta, tzinfo
from email.utils import format_datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import pytest

from pvg_client import ApiError, AsyncClient, Client, Job, Look, Medium, UnreachableError
from pvg_client.models import FieldError, Problem
from tests.client.lines import MEDIUM

JOB = {
    "id": "job_1",
    "kind": "transfer",
    "state": "succeeded",
    "done": True,
    "attempt": 1,
    "created_at": "2026-01-05T10:00:00Z",
    "brand_new": {"of a later": "version"},
}
NOW = datetime(2026, 1, 5, 12, tzinfo=UTC)
Outcome = httpx.Response | Exception


def problem(status: int, name: str = "unavailable", **headers: str) -> httpx.Response:
    body = {"type": f"/docs/problems#{name}", "code": name, "title": "T", "detail": "D", "status": status, "later": 1}
    body |= {"request_id": "req_1"}
    return httpx.Response(status, json=body, headers={k.replace("_", "-"): v for k, v in headers.items()})


def again(outcome: Outcome) -> Outcome:
    """The same answer once more: httpx reads one only once."""
    if isinstance(outcome, Exception):
        return outcome
    return httpx.Response(outcome.status_code, content=outcome.content, headers=outcome.headers)


def good(**changed: object) -> httpx.Response:
    return httpx.Response(200, json=JOB | changed)


class Script(httpx.MockTransport):
    """Answers, or errors, one after another."""

    def __init__(self, *outcomes: Outcome) -> None:
        self.requests: list[httpx.Request] = []
        self.timeouts: list[set[float]] = []
        self._left = list(outcomes)
        super().__init__(self._next)

    def _next(self, request: httpx.Request) -> httpx.Response:
        self.requests.append(request)
        self.timeouts.append(set(request.extensions["timeout"].values()))
        outcome = self._left.pop(0)
        if isinstance(outcome, Exception):
            raise outcome
        return outcome


@pytest.fixture
def pauses(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The pauses that were made: they take no time, and by the client's clocks nothing else does."""
    made: list[float] = []

    async def pause(seconds: float) -> None:
        made.append(seconds)

    def now(zone: tzinfo) -> datetime:
        return (NOW + timedelta(seconds=sum(made))).astimezone(zone)

    for module in ("calls", "jobs", "client"):
        clock = SimpleNamespace(monotonic=lambda: sum(made), sleep=made.append)
        monkeypatch.setattr(f"pvg_client.{module}.time", clock)
    monkeypatch.setattr("pvg_client.calls.datetime", SimpleNamespace(now=now))
    monkeypatch.setattr("pvg_client.client.asyncio.sleep", pause)
    return made


def blocking(script: Script, **options: Any) -> Job:
    with Client("http://service.test", transport=script, **options) as client:
        return client.transfer("vid_1", reference="ref_1")


def awaited(script: Script, **options: Any) -> Job:
    async def session() -> Job:
        async with AsyncClient("http://service.test", transport=script, **options) as client:
            return await client.transfer("vid_1", reference="ref_1")

    return asyncio.run(session())


both = pytest.mark.parametrize("transfer", [blocking, awaited])
Transfer = Callable[..., Job]


@both
@pytest.mark.parametrize(
    "outcome",
    [
        problem(503),
        problem(429, "quota-exceeded"),
        problem(409, "idempotency-key-in-use"),
        httpx.Response(502, text="<html>a proxy</html>"),
        httpx.Response(503, json={"errors": [{"code": 1, "message": "a proxy"}]}),
        httpx.Response(503, json={"errors": ["a proxy"]}),
        httpx.Response(503, json={"errors": True}),
        httpx.ConnectError("refused"),
        httpx.ReadTimeout(""),
        httpx.WriteError("reset"),
        httpx.RemoteProtocolError("closed"),
    ],
)
def test_what_passes_is_asked_again_and_done_once(transfer: Transfer, outcome: Outcome, pauses: list[float]) -> None:
    script = Script(again(outcome), again(outcome), good())
    assert transfer(script).id == "job_1"
    assert len(script.requests) == 3
    assert len({request.headers["idempotency-key"] for request in script.requests}) == 1
    assert len({request.content for request in script.requests}) == 1
    assert 0.25 <= pauses[0] <= 0.5 <= pauses[1] <= 1.0


@both
def test_the_service_says_for_how_long(transfer: Transfer, pauses: list[float]) -> None:
    date = format_datetime(NOW + timedelta(seconds=30), usegmt=True)
    transfer(Script(problem(503, Retry_After="7"), problem(429, Retry_After=date), good()))
    assert pauses == [7, 23]


@both
@pytest.mark.parametrize(
    "said", ["soon", "-1", "Mon, 30 Nov 99999 10:00:00 GMT", f"Mon, {'9' * 20} Nov 2026 10:00:00 GMT"]
)
def test_what_is_no_time_is_passed_over(transfer: Transfer, said: str, pauses: list[float]) -> None:
    assert transfer(Script(problem(503, Retry_After=said), good())).id == "job_1"
    assert 0.25 <= pauses[0] <= 0.5


@both
@pytest.mark.parametrize("status", [400, 401, 403, 404, 409, 413, 422, 500, 507])
def test_what_does_not_pass_is_told_at_once(transfer: Transfer, status: int, pauses: list[float]) -> None:
    with pytest.raises(ApiError) as caught:
        transfer(Script(problem(status, "some-kind")))
    error = caught.value
    assert (error.status, error.code, error.title, error.detail) == (status, "some-kind", "T", "D")
    assert (error.type, error.request_id, error.errors) == ("/docs/problems#some-kind", "req_1", ())
    assert pauses == []


@both
def test_a_quota_that_is_used_up_for_days_is_not_waited_for(transfer: Transfer, pauses: list[float]) -> None:
    with pytest.raises(ApiError) as caught:
        transfer(Script(problem(429, "quota-exceeded", Retry_After="86400")))
    assert caught.value.retry_after_s == 86400
    assert pauses == []


@both
def test_patience_ends(transfer: Transfer, pauses: list[float]) -> None:
    with pytest.raises(UnreachableError, match=r"POST http://service.test/.*transfer: refused"):
        transfer(Script(*[httpx.ConnectError("refused")] * 4), retries=3)
    with pytest.raises(ApiError):
        transfer(Script(*[problem(503)] * 4), retries=3)
    assert len(pauses) == 6
    with pytest.raises(UnreachableError):
        transfer(Script(httpx.UnsupportedProtocol("no")))
    assert len(pauses) == 6


def test_a_wait_outlives_an_outage(pauses: list[float]) -> None:
    def running() -> httpx.Response:
        return good(state="running", done=False)

    away = httpx.ConnectError("refused")
    script = Script(running(), away, away, running(), problem(503), away, away, good())
    with Client("http://service.test", transport=script, retries=3) as client:
        assert client.wait("job_1").state == "succeeded"
    assert {request.url.params["wait"] for request in script.requests} == {"20.0"}


def wait_blocking(script: Script, timeout: float) -> Job:
    with Client("http://service.test", transport=script) as client:
        return client.wait("job_1", timeout=timeout)


def wait_awaited(script: Script, timeout: float) -> Job:
    async def session() -> Job:
        async with AsyncClient("http://service.test", transport=script) as client:
            return await client.wait("job_1", timeout=timeout)

    return asyncio.run(session())


@pytest.mark.parametrize("wait", [wait_blocking, wait_awaited])
def test_a_wait_ends_in_time_in_an_outage_too(wait: Callable[[Script, float], Job], pauses: list[float]) -> None:
    with pytest.raises(TimeoutError, match="refused"):
        wait(Script(httpx.ConnectError("refused")), 0.1)
    with pytest.raises(TimeoutError, match="503"):
        wait(Script(problem(503, Retry_After="30")), 5)
    with pytest.raises(TimeoutError):
        wait(Script(problem(503)), 0)
    assert pauses == pytest.approx([0.1, 5, 0])
    with pytest.raises(ApiError):
        wait(Script(problem(404, "not-found")), 5)
    assert len(pauses) == 3
    assert wait(Script(httpx.ConnectError("refused"), good()), 60).done


@pytest.mark.parametrize("wait", [wait_blocking, wait_awaited])
def test_a_wait_with_a_time_outlives_any_outage_within_it(
    wait: Callable[[Script, float], Job], pauses: list[float]
) -> None:
    away = [httpx.ConnectError("refused"), problem(503)] * 600  # two hours and more
    assert wait(Script(*away, good()), 36000).done
    assert max(pauses) <= 10


@pytest.mark.parametrize("wait", [wait_blocking, wait_awaited])
def test_a_silent_service_holds_a_wait_up_no_longer_than_it_may_take(
    wait: Callable[[Script, float], Job], pauses: list[float]
) -> None:
    script = Script(httpx.ReadTimeout("silent"), good())
    assert wait(script, 10).done
    (paused_s,) = pauses
    assert script.timeouts == [{12}, {10 - paused_s + 2}]
    for limit_s, timeout_s in ((0, 2), (1000, 60)):
        script = Script(good())
        assert wait(script, limit_s).done
        assert script.timeouts == [{timeout_s}]


def test_a_service_that_answers_at_once_is_not_asked_in_a_hurry(pauses: list[float]) -> None:
    script = Script(*[good(state="running", done=False) for _ in range(3)], good())
    with Client("http://service.test", transport=script) as client:
        client.wait("job_1")
    assert pauses == [0.5] * 3


def test_the_key_goes_to_the_service_alone() -> None:
    elsewhere = httpx.Response(200, content=b"file")
    script = Script(good(), elsewhere)
    with Client("http://service.test/pvg/", "pvg_key", transport=script) as client:
        client.job("job_1")
        request = client._api.request("GET", client._api.named("https://store.test/signed?x=y"))
        client._http.send(request)
    own, other = script.requests
    assert own.url.path.startswith("/pvg/")
    assert own.url.path.endswith("/jobs/job_1")
    assert own.headers["authorization"] == "Bearer pvg_key"
    assert "authorization" not in other.headers
    assert "pvg_key" not in repr(client._api)


@pytest.mark.parametrize("path", ["", "/", "/v1", "/v1/", "/pvg/v1"])
def test_an_address_may_end_in_that_of_the_interface(path: str) -> None:
    script = Script(good())
    with Client(f"http://service.test{path}", transport=script) as client:
        client.job("job_1")
    assert script.requests[0].url.path == f"{'/pvg' if 'pvg' in path else ''}/v1/jobs/job_1"


def test_looks_may_be_references_alone_and_one_of_them_needs_no_list() -> None:
    reference, look = Medium.of(MEDIUM | {"id": "ref_1"}), Look("ref_2", strength=0.5)
    given: list[Any] = [[reference, "ref_3", look], reference, "ref_3", look]
    script = Script(*[good() for _ in given])
    with Client("http://service.test", transport=script) as client:
        for looks in given:
            client.transfer("vid_1", looks)
        with pytest.raises(ValueError, match="looks, or one reference"):
            client.transfer("vid_1", look, reference="ref_1")
    bodies = [{"reference": "ref_1"}, {"reference": "ref_3"}, {"reference": "ref_2", "strength": 0.5}]
    asked = [json.loads(request.content)["looks"] for request in script.requests]
    assert asked == [bodies, *([body] for body in bodies)]


@pytest.mark.parametrize(
    ("listed", "query"),
    [
        (lambda client: client.jobs(ids="job_1", state="queued", kind="swap"), "id=job_1&state=queued&kind=swap"),
        (lambda client: client.jobs(ids=["job_1", "job_2"], state=["queued"]), "id=job_1%2Cjob_2&state=queued"),
        (lambda client: client.videos(state="ready"), "state=ready"),
        (lambda client: client.references(state="ready"), "state=ready"),
        (lambda client: client.webhooks(state="failed"), "state=failed"),
    ],
)
def test_one_value_to_list_by_needs_no_list(listed: Callable[[Client], Iterator[Any]], query: str) -> None:
    script = Script(httpx.Response(200, json={"data": [], "next_cursor": None}))
    with Client(transport=script) as client:
        assert list(listed(client)) == []
    assert script.requests[0].url.query.decode() == query


def test_members_of_later_versions_are_passed_over() -> None:
    with Client("http://service.test", transport=Script(good())) as client:
        job = client.job("job_1")
    assert job.raw["brand_new"] == {"of a later": "version"}
    assert job.results == ()


def test_a_preview_is_asked_for_as_it_is_wanted() -> None:
    shown = {"Content-Type": "image/png"}
    script = Script(*[httpx.Response(200, content=b"picture", headers=shown) for _ in range(2)])
    with Client(transport=script) as client:
        look = Look("ref_1", strength=0.5)
        assert client.preview("vid_1", look, frame=0, crop=(0, 0, 64, 64), format="png", before=True) == b"picture"
        assert client.preview("vid_1", "ref_1", time_s=1.5, max_width=320) == b"picture"
    full, short = (json.loads(request.content) for request in script.requests)
    assert full == {
        "video": "vid_1",
        "look": {"reference": "ref_1", "strength": 0.5},
        "frame": 0,
        "crop": [0, 0, 64, 64],
        "format": "png",
        "before": True,
    }
    assert short == {"video": "vid_1", "look": {"reference": "ref_1"}, "time_s": 1.5, "max_width": 320}


def test_a_limit_that_was_gone_over_is_named() -> None:
    body = {"type": "/docs/problems#too-large", "code": "too-large", "title": "T", "limit": 1000, "unit": "bytes"}
    with Client(transport=Script(httpx.Response(413, json=body))) as client, pytest.raises(ApiError) as caught:
        client.job("job_1")
    assert (caught.value.problem.limit, caught.value.problem.unit) == (1000, "bytes")


def test_an_error_of_somebody_else_has_no_code() -> None:
    with Client(transport=Script(httpx.Response(404, text="<html>"))) as client, pytest.raises(ApiError) as caught:
        client.job("job_1")
    assert (caught.value.status, caught.value.code, caught.value.title) == (404, "", "Not Found")


def test_of_an_error_of_somebody_else_what_is_known_is_told() -> None:
    errors = [{"detail": 1}, {"detail": "D", "pointer": ["/a"], "code": 1}, {"detail": "E", "pointer": "/b"}, None]
    body = {"code": 7, "title": {"en": "T"}, "type": None, "detail": ["D"], "status": "404", "request_id": 5}
    body |= {"limit": "9", "errors": errors}
    with Client(transport=Script(httpx.Response(404, json=body))) as client, pytest.raises(ApiError) as caught:
        client.job("job_1")
    assert caught.value.errors == (FieldError("D"), FieldError("E", "/b"))
    assert caught.value.problem == Problem("", "Not Found", status=404, errors=caught.value.errors)


def test_a_deletion_whose_answer_was_lost_is_done(pauses: list[float]) -> None:
    script = Script(httpx.ReadError("lost"), problem(503), problem(404, "not-found"))
    with Client(transport=script) as client:
        client.delete("vid_1", cancel_jobs=True)
    assert {request.url.params["cancel_jobs"] for request in script.requests} == {"true"}
    for answer in (
        httpx.Response(502),
        httpx.Response(504),
        problem(504, "timeout"),
        httpx.Response(503, text="<html>"),
    ):
        with Client(transport=Script(answer, problem(503), problem(404, "not-found"))) as client:
            client.delete("vid_1")


def test_what_was_not_there_to_delete_is_told(pauses: list[float]) -> None:
    nobody = httpx.Response(404, text="<html>")
    for answers in ([problem(503), problem(404, "not-found")], [httpx.Response(502), nobody]):
        with Client(transport=Script(*answers)) as client, pytest.raises(ApiError) as caught:
            client.delete("vid_1")
        assert caught.value.status == 404


def test_an_answer_of_somebody_else_is_told() -> None:
    for answer in (httpx.Response(200, text="<html>log in</html>"), httpx.Response(200, json=[1])):
        with Client(transport=Script(answer)) as client, pytest.raises(UnreachableError, match="not as this service"):
            client.job("job_1")


def test_a_name_that_is_no_text_is_sent_all_the_same(tmp_path: Path) -> None:
    path = tmp_path / os.fsdecode(b"clip \xff.mp4")
    path.write_bytes(b"clip")
    script = Script(httpx.Response(202, json=MEDIUM))
    with Client(transport=script) as client:
        client.upload(path)
    assert script.requests[0].headers["content-disposition"] == "attachment; filename*=UTF-8''clip%20%3F.mp4"
