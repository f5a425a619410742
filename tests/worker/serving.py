"""`pvg-service` as a user starts it, for tests that talk to the real thing.

"Embedded" is one `pvg-service serve`: SQLite, files, a broker of files, workers as its children. "Scaled" is two APIs,
two workers and one of previews, which share PostgreSQL, Redis and S3 and nothing else: each has a data folder of its
own, and each call of a client goes to the API that did not get the one before.
"""

from __future__ import annotations

import itertools
import json
import os
import signal
import subprocess
import sys
import time
import uuid
from collections import deque
from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import httpx
import pytest
import redis

from service.queue import PREVIEW
from tests.folders import files_below
from tests.service.s3 import S3
from tests.service.servers import free_port, fresh_database
from tests.waiting import until

#: of the services that were started last; a failing test shows the end of them
_LOGS: deque[Path] = deque(maxlen=2)
_SHOWN_CHARACTERS = 6000
#: a start is not measured here, and a busy machine warms its sandbox slowly
_START_S = 180
#: seconds for which a patient client asks again
_PATIENCE_S = 60


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    call: pytest.CallInfo[None],
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    if report.failed:
        for log in _LOGS:
            if log.exists() and log.stat().st_mtime >= call.start:
                report.sections.append((f"end of {log.parent.name}/{log.name}", log.read_text()[-_SHOWN_CHARACTERS:]))
    return report


class Turns(httpx.BaseTransport):
    """Takes each request to another of several APIs than the one before, whichever of them it names.

    patient: what is answered 503 is sent again for a minute, and a POST has an Idempotency-Key for it. A service waits
    for its records for some seconds, and a machine at work stands still for as long now and then.
    """

    def __init__(self, ports: Sequence[int], *, patient: bool = True) -> None:
        self._ports = frozenset(ports)
        self._turns = itertools.cycle(ports)
        self._patient = patient
        self._wire = httpx.HTTPTransport()

    def handle_request(self, request: httpx.Request) -> httpx.Response:
        if not self._patient or not _may_be_repeated(request):
            return self._sent(request)
        if request.method == "POST" and request.url.path != "/preview":  # which changes nothing
            request.headers.setdefault("Idempotency-Key", uuid.uuid4().hex)
        end = time.monotonic() + _PATIENCE_S
        answer = self._sent(request)
        while answer.status_code == 503 and time.monotonic() < end:
            answer.close()
            time.sleep(0.5)
            answer = self._sent(request)
            if _is_at_work_still(answer):  # of a request that nobody waits for any more
                answer.status_code = 503
        return answer

    def _sent(self, request: httpx.Request) -> httpx.Response:
        if request.url.port in self._ports:
            request.url = request.url.copy_with(port=next(self._turns))
            request.headers["Host"] = request.url.netloc.decode()
        return self._wire.handle_request(request)

    def close(self) -> None:
        self._wire.close()


def _may_be_repeated(request: httpx.Request) -> bool:
    """It is no question for the service's own state, doing it twice does no harm, and its body is not read away."""
    return (
        request.url.path != "/readyz"
        and request.method in {"GET", "HEAD", "POST", "DELETE"}
        and (isinstance(request.stream, httpx.ByteStream) or "multipart" in request.headers.get("Content-Type", ""))
    )


def _is_at_work_still(answer: httpx.Response) -> bool:
    """A request with the same Idempotency-Key is."""
    return answer.status_code == 409 and b"idempotency-key-in-use" in answer.read()


