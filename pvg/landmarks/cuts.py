"""Scene cuts and dissolves, found one frame at a time from thumbnails: no frame is kept."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import cv2
import numpy as np

from pvg._arrays import Bytes, Floats
from pvg.picture import Picture, as_picture

THUMBNAIL = (64, 36)
HISTOGRAM_BINS = 6
MIN_CHANGE = 3.0
"""Levels of 255: below this mean change of the thumbnail's luma nothing was cut, whatever its structure says."""
MIN_UNLIKENESS = 0.45
"""1 − correlation of two thumbnails' luma. Clips of heads, hands and hand-held cameras stay below 0.28."""
REPLACED_UNLIKENESS, REPLACED_CHANGE = 0.4, 25.0
"""The same two, for a picture that has become another one in a second, which is told beside other signs. [measured:
wipes and their like change it by 27 levels at least when they are over, a singer on a dark stage by 16 and 22]"""
MOVED_LIKENESS, MIDDLE = 0.78, 0.7
"""Correlation of a thumbnail's middle, that share of its sides, with its best place in the one before, from which on
the camera was moved. [measured: other pictures 0.71 at most, nearer ones of the same person 0.75, shaken ones 0.81 at
least]"""
BLOCK, DETAIL, LEAST_DETAIL = (8, 9), 7, 2.0
"""Columns and rows of a thumbnail's blocks, the side of the boxes whose mean is taken from luma to leave its detail,
and the levels of it, standard deviation, that say something."""
SAME_DETAIL, RELIT, RELIT_LEAST = 0.6, 0.5, 8
"""Correlation of a block's detail with what was there before, from which on it is the same; share of the blocks that
have any, and number of those at least, from which on light has moved over a place that stayed. [measured: light that
crosses the picture 0.88 at least, other pictures 0.19 at most]"""
RECOLORED, RECOLORED_CHANGE, RECOLORED_UNLIKENESS = 0.5, 20.0, 0.15
"""Share of the pixels that change their colour bin, with the least change and unlikeness that must come with it: two
shots framed alike, which a change of exposure is not."""
DISSOLVE_REACH = 8
"""Steps on either side of the middle of a dissolve, which is seen when the last of them is."""
DISSOLVE_SHARE, DISSOLVE_LEFT = (0.45, 0.7), 0.25
"""Of the picture after in the one in the middle, and what of their difference is neither, rms. [measured: dissolves
leave 0.07 to 0.18; zooms, pans and moving people 0.4 at least]"""
OVER_SHARE = 0.6
"""What is left at the end of all that a picture's pixels have changed by on the way, from which on it went over into
another by a wipe, an iris or a dissolve: what moves goes up and down. [measured: two of three of those have 0.7 and
more; pictures that pass behind a face have 0.34 at most, pans and zooms 0.61]"""
OVER_RESTS, RESTING_STEPS = 0.05, 3
"""Share of the way to another picture that the last steps may still have gone where it has arrived."""
_LEAST_CONTRAST = 8.0
"""Levels of luma, standard deviation, below which a picture is none that dissolves: fades are light that changes."""


