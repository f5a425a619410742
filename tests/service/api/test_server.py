from __future__ import annotations

import resource
import socket
from collections.abc import Iterator

import pytest

from service.api.server import connection_limit, listen, with_room
from service.settings import Settings


@pytest.fixture
def descriptors() -> Iterator[None]:
    """Puts the limit of descriptors back."""
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    yield
    resource.setrlimit(resource.RLIMIT_NOFILE, before)


def test_an_address_in_use_is_named() -> None:
    with listen("127.0.0.1", 0)[0] as first:
        port = first.getsockname()[1]
        first.listen()
        with pytest.raises(OSError, match="in use") as caught:
            listen("127.0.0.1", port)
        assert caught.value.filename == f"127.0.0.1:{port}"


def test_every_address_of_a_host_has_the_same_port() -> None:
    sockets = listen("localhost", 0)
    try:
        assert len({one.getsockname()[1] for one in sockets}) == 1
        assert {one.family for one in sockets} <= {socket.AF_INET, socket.AF_INET6}
        assert all(one.getsockname()[0] in {"127.0.0.1", "::1"} for one in sockets)
    finally:
        for one in sockets:
            one.close()


def test_the_soft_limit_of_descriptors_is_raised_and_some_are_kept(descriptors: None) -> None:
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (300, hard))
    assert connection_limit(20) == 20
    raised, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    assert raised == (min(hard, 16_384) if hard != resource.RLIM_INFINITY else 16_384)
    assert connection_limit(10**6) == raised - 256


def test_an_application_is_made_for_the_connections_that_there_is_room_for(descriptors: None) -> None:
    assert with_room(Settings(max_connections=20)).max_connections == 20
    assert with_room(Settings(max_connections=10**6)).max_connections == connection_limit(10**6) < 10**6
