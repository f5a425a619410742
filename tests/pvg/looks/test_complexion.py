from __future__ import annotations

import cv2
import numpy as np
import pytest

from pvg.looks.complexion import _cast, _held, complexion
from pvg.looks.scene import in_scene

TAN = (60.0, 15.0, 20.0)  # CIELAB: C*/L* 0.42
ASHEN = (60.0, 10.0, 13.0)  # 0.27


def skin(lab: tuple[float, float, float], chroma: float = 1.0, count: int = 400) -> np.ndarray:
    """Open skin of one complexion in light of many strengths, (count, 3) RGB."""
    rng = np.random.default_rng(0)
    median = np.array((lab[0], chroma * lab[1], chroma * lab[2]), np.float32).reshape(1, 1, 3)
    rgb = 255.0 * cv2.cvtColor(median, cv2.COLOR_LAB2RGB)[0, 0]
    return (rng.uniform(0.8, 1.2, (count, 1)) * rgb + rng.normal(0, 2, (count, 3))).astype(np.float32)


def median_lab(colors: np.ndarray) -> np.ndarray:
    median = (np.median(colors, axis=0) / 255).astype(np.float32).reshape(1, 1, 3)
    return np.asarray(cv2.cvtColor(median, cv2.COLOR_RGB2LAB)[0, 0])


def lightness_and_saturation(colors: np.ndarray) -> tuple[float, float]:
    lightness, a, b = median_lab(colors)
    return float(lightness), float(np.hypot(a, b) / lightness)


def test_ashen_skin_gains_chroma_and_keeps_its_lightness() -> None:
    reference = skin(ASHEN)
    before, after = lightness_and_saturation(reference), lightness_and_saturation(complexion(reference, skin(TAN), 1.0))
    assert after[1] == pytest.approx(0.36, abs=0.015)
    assert after[0] == pytest.approx(before[0], abs=1.0)


RICH = (60.0, 20.0, 28.0)  # 0.57


@pytest.mark.parametrize(("warmth", "share"), [(0, 0.0), (10, 0.0), (18, 0.375), (26, 0.75), (100, 0.75)])
def test_in_warm_surroundings_three_quarters_of_the_chroma_that_the_clips_skin_has_more_are_taken(
    warmth: int, share: float
) -> None:
    plain, warm = (median_lab(complexion(skin(TAN), skin(RICH), 1.0, one)) for one in (0, warmth))
    before, after, own = (float(np.hypot(*lab[1:])) for lab in (plain, warm, median_lab(skin(RICH))))
    assert own - before > 4
    assert (after - before) / (own - before) == pytest.approx(share, abs=0.11)  # in CIELAB a little less
    assert np.degrees(np.arctan2(*warm[:0:-1])) == pytest.approx(np.degrees(np.arctan2(*plain[:0:-1])), abs=1.0)


def test_there_chroma_grows_by_a_fifth_at_most_and_not_with_lightness() -> None:
    plain, warm = (median_lab(complexion(skin(ASHEN), skin((60.0, 26.0, 36.0)), 1.0, one)) for one in (0, 60))
    assert np.hypot(*warm[1:]) / np.hypot(*plain[1:]) == pytest.approx(1.2, abs=0.02)
    bright, own = skin((80.0, 18.0, 26.0)), skin((45.0, 17.0, 24.0))  # less for its lightness than the clip's has
    np.testing.assert_allclose(complexion(bright, own, 1.0, 60), complexion(bright, own, 1.0), atol=1.0)


def test_what_is_richer_than_the_clips_skin_stays_as_it_is_there() -> None:
    for own in (TAN, ASHEN):
        np.testing.assert_array_equal(complexion(skin(TAN), skin(own), 1.0, 60), complexion(skin(TAN), skin(own), 1.0))
    reference = skin(TAN)
    assert complexion(reference, skin(RICH), 0.0, 60) is reference  # as it is, is what was asked for


def test_the_clips_own_skin_bounds_it() -> None:
    own = skin(ASHEN, chroma=1.15)
    _, saturation = lightness_and_saturation(complexion(skin(ASHEN), own, 1.0))
    assert saturation == pytest.approx(lightness_and_saturation(own)[1], abs=0.01)


@pytest.mark.parametrize(
    ("own", "saturation"),
    [((70.0, 12.0, 14.0), 0.33), ((70.0, 7.0, 8.0), 0.23)],
    ids=["pale skin", "a grey film"],
)
def test_pale_skin_that_gets_darker_gets_the_chroma_of_darker_skin(
    own: tuple[float, float, float], saturation: float
) -> None:
    assert lightness_and_saturation(skin(own))[1] < 0.27
    taken = complexion(skin(ASHEN), skin(own), 1.0)
    assert lightness_and_saturation(taken)[1] == pytest.approx(saturation, abs=0.015)


