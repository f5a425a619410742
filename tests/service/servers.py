"""Real Redis and PostgreSQL servers for tests, thrown away afterwards."""

from __future__ import annotations

import os
import secrets
import shutil
import signal
import socket
import subprocess
import tempfile
import threading
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final, NoReturn
from urllib.parse import urlsplit

import psycopg
import pytest
import redis
from sqlalchemy.engine import make_url

from tests.waiting import until

#: what tests start or use and no Python package brings: its name in a skipped test's reason, and Debian's package of it
PACKAGES: Final = {
    "redis-server": "redis-server",
    "PostgreSQL": "postgresql",
    "chromium": "chromium",
    "strace": "strace",
    "curl": "curl",
    "jq": "jq",
    "nginx": "nginx-light",
    "cc": "gcc",
}


def missing(what: str, *, required_by: str = "PVG_REQUIRE_SERVERS") -> NoReturn:
    """Skip the test, or fail it where a variable says that what it needs is required, as all of it is in CI."""
    if os.environ.get(required_by) == "1":
        pytest.fail(f"{required_by}=1, but {what}")
    pytest.skip(what)


def installed(*names: str) -> str:
    """The program of this name, or of the first of these that is there; the test needs it, see `missing`."""
    found = next((path for name in names if (path := shutil.which(name))), None)
    return found or missing(f"{names[0]} is not installed")


def check_namespaces(*command: str) -> None:
    """Skip the test where a command that runs another in namespaces of its own, as `unshare` does, is refused them."""
    alone = subprocess.run(
        [installed(command[0]), *command[1:], "/bin/true"], capture_output=True, text=True, check=False
    )
    if alone.returncode != 0:  # that of a command that fails within them may be the same
        pytest.skip(f"namespaces are not to be had here: {alone.stderr.strip()}")


_given: Final[set[int]] = set()


def free_port() -> int:
    """A port where nobody listens, and that is given once.

    It is none of those that outgoing connections get: one of them could have it before the server that it is for, or
    while that one is away, and a client that asks there meanwhile could be connected to itself. Nor is it up to 10080,
    where browsers refuse some (the Fetch standard's bad ports). Each process of a run has ports of its own: a server
    that is away for a while finds its port free again.
    """
    first = int(Path("/proc/sys/net/ipv4/ip_local_port_range").read_text().split()[0])
    number, count = _process_of_run()
    ports = range(10_081 + number, first, count) if first > 20_000 else (0,)
    while True:
        with socket.socket() as probe, suppress(OSError):
            probe.bind(("127.0.0.1", secrets.choice(ports)))
            port = int(probe.getsockname()[1])
            if port not in _given:
                _given.add(port)
                return port


def _process_of_run() -> tuple[int, int]:
    """Which of pytest-xdist's processes this is, from 0, and how many there are."""
    count = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
    return int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw")) % count, count


def stop(process: subprocess.Popen[bytes]) -> None:
    """End a server; one that does not is killed."""
    process.terminate()
    try:
        process.wait(10)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


@contextmanager
def redis_server(folder: Path, port: int | None = None) -> Iterator[str]:
    """A Redis server of our own, at a free port or a given one; its URL."""
    command = installed("redis-server", "valkey-server")
    port = port or free_port()
    process = subprocess.Popen(
        [command, "--port", str(port), "--bind", "127.0.0.1", "--dir", str(folder), "--save", ""],
        stdout=subprocess.DEVNULL,
    )
    try:
        with redis.Redis(port=port) as client:

            def answers() -> bool:
                assert process.poll() is None, "Redis ended by itself"
                with suppress(redis.ConnectionError, redis.TimeoutError):
                    return bool(client.ping())
                return False

            until(answers, 120, said=lambda: "Redis does not answer")
        yield f"redis://127.0.0.1:{port}/0"
    finally:
        stop(process)


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
    """A PostgreSQL cluster of our own, or the one that is given; the URL of its first database."""
    given = os.environ.get("PVG_TEST_DATABASE_URL")
    if given:
        yield given
        return
    with postgres_of_our_own() as server:
        yield server.url


@contextmanager
def postgres_of_our_own() -> Iterator[Postgres]:
    """A PostgreSQL cluster that may be stopped."""
    binaries = _postgres_bin()
    if binaries is None:
        missing("PostgreSQL is not installed")
    # pytest's own temporary folders are closed to other users, and PostgreSQL refuses to run as root
    with tempfile.TemporaryDirectory(prefix="pvg-postgres-") as name:
        yield from _run_postgres(binaries, Path(name))


