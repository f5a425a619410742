"""Pictures as other cameras take them, their mattes brought back, and the table of what they hold."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from benchmarks.quality.variants import PLAIN, VARIANTS, Kept, alpha_of, variants_table
from pvg.skin import Matte


def _picture() -> np.ndarray:
    """A ramp of grey over a ramp of skin: (32, 64, 3) uint8."""
    ramp = np.linspace(0, 255, 64)[None, :, None]
    return np.concatenate([np.broadcast_to(ramp * tone, (16, 64, 3)) for tone in ((1, 1, 1), (1, 0.7, 0.6))]).astype(
        np.uint8
    )


@pytest.mark.parametrize("name", VARIANTS)
def test_a_variant_is_a_picture_of_the_promised_size_that_depends_on_nothing_else(name: str) -> None:
    variant, picture = VARIANTS[name], _picture()
    drawn = variant.draw(picture)
    assert drawn.dtype == np.uint8
    assert drawn.shape == (32 * variant.scale, 64 * variant.scale, 3)
    np.testing.assert_array_equal(drawn, variant.draw(picture))
    assert (name == PLAIN) == (drawn.shape == picture.shape and bool((drawn == picture).all()))


def test_warm_is_redder_and_cool_bluer_and_a_stop_is_twice_the_light() -> None:
    grey = np.full((1, 1, 3), 100, np.uint8)
    warm, cool, under, over = (VARIANTS[n].draw(grey)[0, 0] for n in ("warm", "cool", "a stop under", "a stop over"))
    assert warm[0] > warm[1] > warm[2]
    assert cool[0] < cool[1] < cool[2]
    assert (under / 100) ** 2.2 == pytest.approx([0.5] * 3, abs=0.01)
    assert (over / 100) ** 2.2 == pytest.approx([2.0] * 3, abs=0.03)


def test_overexposed_highlights_are_compressed_and_not_cut() -> None:
    over = VARIANTS["a stop over"].draw(_picture())[0, :, 0].astype(int)
    assert (np.diff(over) >= 0).all()
    assert over[48] < over[56] < 255


@dataclass(frozen=True)
class _Found:
    matte: Matte
    body: Matte


class _Video:
    """A still with one face whose matte is `alpha` (h, w) over all of it."""

    faces = (None,)

    def __init__(self, alpha: np.ndarray) -> None:
        h, w = alpha.shape
        box = np.array([0, 0, w, h], np.float32)
        own, none = (Matte.over(box, a) for a in (alpha, np.zeros_like(alpha)))
        self._found = _Found(own, none)

    def face_at(self, face: int, frame: int) -> _Found:
        assert (face, frame) == (0, 0)
        return self._found


@pytest.mark.parametrize("name", [PLAIN, "mirrored", "half the size"])
def test_a_matte_is_brought_back_to_the_pictures_own_pixels(name: str) -> None:
    skin = np.zeros((32, 64), np.uint8)
    skin[8:24, 8:32] = 255
    drawn = VARIANTS[name].draw(np.repeat(skin[..., None], 3, axis=2))[..., 0]
    video: Any = _Video(drawn)
    alpha = alpha_of(video, VARIANTS[name], (64, 32))
    np.testing.assert_array_equal(alpha >= 0.5, skin > 0)


def test_the_table_tells_what_moved_and_lists_what_moved_much_for_the_worse() -> None:
    found = [
        Kept("a", PLAIN, {"face": 0.9, "ear": 0.8, "hair": 0.1}),
        Kept("a", "warm", {"face": 0.92, "ear": 0.5, "hair": 0.25}),
        Kept("b", PLAIN, {"face": 1.0, "hair": 0.3}),
        Kept("b", "warm", {"face": 0.96, "hair": 0.0}),
        Kept("c", "warm", {"face": 0.0}),  # of which there is no plain one
    ]
    text = variants_table(found, ("face", "ear", "neck"), ("hair",))
    rows = [re.split(r" *\| *", line)[1:-1] for line in text.splitlines() if line.startswith("|")]
    assert rows[2] == [PLAIN, "95.0", "80.0", "–", "20.0", ""]
    assert rows[3] == ["warm", "-1.0", "-30.0", "–", "-7.5", "2"]
    assert text.splitlines()[-2:] == ["- a, warm: ear 80 → 50", "- a, warm: hair 10 → 25"]