@pytest.mark.parametrize("own", [(60.0, 7.0, 8.0), (60.0, 9.0, 11.5)], ids=["a grey film", "a faded picture"])
def test_dull_skin_takes_six_tenths_of_what_is_richer(own: tuple[float, float, float]) -> None:
    dull, plain, rich = skin(own), skin(TAN), skin((60.0, 15.0, 23.0))
    (_, grey), (_, wanted) = lightness_and_saturation(dull), lightness_and_saturation(in_scene(rich, dull, 1.0))
    assert lightness_and_saturation(complexion(rich, dull, 1.0))[1] == pytest.approx(
        0.4 * grey + 0.6 * wanted, abs=0.01
    )
    assert complexion(rich, dull, 0.0) is rich
    np.testing.assert_allclose(complexion(rich, plain, 1.0), rich, atol=1e-3)


@pytest.mark.parametrize("chroma", [0.0, 0.3, 1.0])
def test_a_clips_own_colours_are_themselves(chroma: float) -> None:
    own = skin(ASHEN, chroma)
    np.testing.assert_allclose(complexion(own, own, 1.0), own, atol=1e-3)


def test_a_face_in_two_lights_keeps_both_of_its_own() -> None:
    sun, sky = skin((62.0, 15.0, 20.0)), skin((45.0, 8.0, 2.0))
    own = np.concatenate((sun, sky))
    assert len(complexion(own, sun, 1.0)) < len(own)  # as a reference of other skin it gives that in the sun
    np.testing.assert_allclose(complexion(own, own, 1.0), own, atol=1e-3)


def test_a_scene_of_zero_leaves_grey_skin_grey() -> None:
    reference = skin(ASHEN)
    assert complexion(reference, skin(TAN), 0.0) is reference


@pytest.mark.parametrize("lab", [TAN, (78.0, 14.0, 19.0), (40.0, 12.0, 14.0)], ids=["tan", "pale", "dark"])
def test_usual_skin_is_taken_as_it_is(lab: tuple[float, float, float]) -> None:
    reference = skin(lab)
    assert complexion(reference, skin(TAN), 0.0) is reference


FLUSHED = (69.0, 31.0, 25.0)  # C* 40


def hue(lab: np.ndarray | tuple[float, float, float]) -> float:
    return float(np.degrees(np.arctan2(lab[2], lab[1])))


NEAR = skin((69.0, 21.0, 24.0))  # a clip whose scene bears them: nothing else holds them back
OLIVE = (60.0, 8.7, 31.0)


def test_flushed_skin_is_held_to_what_skin_is() -> None:
    lightness, red, yellow = median_lab(complexion(skin(FLUSHED), NEAR, 1.0))
    assert lightness == pytest.approx(FLUSHED[0], abs=1.5)  # luma is kept, which is nearly the same
    assert red == pytest.approx(23.0, abs=0.8)
    assert np.hypot(red, yellow) == pytest.approx(32.0, abs=1.0)


def test_skin_in_greenish_light_is_no_yellower_than_skin_is() -> None:
    assert hue(OLIVE) > 70
    assert hue(median_lab(complexion(skin(OLIVE), NEAR, 1.0))) <= 63.0


@pytest.mark.parametrize("lab", [FLUSHED, OLIVE], ids=["flushed", "greenish"])
def test_a_scene_of_zero_takes_them_as_they_are(lab: tuple[float, float, float]) -> None:
    reference = skin(lab)
    assert complexion(reference, NEAR, 0.0) is reference
    whole, half = (median_lab(complexion(reference, NEAR, scene)) for scene in (1.0, 0.5))
    assert np.linalg.norm(half - median_lab(reference)) < np.linalg.norm(whole - median_lab(reference))


def test_a_clip_as_flushed_takes_it_as_it_is() -> None:
    reference = np.clip(skin(FLUSHED), 0, 255)
    np.testing.assert_allclose(complexion(reference, reference, 1.0), reference, atol=1e-3)


