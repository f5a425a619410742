from __future__ import annotations

import cv2
import numpy as np
import pytest

from pvg.skin.light import MID_GREY, face_color, gain_of, median_color, most_chroma


@pytest.mark.parametrize("cells", [1, 2, 7, 300, 301])
@pytest.mark.parametrize("levels", [(0, 256), (250, 256), (0, 3), (40, 41)])
def test_the_median_of_levels_is_that_of_sorted_ones(cells: int, levels: tuple[int, int]) -> None:
    rng = np.random.default_rng(cells)
    rgb = rng.integers(*levels, (20, 31, 3)).astype(np.uint8)
    sample = np.zeros((20, 31), np.bool_)
    sample.flat[rng.choice(sample.size, cells, replace=False)] = True
    np.testing.assert_array_equal(median_color(rgb, sample), np.median(rgb[sample], axis=0))


def test_the_lit_part_of_a_face_in_the_shade_is_not_driven_into_white() -> None:
    rgb = np.full((10, 10, 3), (80, 60, 50), np.uint8)
    rgb[:, 7:] = (220, 190, 160)
    everywhere = np.ones((10, 10), np.bool_)
    gain = gain_of(face_color(rgb, everywhere))
    assert (gain * rgb[0, 0]).max() < 160
    assert 200 < (gain * rgb[0, 9]).max() <= 255
    rgb[:, 7:] = (120, 90, 75)  # a face in even light has such cells
    np.testing.assert_array_equal(face_color(rgb, everywhere), (80, 60, 50))


def test_a_hard_shadow_that_moves_over_a_face_changes_its_light_by_and_by() -> None:
    everywhere, before = np.ones((10, 100), np.bool_), 0.0
    for lit in range(46):  # the median is in the shade
        rgb = np.full((10, 100, 3), (80, 60, 50), np.uint8)
        rgb[:, 100 - lit :] = (220, 190, 160)
        light = float(face_color(rgb, everywhere).max())
        assert light >= before
        assert light < 1.25 * max(before, 80.0)  # a quantile alone leaps by 1.7
        before = light
    assert before > 130


def test_where_nothing_of_a_face_is_seen_its_colour_is_grey() -> None:
    rgb, nothing = np.zeros((4, 4, 3), np.uint8), np.zeros((4, 4), np.bool_)
    assert median_color(rgb, nothing) is None
    np.testing.assert_array_equal(face_color(rgb, nothing), np.full(3, MID_GREY, np.float32))


def _of_lab(light: float, hue: float, chroma: float) -> np.ndarray:
    """(3,) RGB levels of a CIELAB lightness, hue in degrees and chroma."""
    angle = np.radians(hue)
    lab = np.array([[[light, chroma * np.cos(angle), chroma * np.sin(angle)]]], np.float32)
    return np.asarray(255 * cv2.cvtColor(lab, cv2.COLOR_Lab2RGB)[0, 0], np.float32)


def _hue_and_chroma(color: np.ndarray) -> tuple[float, float]:
    """In CIELAB, degrees and units, of (3,) RGB levels."""
    lab = cv2.cvtColor(np.reshape(color / 255, (1, 1, 3)).astype(np.float32), cv2.COLOR_RGB2Lab)[0, 0]
    return float(np.degrees(np.arctan2(lab[2], lab[1]))), float(np.hypot(*lab[1:]))


@pytest.mark.parametrize(("light", "hue", "chroma"), [(66, 55, 26), (64, 48, 17), (70, 38, 35), (75, 62, 19)])
def test_usual_skin_stays_as_it_is(light: float, hue: float, chroma: float) -> None:
    np.testing.assert_array_equal(gain_of(_of_lab(light, hue, chroma)), 1)


@pytest.mark.parametrize(("light", "hue", "chroma"), [(57, 25, 7), (63, 10, 19), (66, 20, 10)])
def test_skin_that_a_cool_white_made_red_and_pale_is_made_usual(light: float, hue: float, chroma: float) -> None:
    color = _of_lab(light, hue, chroma)
    turned, raised = _hue_and_chroma(color * gain_of(color))
    assert 31 < turned < 55
    assert raised > 12.5


@pytest.mark.parametrize("light", [55, 72])
def test_skin_that_a_warm_white_made_vivid_is_made_usual(light: float) -> None:
    color = _of_lab(light, 52, 50)
    usual = color * gain_of(color)
    hue, chroma = _hue_and_chroma(usual)
    assert hue == pytest.approx(52, abs=3)
    assert 30 < chroma < 43


def test_pale_skin_of_usual_hue_is_no_cool_white() -> None:
    """In haze all chroma is low: told as a white's, it would make skin of walls and hair."""
    hazy, cool = (gain_of(_of_lab(66, hue, 10)) for hue in (48, 22))
    np.testing.assert_array_equal(hazy, 1)
    assert cool[0] > 1.04 * cool[2]


def test_light_that_changes_by_little_changes_the_gain_by_little() -> None:
    colors = [_of_lab(66, hue, chroma) for chroma in (3, 10, 20, 40) for hue in np.arange(-60, 120, 0.5)]
    gains = np.array([gain_of(color) for color in colors]).reshape(4, -1, 3)
    assert np.abs(np.diff(gains, axis=1)).max() < 0.05


def test_the_chroma_around_a_face_is_its_own_in_any_light() -> None:
    """A nearly grey picture stays one, though `gain_of` makes it usual; a dim one has the chroma of a lit one."""
    everywhere = np.ones((10, 10), np.bool_)

    def told(color: np.ndarray) -> float:
        return most_chroma(np.tile(np.rint(color).astype(np.uint8), (10, 10, 1)), everywhere, color)

    skin, greyish = _of_lab(66, 50, 20), _of_lab(66, 50, 3)
    assert told(skin) == pytest.approx(17, abs=2)
    assert told(0.25 * skin) == pytest.approx(told(skin), abs=2)
    assert told(greyish) < 4
    assert _hue_and_chroma(greyish * gain_of(greyish))[1] > 5
    assert most_chroma(np.zeros((10, 10, 3), np.uint8), ~everywhere, skin) == 0
