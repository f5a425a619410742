from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import pvg
from pvg.asset import FaceRecord, KeyFrame
from pvg.haze import cleared, through_haze
from pvg.looks.haze import under_haze, with_less_haze
from tests.gallery.assets import SUMMARY, key_frame

HAZE = 80  # levels, half of which looks take off


def _with(record: FaceRecord, haze: int, change: Callable[[np.ndarray], np.ndarray]) -> FaceRecord:
    """The same face with its colours changed, and what it says of its haze."""

    def changed(key: KeyFrame) -> KeyFrame:
        colors, skin, parts = (change(each) for each in (key.colors, key.skin, key.parts))
        return replace(key, colors=colors, skin=skin, parts=parts)

    return replace(record, key_frames=tuple(changed(key) for key in record.key_frames), haze=haze)


def _hazy(record: FaceRecord) -> FaceRecord:
    return _with(record, HAZE, lambda colors: through_haze(colors, HAZE))


def _less_hazy(record: FaceRecord) -> FaceRecord:
    """The face as looks see it, without a word of haze."""
    return _with(record, 0, lambda colors: cleared(through_haze(colors, HAZE), HAZE // 2))


def test_half_of_a_faces_haze_is_taken_off() -> None:
    clear = FaceRecord(SUMMARY, (key_frame(),))
    assert with_less_haze(clear).key_frames[0] is clear.key_frames[0]
    told = with_less_haze(_hazy(clear))
    assert told.haze == HAZE // 2
    for name in ("colors", "skin", "parts"):
        wanted = getattr(_less_hazy(clear).key_frames[0], name)
        np.testing.assert_allclose(getattr(told.key_frames[0], name), wanted, atol=1e-3)


def test_colours_that_do_not_change_stay_to_the_bit() -> None:
    own = key_frame().colors
    clear = np.maximum((own - 40) * np.float32(1.2), 0)
    np.testing.assert_array_equal(under_haze(own, clear, clear.copy(), 40), own)


@pytest.fixture
def hazy(video: pvg.VectorVideo, monkeypatch: pytest.MonkeyPatch) -> pvg.VectorVideo:
    """The clip as if it had been taken in haze."""
    monkeypatch.setattr(video, "records", tuple(_hazy(record) for record in video.records))
    return video


def test_a_look_of_a_hazy_clip_is_that_of_a_clearer_one_under_haze(
    video: pvg.VectorVideo, dark_reference: pvg.VectorVideo, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain, half = video.records, HAZE // 2
    monkeypatch.setattr(video, "records", tuple(_less_hazy(record) for record in plain))
    look, g = pvg.transfer(video, dark_reference), video.records[0].key_frames[0].colors
    monkeypatch.setattr(video, "records", tuple(_hazy(record) for record in plain))
    under = pvg.transfer(video, dark_reference)
    assert look.maps[0].haze == 0
    assert under.maps[0].haze == half
    np.testing.assert_allclose(under.colors[0], through_haze(look.colors[0], half), atol=0.1)
    np.testing.assert_allclose(under.parts[0], (1 - half / 255) * look.parts[0], atol=0.1)
    assert np.abs(look.colors[0] - g).max() > 10


def test_a_look_without_strength_leaves_a_hazy_clip_as_it_is(
    hazy: pvg.VectorVideo, dark_reference: pvg.VectorVideo
) -> None:
    look = pvg.transfer(hazy, dark_reference, strength=0.0)
    np.testing.assert_array_equal(look.colors[0], [key.colors for key in hazy.records[0].key_frames])


def test_all_colours_together_are_taken_as_they_are(
    hazy: pvg.VectorVideo, dark_reference: pvg.VectorVideo, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The paper knows no haze."""
    look = pvg.transfer(hazy, dark_reference, match="color")
    assert look.maps[0].haze == 0
    monkeypatch.setattr(hazy, "records", tuple(replace(record, haze=0) for record in hazy.records))
    np.testing.assert_array_equal(look.colors[0], pvg.transfer(hazy, dark_reference, match="color").colors[0])
