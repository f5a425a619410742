from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pvg.picture import RgbPicture, clipped, common, cut_out, slices_of
from pvg.raster import Raster
from pvg.video import RGB24, PixelFormat, PlanePicture, picture_of
from tests.gallery.pictures import FORMATS, YUV420, frame_of, waves


def planes(pixel_format: PixelFormat, height: int = 121, width: int = 150) -> tuple[PlanePicture, RgbPicture]:
    frame = frame_of(waves(height, width), pixel_format)
    return picture_of(frame), RgbPicture(frame.rgb())


def apart(a: np.ndarray, b: np.ndarray) -> int:
    assert a.shape == b.shape
    return int(np.abs(a.astype(int) - b).max())


@pytest.mark.parametrize("pixel_format", FORMATS, ids=lambda f: f.name)
def test_planes_show_what_their_rgb_shows(pixel_format: PixelFormat) -> None:
    coded, rgb = planes(pixel_format)
    assert coded.size == rgb.size == (121, 150)
    assert apart(coded.rgb(), rgb.rgb()) == 0
    cos, sin = 1.3 * np.cos(0.2), 1.3 * np.sin(0.2)
    turned = np.array([[cos, -sin, 20.0], [sin, cos, -10.0]])
    assert apart(coded.warp(turned, (90, 80)), rgb.warp(turned, (90, 80))) <= 3
    for step in (1.0, 2.4, 7.3):
        raster = Raster(np.array([-5.3, 8.7], np.float32), step, (40, 30))
        assert apart(coded.cells(raster), rgb.cells(raster)) <= 3
    assert apart(coded.thumbnail((16, 9)), rgb.thumbnail((16, 9))) <= 12  # from different pixels
    small, factor = coded.reduced(2.5)
    assert factor == 2
    assert apart(small.rgb(), rgb.reduced(2.5)[0].rgb()[: small.size[0], : small.size[1]]) <= 6  # at the edges


@pytest.mark.parametrize("pixel_format", FORMATS, ids=lambda f: f.name)
def test_a_part_answers_in_the_wholes_coordinates(pixel_format: PixelFormat) -> None:
    coded, _ = planes(pixel_format)
    part = coded.part((31, 27, 111, 99))
    x0, y0, x1, y1 = part.box
    assert (x0 <= 31, y0 <= 27, x1 >= 111, y1 >= 99) == (True,) * 4
    assert part.size == coded.size
    raster = Raster(np.array([40.4, 35.2], np.float32), 2.3, (20, 25))
    np.testing.assert_array_equal(part.cells(raster), coded.cells(raster))
    straight = np.array([[1.0, 0, 40], [0, 1.0, 40]])
    np.testing.assert_array_equal(part.warp(straight, (50, 50)), coded.warp(straight, (50, 50)))
    inner = part.rgb()[27 - y0 : 99 - y0, 31 - x0 : 111 - x0]
    np.testing.assert_array_equal(inner, coded.rgb()[27:99, 31:111])


def test_a_part_is_a_copy() -> None:
    coded, _ = planes(YUV420)
    part = coded.part((0, 0, 40, 40))
    before = part.rgb().copy()
    for plane in coded.planes:
        plane[:] = 0
    np.testing.assert_array_equal(part.rgb(), before)


def test_cells_are_means_of_the_pixels_they_cover() -> None:
    coded, _ = planes(RGB24)
    pixels = coded.rgb().astype(float)
    means = pixels[:120, :148].reshape(30, 4, 37, 4, 3).mean(axis=(1, 3))
    assert np.abs(coded.cells(Raster(np.zeros(2, np.float32), 4.0, (30, 37))) - means).max() <= 0.51


def test_beyond_the_picture_its_edge_is_repeated() -> None:
    coded, rgb = planes(YUV420)
    for picture in (coded, rgb):
        far = picture.cells(Raster(np.array([-300.0, 40.0], np.float32), 2.0, (10, 10)))
        assert (far == far[:, :1]).all()
        part = picture.part((400, 400, 500, 500))
        assert part.box[2] <= 150
        assert part.box[3] <= 121
        assert part.rgb().size > 0


@settings(max_examples=50, deadline=None)
@given(box=st.tuples(*[st.integers(-50, 250)] * 4))
def test_a_clipped_box_is_never_empty_and_lies_within(box: tuple[int, int, int, int]) -> None:
    x0, y0, x1, y1 = clipped(box, (10, 20, 110, 90))
    assert 10 <= x0 < x1 <= 110
    assert 20 <= y0 < y1 <= 90


@pytest.mark.parametrize("box", [(30.7, 40.2, 60.1, 55.9), (-9.5, -4.0, 20.0, 30.0), (130.0, 100.0, 190.0, 150.0)])
def test_what_is_cut_out_lies_where_it_says_and_holds_what_of_the_box_is_in_the_picture(
    box: tuple[float, float, float, float],
) -> None:
    _, picture = planes(YUV420)
    rgb, corner = cut_out(picture, np.array(box, np.float32))
    x, y = (int(v) for v in corner)
    np.testing.assert_array_equal(rgb, picture.rgb()[y : y + rgb.shape[0], x : x + rgb.shape[1]])
    assert x <= max(box[0], 0)
    assert y <= max(box[1], 0)
    assert x + rgb.shape[1] >= min(box[2] + 1, 150)
    assert y + rgb.shape[0] >= min(box[3] + 1, 121)


BOXES = st.tuples(*[st.integers(-4, 8)] * 2, *[st.integers(1, 9)] * 2).map(
    lambda drawn: (drawn[0], drawn[1], drawn[0] + drawn[2], drawn[1] + drawn[3])
)


@given(BOXES, BOXES)
def test_the_common_part_of_two_boxes_is_what_both_cover(one: tuple[int, ...], other: tuple[int, ...]) -> None:
    corner, covered = (-4, -4), np.zeros((24, 24), np.uint8)
    for x0, y0, x1, y1 in (one, other):
        covered[slices_of((x0, y0, x1, y1), corner)] += 1
    shared = common((one[0], one[1], one[2], one[3]), (other[0], other[1], other[2], other[3]))
    if shared is None:
        assert covered.max() < 2
    else:
        assert (covered[slices_of(shared, corner)] == 2).all()
        assert (covered == 2).sum() == (shared[2] - shared[0]) * (shared[3] - shared[1])
