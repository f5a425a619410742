"""An object store that goes away under work: R22."""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import httpx
import pytest

from scripts.samples import Samples
from tests.promises import Drill
from tests.service.fixtures import MP4, PNG
from tests.service.s3 import S3
from tests.service.servers import Wire
from tests.waiting import until
from tests.worker.serving import running_afresh

AWAY_S = 30
QUICK = {"lease_s": "20", "heartbeat_s": "1", "reap_interval_s": "1", "progress_interval_s": "0.2"}


@pytest.mark.slow
@pytest.mark.parametrize("how", ["cut", "hang"])
def test_a_store_that_is_away_for_half_a_minute_costs_no_job(
    s3: S3, postgres_url: str, redis_url: str, tmp_path: Path, samples: Samples, promise: Callable[..., Drill], how: str
) -> None:
    drill = promise("R22", wanted="503 + Retry-After, running jobs wait and go on, none failed; mends itself")
    wire = Wire(int(s3.url.rpartition(":")[2]))
    wire.connect()
    parts = {"postgres_url": postgres_url, "broker_url": redis_url.replace("/0", "/4"), "s3": s3}
    with running_afresh(tmp_path, **parts, store_port=wire.port, previews=0, patient=False, **QUICK) as service:
        kept = MP4 + os.urandom(1000)
        medium = service.client.post("/videos", content=kept).json()
        job_id = service.upload("/videos", samples.woman_clip)["job"]
        service.at_work(job_id)
        (wire.cut if how == "cut" else wire.hang)()
        gone = time.monotonic()
        written, read = [], []
        while time.monotonic() < gone + AWAY_S:
            answer = service.client.post("/references", content=PNG + os.urandom(10))
            assert answer.status_code != 503 or int(answer.headers["retry-after"]) > 0
            written.append(answer.status_code)
            read.append(service.client.get(f"/jobs/{job_id}").status_code)
            time.sleep(0.5)
        waited = service.job(job_id)
        wire.connect()
        back = time.monotonic()
        job = service.finished(job_id)
        for port in service.ports:
            url = f"http://127.0.0.1:{port}/references"
            until(lambda url=url: httpx.post(url, content=PNG + os.urandom(10), timeout=60).status_code == 202)
        mended = time.monotonic() - back
        assert service.client.get(f"/videos/{medium['id']}/file").content == kept
        states = [(one["state"], one["attempt"]) for one in (waited, job)]
        drill.measured = (
            f"store {how} for {back - gone:.0f} s: writes {dict(Counter(written))}, reads of records "
            f"{dict(Counter(read))}; {states[1]}, all well after {mended:.1f} s"
        )
    wire.cut()
    assert set(written) == {503}
    assert set(read) == {200}
    assert states == [("running", 1), ("succeeded", 1)]
