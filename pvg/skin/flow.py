"""Dense optical flow between two pictures in a row, in cells: DIS (Kroeger et al. 2016), OpenCV's fastest preset."""

from __future__ import annotations

import cv2
import numpy as np

from pvg._arrays import Bytes, Floats

_LEAST = 32
"""Cells of the shorter side below which OpenCV's DIS may read beyond its coarse levels.

Measured with 5.0.0: pictures of less than 32 rows and three to five times as many columns end the process; those of
less than 12 rows and columns are refused.
"""


class FlowFinder:
    """Finds the flow between pictures of any size; keeps its scratch memory, so not for several threads at once."""

    def __init__(self) -> None:
        self._dis = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_ULTRAFAST)

    def back(self, now: Bytes, before: Bytes) -> Floats:
        """The flow (h, w, 2) float32 in cells, x and y, from each cell of `now` to where it was in `before`.

        now, before: (h, w) uint8 grey.
        """
        h, w = now.shape
        more = max(0, _LEAST - h), max(0, _LEAST - w)
        if any(more):
            now, before = (_widened(grey, more) for grey in (now, before))
        flow = self._dis.calc(now, before, np.zeros((*now.shape, 2), np.float32))
        return np.asarray(flow[:h, :w], np.float32)


def _widened(grey: Bytes, more: tuple[int, int]) -> Bytes:
    """A picture with its last row and column repeated so many times."""
    return np.asarray(cv2.copyMakeBorder(grey, 0, more[0], 0, more[1], cv2.BORDER_REPLICATE), np.uint8)
