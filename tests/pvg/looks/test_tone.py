from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

import pvg
from pvg.looks.tone import _GAIN_RANGE, SAMPLES, ComplexionMap, skin_sample
from pvg.rendering.clip import source_frame
from pvg.video import read_image
from scripts.samples import Samples

seeds = st.integers(0, 1000)


def skin_like(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return (rng.uniform(60, 200, 3) + rng.normal(0, rng.uniform(4, 20), (300, 3))).clip(0, 255).astype(np.float32)


@given(seeds)
def test_the_map_to_itself_is_the_identity(seed: int) -> None:
    skin = skin_like(seed)
    colors = np.random.default_rng(seed + 1).uniform(0, 255, (50, 3)).astype(np.float32)
    np.testing.assert_allclose(ComplexionMap.between(skin, skin.astype(float))(colors), colors, atol=1e-3)


@given(seeds, seeds)
def test_the_median_skin_arrives_at_the_median_of_the_other(one: int, two: int) -> None:
    skin, other = skin_like(one), skin_like(two).astype(float)
    mapped = ComplexionMap.between(skin, other)(np.median(skin, axis=0)[None])
    np.testing.assert_allclose(mapped[0], np.median(other, axis=0), atol=1e-3)


@given(seeds, seeds)
def test_differences_grow_by_no_more_than_the_bounded_gain(one: int, two: int) -> None:
    skin, other = skin_like(one), skin_like(two).astype(float)
    change = ComplexionMap.between(skin, other)
    near = np.median(skin, axis=0) + np.random.default_rng(one).normal(0, 1.0, (20, 3))
    steps = change(near.astype(np.float32)) - change.end
    bound = 1.01 * _GAIN_RANGE[1] * np.abs(near - change.start) * change.ratio + 1e-3
    assert (np.abs(steps) <= bound).all()


def test_the_sample_is_the_faces_skin(samples: Samples) -> None:
    """It has the cheeks' colour, not that of lips, brows, hair or background."""
    with pvg.vectorize(samples.dark_portrait) as image:
        data = image.face_frame(0, 0)
        assert data is not None
        rgb = source_frame(image, 0).rgb()
        sample = image.records[0].key_frames[0].skin
        assert sample.shape == (SAMPLES, 3)
        cheek = np.rint(data.skin_points[72:88].reshape(2, 8, 2).mean(axis=1)).astype(int)
        for x, y in cheek:
            around = rgb[y - 4 : y + 5, x - 4 : x + 5].reshape(-1, 3).mean(axis=0)
            assert np.linalg.norm(sample - around, axis=1).min() < 20
        lips = np.rint(data.points[84:96].mean(axis=0)).astype(int)
        assert np.linalg.norm(sample - rgb[lips[1], lips[0]].astype(float), axis=1).min() > 3


def test_without_enough_skin_there_is_no_sample(samples: Samples) -> None:
    with pvg.vectorize(samples.dark_portrait) as image:
        data = image.face_frame(0, 0)
        assert data is not None
        rgb = read_image(samples.dark_portrait).rgb()
        nothing = np.zeros(rgb.shape[:2], np.float32)
        assert skin_sample(rgb, nothing, data.points, data.skin_points).shape == (0, 3)
