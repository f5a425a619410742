"""How warm the surroundings of people are told to be."""

from __future__ import annotations

import numpy as np
import pytest

import pvg
from pvg.skin import SceneReader
from pvg.warmth import MOST_WARMTH, warmth_of
from scripts.samples import Samples
from tests.gallery.faces import read_rgb

NOBODY = np.zeros((90, 160), np.uint8)


def _room(light: tuple[float, float, float]) -> np.ndarray:
    """Grey things of many shades in a light."""
    grey = np.random.default_rng(0).uniform(40, 220, (*NOBODY.shape, 1))
    return np.clip(grey * np.array(light), 0, 255).astype(np.uint8)


@pytest.mark.parametrize(
    ("light", "least", "most"),
    [
        ((1.0, 1.0, 1.0), 0, 1),
        ((1.0, 0.85, 0.6), 25, 45),
        ((1.0, 0.93, 0.8), 10, 25),
        ((1.0, 0.6, 0.05), 60, MOST_WARMTH),
        ((0.8, 0.9, 1.0), 0, 0),
        ((0.5, 1.0, 0.4), 0, 0),
        ((1.0, 0.7, 1.0), 0, 0),
    ],
    ids=["white", "a lamp", "an evening", "an orange grade", "a cloudy day", "leaves", "magenta"],
)
def test_light_is_as_warm_as_it_has_the_skins_hue(light: tuple[float, float, float], least: int, most: int) -> None:
    assert least <= warmth_of(_room(light), NOBODY) <= most


def test_people_do_not_count_and_with_them_alone_nothing_is_known() -> None:
    picture, people = _room((1.0, 1.0, 1.0)), NOBODY.copy()
    picture[:, 40:], people[:, 40:] = (200, 120, 60), 255
    assert warmth_of(picture, NOBODY) > 30
    assert warmth_of(picture, people) <= 1
    people[:, 3:] = 255
    assert warmth_of(np.full_like(picture, (200, 120, 60)), people) == 0


def test_black_and_white_say_nothing() -> None:
    for level in (0, 10, 250, 255):
        assert warmth_of(np.full((90, 160, 3), level, np.uint8), NOBODY) == 0


def test_a_vectorised_clip_knows_the_warmth_of_its_key_view(samples: Samples) -> None:
    scene = SceneReader().step(read_rgb(samples.dark_portrait))
    with pvg.vectorize(samples.dark_portrait) as video:
        assert [record.warmth for record in video.records] == [warmth_of(scene.rgb, scene.person)]
