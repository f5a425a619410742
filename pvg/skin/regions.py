"""Connected parts of masks."""

from __future__ import annotations

import cv2
import numpy as np

from pvg.skin.zones import Bools


def biggest_part(mask: Bools, near: Bools | None = None) -> Bools:
    """The largest 4-connected part of `mask` (h, w), of those that touch `near` (h, w) when any does."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=4)
    if count <= 1:
        return mask
    areas = stats[:, cv2.CC_STAT_AREA].astype(np.int64)
    areas[0] = 0
    if near is not None:
        touched = np.bincount(labels[near], minlength=count) > 0
        if touched[1:].any():
            areas[~touched] = 0
    part: Bools = labels == int(np.argmax(areas))
    return part


def fill_holes(mask: Bools) -> Bools:
    """`mask` (h, w) with every enclosed hole filled."""
    # a frame of background joins all that reaches the edge
    outside = np.pad(~mask, 1, constant_values=True).astype(np.uint8)
    _, labels = cv2.connectedComponents(outside, connectivity=4)
    filled: Bools = (labels != labels[0, 0])[1:-1, 1:-1]
    return filled
