"""The real parts that tests start, one of each a run: Redis, PostgreSQL and an S3 server; and what to do without them.

Where a server is not installed its tests are skipped, and the last lines of the run say which and how to have it.
"""

from __future__ import annotations

import uuid
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import pytest
import redis
from sqlalchemy.engine import make_url

from tests.service.s3 import S3, s3_server
from tests.service.servers import PACKAGES, Wire, fresh_database, postgres_server, redis_server, wired


@pytest.fixture(scope="session")
def postgres_url() -> Iterator[str]:
    with postgres_server() as url:
        yield url


@pytest.fixture(scope="session")
def postgres_tables(postgres_url: str) -> Iterator[str]:
    """The name of a database that has the tables, to make others from: sooner than migrating each."""
    from service.catalog.migrations import migrate

    with fresh_database(postgres_url) as url:
        migrate(url)
        yield str(make_url(url).database)


@pytest.fixture(scope="session")
def postgres_records(postgres_url: str, postgres_tables: str) -> Iterator[str]:
    """A database with the tables that one test after the other has, each empty."""
    with fresh_database(postgres_url, postgres_tables) as url:
        yield url


@pytest.fixture(scope="session")
def redis_url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with redis_server(tmp_path_factory.mktemp("redis")) as url:
        yield url


@pytest.fixture(scope="session")
def s3() -> Iterator[S3]:
    """An S3 server, without a bucket."""
    with s3_server() as server:
        yield server


@pytest.fixture
def bucket(s3: S3, monkeypatch: pytest.MonkeyPatch) -> Iterator[S3]:
    """An empty bucket, for storage that this process itself opens too."""
    with s3.fresh_bucket() as one:
        for name, value in one.environment().items():
            monkeypatch.setenv(name, value)
        yield one


@pytest.fixture
def wire(bucket: S3, monkeypatch: pytest.MonkeyPatch) -> Iterator[Wire]:
    """What storage in the bucket goes over that this process opens."""
    with wired(bucket.url) as (wire, url):
        monkeypatch.setenv("AWS_ENDPOINT", url)
        yield wire


@pytest.fixture(scope="session")
def shared_bucket(s3: S3) -> Iterator[S3]:
    """A bucket in which each test has a prefix of its own."""
    with s3.fresh_bucket() as one:
        yield one


@contextmanager
def fresh_parts(request: pytest.FixtureRequest) -> Iterator[dict[str, str]]:
    """Settings that name a database with tables, a broker and a store, all empty and of one test."""
    server, template = request.getfixturevalue("postgres_url"), request.getfixturevalue("postgres_tables")
    broker = str(request.getfixturevalue("redis_url")).replace("/0", "/6")
    bucket: S3 = request.getfixturevalue("shared_bucket")
    patch: pytest.MonkeyPatch = request.getfixturevalue("monkeypatch")
    for name, value in bucket.environment().items():
        patch.setenv(name, value)
    with redis.Redis.from_url(broker) as former:
        former.flushdb()
    with fresh_database(server, template) as url:
        yield {
            "database_url": url,
            "broker_url": broker,
            "storage_url": f"s3://{bucket.bucket}/{uuid.uuid4().hex}",
        }


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--scaled", action="store_true", help="tests of the API on PostgreSQL, Redis and S3")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """With `--scaled` only what is true of it runs: tests that use the settings and are not of the embedded service."""
    if not config.getoption("--scaled"):
        return
    taken = [item for item in items if "settings" in _fixtures(item) and not item.get_closest_marker("embedded")]
    config.hook.pytest_deselected(items=[item for item in items if item not in taken])
    items[:] = taken


def _fixtures(item: pytest.Item) -> Sequence[str]:
    return getattr(item, "fixturenames", ())


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> Iterator[None]:
    """Say in the last lines what was skipped on this machine, and how to have it."""
    yield
    skipped = terminalreporter.stats.get("skipped", [])
    reasons = Counter(str(report.longrepr[2]).removeprefix("Skipped: ") for report in skipped if report.longrepr)
    if not reasons:
        return
    terminalreporter.section("skipped on this machine", yellow=True)
    for reason, count in reasons.most_common():
        terminalreporter.line(f"{count} test{'s' if count > 1 else ''}: {reason}")
    packages = [package for name, package in PACKAGES.items() if f"{name} is not installed" in reasons]
    if packages:
        terminalreporter.line(f"to run more of them: apt-get install {' '.join(packages)}, and the same again")
