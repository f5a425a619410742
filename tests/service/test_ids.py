from __future__ import annotations

import os
import socket
import time
import uuid

import pytest

from service.ids import MEDIA_ID, host_of, new_id, uuid7_hex, worker_id


def test_ids_are_version_7_uuids_of_now() -> None:
    before = time.time_ns() // 1_000_000
    value = uuid.UUID(hex=uuid7_hex())
    assert (value.version, value.variant) == (7, uuid.RFC_4122)
    assert before <= value.int >> 80 <= time.time_ns() // 1_000_000


def test_ids_made_apart_in_time_sort_in_that_order() -> None:
    ids = []
    for _ in range(200):
        ids.append(new_id("vid"))
        time.sleep(0.00001)
    assert ids == sorted(ids)
    assert len(set(ids)) == 200
    assert all(MEDIA_ID.fullmatch(one) for one in ids)


@pytest.mark.parametrize("host", ["node", "node-2-a", "n" * 64])
def test_a_worker_is_told_by_its_machine_and_its_process(host: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socket, "gethostname", lambda: host)
    assert worker_id() == f"{host[:60]}-{os.getpid()}"
    assert host_of(worker_id()) == host[:60]