class Postgres:
    """A PostgreSQL cluster in a folder, not started yet."""

    def __init__(self, binaries: Path, folder: Path) -> None:
        prefix: list[str] = []
        if os.geteuid() == 0:
            prefix = ["runuser", "-u", "postgres", "--"]
            shutil.chown(folder, "postgres")
        self._folder, self._data, port = folder, folder / "data", free_port()
        init = [*prefix, str(binaries / "initdb"), "-D", str(self._data), "-U", "pvg", "-A", "trust", "--no-sync"]
        _run(init, folder)
        self._options = f"-p {port} -c listen_addresses=127.0.0.1 -c unix_socket_directories={folder} -c fsync=off"
        self._control = [*prefix, str(binaries / "pg_ctl"), "-D", str(self._data), "-w"]
        self.url = f"postgresql+psycopg://pvg@127.0.0.1:{port}/postgres"

    def start(self) -> None:
        """Start it, also after `stop`."""
        _run([*self._control, "-o", self._options, "-l", str(self._folder / "log"), "start"], self._folder)

    def stop(self) -> None:
        """Stop it as a crash does: connections end, and are refused."""
        _run([*self._control, "-m", "immediate", "stop"], self._folder)

    def freeze(self) -> None:
        """Stop its processes where they are: connections stay, and nothing answers."""
        self._signal(signal.SIGSTOP)

    def thaw(self) -> None:
        """Let its processes go on."""
        self._signal(signal.SIGCONT)

    def _signal(self, number: signal.Signals) -> None:
        first = (self._data / "postmaster.pid").read_text().split()[0]
        # the one that starts others first, so that none is missed
        os.kill(int(first), number)
        for child in Path(f"/proc/{first}/task/{first}/children").read_text().split():
            with suppress(ProcessLookupError):  # it ended meanwhile
                os.kill(int(child), number)


def _run_postgres(binaries: Path, folder: Path) -> Iterator[Postgres]:
    server = Postgres(binaries, folder)
    server.start()
    try:
        yield server
    finally:
        server.stop()


class Wire:
    """A port that leads to a server, and can be cut: connections end, new ones are refused; or hang."""

    def __init__(self, port: int) -> None:
        self._target = port
        self.port = free_port()
        self._pairs: list[socket.socket] = []
        self._flows = threading.Event()
        self._answers = threading.Event()
        self._listener: socket.socket | None = None
        self._lock = threading.Lock()

    def connect(self) -> None:
        """Let everything through."""
        self._flows.set()
        self._answers.set()
        if self._listener is None:
            self._listener = socket.create_server(("127.0.0.1", self.port))
            threading.Thread(target=self._accept, args=(self._listener,), daemon=True).start()

    def cut(self) -> None:
        """End all connections and refuse new ones."""
        with self._lock:
            if self._listener is not None:
                self._listener.shutdown(socket.SHUT_RDWR)
                self._listener.close()
                self._listener = None
            for one in self._pairs:
                with suppress(OSError):
                    one.shutdown(socket.SHUT_RDWR)
            self._pairs.clear()

    def hang(self) -> None:
        """Let nothing through, and end nothing."""
        self._flows.clear()

    def mute(self) -> None:
        """Let the server hear what it is asked, and nobody hear what it answers."""
        self._answers.clear()

    def _accept(self, listener: socket.socket) -> None:
        with suppress(OSError):
            while True:
                near = listener.accept()[0]
                far = socket.create_connection(("127.0.0.1", self._target))
                with self._lock:
                    if self._listener is not listener:  # it was cut meanwhile
                        near.close()
                        far.close()
                        return
                    self._pairs += [near, far]
                for source, sink, flows in ((near, far, self._flows), (far, near, self._answers)):
                    threading.Thread(target=self._pump, args=(source, sink, flows), daemon=True).start()

    def _pump(self, source: socket.socket, sink: socket.socket, flows: threading.Event) -> None:
        with suppress(OSError):
            while data := source.recv(65536):
                self._flows.wait()
                flows.wait()
                sink.sendall(data)
        for one in (source, sink):
            with suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)
        source.close()  # the sink is another pump's source


@contextmanager
def wire_to(url: str) -> Iterator[tuple[Wire, str]]:
    """A wire to the server of a database, and the URL that leads over it."""
    parsed = make_url(url)
    assert parsed.port is not None
    with _connected(parsed.port) as wire:
        yield wire, parsed.set(port=wire.port).render_as_string(hide_password=False)


@contextmanager
def wired(url: str) -> Iterator[tuple[Wire, str]]:
    """A wire to a web server of this machine, and the URL that leads over it."""
    port = urlsplit(url).port
    assert port is not None
    with _connected(port) as wire:
        yield wire, f"http://127.0.0.1:{wire.port}"


@contextmanager
def _connected(port: int) -> Iterator[Wire]:
    wire = Wire(port)
    wire.connect()
    try:
        yield wire
    finally:
        wire.connect()
        wire.cut()


_COPY: Final = "_copy"


def is_from_template(url: str) -> bool:
    """The database was made from another one, with its tables."""
    return str(make_url(url).database).endswith(_COPY)


@contextmanager
def fresh_database(server_url: str, template: str = "template1", *, patient: bool = True) -> Iterator[str]:
    """A database of its own in the server, empty or like the one of this name; its URL.

    patient: who uses the URL waits long to be connected. Many do at once, on a machine that stands still now and then;
    drills of outages have the service's own time.
    """
    url = make_url(server_url)
    name = f"pvg_test_{uuid.uuid4().hex[:12]}{_COPY if template != 'template1' else ''}"
    plain = url.set(drivername="postgresql").render_as_string(hide_password=False)
    with psycopg.connect(plain, autocommit=True) as connection:
        connection.execute(f'CREATE DATABASE "{name}" TEMPLATE "{template}"'.encode())
    try:
        query = {"connect_timeout": "60"} if patient else {}
        yield url.set(database=name).update_query_dict(query).render_as_string(hide_password=False)
    finally:
        with psycopg.connect(plain, autocommit=True) as connection:
            connection.execute(f'DROP DATABASE "{name}" WITH (FORCE)'.encode())
