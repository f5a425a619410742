from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pvg.looks import LookMap, SkinMap
from pvg.looks.opponent import to_opponent, to_rgb
from pvg.looks.skin_map import _FLATTEST, _SLOPE_RANGE
from pvg.looks.tone import CRISP
from pvg.looks.usual_chroma import UsualChroma
from tests.pvg.looks.skins import any_colors, skin_like

seeds = st.integers(0, 1000)


@given(seeds)
def test_the_map_to_itself_is_the_identity_with_a_slope_of_one(seed: int) -> None:
    skin = skin_like(seed)
    same = SkinMap.between(skin, skin.astype(float))
    np.testing.assert_allclose(same(any_colors(seed + 1)), any_colors(seed + 1), atol=1e-3)
    np.testing.assert_allclose(same.slopes(any_colors(seed + 1)), 1, atol=1e-3)


@given(seeds, seeds)
def test_what_differs_from_the_usual_chroma_never_grows(one: int, two: int) -> None:
    """A flush does not become an orange patch; in a darker skin it is weaker."""
    source, target = skin_like(one), skin_like(two)
    change = SkinMap.between(source, target.astype(float))
    assert 0.0 < change.spread <= 1.0
    darker = np.median(to_opponent(target)[:, 0]) / np.median(to_opponent(source)[:, 0])
    assert change.spread <= max(1.02 * darker + 0.02, _FLATTEST)


@pytest.mark.parametrize("crisp", [0.0, CRISP])
@given(seeds, seeds)
def test_black_stays_black(crisp: float, one: int, two: int) -> None:
    """A brow or a lash takes no chroma from the reference's skin."""
    change = SkinMap.between(skin_like(one), skin_like(two).astype(float), crisp=crisp)
    np.testing.assert_allclose(change(np.zeros((1, 3), np.float32)), 0, atol=1e-6)


@given(seeds)
def test_pixels_of_a_face_with_its_own_colours_stay(seed: int) -> None:
    skin = skin_like(seed)
    np.testing.assert_allclose(SkinMap.between(skin, skin.astype(float), crisp=CRISP).tone, np.arange(256), atol=1e-6)


@given(seeds, seeds)
def test_the_median_of_the_skin_ends_where_the_transport_has_it(one: int, two: int) -> None:
    skin, moved = skin_like(one), skin_like(two).astype(float)
    tone = SkinMap.between(skin, moved, crisp=CRISP).tone
    before, after = (float(np.median(to_opponent(colors)[:, 0])) for colors in (skin, moved))
    assert np.interp(before, np.arange(256), tone) == pytest.approx(after, abs=1.0)


@given(seeds, seeds)
def test_the_slope_is_one_for_all_of_a_face_and_stays_in_its_range(one: int, two: int) -> None:
    slopes = SkinMap.between(skin_like(one), skin_like(two).astype(float)).slopes(any_colors(one))
    assert (slopes == slopes[0]).all()
    assert _SLOPE_RANGE[0] <= slopes[0, 0] <= _SLOPE_RANGE[1]


@pytest.mark.parametrize("crisp", [0.0, CRISP])
@given(seeds, seeds)
def test_skin_beside_a_face_keeps_its_order_and_its_distance(crisp: float, one: int, two: int) -> None:
    skin = SkinMap.between(skin_like(one), skin_like(two).astype(float), crisp=crisp)
    curve, middle = skin.beside, skin.own.middle
    assert abs(curve[0]) < 1e-9
    assert curve.max() <= 255.001
    assert np.diff(curve).min() > -1e-9
    change = np.interp(middle, np.arange(256), skin.tone) - middle
    near = np.arange(256)[int(0.85 * middle) : int(middle)]
    assert (curve[near] >= near + change - 1e-6).all()  # never darker than the face became


@given(seeds)
def test_beside_its_own_face_skin_stays_as_it_is(seed: int) -> None:
    skin = skin_like(seed)
    same = SkinMap.between(skin, skin.astype(float))
    np.testing.assert_allclose(same.beside, np.arange(256), atol=0.3)


@given(seeds)
def test_patches_differ_less_on_skin_of_another_hue_and_as_much_on_its_own(seed: int) -> None:
    rng = np.random.default_rng(seed)
    pink = rng.normal((190, 150, 140), 4, (300, 3)).astype(np.float32)
    pink[:60] += np.float32((8, -4, 0))  # a flushed nose
    for color, least, most in (((150, 110, 70), 0.3, 0.45), ((190, 150, 140), 0.8, 1.0)):
        change = SkinMap.between(pink, rng.normal(color, 4, (300, 3)))
        mapped = [to_opponent(each) for each in (change.at_patches(pink), change(pink))]
        beyond = [each[:, 1:] - change.goal.at(each[:, 0]) for each in mapped]  # the usual chroma of its own luma
        flush = [each[:60].mean(axis=0) - each[60:].mean(axis=0) for each in beyond]
        patch, texture = (float(np.hypot(*each)) for each in flush)
        assert least * texture < patch < most * texture


