"""Ears and neck keep their light beside the face."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from pvg.looks import LookMap, SkinMap
from pvg.raster import SUBPIXEL_BITS, fixed_point
from pvg.rendering.beside import BesideTables, with_beside
from pvg.rendering.blocks import Blocks
from pvg.rendering.correction import Correction
from pvg.rendering.map_tables import MapTables
from pvg.rendering.placed_face import PlacedFace
from pvg.rendering.planes import apply_correction
from pvg.video import RGB24, PixelFormat
from tests.gallery.pictures import YUV444, frame_of

FACE, SHADE = np.array([175.0, 130.0, 105.0]), 0.75
ONCE = np.ones((1, 5), np.float32)


@pytest.fixture(scope="module")
def placed(placed: PlacedFace) -> PlacedFace:
    """A face whose matte takes the whole picture."""
    return replace(placed, x=0, y=0, alpha=np.ones((360, 640), np.float32))


def brighter(contrast: float) -> LookMap:
    """A look that makes a flatly lit face bright and contrasty."""
    light = np.random.default_rng(0).normal(0, 1, (400, 1))
    own, goal = (FACE * (1 + 0.06 * light)), np.array([215.0, 180.0, 160.0]) * (1 + 0.06 * contrast * light)
    return LookMap(SkinMap.between(own.astype(np.float32), goal), 1.0, ONCE)


def crimson(placed: PlacedFace, goal: tuple[float, float, float]) -> float:
    """How much of the redness of ears beside a face, against it, is left by a look from FACE to a goal."""
    light = 1 + 0.06 * np.random.default_rng(0).normal(0, 1, (400, 1))
    look = LookMap(SkinMap.between((FACE * light).astype(np.float32), np.array(goal) * light), 1.0, ONCE)
    ears = ~inside(placed, 0.02)
    frame = frame_of(np.where(ears[..., None], FACE + np.array([25.0, -10.0, 0.0]), FACE), YUV444)
    face, neck, at_ears = (MapTables.of(look, YUV444, region=region) for region in ("face", "beside", "ears"))
    lattice = placed.lattice()
    shift = np.zeros((3, lattice.height, lattice.width), np.float32)
    (correction,) = with_beside(
        Blocks.of(frame, placed, lattice), [Correction(lattice, shift, face)], [BesideTables(neck, at_ears)]
    )
    out = frame.patched(apply_correction(frame, (placed.x, placed.y), placed.alpha, correction))
    far, near = ~inside(placed, 0.15) & inside(placed, 0.25), inside(placed, -0.05)
    before, after = (
        (rgb[..., 0] - rgb @ np.array([0.299, 0.587, 0.114]))
        for rgb in (one.rgb().astype(float) for one in (frame, out))
    )
    return float((after[far].mean() - after[near].mean()) / (before[far].mean() - before[near].mean()))


def test_ears_redder_than_the_face_come_near_to_it_when_it_is_moved_and_stay_when_not(placed: PlacedFace) -> None:
    assert crimson(placed, tuple(FACE)) > 0.95
    assert crimson(placed, (200.0, 170.0, 150.0)) < 0.36


def inside(placed: PlacedFace, grown: float) -> np.ndarray:
    """(360, 640) bool: the face's oval, or further inside or outside by a share of its width."""
    oval = np.zeros((360, 640), np.uint8)
    cv2.fillPoly(oval, [fixed_point(placed.data.landmarks.oval)], 1, shift=SUBPIXEL_BITS)
    far = cv2.distanceTransform(1 - oval, cv2.DIST_L2, 5) - cv2.distanceTransform(oval, cv2.DIST_L2, 5)
    return np.asarray(far <= grown * placed.data.landmarks.axes.width)


def drawn(
    placed: PlacedFace,
    look: LookMap,
    pixel_format: PixelFormat,
    *,
    beside: bool,
    asked: float = 0.0,
    shade: float = SHADE,
    height: tuple[float, float] = (-2.0, 2.0),
) -> tuple[float, float]:
    """Mean luma of a face and of the shaded skin beside it, after a look.

    asked: levels of luma that the membrane adds everywhere;  shade: of the skin beside the face;  height: from where to
    where it is looked at, of the face's width below its centre.
    """
    within = inside(placed, 0.0)
    picture = np.where(within[..., None], FACE, shade * FACE)
    frame = frame_of(picture, pixel_format)
    face, neck, ears = (MapTables.of(look, pixel_format, region=region) for region in ("face", "beside", "ears"))
    lattice = placed.lattice()
    shift = np.zeros((3, lattice.height, lattice.width), np.float32)
    shift[0] = asked
    (correction,) = with_beside(
        Blocks.of(frame, placed, lattice),
        [Correction(lattice, shift, face)],
        [BesideTables(neck, ears) if beside else None],
    )
    out = frame.patched(apply_correction(frame, (placed.x, placed.y), placed.alpha, correction))
    luma = out.format.to_rgb(out.planes) @ np.array([0.299, 0.587, 0.114])
    x0, y0, x1, y1 = placed.window
    window = np.zeros_like(within)
    window[y0:y1, x0:x1] = True
    axes = placed.data.landmarks.axes
    y, x = np.mgrid[:360, :640]
    below = ((x - axes.center[0]) * axes.down[0] + (y - axes.center[1]) * axes.down[1]) / axes.width
    window &= (below > height[0]) & (below < height[1])
    return float(luma[inside(placed, -0.1)].mean()), float(luma[window & ~inside(placed, 0.15)].mean())


