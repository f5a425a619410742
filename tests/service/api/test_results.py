from __future__ import annotations

import base64
import hashlib
import os
from datetime import datetime, timedelta
from typing import Any

import pytest
from sqlalchemy import delete, select, update

from service.api.downloads import disposition
from service.api.uploads import declared_name
from service.catalog import Media, Output, PartName, PartOf, Result, jobs, results, sweep
from tests.service.api.test_authentication import holder
from tests.service.api.test_media import transfer, upload
from tests.service.fixtures import MP4, Api, claim, make_ready, make_results, serve
from tests.waiting import until

CONTENT = os.urandom(1_000_000)


@pytest.fixture
def path(api: Api) -> str:
    video = upload(api, "/videos")
    make_ready(api.services, video["id"])
    (result_id,) = make_results(api.services, transfer(api, video["id"], video["id"])["id"], [CONTENT])
    return f"/results/{result_id}"


def test_the_whole_file_carries_its_hash(api: Api, path: str) -> None:
    answer = api.client.get(path)
    digest = hashlib.sha256(CONTENT)
    assert answer.status_code == 200
    assert answer.content == CONTENT
    assert answer.headers["etag"] == f'"{digest.hexdigest()}"'
    assert answer.headers["repr-digest"] == f"sha-256=:{base64.b64encode(digest.digest()).decode()}:"
    assert answer.headers["content-type"] == "video/mp4"
    assert answer.headers["content-length"] == str(len(CONTENT))
    assert answer.headers["accept-ranges"] == "bytes"
    assert "clip" in answer.headers["content-disposition"]


def test_ranges_are_parts_of_the_file(api: Api, path: str) -> None:
    for header, start, end in (
        ("bytes=0-0", 0, 1),
        ("bytes=1000-499999", 1000, 500_000),
        ("bytes=999999-", 999_999, 1_000_000),
        ("bytes=-10", 999_990, 1_000_000),
    ):
        answer = api.client.get(path, headers={"range": header})
        assert answer.status_code == 206
        assert answer.content == CONTENT[start:end]
        assert answer.headers["content-range"] == f"bytes {start}-{end - 1}/1000000"
    outside = api.client.get(path, headers={"range": "bytes=1000000-"})
    assert outside.status_code == 416
    assert outside.headers["content-range"] == "bytes */1000000"
    assert outside.json()["code"] == "range-not-satisfiable"


def test_a_download_goes_on_only_with_the_same_file(api: Api, path: str) -> None:
    etag = api.client.get(path).headers["etag"]
    same = api.client.get(path, headers={"range": "bytes=5-9", "if-range": etag})
    other = api.client.get(path, headers={"range": "bytes=5-9", "if-range": '"other"'})
    assert (same.status_code, other.status_code) == (206, 200)


def test_a_known_file_is_not_sent_again(api: Api, path: str) -> None:
    etag = api.client.get(path).headers["etag"]
    answer = api.client.get(path, headers={"if-none-match": etag})
    assert (answer.status_code, answer.content) == (304, b"")
    assert answer.headers["etag"] == etag


def test_a_file_or_a_part_of_it_is_sent_only_as_what_it_was(api: Api, path: str) -> None:
    etag = api.client.get(path).headers["etag"]
    for more, status in (({}, 200), ({"range": "bytes=5-9"}, 206), ({"if-none-match": etag}, 304)):
        assert api.client.get(path, headers=more | {"if-match": etag}).status_code == status
        refused = api.client.get(path, headers=more | {"if-match": '"other"'})
        assert (refused.status_code, refused.json()["code"]) == (412, "precondition-failed")
        assert api.client.head(path, headers=more | {"if-match": '"other"'}).status_code == 412


def test_all_lines_of_a_condition_and_of_a_range_count(api: Api, path: str) -> None:
    """A list may come in several lines (RFC 9110, 5.3), as of a proxy that adds its own."""
    etag = api.client.get(path).headers["etag"]

    def status_of(name: str, *lines: str) -> int:
        return api.client.get(path, headers=[(name, line) for line in lines]).status_code

    assert status_of("if-none-match", '"other"', etag) == 304
    assert status_of("if-match", '"other"', etag) == 200
    assert status_of("if-match", '"other"', '"another"') == 412
    assert status_of("range", "bytes=0-1", "bytes=2-3") == 200


