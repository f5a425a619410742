from __future__ import annotations

import math
import sqlite3
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from datetime import timedelta
from functools import partial
from typing import Any

import httpx
import pytest
from sqlalchemy import select
from sqlalchemy.exc import OperationalError

from service.api.idempotency import Once
from service.catalog import Job, idempotency, jobs, leases, sweep, utc_now
from service.catalog.idempotency import Claim
from service.catalog.models import IdempotentRequest
from service.settings import Settings
from tests.promises import Drill
from tests.service.api.test_media import PROBLEM, upload
from tests.service.fixtures import MP4, PNG, Api, claim, make_ready, make_results, serve
from tests.service.servers import fresh_database
from tests.side_by_side import at_once
from tests.waiting import until


@pytest.fixture(params=["sqlite", "postgresql"])
def either(request: pytest.FixtureRequest, settings: Settings) -> Iterator[Api]:
    """A running API on each database."""
    if request.param == "sqlite":
        yield from serve(settings)
        return
    with fresh_database(request.getfixturevalue("postgres_url")) as url:
        yield from serve(settings.model_copy(update={"database_url": url}))


def wanted(api: Api, **more: object) -> dict[str, Any]:
    video = upload(api, "/videos")["id"]
    return {"video": video, "looks": [{"reference": video}], **more}


def post(api: Api, path: str, key: str, **options: Any) -> httpx.Response:
    return api.client.post(path, headers={"Idempotency-Key": key}, **options)


def requests(api: Api) -> list[IdempotentRequest]:
    """Those whose key is remembered, under way or answered."""
    with api.services.database.read() as session:
        return list(session.scalars(select(IdempotentRequest)))


def kinds(api: Api) -> Counter[str]:
    with api.services.database.read() as session:
        return Counter(session.scalars(select(Job.kind)))


@pytest.mark.parametrize("force", [True, False])
def test_fifty_requests_of_one_idempotency_key_at_once_are_one_job(
    either: Api, promise: Callable[..., Drill], force: bool
) -> None:
    drill = promise("R17", wanted="one job")
    body = wanted(either, force=force)
    answers = at_once([partial(post, either, "/transfer", "order-42", json=body)] * 50)
    assert {answer.status_code for answer in answers} <= {202, 409}
    assert len({answer.json()["id"] for answer in answers if answer.status_code == 202}) == 1
    assert kinds(either)["transfer"] == 1
    drill.measured = f"1 job, {sum(answer.status_code == 202 for answer in answers)} of 50 told of it, the others 409"
    again = post(either, "/transfer", "order-42", json=body)
    assert again.headers["idempotent-replayed"] == "true"
    firsts = [one for one in answers if one.status_code == 202 and "idempotent-replayed" not in one.headers]
    assert len(firsts) == 1
    assert again.json() == firsts[0].json()
    assert again.headers["location"] == firsts[0].headers["location"]


def test_the_same_transfer_asked_for_at_once_without_a_key_is_one_job(either: Api) -> None:
    body = wanted(either)
    answers = at_once([partial(either.client.post, "/transfer", json=body)] * 20)
    assert Counter(answer.status_code for answer in answers) == {202: 1, 200: 19}
    assert kinds(either)["transfer"] == 1


def test_the_same_upload_at_once_is_one_medium(either: Api) -> None:
    answers = at_once([partial(post, either, "/videos", "clip", content=MP4)] * 10)
    assert {answer.status_code for answer in answers} <= {202, 409}
    assert kinds(either) == {"vectorize": 1}
    assert len(either.blobs) == 1


def test_another_body_or_call_under_the_same_key_is_refused(api: Api) -> None:
    body = wanted(api)
    first = post(api, "/transfer", '"quoted"', json=body)
    assert post(api, "/transfer", "quoted", json={**body, "force": False}).json() == first.json()  # a default, said
    for path, other in (("/transfer", {**body, "force": True}), ("/swap", {"a": body["video"], "faces": [0, 1]})):
        refused = post(api, path, "quoted", json=other)
        assert (refused.status_code, refused.json()["code"]) == (422, "idempotency-key-reused")
    assert post(api, "/videos", "quoted", content=MP4).status_code == 422
    assert post(api, "/transfer", "a b", json=body).status_code == 400
    assert kinds(api)["transfer"] == 1


