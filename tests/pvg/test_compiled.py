"""Compiled functions: their machine code is kept where it can be, found where it lies, and never needed."""

from __future__ import annotations

import asyncio
import errno
import os
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from typing import Any

import numba
import pytest
from llvmlite.binding.executionengine import ExecutionEngine
from numba.core.caching import IndexDataCacheFile, NullCache

from pvg import _compiled

REPOSITORY = Path(__file__).resolve().parents[2]

KERNELS = """
from pvg._compiled import kernel
from helpers import twice, OFFSET

@kernel()
def doubled_and_moved(x):
    return twice(x) + OFFSET
"""
HELPERS = """
from pvg._compiled import kernel

OFFSET = 1

@kernel(inline=True)
def once(x):
    return x

@kernel()
def twice(x):
    return once(x) + x
"""
PROBE = """
import numpy as np
from numba.core import event
compiled = []
class Listener(event.Listener):
    def on_start(self, event):
        compiled.append(event.data["dispatcher"].py_func.__name__)
    def on_end(self, event):
        pass
event.register("numba:compile", Listener())
import kernels
result = kernels.doubled_and_moved(20)
print(result, *sorted({"doubled_and_moved", "twice"} & set(compiled)))
"""


@pytest.fixture
def package(tmp_path: Path) -> Iterator[Path]:
    """A folder of two modules with kernels, and a copy of what they need of ours."""
    folder = tmp_path / "package"
    (folder / "pvg").mkdir(parents=True)
    for name in ("_compiled.py", "_folders.py"):
        shutil.copy(REPOSITORY / "pvg" / name, folder / "pvg")
    (folder / "pvg" / "__init__.py").touch()
    (folder / "kernels.py").write_text(KERNELS)
    (folder / "helpers.py").write_text(HELPERS)
    yield folder
    for path in (folder, *folder.rglob("*")):
        path.chmod(0o755)


def run(folder: Path, *prefix: str, **variables: str) -> subprocess.CompletedProcess[str]:
    environment = {k: v for k, v in os.environ.items() if k not in ("HOME", "PVG_CACHE_DIR") and "NUMBA" not in k}
    environment |= {"PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1", **variables}
    return subprocess.run(
        [*prefix, sys.executable, "-c", PROBE], env=environment, cwd="/", capture_output=True, text=True, check=True
    )


def without_privilege() -> list[str]:
    """The beginning of a command that keeps to permissions: root otherwise writes everywhere."""
    if os.geteuid() != 0:
        return []
    return ["setpriv", "--bounding-set=-dac_override,-dac_read_search"]


def close(folder: Path) -> None:
    for path in (folder, *folder.rglob("*")):
        path.chmod(0o555 if path.is_dir() else 0o444)


COMPILED_ALL = "41 doubled_and_moved twice\n"
COMPILED_NONE = "41\n"


def test_the_next_process_compiles_nothing(package: Path) -> None:
    home = {"HOME": str(package.parent)}
    assert run(package, **home).stdout == COMPILED_ALL
    assert any((package / "__pycache__").glob("*.nbc"))
    assert run(package, **home).stdout == COMPILED_NONE


def test_a_cache_that_may_only_be_read_is_used(package: Path) -> None:
    run(package, HOME=str(package.parent))
    close(package)
    done = run(package, *without_privilege(), HOME=str(package))
    assert (done.stdout, done.stderr) == (COMPILED_NONE, "")


def test_without_any_place_to_write_it_works_and_says_so_once(package: Path) -> None:
    close(package)
    done = run(package, *without_privilege(), HOME=str(package))
    assert done.stdout == COMPILED_ALL
    assert done.stderr.count("\n") == 1
    assert "PVG_CACHE_DIR" in done.stderr
    assert not (package / "__pycache__").exists()


def test_the_users_cache_folder_serves_where_the_modules_cannot_be_written(package: Path, tmp_path: Path) -> None:
    close(package)
    own = tmp_path / "own"
    own.mkdir()
    assert run(package, *without_privilege(), PVG_CACHE_DIR=str(own)).stdout == COMPILED_ALL
    assert run(package, *without_privilege(), PVG_CACHE_DIR=str(own)).stdout == COMPILED_NONE
    assert (own / "kernels").is_dir()


