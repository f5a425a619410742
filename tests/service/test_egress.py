from __future__ import annotations

import asyncio
import errno
import ipaddress
import ssl
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from socket import socket

import pytest

from service import egress as egress_module
from service.egress import MAX_REDIRECTS, Egress, is_public
from service.errors import FetchFailedError, ServiceError, UrlNotAllowedError
from service.settings import Settings
from tests.promises import Drill
from tests.service.remote import (
    PRIVATE,
    PUBLIC,
    Names,
    Remote,
    answer,
    connected,
    names,
    public_loopback,
    remote,
)
from tests.service.servers import free_port

__all__ = ["connected", "names", "public_loopback"]

#: what this process may never connect to, in every notation that some resolver or parser takes
PRIVATE_HOSTS = [
    *("127.0.0.1", "127.1", "2130706433", "0x7f000001", "0x7f.1", "0177.0.0.1", "017700000001", "127.0.0.1."),
    *("0", "0.0.0.0", "10.0.0.5", "172.16.3.4", "192.168.1.1", "169.254.169.254", "2852039166", "0xa9fea9fe"),
    *("100.64.0.1", "100.100.100.200", "192.0.0.192", "168.63.129.16", "198.18.0.1", "192.88.99.1", "224.0.0.1"),
    *("240.0.0.1", "255.255.255.255", "203.0.113.9"),
    *("[::]", "[::1]", "[0:0:0:0:0:0:0:1]", "[::ffff:127.0.0.1]", "[::ffff:7f00:1]", "[::127.0.0.1]"),
    *("[::ffff:0:127.0.0.1]", "[64:ff9b::7f00:1]", "[64:ff9b::169.254.169.254]", "[64:ff9b:1::a9fe:a9fe]"),
    *("[2002:7f00:1::]", "[2002:a9fe:a9fe::1]", "[2001:0:7f00:1::]", "[2001:db8::1]", "[3fff::1]"),
    *("[fe80::1]", "[fc00::1]", "[fd00:ec2::254]", "[ff02::1]", "[fec0::1]", "[100::1]", "[5f00::1]"),
]


@pytest.fixture
def egress(tmp_path: Path) -> Iterator[Egress]:
    made = Egress(Settings(data_dir=tmp_path))
    yield made
    made.close()


@pytest.fixture
def here() -> Iterator[Remote]:
    """What is at a public address."""
    with remote(PUBLIC, free_port()) as server:  # the same port is for others to listen at
        yield server


@pytest.fixture
def inside(here: Remote) -> Iterator[Remote]:
    """What must not be reached, at the same port."""
    with remote(PRIVATE, here.port) as server:
        server.answers["/"] = server.answers["/secret"] = answer(b"secret")
        yield server


@pytest.fixture
def at(here: Remote, names: Names, public_loopback: None) -> str:
    """The address of what is at a public address, by its name."""
    names.tell("public.example", PUBLIC)
    return f"http://public.example:{here.port}"


def fetch(egress: Egress, url: str) -> bytes:
    async def whole() -> bytes:
        async with egress.stream(url) as file:
            return b"".join([chunk async for chunk in file.chunks])

    return asyncio.run(whole())


@pytest.mark.parametrize("text", ["93.184.216.34", "1.1.1.1", "2606:4700::1111", "64:ff9b::5db8:d822", "2a00:1450::1"])
def test_addresses_of_the_internet_are_public(text: str) -> None:
    assert is_public(ipaddress.ip_address(text))


@pytest.mark.parametrize("host", PRIVATE_HOSTS)
def test_an_address_that_is_not_public_is_refused_in_any_notation(egress: Egress, names: Names, host: str) -> None:
    with pytest.raises(UrlNotAllowedError):
        egress.check(f"http://{host}/")
    assert names.asked == []


@pytest.mark.parametrize(
    "url",
    [
        *(
            "",
            "clip.mp4",
            "//public.example/",
            "file:///etc/passwd",
            "ftp://public.example/",
            "gopher://public.example/",
        ),
        *("http:///clip.mp4", "http://user@public.example/", "http://user:word@public.example/", "http://:0/"),
        *("http://public.example:25/", "http://public.example:0/", "https://public.example:22/", "http://[::1/"),
        *("http://a]b/", "http://a[b/", "http://a%2eb/", "http://ex\u2100mple.com/"),
        *("http://public.example:99999/", "http://public.example/\n", "http://" + "a" * 3000, "data:video/mp4,abc"),
    ],
)
def test_what_is_no_plain_address_of_the_web_is_refused(egress: Egress, names: Names, url: str) -> None:
    with pytest.raises(UrlNotAllowedError):
        egress.check(url)
    assert names.asked == []


