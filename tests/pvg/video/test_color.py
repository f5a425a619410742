"""The colour spaces of sources: published points, inverses, and the tables that pictures are converted by."""

from __future__ import annotations

import numpy as np
import pytest

from pvg.errors import MediaError
from pvg.video import INPUT_COLORS, ColorSpace, PixelFormat, color_space, named_space

NAMED = [name for name in INPUT_COLORS if name not in ("auto", "sdr")]
TAGGED = [(9, 16), (9, 18), (9, 14), (12, 1), (12, 13), (1, 8), (1, 16)]
SPACES = [named_space(name) for name in NAMED] + [color_space(*tags) for tags in TAGGED]


def ids(space: ColorSpace | None) -> str:
    return "none" if space is None else space.name


def colors() -> np.ndarray:
    return np.random.default_rng(3).uniform(4, 250, (400, 3))


@pytest.mark.parametrize("space", SPACES, ids=ids)
def test_sdr_colors_come_back(space: ColorSpace) -> None:
    np.testing.assert_allclose(space.to_sdr(space.from_sdr(colors())), colors(), atol=0.05)


@pytest.mark.parametrize("space", SPACES, ids=ids)
def test_grey_stays_grey_and_rises(space: ColorSpace) -> None:
    grey = np.repeat(np.linspace(0, 255, 64)[:, None], 3, axis=1)
    own = space.from_sdr(grey)
    np.testing.assert_allclose(own, own[:, :1].repeat(3, axis=1), atol=0.05)
    assert (np.diff(own[:, 0]) > 0).all()


@pytest.mark.parametrize(
    ("space", "signal", "light"),
    [
        # BT.2408 table 1: SDR white, 203 cd/m², is 58 % of PQ and 75 % of HLG
        (color_space(9, 16), 0.58, 1.0),
        (color_space(9, 18), 0.75, 1.0),
        # their makers' 18 % grey, 10-bit codes of the studio range: S-Log3 420, V-Log 433; LogC 39.1 %, LogC4 27.8 %
        (named_space("slog3"), (420 - 64) / 876, 0.18),
        (named_space("vlog"), (433 - 64) / 876, 0.18),
        (named_space("logc3"), 0.391, 0.18),
        (named_space("logc4"), 0.2784, 0.18),
        (named_space("applelog"), 0.4883, 0.18),
    ],
    ids=lambda value: value.name if isinstance(value, ColorSpace) else None,
)
def test_published_points(space: ColorSpace, signal: float, light: float) -> None:
    shown = space.to_sdr(np.full((1, 3), 255.0 * signal))[0, 0] / 255.0
    assert shown == pytest.approx(float(space.display.encode(np.array([light]))[0]), abs=0.006)


def test_what_an_sdr_display_shows_as_it_is_has_no_space() -> None:
    for primaries in (1, 2, 5, 6):
        for transfer in (1, 2, 6, 13):
            assert color_space(primaries, transfer) is None
    assert named_space("sdr") is None


def test_hdr_without_primaries_is_bt2020() -> None:
    assert color_space(2, 16) is color_space(9, 16)


def test_primaries_move_the_corners_of_the_gamut() -> None:
    # P3's red is outside BT.709: more than all red, less than no green
    red = color_space(12, 13).to_sdr(np.array([[255.0, 0.0, 0.0]]))[0]
    assert red[0] > 270
    assert red[1] == 0
    # one of CIE XYZ: BT.709 red in BT.2020 light is (0.6274, 0.0691, 0.0164) [BT.2087]
    own = color_space(9, 14).from_sdr(np.array([[255.0, 0.0, 0.0]]))[0] / 255.0
    np.testing.assert_allclose(own**2.4, (0.6274, 0.0691, 0.0164), atol=2e-4)


@pytest.mark.parametrize("tags", [(10, 1), (1, 17), (1, 9), (77, 1)])
def test_unknown_code_points_are_refused(tags: tuple[int, int]) -> None:
    with pytest.raises(MediaError, match="ISO/IEC 23091-2"):
        color_space(*tags)


def test_unknown_names_are_refused() -> None:
    with pytest.raises(ValueError, match="is not one of auto, sdr, pq"):
        named_space("slog2")


@pytest.mark.parametrize("space", SPACES, ids=ids)
@pytest.mark.parametrize("depth", [10, 12])
def test_pictures_are_converted_as_colors_are(space: ColorSpace, depth: int) -> None:
    pixel_format = PixelFormat(f"yuv444p{depth}le", depth, (0, 0), (0.2627, 0.0593), False, space)
    wanted = np.random.default_rng(5).uniform(20, 235, (24, 32, 3))
    planes = pixel_format.from_rgb(space.from_sdr(wanted.reshape(-1, 3)).reshape(wanted.shape))
    shown = pixel_format.fast_rgb(planes).astype(float)
    # a code step of the shadows is some levels wide in 10 bits
    assert np.quantile(np.abs(shown - wanted), 0.99) < (4.0 if depth == 10 else 2.0)
    assert abs((shown - wanted).mean()) < 0.3


@pytest.mark.parametrize("space", SPACES, ids=ids)
def test_the_slope_is_that_of_grey(space: ColorSpace) -> None:
    luma = np.array([40.0, 120.0, 200.0])
    grey = luma[:, None].repeat(3, axis=1)
    finite = (space.from_sdr(grey + 0.5) - space.from_sdr(grey - 0.5))[:, 1]
    np.testing.assert_allclose(space.slope(luma), finite, rtol=0.02)
