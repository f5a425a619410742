"""A beard stays as dark as it is where a look brightens skin, and keeps its hue."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from pvg._arrays import Bools, Doubles, Floats
from pvg.face import layout
from pvg.looks import LookMap, SkinMap
from pvg.rendering.beard import with_beard
from pvg.rendering.blocks import Blocks
from pvg.rendering.correction import Correction
from pvg.rendering.map_tables import MapTables
from pvg.rendering.placed_face import PlacedFace
from pvg.rendering.planes import apply_correction
from pvg.video import RGB24, PixelFormat
from tests.gallery.pictures import YUV444, frame_of

SKIN, HAIR = np.array([175.0, 130.0, 105.0]), np.array([80.0, 62.0, 52.0])
BRIGHT, DARK = np.array([225.0, 190.0, 175.0]), np.array([120.0, 80.0, 60.0])
ONCE = np.ones((1, 5), np.float32)
WEIGHTS = np.array([0.299, 0.587, 0.114])


@pytest.fixture(scope="module")
def placed(placed: PlacedFace) -> PlacedFace:
    """A face whose matte takes everything in its window."""
    return replace(placed, alpha=np.ones_like(placed.alpha))


def look_to(goal: Doubles, beard: float = 1.0) -> LookMap:
    light = 1 + 0.06 * np.random.default_rng(0).normal(0, 1, (400, 1))
    return LookMap(SkinMap.between((SKIN * light).astype(np.float32), goal * light, crisp=0.8), 1.0, ONCE, beard)


def below(placed: PlacedFace) -> Doubles:
    """(360, 640) how far pixels are below the face's centre, of its width."""
    return _along(placed, placed.data.landmarks.axes.down)


def aside(placed: PlacedFace) -> Doubles:
    """(360, 640) how far pixels are across from the face's centre, of its width."""
    return _along(placed, placed.data.landmarks.axes.across)


def _along(placed: PlacedFace, direction: Floats) -> Doubles:
    axes = placed.data.landmarks.axes
    y, x = np.mgrid[:360, :640]
    return np.asarray(((x - axes.center[0]) * direction[0] + (y - axes.center[1]) * direction[1]) / axes.width)


def chin(placed: PlacedFace) -> Bools:
    """(360, 640): the chin, inside the face's oval and below the lips."""
    axes = placed.data.landmarks.axes
    lips = placed.data.landmarks.points[layout.LIPS_OUTER] - axes.center
    far = below(placed) - float((lips @ axes.down).max()) / axes.width
    return np.asarray((np.abs(aside(placed)) < 0.05) & (far > 0.1) & (far < 0.15))


def drawn(
    placed: PlacedFace,
    look: LookMap,
    pixel_format: PixelFormat,
    *,
    hair: Doubles = HAIR,
    picture: Doubles | None = None,
) -> Doubles:
    """(360, 640, 3) RGB of a picture after a look, its curves asking for nothing; its lower half is hair by default."""
    if picture is None:
        picture = np.where((below(placed) > 0.0)[..., None], hair, SKIN)
    frame, lattice = frame_of(picture, pixel_format), placed.lattice()
    shift = np.zeros((3, lattice.height, lattice.width), np.float32)
    blocks = Blocks.of(frame, placed, lattice)
    (correction,) = with_beard(blocks, [Correction(lattice, shift, MapTables.of(look, pixel_format))])
    out = frame.patched(apply_correction(frame, (placed.x, placed.y), placed.alpha, correction))
    return np.asarray(out.format.to_rgb(out.planes), np.float64)


@pytest.mark.parametrize("pixel_format", [YUV444, RGB24], ids=["clip", "still"])
def test_a_beard_stays_as_dark_as_it_is_and_the_forehead_gets_bright(
    placed: PlacedFace, pixel_format: PixelFormat
) -> None:
    on = chin(placed)
    shaven, bearded = (drawn(placed, look_to(BRIGHT, beard), pixel_format) for beard in (0.0, 1.0))
    own = float(HAIR @ WEIGHTS)
    assert float(shaven[on].mean(axis=0) @ WEIGHTS) > own + 20  # the fault
    assert float(bearded[on].mean(axis=0) @ WEIGHTS) == pytest.approx(own, abs=5)
    forehead = (below(placed) < -0.3) & (below(placed) > -0.5)
    np.testing.assert_array_equal(bearded[forehead], shaven[forehead])


def test_where_a_look_darkens_skin_a_beard_goes_along_and_keeps_its_hue(placed: PlacedFace) -> None:
    on = chin(placed)
    shaven, bearded = (drawn(placed, look_to(DARK, beard), YUV444)[on].mean(axis=0) for beard in (0.0, 1.0))
    assert bearded @ WEIGHTS == pytest.approx(shaven @ WEIGHTS, abs=0.5)
    own, new = HAIR - HAIR @ WEIGHTS, bearded - bearded @ WEIGHTS
    assert np.abs(new - own).max() < 2


