"""Mean code values of a frame around the nodes of a face's lattice, or around blocks of them."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from pvg._arrays import Floats
from pvg.rendering.rgb_planes import opponent_matrix
from pvg.video import Frame


def mean_codes(frame: Frame, window: tuple[int, int, int, int], shape: tuple[int, int]) -> Floats:
    """(h, w, 3) mean codes of luma and chroma over each of h × w blocks that a window is divided into.

    window: x0, y0, x1, y1 of its pixels, x0 and y0 multiples of the chroma step.
    """
    codes = np.stack([averaged(frame.over(p, window), shape) for p in range(3)], axis=-1)
    if frame.format.is_rgb:
        codes = (codes @ opponent_matrix(frame.format).T + frame.format.opponent.offset).astype(np.float32)
    return codes


def averaged(plane: NDArray[Any], shape: tuple[int, int]) -> Floats:
    """A plane of a window averaged over each of h × w blocks, (h, w) float32."""
    apart = max(1, plane.shape[0] // (2 * shape[0]))  # two samples a block will do: means are taken over several
    few = np.ascontiguousarray(plane[::apart, ::apart])
    return np.asarray(cv2.resize(few, (shape[1], shape[0]), interpolation=cv2.INTER_AREA), np.float32)
