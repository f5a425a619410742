from __future__ import annotations

import threading
import time

from service.catalog import Progress, jobs
from tests.service.api.test_media import upload
from tests.service.fixtures import Api, claim, make_ready


def test_progress_is_shown_as_reported(api: Api) -> None:
    video = upload(api, "/videos")
    database = api.services.database
    lease = claim(database, video["job"])
    with database.write() as session:
        jobs.report(session, lease, Progress("landmarks", 0.25, 30, 120), now=database.now())
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
    timer.start()
    began = time.monotonic()
    body = api.client.get(f"/jobs/{video['job']}?wait=20").json()
    waited = time.monotonic() - began
    timer.join()
    assert body["state"] == "succeeded"
    assert 0.5 < waited < 10


def test_a_long_poll_ends_when_its_time_is_over(api: Api) -> None:
    video = upload(api, "/videos")
    began = time.monotonic()
    assert not api.client.get(f"/jobs/{video['job']}?wait=0.5").json()["done"]
    assert 0.45 < time.monotonic() - began < 5
    assert api.client.get(f"/jobs/{video['job']}?wait=61").status_code == 422


def test_cancel_answers_202_then_200_and_409_after_another_end(api: Api) -> None:
    video, other = upload(api, "/videos"), upload(api, "/videos", b"other")
    first = api.client.post(f"/jobs/{video['job']}/cancel")
    assert (first.status_code, first.json()["state"]) == (202, "canceled")
    assert first.json()["error"]["type"] == "canceled"
    assert api.client.post(f"/jobs/{video['job']}/cancel").status_code == 200
    assert api.client.get(f"/videos/{video['id']}").json()["error"]["type"] == "canceled"
    make_ready(api.services, other["id"])
    finished = api.client.post(f"/jobs/{other['job']}/cancel")
    assert (finished.status_code, finished.json()["type"]) == (409, "conflict")


def test_cancel_of_a_running_job_is_a_request_to_its_worker(api: Api) -> None:
    video = upload(api, "/videos")
    claim(api.services.database, video["job"])
    first = api.client.post(f"/jobs/{video['job']}/cancel")
    assert (first.status_code, first.json()["state"]) == (202, "canceling")
    assert api.client.post(f"/jobs/{video['job']}/cancel").status_code == 200


def test_unknown_jobs_are_not_found(api: Api) -> None:
    assert api.client.get(f"/jobs/job_{'0' * 32}").status_code == 404
    assert api.client.post("/jobs/x/cancel").status_code == 404