def test_a_result_is_deleted_only_as_what_it_was(api: Api, path: str) -> None:
    etag = api.client.get(path).headers["etag"]
    assert api.client.delete(path, headers={"if-match": f"W/{etag}"}).status_code == 412
    assert api.client.get(path).status_code == 200
    assert api.client.delete(path, headers={"if-match": f'"other", {etag}'}).status_code == 204
    assert api.client.delete(path, headers={"if-match": "*"}).status_code == 404


def test_head_has_the_headers_only(api: Api, path: str) -> None:
    answer = api.client.head(path)
    assert (answer.status_code, answer.content) == (200, b"")
    assert answer.headers["content-length"] == "1000000"


@pytest.mark.parametrize("wanted", ["bytes=0-9", "bytes=2000000-"])
def test_of_a_head_a_range_means_nothing(api: Api, path: str, wanted: str) -> None:
    """RFC 9110, 14.2."""
    answer = api.client.head(path, headers={"range": wanted})
    assert (answer.status_code, answer.headers["content-length"]) == (200, "1000000")
    assert "content-range" not in answer.headers


def test_unknown_results_are_not_found_and_expired_ones_are_gone(api: Api, path: str) -> None:
    assert api.client.get(f"/results/res_{'0' * 32}").status_code == 404
    with api.services.background.write() as session:
        result = results.get(session, path.removeprefix("/results/"))
        assert result is not None
        key = results.drop_bytes(session, result, now=api.services.database.now())
    assert key is not None
    api.services.storage.delete(key)
    answer = api.client.get(path)
    assert (answer.status_code, answer.json()["code"]) == (410, "gone")


def test_a_file_whose_bytes_are_lost_is_gone_for_head_as_for_get(api: Api, path: str) -> None:
    for key in api.blobs:
        api.services.storage.delete(key)
    video = api.client.get("/videos").json()["data"][0]["id"]
    for lost in (path, f"/videos/{video}/file"):
        assert (api.client.get(lost).status_code, api.client.head(lost).status_code) == (410, 410)


def test_a_look_says_why_its_result_is_gone(api: Api) -> None:
    services, now = api.services, api.services.background.now()
    made = []
    for tail in (b"kept", b"late", b"deleted", b"of late media"):
        video = upload(api, "/videos", tail)["id"]
        make_ready(services, video)
        job = transfer(api, video, video)
        assert job["looks"][0]["result_gone"] is None
        made.append((video, job["id"], *make_results(services, job["id"], [tail])))
    with services.background.write() as session:
        session.get_one(Result, made[1][2]).expires_at = now - timedelta(seconds=1)
        assert len(sweep.expire_results(session, now=now)) == 1
        session.get_one(Media, made[3][0]).expires_at = now - timedelta(seconds=1)
        assert sweep.expire_medium(session, made[3][0], now=now)
    assert api.client.delete(f"/videos/{made[2][0]}").status_code == 204
    assert api.client.delete(f"/videos/{made[1][0]}").status_code == 204  # what had expired has expired
    looks = [api.client.get(f"/jobs/{job_id}").json()["looks"][0] for _, job_id, _ in made]
    assert [look["result_gone"] for look in looks] == [None, "expired", "deleted", "expired"]
    assert [look["result"] for look in looks] == [made[0][2], None, None, None]


def test_a_result_that_is_gone_is_made_again_without_its_key(api: Api) -> None:
    video = upload(api, "/videos")["id"]
    make_ready(api.services, video)
    body, key = {"video": video, "looks": [{"reference": video}]}, {"Idempotency-Key": "order-42"}
    job = api.client.post("/transfer", json=body, headers=key).json()["id"]
    (result,) = make_results(api.services, job, [b"made"])
    with api.services.background.write() as session:
        session.get_one(Result, result).expires_at = api.services.background.now() - timedelta(seconds=1)
    gone = api.client.get(f"/results/{result}")
    assert gone.status_code == 410
    assert gone.json()["detail"].endswith("without its Idempotency-Key or with a new one")
    assert api.client.delete(f"/results/{result}").status_code == 204
    assert api.client.post("/transfer", json=body, headers=key).json()["id"] == job
    assert api.client.post("/transfer", json=body, headers={"Idempotency-Key": "order-43"}).json()["id"] != job