@dataclass(frozen=True)
class Service:
    """A running service, and every process that belongs to it.

    process: the API, or the first of several. data_dir: its folder. others: the folders of the other processes.
    patient: its clients are, see `Turns`.
    """

    client: httpx.Client
    process: subprocess.Popen[bytes]
    data_dir: Path
    log: Path
    ports: tuple[int, ...] = ()
    others: tuple[Path, ...] = ()
    s3: S3 | None = None
    settings: dict[str, str] = field(default_factory=dict)
    patient: bool = True

    @property
    def folders(self) -> tuple[Path, ...]:
        return (self.data_dir, *self.others)

    def processes(self) -> dict[int, str]:
        """Pid and command line of all processes of this service, however they were started."""
        return {pid: command for folder in self.folders for pid, command in processes_of(folder).items()}

    def new_client(self) -> httpx.Client:
        """Another client of it."""
        return httpx.Client(
            base_url=self.client.base_url, timeout=60, transport=Turns(self.ports, patient=self.patient)
        )

    def drafts(self) -> list[Path]:
        """What any process of it has not finished writing."""
        return [path for folder in self.folders for path in (folder / "spool").iterdir()]

    def blobs(self) -> list[str]:
        """The keys of everything that it keeps, but for the mark of its store."""
        if self.s3 is not None:
            keys = self.s3.listed()
        else:
            keys = [str(path.relative_to(self.data_dir)) for path in self.data_dir.glob("blobs/**/*") if path.is_file()]
        return sorted(key for key in keys if "/." not in key)

    def blob(self, key: str) -> bytes:
        """The bytes of one of `blobs`."""
        return (self.data_dir / key).read_bytes() if self.s3 is None else self.s3.read(key)

    def sizes(self) -> dict[str, int]:
        """The size of everything in S3, by its key; nothing where it keeps files."""
        return {} if self.s3 is None else self.s3.sizes()

    def files(self) -> list[Path]:
        """Every file in its folders."""
        return [path for folder in self.folders for path in files_below(folder)]

    def upload(self, path: str, file: Path, **fields: str) -> dict[str, Any]:
        with file.open("rb") as data:
            answer = self.client.post(path, files={"file": (file.name, data)}, data=fields)
        assert answer.status_code in {200, 202}, answer.text
        body: dict[str, Any] = answer.json()
        return body

    def job(self, job_id: str) -> dict[str, Any]:
        """A job as it is; of a service that has no time for an answer (503) it is asked for again."""
        end = time.monotonic() + 30
        while True:
            answer = self.client.get(f"/jobs/{job_id}")
            if answer.status_code != 503 or time.monotonic() > end:
                assert answer.is_success, f"{answer.status_code} {answer.text}\n{self.log.read_text()[-4000:]}"
                return dict(answer.json())
            time.sleep(0.5)

    def finished(self, job_id: str, seconds: float = 300) -> dict[str, Any]:
        """The job once it is done."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            body = self.job(f"{job_id}?wait=10")
            if body["done"]:
                return body
        raise AssertionError(f"not done after {seconds} s: {body}\n{self.log.read_text()[-4000:]}")

    def finished_at_last(self, job_id: str, seconds: float) -> dict[str, Any]:
        """The job once it is done, by a service that may not answer for a while."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            answer = self.client.get(f"/jobs/{job_id}")
            if answer.is_success and answer.json()["done"]:
                return dict(answer.json())
            time.sleep(0.2)
        raise AssertionError(f"not done after {seconds} s: {answer.text}\n{self.log.read_text()[-4000:]}")

    def at_work(self, job_id: str, seconds: float = 240) -> None:
        """Wait until a job has done a frame."""
        until(
            lambda: self.job(job_id)["progress"]["frames_done"] >= 1,
            seconds,
            said=lambda: self.log.read_text()[-4000:],
        )

    def folder_of(self, job_id: str) -> Path:
        """The data folder of the worker that is at work on a job: what it writes is there, under the job's id.

        What killed attempts have left there is older.
        """

        def written(path: Path) -> float:
            with suppress(FileNotFoundError):  # it is cleared away
                return path.stat().st_mtime
            return 0.0

        return max((path for path in self.drafts() if job_id in path.name), key=written).parent.parent

    def events(self, event: str, **values: object) -> list[dict[str, Any]]:
        """What the log says of an event."""
        whole = self.log.read_text().rpartition("\n")[0]  # the last line may still be written
        lines = [json.loads(line) for line in whole.splitlines() if line.startswith("{")]
        return [line for line in lines if line["event"] == event and values.items() <= line.items()]

    def ready(self, path: str, file: Path) -> dict[str, Any]:
        """Upload and wait for the vectorisation."""
        medium = self.upload(path, file)
        job = self.finished(medium["job"])
        assert job["state"] == "succeeded", job
        body: dict[str, Any] = self.client.get(f"{path}/{medium['id']}").json()
        return body


