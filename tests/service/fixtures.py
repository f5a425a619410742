"""Fixtures of the service's and the worker's tests."""

from __future__ import annotations

import hashlib
import socket
import tempfile
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from functools import cache
from pathlib import Path
from typing import Any

import httpx
import pytest
import structlog
import uvicorn
from fastapi import FastAPI
from sqlalchemy import NullPool, create_engine, text
from sqlalchemy.engine import make_url
from sqlalchemy.orm import Session

from service.api import Services, calls, create_app
from service.api.examples import MEDIUM
from service.api.server import listen, make_server
from service.catalog import (
    DEFAULT_VECTOR_SETTINGS,
    Asset,
    Database,
    Job,
    JobKind,
    Lease,
    LookParams,
    Media,
    NewLook,
    Output,
    PartName,
    PartOf,
    RenderRequest,
    Report,
    Role,
    Upload,
    VectorSettings,
    content_type_of,
    jobs,
    leases,
    media,
    results,
    tombstones,
    utc_now,
)
from service.catalog.database import _WritersTurn
from service.catalog.migrations import migrate
from service.catalog.models import Base
from service.ids import new_id
from service.settings import Settings
from tests.parts import fresh_parts
from tests.service.declared import Declared
from tests.service.servers import fresh_database, is_from_template
from tests.waiting import until

PNG = b"\x89PNG\r\n\x1a\n"
MP4 = b"\x00\x00\x00\x18ftypisom\x00\x00\x02\x00isomiso2"


@pytest.fixture(scope="session", autouse=True)
def plain_logs() -> None:
    """Send log lines where pytest captures them."""
    structlog.configure(
        processors=[structlog.processors.format_exc_info, structlog.stdlib.render_to_log_kwargs],
        logger_factory=structlog.stdlib.LoggerFactory(),
        wrapper_class=structlog.stdlib.BoundLogger,
        cache_logger_on_first_use=False,
    )


@dataclass
class FakeClock:
    """A clock that moves when told to."""

    time: datetime = field(default_factory=lambda: datetime.now(UTC))

    def __call__(self) -> datetime:
        return self.time

    def forward(self, seconds: float) -> None:
        self.time += timedelta(seconds=seconds)


@pytest.fixture
def clock() -> FakeClock:
    return FakeClock()


@pytest.fixture(params=["sqlite", "postgresql"])
def database(request: pytest.FixtureRequest, tmp_path: Path, clock: FakeClock) -> Iterator[Database]:
    """An empty catalog, once on each engine. Its tables stay as they are: the next test has them, too."""
    if request.param == "sqlite":
        yield from _open(_sqlite(tmp_path), clock)
        return
    url = request.getfixturevalue("postgres_records")
    yield from _open(url, clock)
    empty(url)


@pytest.fixture(params=["sqlite", "postgresql"])
def own_database(request: pytest.FixtureRequest, tmp_path: Path, clock: FakeClock) -> Iterator[Database]:
    """An empty catalog whose tables may be changed, once on each engine."""
    if request.param == "sqlite":
        yield from _open(_sqlite(tmp_path), clock)
        return
    server = request.getfixturevalue("postgres_url")
    with fresh_database(server, request.getfixturevalue("postgres_tables")) as url:
        yield from _open(url, clock)


def _sqlite(folder: Path) -> str:
    url = f"sqlite:///{folder / 'catalog.sqlite3'}"
    make_tables(url)
    return url


def _open(url: str, clock: FakeClock) -> Iterator[Database]:
    database = Database(url, clock=clock)
    yield database
    database.close()


def empty(url: str) -> None:
    """Delete all records of a PostgreSQL database, and end who else is connected: much sooner than making another."""
    engine = create_engine(url, poolclass=NullPool)
    others = "SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE datname = current_database()"
    with engine.begin() as connection:
        connection.execute(text(f"{others} AND pid <> pg_backend_pid()"))
        for table in reversed(Base.metadata.sorted_tables):
            connection.execute(table.delete())


