from __future__ import annotations

import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime, timedelta
from functools import partial

import pytest
from alembic import command
from alembic.autogenerate import compare_metadata
from alembic.runtime.migration import MigrationContext
from sqlalchemy import inspect, text, update
from sqlalchemy.exc import IntegrityError, OperationalError

from service.catalog import (
    Asset,
    Database,
    Job,
    Lease,
    Media,
    Output,
    PartOf,
    Role,
    VectorSettings,
    jobs,
    leases,
    ledger,
    media,
    results,
    resumable,
    webhooks,
)
from service.catalog.database import make_engine
from service.catalog.migrations import _config, is_current, migrate, migrate_to
from service.catalog.models import Base, IdempotentRequest, Result, WebhookSecret
from tests.service.catalog.test_ledger import ask, draw, ready
from tests.service.catalog.test_parts import draw_all, split
from tests.service.fixtures import FakeClock, add_media, add_transfer, announce, claim
from tests.service.servers import fresh_database
from tests.waiting import until


@pytest.fixture
def database(own_database: Database) -> Database:
    return own_database


def test_the_migrations_make_the_tables_of_the_models(database: Database) -> None:
    engine = make_engine(database.url)
    with engine.connect() as connection:
        context = MigrationContext.configure(connection, opts={"compare_type": True})
        assert compare_metadata(context, Base.metadata) == []
    engine.dispose()
    assert is_current(database.url)


def test_migrating_again_changes_nothing_and_down_removes_everything(database: Database) -> None:
    migrate(database.url)
    assert is_current(database.url)
    command.downgrade(_config(database.url), "base")
    engine = make_engine(database.url)
    assert inspect(engine).get_table_names() == ["alembic_version"]
    engine.dispose()


