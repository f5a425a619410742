from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pvg.asset import KeyFrame
from pvg.curves import table_labels
from pvg.face import PARTS
from pvg.looks import SkinMap, to_rgb
from pvg.looks.apart import parts_apart
from pvg.looks.opponent import to_opponent
from tests.gallery.assets import key_frame

_LIPS = table_labels().on_group("lips")
_BESIDE = table_labels().on_curves("upper_lip", "chin")


def _face() -> KeyFrame:
    """Skin of one hue, in more and less light, with lips that are darker and redder."""
    light = np.random.default_rng(0).uniform(0.8, 1.2, (len(table_labels()), 1))
    colors = (np.array((150, 110, 95)) * light).astype(np.float32)
    lips = np.float32((130, 75, 70))
    colors[_LIPS] = lips
    return replace(key_frame(), colors=colors, skin=colors[~_LIPS], parts=np.tile(lips, (len(PARTS), 1)))


@pytest.mark.parametrize("contrast", [0.8, 1.0, 1.5])
def test_lips_are_what_the_map_makes_of_them_and_the_skin_beside_them_is_not_changed_by_them(contrast: float) -> None:
    key = _face()
    skin = SkinMap.between(key.skin, 0.6 * key.skin.astype(np.float64) ** 1.05)
    moved = skin(key.colors)
    slopes = np.array([skin.slopes(key.colors[:1])[0, 0], contrast, contrast])  # chroma as the membrane has it
    new, lacks = parts_apart(key, skin, moved, contrast)
    np.testing.assert_array_equal(new[~_LIPS], moved[~_LIPS])

    def shifts(colors: np.ndarray) -> np.ndarray:
        return to_opponent(colors) - slopes * to_opponent(key.colors)

    beside = shifts(moved)[_BESIDE & key.visible].mean(axis=0)
    np.testing.assert_allclose(shifts(new)[_LIPS], np.broadcast_to(beside, (int(_LIPS.sum()), 3)), atol=1e-3)
    lips = to_rgb(to_opponent(new[_LIPS][:1]) + lacks[PARTS.index("lips")])
    np.testing.assert_allclose(lips, skin(key.parts[:1]), atol=1e-3)
    assert not np.delete(lacks, PARTS.index("lips"), axis=0).any()


def test_lips_that_are_not_seen_stay_as_they_are() -> None:
    hidden = replace(_face(), parts=np.full((len(PARTS), 3), np.nan, np.float32))
    skin = SkinMap.between(hidden.skin, 0.6 * hidden.skin.astype(np.float64))
    moved = skin(hidden.colors)
    new, lacks = parts_apart(hidden, skin, moved, 1.0)
    np.testing.assert_array_equal(new, moved)
    assert not lacks.any()


def test_own_colours_lack_nothing() -> None:
    key = _face()
    skin = SkinMap.between(key.skin, key.skin.astype(np.float64))
    new, lacks = parts_apart(key, skin, skin(key.colors), 1.0)
    np.testing.assert_allclose(new, key.colors, atol=1e-3)
    np.testing.assert_allclose(lacks, 0, atol=1e-3)
