"""Threads that the faces of a clip share: with its own each would take 40 MB, and of a picture 130 MB."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from types import TracebackType
from typing import Self


@dataclass(frozen=True, eq=False)
class Helpers:
    """They work beside the thread that adds rows. Leaving the block begins nothing more and waits for what was begun.

    bodies: one thread, in which a row's body is looked for while the next row's face is.
    fits: one, for key frames' colours: half a second each that nothing before `VectorFace.finish` waits for.
    """

    bodies: ThreadPoolExecutor = field(default_factory=lambda: ThreadPoolExecutor(1))
    fits: ThreadPoolExecutor = field(default_factory=lambda: ThreadPoolExecutor(1))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for threads in (self.bodies, self.fits):
            threads.shutdown(cancel_futures=True)
