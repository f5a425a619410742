"""Connected components of masks, holes, narrow bridges, and what goes over into skin without an edge."""

from __future__ import annotations

import cv2
import numpy as np

from pvg._arrays import Bools, Bytes, Floats
from pvg.skin.parameters import SKIN_PRIOR
from pvg.skin.prior import SpatialPrior

_CLEANUP = SKIN_PRIOR.cleanup


def occupied(cells: Bytes, margin: int = 0) -> tuple[slice, slice]:
    """Rows and columns of the box around what is not 0 of cells (h, w), and of `margin` cells more where there are any.

    What is looked for in a box is found sooner than in a whole picture; where all is 0 it is empty.
    """
    x, y, w, h = cv2.boundingRect(cells)
    if not h:
        return slice(0, 0), slice(0, 0)
    return slice(max(0, y - margin), y + h + margin), slice(max(0, x - margin), x + w + margin)


def largest_component(mask: Bools, near: Bools | None = None) -> Bools:
    """The largest 4-connected component of `mask` (h, w), of those that touch `near` (h, w) when any does."""
    touching = None if near is None else near & mask
    if touching is not None and touching.any():  # nearly always all of it lies in one component
        component = _component_at(mask, int(np.argmax(touching)))
        if component[touching].all():
            return component
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=4)
    if count <= 1:
        return mask
    areas = stats[:, cv2.CC_STAT_AREA].astype(np.int64)
    areas[0] = 0
    if near is not None:
        touched = np.bincount(labels[near], minlength=count) > 0
        if touched[1:].any():
            areas[~touched] = 0
    largest: Bools = labels == int(np.argmax(areas))
    return largest


def held_components(mask: Bools, certain: Bools, least: float) -> Bools:
    """The 4-connected components of `mask` (h, w) that hold more than `least` of the `certain` cells (h, w).

    Where none does, the largest that touches them.
    """
    main = largest_component(mask, certain)
    if main[certain & mask].all():
        return main
    count, labels = cv2.connectedComponents(mask.astype(np.uint8), connectivity=4)
    held = np.bincount(labels[certain & mask], minlength=count) > least
    held[0] = False
    return np.asarray(main | held[labels], np.bool_)


def _component_at(mask: Bools, cell: int) -> Bools:
    """The 4-connected component of one cell, counted row by row, of `mask` (h, w): a third of labelling all."""
    marks = mask.astype(np.uint8)
    y, x = divmod(cell, mask.shape[1])
    cv2.floodFill(marks, None, (x, y), (2,))
    component: Bools = marks == 2
    return component


def fill_holes(mask: Bools) -> Bools:
    """`mask` (h, w) with every enclosed hole filled."""
    # a frame of background joins all that reaches the edge
    outside = _component_at(np.pad(~mask, 1, constant_values=True), 0)
    filled: Bools = ~outside[1:-1, 1:-1]
    return filled


def face_component(skin: Bools, certain: Bools, prior: SpatialPrior) -> Bools:
    """A face's skin of raw skin cells (h, w): the component of the face, ears that hair cuts off from it, no holes.

    Beards and the shadow under the chin are closed, so that they cut nothing off.
    certain: (h, w) bool, of the foreground, what is skin whatever the raw cells say; what lies before a face, such as
    a strand of hair, may cut it into several parts.
    """
    raw = cv2.morphologyEx(skin.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)).astype(np.bool_)
    raw |= certain
    line = _line(prior.closing.step)
    closed = cv2.dilate(raw.astype(np.uint8), line, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    closed = cv2.erode(closed, line, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    raw |= closed.astype(np.bool_) & prior.closing.within
    least = _CLEANUP.least_part * prior.size**2
    main = _without_bridges(held_components(raw, certain, least), certain, prior)
    rest = raw & ~main
    if not (rest & prior.ears).any():
        return fill_holes(main)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(rest.astype(np.uint8), connectivity=4)
    reach = max(1, round(_CLEANUP.ear_gap * prior.size))
    near = cv2.dilate(main.astype(np.uint8), np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)).astype(np.bool_)
    touched = np.bincount(labels[near & prior.ears], minlength=count) > 0
    kept = touched & (stats[:, cv2.CC_STAT_AREA] > least)
    kept[0] = False
    return fill_holes(main | kept[labels])


def _without_bridges(main: Bools, certain: Bools, prior: SpatialPrior) -> Bools:
    """`main` (h, w) without what hangs on the neck by a narrow bridge: ties, stripes, locks of hair."""
    neck = prior.neck > _CLEANUP.neck_weight
    reach = max(1, round(_CLEANUP.bridge * prior.size))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    # what lies beyond the picture counts as skin, or a neck cut by its edge would be thinned
    core = cv2.erode(main.astype(np.uint8), disc).astype(np.bool_) | (main & ~neck)
    core = held_components(core, certain, _CLEANUP.least_part * prior.size**2)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 3, 2 * reach + 3))
    wide: Bools = main & (cv2.dilate(core.astype(np.uint8), disc).astype(np.bool_) | ~neck)
    return wide


def _line(step: Floats) -> Bytes:
    """A structuring element: a line along (and as long as) the vector `step` (2,)."""
    half = np.abs(step) / 2
    size = (int(np.ceil(half[1])) * 2 + 1, int(np.ceil(half[0])) * 2 + 1)
    element = np.zeros(size, np.uint8)
    center = np.array([size[1] // 2, size[0] // 2])
    ends = [tuple(int(v) for v in np.rint(center + sign * step / 2)) for sign in (-1, 1)]
    cv2.line(element, ends[0], ends[1], (1,), 1)
    return element


def goes_over(lab: Floats, part: Bools, skin: Bools) -> float:
    """The share of a part's outline over which it goes over into skin without an edge.  All (h, w), lab (h, w, 3)."""
    own = part.astype(np.float32)
    outline = (cv2.dilate(part.view(np.uint8), np.ones((3, 3), np.uint8)) > 0) & ~part
    count = np.maximum(cv2.blur(own, (3, 3), borderType=cv2.BORDER_CONSTANT), 1e-6)
    beside = cv2.blur(lab * own[..., None], (3, 3), borderType=cv2.BORDER_CONSTANT) / count[..., None]
    step = np.linalg.norm((lab - beside)[outline], axis=1)
    return float((skin[outline] & (step < SKIN_PRIOR.highlights.step)).sum()) / max(int(outline.sum()), 1)
