from __future__ import annotations

import threading
import time
from collections.abc import Collection, Iterator, Sequence
from datetime import datetime, timedelta
from typing import Any

import pytest
from sqlalchemy import select
from sqlalchemy.orm import Session

from service.api import lookups
from service.catalog import Job, Progress, Result, leases, results
from service.catalog.models import Base
from tests.service.api.test_authentication import holder
from tests.service.api.test_media import upload
from tests.service.fixtures import MP4, Api, claim, make_ready, make_results


def test_progress_is_shown_as_reported(api: Api) -> None:
    video = upload(api, "/videos")
    database = api.services.database
    lease = claim(database, video["job"])
    with database.write() as session:
        leases.report(session, lease, Progress("landmarks", 0.25, 30, 120), now=database.now())
    body = api.client.get(f"/jobs/{video['job']}").json()
    assert (body["state"], body["done"]) == ("running", False)
    assert body["progress"] == {
        "stage": "landmarks",
        "fraction": 0.25,
        "frames_done": 30,
        "frames_total": 120,
    }
    assert body["started_at"] is not None


def test_a_long_poll_returns_when_the_job_ends(api: Api) -> None:
    video = upload(api, "/videos")
    timer = threading.Timer(0.8, make_ready, (api.services, video["id"]))
    began = time.monotonic()
    timer.start()
    body = api.client.get(f"/jobs/{video['job']}?wait=20").json()
    waited = time.monotonic() - began
    timer.join()
    assert body["state"] == "succeeded"
    assert 0.5 < waited < 19


def test_a_long_poll_ends_when_its_time_is_over(api: Api) -> None:
    video = upload(api, "/videos")
    began = time.monotonic()
    assert not api.client.get(f"/jobs/{video['job']}?wait=0.5").json()["done"]
    assert 0.45 < time.monotonic() - began < 25
    assert api.client.get(f"/jobs/{video['job']}?wait=61").status_code == 422


def test_cancel_answers_202_then_200_and_409_after_another_end(api: Api) -> None:
    video, other = upload(api, "/videos"), upload(api, "/videos", b"other")
    first = api.client.post(f"/jobs/{video['job']}/cancel")
    assert (first.status_code, first.json()["state"]) == (202, "canceled")
    assert first.json()["error"]["code"] == "canceled"
    assert api.client.post(f"/jobs/{video['job']}/cancel").status_code == 200
    assert api.client.get(f"/videos/{video['id']}").json()["error"]["code"] == "canceled"
    make_ready(api.services, other["id"])
    finished = api.client.post(f"/jobs/{other['job']}/cancel")
    assert (finished.status_code, finished.json()["code"]) == (409, "conflict")


def test_cancel_of_a_running_job_is_a_request_to_its_worker(api: Api) -> None:
    video = upload(api, "/videos")
    claim(api.services.database, video["job"])
    first = api.client.post(f"/jobs/{video['job']}/cancel")
    assert (first.status_code, first.json()["state"]) == (202, "canceling")
    assert api.client.post(f"/jobs/{video['job']}/cancel").status_code == 200


def test_unknown_jobs_are_not_found(api: Api) -> None:
    assert api.client.get(f"/jobs/job_{'0' * 32}").status_code == 404
    assert api.client.post("/jobs/x/cancel").status_code == 404


def test_how_long_a_job_was_queued_is_known_when_it_runs(api: Api) -> None:
    job_id = upload(api, "/videos")["job"]

    def timings() -> dict[str, float] | None:
        shown: dict[str, float] | None = api.client.get(f"/jobs/{job_id}").json()["timings"]
        return shown

    assert timings() is None
    with api.services.background.write() as session:
        session.get_one(Job, job_id).queued_at -= timedelta(seconds=90)
    lease = claim(api.services.database, job_id)
    running = timings()
    assert running is not None
    assert 90 <= running["queued_s"] < 120
    database = api.services.database
    with api.services.background.write() as session:
        assert leases.give_back(session, lease, now=database.now())
    assert timings() is None, "it is counted anew"


