"""Any order of claims, beats, crashes, cancels and late workers takes the steps of the table and no others."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from datetime import timedelta
from functools import partial
from pathlib import Path
from typing import Any

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import Bundle, RuleBasedStateMachine, initialize, invariant, multiple, rule
from sqlalchemy.orm import Session

from service.catalog import (
    ENDED,
    Asset,
    Database,
    Job,
    JobState,
    Lease,
    Media,
    MediaState,
    Progress,
    jobs,
    leases,
    media,
)
from service.catalog.transitions import JOB_TRANSITIONS, LeaseCheck, LeaseEffect, Step
from tests.service.fixtures import FakeClock, add_media, add_transfer, announce, job_of, make_tables

LEASE_S = 30
MAX_ATTEMPTS = 3
MAX_QUEUED_S = 100
PROBLEM = {"type": "media-invalid", "title": "t", "detail": "d"}


class JobMachine(RuleBasedStateMachine):
    """One job, the medium it makes or waits for, and every worker that ever held it."""

    leases = Bundle("leases")

    @initialize(waits=st.booleans())
    def start(self, waits: bool) -> None:
        self.folder = tempfile.TemporaryDirectory()
        self.clock = FakeClock()
        url = f"sqlite:///{Path(self.folder.name) / 'catalog.sqlite3'}"
        make_tables(url)
        self.database = Database(url, clock=self.clock)
        medium = add_media(self.database)
        self.media_id = medium.id
        self.waits = waits
        self.job_id = add_transfer(self.database, medium, medium) if waits else medium.job_id
        self.ended: tuple[str, object] | None = None
        self.last_attempt = 1
        self.successes = 0

    def teardown(self) -> None:
        if hasattr(self, "database"):
            self.database.close()
            self.folder.cleanup()

    def job(self) -> Job:
        return job_of(self.database, self.job_id)

    def medium(self) -> Media:
        with self.database.read() as session:
            medium = media.get(session, self.media_id)
        assert medium is not None
        return medium

    def allows(self, step: Step, job: Job, lease: Lease | None) -> bool:
        """Whether the table lets the step be taken from where the job is."""
        row = JOB_TRANSITIONS[step]
        free = row.check is not LeaseCheck.FREE or job.lease_token is None
        held = row.check is not LeaseCheck.HELD or (lease is not None and job.lease_token == lease.token)
        lapsed = row.check is not LeaseCheck.LAPSED or (
            job.lease_expires_at is not None and job.lease_expires_at < self.clock()
        )
        return job.state in row.sources and row.waiting in (None, job.waiting) and held and lapsed and free

    def take(
        self, steps: Sequence[Step], call: Callable[[Session], Any], *, lease: Lease | None = None, may: bool = True
    ) -> Any:
        """Run a call that is to take the first of these steps that is allowed, if it may, and check what it did."""
        before = self.job()
        with self.database.write() as session:
            answer = call(session)
        after = self.job()
        step = next((step for step in steps if may and self.allows(step, before, lease)), None)
        assert bool(answer) == (step is not None), (steps, step, answer)
        if step is None:
            assert (after.state, after.lease_token, after.updated_at) == (
                before.state,
                before.lease_token,
                before.updated_at,
            )
            return answer
        row = JOB_TRANSITIONS[step]
        assert after.state == (row.target or before.state), step
        if row.effect is LeaseEffect.NONE:
            assert after.lease_token == before.lease_token
        elif row.effect is LeaseEffect.DROPPED:
            assert after.lease_token is None
        else:
            assert after.lease_expires_at == self.clock() + timedelta(seconds=LEASE_S)
        assert (after.lease_token == before.lease_token) or row.effect in {LeaseEffect.DROPPED, LeaseEffect.GRANTED}
        return answer

    @rule(target=leases)
    def claim(self) -> object:
        lease = self.take([Step.CLAIM], lambda s: leases.claim(s, self.job_id, now=self.clock(), lease_s=LEASE_S))
        return lease if lease is not None else multiple()

    @rule(lease=leases)
    def beat(self, lease: Lease) -> None:
        self.take([Step.RENEW], lambda s: leases.renew(s, lease, now=self.clock(), lease_s=LEASE_S), lease=lease)

    @rule(lease=leases, fraction=st.floats(0, 1))
    def report(self, lease: Lease, fraction: float) -> None:
        progress = Progress("skin", fraction, 1, 2)
        self.take([Step.REPORT], lambda s: leases.report(s, lease, progress, now=self.clock()), lease=lease)

    @rule(lease=leases, good=st.booleans())
    def end(self, lease: Lease, good: bool) -> None:
        if not good:
            self.take([Step.FAIL], lambda s: leases.fail(s, lease, PROBLEM, now=self.clock(), timings={}), lease=lease)
        elif self.waits:
            succeed = partial(leases.succeed, lease=lease, now=self.clock(), timings={})
            self.successes += bool(self.take([Step.SUCCEED], succeed, lease=lease))
        else:
            asset = Asset("asset/x", 1, {}, [], [])
            finish = partial(media.finish, lease=lease, asset=asset, now=self.clock(), timings={})
            with self.database.write() as session:
                announce(session, "asset/x")
            self.successes += bool(self.take([Step.SUCCEED], lambda s: finish(s) is not None, lease=lease))

    @rule(lease=leases)
    def confirm_cancel(self, lease: Lease) -> None:
        self.take([Step.CONFIRM_CANCEL], lambda s: leases.confirm_cancel(s, lease, now=self.clock()), lease=lease)

    @rule(lease=leases)
    def give_back(self, lease: Lease) -> None:
        before = self.job().attempt
        self.take([Step.GIVE_BACK], lambda s: leases.give_back(s, lease, now=self.clock()), lease=lease)
        assert self.job().attempt == before

    @rule()
    def cancel(self) -> None:
        steps = [Step.CANCEL_QUEUED, Step.REQUEST_CANCEL]
        self.take(steps, lambda s: jobs.cancel(s, self.job_id, now=self.clock()))

    @rule()
    def revoke(self) -> None:
        self.take([Step.REVOKE], lambda s: jobs.revoke(s, self.job_id, now=self.clock()))

    @rule()
    def publish(self) -> None:
        published = self.job().published_at
        with self.database.write() as session:
            jobs.mark_published(session, self.job_id, now=self.clock())
        after = self.job()
        assert after.published_at == (self.clock() if self.allows(Step.PUBLISH, after, None) else published)

    @rule(good=st.booleans())
    def end_medium(self, good: bool) -> None:
        """The vectorisation that a transfer waits for comes to its end."""
        if not self.waits or self.medium().state != MediaState.VECTORIZING:
            return
        with self.database.write() as session:
            lease = leases.claim(session, self.medium().job_id, now=self.clock(), lease_s=LEASE_S)
            assert lease is not None
            if good:
                asset = Asset("asset/x", 1, {}, [], [])
                announce(session, "asset/x")
                assert media.finish(session, lease, asset, now=self.clock(), timings={}) == []
            else:
                assert leases.fail(session, lease, PROBLEM, now=self.clock(), timings={})

    @rule()
    def release(self) -> None:
        state, waits = self.medium().state, self.job().waiting
        if state == MediaState.FAILED and waits:
            self.take([Step.FAIL_WAITING], lambda s: jobs.release(s, now=self.clock()) == [])
            return
        self.take([Step.RELEASE], partial(jobs.release, now=self.clock()), may=state == MediaState.READY)

    @rule(seconds=st.sampled_from([5, LEASE_S + 1]))
    def reap(self, seconds: int) -> None:
        self.clock.forward(seconds)
        before = self.job()
        last = before.attempt >= MAX_ATTEMPTS
        steps = [Step.REAP_CANCELED, Step.GIVE_UP if last else Step.REQUEUE]

        def reap(session: Session) -> bool:
            again = leases.reap(session, now=self.clock(), max_attempts=MAX_ATTEMPTS)
            assert [message.job_id for message in again] == ([self.job_id] if again else [])
            job = session.get_one(Job, self.job_id)
            assert bool(again) == (job.state == JobState.QUEUED and before.state == JobState.RUNNING)
            return job.state != before.state

        self.take(steps, reap)

    @rule(seconds=st.sampled_from([0, MAX_QUEUED_S + 1]))
    def expire(self, seconds: int) -> None:
        self.clock.forward(seconds)
        late = self.clock() - timedelta(seconds=MAX_QUEUED_S)
        queued_at = self.job().queued_at

        def expire(session: Session) -> bool:
            jobs.expire(session, before=late, now=self.clock())
            job = session.get_one(Job, self.job_id)
            return job.finished_at == self.clock() and job.state == JobState.EXPIRED

        if self.ended is None:
            self.take([Step.EXPIRE], expire, may=queued_at < late)

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
        if not self.waits:  # a medium follows the job that vectorises it
            state = {JobState.SUCCEEDED: MediaState.READY}.get(JobState(job.state), MediaState.FAILED)
            assert self.medium().state == (state if job.state in ENDED else MediaState.VECTORIZING)


JobMachine.TestCase.settings = settings(
    max_examples=40, stateful_step_count=25, deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
TestJobMachine = JobMachine.TestCase