@pytest.mark.parametrize("pixel_format", [YUV444, RGB24], ids=["clip", "still"])
def test_skin_in_the_faces_shade_stays_as_far_below_the_face(placed: PlacedFace, pixel_format: PixelFormat) -> None:
    look = brighter(contrast=2.0)
    below = float((1 - SHADE) * FACE @ np.array([0.299, 0.587, 0.114]))
    face, shade = drawn(placed, look, pixel_format, beside=False)
    assert face - shade > 1.35 * below  # the fault
    same, kept = drawn(placed, look, pixel_format, beside=True)
    assert same == pytest.approx(face, abs=0.5)
    assert same - kept == pytest.approx(below, rel=0.15)


def test_an_ear_in_deep_shade_gets_as_much_brighter_as_the_face_and_a_neck_does_not(placed: PlacedFace) -> None:
    look, dark = brighter(contrast=1.0), 0.4
    before = dark * float(FACE @ np.array([0.299, 0.587, 0.114]))
    face, ears = drawn(placed, look, YUV444, beside=True, shade=dark, height=(-0.4, 0.0))
    _, neck = drawn(placed, look, YUV444, beside=True, shade=dark, height=(0.3, 2.0))
    gained = face - float(FACE @ np.array([0.299, 0.587, 0.114]))
    assert ears - before == pytest.approx(gained, rel=0.15)
    assert neck - before < 0.75 * gained


def test_a_skins_own_map_changes_nothing_beside_it_either(placed: PlacedFace) -> None:
    skin = (FACE * (1 + 0.06 * np.random.default_rng(0).normal(0, 1, (400, 1)))).astype(np.float32)
    own = LookMap(SkinMap.between(skin, skin.astype(float)), 1.0, ONCE)
    face, shade = drawn(placed, own, YUV444, beside=True)
    assert (face, shade) == pytest.approx(drawn(placed, own, YUV444, beside=False), abs=1e-3)


@pytest.mark.parametrize("asked", [-20.0, 20.0])
def test_what_the_curves_ask_for_ends_with_the_face(placed: PlacedFace, asked: float) -> None:
    """Light that falls on a chin would make a neck brighter than the chest below it."""
    face, shade = drawn(placed, brighter(contrast=1.0), YUV444, beside=True)
    lit, same = drawn(placed, brighter(contrast=1.0), YUV444, beside=True, asked=asked)
    assert lit - face == pytest.approx(asked, rel=0.25)
    assert same == pytest.approx(shade, abs=0.3)


def test_what_is_kept_for_the_face_ends_as_far_from_its_oval_on_all_sides(placed: PlacedFace) -> None:
    lattice = placed.lattice()
    lattice = replace(lattice, width=3 * (lattice.width // 3) + 1)  # blocks of three nodes do not go into it
    look, pixel_format = brighter(contrast=2.0), YUV444
    frame = frame_of(np.broadcast_to(FACE, (360, 640, 3)), pixel_format)
    tables = MapTables.of(look, pixel_format, region="face")
    shift = np.ones((3, lattice.height, lattice.width), np.float32)
    (correction,) = with_beside(
        Blocks.of(frame, placed, lattice), [Correction(lattice, shift, tables)], [BesideTables(tables, tables)]
    )
    kept = correction.shift[0]
    rows, columns = np.nonzero((kept > 0.3) & (kept < 0.7))
    points = np.stack([lattice.x + lattice.step * columns, lattice.y + lattice.step * rows], axis=1).astype(np.float32)
    oval = placed.data.landmarks.oval.astype(np.float32)
    outside = np.array([-cv2.pointPolygonTest(oval, point.tolist(), True) for point in points]) / lattice.step
    middle = oval.mean(axis=0)
    aside = [outside[side].mean() for side in (points[:, 0] < middle[0], points[:, 0] > middle[0])]
    assert aside[0] == pytest.approx(aside[1], abs=1.0)