@dataclass(frozen=True, eq=False)
class Change:
    """A picture that becomes another one step by step.

    lumas: (n, 36, 64) float32, thumbnails' luma, one a step;  steps: how many of the last of them it was seen in.
    """

    lumas: Floats
    steps: int

    @property
    def is_over(self) -> bool:
        """Whether it went over without moving, as in a wipe, an iris or a dissolve, and has arrived."""
        lumas = self.lumas[-1 - self.steps :]
        before, after = lumas[0], lumas[-1]
        if min(before.std(), after.std()) < _LEAST_CONTRAST:
            return False
        on_the_way = float(np.abs(np.diff(lumas, axis=0)).sum())
        return self.rests and float(np.abs(after - before).sum()) >= OVER_SHARE * on_the_way

    @property
    def rests(self) -> bool:
        """Whether it has arrived."""
        way = _way(self.lumas[-1 - self.steps :])
        return len(way) > RESTING_STEPS and 1 - float(way[-1 - RESTING_STEPS]) < OVER_RESTS

    def steps_since(self, share: float, part: Floats) -> int:
        """How many steps before the last it had gone a share of the way within a part of the picture; 0 if that stayed.

        part: (4,) x0, y0, x1, y1 in shares of the picture.
        """
        height, width = self.lumas.shape[1:]
        x0, y0 = np.minimum(part[:2] * (width, height), (width - 1, height - 1)).astype(int)
        x1, y1 = np.ceil(part[2:] * (width, height)).astype(int)
        way = _way(self.lumas[:, y0 : max(y1, y0 + 1), x0 : max(x1, x0 + 1)])
        return int((way[:-1] >= share).sum())


class CutDetector:
    """Finds for each frame in turn whether it starts a new shot.

    A cut changes the picture's structure (the luma of two thumbnails stops correlating wherever they are laid, which a
    change of exposure or a shaken camera does not do) or, more rarely, its colours as a whole. A dissolve counts as a
    cut once it has ended: in its middle the picture is a mean of two that have nothing in common.
    """

    def __init__(self, remembered: int = 0, step: int = 1) -> None:
        """remembered: how many steps back `is_another_since` is to look;  step: see `frames_a_step`."""
        self._step = step
        self._taken = 0  # frames
        self.dissolve: Change | None = None  # that the last picture ends
        self._waited = 0  # steps since a dissolve was seen that has not come to its end yet
        self._histogram: Floats | None = None  # of the frame before
        self._last: Floats | None = None  # its luma
        # luma of the frames before, one a step, of this shot
        self._recent: deque[Floats] = deque(maxlen=max(3 * DISSOLVE_REACH, remembered) + 1)

    def is_cut(self, frame: Picture | Bytes) -> bool:
        """Take the next frame, a picture or (H, W, 3) uint8; the first frame ever is not a cut."""
        small = as_picture(frame).thumbnail(THUMBNAIL)
        luma = np.asarray(cv2.cvtColor(small, cv2.COLOR_RGB2GRAY), np.float32)
        cut = self._is_hard_cut(small, luma)
        self._last = luma
        self.dissolve = None
        if not cut and self._taken % self._step == 0:
            self._recent.append(luma)
            self.dissolve = self._ended_dissolve()
            cut = self.dissolve is not None
        self._taken += 1
        if cut:
            self.forget()
        return cut

    def is_another_since(self, steps: int) -> bool:
        """Whether the last picture has nothing in common with the one so many steps before it, of the same shot.

        Light that crosses a picture, a leak or a lamp, changes it as much, but not its detail.
        """
        if self._last is None or len(self._recent) <= steps:
            return False
        before, now = self._recent[-1 - steps], self._last
        changed = float(np.abs(now - before).mean()) > REPLACED_CHANGE
        unlike = changed and _unlikeness(now, before) > REPLACED_UNLIKENESS
        return unlike and not _moved(now, before) and not _relit(now, before)

    def change(self, steps: int) -> Change:
        """The pictures of this shot that are remembered, of which the last so many steps are looked at."""
        return Change(np.stack(self._recent), min(len(self._recent) - 1, steps))

    def forget(self) -> None:
        """Start a new shot with the last picture."""
        self._waited = 0
        self._recent.clear()
        if self._last is not None:
            self._recent.append(self._last)

    def _ended_dissolve(self) -> Change | None:
        """The dissolve that has come to its end with the last picture, or was seen as many steps ago as is waited."""
        reach = DISSOLVE_REACH
        seen = self._waited > 0 or (
            len(self._recent) > 2 * reach
            and _dissolved(self._recent[-1 - 2 * reach], self._recent[-1 - reach], self._recent[-1])
        )
        if not seen:
            return None
        self._waited += 1
        change = self.change(3 * reach)
        return change if change.rests or self._waited > reach else None

    def _is_hard_cut(self, small: Bytes, luma: Floats) -> bool:
        """Whether a picture differs from the one before as a cut does.  small: (36, 64, 3) RGB;  luma: (36, 64)."""
        histogram = cv2.calcHist(
            [small], [0, 1, 2], None, [HISTOGRAM_BINS] * 3, [0, 256, 0, 256, 0, 256]
        ).ravel() / float(luma.size)
        histogram_before, self._histogram = self._histogram, np.asarray(histogram, np.float32)
        before = self._last
        if histogram_before is None or before is None:
            return False
        change = float(np.abs(luma - before).mean())
        if change < MIN_CHANGE:
            return False
        recolored = float(np.abs(histogram - histogram_before).sum()) / 2
        unlikeness = _unlikeness(luma, before)
        framed_alike = recolored > RECOLORED and change > RECOLORED_CHANGE and unlikeness > RECOLORED_UNLIKENESS
        return (unlikeness > MIN_UNLIKENESS and not _moved(luma, before)) or framed_alike


