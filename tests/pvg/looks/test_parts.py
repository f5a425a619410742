from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pvg.asset import KeyFrame
from pvg.curves import table_labels
from pvg.face import PARTS
from pvg.looks.opponent import to_opponent, to_rgb
from pvg.looks.parts import MAKEUP, PartChanges, _hue, strengths
from pvg.looks.skin_map import SkinMap
from tests.gallery.assets import key_frame


def _skin(color: tuple[float, float, float], seed: int = 0) -> np.ndarray:
    """Skin of one chroma for each tone, (256, 3)."""
    light = np.random.default_rng(seed).uniform(0.85, 1.15, (256, 1))
    return (np.array(color) * light).astype(np.float32)


def _face(color: tuple[float, float, float], beyond: dict[str, tuple[float, float, float]]) -> KeyFrame:
    """A key frame whose parts are its skin's colour, multiplied and shifted: part -> (luma share, B − Y, R − Y)."""
    skin = _skin(color)
    middle = to_opponent(np.median(skin, axis=0)[None])[0]
    parts = []
    for part in PARTS:
        share, blue, red = beyond.get(part, (1.0, 0.0, 0.0))
        parts.append(to_rgb(np.array([[middle[0] * share, middle[1] * share + blue, middle[2] * share + red]]))[0])
    return replace(key_frame(), skin=skin, parts=np.array(parts, np.float32))


_OWN = _face((150, 110, 95), {"lips": (0.85, 0.0, 12.0), "brows": (0.5, 0.0, 0.0)})
_MADE_UP = _face((210, 175, 160), {"lips": (0.75, -4.0, 22.0), "lids": (0.85, 5.0, 0.0), "cheeks": (1.0, 0.0, 12.0)})


FULL = strengths(1.0)


def _asked_nothing(skin: SkinMap, own: KeyFrame) -> np.ndarray:
    """What a clip's parts gain beside a reference that shows none: what F takes of lips and brows, else nothing."""
    count = len(PARTS)
    change = PartChanges(np.full(count, np.nan), np.zeros((count, 2))).on(skin, own, FULL)
    assert not np.delete(change, [PARTS.index("lips"), PARTS.index("brows")], axis=0).any()
    return change


def _map(source: KeyFrame, target: KeyFrame) -> SkinMap:
    return SkinMap.between(source.skin, target.skin.astype(np.float64))


@pytest.mark.parametrize("part", ["lips", "lids", "cheeks"])
def test_a_part_ends_as_far_from_the_skin_as_the_references(part: str) -> None:
    skin, p = _map(_OWN, _MADE_UP), PARTS.index(part)
    change = PartChanges.of(_MADE_UP).on(skin, _OWN, FULL)
    ends = to_opponent(skin(_OWN.parts))[p] + change[p] - to_opponent(skin(np.median(_OWN.skin, axis=0)[None]))[0]
    wanted = to_opponent(_MADE_UP.parts)[p] - to_opponent(np.median(_MADE_UP.skin, axis=0)[None])[0]
    alone = np.linalg.norm(ends - change[p] - wanted)
    assert np.linalg.norm(ends - wanted) < 0.25 * alone


@pytest.mark.parametrize("light", [(40, 45, 200), (70, 190, 60), (110, 50, 190), (200, 35, 25), (205, 110, 20)])
def test_light_of_nearly_one_colour_shows_no_make_up(light: tuple[float, float, float]) -> None:
    own = _face(light, {"lips": (0.85, 0.0, -4.0), "brows": (0.5, 0.0, 0.0)})
    skin = _map(own, _face(tuple(1.2 * level for level in light), {}))  # brighter, in the same light
    np.testing.assert_array_equal(PartChanges.of(_MADE_UP).on(skin, own, FULL), _asked_nothing(skin, own))


@pytest.mark.parametrize("gain", [0.85, 1.05, 1.2])
@pytest.mark.parametrize(
    ("skin", "lips"),
    [((60, 70, 200), (85, 60, 180)), ((70, 70, 180), (85, 58, 160)), ((60, 130, 140), (75, 115, 125))],
    ids=["blue", "violet", "cyan"],
)
def test_lips_in_blue_light_keep_its_hue_as_the_skin_gets_brighter_or_darker(
    skin: tuple[float, float, float], lips: tuple[float, float, float], gain: float
) -> None:
    own = _face(skin, {})
    parts = own.parts.copy()
    parts[PARTS.index("lips")] = lips
    own = replace(own, parts=parts)
    brighter = SkinMap.between(own.skin, gain * own.skin.astype(np.float64))
    change = _asked_nothing(brighter, own)[PARTS.index("lips")]
    drawn = to_rgb((to_opponent(brighter(own.parts))[PARTS.index("lips")] + change)[None])[0]
    np.testing.assert_allclose(drawn, gain * np.array(lips), atol=16)


