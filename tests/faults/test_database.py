"""A database that goes away under load, and machines that go away from it: R22, R2."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import httpx
import pytest
from sqlalchemy.exc import SQLAlchemyError

from scripts.samples import Samples
from service.catalog import Database, leases
from tests.promises import Drill
from tests.service.fixtures import PNG
from tests.service.servers import fresh_database, postgres_of_our_own, wire_to
from tests.waiting import until
from tests.worker.serving import Service, running_service

AWAY_S = 30
QUICK = {"lease_s": "12", "heartbeat_s": "3", "reap_interval_s": "1", "progress_interval_s": "0.2"}


@contextmanager
def clients(service: Service, job_id: str) -> Iterator[list[tuple[float, str, int]]]:
    """Three that read and two that write, all the time; when, which, and the status of each answer."""
    answers: list[tuple[float, str, int]] = []
    done = threading.Event()

    def go_on(what: str, ask: Callable[[httpx.Client], httpx.Response]) -> None:
        with httpx.Client(base_url=service.client.base_url, timeout=60) as client:
            while not done.is_set():
                answer = ask(client)
                assert answer.status_code != 503 or int(answer.headers["retry-after"]) > 0
                answers.append((time.monotonic(), what, answer.status_code))
                time.sleep(0.2)

    def read(client: httpx.Client) -> httpx.Response:
        return client.get(f"/jobs/{job_id}")

    def write(client: httpx.Client) -> httpx.Response:
        return client.post("/references", content=PNG)

    asked = [("GET", read)] * 3 + [("POST", write)] * 2
    threads = [threading.Thread(target=go_on, args=one) for one in asked]
    for thread in threads:
        thread.start()
    try:
        yield answers
    finally:
        done.set()
        for thread in threads:
            thread.join()


@pytest.mark.slow
@pytest.mark.parametrize("how", ["stopped", "frozen"])
def test_a_database_that_is_away_for_half_a_minute_under_load_costs_no_job(
    tmp_path: Path, samples: Samples, promise: Callable[..., Drill], how: str
) -> None:
    drill = promise("R22", wanted="503 + Retry-After, running jobs wait and go on, none failed; mends itself")
    with (
        postgres_of_our_own() as server,
        fresh_database(server.url, patient=False) as url,
        running_service(tmp_path, database_url=url, worker_concurrency="1", patient=False, **QUICK) as service,
    ):
        job_id = service.upload("/videos", samples.woman_clip)["job"]
        service.at_work(job_id)
        with clients(service, job_id) as answers:
            time.sleep(2)
            gone = time.monotonic()
            (server.stop if how == "stopped" else server.freeze)()
            time.sleep(AWAY_S)
            coming = time.monotonic()  # it may answer before its start has returned
            (server.start if how == "stopped" else server.thaw)()
            back = time.monotonic()
            job = service.finished_at_last(job_id, 300)
            until(lambda: len({what for at, what, status in list(answers) if at > back and status < 300}) == 2)
        others = service.client.get("/jobs").json()["data"]
        kept = {one["id"]: (one["state"], one["attempt"]) for one in others if one["kind"] == "vectorize"}
    away = Counter(status for at, _, status in answers if gone + 15 < at < coming)
    mended = [
        min(at - back for at, what, status in answers if what == name and at > back and status < 300)
        for name in ("GET", "POST")
    ]
    drill.measured = (
        f"{how} for {back - gone:.0f} s: {away[503]} answers 503; read again after {mended[0]:.1f} s, written after "
        f"{mended[1]:.1f} s; {job['state']}, attempt {job['attempt']}"
    )
    assert {status for _, _, status in answers} <= {200, 202, 503}
    assert set(away) == {503}
    assert (job["state"], job["attempt"]) == ("succeeded", 1)
    assert {attempt for _, attempt in kept.values()} == {1}


@pytest.mark.slow
def test_what_a_machine_that_loses_its_power_keeps_locked_is_free_again(
    postgres_url: str, tmp_path: Path, promise: Callable[..., Drill]
) -> None:
    drill = promise("R2", wanted="power lost in the middle of a transaction: another may take over within 45 s")
    with (
        fresh_database(postgres_url, patient=False) as url,
        wire_to(url) as (wire, far),
        running_service(tmp_path, arguments=["--no-worker"], database_url=url, patient=False) as service,
    ):
        ids = [service.client.post("/references", content=PNG + name).json()["job"] for name in (b"a", b"b")]
        # the worker of the machine that is lost; PostgreSQL is told of its end by nobody
        lost = Database(far)
        with lost.write() as session:
            held = [leases.claim(session, job_id, now=lost.now(), lease_s=30) for job_id in ids]
        with suppress(SQLAlchemyError), lost.write() as session:
            assert held[0] is not None
            assert leases.renew(session, held[0], now=lost.now(), lease_s=30)
            wire.hang()
            gone, again_s = time.monotonic(), dict.fromkeys(ids, 0.0)
            try:
                for job_id in reversed(ids):
                    until(lambda job_id=job_id: service.job(job_id)["attempt"] == 2, 180)
                    again_s[job_id] = time.monotonic() - gone
            finally:
                wire.connect()
        lost.close()
    drill.measured = "; ".join(f"queued again after {again_s[job_id]:.0f} s" for job_id in ids)
    drill.keep_to(max(again_s.values()), 45)
