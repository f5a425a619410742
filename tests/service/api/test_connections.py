"""The limits of connections, on the service as its command starts it."""

from __future__ import annotations

import asyncio
import errno
import json
import os
import resource
import select
import socket
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any
from unittest import mock

import httpx
import pytest
from uvicorn.server import ServerState

from service.api import connections
from service.api.connections import BoundedConfig, BoundedProtocol, Limits
from service.settings import Settings
from tests.promises import Drill
from tests.service.fixtures import MP4, PNG, Api, serve
from tests.waiting import until
from tests.worker.serving import Service, running_service

#: the service's limits in seconds, short so that a test is
IDLE, HEAD, BODY, SEND = 2, 3, 4, 3
SHORT = {"head_timeout_s": str(HEAD), "body_timeout_s": str(BODY), "send_timeout_s": str(SEND)}
#: where a client must not be cut off: a machine at work stands still for some seconds now and then
LONGER = 10


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """It waits long for the first byte of a request: between its connection and that a machine may stand still."""
    limits = SHORT | {"idle_timeout_s": "30"}
    with running_service(tmp_path_factory.mktemp("api"), arguments=("--no-worker",), **limits) as running:
        yield running


@pytest.fixture(scope="module")
def patient_service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    longer = SHORT | {"idle_timeout_s": str(LONGER), "body_timeout_s": str(LONGER)}
    with running_service(tmp_path_factory.mktemp("patient"), arguments=("--no-worker",), **longer) as running:
        yield running


@pytest.fixture
def hasty(tmp_path: Path) -> Iterator[Api]:
    """An API that waits for nothing for long."""
    limits = {"idle_timeout_s": IDLE, "head_timeout_s": HEAD, "body_timeout_s": BODY, "send_timeout_s": SEND}
    yield from serve(Settings(data_dir=tmp_path, reap_interval_s=3600, **limits))


@pytest.fixture(scope="module", autouse=True)
def many_descriptors() -> None:
    """The tests' own side needs some, too."""
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(hard, 8192) if hard != resource.RLIM_INFINITY else 8192, hard))


def connect(service: Service) -> socket.socket:
    url = service.client.base_url
    return socket.create_connection((url.host, url.port), timeout=60)


def all_of(connection: socket.socket) -> bytes:
    """What comes until the server closes."""
    received = b""
    try:
        while data := connection.recv(65536):
            received += data
    except ConnectionResetError:
        pass
    return received


def answer_to(service: Service, sent: bytes) -> tuple[int, dict[str, Any], bool]:
    """Status, problem, and whether it said that the connection closes, which it then has done."""
    with connect(service) as connection:
        connection.sendall(sent)
        head, _, body = all_of(connection).partition(b"\r\n\r\n")
    lines = head.decode().lower().splitlines()
    assert "content-type: application/problem+json" in lines, head
    return int(head.split()[1]), json.loads(body), "connection: close" in lines


@contextmanager
def waits_of_others(service: Service, path: str = "/videos") -> Iterator[list[float]]:
    """How long another client's requests take, one after the other, for the time of the block."""
    taken: list[float] = []
    done = threading.Event()

    def ask() -> None:
        while not done.is_set():
            began = time.monotonic()
            try:
                answer = service.client.get(path)
            except httpx.RemoteProtocolError:  # it was silent for too long just before it asked (RFC 9112, 9.5)
                answer = service.client.get(path)
            assert answer.status_code == 200
            taken.append(time.monotonic() - began)
            time.sleep(0.02)

    thread = threading.Thread(target=ask)
    thread.start()
    try:
        yield taken
    finally:
        done.set()
        thread.join()


def p99(taken: list[float]) -> float:
    """The largest is never it, of however few: a machine that stands still for once makes one large."""
    return sorted(taken)[min(int(len(taken) * 0.99), len(taken) - 2)]


def allowed_wait(service: Service) -> float:
    """The promise, 0.5 s, and what other work on this machine adds to it."""
    with waits_of_others(service) as taken:
        time.sleep(1)
    return 0.5 + 3 * max(taken)


def processor_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return sum(map(int, fields[11:13])) / os.sysconf("SC_CLK_TCK")


def processor_share(pid: int, seconds: float = 2) -> float:
    """How much of a processor it takes from now on."""
    used, began = processor_s(pid), time.monotonic()
    time.sleep(seconds)
    return (processor_s(pid) - used) / (time.monotonic() - began)