@cache
def _sqlite_tables() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        migrate(f"sqlite:///{folder}/catalog.sqlite3")
        return (Path(folder) / "catalog.sqlite3").read_bytes()


def make_tables(url: str) -> None:
    """What `migrate` does to a database that is not there yet; to a SQLite file sooner, once it was done to one."""
    parsed = make_url(url)
    path = Path(parsed.database or "")
    if is_from_template(url):
        return
    if parsed.get_backend_name() != "sqlite" or path.exists():
        migrate(url)
        return
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    path.touch(mode=0o600)
    path.write_bytes(_sqlite_tables())


@pytest.fixture
def settings(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Settings]:
    """Those of an embedded service, or with `--scaled` of one on PostgreSQL, Redis and S3."""
    # rounds of the reaper are run by the tests themselves; how soon pictures come is not tried here
    embedded = Settings(data_dir=tmp_path / "data", reap_interval_s=3600, preview_timeout_s=60)
    if not request.config.getoption("--scaled"):
        yield embedded
        return
    with fresh_parts(request) as parts:
        yield embedded.model_copy(update=parts)


@dataclass(frozen=True)
class Api:
    """A running API: a real server on a real socket."""

    client: httpx.Client
    services: Services
    address: tuple[str, int]
    app: FastAPI

    @property
    def blobs(self) -> list[str]:
        return sorted(key for key, _ in self.services.storage.entries())

    @property
    def drafts(self) -> list[Path]:
        return list(self.services.settings.spool_folder.iterdir())


@pytest.fixture
def api(settings: Settings) -> Iterator[Api]:
    yield from serve(settings)


def begun(api: Api, call: str, sent: bytes, declared: int, *, within_s: float, **fields: str) -> int | None:
    """Send the beginning of a body that declares more: the status of the answer, or None if none comes by then."""
    with socket.create_connection(api.address, timeout=within_s) as connection:
        head = {"Host": "localhost", "Content-Length": str(declared), **fields}
        lines = "".join(f"{name}: {value}\r\n" for name, value in head.items())
        connection.sendall(f"{call} HTTP/1.1\r\n{lines}\r\n".encode() + sent)
        try:
            return int(connection.recv(4096).split()[1])
        except TimeoutError:
            return None


#: seconds for which the API waits for its records, but in these tests
USUAL_PATIENCE_S = calls._PATIENCE_S


def serve(settings: Settings) -> Iterator[Api]:
    """Run the API of these settings in a thread, without the rounds of reaper and collector: tests run those.

    It waits long for its records, and its client for it: a machine at work stands still for some seconds now and then.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(calls, "_PATIENCE_S", 60.0)
        patch.setattr("service.catalog.database._POOL_S", 60.0)
        yield from _serve(settings)


def _serve(settings: Settings) -> Iterator[Api]:
    make_tables(settings.database)
    app = create_app(settings)
    services = app.state.services
    for cleaning in (services.reaper, services.collector):
        cleaning._rounds._work = lambda: None
    with running(make_server(app, settings, drain_s=2)) as address:
        hooks = {"response": [Declared(app)]}
        with httpx.Client(base_url=f"http://127.0.0.1:{address[1]}", timeout=90, event_hooks=hooks) as client:
            yield Api(client, services, address, app)


@contextmanager
def running(server: uvicorn.Server) -> Iterator[tuple[str, int]]:
    """Run a server in a thread, at the address that is given, and stop it."""
    with listen("127.0.0.1", 0)[0] as listener:
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
        thread.start()
        try:
            until(lambda: server.started)
            yield listener.getsockname()
        finally:
            server.should_exit = True
            thread.join(60)


def held_up(database: Database) -> int:
    """How many writers wait until what another one is writing is recorded."""
    if isinstance(database._turn, _WritersTurn):
        return len(database._turn._line._waiting)
    waiting = text("SELECT 1 FROM pg_stat_activity WHERE datname = current_database() AND wait_event_type = 'Lock'")
    with database.read() as session:
        return len(session.execute(waiting).all())


# a worker's steps, done by hand on the records


def add_media(
    database: Database,
    role: Role = Role.VIDEO,
    *,
    content: bytes | None = None,
    settings: VectorSettings = DEFAULT_VECTOR_SETTINGS,
    owner: str = "",
) -> Media:
    """Record a medium as an upload does."""
    media_id = new_id("vid" if role is Role.VIDEO else "ref")
    sha256 = hashlib.sha256(content or media_id.encode()).hexdigest()
    upload = Upload(media_id, role, sha256, 10, "video/mp4", "clip.mp4", f"source/{media_id}", settings, owner)
    with database.write() as session:
        announce(session, upload.source_key)
        return media.create(session, upload, now=database.now(), ttl_s=1000)


def announce(session: Session, *keys: str) -> None:
    """What is written before a blob is; for records whose blobs the test does without."""
    for key in keys:
        tombstones.expect(session, key, now=utc_now(), within_s=900)


def add_transfer(database: Database, video: Media, reference: Media) -> str:
    """Record a transfer as a request does; the job's id."""
    with database.write() as session:
        look = NewLook(video.id, reference.id, LookParams())
        job = jobs.create(session, JobKind.TRANSFER, request=RenderRequest(), now=database.now(), outputs=[look])
    return job.id


