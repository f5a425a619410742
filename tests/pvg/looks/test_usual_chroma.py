from __future__ import annotations

import numpy as np
import pytest

from pvg.looks.opponent import to_opponent, to_rgb
from pvg.looks.usual_chroma import UsualChroma


@pytest.mark.parametrize("seed", range(4))
def test_no_channel_of_the_usual_chroma_is_above_white(seed: int) -> None:
    rng = np.random.default_rng(seed)
    colors = np.minimum(rng.uniform(0.5, 2.0, (300, 1)) * rng.uniform(80, 200, 3), 255.0)
    luma = np.arange(256.0)
    usual = to_rgb(np.column_stack([luma, UsualChroma.of(to_opponent(colors)).at(luma)]))
    assert usual.max() <= 255.0 + 1e-6