def test_a_result_is_deleted_alone(api: Api, job: dict[str, Any]) -> None:
    one, two = (look["result"] for look in job["looks"])
    key = {"Idempotency-Key": "link"}
    link = api.client.post(f"/results/{one}/link", headers=key).json()["url"]
    blobs = len(api.blobs)
    assert api.client.delete(f"/results/{one}").status_code == 204
    assert blobs - len(api.blobs) == 1 + len(PARTS)
    for path in (f"/results/{one}", f"/results/{one}/matte", link):
        assert api.client.get(path).status_code == 404
    assert api.client.delete(f"/results/{one}").status_code == 404
    assert api.client.post(f"/results/{one}/link", headers=key).status_code == 404
    looks = api.client.get(f"/jobs/{job['id']}").json()["looks"]
    assert [(look["result"], look["result_gone"]) for look in looks] == [(None, "deleted"), (two, None)]
    assert looks[0]["extras"] == []
    assert api.client.get(f"/results/{two}/matte").content == MATTE
    # one that was asked for again is made again
    again = transfer(api, looks[0]["video"], looks[0]["reference"], looks[0]["reference"])
    assert again["id"] != job["id"]
    # a link is for reading, and another key's results are not there
    link = api.client.post(f"/results/{two}/link").json()["url"]
    assert holder(api).delete(f"/results/{two}").status_code == 404
    assert api.client.delete(link).status_code == 401


CUBE, SECOND, MATTE = b"LUT_3D_SIZE 2\n" * 100, b"LUT_3D_SIZE 3\n", os.urandom(5000)
PARTS: list[tuple[PartName, int, bytes]] = [("look.cube", 1, CUBE), ("look.cube", 2, SECOND), ("matte", 1, MATTE)]


@pytest.fixture
def job(api: Api) -> dict[str, Any]:
    """Two looks, each with a cube of two persons and a matte of one."""
    video = upload(api, "/videos")
    make_ready(api.services, video["id"])
    asked = transfer(api, video["id"], video["id"], video["id"])
    assert [look["extras"] for look in asked["looks"]] == [[], []]
    make_results(api.services, asked["id"], [b"one", b"two"], parts=PARTS)
    body: dict[str, Any] = api.client.get(f"/jobs/{asked['id']}").json()
    return body


def test_a_look_lists_what_was_made_beside_it(api: Api, job: dict[str, Any]) -> None:
    assert len(job["looks"]) == 2
    for look, content in zip(job["looks"], (b"one", b"two"), strict=True):
        assert api.client.get(look["url"]).content == content
        expected = [
            ("look.cube", 1, f"{look['url']}/look.cube", CUBE, "text/plain"),
            ("look.cube", 2, f"{look['url']}/look.cube?person=2", SECOND, "text/plain"),
            ("matte", 1, f"{look['url']}/matte", MATTE, "video/x-matroska"),
        ]
        names = ("part", "person", "url", "sha256", "size_bytes", "content_type")
        assert [tuple(extra[name] for name in names) for extra in look["extras"]] == [
            (part, person, url, hashlib.sha256(data).hexdigest(), len(data), kind)
            for part, person, url, data, kind in expected
        ]
        for extra, (_, _, _, data, _) in zip(look["extras"], expected, strict=True):
            assert api.client.get(extra["url"]).content == data


def test_a_part_answers_as_its_result_does(api: Api, job: dict[str, Any]) -> None:
    url, etag = f"{job['looks'][0]['url']}/look.cube", f'"{hashlib.sha256(CUBE).hexdigest()}"'
    whole = api.client.get(url)
    assert (whole.status_code, whole.content) == (200, CUBE)
    assert whole.headers["etag"] == etag
    assert whole.headers["repr-digest"] == f"sha-256=:{base64.b64encode(hashlib.sha256(CUBE).digest()).decode()}:"
    assert whole.headers["content-type"] == "text/plain"
    assert whole.headers["content-disposition"].endswith("clip-look-1.cube")
    head = api.client.head(url)
    assert (head.status_code, head.content, head.headers["content-length"]) == (200, b"", str(len(CUBE)))
    part = api.client.get(url, headers={"range": "bytes=10-19", "if-range": etag})
    assert (part.status_code, part.content) == (206, CUBE[10:20])
    assert api.client.get(url, headers={"range": "bytes=999999-"}).status_code == 416
    assert api.client.get(url, headers={"if-none-match": etag}).status_code == 304
    matte = api.client.get(f"{job['looks'][0]['url']}/matte")
    assert (matte.content, matte.headers["content-type"]) == (MATTE, "video/x-matroska")


def test_a_person_that_is_not_there_is_answered_with_those_that_are(api: Api, job: dict[str, Any]) -> None:
    url = job["looks"][0]["url"]
    assert api.client.get(f"{url}/look.cube?person=2").content == SECOND
    answer = api.client.get(f"{url}/look.cube?person=3")
    assert (answer.status_code, answer.json()["code"]) == (404, "not-found")
    assert answer.json()["detail"].endswith("has no look.cube of person 3; it has those of: 1, 2")
    assert api.client.get(f"{url}/matte?person=2").status_code == 404
    assert api.client.get(f"{url}/matte?person=0").status_code == 422


