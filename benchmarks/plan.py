"""`python -m benchmarks.plan`: what so many clips an hour need, by simulation from measured costs.

Clips arrive at random (Poisson). Each is uploaded and vectorised, then asked for some looks, drawn in parts of 7.5 s
and joined; every step is a job of one worker process, handed out first come, first served. Records and object store
are one server each, of which every step takes its measured share. Change `Costs` for another machine.
"""

from __future__ import annotations

import argparse
import heapq
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from pvg.rendering import part_bounds


@dataclass(frozen=True)
class Costs:
    """Seconds of one core, unless a name says otherwise; a frame is 1080×1920. Beside each: where it was measured.

    The first six: docs/performance.md, "What to expect", whole runs of 200 frames, of which 0.4 s are the clip's fit.
    """

    vectorize_frame: float = 0.0354
    vectorize_once: float = 0.40
    decode_frame: float = 0.0045
    draw_frame: float = 0.013  # of the first look of a request
    draw_further_frame: float = 0.0055
    encode_frame: float = 0.0178
    look_once: float = 0.10  # opening, transport: docs/performance.md, "Previews"
    join_second: float = 0.002  # of a second of the clip and a look
    claim: float = 0.020  # of the database server: a short job in all 11 ms with 500 queued, 33 with 5000
    report: float = 0.003  # once a second of a job at work
    end: float = 0.003
    upload_call: float = 0.02  # of an API, and a second a gigabyte for its hash
    call: float = 0.012
    clip_bytes_s: float = 1.0e6  # of a second of the clip
    asset_bytes_frame: float = 3.0e3


@dataclass(frozen=True)
class Demand:
    """What is asked for: clips an hour, their length in seconds and frames a second, looks of each in one request."""

    clips: float
    length_s: float = 30.0
    frame_rate: float = 30.0
    looks: int = 3


@dataclass(frozen=True)
class Step:
    """One job: seconds of a worker process, of the database, and bytes to and from the store."""

    work_s: float
    database_s: float
    stored_bytes: float


def steps_of(demand: Demand, costs: Costs) -> tuple[Step, list[Step], Step]:
    """A clip's vectorisation, its parts and its join."""
    frames = demand.length_s * demand.frame_rate
    clip = costs.clip_bytes_s * demand.length_s

    def step(work_s: float, stored_bytes: float) -> Step:
        return Step(work_s, costs.claim + costs.end + costs.report * work_s, stored_bytes)

    asset = costs.asset_bytes_frame * frames
    vectorize = step(costs.vectorize_once + costs.vectorize_frame * frames, 2 * clip + asset)  # sent, read, asset
    parts = len(part_bounds(round(frames), demand.frame_rate)) - 1
    each = frames / parts
    drawing = costs.draw_frame + (demand.looks - 1) * costs.draw_further_frame
    drawn = costs.decode_frame + drawing + demand.looks * costs.encode_frame
    part = step(costs.look_once * demand.looks + drawn * each, clip + asset + demand.looks * clip / parts)
    join = step(costs.join_second * demand.length_s * demand.looks, clip + 3 * demand.looks * clip)  # read, kept, taken
    return vectorize, [part] * parts, join


@dataclass(order=True)
class _Job:
    """What waits for a worker, in the order of time."""

    at: float
    number: int
    clip: int = field(compare=False)
    kind: int = field(compare=False)  # 0 vectorise, 1 a part, 2 the join


def simulate(demand: Demand, costs: Costs, workers: int, *, hours: float, seed: int = 0) -> list[float]:
    """Seconds from each clip's upload to its last result, with so many worker processes."""
    rng = np.random.default_rng(seed)
    vectorize, parts, join = steps_of(demand, costs)
    work = (vectorize.work_s, parts[0].work_s, join.work_s)
    arrivals = np.cumsum(rng.exponential(3600.0 / demand.clips, max(1, round(demand.clips * hours))))
    numbers = iter(range(10**9))
    waiting = [_Job(float(at), next(numbers), clip, 0) for clip, at in enumerate(arrivals)]
    heapq.heapify(waiting)
    free = [0.0] * workers
    left = [len(parts)] * len(arrivals)
    ended = [0.0] * len(arrivals)
    while waiting:
        job = heapq.heappop(waiting)
        end = max(job.at, heapq.heappop(free)) + work[job.kind]
        heapq.heappush(free, end)
        for at, kind in _next(job, end, parts, left, ended):
            heapq.heappush(waiting, _Job(at, next(numbers), job.clip, kind))
    warm = len(arrivals) // 5
    return [end - at for end, at in zip(ended[warm:], arrivals[warm:], strict=True)]


def _next(job: _Job, end: float, parts: list[Step], left: list[int], ended: list[float]) -> Iterator[tuple[float, int]]:
    """When and what follows a job that has ended."""
    if job.kind == 0:
        yield from ((end, 1) for _ in parts)
    elif job.kind == 1:
        left[job.clip] -= 1
        ended[job.clip] = max(ended[job.clip], end)
        if not left[job.clip]:
            yield ended[job.clip], 2
    else:
        ended[job.clip] = end


def workers_for(demand: Demand, costs: Costs, *, load: float) -> int:
    """Worker processes, of one core each, that are at work for this part of the time."""
    vectorize, parts, join = steps_of(demand, costs)
    core_s = vectorize.work_s + sum(part.work_s for part in parts) + join.work_s
    return max(1, int(np.ceil(demand.clips / 3600.0 * core_s / load)))


def main() -> None:
    """Print what each rate needs, and what is used up first."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.plan", description=__doc__)
    parser.add_argument("--clips", type=float, nargs="+", default=[100.0, 1000.0, 10_000.0], help="an hour")
    parser.add_argument("--length", type=float, default=30.0, help="seconds of a clip")
    parser.add_argument("--looks", type=int, default=3, help="of a clip, in one request")
    parser.add_argument("--load", type=float, default=0.7, help="part of the time that workers are at work")
    parser.add_argument("--store", type=float, default=1.25e9, help="bytes a second of the store (10 Gbit/s)")
    options = parser.parse_args()
    costs = Costs()
    coded_elsewhere = Costs(decode_frame=0.001, encode_frame=0.001)  # assumed, not measured: handing pictures over
    print("clips/h  encoder  workers  DB cores  store  API cores  wait p50 s  p95 s   a clip's work")
    for clips in options.clips:
        for name, chosen in (("CPU", costs), ("GPU", coded_elsewhere)):
            demand = Demand(clips, options.length, looks=options.looks)
            vectorize, parts, join = steps_of(demand, chosen)
            steps, rate = [vectorize, *parts, join], clips / 3600.0
            workers = workers_for(demand, chosen, load=options.load)
            waits = simulate(demand, chosen, workers, hours=max(1.0, 1000.0 / clips))
            database = rate * sum(step.database_s for step in steps)
            store = rate * sum(step.stored_bytes for step in steps) / options.store
            gigabytes = chosen.clip_bytes_s * options.length / 1e9
            api = rate * (chosen.upload_call + gigabytes + 20 * chosen.call)
            work = sum(step.work_s for step in steps)
            coded = options.length * demand.frame_rate * options.looks * chosen.encode_frame / work
            p50, p95 = np.percentile(waits, (50, 95))
            print(
                f"{clips:7.0f}  {name:7s}  {workers:7d}  {database:8.2f}  {store:6.1%}  {api:9.2f}  {p50:10.0f}  "
                f"{p95:5.0f}   {work:5.0f} s, {coded:.0%} of it encoding"
            )


if __name__ == "__main__":
    main()
