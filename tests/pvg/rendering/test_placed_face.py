from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import pvg
from pvg.asset import FaceFrameData
from pvg.curves.labels import table_labels
from pvg.rendering.placed_face import Region, divide_overlaps, open_region

SIZE = (640, 360)


@pytest.fixture(scope="module")
def data(video: pvg.VectorVideo) -> FaceFrameData:
    found = video.face_frame(0, 20)
    assert found is not None
    return found


def moved(data: FaceFrameData, x: float, y: float = 0.0, scale: float = 1.0) -> Region:
    """The face elsewhere in the picture and of another size."""
    center = data.points.mean(axis=0)
    shift = np.array([x, y], np.float32)

    def place(points: np.ndarray) -> np.ndarray:
        return ((points - center) * scale + center + shift).astype(np.float32)

    box = place(data.box.reshape(2, 2)).ravel()
    there = replace(
        data, points=place(data.points), skin_points=place(data.skin_points), boundary=place(data.boundary), box=box
    )
    region = open_region(there, table_labels(), *SIZE)
    assert region is not None
    return region


def over_picture(region: Region) -> np.ndarray:
    whole = np.zeros(SIZE[::-1], np.float32)
    x0, y0, x1, y1 = region.window
    whole[y0:y1, x0:x1] = region.alpha
    return whole


def test_overlapping_mattes_never_add_up_to_more_than_one(data: FaceFrameData) -> None:
    before = [moved(data, -40), moved(data, 30), moved(data, 0, 20, 0.6)]
    after = divide_overlaps(before)
    assert sum(over_picture(region) for region in before).max() > 1.9
    assert sum(over_picture(region) for region in after).max() < 1.0 + 1e-5
    covered = np.maximum.reduce([over_picture(region) for region in before])
    assert (sum(over_picture(region) for region in after) >= 0.33 * covered).all()
    for one, two in zip(before, after, strict=True):
        assert (two.alpha <= one.alpha).all()
        assert (two.alpha >= 0).all()


def test_faces_apart_keep_their_mattes(data: FaceFrameData) -> None:
    before = [moved(data, -160, 0, 0.5), moved(data, 120, 0, 0.5)]
    for one, two in zip(before, divide_overlaps(before), strict=True):
        assert one is two
    assert divide_overlaps([]) == []


def test_the_middle_of_a_face_is_its_own_though_anothers_neck_or_ear_reaches_there(data: FaceFrameData) -> None:
    """Side by side and a little into each other: each keeps what lies in its own oval only."""
    one, two = moved(data, -60), moved(data, 60)
    first, second = (over_picture(region) for region in divide_overlaps([one, two]))
    for region, own, other in ((one, first, second), (two, second, first)):
        nose = np.rint(region.data.points[46]).astype(int)
        assert own[nose[1], nose[0]] > 0.9
        assert other[nose[1], nose[0]] < 0.1


def test_the_larger_face_is_the_nearer(data: FaceFrameData) -> None:
    large, small = moved(data, 0), moved(data, 15, 0, 0.5)
    first, second = (over_picture(region) for region in divide_overlaps([large, small]))
    nose = np.rint(small.data.points[46]).astype(int)
    assert first[nose[1], nose[0]] > 0.9
    assert second.sum() < 0.2 * small.alpha.sum()


def test_dividing_does_not_depend_on_the_order(data: FaceFrameData) -> None:
    one, two = moved(data, -40), moved(data, 30)
    ab, ba = divide_overlaps([one, two]), divide_overlaps([two, one])
    np.testing.assert_allclose(ab[0].alpha, ba[1].alpha, atol=1e-6)
    np.testing.assert_allclose(ab[1].alpha, ba[0].alpha, atol=1e-6)
