from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pvg.looks.look import Look
from pvg.membrane.lattice import Lattice, Membrane
from pvg.rendering._planes import roll_off
from pvg.rendering.clip import _contrast_at_curves
from pvg.rendering.planes import Change, _take_out, apply_change
from pvg.video import RGB24, Frame, Patch, PixelFormat

SIDE = 48
YUV444 = PixelFormat("yuv444p", 8, (0, 0), (0.299, 0.114), True)
FORMATS = (
    PixelFormat("yuv420p", 8, (1, 1), (0.2126, 0.0722), False),
    PixelFormat("yuv422p10le", 10, (1, 0), (0.2126, 0.0722), False),
    YUV444,
    RGB24,
)


def picture(rng: np.random.Generator) -> np.ndarray:
    smooth = rng.uniform(30, 220, (6, 6, 3)).repeat(8, axis=0).repeat(8, axis=1)
    return np.asarray(np.clip(smooth + rng.normal(0, 6, smooth.shape), 0, 255))


def frame_of(rgb: np.ndarray, pixel_format: PixelFormat) -> Frame:
    return Frame(0, 0, 0.0, pixel_format, pixel_format.from_rgb(rgb))


def constant(*channels: float) -> Membrane:
    lattice = Lattice.over((0, 0, SIDE, SIDE), target_height=12)
    planes = np.array(channels, np.float32)[:, None, None] * np.ones((1, lattice.height, lattice.width), np.float32)
    return Membrane(lattice, planes)


@pytest.mark.parametrize("pixel_format", FORMATS, ids=lambda f: f.name)
def test_no_shift_and_a_lambda_of_one_change_no_bit(pixel_format: PixelFormat) -> None:
    frame = frame_of(picture(np.random.default_rng(0)), pixel_format)
    alpha = np.random.default_rng(1).random((32, 32), np.float32)
    for change in (Change(0, contrast_channel=3), Change(0)):
        patches = apply_change(frame, (8, 8), alpha, constant(0, 0, 0, 1, 1), change)
        for before, after in zip(frame.planes, frame.patched(patches).planes, strict=True):
            np.testing.assert_array_equal(before, after)


@pytest.mark.parametrize("pixel_format", FORMATS, ids=lambda f: f.name)
def test_a_shift_moves_what_the_matte_covers_and_nothing_else(pixel_format: PixelFormat) -> None:
    frame = frame_of(np.full((SIDE, SIDE, 3), 120.0), pixel_format)
    alpha = np.zeros((32, 32), np.float32)
    alpha[8:24, 8:24] = 1.0
    shift = pixel_format.opponent.matrix @ np.array([30.0, 10.0, -20.0])
    out = frame.patched(apply_change(frame, (8, 8), alpha, constant(*shift), Change(0)))
    moved = out.format.to_rgb(out.planes)[20:28, 20:28] - frame.format.to_rgb(frame.planes)[20:28, 20:28]
    np.testing.assert_allclose(moved.mean(axis=(0, 1)), [30, 10, -20], atol=1.6)
    for p, (before, after) in enumerate(zip(frame.planes, out.planes, strict=True)):
        sx, sy = pixel_format.chroma_log2 if p else (0, 0)
        changed = np.argwhere(before != after)
        assert len(changed) > 0
        assert changed.min(axis=0)[0] >= 16 >> sy
        assert changed.min(axis=0)[1] >= 16 >> sx
        assert changed.max(axis=0)[0] < 32 >> sy
        assert changed.max(axis=0)[1] < 32 >> sx


@pytest.mark.parametrize(
    "change",
    [Change(0), Change(0, contrast_channel=3), Change(0, 1.3, low_channel=5)],
    ids=["number 1", "field", "1.3"],
)
def test_a_still_in_rgb_gets_what_a_clip_in_luma_and_chroma_gets(change: Change) -> None:
    rgb = np.rint(picture(np.random.default_rng(2)))
    membrane = constant(18, -9, 6, 1.25, 0.6, 110, -5, 8)
    alpha = np.random.default_rng(3).random((32, 32), np.float32)
    outs = []
    for pixel_format in (RGB24, YUV444):
        frame = frame_of(rgb, pixel_format)
        out = frame.patched(apply_change(frame, (8, 8), alpha, membrane, change))
        outs.append(np.clip(out.format.to_rgb(out.planes), 0, 255))
    assert np.abs(outs[0] - rgb).max() > 10
    assert np.abs(outs[0] - outs[1]).mean() < 0.8
    assert np.abs(outs[0] - outs[1]).max() < 4.0  # three roundings in the one, one in the other