def test_jobs_are_listed_by_what_is_asked_for(api: Api) -> None:
    video, other = upload(api, "/videos"), upload(api, "/videos", b"other")

    def ask(video_id: str, **metadata: str) -> str:
        body = {"video": video_id, "looks": [{"reference": other["id"]}], "metadata": metadata}
        answer = api.client.post("/transfer", json=body)
        assert (answer.status_code, answer.json()["metadata"]) == (202, metadata)
        return str(answer.json()["id"])

    first, second = ask(video["id"], order="42"), ask(video["id"], order="42", **{"a.b": "x:y ü"})
    third = ask(other["id"])
    assert api.client.post(f"/jobs/{third}/cancel").status_code == 202

    def listed(**query: object) -> list[str]:
        answer = api.client.get("/jobs", params=query)
        assert answer.status_code == 200
        assert answer.json()["next_cursor"] is None
        return [job["id"] for job in answer.json()["data"]]

    assert listed() == [third, second, first, other["job"], video["job"]]
    assert listed(video=video["id"]) == [second, first, video["job"]]
    assert listed(video=video["id"], kind="transfer", metadata=["order:42", "a.b:x:y ü"]) == [second]
    assert listed(reference=other["id"]) == [third, second, first, other["job"]]
    assert listed(reference=other["id"], video=video["id"], kind="transfer") == [second, first]
    assert listed(reference=f"{video['id']}\0") == [video["job"]]
    assert listed(metadata="order:4") == []
    assert listed(state=["canceled", "running"]) == [third]
    assert listed(kind="vectorize", state="queued") == [other["job"], video["job"]]
    assert listed(id=f"{first},job_unknown, {third}\0") == [third, first]
    assert listed(id="") == []
    page = api.client.get("/jobs", params={"limit": 2}).json()
    assert page["next_cursor"] == second
    assert page["data"][1] == api.client.get(f"/jobs/{second}").json()
    assert listed(cursor=second) == [first, other["job"], video["job"]]
    named = {"id": f"{first},{second},{third}", "limit": 2}
    page = api.client.get("/jobs", params=named).json()
    assert ([job["id"] for job in page["data"]], page["next_cursor"]) == ([third, second], second)
    assert listed(**named, cursor=second) == [first]
    for wrong in ({"metadata": "order"}, {"metadata": ["a:1", "a:2"]}, {"state": "done"}, {"id": "x," * 201}):
        assert api.client.get("/jobs", params=wrong).status_code == 422


def test_metadata_has_limits(api: Api) -> None:
    video = upload(api, "/videos")
    wrong: tuple[dict[str, object], ...] = ({"a b": "1"}, {"a": 1}, {"a": "x" * 201}, {"a": "\0"}, {"": "x"})
    for metadata in (*wrong, {str(i): "" for i in range(17)}):
        body = {"video": video["id"], "looks": [{"reference": video["id"]}], "metadata": metadata}
        assert api.client.post("/transfer", json=body).status_code == 422
    given = api.client.post("/videos?metadata=order:42&metadata=who:me", content=MP4)
    assert given.json()["metadata"] == {"order": "42", "who": "me"}  # of the same bytes: the last that were given
    again = api.client.post("/videos", files={"file": ("a.mp4", MP4)}, data={"metadata": ["order:43"]})
    assert (again.json()["id"], again.json()["metadata"]) == (video["id"], {"order": "43"})
    assert api.client.post("/videos", content=MP4).json()["metadata"] == {"order": "43"}
    assert api.client.post("/videos?metadata=order", content=MP4).status_code == 422


def test_the_job_of_an_upload_has_its_metadata(api: Api) -> None:
    def listed(pair: str) -> list[str]:
        return [job["id"] for job in api.client.get("/jobs", params={"metadata": pair}).json()["data"]]

    video = api.client.post("/videos?metadata=order:77", content=MP4).json()
    path = f"/jobs/{video['job']}"
    assert api.client.get(path).json()["metadata"] == {"order": "77"}
    assert listed("order:77") == [video["job"]]
    # the same bytes under another name, while it is vectorised, when it has failed, and when it is ready
    api.client.post("/videos?metadata=order:78", content=MP4).raise_for_status()
    assert (listed("order:77"), listed("order:78")) == ([], [video["job"]])
    api.client.post(f"{path}/cancel").raise_for_status()
    again = api.client.post("/videos?metadata=order:79", content=MP4).json()
    assert (again["id"], api.client.get(f"/jobs/{again['job']}").json()["metadata"]) == (video["id"], {"order": "79"})
    make_ready(api.services, video["id"])
    api.client.post("/videos?metadata=order:80", content=MP4).raise_for_status()
    assert listed("order:80") == [again["job"]]
    api.client.post("/videos", content=MP4).raise_for_status()
    assert listed("order:80") == [again["job"]]


