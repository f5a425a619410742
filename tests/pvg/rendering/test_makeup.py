"""What parts of a face gain is added where they are, and nowhere else."""

from __future__ import annotations

import numpy as np
import pytest

from pvg.face import PARTS
from pvg.rendering.correction import Correction
from pvg.rendering.makeup import with_parts
from pvg.rendering.placed_face import PlacedFace

LIPS = PARTS.index("lips")
GAIN = np.array([-6.0, 2.0, 9.0])  # luma and chroma, code values


def still(placed: PlacedFace) -> Correction:
    """A correction that changes nothing."""
    lattice = placed.lattice()
    return Correction(lattice, np.zeros((3, lattice.height, lattice.width), np.float32), 1.0)


def lips_gain() -> np.ndarray:
    change = np.zeros((len(PARTS), 3))
    change[LIPS] = GAIN
    return change


def test_lips_gain_their_change_and_the_rest_of_the_face_nothing(placed: PlacedFace) -> None:
    landmarks, before = placed.data.landmarks, still(placed)
    (after,) = with_parts([before], [lips_gain()], landmarks)
    share = after.shift[2] / GAIN[2]
    assert share.max() == pytest.approx(1.0, abs=0.05)
    for plane, gain in enumerate(GAIN):
        np.testing.assert_allclose(after.shift[plane], gain * share, atol=1e-4)
    lattice = before.lattice
    rows, columns = np.nonzero(share > 0.01)
    far = np.hypot(
        lattice.x + lattice.step * columns - landmarks.eyes_and_mouth[2, 0],
        lattice.y + lattice.step * rows - landmarks.eyes_and_mouth[2, 1],
    )
    assert far.max() < 0.35 * landmarks.axes.width
    assert not before.shift.any()  # looks share what they are made from


def test_lips_that_are_not_seen_gain_nothing(placed: PlacedFace) -> None:
    one = still(placed)
    hidden = np.zeros((one.lattice.height, one.lattice.width), np.float32)
    (after,) = with_parts([one], [lips_gain()], placed.data.landmarks, hidden)
    assert not after.shift.any()


def test_a_look_without_parts_of_its_own_stays_as_it_is(placed: PlacedFace) -> None:
    one, other = still(placed), still(placed)
    first, second = with_parts([one, other], [None, lips_gain()], placed.data.landmarks)
    assert first is one or not first.shift.any()
    assert second.shift.any()
