"""The map of a person at another exposure."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from pvg._arrays import Doubles, Floats
from pvg.asset import FaceRecord, KeyFrame
from pvg.looks.exposure import Exposure, KeyExposure, at_exposure, leading_key
from pvg.looks.opponent import to_opponent, to_rgb
from pvg.looks.skin_map import SkinMap
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


def test_a_face_in_dim_light_is_under_no_coloured_lamp() -> None:
    """It has less chroma, and leads where it is seen the longest, as any other."""
    first, last = SUMMARY.first_frame, SUMMARY.last_frame
    flash = record([key_at(first, 12), key_at(last - 4, 100)])
    assert leading_key([flash]) is flash.key_frames[0]


def test_skin_that_is_burnt_out_does_not_lead() -> None:
    first, white = SUMMARY.first_frame, key_at(SUMMARY.first_frame, 300)
    burnt = replace(white, skin=np.minimum(white.skin, np.float32(255.0)))
    usual = key_at(first + 9, 60)
    assert leading_key([record([burnt, usual])]) is usual


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
    exposure = Exposure(lead, lambda key: (key.skin, skin_map(key.skin)))
    assert exposure.of(lead)[:2] == (1.0, 1.0)
    keys = {level: burnt_out(key_at(9, level), 1.0) for level in (10, 25, 40, 60, 80, 110)}
    new = {level: exposure.of(key) for level, key in keys.items()}
    for level, (gain, kept, _) in new.items():
        np.testing.assert_allclose(gain, level / 50, rtol=1e-2)
        if gain <= 1:
            assert kept == gain  # light that is dimmed dims the new colours as much
        moved = skin_map(at_exposure(keys[level], 1 / gain).colors)
        assert np.quantile((kept * moved).max(axis=1), 0.95) < 250
    shares = [share for _, share, _ in new.values()]
    assert shares == sorted(shares)


def burnt_out(key: KeyFrame, gain: float) -> KeyFrame:
    """A key frame in more light, which its camera could not take in."""
    lit = at_exposure(key, gain)
    skin, colors = (np.minimum(of, np.float32(255.0)) for of in (lit.skin, lit.colors))
    return replace(lit, frame=9, skin=skin, colors=colors)


def times(factor: float) -> Callable[[KeyFrame], tuple[Floats, Doubles]]:
    return lambda key: (key.skin, factor * key.skin.astype(np.float64))


@pytest.mark.parametrize("look", [1.0, 0.8], ids=["its own colours", "a darker look"])
def test_a_look_that_brightens_nothing_keeps_all_of_the_light(look: float) -> None:
    lead = key_at(0, 80)
    exposure = Exposure(lead, times(look))
    for light in (1.1, 1.25, 1.6, 2.0):  # of the last two much is burnt out
        gain, kept, _ = exposure.of(burnt_out(lead, light))
        assert gain > 1.05
        assert kept == pytest.approx(gain, rel=1e-6)


def test_a_look_that_brightens_has_its_highlights_where_the_clip_has_them() -> None:
    lead = key_at(0, 80)
    exposure = Exposure(lead, times(1.25))
    key = burnt_out(lead, 1.6)
    gain, kept, _ = exposure.of(key)
    np.testing.assert_allclose(np.quantile(kept * 1.25 * key.skin.max(axis=1) / gain, 0.98), 255.0, rtol=1e-4)


def test_a_look_brighter_than_highlights_may_be_dims_no_brighter_light() -> None:
    """As one takes them that keeps the reference's own brightness: its highlights stay where F has them."""
    lead = key_at(0, 80)
    exposure = Exposure(lead, times(1.5))
    for lamp in (np.ones(3), np.array((1.02, 0.99, 0.98))):
        kept = [exposure.of(at_exposure(replace(lead, frame=9), light * lamp)).kept for light in (0.99, 1.02, 1.2)]
        assert kept == sorted(kept)
        assert kept[-1] >= 1.0


