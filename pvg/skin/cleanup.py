"""Connected parts of masks."""

from __future__ import annotations

import cv2
import numpy as np

from pvg._arrays import Bools, Bytes, Floats
from pvg.skin.prior import Places


def biggest_part(mask: Bools, near: Bools | None = None) -> Bools:
    """The largest 4-connected part of `mask` (h, w), of those that touch `near` (h, w) when any does."""
    touching = None if near is None else near & mask
    if touching is not None and touching.any():  # nearly always all of it lies in one part
        about = _part_at(mask, int(np.argmax(touching)))
        if about[touching].all():
            return about
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


def _part_at(mask: Bools, cell: int) -> Bools:
    """The 4-connected part of `mask` (h, w) about one of its cells, counted row by row: a third of labelling all."""
    marks = mask.astype(np.uint8)
    y, x = divmod(cell, mask.shape[1])
    cv2.floodFill(marks, None, (x, y), (2,))
    part: Bools = marks == 2
    return part


def fill_holes(mask: Bools) -> Bools:
    """`mask` (h, w) with every enclosed hole filled."""
    # a frame of background joins all that reaches the edge
    outside = _part_at(np.pad(~mask, 1, constant_values=True), 0)
    filled: Bools = ~outside[1:-1, 1:-1]
    return filled


_EAR_GAP = 0.12  # face sizes: hair between an ear and the cheek
_BRIDGE = 0.06  # face sizes: half the width of what may be no neck
_LEAST_PART = 0.004  # squared face sizes


def gather(skin: Bools, where: Places) -> Bools:
    """A face's skin of raw skin cells (h, w): the part that holds the face, what hair or beard cuts off, no holes."""
    raw = cv2.morphologyEx(skin.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)).astype(np.bool_)
    raw |= where.sure
    for gap in where.gaps:
        line = _line(gap.across)
        closed = cv2.dilate(raw.astype(np.uint8), line, borderType=cv2.BORDER_CONSTANT, borderValue=0)
        closed = cv2.erode(closed, line, borderType=cv2.BORDER_CONSTANT, borderValue=0)
        raw = raw | (closed.astype(np.bool_) & gap.within)
    main = _wide_neck(biggest_part(raw, where.sure), where)
    rest = raw & ~main
    if not (rest & where.ears).any():
        return fill_holes(main)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(rest.astype(np.uint8), connectivity=4)
    reach = max(1, round(_EAR_GAP * where.size))
    near = cv2.dilate(main.astype(np.uint8), np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)).astype(np.bool_)
    touched = np.bincount(labels[near & where.ears], minlength=count) > 0
    kept = touched & (stats[:, cv2.CC_STAT_AREA] > _LEAST_PART * where.size**2)
    kept[0] = False
    return fill_holes(main | kept[labels])


def _wide_neck(main: Bools, where: Places) -> Bools:
    """`main` (h, w) without what hangs on the neck by a narrow bridge: ties, stripes, locks of hair."""
    neck = where.neckness > 0.9
    reach = max(1, round(_BRIDGE * where.size))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    # what lies beyond the picture counts as skin, or a neck cut by its edge would be thinned
    core = cv2.erode(main.astype(np.uint8), disc).astype(np.bool_) | (main & ~neck)
    core = biggest_part(core, where.sure)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 3, 2 * reach + 3))
    wide: Bools = main & (cv2.dilate(core.astype(np.uint8), disc).astype(np.bool_) | ~neck)
    return wide


def _line(step: Floats) -> Bytes:
    """A line of ones along (and as long as) the vector `step` (2,)."""
    half = np.abs(step) / 2
    size = (int(np.ceil(half[1])) * 2 + 1, int(np.ceil(half[0])) * 2 + 1)
    kernel = np.zeros(size, np.uint8)
    center = np.array([size[1] // 2, size[0] // 2])
    ends = [tuple(int(v) for v in np.rint(center + sign * step / 2)) for sign in (-1, 1)]
    cv2.line(kernel, ends[0], ends[1], (1,), 1)
    return kernel
