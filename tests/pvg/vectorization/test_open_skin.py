from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

import pvg
from pvg.face import layout
from pvg.rendering import source_frame
from pvg.vectorization.open_skin import SAMPLES, skin_sample
from scripts.samples import Samples


@pytest.fixture(scope="module")
def image(samples: Samples) -> Iterator[pvg.VectorVideo]:
    with pvg.vectorize(samples.dark_portrait) as vectorized:
        yield vectorized


def test_the_sample_is_the_faces_skin(image: pvg.VectorVideo) -> None:
    """It has the cheeks' colour, not that of lips, brows, hair or background."""
    data = image.face_at(0, 0)
    assert data is not None
    rgb = source_frame(image, 0).rgb()
    sample = image.records[0].key_frames[0].skin
    assert sample.shape == (SAMPLES, 3)
    for cheek in (layout.LEFT_CHEEK, layout.RIGHT_CHEEK):
        x, y = np.rint(data.landmarks.skin_points[cheek].mean(axis=0)).astype(int)
        around = rgb[y - 4 : y + 5, x - 4 : x + 5].reshape(-1, 3).mean(axis=0)
        assert np.linalg.norm(sample - around, axis=1).min() < 20
    lips = np.rint(data.landmarks.points[layout.LIPS_OUTER].mean(axis=0)).astype(int)
    assert np.linalg.norm(sample - rgb[lips[1], lips[0]].astype(float), axis=1).min() > 3


def test_without_enough_skin_there_is_no_sample(image: pvg.VectorVideo) -> None:
    data = image.face_at(0, 0)
    assert data is not None
    rgb = source_frame(image, 0).rgb()
    nothing = np.zeros(rgb.shape[:2], np.float32)
    assert [part.shape for part in skin_sample(rgb, nothing, data.landmarks)] == [(0, 3), (0, 2)]
