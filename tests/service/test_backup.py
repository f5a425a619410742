"""What docs/operations/data.md says of backups and of other versions' tables, done to a service that has something."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path
from types import MappingProxyType

import httpx
import pytest
from pydantic import SecretStr
from sqlalchemy import inspect, text
from sqlalchemy.engine import make_url

from service.catalog import Database, Job, JobState, jobs, leases, workers
from service.catalog.database import make_engine
from service.catalog.migrations import migrate, migrate_to
from service.settings import Settings
from tests.faults.test_clocks import clock_that_is_off
from tests.service.catalog.test_parts import finish, parted
from tests.service.fixtures import MP4, PNG, Api, claim, make_ready, make_results, serve
from tests.service.servers import fresh_database, installed

PAGE = Path(__file__).resolve().parents[2] / "docs" / "operations" / "data.md"
LOOK = b"a recoloured clip" * 1000


@pytest.fixture(params=["sqlite", "postgresql"])
def kept(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Settings]:
    """A service's settings, once for each database."""
    settings = Settings(data_dir=tmp_path / "data", reap_interval_s=3600)
    if request.param == "sqlite":
        yield settings
        return
    installed("pg_dump")
    with fresh_database(request.getfixturevalue("postgres_url")) as url:
        yield settings.model_copy(update={"database_url": url})


@contextmanager
def running(settings: Settings) -> Iterator[Api]:
    yield from serve(settings)


def upload(api: Api, path: str, content: bytes) -> str:
    kind = "video/mp4" if path == "/videos" else "image/png"
    answer = api.client.post(path, content=content, headers={"Content-Type": kind})
    assert answer.status_code == 202, answer.text
    return str(answer.json()["id"])


def fill(api: Api) -> tuple[str, str, str]:
    """A clip, a portrait, a result; a job that is running and one that is queued. The clip, the result, its link."""
    video, portrait = upload(api, "/videos", MP4 + b"clip"), upload(api, "/references", PNG + b"portrait")
    for medium in (video, portrait):
        make_ready(api.services, medium)
    job = api.client.post("/transfer", json={"video": video, "looks": [{"reference": portrait}]}).json()["id"]
    (result,) = make_results(api.services, job, [LOOK])
    link = api.client.post(f"/results/{result}/link").raise_for_status().json()["url"]
    for strength in (0.25, 0.75):
        look = {"reference": portrait, "strength": strength}
        job = api.client.post("/transfer", json={"video": video, "looks": [look]}).raise_for_status().json()["id"]
    claim(api.services.background, job)
    return video, result, str(link)


def said(name: str) -> str:
    """The commands of the page below a mark."""
    found = re.search(rf"<!-- tested: {name} -->\n```sh\n(.*?)```", PAGE.read_text(), re.DOTALL)
    assert found is not None, name
    return found[1]