def test_no_connection_to_an_address_that_is_not_public(
    egress: Egress,
    here: Remote,
    inside: Remote,
    names: Names,
    public_loopback: None,
    connected: list[str],
    promise: Callable[..., Drill],
) -> None:
    drill = promise("R15", wanted="no connection to a non-global address")
    port = here.port
    urls = [f"http://{host}:{port}/secret" for host in PRIVATE_HOSTS]
    # names that lead inside, alone or beside a public address, in every disguise of IPv6
    for number, addresses in enumerate(
        [
            *([PRIVATE], [PUBLIC, PRIVATE], [PRIVATE, PUBLIC], ["10.0.0.5"], ["169.254.169.254"], ["::1"]),
            *(["::ffff:127.0.0.1"], ["64:ff9b::7f00:1"], ["2002:7f00:1::"], [PUBLIC, "fd00:ec2::254"], ["fe80::1%lo"]),
        ]
    ):
        names.tell(f"inside{number}.example", addresses)
        urls.append(f"http://inside{number}.example:{port}/secret")
    urls.append(f"http://localhost:{port}/secret")
    # one that is public when it is first asked for, and in whose place something else stands afterwards
    names.tell("public.example", PUBLIC)
    leads = [
        *urls,
        f"//127.0.0.1:{port}/secret",
        f"http://public.example@127.0.0.1:{port}/secret",
        "file:///etc/passwd",
    ]
    for number, url in enumerate(leads):
        here.answers[f"/lead{number}"] = answer(b"", "302 Found", Location=url)
        here.answers[f"/far{number}"] = answer(b"", "307 Temporary Redirect", Location=f"/lead{number}")
    urls += [f"http://public.example:{port}/{way}{number}" for way in ("lead", "far") for number in range(len(leads))]
    for url in urls:
        with pytest.raises(UrlNotAllowedError):
            fetch(egress, url)
    for url in urls[: len(leads) - 3]:
        with pytest.raises(UrlNotAllowedError):
            egress.post(url, headers={}, content=b"{}", timeout_s=20)
    drill.measured = f"{len(urls)} addresses, {inside.connections} connections inside, {len(connected)} to public ones"
    assert inside.connections == 0
    assert set(connected) == {PUBLIC}


def test_a_name_is_resolved_once_and_what_was_checked_is_connected_to(
    egress: Egress,
    here: Remote,
    inside: Remote,
    names: Names,
    public_loopback: None,
    connected: list[str],
    promise: Callable[..., Drill],
) -> None:
    drill = promise("R15", wanted="a rebound name: no second resolution")
    here.answers["/clip"] = answer(b"clip")
    names.tell("rebinding.example", PUBLIC, PRIVATE)
    assert fetch(egress, f"http://rebinding.example:{here.port}/clip") == b"clip"
    assert names.asked == ["rebinding.example"]
    assert set(connected) == {PUBLIC}
    # the second request finds it moved
    with pytest.raises(UrlNotAllowedError):
        fetch(egress, f"http://rebinding.example:{here.port}/clip")
    # and so does a redirect to itself
    here.answers["/"] = answer(b"", "301 Moved Permanently", Location="/clip")
    names.tell("rebinding.example", PUBLIC, PRIVATE)
    with pytest.raises(UrlNotAllowedError):
        fetch(egress, f"http://rebinding.example:{here.port}/")
    drill.measured = f"{inside.connections} connections inside"
    assert inside.connections == 0