def test_a_part_that_was_not_asked_for_says_how_to_ask(api: Api, path: str) -> None:
    for part, extra in (("look.cube", "cube"), ("matte", "matte")):
        answer = api.client.get(f"{path}/{part}")
        assert (answer.status_code, answer.headers["content-type"]) == (404, "application/problem+json")
        assert f'"output": {{"extras": ["{extra}"]}}' in answer.json()["detail"]
        assert api.client.get(f"/results/res_{'0' * 32}/{part}").status_code == 404


def test_a_part_is_no_result_of_its_own(api: Api, job: dict[str, Any]) -> None:
    with api.services.database.read() as session:
        rows = session.query(Result).filter(Result.part_of.is_not(None)).all()
    assert len(rows) == 6
    for row in rows:
        assert api.client.get(f"/results/{row.id}").status_code == 404
        assert row.part_of in {look["result"] for look in job["looks"]}


def test_a_transfer_that_finds_its_result_keeps_it_with_its_parts_for_a_full_retention(
    api: Api, job: dict[str, Any]
) -> None:
    video, now = job["looks"][0]["video"], api.services.database.now()
    again = api.client.post("/transfer", json={"video": video, "looks": [{"reference": video}] * 2})
    assert (again.status_code, again.json()["id"]) == (200, job["id"])
    shown = [file for look in again.json()["looks"] for file in (look, *look["extras"])]
    assert len(shown) == 8
    full = now + timedelta(seconds=api.services.settings.result_ttl_s)
    assert all(datetime.fromisoformat(file["expires_at"]) >= full for file in shown)


def test_no_use_shortens_what_is_kept_where_the_times_of_retention_are_shorter_now(
    api: Api, job: dict[str, Any]
) -> None:
    video = job["looks"][0]["video"]

    def kept_until() -> list[datetime]:
        with api.services.database.read() as session:
            of_media = session.get_one(Media, video).expires_at
            of_results = session.scalars(
                select(Result.expires_at).where(Result.job_id == job["id"]).order_by(Result.id)
            )
            return [of_media, *of_results]

    promised = kept_until()
    less = {"media_ttl_s": 60.0, "result_ttl_s": 60.0}
    for other in serve(api.services.settings.model_copy(update=less)):
        again = other.client.post("/transfer", json={"video": video, "looks": [{"reference": video}] * 2})
        assert (again.status_code, again.json()["id"]) == (200, job["id"])
        assert other.client.post("/videos", content=MP4).json()["id"] == video
    assert all(timedelta() <= new - old < timedelta(seconds=1) for new, old in zip(kept_until(), promised, strict=True))


def test_a_result_is_said_to_be_kept_no_longer_than_its_video(api: Api, job: dict[str, Any]) -> None:
    look = job["looks"][0]
    until = api.services.database.now().replace(microsecond=0) + timedelta(seconds=100)
    with api.services.background.write() as session:
        session.get_one(Media, look["video"]).expires_at = until
    shown = api.client.get(f"/jobs/{job['id']}").json()["looks"][0]
    links = [
        api.client.post(f"/results/{look['result']}/link", json=wanted).json() for wanted in ({}, {"part": "matte"})
    ]
    assert {datetime.fromisoformat(one["expires_at"]) for one in (shown, *shown["extras"], *links)} == {until}


@pytest.mark.parametrize("of_media", [True, False])
def test_a_result_is_gone_from_the_time_on_until_which_it_is_said_to_be_kept(
    api: Api, job: dict[str, Any], of_media: bool
) -> None:
    look, services = job["looks"][0], api.services
    link = api.client.post(f"/results/{look['result']}/link").json()["url"]
    with services.background.write() as session:
        if of_media:
            session.get_one(Media, look["video"]).expires_at = services.database.now()
        else:
            session.execute(update(Result).values(expires_at=services.database.now()))
    for url in (look["url"], f"{look['url']}/matte", f"{look['url']}/look.cube", link):
        for answer in (api.client.get(url), api.client.get(url, headers={"if-none-match": f'"{look["sha256"]}"'})):
            assert (answer.status_code, answer.json()["code"]) == (410, "gone")
        assert api.client.head(url).status_code == 410
    for wanted in ({}, {"part": "matte"}):
        answer = api.client.post(f"/results/{look['result']}/link", json=wanted)
        assert (answer.status_code, answer.json()["code"]) == (410, "gone")
    again = api.client.post("/transfer", json={"video": look["video"], "looks": [{"reference": look["video"]}] * 2})
    if of_media:  # a use of it, from which on it is kept again
        assert (again.status_code, again.json()["id"]) == (200, job["id"])
        assert api.client.get(look["url"]).content == b"one"
    else:
        assert (again.status_code, again.json()["id"] != job["id"]) == (202, True)