@pytest.mark.parametrize("chroma", [12.0, 20.0, 30.0])
@pytest.mark.parametrize("angle", range(-25, 116, 5))
def test_a_clips_own_colours_are_themselves_in_every_hue(angle: float, chroma: float) -> None:
    a, b = chroma * np.cos(np.radians(angle)), chroma * np.sin(np.radians(angle))
    own = np.clip(skin((55.0, a, b)), 0, 255)
    np.testing.assert_allclose(complexion(own, own, 1.0), own, atol=0.01)


def test_the_hue_of_skin_without_chroma_bounds_nothing() -> None:
    yellow = np.array((60.0, 8.7, 31.0))
    greys = [np.array((60.0, 0.4 * np.cos(turn), 0.4 * np.sin(turn))) for turn in np.linspace(0, 6, 7)]
    held = np.array([_held(yellow, grey) for grey in greys])
    np.testing.assert_allclose(held, held[:1].repeat(len(held), axis=0))
    assert hue(held[0]) == pytest.approx(62.0)


def test_an_orange_lamp_is_held_in_chroma_alone() -> None:
    orange = np.array((63.0, 22.5, 35.0))
    held = _held(orange, np.array(TAN))
    assert held is not None
    assert np.hypot(*held[1:]) == pytest.approx(32.0)
    assert hue(held) == pytest.approx(hue(orange))


@pytest.mark.parametrize("lab", [(45.0, 30.0, -35.0), (60.0, -30.0, 30.0)], ids=["purple", "green"])
def test_coloured_light_is_meant(lab: tuple[float, float, float]) -> None:
    assert _held(np.array(lab), np.array(TAN)) is None


@pytest.mark.parametrize("edge", [0.0, 90.0, -25.0, 115.0])
def test_hues_that_hardly_differ_are_held_alike(edge: float) -> None:
    ends = []
    for degrees in (edge - 0.2, edge + 0.2):
        angle = np.radians(degrees)
        lab = np.array([65.0, 40.0 * np.cos(angle), 40.0 * np.sin(angle)])
        held = _held(lab, np.array(TAN))
        ends.append(lab if held is None else held)
    assert np.linalg.norm(ends[0] - ends[1]) < 1.0


@pytest.mark.parametrize("level", [0.0, 0.2])
def test_black_skin_gets_no_chroma(level: float) -> None:
    """Nor where the clip's has a yellow cast, which others are turned to."""
    black, yellow = np.full((50, 3), level, np.float32), skin((60.0, 2.0, 30.0))
    np.testing.assert_allclose(complexion(black, yellow, 1.0), black, atol=0.5)


def test_black_and_white_stays() -> None:
    taken = complexion(skin(ASHEN, chroma=0.02), skin(TAN), 0.0)
    assert lightness_and_saturation(taken)[1] < 0.02


def test_without_skin_there_is_nothing_to_change() -> None:
    nothing, reference = np.zeros((0, 3), np.float32), skin(ASHEN)
    assert complexion(nothing, reference, 0.0).shape == (0, 3)
    assert complexion(reference, nothing, 0.0) is reference


def lab_of(angle: float, chroma: float = 30.0) -> np.ndarray:
    return np.array((60.0, chroma * np.cos(np.radians(angle)), chroma * np.sin(np.radians(angle))))


@pytest.mark.parametrize(
    ("given", "own", "turned"),
    [
        (50, 62, 0),
        (50, 40, 0),
        (50, 78, 8),
        (70, 78, 4),
        (80, 78, 0),
        (50, 100, 19),
        (50, 140, 0),
        (-70, 78, 0),
        (130, 78, 0),
    ],
)
def test_half_of_what_a_clips_skin_is_yellower_than_skin_stays(given: float, own: float, turned: float) -> None:
    assert np.degrees(_cast(lab_of(given), lab_of(own))) == pytest.approx(turned, abs=1e-6)
    assert _cast(lab_of(given), lab_of(own, 2.0)) == 0.0  # a grey's hue is chance


def test_a_cast_turns_the_hue_alone_as_far_as_the_scene_counts() -> None:
    reference = skin((60.0, 19.0, 23.0))
    turned, half, none = (
        median_lab(complexion(reference, skin(tuple(lab_of(78))), scene)) for scene in (1.0, 0.5, 0.0)
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("pvg.looks.complexion._CAST", 0.0)
        without = median_lab(complexion(reference, skin(tuple(lab_of(78))), 1.0))
    assert hue(turned) - hue(without) == pytest.approx(8.0, abs=0.3)
    assert hue(none) < hue(half) < hue(turned)
    assert np.hypot(*turned[1:]) == pytest.approx(np.hypot(*without[1:]), abs=0.5)
    assert turned[0] == pytest.approx(without[0], abs=1.0)