def test_uploads_and_forms_are_compared_by_what_they_hold(api: Api) -> None:
    first = post(api, "/videos", "raw", content=MP4)
    again = post(api, "/videos", "raw", content=MP4)
    assert (first.status_code, again.status_code, again.json()) == (202, 202, first.json())
    assert post(api, "/videos", "raw", content=MP4 + b"2").status_code == 422
    assert post(api, "/videos?mask=ycbcr", "raw", content=MP4).status_code == 422

    def form(content: bytes, strength: str = "1") -> httpx.Response:  # with a boundary of its own each time
        data = {"video": first.json()["id"], "strength": strength, "metadata": ["a:1", "b:2"]}
        return post(api, "/transfer", "form", data=data, files=[("reference", ("a.png", content))])

    made = form(PNG)
    assert (made.status_code, made.json()["metadata"]) == (202, {"a": "1", "b": "2"})
    assert form(PNG).json() == made.json()
    assert form(PNG + b"2").status_code == form(PNG, "0.5").status_code == 422
    assert len(api.client.get("/references").json()["data"]) == 1
    assert api.drafts == []


def test_of_a_form_the_order_of_its_references_alone_matters(api: Api) -> None:
    video = upload(api, "/videos")["id"]
    one, other = ("reference", ("a.png", PNG + b"a")), ("reference", ("b.png", PNG + b"b"))
    which, strength = ("video", (None, video)), ("strength", (None, "0.5"))
    first = post(api, "/transfer", "k", files=[which, strength, one, other])
    assert first.status_code == 202
    for same in ([one, strength, other, which], [strength, which, one, other, ("light", (None, "0"))]):
        again = post(api, "/transfer", "k", files=same)
        assert (again.status_code, again.headers.get("idempotent-replayed")) == (202, "true")
        assert again.json() == first.json()
    turned = post(api, "/transfer", "k", files=[which, strength, other, one])
    assert (turned.status_code, turned.json()["code"]) == (422, "idempotency-key-reused")
    renamed = post(api, "/transfer", "k", files=[which, strength, one, ("reference", ("c.png", PNG + b"b"))])
    assert (renamed.status_code, renamed.json()["code"]) == (422, "idempotency-key-reused")


