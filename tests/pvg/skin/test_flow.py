"""The flow between pictures, of the shapes that OpenCV cannot bear too."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from pvg.skin.flow import FlowFinder
from tests.gallery.pictures import colorful


def _moved(shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """A grey picture (h, w) and the same one cell to the right."""
    h, w = shape
    grey = cv2.cvtColor(colorful(3, (w + 1, h)), cv2.COLOR_RGB2GRAY)
    return np.ascontiguousarray(grey[:, 1:]), np.ascontiguousarray(grey[:, :-1])


@pytest.mark.parametrize(
    "shape", [(1, 1), (1, 128), (8, 8), (11, 11), (12, 48), (15, 128), (24, 128), (31, 128), (128, 1), (128, 8)]
)
def test_pictures_of_any_shape_have_a_flow(shape: tuple[int, int]) -> None:
    before, now = _moved(shape)
    finder = FlowFinder()
    for _ in range(3):
        flow = finder.back(now, before)
        assert flow.shape == (*shape, 2)
        assert np.isfinite(flow).all()


@pytest.mark.parametrize("shape", [(24, 128), (72, 128), (128, 24)])
def test_the_flow_leads_back_to_where_things_were(shape: tuple[int, int]) -> None:
    before, now = _moved(shape)
    flow = FlowFinder().back(now, before)
    inner = flow[shape[0] // 4 : -shape[0] // 4, shape[1] // 4 : -shape[1] // 4]
    assert np.median(inner[..., 0]) == pytest.approx(-1, abs=0.3)
    assert np.median(inner[..., 1]) == pytest.approx(0, abs=0.3)
