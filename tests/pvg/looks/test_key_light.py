from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pvg.looks.key_light import in_key_light, with_lit_skin
from pvg.looks.light import light_ratio, relit
from tests.gallery.assets import key_frame

PEACH = np.array((210.0, 170.0, 145.0))


def shaded(color: np.ndarray, count: int, shades: tuple[float, float], seed: int = 0) -> np.ndarray:
    """Skin of one hue in light of many strengths, noisy as a picture is."""
    rng = np.random.default_rng(seed)
    return (rng.uniform(*shades, (count, 1)) * color + rng.normal(0, 2, (count, 3))).astype(np.float32)


def lit_of(skin: np.ndarray) -> np.ndarray:
    """The open skin of a key frame that has this skin, without what lies in deep shade."""
    key = replace(key_frame(), skin=skin, skin_at=np.zeros(len(skin), np.int16))
    return with_lit_skin(key).skin


@pytest.mark.parametrize("share", [0.3, 0.5])
def test_shade_lit_by_the_sky_is_left_out(share: float) -> None:
    count = 500
    lit = shaded(PEACH, round((1 - share) * count), (0.85, 1.0))
    sky = shaded(np.array((150.0, 125.0, 135.0)), round(share * count), (0.7, 0.95), seed=1)
    kept = in_key_light(np.concatenate([lit, sky]))
    assert abs(len(kept) - len(lit)) < 0.03 * count
    np.testing.assert_allclose(np.median(kept, axis=0), np.median(lit, axis=0), atol=2)


@pytest.mark.parametrize("richer", [1.0, 1.15], ids=["of the same hue", "richer"])
def test_shade_of_the_key_light_stays(richer: float) -> None:
    gray = PEACH.mean()
    skin = np.concatenate([shaded(PEACH, 300, (0.8, 1.0)), shaded(gray + richer * (PEACH - gray), 200, (0.3, 0.8))])
    assert in_key_light(skin) is skin


def test_a_little_cool_shade_stays_as_it_may_be_a_beard() -> None:
    skin = np.concatenate([shaded(PEACH, 450, (0.6, 1.0)), shaded(np.array((130.0, 118.0, 122.0)), 60, (0.7, 1.0))])
    assert in_key_light(skin) is skin


def test_no_skin_is_no_skin() -> None:
    assert in_key_light(np.zeros((0, 3), np.float32)).shape == (0, 3)


def test_a_face_under_a_cap_has_the_complexion_of_what_is_lit() -> None:
    lit, deep = shaded(PEACH, 150, (0.6, 1.0)), shaded(np.array((60.0, 28.0, 17.0)), 350, (0.4, 1.0), seed=1)
    kept = lit_of(np.concatenate([deep, lit]))
    assert abs(len(kept) - len(lit)) <= 5
    np.testing.assert_allclose(np.median(kept, axis=0), np.median(lit, axis=0), atol=2)


@pytest.mark.parametrize("share", [0.2, 0.4])
def test_a_face_of_which_less_than_half_is_in_deep_shade_keeps_it(share: float) -> None:
    skin = np.concatenate(
        [shaded(PEACH, round(500 * (1 - share)), (0.7, 1.0)), shaded(PEACH, round(500 * share), (0.1, 0.3))]
    )
    assert lit_of(skin) is skin


def test_deep_shade_is_left_out_little_by_little() -> None:
    lit, deep = shaded(PEACH, 245, (0.9, 1.0)), shaded(PEACH, 255, (0.2, 0.5), seed=1)
    kept = [len(lit_of(np.concatenate([lit, share * deep]).astype(np.float32))) for share in np.linspace(2, 0.6, 100)]
    assert kept[0] == 500
    assert kept[-1] < 300
    assert max(-np.diff(kept)) < 50


def test_no_skin_has_no_shade() -> None:
    assert lit_of(np.zeros((0, 3), np.float32)).shape == (0, 3)


def test_a_face_under_a_cap_gives_and_takes_light_by_its_lit_skin() -> None:
    skin = np.concatenate([shaded(PEACH, 140, (0.1, 0.2)), shaded(PEACH, 60, (0.8, 1.0), seed=1)])
    capped = with_lit_skin(replace(key_frame(), skin=skin, skin_at=np.arange(200, dtype=np.int16)))
    assert 60 <= len(capped.skin) < 70
    np.testing.assert_array_equal(capped.skin, skin[capped.skin_at])
    assert relit(capped, light_ratio(capped, key_frame(), 1.0)).skin.shape == capped.skin.shape
