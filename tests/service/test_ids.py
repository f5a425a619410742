from __future__ import annotations

import time
import uuid

from service.ids import MEDIA_ID, new_id, uuid7_hex


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