def test_a_reference_like_the_clip_asks_for_nothing() -> None:
    change = PartChanges.of(_OWN).on(_map(_OWN, _OWN), _OWN, FULL)
    assert np.abs(change).max() < 1.0


def test_half_the_strength_takes_less_red_from_lips_than_it_gives() -> None:
    lips, half = PARTS.index("lips"), strengths(0.5)
    painted, plain = (_face((190, 150, 135), {"lips": (0.8, 0.0, red)}) for red in (40.0, 8.0))
    changes = [
        [PartChanges.of(reference).on(_map(own, reference), own, strength)[lips, 2] for strength in (half, FULL)]
        for own, reference in ((plain, painted), (painted, plain))
    ]
    (given, all_given), (taken, all_taken) = changes
    assert all_given > 4.0
    assert all_taken < -4.0
    assert given == pytest.approx(all_given / 4, rel=0.01)
    assert taken == pytest.approx(all_taken / 8, rel=0.01)


@pytest.mark.parametrize(("share", "keeps"), [(0.3, 1.0), (0.725, 0.5), (1.0, 0.0)])
def test_a_brow_keeps_the_hue_of_its_hair_as_far_as_it_is_dark(share: float, keeps: float) -> None:
    """A grey brow stays grey on skin made red, one as light as the skin goes with it."""
    own, red = _face((150, 150, 150), {"brows": (share, 0.0, 0.0)}), _face((190, 140, 120), {})
    skin = _map(own, red)
    moved = to_opponent(skin(own.parts))[PARTS.index("brows")]
    gains = PartChanges.of(red).on(skin, own, strengths(0.0))[PARTS.index("brows")]
    assert gains[0] == pytest.approx(0.0, abs=1.0)  # the skin's luma stays as well
    np.testing.assert_allclose(gains[1:], -keeps * moved[1:], atol=0.05 * np.abs(moved[1:]).max())


@pytest.mark.parametrize(("share", "kept"), [(0.3, 0.9), (0.725, 0.45), (1.0, 0.0)])
def test_a_brow_stays_as_dark_as_its_hair_where_skin_gets_brighter(share: float, kept: float) -> None:
    """And in less light it gets darker with the skin."""
    brow = PARTS.index("brows")
    own = _face((150, 110, 95), {"brows": (share, 0.0, 0.0)})
    for goal, sign in (((200, 160, 145), 1), ((100, 70, 55), 0)):
        reference = _face(goal, {})
        skin = _map(own, reference)
        before, moved = (to_opponent(colors)[brow, 0] for colors in (own.parts, skin(own.parts)))
        gain = PartChanges.of(reference).on(skin, own, strengths(0.0))[brow, 0]
        assert abs(moved - before) > 5.0
        assert gain == pytest.approx(-sign * kept * (moved - before), abs=0.5)


def test_lids_take_little_of_a_reference_below_full_strength() -> None:
    own, reference = (_face((190, 150, 135), {"lids": (share, 0.0, 0.0)}) for share in (1.0, 0.8))
    half, most, full = (
        PartChanges.of(reference).on(_map(own, reference), own, strength)[PARTS.index("lids"), 0]
        for strength in (strengths(0.5), strengths(0.75), FULL)
    )
    assert full < -10.0
    assert half == pytest.approx(full / 64, rel=0.01)
    assert most == pytest.approx(0.178 * full, rel=0.01)


@pytest.mark.parametrize(
    ("part", "color"),
    [
        ("lips", (0.3, 0.0, 3.0)),  # under a black beard
        ("lips", (0.8, 0.0, -20.0)),  # grey: stubble
        ("lids", (0.3, 0.0, 0.0)),  # sunglasses
        ("cheeks", (0.4, 0.0, 0.0)),  # in deep shadow
        ("cheeks", (1.1, 10.0, -6.0)),  # in light that takes their colour: on another face they would be grey patches
    ],
)
def test_a_beard_or_a_shadow_in_the_reference_is_left_out(part: str, color: tuple[float, float, float]) -> None:
    reference = _face((210, 175, 160), {part: color})
    skin, p = _map(_OWN, reference), PARTS.index(part)
    np.testing.assert_array_equal(PartChanges.of(reference).on(skin, _OWN, FULL)[p], _asked_nothing(skin, _OWN)[p])


def test_cheeks_that_are_violet_themselves_stay_so_with_their_own_colours() -> None:
    own = _face((210, 175, 160), {"cheeks": (1.0, 9.0, 3.0)})
    change = PartChanges.of(own).on(_map(own, own), own, FULL)
    assert np.abs(change[PARTS.index("cheeks")]).max() < 0.1


def test_deep_red_lips_are_a_lipstick_and_no_shadow() -> None:
    skin, lips = _map(_OWN, _MADE_UP), PARTS.index("lips")
    reds = []
    for luma in (0.5, 0.44, 0.4):
        reference = _face((210, 175, 160), {"lips": (luma, -4.0, 70.0)})
        reds.append(PartChanges.of(reference).on(skin, _OWN, FULL)[lips, 2])
    assert min(reds) > 0.8 * max(reds) > 0