def job_of(database: Database, job_id: str) -> Job:
    """A job as it is recorded."""
    with database.read() as session:
        return session.get_one(Job, job_id)


def claim(database: Database, job_id: str, lease_s: float = 30) -> Lease:
    with database.write() as session:
        lease = leases.claim(session, job_id, now=database.now(), lease_s=lease_s)
    assert lease is not None
    return lease


def make_ready(services: Services, media_id: str, *, faces: int = 1) -> None:
    """End a medium's vectorisation well, and let waiting jobs go."""
    database, storage = services.background, services.storage
    with database.read() as session:
        medium = media.get(session, media_id)
    assert medium is not None
    lease = claim(database, medium.job_id)
    draft = storage.spool.draft()
    draft.write_bytes(b"asset of " + media_id.encode())
    key = storage.key("asset", medium.sha256, media_id, ".pvg")
    services.blobs.put(draft, key)
    found = [MEDIUM["faces"][0] | {"index": i, "width_px": 300.0} for i in range(faces)]
    asset = Asset(key, 30, MEDIUM["media"], found, [])
    with database.write() as session:
        assert media.finish(session, lease, asset, now=database.now(), timings={}) == []
    with database.write() as session:
        jobs.release(session, now=database.now())


def make_results(
    services: Services,
    job_id: str,
    contents: list[bytes],
    report: Report | None = None,
    parts: Sequence[tuple[PartName, int, bytes]] = (),
) -> list[str]:
    """End a job well with these files as its results, each with the same parts of persons."""
    lease = claim(services.background, job_id)
    outputs: list[Output] = []
    for position, content in enumerate(contents):
        result = _output(services, position, content, f"clip–{position}.mp4", report=report)
        outputs.append(result)
        for part, person, data in parts:
            name = f"clip-look-{person}.cube" if part == "look.cube" else f"clip-matte-{person}.mkv"
            outputs.append(_output(services, position, data, name, part_of=PartOf(result.result_id, part, person)))
    now = services.background.now()
    with services.background.write() as session:
        assert results.publish(session, lease, outputs, now=now, timings={"render_s": 1.0}, ttl_s=1000)
    return [output.result_id for output in outputs if output.part_of is None]


def _output(services: Services, position: int, content: bytes, name: str, **more: Any) -> Output:
    draft = services.storage.spool.draft()
    draft.write_bytes(content)
    sha256, result_id, suffix = hashlib.sha256(content).hexdigest(), new_id("res"), Path(name).suffix
    key = services.storage.key("result", sha256, result_id, suffix)
    services.blobs.put(draft, key)
    return Output(result_id, position, key, sha256, len(content), content_type_of(suffix), name, **more)
