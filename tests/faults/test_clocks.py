"""A worker and an API whose machine's clock is a minute off, beside others whose clock is right: R21."""

from __future__ import annotations

import subprocess
from collections import Counter
from collections.abc import Callable
from datetime import datetime
from email.utils import parsedate_to_datetime
from pathlib import Path

import httpx
import pytest

from scripts.samples import Samples
from tests.promises import Drill
from tests.service.s3 import S3
from tests.service.servers import installed
from tests.worker.serving import running_afresh

QUICK = {"lease_s": "8", "heartbeat_s": "1", "reap_interval_s": "1", "republish_after_s": "1"}

#: in the place of the C library's, for a process and all that it starts. No headers are needed
_CLOCK = """
struct timespec { long seconds, nanoseconds; };
struct timeval { long seconds, microseconds; };
extern void *dlsym(void *, const char *);

int clock_gettime(int clock, struct timespec *at) {
    static int (*real)(int, struct timespec *);
    if (!real) real = dlsym((void *)-1L, "clock_gettime");
    int failed = real(clock, at);
    if (!failed && (clock == 0 || clock == 5)) at->seconds += OFF_S;  /* CLOCK_REALTIME, CLOCK_REALTIME_COARSE */
    return failed;
}

int gettimeofday(struct timeval *at, void *zone) {
    struct timespec now;
    int failed = clock_gettime(0, &now);
    at->seconds = now.seconds;
    at->microseconds = now.nanoseconds / 1000;
    return failed;
}

long time(long *at) {
    struct timespec now;
    clock_gettime(0, &now);
    if (at) *at = now.seconds;
    return now.seconds;
}
"""


def clock_that_is_off(folder: Path, off_s: int) -> dict[str, str]:
    """Variables of a process that takes the machine's clock for one that is so many seconds off."""
    compiler = installed("cc")
    (folder / "clock.c").write_text(_CLOCK)
    library = folder / "clock.so"
    options = ("-shared", "-fPIC", "-nostdlib", "-fno-builtin", f"-DOFF_S={off_s}L", "-o", str(library))
    subprocess.run([compiler, *options, str(folder / "clock.c")], check=True)
    return {"LD_PRELOAD": str(library)}


@pytest.mark.slow
@pytest.mark.parametrize("off_s", [-60, 60])
def test_a_worker_and_an_api_whose_clock_is_off_burn_no_attempt_and_do_no_job_twice(
    s3: S3,
    postgres_url: str,
    redis_url: str,
    tmp_path: Path,
    samples: Samples,
    promise: Callable[..., Drill],
    off_s: int,
) -> None:
    drill = promise("R21", wanted="a worker and an API, 60 s off: no attempt burnt, no twin render")
    off = clock_that_is_off(tmp_path, off_s)
    parts = {"postgres_url": postgres_url, "broker_url": redis_url.replace("/0", "/5"), "s3": s3}
    environments = {"api-1": off, "worker-3": off}
    with running_afresh(tmp_path, **parts, previews=0, environments=environments, **QUICK) as service:
        dates = [
            parsedate_to_datetime(httpx.get(f"http://127.0.0.1:{port}/livez").headers["date"]) for port in service.ports
        ]
        ids = [service.upload("/videos", samples.woman_clip, matching=one)["id"] for one in ("table", "chain")]
        firsts = [service.client.get(f"/videos/{video}").json()["job"] for video in ids]
        for job in firsts:  # one by either worker
            service.at_work(job)
        renders = []
        for video in ids:
            wanted = {"video": video, "looks": [{"reference": ids[0]}]}
            renders.append(service.client.post("/transfer", json=wanted).raise_for_status().json()["id"])
        done = [service.finished(job) for job in (*firsts, *renders)]
        begun = service.events("job begins")
    first, second = (
        datetime.fromisoformat(line["timestamp"]) for job in firsts for line in begun if line["job"] == job
    )
    apart_s = [abs((one - other).total_seconds()) for one, other in (dates, (first, second))]
    times = Counter(line["job"] for line in begun)
    drill.measured = (
        f"{off_s:+d} s: {len(done)} jobs {done[0]['state']} on attempt {max(job['attempt'] for job in done)}, begun "
        f"{max(times.values())} time each (lease 8 s, a round a second)"
    )
    # the clocks of both pairs were apart, and each worker had a job
    assert all(30 < apart < 90 for apart in apart_s), apart_s
    assert {(job["state"], job["attempt"]) for job in done} == {("succeeded", 1)}
    assert times == dict.fromkeys((*firsts, *renders), 1)
