from __future__ import annotations

from collections.abc import Callable
from datetime import timedelta

import pytest

from service.catalog import Database, jobs, leases, utc_now
from service.catalog.migrations import migrate
from tests.promises import Drill
from tests.service.fixtures import add_media, claim
from tests.service.servers import fresh_database


@pytest.mark.parametrize("off_s", [-60, 60])
def test_a_machine_whose_clock_is_off_burns_no_attempt_and_steals_no_job(
    postgres_url: str, monkeypatch: pytest.MonkeyPatch, promise: Callable[..., Drill], off_s: int
) -> None:
    """On the far side of every call stands the server's clock, here this machine's true one."""
    drill = promise("R21", wanted="no attempt burnt, no twin render")
    with fresh_database(postgres_url) as url:
        migrate(url)
        database = Database(url)
        with monkeypatch.context() as patch:
            wrong = utc_now() + timedelta(seconds=off_s)
            patch.setattr("service.catalog.clock.utc_now", lambda: wrong)
            patch.setattr("service.catalog.database.utc_now", lambda: wrong)
            assert abs((database.now() - utc_now()).total_seconds()) < 30
            off = Database(url)
            job_id = add_media(off).job_id
            lease = claim(off, job_id)
        with database.write() as session:  # an API whose clock is right
            assert leases.reap(session, now=database.now(), max_attempts=3) == []
        theirs = claim(database, add_media(database).job_id)
        with off.write() as session:  # and one whose clock is not
            assert leases.reap(session, now=off.now(), max_attempts=3) == []
            assert leases.renew(session, lease, now=off.now(), lease_s=30)
            assert leases.held_state(session, theirs) is not None
            held = jobs.get(session, lease.job_id)
        assert held is not None
        drill.measured = f"{off_s:+d} s: attempt {held.attempt}, leases of both kept"
        off.close()
        database.close()
