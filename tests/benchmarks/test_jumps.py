"""Where a look's change jumps though the picture does not."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.quality.jumps import jumps, mean_jump
from tests.gallery.pictures import colorful

PATCH = slice(60, 100), slice(80, 130)


def looked(picture: np.ndarray, *, at: tuple[slice, slice] | None, by: int = 30) -> np.ndarray:
    """A picture that a look has made brighter in a patch."""
    out = picture.astype(np.int16)
    if at is not None:
        out[at] += by
    return np.clip(out, 0, 255).astype(np.uint8)


@pytest.fixture
def picture() -> np.ndarray:
    return (colorful(3, (240, 160)) // 2 + 50).astype(np.uint8)


def test_a_patch_that_opens_on_a_picture_that_stays_is_a_jump(picture: np.ndarray) -> None:
    jump = jumps((picture, looked(picture, at=None)), (picture, looked(picture, at=PATCH)))
    assert jump[66:94, 86:124].min() == pytest.approx(30, abs=1)
    assert jump[:50].max() == jump[110:].max() == 0


def test_a_patch_that_moves_with_the_picture_is_none(picture: np.ndarray) -> None:
    shifted = np.roll(picture, 3, axis=1)
    moved = PATCH[0], slice(PATCH[1].start + 3, PATCH[1].stop + 3)
    jump = jumps((picture, looked(picture, at=PATCH)), (shifted, looked(shifted, at=moved)))
    assert jump.sum() == 0


def test_what_the_picture_itself_shows_anew_is_none(picture: np.ndarray) -> None:
    hand = picture.copy()
    hand[PATCH] = (200, 30, 30)
    assert jumps((picture, picture), (hand, looked(hand, at=PATCH))).sum() == 0


def test_a_little_or_a_few_pixels_are_none(picture: np.ndarray) -> None:
    assert jumps((picture, picture), (picture, looked(picture, at=PATCH, by=6))).sum() == 0
    assert jumps((picture, picture), (picture, looked(picture, at=(slice(60, 63), slice(80, 83))))).sum() == 0


def test_the_frame_with_most_of_it_is_named(picture: np.ndarray) -> None:
    frames = [(picture, looked(picture, at=PATCH if k >= 2 else None)) for k in range(4)]
    mean, worst = mean_jump(frames)
    assert worst == 2
    assert mean == pytest.approx(float(jumps(frames[1], frames[2]).sum()) / 4)
