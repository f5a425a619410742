from __future__ import annotations

import cv2
import numpy as np
import pytest

from pvg.rendering import PictureFormat, cropped, encoded, fitted
from pvg.rendering.pictures import thumbnail


def test_a_thumbnail_at_the_edge_is_square_and_not_shifted() -> None:
    picture = np.zeros((40, 60, 3), np.uint8)
    picture[:, :10] = 200
    small = thumbnail(picture, (-10, 0, 40, 40), 40)
    assert small.shape == (40, 40, 3)
    assert (small[:, :19] == 200).all()
    assert (small[:, 21:] == 0).all()


def test_crops_and_sizes() -> None:
    picture = np.arange(40 * 60 * 3, dtype=np.uint8).reshape(40, 60, 3)
    np.testing.assert_array_equal(cropped(picture, (50, 30, 100, 100)), picture[30:, 50:])
    with pytest.raises(ValueError, match="outside"):
        cropped(picture, (60, 0, 5, 5))
    assert fitted(picture, 30).shape == (20, 30, 3)
    assert fitted(picture, 600, 600) is picture
    assert fitted(picture, 600, 10).shape == (10, 15, 3)


@pytest.mark.parametrize("encoding", ["jpeg", "png"])
def test_colours_survive_the_encoding(encoding: PictureFormat) -> None:
    picture = np.zeros((32, 32, 3), np.uint8)
    picture[:] = (200, 120, 90)
    data = encoded(picture, encoding)
    back = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
    assert np.abs(back.astype(int) - picture).max() <= (3 if encoding == "jpeg" else 0)