@pytest.mark.parametrize(
    ("place", "kind", "detail"),
    [
        ("ftp://public.example/clip", UrlNotAllowedError, "the URL must begin with https:// or http://"),
        (f"http://{PRIVATE}:8000/", UrlNotAllowedError, "the host of the URL is not at a public address"),
        ("http://inside.example:8000/", UrlNotAllowedError, "the host of the URL is not at a public address"),
        ("http://nowhere.example:8000/", FetchFailedError, "the host of the URL has no address"),
    ],
)
def test_what_is_wrong_with_an_address_that_is_led_to_is_told_as_of_that(
    egress: Egress, here: Remote, names: Names, public_loopback: None, place: str, kind: type[Exception], detail: str
) -> None:
    """The URL that was given has none of these faults."""
    names.tell("public.example", PUBLIC)
    names.tell("inside.example", PRIVATE)
    here.answers["/lead"] = answer(b"", "302 Found", Location=place)
    with pytest.raises(kind, match=f"^the address leads to another one: {detail}"):
        fetch(egress, f"http://public.example:{here.port}/lead")
    with pytest.raises(kind, match=f"^{detail}"):
        fetch(egress, place)


def test_a_public_address_is_asked_for_by_its_name_and_with_nothing_of_our_own(
    egress: Egress, here: Remote, at: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "netrc").write_text("machine public.example login me password secret\n")
    monkeypatch.setenv("NETRC", str(tmp_path / "netrc"))
    for name in ("HTTP_PROXY", "http_proxy", "ALL_PROXY"):
        monkeypatch.setenv(name, "http://127.0.0.1:9")
    here.answers["/first"] = answer(b"", "302 Found", Location="/clip?a=b#c", Set_Cookie="a=b")
    here.answers["/clip"] = answer(b"clip")
    assert fetch(egress, f"{at}/first") == b"clip"
    first, second = (request.lower() for request in here.requests)
    assert first.startswith(b"get /first http/1.1\r\n")
    assert second.startswith(b"get /clip?a=b http/1.1\r\n")
    for request in (first, second):
        assert f"\r\nhost: public.example:{here.port}\r\n".encode() in request
        assert b"authorization" not in request
        assert b"cookie" not in request


def test_a_post_returns_the_status_and_follows_nothing(egress: Egress, here: Remote, inside: Remote, at: str) -> None:
    here.answers["/hook"] = answer(b"", "204 No Content")
    here.answers["/moved"] = answer(b"", "307 Temporary Redirect", Location=f"http://127.0.0.1:{here.port}/")
    here.answers["/long"] = answer(b"x" * 1_000_000, "500 Internal Server Error")
    sent = {"webhook-id": "msg_1", "content-type": "application/json"}
    assert egress.post(f"{at}/hook", headers=sent, content=b'{"a": 1}', timeout_s=20).status == 204
    assert here.requests[0].endswith(b'\r\n\r\n{"a": 1}')
    assert b"\r\nwebhook-id: msg_1\r\n" in here.requests[0]
    assert egress.post(f"{at}/moved", headers={}, content=b"", timeout_s=20).status == 307
    assert egress.post(f"{at}/long", headers={}, content=b"", timeout_s=20).status == 500
    assert inside.connections == 0


def test_a_post_takes_no_longer_than_it_may(egress: Egress, here: Remote, at: str) -> None:
    def trickle(connection: socket) -> None:
        for letter in b"HTTP/1.1 200 OK\r\nContent-Length: 0\r\n" + b"X" * 600:
            connection.sendall(bytes([letter]))
            time.sleep(0.1)

    here.answers["/"] = trickle
    began = time.monotonic()
    with pytest.raises(FetchFailedError):
        egress.post(at, headers={}, content=b"", timeout_s=1)
    assert time.monotonic() - began < 30  # it sends for 60