def _way(lumas: Floats) -> Floats:
    """(n,) how far each picture of (n, h, w) is on the way from the first, 0, to the last, 1."""
    whole = lumas[-1] - lumas[0]
    square = max(float((whole * whole).sum()), 1e-3)
    return np.asarray(((lumas - lumas[0]) * whole).sum(axis=(1, 2)) / square, np.float32)


def _dissolved(before: Floats, middle: Floats, after: Floats) -> bool:
    """Whether the picture in the middle of a dissolve is the mean of two unlike others; all (h, w) thumbnails' luma."""
    if min(before.std(), after.std()) < _LEAST_CONTRAST or _unlikeness(after, before) < MIN_UNLIKENESS:
        return False
    whole, part = ((one - before) - (one - before).mean() for one in (after, middle))
    square = float((whole * whole).mean())
    share = float((whole * part).mean()) / square
    left = float(np.sqrt(((part - share * whole) ** 2).mean() / square))
    return DISSOLVE_SHARE[0] < share < DISSOLVE_SHARE[1] and left < DISSOLVE_LEFT and not _moved(after, before)


def _relit(luma: Floats, before: Floats) -> bool:
    """Whether most of the detail of one is where that of the other is; both (h, w) luma of thumbnails."""
    columns, rows = BLOCK
    alike = seen = 0
    detail, detail_before = (one - cv2.blur(one, (DETAIL, DETAIL)) for one in (luma, before))
    for y in range(0, luma.shape[0], rows):
        for x in range(0, luma.shape[1], columns):
            here, there = (one[y : y + rows, x : x + columns] for one in (detail, detail_before))
            if min(here.std(), there.std()) > LEAST_DETAIL:
                seen += 1
                alike += _unlikeness(here, there) < 1 - SAME_DETAIL
    return seen >= RELIT_LEAST and alike > RELIT * seen


def _moved(luma: Floats, before: Floats) -> bool:
    """Whether the middle of a thumbnail is found in the one before; both (h, w) luma."""
    rows, columns = (round(side * (1 - MIDDLE) / 2) for side in luma.shape)
    middle = luma[rows:-rows, columns:-columns]
    if middle.std() < 1.0:  # what is flat is found everywhere
        return False
    return float(cv2.matchTemplate(before, middle, cv2.TM_CCOEFF_NORMED).max()) > MOVED_LIKENESS


def _unlikeness(a: Floats, b: Floats) -> float:
    """1 − correlation of two pictures (h, w), in [0, 2]; 1 when one of them is flat."""
    a, b = a - a.mean(), b - b.mean()
    norm = float(np.sqrt((a * a).sum() * (b * b).sum()))
    return 1 - float((a * b).sum()) / norm if norm > 1e-3 else 1.0
