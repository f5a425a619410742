"""A thousand queued jobs."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import httpx
import pytest

from scripts.samples import Samples
from tests.promises import Drill
from tests.worker.serving import running_service


@pytest.mark.slow
def test_a_thousand_queued_jobs_hold_nobody_up(tmp_path: Path, samples: Samples, promise: Callable[..., Drill]) -> None:
    drill = promise("R12", wanted="1000 queued, 2 workers: POST p99 < 200 ms, GET p99 < 100 ms")
    with running_service(tmp_path, worker_concurrency="2") as service:
        video = service.ready("/videos", samples.single_face_clip)["id"]
        reference = service.ready("/references", samples.dark_portrait)["id"]
        ids: list[str] = []
        posts: list[float] = []
        gets: list[float] = []
        full = threading.Event()

        def ask(number: int) -> None:
            with httpx.Client(base_url=service.client.base_url, timeout=60) as client:
                for seed in range(250):
                    wanted = {"video": video, "looks": [{"reference": reference, "seed": 1000 * number + seed}]}
                    began = time.perf_counter()
                    ids.append(client.post("/transfer", json=wanted).raise_for_status().json()["id"])
                    posts.append(time.perf_counter() - began)

        def look() -> None:
            with httpx.Client(base_url=service.client.base_url, timeout=60) as client:
                while not full.wait(0.02):
                    if ids:
                        began = time.perf_counter()
                        client.get(f"/jobs/{ids[len(gets) * 37 % len(ids)]}").raise_for_status()
                        gets.append(time.perf_counter() - began)

        looking = threading.Thread(target=look)
        looking.start()
        try:
            with ThreadPoolExecutor(4) as clients:
                list(clients.map(ask, range(4)))
        finally:
            full.set()
            looking.join()
        assert len(set(ids)) == 1000
        post, get = (1000 * sorted(times)[int(0.99 * len(times))] for times in (posts, gets))
        drill.measured = f"4 clients at once: POST p99 {post:.0f} ms, GET p99 {get:.0f} ms"
        drill.keep_to(post, 200)
        drill.keep_to(get, 100)