def test_jobs_and_media_have_strong_etags_that_change_with_them(api: Api) -> None:
    video = upload(api, "/videos")
    for path in ("/jobs", f"/jobs?id={video['job']},job_0", f"/jobs/{video['job']}", f"/videos/{video['id']}"):
        first = api.client.get(path)
        tag = first.headers["etag"]
        assert tag.startswith('"')
        same = api.client.get(path, headers={"If-None-Match": f'"other", {tag}'})
        assert (same.status_code, same.content, same.headers["etag"]) == (304, b"", tag)
    make_ready(api.services, video["id"])
    changed = api.client.get(path, headers={"If-None-Match": tag})
    assert (changed.status_code, changed.json()["state"]) == (200, "ready")
    assert changed.headers["etag"] != tag


def test_prefer_wait_holds_the_answer_and_is_said_to_be_applied(api: Api) -> None:
    video = upload(api, "/videos")
    path = f"/jobs/{video['job']}"
    plain = api.client.get(path, headers={"Prefer": "respond-async"})
    assert "preference-applied" not in plain.headers
    began = time.monotonic()
    held = api.client.get(path, headers={"Prefer": "wait=1"})
    assert held.headers["preference-applied"] == "wait=1"
    assert 0.9 < time.monotonic() - began < 25
    assert "preference-applied" not in api.client.get(f"{path}?wait=0", headers={"Prefer": "wait=9"}).headers
    make_ready(api.services, video["id"])
    done = api.client.get(path, headers={"Prefer": "wait=100"})
    assert done.headers["preference-applied"] == "wait=60"
    assert done.json()["expires_at"] > done.json()["finished_at"]


def test_the_record_of_a_job_is_kept_as_long_as_what_the_job_has_made(api: Api) -> None:
    video = upload(api, "/videos")
    make_ready(api.services, video["id"])
    asked = {"video": video["id"], "looks": [{"reference": video["id"]}]}
    drawn = api.client.post("/transfer", json=asked).raise_for_status().json()["id"]
    make_results(api.services, drawn, [b"look"])
    with api.services.background.write() as session:  # four weeks ago, of the 30 days for which records are kept
        for job_id in (video["job"], drawn):
            job = session.get_one(Job, job_id)
            assert job.finished_at is not None
            job.finished_at -= timedelta(days=28)
    # in use: the retention of the medium, and with the next line that of the look, count from now
    api.client.post("/videos", content=MP4).raise_for_status()
    assert api.client.post("/transfer", json=asked).json()["id"] == drawn

    def shown(job_id: str) -> dict[str, Any]:
        alone: dict[str, Any] = api.client.get(f"/jobs/{job_id}").json()
        assert alone in api.client.get("/jobs").json()["data"]
        return alone

    kept_until = api.client.get(f"/videos/{video['id']}").json()["expires_at"]
    assert shown(video["job"])["expires_at"] == kept_until
    (look,) = shown(drawn)["looks"]
    assert shown(drawn)["expires_at"] == look["expires_at"] < kept_until
    api.client.delete(f"/videos/{video['id']}").raise_for_status()
    for job_id in (video["job"], drawn):  # nothing is left that it would have to outlive
        times = (datetime.fromisoformat(shown(job_id)[name]) for name in ("finished_at", "expires_at"))
        assert next(times) + timedelta(seconds=api.services.settings.job_ttl_s) == next(times)


def test_a_job_says_how_its_results_are_written(api: Api) -> None:
    video, reference = upload(api, "/videos"), upload(api, "/references", b"face")
    assert api.client.get(f"/jobs/{video['job']}").json()["output"] is None
    looks = [{"reference": reference["id"]}]
    usual = {"container": None, "codec": "auto", "crf": None, "preset": None, "audio": "copy", "extras": []}
    for output, stored in (
        ({}, {}),
        ({"container": "mov", "codec": "prores", "extras": ["matte"], "matte": "prores"},) * 2,
        ({"crf": 20, "preset": "slow", "audio": "none"},) * 2,
    ):
        asked = {"video": video["id"], "looks": looks, "output": output}
        job = api.client.post("/transfer", json=asked).raise_for_status().json()
        assert job["output"] == usual | {"matte": "ffv1"} | stored
        assert api.client.get(f"/jobs/{job['id']}").json()["output"] == job["output"]


class Reads:
    """A page's results that count how often one of them is looked at."""

    def __init__(self, results: Sequence[Result]) -> None:
        self.count = 0
        self._results = results

    def __iter__(self) -> Iterator[Result]:
        for one in self._results:
            self.count += 1
            yield one


