"""`python -m benchmarks.fanout`: how much sooner a long render ends with more workers.

The service on its embedded default, one look, workers of one slot that are held on a core of their own, since a render
decodes and encodes beside drawing. One worker and two by wall time, in turns, because a machine has other work too. For
more workers than cores the bound by processor time: the parts as they were measured, given in their order to whoever is
free first, with the cut before and the join after.
"""

from __future__ import annotations

import argparse
import heapq
import json
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import httpx

from benchmarks.service_run import until_done, upload
from pvg.video import read_frames
from scripts.demo import _free_port, _wait_ready
from scripts.samples import fetch_samples

_RATE = Fraction(24)
_SINGLE = {"PVG_WORKER_CONCURRENCY": "1", "NUMBA_NUM_THREADS": "1", "OPENCV_FOR_THREADS_NUM": "1"}


@dataclass(frozen=True)
class Costs:
    """Seconds of one job: of the cut, by the clock; of each part and of the join, of processor time."""

    cut_s: float
    parts_s: tuple[float, ...]
    join_s: float

    def with_workers(self, count: int) -> float:
        """The least time that so many workers with a core each need, taking the parts in their order."""
        free_at = [0.0] * count
        for part in self.parts_s:
            heapq.heapreplace(free_at, free_at[0] + part)
        return self.cut_s + max(free_at) + self.join_s


def make_clip(path: Path, seconds: float, width: int) -> Path:
    """The sample of a woman, played there and back at a width."""
    there = [frame.rgb() for frame in read_frames(fetch_samples().woman_clip)]
    frames = [*there, *reversed(there)]
    size = width, round(width * there[0].shape[0] / there[0].shape[1] / 2) * 2
    with av.open(str(path), "w") as output:
        stream = output.add_stream("libx264", rate=_RATE, options={"crf": "16", "preset": "veryfast"})
        stream.width, stream.height, stream.pix_fmt = *size, "yuv420p"
        for number in range(round(seconds * _RATE)):
            picture = av.VideoFrame.from_ndarray(frames[number % len(frames)], format="rgb24")
            output.mux(stream.encode(picture.reformat(*size, format="yuv420p")))
        output.mux(stream.encode())
    return path


@contextmanager
def service(folder: Path) -> Iterator[str]:
    """The API alone; its address."""
    environment = {**os.environ, **_SINGLE, "PVG_DATA_DIR": str(folder), "PVG_PORT": str(port := _free_port())}
    with started(["serve", "--no-worker"], environment, folder / "service.log") as process:
        url = f"http://127.0.0.1:{port}"
        _wait_ready(url, process, folder / "service.log")
        yield url


@contextmanager
def worker(folder: Path, core: int) -> Iterator[Path]:
    """A worker of one slot on this core, once it takes jobs; its log."""
    log = folder / f"worker-{core}-{time.monotonic_ns()}.log"
    environment = {**os.environ, **_SINGLE, "PVG_DATA_DIR": str(folder), "PVG_PREVIEW_CONCURRENCY": "1"}
    with started(["worker"], environment, log, core):
        while "celery@" not in log.read_text() and "ready" not in log.read_text():
            time.sleep(0.2)
        yield log


@contextmanager
def started(
    arguments: Sequence[str], environment: dict[str, str], log: Path, core: int | None = None
) -> Iterator[subprocess.Popen[bytes]]:
    """A command of the service, on a core or on all, stopped at the end."""
    command = [str(Path(sys.executable).with_name("pvg-service")), *arguments]
    hold = ["taskset", "-c", str(core)] if core is not None else []
    with log.open("wb") as output:
        process = subprocess.Popen([*hold, *command], env=environment, stdout=output, stderr=output)
        try:
            yield process
        finally:
            process.send_signal(signal.SIGTERM)
            process.wait(60)


def events(logs: Sequence[Path]) -> list[dict[str, Any]]:
    """What the workers have logged."""
    lines = [line for log in logs for line in log.read_text().splitlines() if line.startswith("{")]
    return [json.loads(line) for line in lines]


def costs_of(said: Sequence[dict[str, Any]], job: str) -> Costs:
    """What a job cost, by the logs of its workers."""
    ends = [line for line in said if line["event"] == "job ends"]
    shares = [line for line in ends if line.get("part_of") == job]
    parts = sorted((line["job"], line["cpu_s"]) for line in shares if line["kind"] == "part")
    (join,) = [line for line in shares if line["kind"] == "join"]
    began, ended = (
        datetime.fromisoformat(line["timestamp"])
        for line in said
        if line.get("job") == job and line["event"] in {"job begins", "job ends"}
    )
    seconds = tuple(cpu for _, cpu in parts)
    return Costs((ended - began).total_seconds(), seconds, join["cpu_s"] - sum(seconds))


def measure(seconds: float, width: int, pairs: int) -> dict[str, Any]:
    """Wall seconds with one worker and with two, in pairs, and what the job costs."""
    walls: dict[int, list[float]] = {1: [], 2: []}
    found: list[Costs] = []
    digests, loads = set(), []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        clip = make_clip(folder / "clip.mp4", seconds, width)
        with service(folder) as url, httpx.Client(base_url=f"{url}/v1", timeout=60) as client, worker(folder, 0) as log:
            video = upload(client, "/videos", clip)
            reference = upload(client, "/references", fetch_samples().dark_portrait)
            for medium in (video, reference):
                until_done(client, medium["job"])
            wanted = {"video": video["id"], "looks": [{"reference": reference["id"]}], "force": True}

            def run(workers: int, logs: list[Path]) -> None:
                loads.append(os.getloadavg()[0])
                began = time.perf_counter()
                job = client.post("/transfer", json=wanted).raise_for_status().json()["id"]
                until_done(client, job)
                walls[workers].append(time.perf_counter() - began)
                done = client.get(f"/jobs/{job}").json()
                digests.add(done["looks"][0]["sha256"])
                time.sleep(1)  # the last line of the log
                found.append(costs_of(events(logs), job))

            for _ in range(pairs):
                run(1, [log])
                with worker(folder, 1) as second:
                    run(2, [log, second])
    assert len(digests) == 1, "the bytes depend on how many workers there are"
    return {"walls": walls, "costs": found, "loads": loads}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=80.0, help="of the clip")
    parser.add_argument("--width", type=int, default=640, help="of the clip, in pixels")
    parser.add_argument("--pairs", type=int, default=2)
    given = parser.parse_args()
    result = measure(given.seconds, given.width, given.pairs)
    walls, loads = result["walls"], result["loads"]
    shown = ", ".join(f"{one:.1f}" for one in loads)
    print(f"{given.seconds:.0f} s, {given.width} px wide; load of the machine before each run: {shown}")
    ratios = [one / two for one, two in zip(walls[1], walls[2], strict=True)]
    for one, two, ratio in zip(walls[1], walls[2], ratios, strict=True):
        print(f"by the clock: one worker {one:.1f} s, two {two:.1f} s, {ratio:.2f} times faster")
    print(f"by the clock, middle of {len(ratios)}: {statistics.median(ratios):.2f}")
    for number, costs in enumerate(result["costs"]):
        parts = " ".join(f"{part:.1f}" for part in costs.parts_s)
        print(f"run {number}: cut {costs.cut_s:.2f} s, parts {parts} s of processor time, join {costs.join_s:.2f} s")
        bound = [f"{count}: {costs.with_workers(1) / costs.with_workers(count):.2f}" for count in (2, 3, 4, 8)]
        print(f"  times faster with so many workers: {', '.join(bound)}")


if __name__ == "__main__":
    main()
