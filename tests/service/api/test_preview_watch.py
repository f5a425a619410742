from __future__ import annotations

import asyncio
from collections.abc import Collection

import pytest

from service.api.calls import Calls
from service.api.preview_watch import PreviewWatch
from service.catalog import Preview
from service.errors import UnavailableError


def test_an_outage_is_two_lines_of_the_log_however_long_it_is(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    looks = 0

    def load(preview_ids: Collection[str]) -> tuple[list[Preview], Collection[str]]:
        nonlocal looks
        looks += 1
        if 2 <= looks <= 6:
            raise UnavailableError("away")
        return [Preview(id=one) for one in preview_ids if looks > 8], preview_ids

    made = asyncio.run(PreviewWatch(Calls(), load).end_of("prv_1", 60))
    assert made is not None
    said = [record.getMessage() for record in caplog.records if record.name == "service.api.preview_watch"]
    assert [one.split(" be ")[0] for one in said] == [
        "pictures that are waited for cannot",
        "pictures that are waited for can",
    ]