@pytest.mark.parametrize(("above", "luma", "kept"), [(0.4, 0.55, False), (0.4, 0.75, True), (1.0, 0.55, True)])
def test_lips_in_a_moustaches_shade_are_left_out(above: float, luma: float, *, kept: bool) -> None:
    lips, mouth = PARTS.index("lips"), table_labels().on_curves("upper_lip")
    reference = _face((210, 175, 160), {"lips": (luma, 0.0, 15.0)})
    skin = np.median(reference.skin, axis=0)
    colors = np.where(mouth[:, None], above * skin, skin).astype(np.float32)
    reference = replace(reference, colors=colors, visible=np.ones(len(colors), np.bool_))
    skin = _map(_OWN, reference)
    change = PartChanges.of(reference).on(skin, _OWN, FULL)[lips]
    assert (change != _asked_nothing(skin, _OWN)[lips]).any() == kept


def test_what_is_not_seen_on_either_side_is_left_out() -> None:
    hidden = np.full((len(PARTS), 3), np.nan, np.float32)
    unseen = replace(_MADE_UP, parts=hidden)
    skin = _map(_OWN, unseen)
    np.testing.assert_array_equal(PartChanges.of(unseen).on(skin, _OWN, FULL), _asked_nothing(skin, _OWN))
    ours = replace(_OWN, parts=hidden)
    assert (PartChanges.of(_MADE_UP).on(_map(ours, _MADE_UP), ours, FULL) == 0).all()


@pytest.mark.parametrize("strength", [0.0, 1.0])
@pytest.mark.parametrize("tone", [(210, 175, 160), (100, 75, 62)])
def test_lips_that_are_asked_for_nothing_keep_what_sets_them_apart(
    tone: tuple[float, float, float], strength: float
) -> None:
    """F takes what differs from the skin for a stain and lessens it; on skin in less light there is less of it."""
    reference = _face(tone, {"lips": (0.3, 0.0, 3.0)})
    skin = replace(_map(_OWN, reference), spread=0.5)
    change = PartChanges.of(reference).on(skin, _OWN, strengths({"lips": strength}))
    lips, before = to_opponent(skin(_OWN.parts))[0], to_opponent(_OWN.parts)[0]
    gain = min(1.0, tone[0] / 150)
    for add, share in ((np.zeros(3), 0.5), (change[0], gain)):
        red = (lips + add)[2] - skin.goal.at(lips[:1])[0, 1]
        assert red == pytest.approx(share * (before[2] - skin.own.at(before[:1])[0, 1]), rel=0.05)


def test_black_lips_are_bounded_by_what_lips_can_be() -> None:
    painted = _face((210, 175, 160), {"lips": (0.5, 0.0, 30.0)})
    skin = _map(_OWN, painted)
    lips = to_opponent(skin(_OWN.parts))[0] + PartChanges.of(painted).on(skin, _OWN, FULL)[0]
    assert lips[0] > 0.55 * to_opponent(skin(np.median(_OWN.skin, axis=0)[None]))[0, 0]


@pytest.mark.parametrize("painted", [(0.7, 30.0, 30.0), (0.7, 10.0, 60.0), (0.7, -30.0, 0.0), (0.7, -40.0, 90.0)])
@pytest.mark.parametrize("tone", [(210, 175, 160), (120, 80, 60)])
def test_lips_stay_in_the_hues_that_lips_have_beside_their_skin(
    painted: tuple[float, float, float], tone: tuple[float, float, float]
) -> None:
    """Neither mauve nor yellow, whatever the reference wears; a clip that wears it keeps it."""
    reference = _face(tone, {"lips": painted})
    skin = _map(_OWN, reference)
    lips = to_opponent(skin(_OWN.parts))[0] + PartChanges.of(reference).on(skin, _OWN, FULL)[0]
    around = _hue(to_opponent(np.array([tone], float))[0, 1:])
    own = _hue(to_opponent(_OWN.parts)[0, 1:])
    assert around - 3 <= _hue(lips[1:]) <= max(around + 18, 68, own) + 1  # degrees
    if PartChanges.of(reference).chroma[0].any():
        same = PartChanges.of(reference).on(_map(reference, reference), reference, FULL)
        assert np.abs(same[0]).max() < 1.0


def test_strengths_are_for_all_parts_or_by_part() -> None:
    np.testing.assert_array_equal(strengths(0.5), np.full(len(PARTS), 0.5, np.float32))
    np.testing.assert_array_equal(strengths({"lids": 0.2}), np.float32([MAKEUP, 0.2, MAKEUP, MAKEUP]))
    for wrong in (1.5, -0.1, {"nose": 0.5}, {"lips": True}, {"lips": 2}):
        with pytest.raises(ValueError, match=r"makeup|no part"):
            strengths(wrong)
