"""`python -m benchmarks.soak --minutes 30`: steady work on the running service, and what of it keeps growing.

Uploads, transfers, cancels and deletes go on at a steady rate against `pvg-service serve` in a folder of its own.
Memory (resident, in MB) of the API, the worker and its children, open descriptors, threads, bytes on disk and messages
that wait are sampled each second. After a warm-up a straight line is fitted to each; what grows in an hour by more than
its allowance, and by more than chance explains, grows.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import threading
import time
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import httpx
import numpy as np
from numpy.typing import NDArray

from benchmarks.service_run import served
from scripts.samples import Samples, fetch_samples

WARM_UP = 0.3  # of the time: children are replaced, caches fill
ALLOWED = {"MB": 30.0, "descriptors": 10.0, "threads": 5.0, "disk MB": 10.0, "jobs": 20.0}
"""By unit, how much may be gained in an hour."""
_SIGMAS = 3.0
_LEAST_GAIN = 0.33  # of what is allowed in an hour: less may be a cache or a journal that fills once
_PAGE = os.sysconf("SC_PAGE_SIZE")


@dataclass(frozen=True)
class Slope:
    """A line fitted to one quantity: per_hour and its standard error `error`, both in `unit` an hour."""

    name: str
    unit: str
    first: float
    last: float
    per_hour: float
    error: float

    @property
    def verdict(self) -> Literal["GROWS", "steady", "too short to tell"]:
        """Whether it grows by more than allowed, and than chance explains, and by enough to be no single step."""
        allowed, gained = ALLOWED[self.unit], self.last - self.first
        if self.per_hour > max(allowed, _SIGMAS * self.error) and gained > _LEAST_GAIN * allowed:
            return "GROWS"
        return "steady" if self.per_hour + _SIGMAS * self.error < allowed else "too short to tell"


def fitted(name: str, unit: str, times_s: NDArray[np.float64], values: NDArray[np.float64]) -> Slope:
    """The line through samples taken at times_s. Neighbours are alike, so the error counts blocks of them, not each.

    times_s, values: (n,), n at least 20. Raises ValueError for fewer.
    """
    blocks = min(20, len(values) // 2)
    if blocks < 10:
        raise ValueError(f"{len(values)} samples are too few for a slope; soak for longer")
    hours = np.array([part.mean() for part in np.array_split(times_s, blocks)]) / 3600
    means = np.array([part.mean() for part in np.array_split(values, blocks)])
    spread = hours - hours.mean()
    slope = float(spread @ means / (spread @ spread))
    rest = means - means.mean() - slope * spread
    error = float(np.sqrt((rest @ rest) / (blocks - 2) / (spread @ spread)))
    return Slope(name, unit, float(means[0]), float(means[-1]), slope, error)


# --- the service, looked at from outside -----------------------------------------------------------------------


def processes(data_dir: Path) -> dict[int, str]:
    """Who of the service runs: pid -> "API", "worker" (its main process) or "children"."""
    marker = f"PVG_DATA_DIR={data_dir}".encode()
    parents: dict[int, int] = {}
    for entry in Path("/proc").iterdir():
        try:
            if entry.name.isdigit() and marker in (entry / "environ").read_bytes().split(b"\0"):
                parents[int(entry.name)] = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
        except OSError:
            continue  # it has ended, or is another user's
    roots = {pid for pid, parent in parents.items() if parent not in parents}
    return {
        pid: "API" if pid in roots else "worker" if parent in roots else "children" for pid, parent in parents.items()
    }


def look(data_dir: Path) -> dict[tuple[str, str], float]:
    """One sample: (quantity, unit) -> value."""
    sample: defaultdict[tuple[str, str], float] = defaultdict(float)
    for pid, who in processes(data_dir).items():
        try:
            pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
            descriptors, threads = (len(os.listdir(f"/proc/{pid}/{kind}")) for kind in ("fd", "task"))
        except OSError:
            continue
        sample[(f"memory of {who}", "MB")] += pages * _PAGE / 1e6
        sample[("descriptors", "descriptors")] += descriptors
        sample[("threads", "threads")] += threads
    for folder, _, names in os.walk(data_dir):
        for name in names:
            try:
                size_mb = (Path(folder) / name).stat().st_size / 1e6
            except FileNotFoundError:
                continue
            records = Path(folder) == data_dir  # the database with its journal, and the log
            sample[("disk: records" if records else "disk: media", "disk MB")] += size_mb
            sample[("messages", "jobs")] += name.endswith(".msg")
    return dict(sample)


# --- the work --------------------------------------------------------------------------------------------------


@dataclass
class Work:
    """What is done to the service, round by round; every round is as the one before it."""

    client: httpx.Client
    samples: Samples
    done: Counter[str] = field(default_factory=Counter)
    wrong: Counter[str] = field(default_factory=Counter)

    def round(self, number: int) -> None:
        """Upload a picture and a reference, transfer, fetch, delete both; each third clip is canceled on its way."""
        portrait = self.samples.portrait.read_bytes() + number.to_bytes(
            8, "big"
        )  # bytes of its own: no upload is known
        video = self._sent("/videos", portrait)
        reference = self._sent("/references", self.samples.dark_portrait.read_bytes() + number.to_bytes(8, "big"))
        if number % 3 == 2:
            self._answered("cancel", self.client.post(f"/jobs/{video['job']}/cancel"), {202, 200, 409})
        else:
            looks = [{"reference": reference["id"]}]
            job = self.client.post("/transfer", json={"video": video["id"], "looks": looks})
            if self._answered("transfer", job, {202}):
                body = self._finished(job.json()["id"])
                self.done[body["state"]] += 1
                for one in body["looks"]:
                    self._answered("download", self.client.get(f"/results/{one['result']}"), {200})
        for path in (f"/videos/{video['id']}", f"/references/{reference['id']}"):
            self._answered("delete", self.client.delete(f"{path}?cancel_jobs=true"), {204})

    def _sent(self, path: str, content: bytes) -> dict[str, str]:
        answer = self.client.post(path, content=content)
        self._answered("upload", answer, {200, 202})
        body: dict[str, str] = answer.json()
        return body

    def _finished(self, job: str) -> dict[str, Any]:
        until = time.monotonic() + 300
        while True:
            body: dict[str, Any] = self.client.get(f"/jobs/{job}?wait=10").json()
            if body["done"] or time.monotonic() > until:
                return body

    def _answered(self, what: str, answer: httpx.Response, wanted: set[int]) -> bool:
        self.done[what] += 1
        if answer.status_code not in wanted:
            self.wrong[f"{what}: {answer.status_code} {answer.text[:120]}"] += 1
        return answer.status_code in wanted


def soak(seconds: float, every_s: float, interval_s: float = 1.0) -> tuple[list[Slope], Work]:
    """Work for so long, a round begun every every_s seconds or when the last is done; the slopes, and what was done."""
    times: list[float] = []
    taken: list[dict[tuple[str, str], float]] = []
    over = threading.Event()
    with tempfile.TemporaryDirectory(prefix="pvg-soak-") as folder, served(Path(folder)) as client:
        work = Work(client, fetch_samples())
        began = time.monotonic()

        def sample() -> None:
            while not over.wait(interval_s):
                times.append(time.monotonic() - began)
                taken.append(look(Path(folder)))

        sampler = threading.Thread(target=sample)
        sampler.start()
        try:
            number = 0
            while (now := time.monotonic() - began) < seconds:
                work.round(number)
                number += 1
                time.sleep(max(0.0, now + every_s - (time.monotonic() - began)))
        finally:
            over.set()
            sampler.join()
    kept = [k for k, at in enumerate(times) if at >= WARM_UP * seconds]
    names = list(dict.fromkeys(name for k in kept for name in taken[k]))
    at = np.array([times[k] for k in kept])
    return [fitted(*name, at, np.array([taken[k].get(name, 0.0) for k in kept])) for name in names], work


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.soak", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--every", type=float, default=5.0, help="seconds from the start of a round to the next")
    parser.add_argument("--json", type=Path, help="write the slopes to this file as well")
    given = parser.parse_args()
    slopes, work = soak(60 * given.minutes, given.every)
    for line in report(slopes, work):
        print(line)
    if given.json:
        given.json.write_text(json.dumps([vars(slope) for slope in slopes], indent=1))
    return 1 if work.wrong or any(slope.verdict == "GROWS" for slope in slopes) else 0


def report(slopes: list[Slope], work: Work) -> Iterator[str]:
    """The table of slopes with a verdict each, what was done, and what was answered wrongly."""
    yield f"{'quantity':20} {'first':>9} {'last':>9} {'per hour':>10} {'± (1 σ)':>9} {'allowed':>8}  verdict"
    for one in slopes:
        yield (
            f"{one.name:20} {one.first:9.1f} {one.last:9.1f} {one.per_hour:10.1f} {one.error:9.1f} "
            f"{ALLOWED[one.unit]:8.0f}  {one.verdict}"
        )
    yield "done: " + ", ".join(f"{count} {what}" for what, count in sorted(work.done.items()))
    yield from (f"WRONG {count} times: {what}" for what, count in work.wrong.items())


if __name__ == "__main__":
    sys.exit(main())