def test_a_post_has_all_the_time_that_it_may_take(
    here: Remote, at: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def thinks(connection: socket) -> None:
        time.sleep(1)
        connection.sendall(b"HTTP/1.1 204 No Content\r\n\r\n")

    monkeypatch.setattr(egress_module, "_HEAD_S", 0.2)  # these two are of files
    egress = Egress(Settings(data_dir=tmp_path, body_timeout_s=0.2))
    here.answers["/"] = thinks
    assert egress.post(at, headers={}, content=b"", timeout_s=30).status == 204
    egress.close()


def test_a_file_that_comes_too_slowly_is_given_up(here: Remote, at: str, tmp_path: Path) -> None:
    egress = Egress(Settings(data_dir=tmp_path, body_timeout_s=5))

    def trickle(connection: socket) -> None:
        connection.sendall(b"HTTP/1.1 200 OK\r\nContent-Length: 1000\r\n\r\n")
        for _ in range(600):
            connection.sendall(b"x")
            time.sleep(0.1)

    here.answers["/"] = trickle
    with pytest.raises(FetchFailedError, match="fewer than 500 bytes a second"):
        fetch(egress, at)
    egress.close()


def sends(head: bytes, again: bytes, megabytes: float) -> Callable[[socket], None]:
    def send(connection: socket) -> None:
        connection.sendall(head)
        for _ in range(int(megabytes * 100)):
            connection.sendall(again * (10_000 // len(again)))
        connection.sendall(b"0\r\n\r\n")

    return send


CHUNKED = b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n"
INTERIM = b"HTTP/1.1 100 \r\n\r\n"


@pytest.mark.parametrize(("head", "again"), [(CHUNKED, b"1\r\na\r\n"), (b"", INTERIM)])
def test_an_answer_of_countless_small_pieces_is_given_up_at_once(
    egress: Egress, here: Remote, at: str, head: bytes, again: bytes
) -> None:
    here.answers["/"] = sends(head, again, 3)
    began = time.thread_time()  # the server's threads are others
    with pytest.raises(FetchFailedError, match="does not answer as HTTP has it"):
        fetch(egress, at)
    if head:
        assert egress.post(at, headers={}, content=b"", timeout_s=60).status == 200
    else:
        with pytest.raises(FetchFailedError, match="does not answer as HTTP has it"):
            egress.post(at, headers={}, content=b"", timeout_s=60)
    assert time.thread_time() - began < 1  # it was seconds


def test_an_answer_may_have_some_interim_ones_before_it_and_small_chunks(egress: Egress, here: Remote, at: str) -> None:
    here.answers["/"] = sends(INTERIM * 100 + CHUNKED, b"40\r\n" + b"a" * 64 + b"\r\n", 1)
    assert len(fetch(egress, at)) == 64 * 100 * (10_000 // 70)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (answer(b"", "404 Not Found"), "status 404"),
        (answer(b"abc", Content_Encoding="gzip"), "compressed"),
        (answer(b"", "302 Found", Location="/"), f"more than {MAX_REDIRECTS}"),
        (answer(b"", "302 Found"), "answers with status 302"),
        (lambda connection: connection.sendall(b"SSH-2.0-OpenSSH\r\n"), "as HTTP has it"),
        (lambda connection: connection.sendall(b"HTTP/1.1 200 OK\r\nContent-Length: 9\r\n\r\nabc"), "breaks off"),
    ],
)
def test_what_is_no_file_says_why(
    egress: Egress, here: Remote, at: str, given: Callable[[socket], None], said: str
) -> None:
    here.answers["/"] = given
    with pytest.raises(FetchFailedError, match=said):
        fetch(egress, at)


@pytest.mark.parametrize("error", [OSError(errno.ETIMEDOUT, "a disk of the network"), TimeoutError(), KeyError("x")])
@pytest.mark.parametrize("begun", [False, True])
def test_what_the_reader_of_a_file_fails_with_is_its_own(
    egress: Egress, here: Remote, at: str, error: Exception, begun: bool
) -> None:
    here.answers["/"] = answer(b"abc")

    async def read() -> None:
        async with egress.stream(at) as file:
            if begun:
                assert await anext(file.chunks) == b"abc"
            raise error

    with pytest.raises(type(error)) as raised:
        asyncio.run(read())
    assert raised.value is error


@pytest.mark.parametrize("begun", [False, True])
def test_a_file_that_takes_too_long_in_all_is_given_up(here: Remote, at: str, tmp_path: Path, begun: bool) -> None:
    egress = Egress(Settings(data_dir=tmp_path, fetch_timeout_s=0.5))
    gone = threading.Event()

    def send(connection: socket) -> None:
        connection.sendall(b"HTTP/1.1 200 OK\r\nContent-Length: 1000\r\n\r\nx" if begun else b"")
        gone.wait(10)

    here.answers["/"] = send
    began = time.monotonic()
    with pytest.raises(FetchFailedError, match="not answer in time"):
        fetch(egress, at)
    assert time.monotonic() - began < 5
    gone.set()
    egress.close()


def test_a_file_whose_reader_takes_too_long_is_given_up(here: Remote, at: str, tmp_path: Path) -> None:
    egress = Egress(Settings(data_dir=tmp_path, fetch_timeout_s=0.2))
    here.answers["/"] = answer(b"abc")

    async def read() -> None:
        async with egress.stream(at):
            await asyncio.sleep(10)

    with pytest.raises(FetchFailedError, match="not answer in time"):
        asyncio.run(read())
    egress.close()


def test_a_name_that_is_none_and_a_port_where_nobody_listens(
    egress: Egress, here: Remote, names: Names, public_loopback: None
) -> None:
    names.tell("public.example", PUBLIC)
    for url in ("http://nothing.example/", f"http://{'a' * 80}.example/", "http://public.example:1029/"):
        with pytest.raises(FetchFailedError):
            fetch(egress, url)


def test_the_next_address_is_tried_when_one_takes_no_connection(
    egress: Egress, here: Remote, names: Names, public_loopback: None, connected: list[str]
) -> None:
    names.tell("public.example", ["93.184.216.34", PUBLIC])
    here.answers["/"] = answer(b"clip")
    assert fetch(egress, f"http://public.example:{here.port}/") == b"clip"
    assert connected == ["93.184.216.34", PUBLIC]


def test_a_closed_network_may_be_opened(tmp_path: Path, inside: Remote) -> None:
    egress = Egress(Settings(data_dir=tmp_path, allow_private_networks=True))
    assert fetch(egress, f"http://127.0.0.1:{inside.port}/secret") == b"secret"
    with pytest.raises(ServiceError):
        fetch(egress, "file:///etc/passwd")


def test_one_network_may_be_opened_and_no_other(tmp_path: Path, inside: Remote, names: Names) -> None:
    """For an application's own receivers, beside which there are others, and what a cloud tells its machines."""
    egress = Egress(Settings(data_dir=tmp_path, allowed_networks=f"{PRIVATE}/32, fd00:1::/64"))
    assert fetch(egress, f"http://{PRIVATE}:{inside.port}/secret") == b"secret"
    names.tell("backend.internal", PRIVATE)
    assert fetch(egress, f"http://backend.internal:{inside.port}/secret") == b"secret"
    names.tell("two.internal", [PRIVATE, "10.0.0.5"])
    for host in ("two.internal", "127.0.0.77", "10.0.0.5", "169.254.169.254", "[fd00:2::1]", f"[::ffff:{PRIVATE}]"):
        with pytest.raises(UrlNotAllowedError):
            fetch(egress, f"http://{host}:{inside.port}/secret")
    egress.check("http://[fd00:1::7]/")
    with pytest.raises(ValueError, match=r"10\.1\.2\.3/24 is not a network"):
        Settings(data_dir=tmp_path, allowed_networks="10.1.2.3/24")


def test_a_certificate_must_be_of_the_name(
    egress: Egress, names: Names, public_loopback: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    key, certificate = tmp_path / "key.pem", tmp_path / "certificate.pem"
    subprocess.run(
        [
            *("openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"),
            *("-keyout", str(key), "-out", str(certificate), "-days", "2", "-subj", "/CN=studio.example"),
            *("-addext", "subjectAltName=DNS:studio.example"),
        ],
        check=True,
        capture_output=True,
    )
    monkeypatch.setenv("SSL_CERT_FILE", str(certificate))
    tls = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    tls.load_cert_chain(certificate, key)
    asked_for: list[str | None] = []
    tls.sni_callback = lambda _, name, __: asked_for.append(name)
    names.tell("studio.example", PUBLIC)
    names.tell("other.example", PUBLIC)
    with remote(PUBLIC, tls=tls) as server:
        server.answers["/"] = answer(b"clip")
        assert fetch(egress, f"https://studio.example:{server.port}/") == b"clip"
        assert fetch(egress, f"https://studio.example.:{server.port}/") == b"clip"
        for host in ("other.example", PUBLIC):
            with pytest.raises(FetchFailedError, match="certificate"):
                fetch(egress, f"https://{host}:{server.port}/")
    assert asked_for == ["studio.example", "studio.example", "other.example", None]
