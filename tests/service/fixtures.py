"""Fixtures of the service's and the worker's tests."""

from __future__ import annotations

import hashlib
import socket
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path

import httpx
import pytest
import structlog
import uvicorn

from service.api import Services, create_app
from service.catalog import (
    DEFAULT_VECTOR_SETTINGS,
    Asset,
    Database,
    JobKind,
    Lease,
    LookParams,
    Media,
    NewLook,
    Output,
    RenderRequest,
    Report,
    Role,
    Upload,
    VectorSettings,
    jobs,
    media,
    results,
)
from service.catalog.migrations import migrate
from service.ids import new_id
from service.settings import Settings
from tests.service.servers import fresh_database, postgres_server, redis_server

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


@pytest.fixture(scope="session")
def postgres_url() -> Iterator[str]:
    with postgres_server() as url:
        yield url


@pytest.fixture(scope="session")
def redis_url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with redis_server(tmp_path_factory.mktemp("redis")) as url:
        yield url


@pytest.fixture
def clock() -> FakeClock:
    return FakeClock()


@pytest.fixture(params=["sqlite", "postgresql"])
def database(request: pytest.FixtureRequest, tmp_path: Path, clock: FakeClock) -> Iterator[Database]:
    """An empty catalog, once on each engine."""
    if request.param == "sqlite":
        yield from _open(f"sqlite:///{tmp_path / 'catalog.sqlite3'}", clock)
        return
    with fresh_database(request.getfixturevalue("postgres_url")) as url:
        yield from _open(url, clock)


def _open(url: str, clock: FakeClock) -> Iterator[Database]:
    migrate(url)
    database = Database(url, clock=clock)
    yield database
    database.close()


@pytest.fixture
def settings(tmp_path: Path) -> Settings:
    # rounds of the reaper are run by the tests themselves
    return Settings(data_dir=tmp_path / "data", reap_interval_s=3600)


@dataclass(frozen=True)
class Api:
    """A running API: a real server on a real socket."""

    client: httpx.Client
    services: Services
    address: tuple[str, int]

    @property
    def blobs(self) -> list[str]:
        return sorted(key for key, _ in self.services.storage.entries())

    @property
    def drafts(self) -> list[Path]:
        return list(self.services.settings.spool_folder.iterdir())


@pytest.fixture
def api(settings: Settings) -> Iterator[Api]:
    yield from serve(settings)


def serve(settings: Settings) -> Iterator[Api]:
    """Run the API of these settings in a thread."""
    migrate(settings.database)
    app = create_app(settings)
    server = uvicorn.Server(uvicorn.Config(app, log_config=None, access_log=False, timeout_graceful_shutdown=2))
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
        thread.start()
        try:
            until = time.monotonic() + 20
            while not server.started and time.monotonic() < until:
                time.sleep(0.01)
            address = listener.getsockname()
            with httpx.Client(base_url=f"http://127.0.0.1:{address[1]}", timeout=30) as client:
                yield Api(client, app.state.services, address)
        finally:
            server.should_exit = True
            thread.join(20)


# a worker's steps, done by hand on the records


def add_media(
    database: Database,
    role: Role = Role.VIDEO,
    *,
    content: bytes | None = None,
    settings: VectorSettings = DEFAULT_VECTOR_SETTINGS,
) -> Media:
    """Record a medium as an upload does."""
    media_id = new_id("vid" if role is Role.VIDEO else "ref")
    sha256 = hashlib.sha256(content or media_id.encode()).hexdigest()
    upload = Upload(media_id, role, sha256, 10, "video/mp4", "clip.mp4", f"source/{media_id}", settings)
    with database.write() as session:
        return media.create(session, upload, now=database.now(), ttl_s=1000)


def add_transfer(database: Database, video: Media, reference: Media) -> str:
    """Record a transfer as a request does; the job's id."""
    with database.write() as session:
        look = NewLook(video.id, reference.id, LookParams())
        job = jobs.create(session, JobKind.TRANSFER, request=RenderRequest(), now=database.now(), outputs=[look])
    return job.id


def claim(database: Database, job_id: str, lease_s: float = 30) -> Lease:
    with database.write() as session:
        lease = jobs.claim(session, job_id, now=database.now(), lease_s=lease_s)
    assert lease is not None
    return lease


def make_ready(services: Services, media_id: str, *, faces: int = 1) -> None:
    """End a medium's vectorisation well, and let waiting jobs go."""
    database, storage = services.database, services.storage
    with database.read() as session:
        medium = media.get(session, media_id)
    assert medium is not None
    lease = claim(database, medium.job_id)
    draft = storage.draft()
    draft.write_bytes(b"asset of " + media_id.encode())
    key = storage.key("asset", medium.sha256, media_id, ".pvg")
    storage.put(draft, key)
    asset = Asset(key, 30, {"kind": "video"}, [{"index": i, "width_px": 300.0} for i in range(faces)], [])
    with database.write() as session:
        assert media.finish(session, lease, asset, now=database.now(), timings={}) == []
    with database.write() as session:
        jobs.release(session, now=database.now())


def make_results(services: Services, job_id: str, contents: list[bytes], report: Report | None = None) -> list[str]:
    """End a job well with these files as its results."""
    lease = claim(services.database, job_id)
    outputs = []
    for position, content in enumerate(contents):
        draft = services.storage.draft()
        draft.write_bytes(content)
        sha256, result_id = hashlib.sha256(content).hexdigest(), new_id("res")
        key = services.storage.key("result", sha256, result_id, ".mp4")
        services.storage.put(draft, key)
        name = f"clip–{position}.mp4"
        outputs.append(Output(result_id, position, key, sha256, len(content), "video/mp4", name, report))
    now = services.database.now()
    with services.database.write() as session:
        assert results.publish(session, lease, outputs, now=now, timings={"render_s": 1.0}, ttl_s=1000)
    return [output.result_id for output in outputs]