def test_results_of_which_one_has_expired_are_not_kept_on(api: Api, job: dict[str, Any]) -> None:
    services = api.services
    with services.background.write() as session:
        result = results.get(session, job["looks"][0]["result"])
        assert result is not None
        now = services.database.now()
        assert results.keep(session, job["id"], now=now, ttl_s=5000)
        assert results.drop_bytes(session, result, now=now)
        assert not results.keep(session, job["id"], now=now, ttl_s=10_000)
        session.refresh(result)
        assert result.expires_at == now + timedelta(seconds=5000)


def test_results_of_which_one_was_deleted_are_not_kept_on(api: Api, job: dict[str, Any]) -> None:
    deleted, other = (look["result"] for look in job["looks"])
    now = api.services.database.now()
    with api.services.background.write() as session:
        before = session.get_one(Result, other).expires_at
        results.delete(session, deleted, now=now)
        assert not results.keep(session, job["id"], now=now, ttl_s=10_000)
        assert session.get_one(Result, other, populate_existing=True).expires_at == before


def test_parts_expire_with_their_result(api: Api, job: dict[str, Any]) -> None:
    before = len(api.blobs)
    late = api.services.database.now() + timedelta(seconds=1001)
    with api.services.background.write() as session:
        keys = sweep.expire_results(session, now=late)
    for key in keys:
        api.services.storage.delete(key)
    assert len(keys) == 8
    assert len(api.blobs) == before - 8
    for look in job["looks"]:
        for extra in look["extras"]:
            answer = api.client.get(extra["url"])
            assert (answer.status_code, answer.json()["code"]) == (410, "gone")
            assert look["result"] in answer.json()["detail"]
    after = api.client.get(f"/jobs/{job['id']}").json()
    assert [(look["result"], look["extras"]) for look in after["looks"]] == [(None, [])] * 2
    with api.services.background.write() as session:  # and their records with their job's
        session.execute(delete(Media))
        assert sweep.expire_jobs(session, before=late) == 2
        assert session.query(Result).count() == 0


def test_parts_are_deleted_with_the_video(api: Api, job: dict[str, Any]) -> None:
    with api.services.database.read() as session:
        assert len(sweep.known_keys(session, api.blobs)) == len(api.blobs) == 10
    video = job["looks"][0]["video"]
    assert api.client.delete(f"/videos/{video}").status_code == 204
    until(lambda: api.blobs == [])
    assert api.client.get(job["looks"][0]["extras"][0]["url"]).status_code == 404
    with api.services.database.read() as session:
        assert session.query(Result).count() == 0


def test_a_lost_lease_publishes_no_parts(api: Api) -> None:
    video = upload(api, "/videos")
    make_ready(api.services, video["id"])
    lease = claim(api.services.database, transfer(api, video["id"], video["id"])["id"])
    database = api.services.database
    with database.write() as session:
        jobs.revoke(session, lease.job_id, now=database.now())
    main = Output("res_1", 0, "result/1", "0" * 64, 1, "video/mp4", "a.mp4")
    part = Output("res_2", 0, "result/2", "0" * 64, 1, "text/plain", "a.cube", part_of=PartOf("res_1", "look.cube", 1))
    with database.write() as session:
        assert not results.publish(session, lease, [main, part], now=database.now(), timings={}, ttl_s=1)
        assert session.query(Result).count() == 0


@pytest.mark.parametrize(
    ("name", "plain"),
    [
        ("clip-a b.mp4", "clip-a b.mp4"),
        ("frau lächelt–微.mp4", "frau l_chelt__.mp4"),
        ('a"b\\c.mp4', "a_b_c.mp4"),
        ("100%41.mp4", "100_41.mp4"),
        ("x; filename*=UTF-8''y.exe", "x; filename_=UTF-8__y.exe"),
        ("a\r\nb", "a__b"),
    ],
)
def test_a_name_is_told_in_ascii_too(name: str, plain: str) -> None:
    told = disposition(name)
    assert told.startswith(f'inline; filename="{plain}"; ')
    assert declared_name(told) == name