def processes_of(data_dir: Path) -> dict[int, str]:
    """Every living process whose environment, or whose last argument as that of a sandbox, names this data folder."""
    marker = f"PVG_DATA_DIR={data_dir}".encode()
    found = {}
    for entry in Path("/proc").iterdir():
        if not entry.name.isdigit():
            continue
        try:
            command = (entry / "cmdline").read_bytes()
            if marker in (entry / "environ").read_bytes().split(b"\0") or command.endswith(f"\0{data_dir}\0".encode()):
                found[int(entry.name)] = command.replace(b"\0", b" ").decode()
        except OSError:
            continue  # it ended, is a zombie, or is another user's
    return found


def worker_processes(data_dir: Path, at_least: int = 1) -> set[int]:
    """The worker's main process and its pool children, once there are so many."""

    def found() -> set[int]:
        return {pid for pid, command in processes_of(data_dir).items() if "worker.app" in command}

    return until(lambda: now if len(now := found()) >= at_least else set(), _START_S, said=found)


def pool_child(service: Service, job_id: str) -> int:
    """The pool child that has a job; its worker has a single slot."""
    workers = worker_processes(service.folder_of(job_id), 2)
    (child,) = [pid for pid in workers if parent_of(pid) in workers]
    return child


def sandboxed(service: Service) -> list[int]:
    """The processes in which media are worked on: those that a fork server has forked."""
    found = {pid for pid, command in service.processes().items() if "worker.sandbox" in command}
    forked = []
    for pid in found:
        with suppress(OSError):  # it has ended since
            if parent_of(pid) in found:
                forked.append(pid)
    return forked


def parent_of(pid: int) -> int:
    return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])


def kill_all(pids: Iterable[int], number: signal.Signals = signal.SIGKILL) -> None:
    """Send a signal to processes; some of them may end by themselves meanwhile."""
    for pid in pids:
        with suppress(ProcessLookupError):
            os.kill(pid, number)


def wait_until_gone(data_dir: Path, seconds: float) -> dict[int, str]:
    """Processes that are still there after so many seconds."""
    end = time.monotonic() + seconds
    while (left := processes_of(data_dir)) and time.monotonic() < end:
        time.sleep(0.1)
    return left


@contextmanager
def running_service(
    folder: Path,
    *,
    cwd: Path | None = None,
    before: Sequence[str] = (),
    arguments: Sequence[str] = (),
    patient: bool = True,
    until_answers: str = "/readyz",
    **settings: str,
) -> Iterator[Service]:
    """Start the service with these settings (without their prefix), stop it with Ctrl-C's signal.

    ``before`` is a command that runs another, such as `strace`; ``arguments`` go to `serve`. Drills of outages have no
    ``patient`` client. One that is not to be ready is waited for ``until_answers`` "/livez".
    """
    data_dir, log, port = folder / "data", folder / "service.log", free_port()
    with (
        started(
            [*before, *COMMAND, "serve", *arguments], data_dir, log, cwd=cwd, port=str(port), **settings
        ) as process,
        httpx.Client(
            base_url=f"http://127.0.0.1:{port}", timeout=60, transport=Turns([port], patient=patient)
        ) as client,
    ):
        _wait_until_ready([process], [port], log, until_answers)
        yield Service(client, process, data_dir, log, (port,), settings=settings, patient=patient)


