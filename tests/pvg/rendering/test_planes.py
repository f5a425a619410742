from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pvg.membrane import Lattice
from pvg.rendering._kernels import roll_off
from pvg.rendering.correction import Correction
from pvg.rendering.guards import Guard
from pvg.rendering.map_tables import MapTables
from pvg.rendering.plane_samples import luma_bend
from pvg.rendering.planes import apply_correction, fade_in_dark
from pvg.video import RGB24, Patch, PixelFormat
from tests.gallery.pictures import FORMATS, YUV444, frame_of, patchwork

SIDE = 48


def constant(
    *shift: float, contrast: float | MapTables = 1.0, low: tuple[float, float, float] | None = None
) -> Correction:
    """The same correction everywhere."""
    lattice = Lattice.over((0, 0, SIDE, SIDE), target_height=12)

    def planes(values: tuple[float, ...]) -> np.ndarray:
        return np.array(values, np.float32)[:, None, None] * np.ones((1, lattice.height, lattice.width), np.float32)

    return Correction(lattice, planes(shift), contrast, None if low is None else planes(low))


def tables(pixel_format: PixelFormat, slope: float = 1.0) -> MapTables:
    """A map that multiplies what luma differs from 100 by a slope, and leaves chroma."""
    offset = pixel_format.opponent.offset.astype(np.float32)
    codes = np.arange(2**pixel_format.depth, dtype=np.float32)
    gained = (slope - 1) * (codes - offset[0] - 100 * pixel_format.opponent.matrix[0].sum())
    rise_and_fall = np.float32([[slope > 1], [slope <= 1]]) * gained.astype(np.float32)
    none = np.zeros((2, len(codes)), np.float32)
    told = np.float32([[0.0], [1.0]]) + none
    return MapTables(rise_and_fall, none, 0.0, offset, none, none[0] + 1, told, none[0], none[0], 0.0, 1.0, 1.0, 1.0)


@pytest.mark.parametrize("pixel_format", FORMATS, ids=lambda f: f.name)
def test_no_shift_and_a_contrast_of_one_change_no_bit(pixel_format: PixelFormat) -> None:
    frame = frame_of(patchwork(0), pixel_format)
    alpha = np.random.default_rng(1).random((32, 32), np.float32)
    patches = apply_correction(frame, (8, 8), alpha, constant(0, 0, 0))
    for before, after in zip(frame.planes, frame.patched(patches).planes, strict=True):
        np.testing.assert_array_equal(before, after)


@pytest.mark.parametrize("pixel_format", FORMATS, ids=lambda f: f.name)
def test_a_shift_moves_what_the_matte_covers_and_nothing_else(pixel_format: PixelFormat) -> None:
    frame = frame_of(np.full((SIDE, SIDE, 3), 120.0), pixel_format)
    alpha = np.zeros((32, 32), np.float32)
    alpha[8:24, 8:24] = 1.0
    shift = pixel_format.opponent.matrix @ np.array([30.0, 10.0, -20.0])
    out = frame.patched(apply_correction(frame, (8, 8), alpha, constant(*shift)))
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


@pytest.mark.parametrize("contrast", [1.0, 1.3])
def test_a_still_in_rgb_gets_what_a_clip_in_luma_and_chroma_gets(contrast: float) -> None:
    rgb = np.rint(patchwork(2))
    correction = constant(18, -9, 6, contrast=contrast, low=None if contrast == 1.0 else (110, -5, 8))
    alpha = np.random.default_rng(3).random((32, 32), np.float32)
    outs = []
    for pixel_format in (RGB24, YUV444):
        frame = frame_of(rgb, pixel_format)
        out = frame.patched(apply_correction(frame, (8, 8), alpha, correction))
        outs.append(np.clip(out.format.to_rgb(out.planes), 0, 255))
    assert np.abs(outs[0] - rgb).max() > 10
    assert np.abs(outs[0] - outs[1]).mean() < 0.8
    assert np.abs(outs[0] - outs[1]).max() < 4.0  # three roundings in the one, one in the other


@pytest.mark.parametrize("pixel_format", [RGB24, YUV444])
def test_an_empty_matte_changes_no_bit(pixel_format: PixelFormat) -> None:
    frame = frame_of(np.rint(patchwork(2)), pixel_format)
    correction = constant(18, -9, 6, contrast=1.3, low=(110, -5, 8))
    out = frame.patched(apply_correction(frame, (8, 8), np.zeros((32, 32), np.float32), correction))
    for plane, before in zip(out.planes, frame.planes, strict=True):
        np.testing.assert_array_equal(plane, before)


def test_a_second_face_adds_to_what_the_first_has_laid() -> None:
    frame = frame_of(np.full((SIDE, SIDE, 3), 100.0), YUV444)
    half = np.full((32, 32), 0.5, np.float32)
    first = apply_correction(frame, (0, 0), half, constant(20, 0, 0))
    second = apply_correction(frame, (8, 8), half, constant(40, 0, 0), under=first)
    luma = frame.patched([*first, *second]).planes[0]
    assert [int(luma[i, i]) for i in (4, 20, 36, 44)] == [110, 130, 120, 100]


def test_a_patch_may_reach_over_a_planes_edge() -> None:
    plane = np.zeros((4, 4), np.uint8)
    Patch(0, 2, 3, np.full((4, 4), 9, np.uint8)).lay_over(plane)
    assert plane.sum() == 18


