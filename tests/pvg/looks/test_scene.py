from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pvg.looks.opponent import to_opponent, to_rgb
from pvg.looks.scene import _ending, _kept, in_scene

TAN = (150.0, -0.25, 0.27)  # luma, B − Y and R − Y over it
PALE = (200.0, -0.16, 0.17)
DARK = (70.0, -0.34, 0.40)


def skin(tone: tuple[float, float, float], count: int = 300) -> np.ndarray:
    """Open skin of one tone in light of many strengths, (count, 3) RGB."""
    luma = np.random.default_rng(0).uniform(0.8, 1.2, count) * tone[0]
    rgb = to_rgb(np.column_stack([luma, tone[1] * luma, tone[2] * luma]))
    return np.clip(rgb, 0, 255).astype(np.float32)


def median(colors: np.ndarray) -> tuple[float, np.ndarray]:
    """Luma, and chroma over it."""
    luma, *chroma = to_opponent(np.median(colors, axis=0)[None])[0]
    return float(luma), np.array(chroma) / luma


def test_a_share_of_zero_takes_the_reference_as_it_is() -> None:
    reference = skin(PALE)
    assert in_scene(reference, skin(DARK), 0.0) is reference


@pytest.mark.parametrize("tone", [TAN, PALE, DARK], ids=["tan", "pale", "dark"])
def test_a_clips_own_colours_are_themselves(tone: tuple[float, float, float]) -> None:
    np.testing.assert_allclose(in_scene(skin(tone), skin(tone), 1.0), skin(tone), atol=1e-3)


@pytest.mark.parametrize(("goal", "own", "least", "most"), [(PALE, DARK, 0.4, 0.85), (DARK, PALE, 0.1, 0.3)])
def test_brightness_and_hue_go_part_of_the_way(
    goal: tuple[float, float, float], own: tuple[float, float, float], least: float, most: float
) -> None:
    luma, chroma = median(in_scene(skin(goal), skin(own), 1.0))
    (wanted, wanted_chroma), (start, start_chroma) = median(skin(goal)), median(skin(own))
    assert least < np.log(luma / start) / np.log(wanted / start) < most
    way = (chroma - start_chroma) @ (wanted_chroma - start_chroma) / np.sum((wanted_chroma - start_chroma) ** 2)
    assert 0.4 < way < 0.95


def with_glare(colors: np.ndarray, light: float) -> np.ndarray:
    """Skin whose brightest fifth is mixed with white light, in that share."""
    opponent = to_opponent(colors)
    bright = opponent[:, 0] >= np.quantile(opponent[:, 0], 0.8)
    opponent[bright, 0] *= 1.3
    opponent[bright, 1:] *= 1.3 * (1 - light)
    return np.clip(to_rgb(opponent), 0, 255).astype(np.float32)


def saturation_of_bright(colors: np.ndarray) -> float:
    opponent = to_opponent(colors)
    bright = opponent[opponent[:, 0] >= np.quantile(opponent[:, 0], 0.85)]
    return float(np.median(np.hypot(*bright[:, 1:].T) / bright[:, 0]))


def test_bright_skin_pales_as_the_clips_does_as_far_as_its_middle_is_the_clips() -> None:
    """Six tenths of that: without, a highlight that burns out lies in a ring of orange."""
    rich, goal = (120.0, -0.34, 0.40), skin(PALE)
    plain, burnt = (in_scene(goal, own, 1.0) for own in (skin(rich), with_glare(skin(rich), 0.7)))
    np.testing.assert_allclose(np.median(burnt, axis=0), np.median(plain, axis=0), atol=1.5)
    kept = saturation_of_bright(plain) - saturation_of_bright(goal)  # of the clip's, whose skin is richer
    assert kept > 0.05
    way = kept / (saturation_of_bright(skin(rich)) - saturation_of_bright(goal))
    paler = saturation_of_bright(skin(rich)) - saturation_of_bright(with_glare(skin(rich), 0.7))
    taken = (saturation_of_bright(plain) - saturation_of_bright(burnt)) / (way * paler)
    assert taken == pytest.approx(0.6, abs=0.05)


