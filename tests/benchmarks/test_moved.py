"""How still a look lies on stills that move as it is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.quality.lossless import write_lossless
from benchmarks.quality.moved import FRAMES, Stillness, changes_of, moved_frames

SHAPE = (20, 30)


def changes(*, blink: int = 0, step: int = 0) -> np.ndarray:
    """A patch of 4 × 5 pixels changed by 40 levels, lost for so many frames from the sixth on, or left from it on."""
    out = np.zeros((12, *SHAPE, 3), np.float32)
    out[:, 4:8, 10:15] = 40
    out[6 : 6 + blink] = 0
    out[6 : 6 + 12 * step] = 0
    return out


@pytest.mark.parametrize(
    ("given", "wanted"),
    [
        (changes(), (0, 0, 0)),
        (changes(blink=1), (20 / 10, 0, 40 / 11)),
        (changes(blink=2), (0, 20 / 9, 40 / 11)),
        (changes(blink=3), (0, 0, 40 / 11)),
        (changes(step=1), (0, 0, 20 / 11)),
    ],
    ids=["still", "one frame", "two frames", "three frames", "a step"],
)
def test_what_blinks_is_counted_by_how_long_it_does(given: np.ndarray, wanted: tuple[float, float, float]) -> None:
    stillness = Stillness.of(given, np.ones(given.shape[:3], np.bool_))
    assert (stillness.one, stillness.two, stillness.steps) == pytest.approx(wanted)


def test_what_is_not_seen_does_not_count() -> None:
    given = changes(blink=1)
    seen = np.ones(given.shape[:3], np.bool_)
    seen[6, :, :12] = False
    assert Stillness.of(given, seen).one == pytest.approx(12 / 10)


def test_a_change_that_lies_on_the_still_is_still_and_one_that_lies_on_the_picture_is_not(tmp_path: Path) -> None:
    still = np.full((240, 320, 3), 90, np.uint8)
    patched = still.copy()
    patched[80:160, 100:220] = 190
    paths = [tmp_path / name for name in ("clip.mp4", "on_the_still.mp4", "on_the_picture.mp4")]
    frames = list(moved_frames(still))
    fixed = [frame.copy() for frame in frames]
    for frame in fixed:
        frame[80:160, 100:220] += 100
    for path, given in zip(paths, (frames, moved_frames(patched), fixed), strict=True):
        write_lossless(path, iter(given))
    on_the_still, on_the_picture = (Stillness.of(*changes_of(paths[0], look)) for look in paths[1:])
    assert on_the_still.one == on_the_still.two == 0
    assert on_the_still.steps == 0
    assert on_the_picture.steps > 100
    assert len(frames) == FRAMES
