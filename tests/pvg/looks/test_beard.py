"""Whether a face has a beard that is darker than its skin."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pvg.asset import KeyFrame
from pvg.curves import table_labels
from pvg.looks.beard import beard_of
from tests.gallery.assets import key_frame


def face(upper_lip: float = 1.0, chin: float = 1.0, hidden: tuple[str, ...] = ()) -> KeyFrame:
    """A key frame of even skin whose upper lip and chin have that share of its luma."""
    key = key_frame()
    colors = np.full_like(key.colors, 150.0)
    visible = np.ones(len(colors), bool)
    for name, share in (("upper_lip", upper_lip), ("chin", chin)):
        on = table_labels().on_curves(name)
        colors[on] *= share
        visible[on] = name not in hidden
    return replace(key, colors=colors, visible=visible, skin=np.full((64, 3), 150.0, np.float32))


def test_a_shaven_face_has_none_and_the_shade_of_a_nose_is_none() -> None:
    assert beard_of(face()) == 0.0
    assert beard_of(face(upper_lip=0.7, chin=0.75)) == 0.0


@pytest.mark.parametrize("places", [{"upper_lip": 0.4}, {"chin": 0.3}, {"upper_lip": 0.3, "chin": 0.3}])
def test_a_moustache_a_goatee_and_both_are_one(places: dict[str, float]) -> None:
    assert beard_of(face(**places)) == 1.0


def test_in_between_it_is_told_partly() -> None:
    assert 0.3 < beard_of(face(chin=0.6)) < 0.7


def test_a_hand_before_the_mouth_tells_nothing() -> None:
    assert beard_of(face(upper_lip=0.3, hidden=("upper_lip",))) == 0.0
    assert beard_of(face(0.3, 0.3, hidden=("upper_lip", "chin"))) == 0.0


def test_without_open_skin_there_is_nothing_to_compare_it_with() -> None:
    assert beard_of(replace(face(upper_lip=0.3), skin=np.empty((0, 3), np.float32))) == 0.0
