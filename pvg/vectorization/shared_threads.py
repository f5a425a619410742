"""Threads that the faces of a clip share: threads of their own would take 40 MB a face, in a picture 130 MB."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Self


@dataclass(frozen=True, eq=False)
class SharedThreads:
    """Two pools of one thread each, beside the thread that adds rows to faces.

    bodies: looks for a row's body while the next row's face is looked for;
    fits: fits the colours of key frames, half a second each; nothing before `VectorFace.finish` waits for it.
    Leaving the block cancels what has not begun and waits for what has.
    """

    bodies: ThreadPoolExecutor = field(default_factory=lambda: ThreadPoolExecutor(1))
    fits: ThreadPoolExecutor = field(default_factory=lambda: ThreadPoolExecutor(1))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for pool in (self.bodies, self.fits):
            pool.shutdown(cancel_futures=True)