def test_a_page_looks_at_each_result_a_few_times_however_many_there_are(
    api: Api, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of 200 jobs of 16 looks each, to look for every file among all of them took half a minute."""
    video, reference = upload(api, "/videos"), upload(api, "/references")
    for one in (video, reference):
        make_ready(api.services, one["id"])
    jobs_made = [
        api.client.post(
            "/transfer",
            json={"video": video["id"], "looks": [{"reference": reference["id"], "seed": 2 * k + j} for j in range(2)]},
        ).json()["id"]
        for k in range(8)
    ]
    made = {job: make_results(api.services, job, [f"{job}{i}".encode() for i in range(2)]) for job in jobs_made}
    read: list[Reads] = []

    def files(session: Session, result_ids: Collection[str]) -> Reads:
        read.append(Reads(found(session, result_ids)))
        return read[-1]

    found = results.files
    monkeypatch.setattr(lookups.results, "files", files)
    monkeypatch.setattr(lookups.results, "kept_until", lambda _, of: {one.id: one.expires_at for one in of})
    page = api.client.get("/jobs?kind=transfer&limit=8").json()["data"]
    assert {job["id"]: [look["result"] for look in job["looks"]] for job in page} == made
    assert all(look["size_bytes"] for job in page for look in job["looks"])
    assert [one.count for one in read] == [2 * 16]


def test_the_record_of_a_job_is_deleted_with_all_that_tells_of_it(api: Api) -> None:
    video, reference = upload(api, "/videos"), upload(api, "/references")
    for one in (video, reference):
        make_ready(api.services, one["id"])
    asked = {
        **{"video": video["id"], "looks": [{"reference": reference["id"]}], "metadata": {"user": "somebody-42"}},
        "webhook": {"url": "https://studio.example/hooks?token=secret-42"},
    }
    once = {"Idempotency-Key": "order-42"}
    job = api.client.post("/transfer", json=asked, headers=once).json()["id"]
    going_on = api.client.delete(f"/jobs/{job}")
    assert (going_on.status_code, going_on.json()["code"]) == (409, "conflict")
    (result,) = make_results(api.services, job, [b"a look"])
    (told,) = api.client.get(f"/webhooks?job={job}").json()["data"]
    assert api.client.post(f"/webhooks/{told['id']}/replay", headers={"Idempotency-Key": "again"}).status_code == 202
    ended = [line for line in api.client.get("/metrics").text.splitlines() if line.startswith("pvg_jobs_ended_total")]
    made = api.client.delete(f"/jobs/{video['job']}")
    assert (made.status_code, video["id"] in made.json()["detail"]) == (409, True)
    as_it_was = api.client.delete(f"/jobs/{job}", headers={"If-Match": '"of before"'})
    assert (as_it_was.status_code, as_it_was.json()["code"]) == (412, "precondition-failed")

    as_it_is = {"If-Match": api.client.get(f"/jobs/{job}").headers["etag"]}
    assert api.client.delete(f"/jobs/{job}", headers=as_it_is).status_code == 204
    for path in (f"/jobs/{job}", f"/results/{result}", f"/webhooks/{told['id']}"):
        assert api.client.get(path).status_code == 404, path
    assert api.client.delete(f"/jobs/{job}").status_code == 404
    assert set(ended) <= set(api.client.get("/metrics").text.splitlines())  # what has ended stays counted
    storage, database = api.services.storage, api.services.database
    with database.read() as session:
        tables = [session.execute(select(table)).all() for table in Base.metadata.sorted_tables]
    assert not any(word in repr(tables) for word in ("somebody-42", "secret-42", job, result))
    assert not [key for key, _ in storage.entries() if key.startswith("result/")]
    assert api.client.get(f"/videos/{video['id']}").json()["state"] == "ready"
    again = api.client.post("/transfer", json=asked, headers=once)
    assert (again.status_code, again.json()["id"] != job) == (202, True)


def test_a_key_deletes_its_own_jobs_alone(api: Api) -> None:
    one, other = holder(api), holder(api)
    job = one.upload("/videos").json()["job"]
    assert one.post(f"/jobs/{job}/cancel").status_code == 202
    assert other.delete(f"/jobs/{job}").status_code == 404
    video = one.get(f"/jobs/{job}").json()["media"]
    assert one.delete(f"/videos/{video}").status_code == 204
    assert one.delete(f"/jobs/{job}").status_code == 204
    assert one.get("/jobs").json()["data"] == []
