from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pvg.face import PARTS, Landmarks, Outline, add_cover, feather, layout, part_outlines, taken
from tests.gallery.faces import made_up_landmarks

_SQUARE = np.array([(20, 20), (44, 20), (44, 40), (20, 40)], np.float32)


@pytest.mark.parametrize("step", [1.0, 2.5])
def test_a_cover_weighs_what_its_outline_covers_and_ends_there(step: float) -> None:
    cells = int(80 / step)
    out = np.zeros((cells, cells), np.float32)
    add_cover(out, [Outline(_SQUARE)], (0.0, 0.0), step, 2.0)
    assert out.sum() * step**2 == pytest.approx(24 * 20, rel=0.06)
    ys, xs = np.indices(out.shape) * step
    away = np.hypot(np.clip(np.maximum(20 - xs, xs - 44), 0, None), np.clip(np.maximum(20 - ys, ys - 40), 0, None))
    assert (out[away > 3 * max(2.0, step) + 4 * step] == 0).all()
    assert out[int(30 / step), int(32 / step)] == pytest.approx(1.0, abs=0.02)


def test_a_hole_and_what_lies_outside_the_cells_are_left_out() -> None:
    out = np.zeros((60, 32), np.float32)
    hole = np.array([(26, 26), (38, 26), (38, 34), (26, 34)], np.float32)
    add_cover(out, [Outline(_SQUARE, hole), Outline(_SQUARE + 500)], (0.0, 0.0), 1.0, 0.8)
    assert out[30, 30] < 0.05
    assert out[23, 24] > 0.9


def test_a_cover_costs_what_its_cells_do_however_far_its_outline_reaches() -> None:
    out = np.zeros((60, 32), np.float32)
    vast = np.array([(-9000, -9000), (16, -9000), (16, 9000), (-9000, 9000)], np.float32)
    tracemalloc.start()
    try:
        add_cover(out, [Outline(vast)], (0.0, 0.0), 1.0, 2.0)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 1_000_000
    assert (out[:, :10] == 1.0).all()
    assert (out[:, 23:] == 0.0).all()


@given(st.integers(0, 2**31), st.floats(0.5, 8.0))
def test_what_is_seen_of_a_cover_does_not_hang_on_the_cells_around_it(seed: int, sigma: float) -> None:
    rng = np.random.default_rng(seed)
    polygon = (rng.integers(-3072, 6272, (6, 2)) / 64).astype(np.float32)  # to the step that polygons are drawn by
    whole, part = np.zeros((240, 240), np.float32), np.zeros((50, 60), np.float32)
    add_cover(whole, [Outline(polygon + 70)], (0.0, 0.0), 1.0, sigma)
    add_cover(part, [Outline(polygon)], (0.0, 0.0), 1.0, sigma)
    np.testing.assert_allclose(part, whole[70:120, 70:130], atol=1e-6)


def test_every_part_lies_where_its_features_are() -> None:
    face = made_up_landmarks()
    places = {
        "lips": [*layout.LIPS_OUTER, *layout.LIPS_INNER],
        "lids": layout.EYE_CONTOURS,
        "brows": [*layout.LEFT_BROW, *layout.RIGHT_BROW],
    }
    for part in PARTS:
        outlines = part_outlines(part, face)
        assert len(outlines) == (1 if part == "lips" else 2)
        middle = np.mean([outline.polygon.mean(axis=0) for outline in outlines], axis=0)
        near = face.points[places[part]].mean(axis=0) if part in places else face.axes.center
        assert np.linalg.norm(middle - near) < 0.25 * face.axes.width
        assert 0.0 < feather(part, face) < 0.1 * face.axes.width


def _with_eyes(face: Landmarks, aspect: float) -> Landmarks:
    """The face with either eye open by an eye aspect ratio, its lids drawn to the line between its corners."""
    points = face.points.copy()
    for eye in (layout.LEFT_EYE_CONTOUR, layout.RIGHT_EYE_CONTOUR):
        first, *_, second = points[eye[[0, 1, 2, 3]]]
        width = float(np.linalg.norm(second - first))
        down = np.array([-(second - first)[1], (second - first)[0]]) / width
        for (upper, lower), share in (((1, 5), 1 / 3), ((2, 4), 2 / 3)):
            middle = first + np.float32(share) * (second - first)
            points[eye[upper]] = middle - 0.5 * aspect * width * down
            points[eye[lower]] = middle + 0.5 * aspect * width * down
    return Landmarks(points, face.skin_points)


def test_a_closed_eyes_lid_takes_nothing_and_an_open_ones_all() -> None:
    face = made_up_landmarks()
    assert taken("lids", _with_eyes(face, 0.0)) == (0.0, 0.0)
    assert taken("lids", _with_eyes(face, 0.3)) == (1.0, 1.0)
    shares = [taken("lids", _with_eyes(face, aspect))[0] for aspect in np.linspace(0.0, 0.3, 61)]
    assert np.all(np.diff(shares) >= 0.0)
    assert max(np.diff(shares)) < 0.05  # a blink has no step
    for part in set(PARTS) - {"lids"}:
        assert set(taken(part, _with_eyes(face, 0.0))) == {1.0}


def test_an_outline_covers_by_its_share() -> None:
    whole, half, none = (np.zeros((60, 60), np.float32) for _ in range(3))
    for out, share in ((whole, 1.0), (half, 0.5), (none, 0.0)):
        add_cover(out, [Outline(_SQUARE)], (0.0, 0.0), 1.0, 2.0, [share])
    assert whole.max() > 0.9
    np.testing.assert_allclose(half, 0.5 * whole, atol=1e-6)
    assert not none.any()


def test_a_part_without_an_outline_is_no_brow() -> None:
    with pytest.raises(ValueError, match="a face has no part 'nose'; known are lips, lids, cheeks, brows"):
        part_outlines("nose", made_up_landmarks())