def test_who_migrates_waits_for_another_as_long_as_it_takes(
    database: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Longer than anybody else waits for a lock: tables may be large."""
    if database.url.startswith("sqlite"):
        pytest.skip("SQLite's writers wait by themselves")
    monkeypatch.setattr("service.catalog.database.make_engine", partial(make_engine, lock_wait_s=0.2))
    first = make_engine(database.url)
    waiting = text("SELECT count(*) FROM pg_locks WHERE locktype = 'advisory' AND NOT granted")
    with ThreadPoolExecutor() as pool:
        with first.begin() as connection:
            connection.execute(text("SELECT pg_advisory_xact_lock(7301984)"))
            second = pool.submit(migrate, database.url)
            until(lambda: second.done() or connection.execute(waiting).scalar_one(), 120)
            time.sleep(1)
            assert not second.done(), "it waits for its turn"
        second.result(120)
    first.dispose()


def _locks(url: str, *, granted: bool) -> list[str]:
    """Of whom the locks of `parts` are, or who waits for one."""
    engine = make_engine(url)
    query = text("SELECT mode FROM pg_locks WHERE relation = 'parts'::regclass AND granted = :granted")
    with engine.connect() as connection:
        found = list(connection.scalars(query, {"granted": granted}))
    engine.dispose()
    return found


def test_who_migrates_beside_a_backup_keeps_nobody_else_from_the_tables(
    postgres_url: str, postgres_tables: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr("service.catalog.migrations._PAUSE_S", 0.2)
    with fresh_database(postgres_url, postgres_tables) as url, ThreadPoolExecutor() as pool:
        command.downgrade(_config(url), "0018")
        dump, other = make_engine(url), make_engine(url, lock_wait_s=10)
        with dump.begin() as backup:
            backup.execute(text("LOCK TABLE parts IN ACCESS SHARE MODE"))  # as pg_dump does, until its end
            migrated = pool.submit(migrate, url)
            for _ in range(2):
                until(lambda: migrated.done() or "AccessExclusiveLock" in _locks(url, granted=False), 120)
                with other.connect() as reader:
                    reader.execute(text("SELECT count(*) FROM parts"))
            assert not migrated.done(), "the backup goes on"
        migrated.result(120)
        assert is_current(url)
        dump.dispose()
        other.dispose()
    assert "others use the tables" in caplog.text


def test_who_migrates_does_not_wait_for_others_without_end(
    postgres_url: str, postgres_tables: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("service.catalog.migrations._PATIENCE_S", 0.0)
    with fresh_database(postgres_url, postgres_tables) as url:
        engine = make_engine(url)
        with engine.begin() as backup:
            backup.execute(text("LOCK TABLE parts IN ACCESS SHARE MODE"))
            with pytest.raises(OperationalError, match="lock timeout"):
                migrate_to(url, "0018")
        engine.dispose()
        assert is_current(url)


def test_several_processes_may_migrate_at_once(database: Database) -> None:
    command.downgrade(_config(database.url), "base")
    code = "import sys; from service.catalog.migrations import migrate; migrate(sys.argv[1])"
    started = [subprocess.Popen([sys.executable, "-c", code, database.url]) for _ in range(3)]
    assert [process.wait(180) for process in started] == [0, 0, 0]
    assert is_current(database.url)


def rows(database: Database, query: str) -> list[tuple[object, ...]]:
    with database.read() as session:
        return [tuple(row) for row in session.execute(text(query)).all()]


def test_jobs_of_the_former_version_know_when_they_were_queued(database: Database, clock: FakeClock) -> None:
    medium, other = add_media(database), add_media(database)
    waiting = add_transfer(database, medium, medium)
    clock.forward(100)
    with database.write() as session:  # one of them is queued again after its worker was lost
        lease = leases.claim(session, medium.job_id, now=clock(), lease_s=1)
        running = leases.claim(session, other.job_id, now=clock(), lease_s=1000)
    assert isinstance(lease, Lease)
    assert running is not None
    clock.forward(100)
    with database.write() as session:
        assert len(leases.reap(session, now=clock(), max_attempts=3)) == 1
    before = rows(database, "SELECT id, state, attempt, lease_token FROM jobs ORDER BY id")
    looks = rows(database, "SELECT job_id, position, video_id FROM looks")
    assert len(looks) == 1

    command.downgrade(_config(database.url), "0001")
    assert "queued_at" not in {column["name"] for column in inspect(database._engine).get_columns("jobs")}
    assert rows(database, "SELECT job_id, position, video_id FROM looks") == looks
    migrate(database.url)

    assert rows(database, "SELECT id, state, attempt, lease_token FROM jobs ORDER BY id") == before
    assert rows(database, "SELECT job_id, position, video_id FROM looks") == looks
    with database.read() as session:
        queued = {one: job.queued_at for one in (medium.job_id, waiting) if (job := jobs.get(session, one))}
    assert queued == {medium.job_id: clock(), waiting: clock() - timedelta(seconds=200)}
    engine = make_engine(database.url)
    names = {index["name"] for index in inspect(engine).get_indexes("jobs")}
    engine.dispose()
    assert names == {
        "ix_jobs_media_id",
        "ix_jobs_kind_state_finished_at_owner_id",
        "ix_jobs_owner_fingerprint_id",
        "ix_jobs_owner_id",
        "ix_jobs_owner_state_id",
        "ix_jobs_parent_id",
        "ix_jobs_queue_owner_started_at",
        "ix_jobs_queue_state_waiting_owner",
        "ix_jobs_state_lease_expires_at",
    }


def test_a_deleted_job_still_takes_its_looks_along_after_the_migrations(database: Database) -> None:
    medium = add_media(database)
    job_id = add_transfer(database, medium, medium)
    command.downgrade(_config(database.url), "0001")
    migrate(database.url)
    with database.write() as session:
        session.execute(text("DELETE FROM jobs WHERE id = :id"), {"id": job_id})
    assert rows(database, "SELECT job_id FROM looks") == []


def test_media_of_the_former_version_have_its_settings_and_others_may_stand_beside_them(database: Database) -> None:
    papers = VectorSettings(mask="ycbcr", matching="chain")
    medium = add_media(database, content=b"clip")
    other = add_media(database, content=b"clip", settings=papers)
    job_id = add_transfer(database, medium, medium)
    with pytest.raises(IntegrityError):
        add_media(database, content=b"clip", settings=papers)
    command.downgrade(_config(database.url), "0002")
    assert rows(database, "SELECT id, sha256 FROM media") == [(medium.id, medium.sha256)]
    assert rows(database, "SELECT job_id FROM looks") == [(job_id,)]
    migrate(database.url)
    assert rows(database, "SELECT id, mask, matching FROM media") == [(medium.id, "landmarks", "table")]
    assert rows(database, "SELECT report FROM looks") == [(None,)]
    again = add_media(database, content=b"clip", settings=papers)
    assert again.id != other.id
    with database.read() as session:
        for one, settings in ((medium, VectorSettings()), (again, papers)):
            found = media.find_content(session, Role.VIDEO, medium.sha256, settings)
            assert found is not None
            assert found.id == one.id


def test_media_of_a_version_without_input_colors_have_that_of_their_tags(database: Database) -> None:
    log = VectorSettings(input_color="slog3")
    medium = add_media(database, content=b"clip")
    add_media(database, content=b"clip", settings=log)
    command.downgrade(_config(database.url), "0003")
    assert rows(database, "SELECT id FROM media") == [(medium.id,)]
    migrate(database.url)
    assert rows(database, "SELECT id, input_color FROM media") == [(medium.id, "auto")]
    again = add_media(database, content=b"clip", settings=log)
    with database.read() as session:
        found = media.find_content(session, Role.VIDEO, medium.sha256, log)
        assert found is not None
        assert found.id == again.id


def test_parts_of_results_are_unknown_to_a_version_without_them(database: Database) -> None:
    medium = add_media(database)
    job_id = add_transfer(database, medium, medium)
    vectorised = claim(database, medium.job_id)
    with database.write() as session:
        announce(session, "asset/x")
        assert media.finish(session, vectorised, Asset("asset/x", 1, {}, [], []), now=database.now(), timings={}) == []
    with database.write() as session:
        jobs.release(session, now=database.now())
    main = Output("res_1", 0, "result/1", "0" * 64, 1, "video/mp4", "a.mp4")
    cube = PartOf("res_1", "look.cube", 2)
    part = Output("res_2", 0, "result/2", "0" * 64, 1, "text/plain", "a.cube", part_of=cube)
    lease = claim(database, job_id)
    with database.write() as session:
        announce(session, main.key, part.key)
        assert results.publish(session, lease, [main, part], now=database.now(), timings={}, ttl_s=1)
    query = "SELECT id, part_of, part, person FROM results ORDER BY id"
    assert rows(database, query) == [("res_1", None, None, None), ("res_2", "res_1", "look.cube", 2)]
    command.downgrade(_config(database.url), "0004")
    assert rows(database, "SELECT id FROM results") == [("res_1",)]
    migrate(database.url)
    assert rows(database, query) == [("res_1", None, None, None)]
    engine = make_engine(database.url)
    assert "ix_results_part_of" in {index["name"] for index in inspect(engine).get_indexes("results")}
    engine.dispose()


def test_what_there_was_before_keys_belongs_to_nobody(database: Database) -> None:
    medium = add_media(database, content=b"clip")
    command.downgrade(_config(database.url), "0007")
    migrate(database.url)
    assert rows(database, "SELECT id, owner FROM media") == [(medium.id, "")]
    assert rows(database, "SELECT id, owner FROM jobs") == [(medium.job_id, "")]
    with database.read() as session:
        assert session.get_one(Media, medium.id).metadata_ == {}
    add_media(database, content=b"clip", owner="key_a")
    command.downgrade(_config(database.url), "0007")
    assert rows(database, "SELECT id FROM media") == [(medium.id,)]
    migrate(database.url)
    with pytest.raises(IntegrityError):
        add_media(database, content=b"clip")


def test_a_version_that_tells_a_receiver_once_keeps_the_first_delivery(database: Database) -> None:
    medium = add_media(database)
    with database.write() as session:
        session.execute(text("UPDATE jobs SET state = 'succeeded' WHERE id = :id"), {"id": medium.job_id})
    for url in ("https://a.example/", "https://a.example/", "https://b.example/"):
        with database.write() as session:
            webhooks.announce(session, session.get_one(Job, medium.job_id), url, now=database.now())
    told = "SELECT id, url FROM deliveries ORDER BY id"
    first, _, other = rows(database, told)
    command.downgrade(_config(database.url), "0016")
    assert rows(database, told) == [first, other]
    migrate(database.url)
    assert rows(database, told) == [first, other]


def test_a_version_of_one_former_secret_keeps_the_last_and_may_rotate_beside_others(
    database: Database, clock: FakeClock
) -> None:
    with database.write() as session:
        first = webhooks.secret(session, "", now=clock()).secret
        second = webhooks.rotate(session, "", now=clock()).secret
        third = webhooks.rotate(session, "", now=clock()).secret
    kept = "SELECT secret, former FROM webhook_secrets"
    assert rows(database, kept) == [(third, second)]
    with database.write() as session:  # as that version does, to these tables
        until = clock() + timedelta(seconds=webhooks.FORMER_SECRET_S)
        session.execute(update(WebhookSecret).values(former=third, former_until=until, secret="whsec_4"))
        assert webhooks.signing_secrets(session, "", now=clock()) == ("whsec_4", third, first)
    command.downgrade(_config(database.url), "0019")
    assert rows(database, kept) == [("whsec_4", third)]
    migrate(database.url)
    with database.write() as session:
        assert webhooks.signing_secrets(session, "", now=clock()) == ("whsec_4", third)
        fifth = webhooks.rotate(session, "", now=clock()).secret
        assert webhooks.signing_secrets(session, "", now=clock()) == (fifth, "whsec_4", third)


def test_looks_of_a_version_that_did_not_say_why_results_are_gone_say_it(database: Database) -> None:
    kept, late, deleted, failed = (add_media(database) for _ in range(4))
    made = []
    for medium in (kept, late, deleted):
        with database.write() as session:
            session.execute(text("UPDATE media SET state = 'ready' WHERE id = :id"), {"id": medium.id})
        job_id = add_transfer(database, medium, medium)
        with database.write() as session:
            jobs.release(session, now=database.now())
        made.append(job_id)
        output = Output(f"res_{medium.id}", 0, f"result/{medium.id}", "0" * 64, 1, "video/mp4", "a.mp4")
        lease = claim(database, job_id)
        with database.write() as session:
            announce(session, output.key)
            assert results.publish(session, lease, [output], now=database.now(), timings={}, ttl_s=1)
    made.append(add_transfer(database, failed, failed))
    with database.write() as session:
        result = results.get(session, f"res_{late.id}")
        assert result is not None
        results.drop_bytes(session, result, now=database.now())
        media.delete(session, session.get_one(Media, deleted.id), now=database.now())
    why = "SELECT job_id, result_gone FROM looks ORDER BY job_id"
    expected = list(zip(made, (None, "expired", "deleted", None), strict=True))
    assert rows(database, why) == expected
    command.downgrade(_config(database.url), "0013")
    migrate(database.url)
    assert rows(database, why) == expected


def test_months_are_counted_from_the_records_there_are(database: Database, clock: FakeClock) -> None:
    """As they are counted from then on; of a video that is gone only its frames are not known any more."""
    clock.time = datetime(2026, 11, 30, 23, 59, 59, 999_000, tzinfo=UTC)
    medium, gone = ready(database, "key_a"), ready(database)
    goes_on = ask(database, medium)
    split(database, goes_on, 3)
    in_parts = ask(database, medium, looks=2)
    join = draw_all(database, split(database, in_parts, 2))
    canceled = ask(database, medium)
    of_gone = ask(database, gone)
    assert draw(database, claim(database, of_gone))
    clock.forward(1)
    lease = claim(database, join)
    output = Output("res_a", 0, "result/a", "0" * 64, 1, "video/mp4", "a.mp4")
    with database.write() as session:
        announce(session, output.key)
        assert results.publish(session, lease, [output], now=clock(), timings={}, ttl_s=100)
        assert jobs.cancel(session, canceled, now=clock())
    with database.read() as session:
        before = ledger.every(session)
    assert [(owner, one.month, one.looks) for owner, one in before] == [
        *(("", "2026-11", 1), ("key_a", "2026-11", 0), ("key_a", "2026-12", 2))
    ]
    migrate_to(database.url, "0023")
    migrate(database.url)
    with database.read() as session:
        assert ledger.every(session) == before
    with database.write() as session:
        media.delete(session, session.get_one(Media, gone.id), now=clock())
    migrate_to(database.url, "0023")
    migrate(database.url)
    with database.read() as session:
        (_, first), *others = ledger.every(session)
    assert others == before[1:]
    assert (first.jobs, first.looks, first.frames, first.uploads) == ({"succeeded": 2}, 1, 0, 0)


#: columns of what clients say, and of their secrets, wherever they are
_SAID = ("filename", "said", "webhook", "url", "origin", "key", "secret", "former")


def _say(database: Database, number: int) -> None:
    """One row of each table that keeps what clients say, which is told by its mark."""
    now, said = database.now(), f"mark-{number}"
    medium = add_media(database, content=said.encode())
    with database.write() as session:
        session.execute(update(Media).where(Media.id == medium.id).values(filename=said))
        webhooks.announce(session, session.get_one(Job, medium.job_id), f"https://{said}/", now=now)
        resumable.create(
            session,
            *(Role.VIDEO, VectorSettings()),
            owner="",
            limit_bytes=1,
            now=now,
            ttl_s=1,
            filename=said,
            said=said,
            webhook=said,
        )
        kept = {"locked_until": now, "expires_at": now}
        session.add(IdempotentRequest(owner="", key=said, token=said, digest="", resource_id="", **kept))
        session.add(WebhookSecret(owner=f"key_{number}", secret=said, former=said, created_at=now))
        described = {"sha256": "", "size_bytes": 1, "content_type": "", "filename": said}
        of = {"job_id": "", "position": 0, "video_id": "", "reference_id": ""}
        session.add(Result(id=f"res_{number}", created_at=now, expires_at=now, **described, **of))


def test_no_statistics_keep_what_clients_said_once_it_is_deleted(postgres_url: str, postgres_tables: str) -> None:
    """PostgreSQL's statistics of a column hold its values, also those of rows that are gone."""
    query = "SELECT tablename, attname FROM pg_stats WHERE coalesce(most_common_vals, histogram_bounds)::text ~ 'mark-'"
    with fresh_database(postgres_url, postgres_tables) as url:
        migrate_to(url, "0024")
        database, engine = Database(url), make_engine(url)
        for number in range(3):
            _say(database, number)
        with engine.execution_options(isolation_level="AUTOCOMMIT").connect() as connection:
            connection.execute(text("ANALYZE"))
            kept = set(rows(database, query))
            assert {name for _, name in kept} == {*_SAID, "token"}
            migrate(url)
            connection.execute(text("ANALYZE"))
            assert rows(database, query) == [("idempotent_requests", "token")], "of the test, which is no secret"
            targets = "SELECT attname FROM pg_attribute JOIN pg_class c ON c.oid = attrelid WHERE relkind = 'r' AND "
            ours = "relnamespace = 'public'::regnamespace AND attname = ANY(:said) AND attstattarget IS DISTINCT FROM 0"
            assert connection.scalars(text(targets + ours), {"said": list(_SAID)}).all() == [], "of a newer table"
        engine.dispose()
        database.close()
