from __future__ import annotations

import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.api.ranges import matches, parse_range, require_match
from service.errors import PreconditionError, RangeError

SIZES = st.integers(1, 10_000)


@given(SIZES, st.data())
def test_a_range_is_the_slice_it_names(size: int, data: st.DataObject) -> None:
    start = data.draw(st.integers(0, size - 1))
    last = data.draw(st.integers(start, size * 2))
    assert parse_range(f"bytes={start}-{last}", size) == (start, min(size, last + 1))
    assert parse_range(f"bytes={start}-", size) == (start, size)


@given(SIZES, st.integers(1, 20_000))
def test_a_suffix_range_is_the_end_of_the_file(size: int, length: int) -> None:
    start, end = parse_range(f"bytes=-{length}", size) or (0, 0)
    assert end == size
    assert end - start == min(size, length)


@pytest.mark.parametrize("header", ["bytes=10-", "bytes=10-20", "bytes=-0", "bytes=99999999999999999999-"])
def test_a_range_outside_the_file_is_refused_with_its_size(header: str) -> None:
    with pytest.raises(RangeError) as refused:
        parse_range(header, 10)
    assert refused.value.headers == {"Content-Range": "bytes */10"}


@pytest.mark.parametrize("header", [None, "", "bytes", "bytes=-", "bytes=5-4", "bytes=0-1,3-4", "pages=1-2"])
def test_other_headers_are_ignored(header: str | None) -> None:
    assert parse_range(header, 10) is None


def test_absurdly_long_numbers_are_ignored() -> None:
    digits = "9" * 5000
    for header in (f"bytes=0-{digits}", f"bytes={digits}-", f"bytes=-{digits}"):
        assert parse_range(header, 10) is None


def test_long_blanks_in_a_malformed_range_are_passed_over_at_once() -> None:
    blanks = " " * 5000
    began = time.thread_time()
    assert parse_range(f"bytes{blanks}={blanks}-{blanks}x", 10) is None
    assert time.thread_time() - began < 1
    assert parse_range(f"bytes{blanks}={blanks}1{blanks}-{blanks}2{blanks}", 10) == (1, 3)


def test_conditions_compare_as_the_rfc_says() -> None:
    assert matches('"b", "a"', '"a"')
    assert matches('W/"a"', '"a"')
    assert matches("*", '"a"')
    assert not matches('"b"', '"a"')
    assert not matches(None, '"a"')
    assert matches('"a"', '"a"', weak=False)
    assert not matches('W/"a"', '"a"', weak=False)


@pytest.mark.parametrize("header", [None, "*", '"a"', '"b", "a"'])
def test_an_if_match_holds_that_names_the_tag(header: str | None) -> None:
    require_match(header, '"a"')


@pytest.mark.parametrize("header", ["", '"b"', 'W/"a"', "a", '"b", W/"a"'])
def test_an_if_match_compares_strongly(header: str) -> None:
    with pytest.raises(PreconditionError):
        require_match(header, '"a"')
