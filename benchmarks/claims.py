"""`python -m benchmarks.claims postgresql://…`: how many jobs a second the records can hand out.

The database is migrated first, and left with the jobs in it: give it an empty one. Threads take what a worker takes
from the records for one short job: a claim, a report of progress, a look whether it is canceled, the end.
"""

from __future__ import annotations

import argparse
import statistics
import threading
import time
from dataclasses import dataclass, field

from service.catalog import Database, JobKind, Progress, Role, VectorizeRequest, fairness, jobs, leases
from service.catalog.migrations import migrate

_LEASE_S = 30.0


@dataclass
class _Taken:
    """Seconds of each step, of all threads."""

    claims: list[float] = field(default_factory=list)
    reports: list[float] = field(default_factory=list)
    ends: list[float] = field(default_factory=list)


def fill(database: Database, count: int, owners: int) -> list[str]:
    """Queue so many jobs of so many keys."""
    made = []
    with database.write() as session:
        now = database.now()
        for number in range(count):
            request = VectorizeRequest(Role.VIDEO)
            job = jobs.create(session, JobKind.VECTORIZE, request=request, now=now, owner=f"key_{number % owners}")
            made.append(job.id)
    return made


def work(database: Database, ids: list[str], taken: _Taken, left: threading.Semaphore) -> None:
    """Take and end jobs as long as there are some for this run."""
    while left.acquire(blocking=False):
        job_id = ids.pop()
        began = time.perf_counter()
        with database.write() as session:
            claimed = fairness.claim(session, job_id, now=database.now(), lease_s=_LEASE_S)
        claim = time.perf_counter()
        if claimed is None:
            continue
        with database.write() as session:
            leases.report(session, claimed.lease, Progress("render", 0.5, 1, 2), now=database.now())
        with database.read() as session:
            leases.held_state(session, claimed.lease)
        report = time.perf_counter()
        with database.write() as session:
            leases.succeed(session, claimed.lease, now=database.now(), timings={})
        taken.claims.append(claim - began)
        taken.reports.append(report - claim)
        taken.ends.append(time.perf_counter() - report)


def run(database: Database, ids: list[str], *, threads: int, count: int) -> None:
    """Have so many threads do so many of the queued jobs, and print a line."""
    queued, taken, left = len(ids), _Taken(), threading.Semaphore(count)
    workers = [threading.Thread(target=work, args=(database, ids, taken, left)) for _ in range(threads)]
    began = time.perf_counter()
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    rate = len(taken.claims) / (time.perf_counter() - began)
    claim, report, end = (1e3 * statistics.median(values) for values in (taken.claims, taken.reports, taken.ends))
    print(f"{queued:7d} {threads:8d} {rate:10.1f} {claim:9.1f} {report:9.1f} {end:9.1f}", flush=True)


def main() -> None:
    """Measure with a short queue and a long one."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.claims", description=__doc__)
    parser.add_argument("database", help="an empty database's URL")
    parser.add_argument("--count", type=int, default=300, help="jobs to be done in each run")
    parser.add_argument("--keys", type=int, default=50, help="of whom the jobs are")
    options = parser.parse_args()
    migrate(options.database)
    database = Database(options.database)
    ids: list[str] = []
    print(" queued  workers     jobs/s  claim ms report ms    end ms")
    for queued, threads in ((500, 1), (500, 8), (10_000, 1), (10_000, 8)):
        ids += fill(database, queued - len(ids), options.keys)
        run(database, ids, threads=threads, count=options.count)


if __name__ == "__main__":
    main()
