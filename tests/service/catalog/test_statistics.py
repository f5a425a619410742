from __future__ import annotations

from datetime import timedelta

from service.catalog import Database, statistics, workers
from tests.service.fixtures import add_media, add_transfer, claim


def test_what_there_is_is_counted_on_each_engine(database: Database) -> None:
    medium = add_media(database)
    add_transfer(database, medium, medium)
    lease = claim(database, medium.job_id)
    now = database.now()
    with database.write() as session:
        workers.beat(session, "one", now=now)
        workers.beat(session, "two", now=now, lacks="weights")
        workers.beat(session, "three", now=now, kind="previews")
    with database.read() as session:
        found = statistics.collect(session, now=now, alive_since=now - timedelta(seconds=15))
    assert lease.job_id == medium.job_id
    assert dict(found.active) == {("vectorize", "running"): 1, ("render", "waiting"): 1}
    assert found.workers == {"": 1, "weights": 1}  # those of jobs
    assert found.stored["source"] == medium.size_bytes
