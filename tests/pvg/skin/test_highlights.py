"""What is skin in brighter light, and what is as bright beside skin."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from pvg.skin.color_model import ColorScale, to_skin_lab
from pvg.skin.face_in_scene import FaceInScene
from pvg.skin.highlights import fill_highlights
from pvg.skin.prior import head_shape
from tests.gallery.scenes import TONES, drawn_face

SIDE, AT, REACH = 80, (40, 40), 14.0
TAN = np.array(TONES["tan"][0], np.float32)
#: what is added to the skin where the light is brightest
WHITE_LIGHT, GREEN_LIGHT = np.array((75, 95, 95), np.float32), np.array((0, 90, 0), np.float32)


def _scale() -> ColorScale:
    noise = np.random.default_rng(0).normal(0, 4, (4000, 1, 3))
    return ColorScale.fit(to_skin_lab(np.asarray(np.clip(TAN + noise, 0, 255), np.uint8))[:, 0])


def _raised(
    light: np.ndarray, *, sharp: bool = False, skin_ends: int = SIDE, person: int = 255, gain: float = 1.0
) -> tuple[float, bool]:
    """The share of a bright round place on skin whose probability is raised, and whether any is elsewhere.

    sharp: whether it ends at an edge;  skin_ends: column of a dark wall from which on there is no skin.
    """
    rows, columns = np.mgrid[:SIDE, :SIDE]
    away = np.hypot(rows - AT[0], columns - AT[1]) / REACH
    share = (away < 1).astype(np.float32) if sharp else np.exp(-(away**2)).astype(np.float32)
    rgb = TAN + share[..., None] * light
    rgb[:, skin_ends:] = 30
    scene = np.asarray(np.clip(cv2.GaussianBlur(rgb.astype(np.float32), (0, 0), 0.5) * gain, 0, 255), np.uint8)
    own = columns < skin_ends
    place = (away < 0.7) & own
    probability = np.where((away < 1) | ~own, 0.1, 0.95).astype(np.float32)  # as by colour
    before = probability.copy()
    head = head_shape(drawn_face((300, 150), 130, "tan", (480, 640)).landmarks)
    seen = FaceInScene(scene, np.full(scene.shape[:2], person, np.uint8), np.zeros_like(probability), head)
    fill_highlights(probability, np.zeros_like(probability), seen, _scale(), np.full(3, 1 / gain, np.float32))
    raised = probability > before
    return float(raised[place].mean()), bool(raised[(away > 1.2) | ~own].any())


def test_a_place_that_light_makes_brighter_and_paler_is_skin() -> None:
    assert _raised(WHITE_LIGHT) == (1.0, False)


def test_it_may_lie_where_the_skin_ends() -> None:
    share, elsewhere = _raised(WHITE_LIGHT, skin_ends=AT[1] + 6)
    assert share > 0.85
    assert not elsewhere


def test_the_light_may_have_changed_since_the_key_frame() -> None:
    assert _raised(WHITE_LIGHT, gain=0.6) == (1.0, False)


@pytest.mark.parametrize(
    ("light", "more"),
    [
        (WHITE_LIGHT, {"sharp": True}),
        (GREEN_LIGHT, {}),
        (-0.4 * TAN, {}),
        (WHITE_LIGHT, {"person": 60}),
    ],
    ids=["a light shirt", "green light", "a shadow", "a wall"],
)
def test_what_has_an_edge_another_hue_less_light_or_nobody_is_left_as_it_is(light: np.ndarray, more: dict) -> None:
    assert _raised(light, **more) == (0.0, False)
