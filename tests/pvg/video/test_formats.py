from __future__ import annotations

import av
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pvg.errors import MediaError
from pvg.video import (
    RGB24,
    Frame,
    PixelFormat,
)
from pvg.video.formats import is_high_definition, resolve_format
from tests.gallery.clips import (
    SIZE,
    noise_planes,
    pixel_format,
)
from tests.gallery.pictures import colorful

FORMATS = [
    resolve_format(f"yuv{chroma}p{depth}", *SIZE, matrix, color_range)
    for chroma in ("420", "422", "444")
    for depth in ("", "10le", "12le")
    for matrix, color_range in ((1, 1), (6, 2), (9, 1))
]


@pytest.mark.parametrize(
    ("name", "matrix", "color_range", "rgb", "codes"),
    [  # published code values of colour bars
        ("yuv420p", 6, 1, (255, 0, 0), (81, 90, 240)),
        ("yuv420p", 6, 1, (0, 255, 0), (145, 54, 34)),
        ("yuv420p", 1, 1, (255, 0, 0), (63, 102, 240)),
        ("yuv420p", 1, 1, (0, 0, 255), (32, 240, 118)),
        ("yuv420p", 1, 1, (255, 255, 255), (235, 128, 128)),
        ("yuv420p", 6, 2, (255, 255, 255), (255, 128, 128)),
        ("yuv420p10le", 1, 1, (255, 0, 0), (250, 409, 960)),
        ("yuv420p10le", 9, 1, (0, 0, 0), (64, 512, 512)),
        ("yuv444p12le", 9, 1, (255, 255, 255), (3760, 2048, 2048)),
    ],
)
def test_primaries_have_the_published_code_values(
    name: str, matrix: int, color_range: int, rgb: tuple[int, int, int], codes: tuple[int, int, int]
) -> None:
    fmt = pixel_format(name, matrix, color_range)
    planes = fmt.from_rgb(np.broadcast_to(np.array(rgb), (4, 6, 3)))
    assert tuple(int(plane[0, 0]) for plane in planes) == codes
    np.testing.assert_allclose(fmt.matrix @ rgb + fmt.offset, codes, atol=0.51)


@settings(deadline=None, max_examples=40)
@given(fmt=st.sampled_from(FORMATS), color=st.tuples(*[st.integers(0, 255)] * 3), odd=st.booleans())
def test_a_flat_colour_survives_the_planes(fmt: PixelFormat, color: tuple[int, int, int], odd: bool) -> None:
    shape = (5, 7, 3) if odd else (4, 6, 3)
    back = fmt.to_rgb(fmt.from_rgb(np.broadcast_to(np.array(color, dtype=float), shape)))
    # half a code value a plane, through the inverse matrix
    worst = np.abs(np.linalg.inv(fmt.matrix)).sum(axis=1).max() * 0.5
    assert back.shape == shape
    assert np.abs(back - color).max() <= worst + 1e-9


@settings(deadline=None, max_examples=40)
@given(fmt=st.sampled_from([*FORMATS, RGB24]), seed=st.integers(0, 99), size=st.sampled_from([(24, 16), (13, 9)]))
def test_fast_rgb_is_the_exact_rgb_within_two_levels(fmt: PixelFormat, seed: int, size: tuple[int, int]) -> None:
    planes = noise_planes(fmt, seed, size)
    exact = np.clip(fmt.to_rgb(planes), 0, 255)
    fast = Frame(0, 0, 0.0, fmt, planes).rgb()
    assert fast.dtype == np.uint8
    # chroma is rounded after it is raised: half a code value, times at most 2.14, and half a level; the rest of 2.25
    # is the single precision it is raised in
    assert np.abs(fast - exact).max() <= (2.0 if fmt.depth == 8 else 0.5 + 0.5 * 2.25 / 2 ** (fmt.depth - 8))


def test_rgb_agrees_with_swscale_in_every_matrix_and_range() -> None:
    for matrix, color_range in ((1, 1), (1, 2), (6, 1), (6, 2)):
        fmt = pixel_format("yuv444p", matrix, color_range)
        frame = Frame(0, 0, 0.0, fmt, fmt.from_rgb(colorful(3)))
        raw = av.VideoFrame(*SIZE, "yuv444p")
        for target, plane in zip(raw.planes, frame.planes, strict=True):
            target.update(np.pad(plane, ((0, 0), (0, target.line_size - plane.shape[1]))).tobytes())
        scaled = raw.reformat(
            format="rgb24", src_colorspace=matrix, src_color_range=color_range, dst_color_range=2, interpolation=0x42010
        ).to_ndarray()
        # swscale's 8-bit tables are off by a level here and there; a wrong matrix or range is off by several
        assert np.abs(frame.rgb().astype(int) - scaled).mean() < 0.7


def test_untagged_colours_follow_the_size_whatever_the_rotation() -> None:
    for size, expected in (((640, 480), (0.299, 0.114)), ((1280, 720), (0.2126, 0.0722))):
        assert resolve_format("yuv420p", *size, 2, 0).luma_weights == expected
        assert is_high_definition(*size) == is_high_definition(*size[::-1])
    assert not resolve_format("yuv420p", 640, 480, 2, 0).full_range
    assert resolve_format("yuvj420p", 640, 480, 2, 0).full_range


@pytest.mark.parametrize("matrix", [10, 13, 14])  # two of constant luminance, ICtCp
def test_a_matrix_that_is_not_linear_ycbcr_is_refused(matrix: int) -> None:
    with pytest.raises(MediaError, match=f"matrix {matrix}"):
        resolve_format("yuv420p", 64, 64, matrix, 1)


@pytest.mark.parametrize(("log2", "step"), [((1, 1), 2), ((1, 0), 2), ((0, 0), 1)])
def test_a_plane_over_a_window_has_the_samples_of_its_pixels(log2: tuple[int, int], step: int) -> None:
    form = PixelFormat("any", 8, log2, (0.2126, 0.0722), False)
    shapes = form.plane_shapes(13, 9)
    first, second, third = (np.arange(h * w, dtype=np.uint8).reshape(h, w) for h, w in shapes)
    frame = Frame(0, 0, 0.0, form, (first, second, third))
    assert form.chroma_step == step
    np.testing.assert_array_equal(frame.over(0, (4, 2, 7, 9)), first[2:9, 4:7])
    x, y = log2
    np.testing.assert_array_equal(frame.over(2, (4, 2, 7, 9)), third[2 >> y : -(-9 >> y), 4 >> x : -(-7 >> x)])
    np.testing.assert_array_equal(frame.over(1, (0, 0, 20, 20)), second)
