"""Real Redis and PostgreSQL servers for tests, thrown away afterwards."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import tempfile
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psycopg
import pytest
import redis
from sqlalchemy.engine import make_url


def missing(what: str) -> None:
    """Skip the test, or fail it where the servers are required."""
    if os.environ.get("PVG_REQUIRE_SERVERS") == "1":
        pytest.fail(f"PVG_REQUIRE_SERVERS=1, but {what}")
    pytest.skip(what)


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _stop(process: subprocess.Popen[bytes]) -> None:
    process.terminate()
    try:
        process.wait(10)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


@contextmanager
def redis_server(folder: Path, port: int | None = None) -> Iterator[str]:
    """A Redis server of our own, at a free port or a given one; its URL."""
    command = shutil.which("redis-server") or shutil.which("valkey-server")
    if command is None:
        missing("redis-server is not installed")
    port = port or free_port()
    process = subprocess.Popen(
        [command, "--port", str(port), "--bind", "127.0.0.1", "--dir", str(folder), "--save", ""],
        stdout=subprocess.DEVNULL,
    )
    try:
        with redis.Redis(port=port) as client:
            for _ in range(100):
                try:
                    client.ping()
                    break
                except redis.ConnectionError:
                    time.sleep(0.05)
        yield f"redis://127.0.0.1:{port}/0"
    finally:
        _stop(process)


def _postgres_bin() -> Path | None:
    found = shutil.which("initdb")
    if found:
        return Path(found).parent
    debian = sorted(Path("/usr/lib/postgresql").glob("*/bin"), key=lambda path: int(path.parent.name))
    return debian[-1] if debian else None


def _run(command: list[str], folder: Path) -> None:
    subprocess.run(command, stdout=subprocess.DEVNULL, check=True, cwd=folder)


@contextmanager
def postgres_server() -> Iterator[str]:
    """A PostgreSQL cluster of our own; the URL of its first database."""
    given = os.environ.get("PVG_TEST_DATABASE_URL")
    if given:
        yield given
        return
    binaries = _postgres_bin()
    if binaries is None:
        missing("PostgreSQL is not installed and PVG_TEST_DATABASE_URL is not set")
        return
    # pytest's own temporary folders are closed to other users, and PostgreSQL refuses to run as root
    with tempfile.TemporaryDirectory(prefix="pvg-postgres-") as name:
        yield from _run_postgres(binaries, Path(name))


def _run_postgres(binaries: Path, folder: Path) -> Iterator[str]:
    prefix: list[str] = []
    if os.geteuid() == 0:
        prefix = ["runuser", "-u", "postgres", "--"]
        shutil.chown(folder, "postgres")
    data, port = folder / "data", free_port()
    _run([*prefix, str(binaries / "initdb"), "-D", str(data), "-U", "pvg", "-A", "trust", "--no-sync"], folder)
    options = f"-p {port} -c listen_addresses=127.0.0.1 -c unix_socket_directories={folder} -c fsync=off"
    control = [*prefix, str(binaries / "pg_ctl"), "-D", str(data), "-w"]
    _run([*control, "-o", options, "-l", str(folder / "log"), "start"], folder)
    try:
        yield f"postgresql+psycopg://pvg@127.0.0.1:{port}/postgres"
    finally:
        _run([*control, "-m", "immediate", "stop"], folder)


@contextmanager
def fresh_database(server_url: str) -> Iterator[str]:
    """An empty database in the server; its URL."""
    url = make_url(server_url)
    name = f"pvg_test_{uuid.uuid4().hex[:12]}"
    plain = url.set(drivername="postgresql").render_as_string(hide_password=False)
    with psycopg.connect(plain, autocommit=True) as connection:
        connection.execute(f'CREATE DATABASE "{name}"'.encode())
    try:
        yield url.set(database=name).render_as_string(hide_password=False)
    finally:
        with psycopg.connect(plain, autocommit=True) as connection:
            connection.execute(f'DROP DATABASE "{name}" WITH (FORCE)'.encode())
