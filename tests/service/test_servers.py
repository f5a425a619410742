"""The ports of the servers that tests start."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.service.servers import free_port

#: those that a machine gives to outgoing connections begin here
FIRST = int(Path("/proc/sys/net/ipv4/ip_local_port_range").read_text().split()[0])


@pytest.mark.skipif(FIRST <= 20_000, reason="this machine leaves few ports to servers")
def test_processes_of_one_run_have_ports_of_their_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTEST_XDIST_WORKER_COUNT", "4")
    given = []
    for number in range(4):
        monkeypatch.setenv("PYTEST_XDIST_WORKER", f"gw{number}")
        given += [{free_port() for _ in range(50)}]
    assert [len(ports) for ports in given] == [50] * 4
    assert [len({port % 4 for port in ports}) for ports in given] == [1] * 4
    assert len({port % 4 for ports in given for port in ports}) == 4