@given(st.lists(st.floats(-400, 700), min_size=2, max_size=20))
def test_the_roll_off_keeps_order_and_stays_between_black_and_white(values: list[float]) -> None:
    bend = luma_bend(YUV444)
    ordered = sorted(values)
    rolled = roll_off(np.array([ordered], np.float32), bend)[0].tolist()
    steps = np.diff(rolled)
    assert (steps >= -1e-3).all()
    assert (steps <= np.diff(ordered) + 1e-3).all()
    assert all(-0.01 <= v <= 255.01 for v in rolled)
    assert all(r == pytest.approx(v, abs=1e-3) for v, r in zip(ordered, rolled, strict=True) if 13 <= v <= 224)


@pytest.mark.parametrize("pixel_format", [YUV444, RGB24], ids=lambda f: f.name)
def test_a_slope_above_one_enlarges_shades_but_no_single_pixel_and_one_below_one_flattens_both(
    pixel_format: PixelFormat,
) -> None:
    rgb = np.full((SIDE, SIDE, 3), 100.0)
    rgb[:, 28:] = 140.0
    rgb[20, 16] = 140.0
    frame = frame_of(rgb, pixel_format)
    after = {}
    for slope in (1.6, 0.6):
        correction = constant(0, 0, 0, contrast=tables(pixel_format, slope))
        patches = apply_correction(frame, (0, 0), np.ones((SIDE, SIDE), np.float32), correction)
        after[slope] = frame.patched(patches).rgb()[20, [8, 16, 40], 1]
    np.testing.assert_allclose(after[1.6], [100, 140, 164], atol=2)
    np.testing.assert_allclose(after[0.6], [100, 124, 124], atol=2)


@pytest.mark.parametrize("pixel_format", FORMATS, ids=lambda f: f.name)
def test_what_a_guard_holds_is_dimmed_in_its_own_hue(pixel_format: PixelFormat) -> None:
    frame = frame_of(np.full((SIDE, SIDE, 3), (150, 110, 90), np.uint8), pixel_format)
    alpha, guard = np.zeros((32, 32), np.float32), Guard(8, 8, np.ones((16, 16), np.float32), np.zeros(2, np.float32))
    correction = constant(0, 0, 0, contrast=tables(pixel_format))
    for gain in (1.0, 0.6):
        drawn = frame.patched(apply_correction(frame, (8, 8), alpha, correction, guards=[(guard, gain)]))
        assert np.abs(drawn.rgb()[18:22, 18:22] - np.array((150, 110, 90)) * gain).max() <= 3
        np.testing.assert_array_equal(drawn.rgb()[:14], frame.rgb()[:14])
        if gain == 1.0:
            for before, after in zip(frame.planes, drawn.planes, strict=True):
                np.testing.assert_array_equal(before, after)


@pytest.mark.parametrize("pixel_format", FORMATS, ids=lambda f: f.name)
def test_what_a_guard_holds_is_brightened_without_more_chroma(pixel_format: PixelFormat) -> None:
    """A dark eye in warm shade is a little red; with all of its saturation it is as red as the face gets bright."""
    eye = np.array((80, 60, 56))
    frame = frame_of(np.full((SIDE, SIDE, 3), eye, np.uint8), pixel_format)
    alpha, guard = np.zeros((32, 32), np.float32), Guard(8, 8, np.ones((16, 16), np.float32), np.zeros(2, np.float32))
    correction = constant(0, 0, 0, contrast=tables(pixel_format))
    drawn = frame.patched(apply_correction(frame, (8, 8), alpha, correction, guards=[(guard, 2.0)]))
    gained = eye @ (0.299, 0.587, 0.114)  # luma of BT.601; that of BT.709 differs by half a level
    assert np.abs(drawn.rgb()[18:22, 18:22] - (eye + gained)).max() <= 3


@pytest.mark.parametrize("pixel_format", FORMATS, ids=lambda f: f.name)
def test_what_is_much_darker_than_skin_goes_through_black(pixel_format: PixelFormat) -> None:
    """Skin at 160 gets 60 levels; a pupil beside it is multiplied as the skin is, and not lifted by the same 60."""
    skin, pupil = 160.0, 30.0
    rgb = np.full((SIDE, SIDE, 3), skin)
    rgb[:, 24:] = pupil
    frame, alpha = frame_of(rgb, pixel_format), np.ones((32, 32), np.float32)
    grey = pixel_format.opponent.matrix[0].sum()
    bright = constant(60.0 * grey, 0, 0, contrast=tables(pixel_format))
    around = np.full(bright.shift.shape[1:], skin * grey, np.float32)
    drawn = replace(bright, around=around)
    fade = fade_in_dark(frame, (8, 8), alpha, [constant(0, 0, 0), drawn])
    assert fade is not None
    shown = frame.patched(apply_correction(frame, (8, 8), alpha, drawn, fade=fade)).rgb()[20].astype(float)
    lifted = frame.patched(apply_correction(frame, (8, 8), alpha, bright)).rgb()[20].astype(float)
    np.testing.assert_allclose(shown[12], lifted[12], atol=1.0)
    np.testing.assert_allclose(shown[36], pupil * (skin + 60.0) / skin, atol=3.0)
    assert lifted[36].min() > 80
    assert fade_in_dark(frame, (8, 8), alpha, [constant(0, 0, 0)]) is None
