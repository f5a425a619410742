from __future__ import annotations

import numpy as np
import pytest

from pvg.asset import FaceInFrame
from pvg.curves import table_labels
from pvg.looks.color_map import ratio_contrast
from pvg.membrane import Lattice
from pvg.rendering.correction import Correction, at_curves, extend
from pvg.rendering.placed_face import PlacedFace, place_face
from pvg.rendering.planes import apply_correction
from tests.gallery.pictures import YUV444, frame_of

SIDE = 48
TO_PLANES = YUV444.matrix.astype(np.float32).T


@pytest.fixture(scope="module")
def placed(face: FaceInFrame) -> PlacedFace:
    found = place_face(face, table_labels(), 640, 360)
    assert found is not None
    return found


def colors(seed: int) -> np.ndarray:
    rgb = np.random.default_rng(seed).uniform(40, 220, (len(table_labels()), 3)).astype(np.float32)
    return rgb @ TO_PLANES


def a_field() -> np.ndarray:
    """λ of luma and chroma at the curves."""
    return np.random.default_rng(9).uniform(0.7, 1.5, (len(table_labels()), 2)).astype(np.float32)


def test_skin_paler_than_the_curve_beside_it_does_not_turn_blue_when_made_pale() -> None:
    """A highlight lies between the curves: paler than they are, in a face that is made pale and bright."""
    g, new = (np.array([rgb], np.float32) @ TO_PLANES for rgb in ((157, 106, 79), (225, 182, 163)))
    wanted = at_curves(g, new, ratio_contrast(np.array([(157, 106, 79)]), np.array([(225.0, 182.0, 163.0)])))
    assert isinstance(wanted.contrast, np.ndarray)
    lattice = Lattice.over((0, 0, SIDE, SIDE), target_height=12)
    everywhere = np.ones((1, lattice.height, lattice.width), np.float32)
    correction = Correction(
        lattice, wanted.shift[0, :, None, None] * everywhere, wanted.contrast[0, :, None, None] * everywhere
    )
    frame = frame_of(np.full((SIDE, SIDE, 3), (200.0, 165.0, 145.0)), YUV444)
    out = frame.patched(apply_correction(frame, (8, 8), np.ones((32, 32), np.float32), correction))
    red, green, blue = out.format.to_rgb(out.planes)[20, 20]
    assert red > green > blue
    assert out.planes[0].max() < 255


@pytest.mark.parametrize("contrast", [1.0, 1.4, 0.7])
def test_the_shift_at_the_curves_is_what_the_contrast_leaves_to_the_new_colours(contrast: float) -> None:
    g, new = colors(0), colors(1)
    wanted = at_curves(g, new, contrast)
    np.testing.assert_allclose(wanted.shift + contrast * g, new, atol=1e-3)
    field = np.full((len(g), 2), contrast, np.float32)
    np.testing.assert_allclose(at_curves(g, new, field).shift, wanted.shift, atol=1e-3)


def test_a_clips_own_colours_ask_for_nothing_by_automatic_contrast() -> None:
    rgb = np.random.default_rng(0).uniform(40, 220, (30, 3)).astype(np.float32)
    np.testing.assert_array_equal(ratio_contrast(rgb, rgb.astype(np.float64)), 1)


def test_corrections_solved_together_are_those_solved_alone(placed: PlacedFace) -> None:
    g = colors(0)
    wanted = [at_curves(g, colors(k + 1), contrast) for k, contrast in enumerate((1.0, 1.3, a_field()))]
    together = extend(placed, g, wanted, level=1.0)
    for one, ours in zip(wanted, together, strict=True):
        (alone,) = extend(placed, g, [one], level=1.0)
        np.testing.assert_allclose(ours.shift, alone.shift, atol=0.2)
        np.testing.assert_allclose(ours.contrast, alone.contrast, atol=0.01)
        assert ours.contrast_number == alone.contrast_number
        assert (ours.contrast_field(0) is None) == isinstance(one.contrast, float)


def test_low_frequencies_are_solved_only_for_a_number_other_than_one(placed: PlacedFace) -> None:
    g = colors(0)
    plain, harder, auto = (
        extend(placed, g, [at_curves(g, colors(1), contrast)], level=1.0)[0] for contrast in (1.0, 1.3, a_field())
    )
    assert plain.low is None
    assert auto.low is None
    assert harder.low is not None
    assert harder.low.shape == harder.shift.shape == plain.shift.shape
