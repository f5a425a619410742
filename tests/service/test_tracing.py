from __future__ import annotations

import pytest

from service.tracing import parse, trace_id

TRACE = "0af7651916cd43dd8448eb211c80319c"
GOOD = f"00-{TRACE}-b7ad6b7169203331-01"


@pytest.mark.parametrize("header", [GOOD, f"cc-{TRACE}-b7ad6b7169203331-01-what-the-future-adds"])
def test_a_trace_is_kept_as_it_came(header: str) -> None:
    kept = parse(header)
    assert kept == header[:55]
    assert trace_id(kept) == TRACE


@pytest.mark.parametrize(
    "header",
    [
        None,
        "",
        GOOD.upper(),
        f"{GOOD}-more",
        f"ff-{TRACE}-b7ad6b7169203331-01",
        f"00-{'0' * 32}-b7ad6b7169203331-01",
        f"00-{TRACE}-{'0' * 16}-01",
        f"00-{TRACE}-b7ad6b7169203331",
        f" {GOOD}",
    ],
)
def test_what_is_malformed_is_no_trace(header: str | None) -> None:
    assert parse(header) is None
    assert trace_id(None) is None
