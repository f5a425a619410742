from __future__ import annotations

import threading
from collections.abc import Iterator
from queue import SimpleQueue

import pytest

from service.errors import StoppingError
from service.resolving import RESOLVERS, RESOLVERS_OF_ONE, Resolver
from tests.waiting import until


class HangingNames:
    """A name server that says nothing until it is told to; ``asked`` are the names that have come to it."""

    def __init__(self) -> None:
        self.asked: SimpleQueue[str] = SimpleQueue()
        self.told = threading.Event()

    def find(self, name: str, port: int, **_: object) -> list[tuple[str, int]]:
        self.asked.put(name)
        assert self.told.wait(60)
        return [(name, port)]


@pytest.fixture
def hanging(monkeypatch: pytest.MonkeyPatch) -> Iterator[HangingNames]:
    made = HangingNames()
    monkeypatch.setattr("service.resolving.socket.getaddrinfo", made.find)
    yield made
    made.told.set()


def test_more_names_than_threads_are_looked_up_one_after_another(hanging: HangingNames) -> None:
    resolver = Resolver()
    found = [resolver.look_up(f"key_{number}", f"{number}.example", 80) for number in range(RESOLVERS * 2)]
    first = {hanging.asked.get(timeout=60) for _ in range(RESOLVERS)}
    assert first == {f"{number}.example" for number in range(RESOLVERS)}
    assert sum(one.running() for one in found) == RESOLVERS
    assert hanging.asked.empty()
    hanging.told.set()
    assert [one.result(60) for one in found] == [[(f"{number}.example", 80)] for number in range(len(found))]
    resolver.close()


def test_an_owner_whose_name_server_hangs_holds_up_nobody_else(monkeypatch: pytest.MonkeyPatch) -> None:
    hanging, quick = HangingNames(), [("address", 80)]

    def find(name: str, port: int, **_: object) -> list[tuple[str, int]]:
        return hanging.find(name, port) if name.endswith(".hangs.example") else quick

    monkeypatch.setattr("service.resolving.socket.getaddrinfo", find)
    resolver = Resolver()
    found = [resolver.look_up("key_a", f"{number}.hangs.example", 80) for number in range(RESOLVERS * 2)]
    for one in found[RESOLVERS_OF_ONE + 1 :]:
        one.cancel()  # its request has ended, and nobody waits for it
    assert resolver.look_up("key_b", "quick.example", 80).result(60) == quick
    until(lambda: hanging.asked.qsize() == RESOLVERS_OF_ONE)
    own = resolver.look_up("key_a", "quick.example", 80)
    assert len(resolver._waiting) == 2, "what nobody waits for is forgotten"
    hanging.told.set()
    assert own.result(60) == quick
    assert hanging.asked.qsize() == RESOLVERS_OF_ONE + 1
    resolver.close()


def test_a_resolver_that_is_closed_looks_no_more_names_up(hanging: HangingNames) -> None:
    before = set(threading.enumerate())
    resolver = Resolver()
    found = [resolver.look_up(f"key_{number}", f"{number}.example", 80) for number in range(RESOLVERS + 3)]
    threads = set(threading.enumerate()) - before
    assert len(threads) == RESOLVERS
    for _ in threads:
        hanging.asked.get(timeout=60)
    found[-1].cancel()  # nobody waits for it any more
    resolver.close()
    for one in found[RESOLVERS:-1]:
        with pytest.raises(StoppingError):
            one.result(60)
    with pytest.raises(StoppingError):
        resolver.look_up("", "late.example", 80)
    hanging.told.set()
    assert all(one.result(60) for one in found[:RESOLVERS])
    for thread in threads:
        thread.join(60)
        assert not thread.is_alive()
    assert hanging.asked.empty()
