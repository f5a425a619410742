"""The tables of the state machines, the statement that obeys them, and the pages and comments that repeat them."""

from __future__ import annotations

import inspect
import re
from datetime import timedelta
from itertools import product
from pathlib import Path

import pytest
from sqlalchemy import update

from service.catalog import Database, Job, JobState, Lease, Media, MediaState
from service.catalog.models import ENDED, HELD
from service.catalog.transitions import (
    JOB_TRANSITIONS,
    MEDIA_TRANSITIONS,
    LeaseCheck,
    LeaseEffect,
    MediaStep,
    Step,
    as_markdown,
    take_media_step,
    take_step,
)
from tests.service.fixtures import FakeClock, add_media, job_of

OPERATIONS = Path(__file__).parents[3] / "docs" / "operations.md"
PROBLEM = {"type": "no-face", "title": "No face was found", "detail": "no face found"}


def edges() -> dict[str, set[str]]:
    """Where a step leads from each state; steps that leave it alone do not count."""
    found: dict[str, set[str]] = {state.value: set() for state in JobState}
    for row in JOB_TRANSITIONS.values():
        for source in row.sources:
            if row.target is not None:
                found[source.value].add(row.target.value)
    return found


def test_a_job_goes_these_ways_and_no_other() -> None:
    assert edges() == {
        "queued": {"queued", "running", "failed", "canceled", "expired"},
        "running": {"queued", "canceling", "succeeded", "failed", "canceled", "expired"},
        "canceling": {"canceled"},
        "succeeded": set(),
        "failed": set(),
        "canceled": set(),
        "expired": set(),
    }


def test_a_medium_goes_these_ways_and_no_other() -> None:
    assert {(row.source, row.target) for row in MEDIA_TRANSITIONS.values()} == {
        ("vectorizing", "ready"),
        ("vectorizing", "failed"),
        ("failed", "vectorizing"),
        ("ready", "vectorizing"),
    }


def test_every_step_has_its_row_and_every_state_can_be_reached() -> None:
    assert set(JOB_TRANSITIONS) == set(Step)
    assert set(MEDIA_TRANSITIONS) == set(MediaStep)
    assert {row.target for row in JOB_TRANSITIONS.values()} >= set(JobState)


def test_leases_follow_the_states() -> None:
    """A job has a lease while it is held: steps into that give one, steps out of it take it away.

    One that is being done in parts has none, and is ended by steps of its own.
    """
    for row in JOB_TRANSITIONS.values():
        if row.target is None or row.target in HELD or row.check is LeaseCheck.FREE:
            continue
        assert (row.effect is LeaseEffect.DROPPED) == bool(set(row.sources) & set(HELD)), row
    assert [row.step for row in JOB_TRANSITIONS.values() if row.effect is LeaseEffect.GRANTED] == [Step.CLAIM]


@pytest.mark.parametrize("states", [JobState, MediaState])
def test_the_comments_of_the_states_say_what_the_tables_say(states: type[JobState] | type[MediaState]) -> None:
    expected = edges()
    if states is MediaState:
        expected = {state.value: set() for state in MediaState}
        for row in MEDIA_TRANSITIONS.values():
            expected[row.source.value].add(row.target.value)
    said = {}
    for value, comment in re.findall(r'^ +[A-Z]+ = "(\w+)"(?:  # -> (.*))?$', inspect.getsource(states), re.MULTILINE):
        said[value] = {part.strip() for part in re.sub(r"\([^)]*\)", "", comment).split(",")} - {""}
    assert said == expected


def test_the_tables_are_in_the_documentation_as_they_are() -> None:
    assert f"\n{as_markdown()}\n" in OPERATIONS.read_text()


def put(database: Database, job_id: str, **values: object) -> None:
    with database.write() as session:
        session.execute(update(Job).where(Job.id == job_id).values(**values))


@pytest.mark.parametrize("step", Step)
def test_a_step_is_taken_exactly_where_its_row_allows(database: Database, clock: FakeClock, step: Step) -> None:
    row = JOB_TRANSITIONS[step]
    job_id = add_media(database).job_id
    tokens, expiries = ("mine", "another's", None), (-1, 1)
    taken = 0
    for state, waiting, token, expires in product(JobState, (False, True), tokens, expiries):
        clock.forward(1)
        put(
            database,
            job_id,
            state=state,
            waiting=waiting,
            lease_token=token,
            lease_expires_at=clock() + timedelta(seconds=expires),
            finished_at=None,
        )
        allowed = state in row.sources and row.waiting in (None, waiting)
        allowed &= {LeaseCheck.NONE: True, LeaseCheck.FREE: token is None}.get(row.check, token == "mine")
        allowed &= row.check is not LeaseCheck.LAPSED or expires < 0
        with database.write() as session:
            lease = Lease(job_id, "mine")
            assert take_step(session, step, job_id, now=clock(), lease=lease, lease_s=60) == allowed
        job = job_of(database, job_id)
        taken += allowed
        if not allowed:
            assert (job.state, job.lease_token) == (state, token)
            assert job.updated_at < clock()
            continue
        assert job.state == (row.target or state)
        assert job.updated_at == clock()
        assert (job.finished_at == clock()) == (job.state in ENDED)
        assert (job.queued_at == clock()) == (row.target is JobState.QUEUED)
        assert job.lease_token == {LeaseEffect.DROPPED: None, LeaseEffect.GRANTED: "mine"}.get(row.effect, token)
        if row.effect in (LeaseEffect.GRANTED, LeaseEffect.PROLONGED):
            assert job.lease_expires_at == clock() + timedelta(seconds=60)
    assert taken > 0


def test_a_condition_of_the_caller_is_checked_in_the_same_statement(database: Database, clock: FakeClock) -> None:
    job_id = add_media(database).job_id
    with database.write() as session:
        early = Job.queued_at < clock() - timedelta(seconds=1)
        assert not take_step(session, Step.EXPIRE, job_id, now=clock(), only_if=early)
        assert take_step(session, Step.EXPIRE, job_id, now=clock(), only_if=Job.queued_at <= clock())


@pytest.mark.parametrize("step", MediaStep)
@pytest.mark.parametrize("state", MediaState)
def test_a_medium_changes_exactly_where_its_row_allows(
    database: Database, clock: FakeClock, step: MediaStep, state: MediaState
) -> None:
    row = MEDIA_TRANSITIONS[step]
    medium, other = add_media(database), add_media(database)
    with database.write() as session:
        session.execute(update(Media).values(state=state))
    with database.write() as session:
        taken = take_media_step(session, step, medium.job_id, now=clock(), values={"error": PROBLEM})
    assert taken == (state is row.source)
    with database.read() as session:
        changed, untouched = session.get(Media, medium.id), session.get(Media, other.id)
    assert changed is not None
    assert untouched is not None
    assert (changed.state, changed.error) == ((row.target, PROBLEM) if taken else (state, None))
    assert (untouched.state, untouched.error) == (state, None)