MANY_LINES = b"GET /livez HTTP/1.1\r\nHost: localhost\r\n" + b"a: b\r\n" * 10_000 + b"\r\n"
BODY_HEAD = b"POST /videos HTTP/1.1\r\nHost: localhost\r\nContent-Length: 100000\r\n\r\n"


def test_bodies_that_trickle_are_cut_off_and_hold_nobody_up(service: Service, promise: Callable[..., Drill]) -> None:
    trickle(service, promise("R10", wanted="others' p99 < 500 ms; each cut within 30 s"), f"a limit of {BODY} s")


@pytest.mark.slow
def test_bodies_that_trickle_are_cut_off_at_the_limit_that_is_set_by_default(
    tmp_path: Path, promise: Callable[..., Drill]
) -> None:
    with running_service(tmp_path, arguments=("--no-worker",)) as service:
        trickle(service, promise("R10", wanted="others' p99 < 500 ms; each cut within 30 s"), "the default limit")


def trickle(service: Service, drill: Drill, limit: str) -> None:
    """Send 200 bodies at a byte a second, until all are cut off, and measure what others notice of it."""
    allowed = allowed_wait(service)
    with ExitStack() as stack, waits_of_others(service) as taken:
        sockets = []
        for _ in range(200):
            sockets.append(stack.enter_context(connect(service)))
            sockets[-1].sendall(BODY_HEAD + MP4)  # at once: a silent connection is closed soon
        began, ended = time.monotonic(), dict[socket.socket, float]()
        answers = set()
        while len(ended) < len(sockets) and time.monotonic() - began < 120:
            for one in set(sockets) - ended.keys():
                try:
                    if select.select([one], [], [], 0)[0]:
                        answers.add(one.recv(65536).split(b"\r\n")[0])
                        ended[one] = time.monotonic() - began
                    else:
                        one.sendall(b"\0")
                except (BrokenPipeError, ConnectionResetError):
                    ended[one] = time.monotonic() - began
            time.sleep(1)
    last = max(ended.values(), default=0.0)
    drill.measured = f"p99 {1000 * p99(taken):.0f} ms; {len(ended)} cut within {last:.0f} s (at {limit})"
    drill.keep_to(last, 30)
    drill.keep_to(p99(taken), 0.5, busy=4 * allowed / 0.5)
    assert len(ended) == 200
    assert answers == {b"HTTP/1.1 408 Request Timeout"}
    # who uploads is answered first, and what has come is dropped next
    until(lambda: list((service.data_dir / "spool").iterdir()) == [])


def test_a_body_that_is_slow_but_not_too_slow_arrives(patient_service: Service) -> None:
    content = MP4 + os.urandom(2000 * (LONGER + 2))
    with connect(patient_service) as connection:
        head = (
            f"POST /videos HTTP/1.1\r\nHost: localhost\r\nContent-Length: {len(content)}\r\nConnection: close\r\n\r\n"
        )
        connection.sendall(head.encode())
        began, sent = time.monotonic(), 0
        while sent < len(content):  # 2,000 bytes a second, for longer than the limit, and what was missed
            due = 1000 + int(2000 * (time.monotonic() - began))
            connection.sendall(content[sent:due])
            sent = due
            time.sleep(0.5)
        assert all_of(connection).startswith(b"HTTP/1.1 202 ")


def test_silent_connections_are_closed(hasty: Api) -> None:
    began = time.monotonic()
    with socket.create_connection(hasty.address, timeout=60) as connection:
        assert all_of(connection) == b""
        assert IDLE - 1 < time.monotonic() - began < 10 * IDLE


def test_a_head_that_trickles_is_refused(service: Service) -> None:
    with connect(service) as connection:
        connection.sendall(b"GET /livez HTTP/1.1\r\n")
        began = time.monotonic()
        with suppress(ConnectionError):  # it has been refused since the last look
            while time.monotonic() - began < 10 * HEAD and not select.select([connection], [], [], 0.5)[0]:
                connection.sendall(b"a")
        answer = all_of(connection)
        assert answer.startswith(b"HTTP/1.1 408 ")
        assert b'"too-slow"' in answer


