from __future__ import annotations

import numpy as np
import pytest

from pvg.asset import FaceInFrame
from pvg.curves import table_labels
from pvg.looks import Look
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


def test_skin_paler_than_the_curve_beside_it_does_not_turn_blue_when_made_pale() -> None:
    """A highlight lies between the curves: paler than they are, in a face that is made pale and bright."""
    g, new = (np.array([rgb], np.float32) @ TO_PLANES for rgb in ((157, 106, 79), (225, 182, 163)))
    wanted = at_curves(Look({}, "auto"), g, new)
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


@pytest.mark.parametrize(("contrast", "strength", "expected"), [(1.0, 1.0, 1.0), (1.4, 1.0, 1.4), (1.4, 0.5, 1.2)])
def test_a_number_as_contrast_is_taken_with_the_looks_strength(
    contrast: float, strength: float, expected: float
) -> None:
    g, new = colors(0), colors(1)
    wanted = at_curves(Look({}, contrast, strength), g, new)
    assert wanted.contrast == pytest.approx(expected)
    np.testing.assert_allclose(wanted.shift, new - expected * g, atol=1e-3)


def test_a_clips_own_colours_ask_for_nothing_by_automatic_contrast() -> None:
    wanted = at_curves(Look({}, "auto"), colors(0), colors(0))
    np.testing.assert_array_equal(wanted.shift, 0)
    np.testing.assert_array_equal(wanted.contrast, 1)


def test_corrections_solved_together_are_those_solved_alone(placed: PlacedFace) -> None:
    g = colors(0)
    looks = [Look({}, contrast) for contrast in (1.0, 1.3, "auto")]
    wanted = [at_curves(look, g, colors(k + 1)) for k, look in enumerate(looks)]
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
        extend(placed, g, [at_curves(Look({}, contrast), g, colors(1))], level=1.0)[0]
        for contrast in (1.0, 1.3, "auto")
    )
    assert plain.low is None
    assert auto.low is None
    assert harder.low is not None
    assert harder.low.shape == harder.shift.shape == plain.shift.shape