def test_a_look_of_the_faces_own_colours_changes_nothing(placed: PlacedFace) -> None:
    before, after = (drawn(placed, look_to(SKIN, beard), YUV444) for beard in (0.0, 1.0))
    assert np.abs(after - before).max() <= 1


def test_skin_between_the_hairs_goes_half_way(placed: PlacedFace) -> None:
    """What has three quarters of the cheek's luma, and its chroma for it, is hair and skin."""
    on, mixed = chin(placed), 0.775 * SKIN
    bare, bearded = (drawn(placed, look_to(BRIGHT, beard), YUV444, hair=mixed)[on].mean(axis=0) for beard in (0.0, 1.0))
    share = ((bare - bearded) @ WEIGHTS) / ((bare - mixed) @ WEIGHTS)
    assert share == pytest.approx(0.45, abs=0.08)  # half of the nine tenths that a beard keeps


def side_lit(placed: PlacedFace) -> tuple[Doubles, Bools, Bools]:
    """A face (360, 640, 3) in light from one side, stubble on its lit jaw: where that is, and its bare one in shade."""
    across = aside(placed)
    stubble = 0.9 * SKIN @ WEIGHTS + 0.55 * (SKIN - SKIN @ WEIGHTS)
    lit = np.clip(1.0 + 1.2 * across, 0.6, 1.4)[..., None]
    picture = lit * np.where(((below(placed) > 0.08) & (across > -0.1))[..., None], stubble, SKIN)
    jaw, bare = ((np.abs(below(placed) - 0.15) < 0.04) & (np.abs(across - at) < 0.03) for at in (0.33, -0.33))
    return picture, np.asarray(jaw), np.asarray(bare)


@pytest.mark.parametrize("pixel_format", [YUV444, RGB24], ids=["clip", "still"])
def test_stubble_in_light_is_told_by_the_cheek_above_it(placed: PlacedFace, pixel_format: PixelFormat) -> None:
    own, jaw, _ = side_lit(placed)
    assert float(own[jaw].mean(axis=0) @ WEIGHTS) > 1.1 * float(SKIN @ WEIGHTS)  # it is no darker than the skin
    shaven, bearded = (drawn(placed, look_to(BRIGHT, beard), pixel_format, picture=own)[jaw] for beard in (0.0, 1.0))
    by_f, changed = (np.abs((one - own[jaw]).mean(axis=0)).max() for one in (shaven, bearded))
    assert by_f > 30  # the fault
    assert changed < 0.3 * by_f


def test_skin_in_shade_is_no_beard_below_a_cheek_in_the_same_shade(placed: PlacedFace) -> None:
    own, _, shaded = side_lit(placed)
    assert float(own[shaded].mean(axis=0) @ WEIGHTS) < 0.7 * float(SKIN @ WEIGHTS)
    shaven, bearded = (drawn(placed, look_to(BRIGHT, beard), YUV444, picture=own)[shaded] for beard in (0.0, 1.0))
    np.testing.assert_allclose(bearded, shaven, atol=1)


def test_a_jaw_in_light_of_another_hue_is_no_beard_below_a_cheek_in_the_same_light(placed: PlacedFace) -> None:
    across = aside(placed)
    shade = np.where((below(placed) > 0.0)[..., None], 0.95, 1.0)  # a jaw is a little darker
    two_lights = shade * np.where((across > 0.05)[..., None], (100.0, 140.0, 190.0), SKIN)
    out, bare = (drawn(placed, look_to(BRIGHT, beard), YUV444, picture=two_lights) for beard in (1.0, 0.0))
    np.testing.assert_allclose(out, bare, atol=1)


def test_a_beard_under_hidden_cheeks_is_told_by_its_darkness(placed: PlacedFace) -> None:
    window = below(placed)[placed.y :, placed.x :][: placed.alpha.shape[0], : placed.alpha.shape[1]]
    hidden = replace(placed, alpha=np.ascontiguousarray((window > 0.0).astype(np.float32)))
    out = drawn(hidden, look_to(BRIGHT), YUV444)[chin(placed)].mean(axis=0)
    assert float(out @ WEIGHTS) == pytest.approx(float(HAIR @ WEIGHTS), abs=5)


def test_what_stubble_keeps_moves_with_it(placed: PlacedFace) -> None:
    light = np.array([130.0, 95.0, 76.0])  # of its hairs, in the mean nearly as bright as to be skin
    texture = 1 + 0.35 * np.random.default_rng(3).normal(0, 1, (360, 640, 1))
    lower = (below(placed) > 0.0)[..., None]

    def change(moved: int) -> Doubles:
        picture = np.where(lower, np.roll(light * texture, (moved, moved), (0, 1)), SKIN).clip(0, 255)
        off = drawn(placed, look_to(BRIGHT), YUV444, picture=picture) - np.rint(picture)
        return np.roll(cv2.GaussianBlur(off, (0, 0), 2.0), (-moved, -moved), (0, 1))

    still = change(0)[chin(placed)]
    unlike = [float(np.abs(change(moved)[chin(placed)] - still).mean()) for moved in (1, 2, 3)]
    assert max(unlike) < 1.0
