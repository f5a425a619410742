"""Requests whose target is a whole URL, as clients write them that take the service for a proxy (RFC 9112, 3.2.2)."""

from __future__ import annotations

import socket
from http.client import HTTPResponse

import h11
import pytest

from service.api.targets import in_origin_form
from tests.service.fixtures import PNG, Api


def asked(api: Api, target: str, *, host: str = "localhost", method: str = "GET", body: bytes = b"") -> HTTPResponse:
    with socket.create_connection(api.address, timeout=60) as connection:
        head = f"{method} {target} HTTP/1.1\r\nHost: {host}\r\nContent-Length: {len(body)}\r\n\r\n"
        connection.sendall(head.encode() + body)
        answer = HTTPResponse(connection, method=method)
        answer.begin()
        answer.read()
    return answer


@pytest.mark.parametrize(
    "target", ["http://localhost/v1/videos?limit=1", "HTTP://127.0.0.1:8000/v1/videos", "https://[::1]/videos"]
)
def test_a_target_that_is_a_url_is_its_path(api: Api, target: str) -> None:
    assert asked(api, target).status == 200


def test_what_is_sent_to_a_url_arrives(api: Api) -> None:
    made = asked(api, "http://localhost/v1/references", method="POST", body=PNG)
    assert (made.status, made.headers["location"].startswith("/v1/references/ref_")) == (202, True)


def test_the_host_of_the_url_counts_and_not_the_field(api: Api) -> None:
    assert asked(api, "http://evil.example/v1/videos").status == 421
    assert asked(api, "http://localhost/v1/videos", host="evil.example").status == 200


@pytest.mark.parametrize(
    "target", ["http:///v1/videos", "http://user@localhost/v1/videos", "http://?x", "http://localhost/v1/videos#x"]
)
def test_what_is_no_url_of_a_host_is_malformed(api: Api, target: str) -> None:
    assert asked(api, target).status == 400


@pytest.mark.parametrize(
    ("target", "path"),
    [
        ("/a?b=http://c", "/a?b=http://c"),
        ("//localhost/a", "//localhost/a"),
        ("*", "*"),
        ("http://localhost", "/"),
        ("http://localhost?a=b", "/?a=b"),
        ("http://localhost:1/a/b?c=http://d/e", "/a/b?c=http://d/e"),
    ],
)
def test_the_target_of_a_url_is_all_that_follows_its_host(target: str, path: str) -> None:
    request = h11.Request(method="GET", target=target, headers=[("Host", "localhost"), ("A", "b")])
    found = in_origin_form(request)
    assert (found.target, found.method, found.http_version) == (path.encode(), b"GET", b"1.1")
    assert (b"a", b"b") in list(found.headers)
