from __future__ import annotations

import numpy as np
import pytest

from benchmarks.quality.color import ita, lab, tone_group


@pytest.mark.parametrize(
    ("rgb", "expected"),
    [
        ((255, 255, 255), (100.0, 0.0, 0.0)),
        ((0, 0, 0), (0.0, 0.0, 0.0)),
        ((255, 0, 0), (53.24, 80.09, 67.20)),
        ((0, 0, 255), (32.30, 79.19, -107.86)),
    ],
)
def test_known_colours_have_their_lab_values(rgb: tuple[int, ...], expected: tuple[float, ...]) -> None:
    np.testing.assert_allclose(lab(rgb), expected, atol=0.03)


def test_the_skin_tone_angle_tells_light_from_dark() -> None:
    assert ita((255, 0, 0)) == pytest.approx(np.degrees(np.arctan(3.24 / 67.20)), abs=0.05)
    angles = [ita(tuple(np.array((225, 182, 160)) * gain)) for gain in (1.0, 0.85, 0.7, 0.5, 0.25)]
    assert angles == sorted(angles, reverse=True)
    assert [tone_group(angle) for angle in (56, 55, 41.5, 30, 28, 11, 9.9, -29, -30, -60)] == [
        *("very light", "light", "light", "intermediate", "tan"),
        *("tan", "brown", "brown", "dark", "dark"),
    ]