@pytest.mark.parametrize("broad", [0.25, 0.6, 1.0])
def test_a_flush_that_is_lost_leaves_no_shade(broad: float) -> None:
    """Blood takes green light: a cheek that gets less red gets as much lighter, and its red stays what it is."""
    even = UsualChroma(np.array([-20.0, 25.0]), np.zeros(2), 60.0, 200.0)  # the same at every luma
    change = SkinMap(np.arange(256.0), even, even, 1.0, broad, 1.0, 0.0)
    cheek = np.array([[190.0, 150.0, 130.0], [190.0, 130.0, 120.0], [190.0, 115.0, 112.0]], np.float32)  # ever redder
    after = change.at_patches(cheek)
    beyond = to_opponent(cheek)[:, 2] - 25.0
    assert (beyond[1:] > 10.0).all()
    np.testing.assert_allclose(after[1:, 0], cheek[1:, 0], atol=1e-6)
    left = to_opponent(after)[:, 2] - 25.0
    np.testing.assert_allclose(left, broad * beyond, atol=1e-6)


@pytest.mark.parametrize("broad", [0.25, 1.0])
def test_what_is_less_red_than_the_rest_gets_no_darker(broad: float) -> None:
    even = UsualChroma(np.array([-20.0, 25.0]), np.zeros(2), 60.0, 200.0)
    change = SkinMap(np.arange(256.0), even, even, 1.0, broad, 1.0, 0.0)
    pale = np.array([[170.0, 160.0, 140.0]], np.float32)
    assert to_opponent(pale)[0, 2] < 25.0
    np.testing.assert_allclose(to_opponent(change.at_patches(pale))[0, 0], to_opponent(pale)[0, 0], atol=1e-6)


@given(seeds)
def test_skin_made_bright_ends_below_white_in_every_channel(seed: int) -> None:
    """The usual skin at its brightest; by the reference alone its red would be cut."""
    rng = np.random.default_rng(seed)
    brown = rng.normal((150, 105, 85), (22, 20, 18), (400, 3)).clip(5, 250).astype(np.float32)
    pale = rng.normal((250, 208, 190), (8, 9, 9), (400, 3))
    change = SkinMap.between(brown, pale, crisp=CRISP, bounded=1.0)
    usual = np.array([[change.own.high, *change.own.at(np.array([change.own.high]))[0]]])
    assert change(to_rgb(usual).astype(np.float32)).max() == pytest.approx(243, abs=2)
    assert np.diff(change.tone).min() > -1e-9


@pytest.mark.parametrize("level", [252.0, 253.0, 254.0])
def test_of_burnt_out_skin_all_that_lies_beside_it_has_a_tone(level: float) -> None:
    """Its middle may lie at white, above which there is nothing to lead there."""
    burnt_out = np.full((300, 3), level, np.float32)
    made = SkinMap.between(burnt_out, 0.5 * burnt_out.astype(float))
    for tone in (made.beside, made.ears):
        assert (np.diff(tone) >= 0).all()
        assert np.interp(level, np.arange(256), tone) == pytest.approx(0.5 * level, abs=3)


def test_skin_made_nearly_black_is_held_below_white_as_it_is() -> None:
    skin, black = skin_like(1), np.full((300, 3), 1.0)
    free, held = (SkinMap.between(skin, black, bounded=bounded).tone for bounded in (0.0, 1.0))
    np.testing.assert_array_equal(free, held)


def test_a_neck_as_bright_as_the_faces_brightest_keeps_its_chroma_with_a_duller_reference() -> None:
    """In light from one side an ear and a neck are far brighter than an evenly lit reference: no glare, but skin."""
    rng = np.random.default_rng(3)

    def lit(lows: float, highs: float) -> np.ndarray:
        luma = rng.uniform(lows, highs, 500)
        return to_rgb(luma[:, None] * np.array([1.0, -0.25, 0.22]) + rng.normal(0, 0.5, (500, 3))).astype(np.float32)

    skin = lit(55, 190)
    look_map = LookMap(SkinMap.between(skin, lit(80, 120).astype(np.float64), crisp=0.8), 1.0, np.ones((1, 5)))
    moved = to_opponent(look_map.usual_colors("beside")[1])
    saturation = np.hypot(moved[:, 1], moved[:, 2]) / np.maximum(moved[:, 0], 1.0)
    assert moved[185, 0] > 125.0  # brighter than the reference's brightest
    assert saturation[185] == pytest.approx(saturation[100], rel=0.03)
