from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pvg.asset import KeyFrame
from pvg.curves import table_labels
from pvg.looks.depth import _CLEAR, _DEEPEST, depth_of_features
from pvg.looks.tone import tone_curve
from tests.gallery.assets import key_frame


def _face(brows: float, eyes: float, hidden: tuple[str, ...] = ()) -> KeyFrame:
    """A key frame of even skin whose brows and eyes have that share of its luma."""
    key = key_frame()
    colors = np.full_like(key.colors, 150.0)
    visible = np.ones(len(colors), bool)
    for name, share in (("brows", brows), ("eyes", eyes)):
        on = table_labels().on_group(name)
        colors[on] *= share
        visible[on] = name not in hidden
    return replace(key, colors=colors, visible=visible, skin=np.full((64, 3), 150.0, np.float32))


def test_a_face_is_as_deep_as_itself_whatever_its_light() -> None:
    dim = _face(0.7, 0.6)
    dim = replace(dim, colors=0.5 * dim.colors, skin=0.5 * dim.skin)
    assert depth_of_features(_face(0.7, 0.6), dim) == pytest.approx(1.0)


def test_hazy_features_go_down_as_far_as_the_references() -> None:
    assert depth_of_features(_face(0.5, 0.5), _face(0.4, 0.4)) == pytest.approx(0.8, abs=0.01)


def test_features_never_get_paler() -> None:
    assert depth_of_features(_face(0.3, 0.3), _face(0.9, 0.9)) == 1.0


def test_what_is_clear_already_and_what_is_far_off_is_bounded() -> None:
    assert depth_of_features(_face(_CLEAR, 0.2), _face(0.05, 0.05)) == 1.0
    assert depth_of_features(_face(0.9, 0.9), _face(0.05, 0.05)) == pytest.approx(_DEEPEST)


def test_fair_brows_over_dark_eyes_are_no_haze() -> None:
    assert depth_of_features(_face(0.9, _CLEAR), _face(0.1, 0.1)) == 1.0


@pytest.mark.parametrize(("hidden", "wanted"), [(("eyes",), 0.8), (("brows", "eyes"), 1.0)])
def test_a_feature_that_is_hidden_says_nothing(hidden: tuple[str, ...], wanted: float) -> None:
    assert depth_of_features(_face(0.5, 0.1, hidden), _face(0.4, 0.4)) == pytest.approx(wanted, abs=0.01)


def test_depth_reaches_features_and_leaves_skin() -> None:
    skin = np.random.default_rng(0).normal(150, 6, 400)
    plain, deep = tone_curve(skin, skin), tone_curve(skin, skin, 0.7)
    np.testing.assert_allclose(deep[145:], plain[145:], atol=0.5)
    assert deep[60] == pytest.approx(0.7 * 60, abs=2)
    assert (np.diff(deep) > 0).all()
