"""The matte as a raster that is sampled anywhere."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from pvg.skin import Matte


@settings(deadline=None, max_examples=30)
@given(
    hnp.arrays(np.uint8, st.tuples(st.integers(2, 9), st.integers(2, 9))),
    st.floats(1, 7),
    st.floats(-40, 40),
    st.floats(-40, 40),
)
def test_a_matte_sampled_at_its_cell_centres_is_its_raster(
    alpha: np.ndarray, step: float, x0: float, y0: float
) -> None:
    h, w = alpha.shape
    matte = Matte.over(np.array([x0, y0, x0 + w * step, y0 + h * step], np.float32), alpha, alpha > 127)
    assert matte.raster.step == pytest.approx(step, rel=1e-4)
    xs = x0 + (np.arange(w) + 0.5) * step - 0.5
    ys = y0 + (np.arange(h) + 0.5) * step - 0.5
    np.testing.assert_allclose(matte.alpha_at(xs, ys), alpha / 255, atol=2e-3)
    np.testing.assert_array_equal(matte.mask_at(xs, ys), alpha > 127)
    corner = matte.raster.to_cells(np.array([[xs[-1], ys[-1]]], np.float32))
    np.testing.assert_allclose(corner, [[w - 1, h - 1]], atol=1e-3)


def test_a_matte_is_bilinear_inside_and_nothing_outside_its_box() -> None:
    ramp = np.tile(np.arange(0, 250, 10, dtype=np.uint8), (9, 1))
    matte = Matte.over(np.array([10, 20, 10 + 25 * 2, 20 + 9 * 2], np.float32), ramp, ramp > 120)
    xs = np.linspace(12, 57, 200).astype(np.float32)
    expected = ((xs - 10 + 0.5) / 2 - 0.5) * 10 / 255
    np.testing.assert_allclose(matte.alpha_at(xs, np.array([27.0], np.float32))[0], expected, atol=1e-4)
    far = np.array([-100.0, 5.0, 70.0, 900.0], np.float32)
    assert not matte.alpha_at(far, np.array([27.0], np.float32)).any()
    assert not matte.mask_at(xs, np.array([0.0, 60.0], np.float32)).any()