def test_a_key_is_in_use_while_its_first_request_still_arrives(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    go_on, begun_at = threading.Event(), api.services.database.now()
    monkeypatch.setattr(api.services.database, "now", lambda: begun_at)  # it is heard of now, however slow all is

    def slowly() -> Iterator[bytes]:
        yield MP4
        go_on.wait(60)
        yield b"end"

    with ThreadPoolExecutor(1) as pool:
        first = pool.submit(post, api, "/videos", "slow", content=slowly())
        until(lambda: bool(requests(api)))  # the server has the beginning
        second = post(api, "/videos", "slow", content=MP4 + b"end")
        assert second.status_code == 409
        assert second.json()["code"] == "idempotency-key-in-use"
        assert second.headers["retry-after"] == "1"
        go_on.set()
        assert first.result().status_code == 202
    assert post(api, "/videos", "slow", content=MP4 + b"end").json() == first.result().json()


def test_a_refused_request_leaves_its_key_free(api: Api) -> None:
    body = wanted(api)
    assert post(api, "/transfer", "k", json={**body, "looks": []}).status_code == 422
    assert post(api, "/transfer", "k", json={**body, "video": f"vid_{'0' * 32}"}).status_code == 404
    assert post(api, "/videos", "k", content=b"no video").status_code == 415
    assert post(api, "/transfer", "k", json=body).status_code == 202


def test_a_cancellation_is_replayed(api: Api) -> None:
    job = api.client.post("/transfer", json=wanted(api)).json()
    first, again = (post(api, f"/jobs/{job['id']}/cancel", "stop") for _ in range(2))
    assert (first.status_code, again.status_code, again.headers["idempotent-replayed"]) == (202, 202, "true")
    assert [one.headers.get("location") for one in (first, again)] == [None, None]
    assert api.client.post(f"/jobs/{job['id']}/cancel").status_code == 200


def test_a_claim_whose_commit_was_not_answered_is_not_left_behind(api: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    body, begin = wanted(api), Once._begin
    refused: list[object] = []

    def lost(once: Once, claim: Claim) -> object:
        begun = begin(once, claim)
        refused.append(begun)
        raise OperationalError("COMMIT", None, sqlite3.OperationalError("disk I/O error"))

    with monkeypatch.context() as broken:
        broken.setattr(Once, "_begin", lost)
        assert post(api, "/transfer", "order-1", json=body).status_code >= 500
    assert refused == [None]  # it was claimed
    assert post(api, "/transfer", "order-1", json=body).status_code == 202


def test_a_claim_may_be_made_again_by_the_same_request(either: Api) -> None:
    database, claim = either.services.database, Claim("", "order-1", "0" * 32)
    other = Claim("", "order-1", "1" * 32)

    def begin(one: Claim) -> None:
        with database.write() as session:
            assert idempotency.begin(session, one, now=database.now(), lock_s=30, ttl_s=100) is None

    begin(claim)
    begin(claim)
    with pytest.raises(idempotency.InUseError):
        begin(other)


def test_who_asks_as_told_while_the_key_of_a_killed_process_is_locked_asks_a_few_times(
    api: Api, monkeypatch: pytest.MonkeyPatch
) -> None:
    database, killed_at = api.services.database, api.services.database.now()
    with database.write() as session:
        idempotency.begin(session, Claim("", "lost", "0" * 32), now=killed_at, lock_s=30, ttl_s=100)
    asked_at, asked = killed_at + timedelta(seconds=0.5), []
    while asked_at < killed_at + timedelta(seconds=30):
        with database.write() as session, pytest.raises(idempotency.InUseError) as in_use:
            idempotency.begin(session, Claim("", "lost", "1" * 32), now=asked_at, lock_s=30, ttl_s=100)
        asked.append(max(1, math.ceil(in_use.value.ask_in_s)))
        asked_at += timedelta(seconds=asked[-1])
    assert asked == [1, 2, 4, 8, 15]
    body, now = wanted(api), database.now()
    with database.write() as session:
        (row,) = session.scalars(select(IdempotentRequest))
        row.locked_until = now + timedelta(seconds=10.9)
    monkeypatch.setattr(database, "now", lambda: now)
    refused = post(api, "/transfer", "lost", json=body)
    assert (refused.status_code, refused.headers["retry-after"]) == (409, "11")


def test_a_claim_ends_with_its_lock_and_an_answer_with_its_time(api: Api) -> None:
    database = api.services.database
    now = database.now()
    with database.write() as session:  # of a process that was killed
        idempotency.begin(session, Claim("", "lost", "0" * 32), now=now - timedelta(seconds=31), lock_s=30, ttl_s=100)
    body = wanted(api)
    first = post(api, "/transfer", "lost", json=body)
    assert first.status_code == 202
    with database.write() as session:
        assert idempotency.expire(session, now=now + timedelta(seconds=86_000), limit=10) == 0
        assert idempotency.expire(session, now=now + timedelta(seconds=86_500), limit=10) == 1
    assert "idempotent-replayed" not in post(api, "/transfer", "lost", json=body).headers


def test_a_deleted_medium_takes_the_answers_about_it_along(api: Api) -> None:
    video = post(api, "/videos", "k", content=MP4).json()
    assert api.client.delete(f"/videos/{video['id']}", params={"cancel_jobs": True}).status_code == 204
    assert requests(api) == []
    assert post(api, "/videos", "k", content=MP4).json()["id"] != video["id"]


@pytest.mark.parametrize("end", ["deleted", "expired"])
def test_a_request_for_media_that_are_gone_is_not_answered_as_before(api: Api, end: str) -> None:
    reference = upload(api, "/references", PNG)["id"]
    body = wanted(api)
    body["looks"] = [{"reference": reference}]
    for media_id in (body["video"], reference):
        make_ready(api.services, media_id)
    job = post(api, "/transfer", "transfer", json=body).json()["id"]
    (result,) = make_results(api.services, job, [b"made"])
    assert post(api, f"/results/{result}/link", "link").status_code == 200
    assert post(api, "/transfer", "transfer", json=body).headers["idempotent-replayed"] == "true"
    if end == "deleted":
        assert api.client.delete(f"/references/{reference}").status_code == 204
    else:
        with api.services.background.write() as session:
            assert sweep.expire_medium(session, reference, now=utc_now() + timedelta(days=365))
    assert requests(api) == []
    assert post(api, "/transfer", "transfer", json=body).status_code == 404
    assert post(api, f"/results/{result}/link", "link").status_code == 404


def test_the_same_transfer_points_at_the_same_job_while_its_results_live(api: Api) -> None:
    body = wanted(api)
    make_ready(api.services, body["video"])

    def ask(status: int, **more: object) -> str:
        answer = api.client.post("/transfer", json={**body, **more})
        assert answer.status_code == status
        assert answer.headers["location"] == f"/v1/jobs/{answer.json()['id']}"
        return str(answer.json()["id"])

    first = ask(202)
    assert ask(200) == ask(200, output={}) == first
    others = [ask(202, force=True), ask(202, metadata={"order": "1"}), ask(202, output={"crf": 20})]
    assert len({first, *others}) == 4
    for job_id in (first, others[0]):
        (result,) = make_results(api.services, job_id, [b"made"])
    assert ask(200) == others[0]  # the newest
    look = api.client.get(f"/jobs/{others[0]}").json()["looks"][0]
    assert (look["result"], look["size_bytes"], look["content_type"]) == (result, 4, "video/mp4")
    assert len(look["sha256"]) == 64
    with api.services.background.write() as session:
        session.get_one(Job, first).state = "failed"  # and so is no answer either
        api.services.database.now()
        look_row = jobs.looks(session, others[0])[0]
        look_row.result_id = None  # as the sweep leaves it
    fresh = ask(202)
    lease = claim(api.services.database, fresh)
    with api.services.background.write() as session:
        assert leases.fail(session, lease, PROBLEM, now=api.services.database.now(), timings={})
    assert ask(202) != fresh


def test_a_default_that_is_said_and_another_order_ask_for_the_same(api: Api) -> None:
    video = upload(api, "/videos")["id"]
    make_ready(api.services, video, faces=2)
    picture = api.client.post("/videos", content=PNG).json()["id"]

    def body(of: str, output: dict[str, Any], **look: object) -> dict[str, Any]:
        return {"video": of, "looks": [{"reference": video, **look}], "output": output}

    same = [
        body(video, {}),
        body(video, {"container": "mp4", "codec": "auto", "audio": "copy"}),
        body(video, {"container": None}, protect=["teeth", "eyes", "teeth"]),
    ]
    first = post(api, "/transfer", "same", json=same[0])
    assert [post(api, "/transfer", "same", json=one).json() for one in same] == [first.json()] * 3
    assert [api.client.post("/transfer", json=one).json()["id"] for one in same] == [first.json()["id"]] * 3
    swap = {"a": video, "faces": [0, 1]}
    assert (
        post(api, "/swap", "swap", json=swap).json()
        == post(api, "/swap", "swap", json={**swap, "output": {"container": "mp4"}}).json()
    )

    def job(sent: dict[str, Any], path: str = "/transfer") -> str:
        answer = api.client.post(path, json=sent)
        assert answer.status_code in {200, 202}, answer.text
        return str(answer.json()["id"])

    assert (
        job(body(picture, {})) == job(body(picture, {"container": "png"})) != job(body(picture, {"container": "jpg"}))
    )
    extras = [job(body(video, {"extras": order})) for order in (["cube", "matte"], ["matte", "cube"])]
    faces = [job(body(video, {}, faces=order)) for order in ([0, 1], [1, 0])]
    others = [job(body(video, {"container": "mov"})), job(body(video, {}, protect=["eyes"])), job(swap, "/swap")]
    assert (len({*extras}), len({*faces})) == (1, 1)
    assert len({first.json()["id"], *extras, *faces, *others}) == 6
    assert job(swap, "/swap") != job({**swap, "faces": [1, 0]}, "/swap")
    assert api.client.post("/transfer", json=body(video, {"container": "png"})).status_code == 422
