"""Mattes of rows that wait for the rows after them."""

from __future__ import annotations

import numpy as np
import pytest

from pvg._arrays import Bytes
from pvg.raster import Raster
from pvg.skin import Matte, Scene
from pvg.vectorization.shared_threads import SharedThreads
from pvg.vectorization.steady_mattes import MatteQueue, SteadyRow

SHAPE = (12, 16)
ROWS = 9


def scene() -> Scene:
    raster = Raster(np.zeros(2, np.float32), 1.0, SHAPE)
    picture, person, flow = (np.zeros((*SHAPE, *more), np.uint8) for more in ((3,), (), (2,)))
    return Scene(raster, picture, person, flow[::2, ::2].astype(np.float32), (), False, 0, 0.2)


def face(row: int) -> Matte:
    return Matte.over(np.array([0, 0, 16, 12], np.float32), np.full(SHAPE, row, np.uint8), np.ones(SHAPE, np.bool_))


def body(row: int) -> Bytes:
    """All skin, but for one row, and in a corner of it five times its number, which changes slowly."""
    alpha = np.full(SHAPE, 0 if row == 4 else 255, np.uint8)
    alpha[:6, :6] = 0
    alpha[:3, :3] = 5 * row
    return alpha


def rows_of(scenes: bool) -> list[tuple[int, SteadyRow[int]]]:
    """After how many rows the mattes of each row were known, and they."""
    out: list[tuple[int, SteadyRow[int]]] = []
    with SharedThreads() as threads:
        mattes = MatteQueue[int](threads)
        for row in range(ROWS):
            seen = scene() if scenes else None
            found = mattes.add(row, face(row), seen, lambda row=row: body(row))  # type: ignore[misc]
            out += [(row, each) for each in found]
        return out + [(ROWS, each) for each in mattes.end()]


@pytest.mark.parametrize("scenes", [True, False])
def test_faces_and_bodies_of_one_row_come_together_and_in_order(scenes: bool) -> None:
    assert [(row, int(matte.alpha[0, 0]), int(alpha[0, 0]) // 5) for _, (row, matte, alpha) in rows_of(scenes)] == [
        (row, row, row) for row in range(ROWS)
    ]


def test_bodies_are_held_to_the_rows_around_them() -> None:
    assert [int(alpha[8:, 8:].min()) for _, (_, _, alpha) in rows_of(True)] == [255] * ROWS


def test_without_a_scene_bodies_stay_as_they_are() -> None:
    assert [int(alpha.max()) for _, (_, _, alpha) in rows_of(False)] == [int(body(row).max()) for row in range(ROWS)]


def test_rows_are_known_a_few_rows_later_so_that_little_waits_in_memory() -> None:
    assert max(known - k for k, (known, _) in enumerate(rows_of(True))) <= 4


def test_what_a_body_raises_is_raised_where_it_is_waited_for() -> None:
    def fails() -> Bytes:
        raise RuntimeError("no body")

    with SharedThreads() as threads:
        mattes = MatteQueue[int](threads)
        mattes.add(0, face(0), scene(), fails)
        with pytest.raises(RuntimeError, match="no body"):
            mattes.end()
