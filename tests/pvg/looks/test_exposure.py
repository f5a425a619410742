"""The map of a person at another exposure."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from pvg.asset import FaceRecord, KeyFrame
from pvg.looks.exposure import Exposure, at_exposure, leading_key
from pvg.looks.opponent import to_opponent
from pvg.looks.tone import SkinMap
from tests.gallery.assets import FRAMES, SUMMARY, key_frame


def key_at(frame: int, level: float) -> KeyFrame:
    rng = np.random.default_rng(5)
    made = key_frame()
    skin = (np.array((200.0, 150.0, 125.0)) * rng.uniform(0.7, 1.2, (300, 1)) * level / 100).astype(np.float32)
    colors = (np.array((190.0, 145.0, 120.0)) * rng.uniform(0.7, 1.2, (len(made.colors), 1)) * level / 100).astype("f4")
    visible = np.ones(len(colors), bool)
    return replace(made, frame=frame, skin=skin, colors=colors, visible=visible, parts=made.parts * np.float32(0.5))


def record(keys: Sequence[KeyFrame]) -> FaceRecord:
    return FaceRecord(SUMMARY, tuple(keys))


def brightness(key: KeyFrame) -> float:
    return float(np.median(to_opponent(key.skin)[:, 0]))


def test_brief_light_and_brief_dark_do_not_lead() -> None:
    first, last = SUMMARY.first_frame, SUMMARY.last_frame
    flash = record([key_at(first, 50), key_at(last - 4, 100)])
    assert leading_key([flash]) is flash.key_frames[0]
    night = record([key_at(first, 20), key_at(first + 8, 100)])
    assert leading_key([night]) is night.key_frames[1]


def test_a_ramp_is_led_alike_whichever_way_it_runs() -> None:
    levels = [40, 50, 62, 78, 97]
    frames = [int(f) for f in SUMMARY.first_frame + np.linspace(0, FRAMES - 1, len(levels))]

    def ramp(levels: Sequence[float]) -> FaceRecord:
        keys = [key_at(frame, level) for frame, level in zip(frames, levels, strict=True)]
        return record([keys[0], *(replace(b, since=a.frame) for a, b in itertools.pairwise(keys))])

    up, down = ramp(levels), ramp(levels[::-1])
    assert brightness(leading_key([up])) == brightness(leading_key([down]))
    assert brightness(leading_key([up])) > 0.75 * brightness(up.key_frames[-1])


def test_exposure_survives_the_map_and_never_reaches_white() -> None:
    lead = key_at(0, 50)
    skin_map = SkinMap.between(lead.skin, lead.skin.astype(np.float64) * 1.6)
    exposure = Exposure.between(lead, lead.skin, skin_map(lead.skin))
    assert exposure.of(lead) == (1.0, 1.0)
    new = {level: exposure.of(key_at(9, level)) for level in (10, 25, 40, 60, 80, 125)}
    for level, (gain, kept) in new.items():
        np.testing.assert_allclose(gain, level / 50, rtol=1e-3)
        if gain <= 1:
            assert kept == gain  # light that is dimmed dims the new colours as much
        moved = skin_map(at_exposure(key_at(9, level), 1 / gain).colors)
        assert np.quantile((kept * moved).max(axis=1), 0.95) < 250
    shares = [share for _, share in new.values()]
    assert shares == sorted(shares)


@pytest.mark.parametrize("look", [1.0, 0.8], ids=["its own colours", "a darker look"])
def test_a_look_that_brightens_nothing_keeps_all_of_the_light(look: float) -> None:
    lead = key_at(0, 80)
    exposure = Exposure.between(lead, lead.skin, look * lead.skin.astype(np.float64))
    brightest = float(lead.skin.max())
    for gain in (1.1, 1.25, 248 / brightest):
        assert exposure.kept(gain) == pytest.approx(gain, rel=1e-6)


def test_few_highlights_reach_white_in_more_light() -> None:
    light = np.exp(np.random.default_rng(3).exponential(0.12, (2000, 1)))  # most of the skin is matt, a little shines
    skin = (np.array((150.0, 112.0, 94.0)) * light).astype(np.float32)
    lead = replace(key_at(0, 50), skin=skin)
    brightest = float(np.quantile(skin.max(axis=1), 0.98))
    moved = skin.astype(np.float64) * 240.0 / brightest
    exposure = Exposure.between(lead, lead.skin, moved)
    for gain in (1.1, 1.25, 2.0):
        kept = exposure.kept(gain)
        assert kept > 1.0
        assert ((kept * moved).max(axis=1) >= 250).mean() <= 0.02