@pytest.mark.parametrize("changed", [("helpers.py", "+ x", "+ x + 0"), ("helpers.py", "OFFSET = 1", "OFFSET = 2")])
def test_a_change_in_a_called_module_is_seen(package: Path, changed: tuple[str, str, str]) -> None:
    home = {"HOME": str(package.parent)}
    run(package, **home)
    name, before, after = changed
    path = package / name
    path.write_text(path.read_text().replace(before, after))
    assert "doubled_and_moved" in run(package, **home).stdout


def test_damaged_files_are_compiled_anew(package: Path) -> None:
    home = {"HOME": str(package.parent)}
    run(package, **home)
    for path in (package / "__pycache__").iterdir():
        path.write_bytes(path.read_bytes()[:40])
    assert run(package, **home).stdout == COMPILED_ALL
    assert run(package, **home).stdout == COMPILED_NONE


def test_a_full_disk_does_not_stop_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def full(*_: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(IndexDataCacheFile, "save", full)
    monkeypatch.setenv("PVG_CACHE_DIR", str(tmp_path))
    _compiled._say_uncached.cache_clear()
    squared: Callable[[int], int] = _compiled.kernel()(_squared)
    assert squared(7) == 49
    assert len(caplog.records) == 1


def _squared(x: int) -> int:
    return x * x


OTHER_PROCESSOR = """
import llvmlite.binding as llvm
features = llvm.get_host_cpu_features()
for name in list(features):
    features[name] = name in ("sse2", "64bit", "cx8", "fxsr", "mmx", "sse")
llvm.get_host_cpu_name = lambda: "x86-64"
llvm.get_host_cpu_features = lambda: features
"""


@pytest.mark.skipif(os.uname().machine != "x86_64", reason="names a processor of x86")
def test_a_cache_for_a_named_processor_serves_others(package: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As in the image, which is warmed on one machine and run on another."""
    home = {"HOME": str(package.parent)}
    named = {"NUMBA_CPU_NAME": "x86-64-v3", "NUMBA_CPU_FEATURES": "", **home}
    run(package, **named)
    run(package, **home)
    monkeypatch.setattr(sys.modules[__name__], "PROBE", OTHER_PROCESSOR + PROBE)
    assert run(package, **named).stdout == COMPILED_NONE
    assert run(package, **home).stdout == COMPILED_ALL, "what was compiled for the host itself serves no other"


@pytest.mark.parametrize("callback", [1, 2])
def test_a_signal_that_comes_in_a_callback_of_llvm_is_handled_after_it(
    callback: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain, calls = ExecutionEngine._find_module_ptr, count(1)

    def signalled(engine: Any, pointer: int) -> Any:  # both callbacks ask it first
        if next(calls) == callback:
            signal.raise_signal(signal.SIGUSR1)
        return plain(engine, pointer)

    def end(number: int, _: object) -> None:
        raise KeyboardInterrupt(number)

    @_compiled.kernel()
    def moved(x: int) -> int:
        return x + 1

    monkeypatch.setattr(moved, "_cache", NullCache())
    monkeypatch.setattr(ExecutionEngine, "_find_module_ptr", signalled)
    before = signal.signal(signal.SIGUSR1, end)
    try:
        with pytest.raises(KeyboardInterrupt):
            moved(1)
        assert signal.getsignal(signal.SIGUSR1) is end
    finally:
        signal.signal(signal.SIGUSR1, before)
    assert moved(1) == 2


@contextmanager
def handled(number: int, handler: Callable[[int, object], object]) -> Iterator[None]:
    before = signal.signal(number, handler)
    try:
        yield
    finally:
        signal.signal(number, before)


def interrupt(number: int, _: object) -> None:
    raise KeyboardInterrupt(number)


def test_handlers_are_put_back_though_one_raises_before_all_are_held(monkeypatch: pytest.MonkeyPatch) -> None:
    """It ended the holding with some of them held: what they were for never came again."""
    plain = signal.signal
    held: list[int] = []

    def signalled(number: int, handler: Any) -> Any:
        if number == signal.SIGUSR1 and not held:
            held.append(number)
            signal.raise_signal(number)
        return plain(number, handler)

    with handled(signal.SIGUSR1, interrupt):
        before = {number: signal.getsignal(number) for number in signal.valid_signals()}
        monkeypatch.setattr(signal, "signal", signalled)
        with pytest.raises(KeyboardInterrupt), _compiled._signals_held():
            pass
        monkeypatch.undo()
        after = {number: signal.getsignal(number) for number in before}
        for number, handler in before.items():
            if after[number] is not handler:
                signal.signal(number, handler)
    assert held
    assert after == before


def test_all_signals_that_were_held_are_handled_though_one_raises() -> None:
    told: list[int] = []

    def signalled() -> None:
        signal.raise_signal(signal.SIGUSR1)
        signal.raise_signal(signal.SIGUSR2)
        assert told == []

    with handled(signal.SIGUSR1, interrupt), handled(signal.SIGUSR2, lambda number, _: told.append(number)):
        with pytest.raises(KeyboardInterrupt):
            _compiled._undisturbed(signalled)()
        assert told == [signal.SIGUSR2]


def test_a_loop_is_told_once_of_a_signal_that_was_held() -> None:
    told: list[int] = []

    async def work() -> None:
        asyncio.get_running_loop().add_signal_handler(signal.SIGUSR2, told.append, 1)
        with _compiled._signals_held():
            signal.raise_signal(signal.SIGUSR2)
        await asyncio.sleep(0.05)

    asyncio.run(work())
    assert told == [1]


def test_a_process_that_another_thread_forks_meanwhile_has_its_handlers() -> None:
    """The thread is the main one there, and nothing is being compiled."""
    told: list[int] = []

    def as_after_the_fork() -> None:
        handler = signal.getsignal(signal.SIGUSR2)
        assert callable(handler)
        handler(signal.SIGUSR2, None)

    with handled(signal.SIGUSR2, lambda number, _: told.append(number)), _compiled._signals_held():
        thread = threading.Thread(target=as_after_the_fork)
        thread.start()
        thread.join()
        assert told == [signal.SIGUSR2]


def test_processes_that_keep_other_types_at_once_do_not_mix_them_up(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("numba.config.CACHE_DIR", str(tmp_path))

    @numba.njit
    def twice(x: Any) -> Any:
        return x + x

    twice(1), twice(1.0)
    known, both = twice.overloads, threading.Barrier(2)
    of_integers, of_floats = known
    first_is_kept = threading.Event()
    read: Callable[[Any], Any] = IndexDataCacheFile._load_index
    keep: Callable[[Any, str, Any], None] = IndexDataCacheFile._save_data

    def read_at_once(file: Any) -> Any:
        index = read(file)
        both.wait(10)
        return index

    def keep_in_turn(file: Any, name: str, data: Any) -> None:
        both.wait(10)  # both have written their index
        if threading.current_thread().name == "floats":
            first_is_kept.wait(10)
        keep(file, name, data)
        first_is_kept.set()

    monkeypatch.setattr(IndexDataCacheFile, "_load_index", read_at_once)
    monkeypatch.setattr(IndexDataCacheFile, "_save_data", keep_in_turn)
    processes = [
        threading.Thread(
            target=_compiled._KernelCache(twice.py_func).save_overload, args=(types, known[types]), name=name
        )
        for types, name in ((of_integers, "integers"), (of_floats, "floats"))
    ]
    for process in processes:
        process.start()
    for process in processes:
        process.join()
    monkeypatch.undo()
    monkeypatch.setattr("numba.config.CACHE_DIR", str(tmp_path))
    for types in (of_integers, of_floats):
        found = _compiled._KernelCache(twice.py_func).load_overload(types, twice.targetctx)
        assert found is not None
        assert found.signature == known[types].signature
