"""What the `pvg` command shows while it works, and how it ends."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from io import TextIOWrapper
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tqdm import tqdm

    from pvg.asset import FaceSummary

PIPE_CLOSED = 128 + 13  # as of SIGPIPE, which some systems have no name for


@contextmanager
def progress_bars() -> Iterator[Callable[[str, int, int], None]]:
    """A progress callback that draws one bar a stage on a terminal and nothing when piped."""
    if not sys.stderr.isatty():
        yield lambda stage, done, total: None
        return
    from tqdm import tqdm  # noqa: PLC0415 - only for those who see it

    bars: dict[str, tqdm[None]] = {}

    def report(stage: str, done: int, total: int) -> None:
        if stage not in bars:
            for bar in bars.values():
                bar.close()
            bars[stage] = tqdm(desc=stage, total=total or None, unit="frame")
        bars[stage].update(done - bars[stage].n)

    try:
        yield report
    finally:
        for bar in bars.values():
            bar.close()


def print_warnings(path: Path, lines: Iterable[str]) -> None:
    """Say on standard error what is to be known of a file, one line each."""
    for line in lines:
        print(f"pvg: warning: {path.name}: {line}", file=sys.stderr)


def warn_of_faces(path: Path, faces: Iterable[FaceSummary]) -> None:
    """Say on standard error what is to be known of these faces of a file, one line each."""
    for face in faces:
        for warning in face.warnings:
            print(f"pvg: warning: {path.name}, face {face.index}: {warning}", file=sys.stderr)


def mend_streams() -> None:
    """Let what is printed go anywhere: a file name that is not in the locale's coding comes out as its bytes, and a
    standard stream that is closed is opened to nothing, so that no file gets its number.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            # for as long as the process lasts
            setattr(sys, name, Path(os.devnull).open(mode, errors="surrogateescape"))  # noqa: SIM115
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="surrogateescape")


class EndedError(KeyboardInterrupt):
    """The process is told to end: everything that was begun is put away, as at Ctrl-C."""

    def __init__(self, number: int) -> None:
        super().__init__()
        self.number = number


@contextmanager
def ended_by_signals() -> Iterator[None]:
    """Inside the block SIGTERM and SIGHUP, where nobody else takes them, end the work as Ctrl-C does."""

    def end(number: int, _: object) -> None:
        raise EndedError(number)

    numbers = [one for one in (signal.SIGTERM, signal.SIGHUP) if signal.getsignal(one) == signal.SIG_DFL]
    for one in numbers:
        signal.signal(one, end)
    try:
        yield
    finally:
        for one in numbers:
            signal.signal(one, signal.SIG_DFL)


def end_quietly() -> None:
    """Whoever read the output has had enough: no more is written, by the interpreter's last flush either."""
    with contextlib.suppress(OSError), Path(os.devnull).open("wb") as nothing:
        os.dup2(nothing.fileno(), sys.stdout.fileno())
    sys.exit(PIPE_CLOSED)


def fail(code: int, message: str) -> None:
    print(f"pvg: {message}", file=sys.stderr)
    sys.exit(code)
