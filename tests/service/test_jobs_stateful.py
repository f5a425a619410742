"""Any order of claims, beats, crashes, cancels and late workers keeps the promises of the state machine."""

from __future__ import annotations

import tempfile
from pathlib import Path

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import Bundle, RuleBasedStateMachine, initialize, invariant, multiple, rule

from service.catalog import jobs
from service.catalog.database import Database
from service.catalog.jobs import Lease, Progress
from service.catalog.migrate import migrate
from service.catalog.models import ENDED, Job, JobState
from tests.service.fixtures import FakeClock, add_media

LEASE_S = 30
MAX_ATTEMPTS = 3
PROBLEM = {"type": "media-invalid", "title": "t", "detail": "d"}


class JobMachine(RuleBasedStateMachine):
    """One job, and every worker that ever held it."""

    leases = Bundle("leases")

    @initialize()
    def start(self) -> None:
        self.folder = tempfile.TemporaryDirectory()
        self.clock = FakeClock()
        url = f"sqlite:///{Path(self.folder.name) / 'catalog.sqlite3'}"
        migrate(url)
        self.database = Database(url, clock=self.clock)
        self.job_id = add_media(self.database).job_id
        self.ended: tuple[str, object] | None = None
        self.last_attempt = 1
        self.successes = 0

    def teardown(self) -> None:
        if hasattr(self, "database"):
            self.database.close()
            self.folder.cleanup()

    def job(self) -> Job:
        with self.database.read() as session:
            job = jobs.get(session, self.job_id)
        assert job is not None
        return job

    def holds(self, lease: Lease) -> bool:
        job = self.job()
        return job.lease_token == lease.token

    @rule(target=leases)
    def claim(self) -> object:
        before = self.job().state
        with self.database.write() as session:
            lease = jobs.claim(session, self.job_id, now=self.clock(), lease_s=LEASE_S)
        assert (lease is not None) == (before == JobState.QUEUED)
        return lease if lease is not None else multiple()

    @rule(lease=leases)
    def beat(self, lease: Lease) -> None:
        held = self.holds(lease)
        with self.database.write() as session:
            state = jobs.renew(session, lease, now=self.clock(), lease_s=LEASE_S)
        assert (state is not None) == held

    @rule(lease=leases, fraction=st.floats(0, 1))
    def report(self, lease: Lease, fraction: float) -> None:
        held = self.holds(lease)
        with self.database.write() as session:
            assert jobs.report(session, lease, Progress("skin", fraction, 1, 2), now=self.clock()) == held

    @rule(lease=leases, good=st.booleans())
    def end(self, lease: Lease, good: bool) -> None:
        may = self.holds(lease) and self.job().state == JobState.RUNNING
        with self.database.write() as session:
            if good:
                done = jobs.succeed(session, lease, now=self.clock(), timings={})
                self.successes += done
            else:
                done = jobs.fail(session, lease, PROBLEM, now=self.clock(), timings={})
        assert done == may

    @rule(lease=leases)
    def confirm_cancel(self, lease: Lease) -> None:
        may = self.holds(lease) and self.job().state == JobState.CANCELING
        with self.database.write() as session:
            assert jobs.confirm_cancel(session, lease, now=self.clock()) == may

    @rule()
    def cancel(self) -> None:
        may = self.job().state in {JobState.QUEUED, JobState.RUNNING}
        with self.database.write() as session:
            assert jobs.cancel(session, self.job_id, now=self.clock()) == may

    @rule(seconds=st.sampled_from([5, LEASE_S + 1]))
    def reap(self, seconds: int) -> None:
        self.clock.forward(seconds)
        with self.database.write() as session:
            again = jobs.reap(session, now=self.clock(), max_attempts=MAX_ATTEMPTS)
        assert [message.job_id for message in again] == ([self.job_id] if again else [])
        assert not again or self.job().state == JobState.QUEUED

    @invariant()
    def promises_hold(self) -> None:
        if not hasattr(self, "database"):
            return
        job = self.job()
        assert job.attempt >= self.last_attempt
        self.last_attempt = job.attempt
        held = job.state in {JobState.RUNNING, JobState.CANCELING}
        assert (job.lease_token is not None) == held == (job.lease_expires_at is not None)
        assert (job.finished_at is not None) == (job.state in ENDED)
        assert (job.error is not None) == (job.state in ENDED and job.state != JobState.SUCCEEDED)
        assert self.successes == (job.state == JobState.SUCCEEDED)
        if self.ended is not None:
            assert (job.state, job.finished_at) == self.ended
        elif job.state in ENDED:
            self.ended = (job.state, job.finished_at)


JobMachine.TestCase.settings = settings(
    max_examples=25, stateful_step_count=20, deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
TestJobMachine = JobMachine.TestCase
