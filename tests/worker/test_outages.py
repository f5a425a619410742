"""A worker whose database is away goes on with its job; one without its networks takes none, and says so."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from scripts.samples import Samples
from tests.gallery.clips import cut_clip
from tests.promises import Drill
from tests.service.servers import fresh_database, wire_to
from tests.waiting import until
from tests.worker.serving import running_service

#: the lease is not lost because a machine at work stands still for some seconds
LEASE_S, AWAY_S = 20, 24
QUICK = {"lease_s": str(LEASE_S), "heartbeat_s": "3", "reap_interval_s": "1", "progress_interval_s": "0.2"}


def test_a_job_whose_database_is_away_for_longer_than_its_lease_goes_on(
    tmp_path: Path, samples: Samples, postgres_url: str, promise: Callable[..., Drill]
) -> None:
    drill = promise("R22", wanted="503 + Retry-After, running jobs wait and go on, none failed")
    clip = cut_clip(samples.woman_clip, tmp_path / "clip.mp4", 0, 84)
    with (
        fresh_database(postgres_url, patient=False) as url,
        wire_to(url) as (wire, far),
        running_service(tmp_path, database_url=far, worker_concurrency="1", patient=False, **QUICK) as service,
    ):
        job_id = service.upload("/videos", clip)["job"]
        service.at_work(job_id)
        wire.cut()
        began = time.monotonic()
        while time.monotonic() < began + AWAY_S:
            answer = service.client.get(f"/jobs/{job_id}")
            assert (answer.status_code, answer.headers["retry-after"]) == (503, "5")
            time.sleep(0.5)
        wire.connect()
        until(lambda: service.client.get(f"/jobs/{job_id}").is_success)
        job = service.finished(job_id)
        drill.measured = (
            f"database away for {AWAY_S} s (lease {LEASE_S} s): 503, then {job['state']}, attempt {job['attempt']}"
        )
        assert (job["state"], job["attempt"]) == ("succeeded", 1)
        assert service.events("lease upkeep failed", job=job_id)  # the worker has noticed


def test_a_worker_without_its_networks_takes_no_job_and_says_so(tmp_path: Path, samples: Samples) -> None:
    with running_service(tmp_path, until_answers="/livez", cache_dir=str(tmp_path / "empty"), **QUICK) as service:
        job_id = service.upload("/references", samples.portrait)["job"]
        end = time.monotonic() + 180
        while (ready := service.client.get("/readyz")).json()["checks"]["workers"] == "none":
            assert time.monotonic() < end
            time.sleep(0.1)
        assert (ready.status_code, ready.json()["checks"]["workers"]) == (503, "no network weights")
        assert "no job is taken before the network weights are there" in service.log.read_text()
        assert service.client.get(f"/jobs/{job_id}").json()["state"] == "queued"