def test_who_does_not_take_the_answer_is_cut_off(service: Service) -> None:
    with connect(service) as connection:
        # 40 MB: more than the kernel keeps on either side
        connection.sendall(b"GET /docs/assets/redoc.standalone.js HTTP/1.1\r\nHost: localhost\r\n\r\n" * 40)
        until(lambda: is_closed_by_server(connection))
        assert 0 < all_of(connection).count(b"HTTP/1.1 200 ") < 40


def is_closed_by_server(connection: socket.socket) -> bool:
    """The server has closed its end, whatever the kernel still has of it for us."""
    ends = (f"{port:04X}" for _, port in (connection.getpeername(), connection.getsockname()))
    there = " ".join(f"0100007F:{port}" for port in ends)  # from the server to us
    return f"{there} 01 " not in Path("/proc/net/tcp").read_text()  # 01: established


def test_a_client_that_waits_for_an_answer_is_left_alone(hasty: Api) -> None:
    def waited() -> float:
        with suppress(httpx.TransportError):  # it was silent for too long before it asked
            job = hasty.client.post("/references", content=PNG + b"x").json()["job"]
            began = time.monotonic()
            assert hasty.client.get(f"/jobs/{job}?wait=6").status_code == 200
            return time.monotonic() - began
        return 0

    assert until(waited) > 5


def test_connections_are_kept_between_requests_and_requests_may_follow_each_other(patient_service: Service) -> None:
    request = b"GET /livez HTTP/1.1\r\nHost: localhost\r\n\r\n"
    with connect(patient_service) as connection:
        for _ in range(6):  # for longer than the limit, and each pause well below it
            time.sleep(LONGER / 5)
            connection.sendall(request * 2)
            received = b""
            while received.count(b'{"status":"ok"}') < 2:
                data = connection.recv(65536)
                assert data, "it was closed"
                received += data