def test_a_second_face_adds_to_what_the_first_has_laid() -> None:
    frame = frame_of(np.full((SIDE, SIDE, 3), 100.0), YUV444)
    half = np.full((32, 32), 0.5, np.float32)
    first = apply_change(frame, (0, 0), half, constant(20, 0, 0), Change(0))
    second = apply_change(frame, (8, 8), half, constant(40, 0, 0), Change(0), under=first)
    luma = frame.patched([*first, *second]).planes[0]
    assert [int(luma[i, i]) for i in (4, 20, 36, 44)] == [110, 130, 120, 100]


def test_a_patch_may_reach_over_a_planes_edge() -> None:
    plane = np.zeros((4, 4), np.uint8)
    Patch(0, 2, 3, np.full((4, 4), 9, np.uint8)).lay_over(plane)
    assert plane.sum() == 18


@given(st.lists(st.floats(-400, 700), min_size=2, max_size=20))
def test_the_roll_off_keeps_order_and_stays_between_black_and_white(values: list[float]) -> None:
    bend = Change(0, contrast_channel=3).bend(YUV444, 0)
    ordered = sorted(values)
    rolled = [float(roll_off(np.float32(v), *bend)) for v in ordered]
    steps = np.diff(rolled)
    assert (steps >= -1e-3).all()
    assert (steps <= np.diff(ordered) + 1e-3).all()
    assert all(-0.01 <= v <= 255.01 for v in rolled)
    assert all(r == pytest.approx(v, abs=1e-3) for v, r in zip(ordered, rolled, strict=True) if 13 <= v <= 224)


def test_skin_paler_than_the_curve_beside_it_does_not_turn_blue_when_made_pale() -> None:
    """A highlight lies between the curves: paler than they are, in a face that is made pale and bright."""
    to_planes = YUV444.matrix.astype(np.float32).T
    g, new = (np.array([rgb], np.float32) @ to_planes for rgb in ((157, 106, 79), (225, 182, 163)))
    field = _contrast_at_curves(Look({}, "auto"), g, new)
    assert isinstance(field, np.ndarray)
    shift = new - field[:, [0, 1, 1]] * g
    frame = frame_of(np.full((SIDE, SIDE, 3), (200.0, 165.0, 145.0)), YUV444)
    membrane = constant(*shift[0], *field[0])
    alpha = np.ones((32, 32), np.float32)
    out = frame.patched(apply_change(frame, (8, 8), alpha, membrane, Change(0, contrast_channel=3)))
    red, green, blue = out.format.to_rgb(out.planes)[20, 20]
    assert red > green > blue
    assert out.planes[0].max() < 255


@pytest.mark.parametrize("pixel_format", [YUV444, RGB24], ids=lambda f: f.name)
def test_a_field_above_one_enlarges_shades_but_no_single_pixel_and_one_below_one_flattens_both(
    pixel_format: PixelFormat,
) -> None:
    rgb = np.full((SIDE, SIDE, 3), 100.0)
    rgb[:, 28:] = 140.0
    rgb[20, 16] = 140.0
    frame = frame_of(rgb, pixel_format)
    after = {}
    for contrast in (1.6, 0.6):
        membrane = constant((1 - contrast) * 100, 0, 0, contrast, 1)
        patches = apply_change(
            frame, (0, 0), np.ones((SIDE, SIDE), np.float32), membrane, Change(0, contrast_channel=3)
        )
        after[contrast] = frame.patched(patches).rgb()[20, [8, 16, 40], 1]
    np.testing.assert_allclose(after[1.6], [100, 140, 164], atol=2)
    np.testing.assert_allclose(after[0.6], [100, 124, 124], atol=2)


@pytest.mark.parametrize("height", [0.0, 0.3, 1.5, 12.0])
@pytest.mark.parametrize("place", [20.0, 20.27, 20.5])
def test_a_guard_weighs_as_much_as_the_opening_it_stands_for(height: float, place: float) -> None:
    """Closed lips have no area and no guard, and it grows with what opens, wherever between the pixels that is."""
    sigma, width = 3.0, 30.0
    corners = [(0, 0), (width, 0), (width, height), (0, height)]
    alpha = np.ones((60, 80), np.float32)
    _take_out(alpha, np.array(corners, np.float32) + np.float32(place), sigma)
    assert (1.0 - alpha).sum() == pytest.approx((width + 0.25) * (height + 0.25), rel=0.03, abs=2.0)
    assert alpha.min() > 0.96 - height / (2.5 * sigma)
    assert (alpha.min() < 0.05) == (height > 10)