def run(name: str, settings: Settings, backup: Path) -> None:
    """Run commands of the page as they stand there."""
    plain = make_url(settings.database).set(drivername="postgresql").render_as_string(hide_password=False)
    variables = {"PVG_DATA_DIR": str(settings.folder), "BACKUP": str(backup), "DATABASE": plain}
    if settings.database_url:
        variables["PVG_DATABASE_URL"] = settings.database_url
    variables["PATH"] = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    done = subprocess.run(
        ["sh", "-euc", said(name)],
        env=os.environ | variables,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("secret", ["", "s" * 32], ids=["secret-in-a-file", "secret-set"])
def test_what_was_backed_up_is_there_again(secret: str, kept: Settings, tmp_path: Path) -> None:
    backup = tmp_path / "backup"
    kept = kept.model_copy(update={"link_secret": SecretStr(secret)})
    engine = "postgresql" if kept.database_url else "sqlite"
    with running(kept) as api:
        video, result, link = fill(api)
        before = {path: api.client.get(path).json() for path in ("/videos", "/references", "/jobs")}
        began = time.monotonic()
        run(f"backup {engine}", kept, backup)  # while it serves
        took = time.monotonic() - began
        later = upload(api, "/videos", MP4 + b"after the backup")
    size = sum(path.stat().st_size for path in backup.rglob("*") if path.is_file())
    print(f"{engine}: backed up in {took:.2f} s, {size} bytes")

    shutil.rmtree(kept.folder)
    if kept.database_url:
        _empty(kept.database)
    began = time.monotonic()
    run(f"restore {engine}", kept, backup)
    print(f"{engine}: restored in {time.monotonic() - began:.2f} s")

    with running(kept) as api:
        assert {path: api.client.get(path).json() for path in before} == before
        assert api.client.get(f"/results/{result}").raise_for_status().content == LOOK
        assert httpx.get(api.client.base_url.join(link), timeout=60).raise_for_status().content == LOOK, "links hold"
        assert api.client.get(f"/videos/{later}").status_code == 404
        database = api.services.background
        with database.write() as session:  # what the reaper does once the lease is over
            later_than_the_lease = database.now() + timedelta(seconds=kept.lease_s + 1)
            assert len(leases.reap(session, now=later_than_the_lease, max_attempts=3)) == 1
        states = [(job["state"], job["attempt"]) for job in api.client.get("/jobs").json()["data"]]
        assert states.count(("queued", 2)) == 1, "what was running begins anew"
        again = upload(api, "/videos", MP4 + b"after the backup")
        assert api.client.delete(f"/videos/{video}?cancel_jobs=true").status_code == 204
        assert api.client.get("/videos").json()["data"][0]["id"] == again


def _empty(url: str) -> None:
    engine = make_engine(url)
    with engine.begin() as connection:
        connection.execute(text("DROP SCHEMA public CASCADE"))
        connection.execute(text("CREATE SCHEMA public"))
    engine.dispose()


def test_the_tables_go_down_and_up_with_what_is_in_them(kept: Settings) -> None:
    """One version at a time to the first and back, with media, jobs and results in place."""
    with running(kept) as api:
        _, result, _ = fill(api)
        before = {path: api.client.get(path).json() for path in ("/videos", "/references", "/jobs")}
    database = Database(kept.database)
    counted = _rows(database)
    assert counted.items() >= {"media": 2, "looks": 3, "results": 1}.items()
    newest = _version(database)
    for version in [f"{number:04}" for number in range(int(newest) - 1, 0, -1)]:
        migrate_to(kept.database, version)
        assert _version(database) == version
        assert {name: n for name, n in _rows(database).items() if name in _FIRST} == {n: counted[n] for n in _FIRST}
    _migrate(kept, newest)
    assert {name: n for name, n in _rows(database).items() if name in _FIRST} == {n: counted[n] for n in _FIRST}
    database.close()
    with running(kept) as api:
        after = {path: api.client.get(path).json() for path in before}
        ids = {path: [one["id"] for one in page["data"]] for path, page in before.items()}
        assert {path: [one["id"] for one in page["data"]] for path, page in after.items()} == ids
        assert [job["state"] for job in after["/jobs"]["data"]] == [job["state"] for job in before["/jobs"]["data"]]
        assert api.client.get(f"/results/{result}").raise_for_status().content == LOOK


#: the tables that there were from the beginning
_FIRST = ("media", "jobs", "looks", "results")


def _migrate(
    settings: Settings, version: str | None, code: int = 0, more: Mapping[str, str] = MappingProxyType({})
) -> str:
    environment = os.environ | {"PVG_DATA_DIR": str(settings.folder), "PVG_DATABASE_URL": settings.database_url} | more
    command = [str(Path(sys.executable).with_name("pvg-service")), "migrate", *(["--to", version] if version else [])]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == code, done.stderr
    return done.stdout + done.stderr


def _version(database: Database) -> str:
    with database.read() as session:
        return str(session.execute(text("SELECT version_num FROM alembic_version")).scalar_one())


def _rows(database: Database) -> dict[str, int]:
    engine = make_engine(database.url)
    names = inspect(engine).get_table_names()
    with engine.connect() as connection:
        found = {name: int(connection.execute(text(f'SELECT count(*) FROM "{name}"')).scalar_one()) for name in names}
    engine.dispose()
    return found


def test_of_every_migration_it_is_told_whether_older_versions_run_beside_it() -> None:
    told = re.findall(r"^\| (\d{4}) \| (?:yes|no|–) \|", PAGE.read_text(), re.MULTILINE)
    assert told == sorted(
        path.name[:4] for path in (PAGE.parents[2] / "service/catalog/migrations/versions").glob("0*.py")
    )


def test_versions_that_nobody_knows_are_refused_in_a_line(kept: Settings) -> None:
    assert "there is no version 9999; they are 0001 to" in _migrate(kept, "9999", code=2)
    migrate_to(kept.database, "0013")
    database = Database(kept.database)
    with database.write() as session:
        session.execute(text("UPDATE alembic_version SET version_num = '9998'"))
    database.close()
    for version in ("0012", None):  # None: to the newest, as `serve` goes
        said = _migrate(kept, version, code=2)
        assert said.splitlines()[-1] == (
            "pvg-service: the database's tables are of version 9998, which this code does not know"
        )
        assert "Traceback" not in said


def test_tables_are_not_changed_below_a_running_worker(kept: Settings) -> None:
    migrate_to(kept.database, "0013")
    database = Database(kept.database)
    with database.write() as session:
        # good for as long as the command may take to start
        workers.beat(session, "worker-1", now=database.now() + timedelta(seconds=60))
    assert "1 worker(s) are running: stop every process of the service first" in _migrate(kept, "0012", code=1)
    assert _version(database) == "0013"
    with database.write() as session:
        workers.leave(session, "worker-1")
    _migrate(kept, "0012")
    assert _version(database) == "0012"
    database.close()


def test_a_running_worker_is_seen_from_a_machine_whose_clock_is_ahead(postgres_url: str, tmp_path: Path) -> None:
    """Workers are alive by the database's clock."""
    with fresh_database(postgres_url) as url:
        migrate_to(url, "0013")
        database = Database(url)
        with database.write() as session:
            workers.beat(session, "worker-1", now=database.now() + timedelta(seconds=60))
        settings = Settings(data_dir=tmp_path / "data", database_url=url)
        said = _migrate(settings, "0012", code=1, more=clock_that_is_off(tmp_path, 3600))
        assert "1 worker(s) are running" in said
        assert _version(database) == "0013"
        database.close()


def test_what_is_done_in_parts_begins_anew_in_the_version_before_there_were_parts(kept: Settings) -> None:
    migrate(kept.database)
    database = Database(kept.database)
    job_id, part_ids = parted(database, 2)
    finish(database, claim(database, part_ids[0]))
    claim(database, part_ids[1])
    stopped, others = parted(database, 2)
    claim(database, others[0])
    with database.write() as session:
        assert jobs.cancel(session, stopped, now=database.now())
    migrate_to(kept.database, "0012")
    with database.read() as session:
        found = session.execute(text("SELECT id, state FROM jobs WHERE kind <> 'vectorize' ORDER BY id")).all()
    assert [tuple(row) for row in found] == sorted([(job_id, "queued"), (stopped, "canceling")])
    migrate(kept.database)
    lease = claim(database, job_id)
    with database.write() as session:
        assert leases.held_state(session, lease) == JobState.RUNNING
        # what was being canceled has a lease that is over: the reaper ends it
        leases.reap(session, now=database.now() + timedelta(seconds=1), max_attempts=3)
        assert session.get_one(Job, stopped).state == JobState.CANCELED
    database.close()
