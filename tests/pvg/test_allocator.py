from __future__ import annotations

import ctypes
import os
import subprocess
import sys
import textwrap
import weakref
from collections.abc import Iterator
from pathlib import Path

import pytest

from pvg import _allocator
from pvg._allocator import give_back, map_large_blocks

#: what the programs below begin with
_RESIDENT = """
from pathlib import Path
from pvg._allocator import give_back, map_large_blocks

def resident():
    line = next(x for x in Path("/proc/self/status").read_text().splitlines() if x.startswith("VmRSS"))
    return int(line.split()[1]) * 1024
"""


@pytest.fixture
def _asked_anew() -> Iterator[None]:
    _allocator._glibc.cache_clear()
    yield
    _allocator._glibc.cache_clear()


@pytest.mark.skipif(_allocator._glibc() is None, reason="of glibc")
def test_what_was_freed_between_what_is_needed_goes_back_to_the_system() -> None:
    program = """
        held = [bytearray(100_000) for _ in range(500)]  # smaller than what is mapped by itself
        for block in held:
            block[:] = b"x" * len(block)
        held = held[::50]  # they keep all that lies before them
        before = resident()
        give_back()
        assert before - resident() > 30_000_000, (before, resident())
        assert all(block == b"x" * 100_000 for block in held)
    """
    _printed(program, {})


@pytest.mark.usefixtures("_asked_anew")
@pytest.mark.parametrize("error", [OSError, TypeError, AttributeError])
def test_with_another_c_library_cycles_are_freed_all_the_same(
    error: type[Exception], monkeypatch: pytest.MonkeyPatch
) -> None:
    class Knot:
        def __init__(self) -> None:
            self.itself = self

    def absent(_: Path | None) -> None:
        raise error("no such thing here")

    monkeypatch.setattr(ctypes, "CDLL", absent)
    there = weakref.ref(Knot())
    give_back()
    map_large_blocks()
    assert there() is None


@pytest.mark.skipif(_allocator._glibc() is None, reason="of glibc")
@pytest.mark.parametrize(
    ("environment", "mapped"),
    [
        ({}, True),
        ({"MALLOC_MMAP_THRESHOLD_": "30000000"}, False),
        ({"GLIBC_TUNABLES": "glibc.malloc.mmap_threshold=30000000"}, False),
    ],
)
def test_large_blocks_are_gone_when_they_are_freed(environment: dict[str, str], mapped: bool) -> None:
    program = """
        def block(size):
            return bytearray(b"x") * size

        map_large_blocks()
        block(20_000_000)  # glibc would raise its limit by this
        held, small = [], []
        for _ in range(20):
            held.append(block(3_000_000))
            small.append(block(100_000))
        before = resident()
        held.clear()
        print(before - resident() > 50_000_000)
    """
    assert _printed(program, environment) == str(mapped)


@pytest.mark.skipif(_allocator._glibc() is None, reason="of glibc")
@pytest.mark.parametrize(
    "environment",
    [{"MALLOC_TRIM_THRESHOLD_": "100000"}, {"GLIBC_TUNABLES": "glibc.malloc.trim_threshold=100000"}],
)
def test_what_is_kept_free_is_what_the_environment_says(environment: dict[str, str]) -> None:
    program = """
        map_large_blocks()
        resident()
        held = [bytearray(b"x") * 1_000_000 for _ in range(40)]
        before = resident()
        held.clear()
        print(before - resident() > 30_000_000)
    """
    assert _printed(program, environment) == "True"
    assert _printed(program, {}) == "False"


def _printed(program: str, environment: dict[str, str]) -> str:
    """What a process prints that has these of the variables of glibc's allocator, and no others."""
    plain = {k: v for k, v in os.environ.items() if not k.startswith("MALLOC_") and k != "GLIBC_TUNABLES"}
    done = subprocess.run(
        [sys.executable, "-c", _RESIDENT + textwrap.dedent(program)],
        check=True,
        timeout=60,
        env=plain | environment,
        capture_output=True,
        text=True,
    )
    return done.stdout.strip()
