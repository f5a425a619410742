"""The mattes of a track's rows once the rows after them are known, which they are held to."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from typing import Generic, NamedTuple, TypeVar

from pvg._arrays import Bytes
from pvg.skin import BodyConsensus, BodyInTime, Matte, MatteConsensus, MatteInTime, Scene
from pvg.vectorization.shared_threads import SharedThreads

_AHEAD = 2  # rows whose bodies may be in the making while the next row's face is looked for [by eye]

Row = TypeVar("Row")


class SteadyRow(NamedTuple, Generic[Row]):
    """A row, the matte of its face, and alpha (h, w) of the person's other skin in its scene, 0-255."""

    row: Row
    face: Matte
    body: Bytes


class MatteQueue(Generic[Row]):
    """Holds the mattes of face and body of a track's rows, in order, to what the rows around agree on."""

    def __init__(self, threads: SharedThreads) -> None:
        self._threads = threads
        self._faces, self._bodies = MatteConsensus(), BodyConsensus()
        self._rows: deque[Row] = deque()  # that wait for their mattes
        self._awaited: deque[Future[Bytes | None]] = deque()  # bodies that are being made
        self._steady_faces: deque[Matte] = deque()
        self._steady_bodies: deque[Bytes] = deque()

    def add(
        self, row: Row, face: Matte | MatteInTime, scene: Scene | None, make_body: Callable[[], Bytes]
    ) -> list[SteadyRow[Row]]:
        """Take the next row; those of the rows so far whose mattes are known by now, in order, each once.

        row: given back as it is;  face: a Matte stays as it is;  make_body: called in another thread, for alpha (h, w)
        in the scene; without a scene it stays as it is.
        """
        self._rows.append(row)
        self._awaited.append(self._threads.bodies.submit(self._steady_body, scene, make_body))
        steady = face if isinstance(face, Matte) else self._faces.add(face)
        if steady is not None:
            self._steady_faces.append(steady)
        self._wait(_AHEAD)
        return self._known()

    def end(self) -> list[SteadyRow[Row]]:
        """The rest, when no more come."""
        self._steady_faces.extend(self._faces.end())
        self._wait(0)
        self._steady_bodies.extend(self._bodies.end())
        return self._known()

    def _steady_body(self, scene: Scene | None, make_body: Callable[[], Bytes]) -> Bytes | None:
        alpha = make_body()
        return alpha if scene is None else self._bodies.add(BodyInTime(alpha, scene))

    def _wait(self, ahead: int) -> None:
        while len(self._awaited) > ahead:
            body = self._awaited.popleft().result()
            if body is not None:
                self._steady_bodies.append(body)

    def _known(self) -> list[SteadyRow[Row]]:
        faces, bodies = self._steady_faces, self._steady_bodies
        count = min(len(faces), len(bodies))
        return [SteadyRow(self._rows.popleft(), faces.popleft(), bodies.popleft()) for _ in range(count)]
