from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from pvg.looks.opponent import to_opponent, to_rgb


@given(st.integers(0, 1000))
def test_luma_and_chroma_lead_back_to_the_colour(seed: int) -> None:
    colors = np.random.default_rng(seed).uniform(0, 255, (50, 3)).astype(np.float32)
    np.testing.assert_allclose(to_rgb(to_opponent(colors)), colors, atol=1e-3)