@contextmanager
def running_scaled(
    folder: Path,
    *,
    database_url: str,
    broker_url: str,
    s3: S3,
    workers: int = 2,
    previews: int = 1,
    environments: Mapping[str, Mapping[str, str]] = MappingProxyType({}),
    patient: bool = True,
    **settings: str,
) -> Iterator[Service]:
    """Start two APIs and so many workers that share only these three, all at once; stop them together.

    ``environments`` are variables of one process alone, by the name of its folder: `api-0`, `api-1`, `worker-2` and on.
    ``patient`` as for `running_service`.
    """
    log, ports = folder / "service.log", (free_port(), free_port())
    shared = {"worker_concurrency": "1", "link_secret": "shared-by-all-and-known-to-nobody"} | settings
    shared |= {"database_url": database_url, "broker_url": broker_url, "storage_url": s3.storage_url}
    roles = [("api", ["serve", "--no-worker"])] * len(ports)
    roles += [("worker", ["worker"])] * workers + [("previews", ["worker", "--queues", PREVIEW])] * previews
    with ExitStack() as stack:
        processes, folders = [], []
        for number, (role, arguments) in enumerate(roles):
            folders.append(folder / f"{role}-{number}")
            port = {"port": str(ports[number])} if role == "api" else {}
            own = s3.environment() | dict(environments.get(folders[-1].name, {}))
            one = started([*COMMAND, *arguments], folders[-1], log, environment=own, **port, **shared)
            processes.append(stack.enter_context(one))
        client = stack.enter_context(
            httpx.Client(base_url=f"http://127.0.0.1:{ports[0]}", timeout=60, transport=Turns(ports, patient=patient))
        )
        _wait_until_ready(processes, ports, log)
        yield Service(client, processes[0], folders[0], log, ports, tuple(folders[1:]), s3, shared, patient)
        for process in processes:  # all of them begin to stop before one is waited for
            process.send_signal(signal.SIGINT if process.args[1] == "serve" else signal.SIGTERM)


@contextmanager
def running_afresh(
    folder: Path, *, postgres_url: str, broker_url: str, s3: S3, store_port: int | None = None, **options: Any
) -> Iterator[Service]:
    """`running_scaled` with a database and a bucket of its own, reached by another port if one is given."""
    with fresh_database(postgres_url) as database, s3.fresh_bucket() as bucket:
        store = bucket if store_port is None else replace(bucket, url=f"http://127.0.0.1:{store_port}")
        shared = {"database_url": database, "broker_url": broker_url, "s3": store}
        with running_scaled(folder, **shared, **options) as running:
            yield running


COMMAND = (str(Path(sys.executable).with_name("pvg-service")),)


@contextmanager
def started(
    command: Sequence[str],
    data_dir: Path,
    log: Path,
    *,
    cwd: Path | None = None,
    environment: Mapping[str, str] | None = None,
    **settings: str,
) -> Iterator[subprocess.Popen[bytes]]:
    """One command with a data folder; stopped with Ctrl-C's signal, and with it whatever it began."""
    if log not in _LOGS:
        _LOGS.append(log)
    own = {name: value for name, value in os.environ.items() if not name.startswith(("PVG_", "AWS_"))}
    own |= {"PVG_DATA_DIR": str(data_dir), "OMP_NUM_THREADS": "1"} | dict(environment or {})
    own |= {f"PVG_{name.upper()}": value for name, value in settings.items()}
    with log.open("ab") as output:
        process = subprocess.Popen(command, cwd=cwd, env=own, stdout=output, stderr=output, start_new_session=True)
    try:
        yield process
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            try:
                process.wait(40)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        kill_all(processes_of(data_dir))


def _wait_until_ready(
    processes: Sequence[subprocess.Popen[bytes]], ports: Sequence[int], log: Path, path: str = "/readyz"
) -> None:
    waiting, end = list(ports), time.monotonic() + _START_S
    while waiting:
        assert all(process.poll() is None for process in processes), log.read_text()
        assert time.monotonic() < end, log.read_text()
        try:
            if httpx.get(f"http://127.0.0.1:{waiting[0]}{path}", timeout=60).is_success:
                waiting.pop(0)
        except httpx.TransportError:
            time.sleep(0.1)


@contextmanager
def service_as(setting: str, request: pytest.FixtureRequest, folder: Path, **settings: str) -> Iterator[Service]:
    """The service "embedded" or "scaled"; see above."""
    if setting == "embedded":
        with running_service(folder, **settings) as running:
            yield running
        return
    broker = request.getfixturevalue("redis_url")
    with redis.Redis.from_url(broker) as former:
        former.flushdb()
    parts = {name: request.getfixturevalue(name) for name in ("postgres_url", "s3")}
    with running_afresh(folder, broker_url=broker, **parts, **settings) as running:
        yield running


def service_on(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, **settings: str
) -> Iterator[Service]:
    """The service on the setting that a fixture's parameter names."""
    with service_as(request.param, request, tmp_path_factory.mktemp(request.param), **settings) as running:
        yield running