@pytest.mark.parametrize(
    ("sent", "status"),
    [
        (b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03", 400),
        (b"GET /livez\r\n\r\n", 400),
        (b"GET /livez HTTP/1.1\r\n\r\n", 400),  # no Host
        (b"GET /livez HTTP/1.1\r\nHost: localhost\r\nHost: localhost\r\n\r\n", 400),
        (b"GET /livez HTTP/1.1\r\nHost: localhost\r\nno colon\r\n\r\n", 400),
        (b"GET /livez HTTP/1.1\r\nHost: localhost\r\na: " + b"x" * 20_000, 431),
        (b"GET /livez HTTP/1.1\r\nHost: localhost\r\na: " + b"x" * 20_000 + b"\r\n\r\n", 431),
        (MANY_LINES, 431),
        (b"POST /videos HTTP/1.1\r\nHost: localhost\r\nContent-Length: 1\r\nContent-Length: 2\r\n\r\nx", 400),
        (b"POST /videos HTTP/1.1\r\nHost: localhost\r\nContent-Length: -1\r\n\r\n", 400),
        (b"POST /videos HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: gzip, chunked\r\n\r\n", 501),
        (
            b"POST /videos HTTP/1.1\r\nHost: localhost\r\nContent-Length: 5\r\nTransfer-Encoding: chunked\r\n\r\n"
            b"0\r\n\r\nGET /videos HTTP/1.1\r\nHost: localhost\r\n\r\n",
            400,
        ),
        (b"POST /videos HTTP/1.0\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\n", 400),
        (b"POST /videos HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\nzz\r\n", 400),
        (b"HEAD /livez HTTP/1.1\r\nHost: localhost\r\nContent-Length: 5\r\nTransfer-Encoding: chunked\r\n\r\n", 400),
    ],
)
def test_what_is_no_http_is_a_problem_and_the_connection_closes(service: Service, sent: bytes, status: int) -> None:
    answered, problem, closes = answer_to(service, sent)
    assert (answered, problem["status"], closes) == (status, status, True)
    assert {"type", "title", "detail", "instance"} <= problem.keys()
    assert problem["request_id"].startswith("req_")


def test_a_body_that_breaks_http_with_its_first_bytes_is_answered_with_the_requests_id(service: Service) -> None:
    """The application has not begun when the head and such a body come at once."""
    broken = (
        b"POST /videos HTTP/1.1\r\nHost: localhost\r\nX-Request-ID: mine\r\nTransfer-Encoding: chunked\r\n\r\nzz\r\n"
    )
    with connect(service) as connection:
        connection.sendall(broken)
        answer = connection.recv(65536)
    assert b"\r\nX-Request-ID: mine\r\n" in answer
    assert json.loads(answer.partition(b"\r\n\r\n")[2])["request_id"] == "mine"


CHUNKED = b"POST /livez HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\n"


@pytest.mark.parametrize(
    ("size", "number", "status"), [(1, 3000, 400), (63, 3000, 400), (64, 3000, 405), (1, 900, 405)]
)
def test_a_body_of_thousands_of_tiny_chunks_is_refused(service: Service, size: int, number: int, status: int) -> None:
    chunk = b"%x\r\n%s\r\n" % (size, b"a" * size)
    with connect(service) as connection:
        connection.sendall(CHUNKED + chunk * number + b"0\r\n\r\n")
        answer = connection.recv(65536)
    assert answer.startswith(b"HTTP/1.1 %d " % status)
    assert (b"fewer than 64 bytes on average" in answer) == (status == 400)


@pytest.fixture
def full(tmp_path: Path) -> Iterator[Api]:
    """An API of few connections, which waits long for who takes no answer or sends no body."""
    patient = {"send_timeout_s": 3600, "body_timeout_s": 3600}
    yield from serve(Settings(data_dir=tmp_path, reap_interval_s=3600, max_connections=20, **patient))


def leave_unread(api: Api, stack: ExitStack, number: int) -> None:
    for _ in range(number):
        reader = stack.enter_context(socket.socket())
        reader.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        reader.connect(api.address)
        reader.sendall(b"GET /docs/assets/redoc.standalone.js HTTP/1.1\r\nHost: localhost\r\n\r\n" * 20)
        assert reader.recv(1) == b"H"


def is_served(api: Api) -> bool:
    with httpx.Client(base_url=api.client.base_url, timeout=60) as client:
        return client.get("/livez").status_code == 200


def test_who_takes_no_answer_makes_room_for_others(full: Api) -> None:
    with ExitStack() as stack:
        leave_unread(full, stack, 20)
        until(lambda: is_served(full))


def test_who_takes_an_answer_slowly_is_not_cut_off(full: Api, monkeypatch: pytest.MonkeyPatch) -> None:
    """The buffer is full nearly all the time, for a disk is faster than he is."""
    monkeypatch.setattr(connections, "UNREAD_S", 3.0)
    with httpx.Client(base_url=full.client.base_url, timeout=60) as client:
        made = client.post("/videos", content=MP4 + bytes(40_000_000), headers={"Content-Type": "video/mp4"})
    request = f"GET /videos/{made.json()['id']}/file HTTP/1.1\r\nHost: localhost\r\n\r\n".encode()
    stopped, ended = threading.Event(), list[socket.socket]()
    with ThreadPoolExecutor(1) as thread, ExitStack() as stack:
        stack.callback(stopped.set)
        readers = [stack.enter_context(socket.create_connection(full.address, timeout=60)) for _ in range(20)]

        def read() -> None:
            while not stopped.wait(0.05):
                ended.extend(reader for reader in readers if reader not in ended and not reader.recv(65536))

        for reader in readers:
            reader.sendall(request)
        reading = thread.submit(read)
        for wait_s in (1, 4, 1):
            time.sleep(wait_s)
            assert not is_served(full)
        stopped.set()
        reading.result(60)
        assert ended == []


def test_unread_answers_make_room_where_they_have_more_than_half_of_it(
    full: Api, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connections, "UNREAD_S", 1.0)
    with ExitStack() as stack:
        for number in range(10):
            sender = stack.enter_context(socket.create_connection(full.address, timeout=60))
            sender.sendall(b"POST /videos HTTP/1.1\r\nHost: localhost\r\nContent-Length: 99999\r\n\r\n" + MP4)
            until(lambda number=number: len(full.drafts) == number + 1)
        leave_unread(full, stack, 10)
        time.sleep(4)
        assert [is_served(full) for _ in range(3)] == [False] * 3
        # one that was refused and is still there had no place: without it there is no room either
        refused = stack.enter_context(socket.create_connection(full.address, timeout=60))
        refused.sendall(b"GET /livez HTTP/1.1\r\nHost: localhost\r\n\r\n")
        assert b" 503 " in refused.recv(65536)
        assert not is_served(full)


def test_the_log_stays_small(service: Service) -> None:
    before = service.log.stat().st_size
    for _ in range(300):
        answer_to(service, b"garbage\r\n\r\n")
    assert service.log.stat().st_size - before < 2000


def test_a_client_that_is_gone_when_it_is_refused_is_no_error() -> None:
    """Its socket cannot be shut down any more."""

    async def refuse() -> mock.Mock:
        config = BoundedConfig(lambda: None, Limits.of(Settings()), log_config=None)
        config.load()
        protocol = BoundedProtocol(config, ServerState(), {}, asyncio.get_running_loop())
        transport = mock.Mock(spec=asyncio.Transport)
        transport.is_closing.return_value = False
        transport.get_extra_info.return_value = None
        transport.write_eof.side_effect = OSError(errno.ENOTCONN, "not connected")
        protocol.connection_made(transport)
        protocol.data_received(b"garbage\r\n\r\n")
        protocol.connection_lost(None)
        return transport

    transport = asyncio.run(refuse())
    assert transport.write.call_args.args[0].startswith(b"HTTP/1.1 400 ")
    transport.abort.assert_called_once_with()


@pytest.mark.parametrize("limit", ["5 s", pytest.param("the default", marks=pytest.mark.slow)])
def test_more_clients_than_there_are_places(tmp_path: Path, promise: Callable[..., Drill], limit: str) -> None:
    """1,100 silent connections, and 1,024 descriptors: those that wait make room, others are served.

    And some that send heads of 10,000 lines.
    """
    drill = promise("R24", wanted="others' p99 < 500 ms; idle ones cut within 30 s; log bounded")
    limited = ("sh", "-c", 'ulimit -n 1024; exec "$@"', "sh")
    settings = SHORT | {"idle_timeout_s": "5"} if limit == "5 s" else {}
    with (
        running_service(tmp_path, arguments=("--no-worker",), before=limited, **settings) as service,
        ExitStack() as stack,
    ):
        allowed, began = allowed_wait(service), time.monotonic()
        with waits_of_others(service) as meanwhile:
            sockets = [stack.enter_context(connect(service)) for _ in range(1100)]
            until(lambda: len(closed(sockets)) >= 1100 - Settings().max_connections)  # all have come there
        assert processor_share(service.process.pid) < 0.8
        with waits_of_others(service) as afterwards:
            assert len(os.listdir(f"/proc/{service.process.pid}/fd")) < 1000
            many_lines = {answer_to(service, MANY_LINES)[0] for _ in range(20)}
            while len(closed(sockets)) < 1100:
                assert time.monotonic() - began < 120
                time.sleep(0.2)
            gone, log = time.monotonic() - began, service.log.stat().st_size
            until(lambda: len(afterwards) > 20)
        taken = meanwhile + afterwards
        drill.measured = (
            f"p99 {1000 * p99(taken):.0f} ms; all cut after {gone:.0f} s (at {limit}); 20 times 10,000 lines: "
            f"{many_lines}; log of {log / 1000:.0f} kB"
        )
        drill.keep_to(gone, 30)
        drill.keep_to(p99(taken), 0.5, busy=4 * allowed / 0.5)
        assert many_lines == {431}
        assert service.log.stat().st_size < 100_000 + 200 * len(taken)


def closed(sockets: list[socket.socket]) -> list[int]:
    """Those that the server has closed. select() knows no descriptors above 1023."""
    poller = select.poll()
    for one in sockets:
        poller.register(one, select.POLLIN)
    return [number for number, _ in poller.poll(0)]


def test_a_lack_of_descriptors_neither_spins_nor_fills_the_log(tmp_path: Path) -> None:
    limited = ("sh", "-c", 'ulimit -n 26; exec "$@"', "sh")
    with running_service(tmp_path, arguments=("--no-worker",), before=limited, idle_timeout_s="4") as service:
        service.client.close()
        with ExitStack() as stack:
            logged = service.log.stat().st_size
            for _ in range(120):
                stack.enter_context(connect(service))
            assert processor_share(service.process.pid) < 0.5
            assert service.log.stat().st_size - logged < 5000
            until(lambda: "no more connections can be accepted" in service.log.read_text())
        with connect(service) as connection:
            connection.sendall(b"GET /livez HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")
            assert all_of(connection).startswith(b"HTTP/1.1 200 ")