def test_few_highlights_reach_white_in_more_light() -> None:
    light = np.exp(np.random.default_rng(3).exponential(0.12, (2000, 1)))  # most of the skin is matt, a little shines
    skin = (np.array((150.0, 112.0, 94.0)) * light).astype(np.float32)
    lead = replace(key_at(0, 50), skin=skin)
    brightest = float(np.quantile(skin.max(axis=1), 0.98))
    exposure = Exposure(lead, times(240.0 / brightest))
    for brighter in (1.1, 1.25, 2.0):
        key = burnt_out(lead, brighter)
        gain, kept, _ = exposure.of(key)
        assert kept > 1.0
        in_clip = (key.skin.max(axis=1) >= 250).mean()
        assert ((kept * 240.0 / brightest * key.skin / gain).max(axis=1) >= 250).mean() <= max(0.02, in_clip)


RED, BLUE = np.array((1.5, 0.6, 0.6)), np.array((0.7, 0.9, 1.5))


def test_light_of_another_colour_stays_in_its_key_frame() -> None:
    """The new colours are tinted as the clip's own are, and dimmed where a channel would pass white."""
    lead = key_at(0, 60)
    skin_map = SkinMap.between(lead.skin, lead.skin * np.array((1.05, 1.2, 1.3)))
    exposure = Exposure(lead, lambda key: (key.skin, skin_map(key.skin)))
    wanted = np.median(skin_map(lead.skin), axis=0)
    for lamp in (RED, BLUE):
        light = exposure.of(at_exposure(lead, 0.5 * lamp))
        np.testing.assert_allclose(light.light, 0.5 * lamp, rtol=0.1)
        np.testing.assert_allclose(light.kept * light.tint * wanted, 0.5 * lamp * wanted, rtol=0.1)
        bright = exposure.of(at_exposure(lead, 1.1 * lamp))
        assert np.quantile((bright.kept * bright.tint * skin_map(lead.skin)).max(axis=1), 0.95) < 250


def test_dim_skin_tells_the_colour_of_a_lamp_beside_it() -> None:
    """Its chroma is small as its luma is."""
    lead = at_exposure(key_at(0, 100), 0.06)
    assert max(np.median(lead.skin, axis=0)) < 12
    light = Exposure(lead, times(1.0)).of(replace(at_exposure(lead, 6.0 * BLUE), frame=9))
    assert light.tint[2] / light.tint[0] > 1.5


def test_a_lamp_lights_what_parts_gain_as_it_does_the_skin() -> None:
    """Lips that take 30 levels of red gain little of it under a lamp without red."""
    gained = to_opponent(np.array([[30.0, 4.0, 8.0]])).astype(np.float32)
    light = KeyExposure(0.6, 0.5, np.array((0.2, 0.9, 2.0)))
    np.testing.assert_allclose(to_rgb(light.shown(gained).astype(np.float64)), [[3.0, 1.8, 8.0]], atol=1e-4)
    np.testing.assert_array_equal(KeyExposure(0.6, 0.5, np.ones(3)).shown(gained), np.float32(0.5) * gained)


def test_a_grey_picture_is_in_no_other_light_and_neither_is_a_brighter_one() -> None:
    lead = key_at(0, 60)
    exposure = Exposure(lead, times(1.1))
    grey = to_opponent(lead.skin)[:, :1].astype(np.float32).repeat(3, axis=1)
    for key in (replace(lead, frame=9, skin=grey), at_exposure(lead, 1.3), at_exposure(lead, 0.4)):
        np.testing.assert_array_equal(exposure.of(key).tint, 1.0)


def test_a_coloured_lamp_does_not_lead() -> None:
    """Whether it is the brightest light, or the one that serves longest."""
    first = SUMMARY.first_frame
    usual, lamp = key_at(first + 9, 50), at_exposure(key_at(first, 60), RED)
    assert leading_key([record([replace(lamp, frame=first), usual])]) is usual