def test_bright_skin_of_a_reference_whose_middle_is_the_clips_is_left_as_it_is() -> None:
    """To the bit, as references of the same person in the same room may be, or nearly."""
    own = skin(TAN)
    burnt = own.copy()
    bright = own[:, 0] > np.quantile(own[:, 0], 0.8)
    burnt[bright] += (10, 20, 40)
    for off in (0.0, 1e-7, 1e-3):
        reference = burnt.astype(np.float64) + np.array((off, 0, 0))
        np.testing.assert_allclose(in_scene(reference, own, 1.0), np.clip(reference, 0, 255), atol=0.01)


def test_a_reference_that_burns_out_as_the_clip_does_is_as_before() -> None:
    burnt, own = with_glare(skin(TAN), 0.5), with_glare(skin(DARK), 0.5)
    tone, rich = median(in_scene(burnt, own, 1.0))[1], saturation_of_bright(in_scene(burnt, own, 1.0))
    assert rich / np.hypot(*tone) == pytest.approx(0.5, abs=0.03)


def test_rich_skin_does_not_become_grey_at_will() -> None:
    def way(goal: tuple[float, float, float], own: tuple[float, float, float]) -> float:
        taken, start = (median(colors)[1] for colors in (in_scene(skin(goal), skin(own), 1.0), skin(own)))
        return float(np.linalg.norm(taken - start))

    warm, rich, grey = (120.0, -0.45, 0.45), (120.0, -0.30, 0.30), (120.0, -0.05, 0.05)
    assert way(rich, warm) == pytest.approx(0.133, abs=0.01)
    assert way(rich, warm) < way(grey, warm) < 0.14
    assert way(warm, grey) > 0.25  # the other way there is no end


def test_what_lies_near_is_taken_as_it_is() -> None:
    near = skin((165.0, -0.28, 0.3))
    np.testing.assert_allclose(in_scene(near, skin(TAN), 1.0), near, atol=1e-3)


def test_the_farther_the_smaller_the_share() -> None:
    def share(goal: tuple[float, float, float]) -> float:
        start, wanted = median(skin(TAN))[0], median(skin(goal))[0]
        taken = median(in_scene(skin(goal), skin(TAN), 1.0))[0]
        return float(np.log(taken / start) / np.log(wanted / start))

    assert 0.95 > share((100.0, -0.25, 0.27)) > share((50.0, -0.25, 0.27)) + 0.1


@given(far=st.floats(0.01, 20.0), more=st.floats(1.001, 3.0))
def test_what_is_farther_off_is_farther_off_afterwards(far: float, more: float) -> None:
    assert far * _kept(far) < far * more * _kept(far * more) <= far * more


@given(far=st.floats(0.0, 2.0), more=st.floats(0.0, 2.0))
def test_what_has_an_end_goes_no_farther(far: float, more: float) -> None:
    before, after = _ending(far, 0.2, 0.26), _ending(far + more, 0.2, 0.26)
    assert before <= after <= min(far + more, 0.26)
    assert after - before <= more + 1e-9


def test_shading_and_differences_of_the_reference_stay() -> None:
    reference = skin(PALE)
    taken = in_scene(reference, skin(DARK), 1.0)
    before, after = to_opponent(reference)[:, 0], to_opponent(taken)[:, 0]
    np.testing.assert_allclose(after / np.median(after), before / np.median(before), rtol=1e-3)


def test_black_has_no_ratio() -> None:
    reference, black = skin(PALE), np.zeros((50, 3), np.float32)
    assert in_scene(reference, black, 1.0) is reference
    assert in_scene(black, reference, 1.0) is black


def test_references_of_nearly_the_clips_richness_go_nearly_as_far() -> None:
    """Less chroma has an end and more has none; between both nothing jumps."""
    own = skin(TAN)
    rich = float(np.hypot(TAN[1], TAN[2]))
    tones = [(150.0, 0.25 * rich * more, 0.968 * rich * more) for more in (0.995, 1.005)]
    ends = [median(in_scene(skin(tone), own, 1.0))[1] for tone in tones]
    assert np.linalg.norm(ends[0] - ends[1]) < 0.01
