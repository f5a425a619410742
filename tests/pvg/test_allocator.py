from __future__ import annotations

import ctypes
import subprocess
import sys
import textwrap
import weakref
from collections.abc import Iterator
from pathlib import Path

import pytest

from pvg import _allocator
from pvg._allocator import give_back


@pytest.fixture
def _asked_anew() -> Iterator[None]:
    _allocator._trim.cache_clear()
    yield
    _allocator._trim.cache_clear()


@pytest.mark.skipif(_allocator._trim() is None, reason="of glibc")
def test_what_was_freed_between_what_is_needed_goes_back_to_the_system() -> None:
    program = """
        from pathlib import Path
        from pvg._allocator import give_back

        def resident():
            line = next(x for x in Path("/proc/self/status").read_text().splitlines() if x.startswith("VmRSS"))
            return int(line.split()[1]) * 1024

        held = [bytearray(100_000) for _ in range(500)]  # smaller than what is mapped by itself
        for block in held:
            block[:] = b"x" * len(block)
        held = held[::50]  # they keep all that lies before them
        before = resident()
        give_back()
        assert before - resident() > 30_000_000, (before, resident())
        assert all(block == b"x" * 100_000 for block in held)
    """
    subprocess.run([sys.executable, "-c", textwrap.dedent(program)], check=True, timeout=60)


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
    assert there() is None
