"""Nothing of a face's matte opens or closes for fewer than three frames, unless the picture itself does.

A glint on glasses or a patch of noise can open a hole in a matte for a frame or two, and an ear or a strip of neck can
be taken in for as long. So each cell is held to the median over five frames, two before and two after, of it and its
neighbours: what lasts three frames stays, edges stay where they are, and shorter changes go. Where the picture is alike
in all of them, a cell that is far off its own median is held to that. What really passes in front of the face may
be that short: where a large part of the picture itself leaves its own median, or where something of another hue does,
the frame's own matte holds.

Cells lie in the face's box, which goes with the face, so that a cell sees nearly the same place of it in five frames.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Generic, TypeVar

import cv2
import numpy as np

from pvg._arrays import Bools, Bytes, Floats, ramp
from pvg.raster import Raster, block, square
from pvg.skin.matte import Matte
from pvg.skin.parameters import SKIN_PRIOR

REACH = 2  # frames to either side

_CONSENSUS = SKIN_PRIOR.consensus


@dataclass(frozen=True, eq=False)
class MatteInTime:
    """A matte and what it was made from.

    alpha: (h, w) uint8, mask: (h, w) bool, the matte's own before it was cut along the picture's edge, for a cell that
    lies beyond the edge in one frame lies within it in the next;  rgb: (h, w, 3) uint8, the picture;
    occluder: (h, w) float32 in [0, 1], what lies in front of the face;  visible: (h, w) bool, within the picture.
    """

    raster: Raster
    alpha: Bytes
    mask: Bools
    rgb: Bytes
    occluder: Floats
    visible: Bools

    def matte(self, alpha: Bytes, mask: Bools) -> Matte:
        """A matte over the frame's raster, cut along the picture's edge.  alpha: (h, w) uint8;  mask: (h, w) bool."""
        return Matte.over(self.raster.box, alpha * self._shown, mask & self.visible)

    @cached_property
    def _shown(self) -> Bytes:
        """(h, w) uint8, 1 where alpha may be: a cell more than is visible, or it would fade along the edge."""
        return np.asarray(cv2.dilate(self.visible.astype(np.uint8), square(1)), np.uint8)


Given = TypeVar("Given")
Agreed = TypeVar("Agreed")


class Consensus(Generic[Given, Agreed]):
    """Brings the frames of a track, in order, to what those around each agree on, REACH to either side.

    The first and the last frame stand for what is beyond them.
    """

    def __init__(self, agreed: Callable[[Sequence[Given]], Agreed]) -> None:
        """agreed: what is made of the frame in the middle of 2 REACH + 1."""
        self._agreed = agreed
        self._window: deque[Given] = deque(maxlen=2 * REACH + 1)
        self._behind = 0  # of the window, frames not given yet

    def add(self, frame: Given) -> Agreed | None:
        """Take the next frame; what the one REACH frames before it becomes, None while there is none."""
        if not self._window:
            self._window.extend([frame] * REACH)
        self._window.append(frame)
        self._behind += 1
        if self._behind <= REACH:
            return None
        self._behind -= 1
        return self._agreed(tuple(self._window))

    def end(self) -> list[Agreed]:
        """What the last frames become, when no more come."""
        out = []
        while self._behind:
            self._window.append(self._window[-1])
            if len(self._window) == 2 * REACH + 1:
                out.append(self._agreed(tuple(self._window)))
                self._behind -= 1
        return out


class MatteConsensus(Consensus[MatteInTime, Matte]):
    """Brings the mattes of a face to what the frames around each of them agree on."""

    def __init__(self) -> None:
        super().__init__(_consensus_of)


def _consensus_of(window: Sequence[MatteInTime]) -> Matte:
    """The matte in the middle of five."""
    own = window[REACH]
    usual = _median(*(frame.alpha for frame in window))
    strange = most_off(own.rgb, _median(*(frame.rgb for frame in window)))
    alpha = _held_where_alike(own.alpha, usual, strange)
    if (alpha == own.alpha).all():
        return own.matte(own.alpha, own.mask)
    of_other_hue = np.asarray(own.occluder * ramp(strange.astype(np.float32), *_CONSENSUS.colored), np.float32)
    weight = np.maximum(passes(strange, _CONSENSUS.part), of_other_hue)
    mixed = alpha + weight * (own.alpha.astype(np.float32) - alpha)
    changed = np.rint(mixed).astype(np.uint8)
    return own.matte(changed, np.where(changed == own.alpha, own.mask, changed >= 128))


def _held_where_alike(own: Bytes, usual: Bytes, strange: Bytes) -> Floats:
    """A matte (h, w) held to what is usual (h, w) around each cell, or in it: where it is far off in a like picture.

    What is off by less may be an edge that moves within a cell, which in the dark is hardly seen to.

    strange: (h, w) uint8, see `most_off`.
    """
    alike = 1 - ramp(cv2.blur(strange, (3, 3)).astype(np.float32), *_CONSENSUS.colored)
    off = ramp(cv2.absdiff(own, usual).astype(np.float32), *_CONSENSUS.off)
    around = held_to(own, usual, _CONSENSUS.around)
    return np.asarray(around + alike * off * (usual.astype(np.float32) - around), np.float32)


def held_to(own: Bytes, usual: Bytes, around: int) -> Bytes:
    """A matte (h, w) held to what is usual (h, w) in `around` cells a side.

    An edge may be a little off where it usually is, as it is while a head rolls to and fro.
    """
    cells = block(around)
    return np.asarray(np.clip(own, cv2.erode(usual, cells), cv2.dilate(usual, cells)), np.uint8)


def passes(strange: Bytes, part: int) -> Floats:
    """(h, w) float32 in [0, 1], where something large passes.

    strange: (h, w) uint8, see `most_off`;  part: the least width of such a thing, cells.
    """
    kernel = block(part)
    broad = np.asarray(cv2.morphologyEx(strange, cv2.MORPH_OPEN, kernel), np.uint8)
    return ramp(np.asarray(cv2.dilate(broad, kernel), np.float32), *_CONSENSUS.passing)


def most_off(picture: Bytes, other: Bytes) -> Bytes:
    """(h, w) uint8, how far two pictures (h, w, 3) are off each other, by the channel that is farthest."""
    red, green, blue = cv2.split(cv2.absdiff(picture, other))
    return np.asarray(cv2.max(cv2.max(red, green), blue), np.uint8)


def _median(a: Bytes, b: Bytes, c: Bytes, d: Bytes, e: Bytes) -> Bytes:
    """The median of five arrays of one shape, element by element."""
    low, high = np.maximum(np.minimum(a, b), np.minimum(c, d)), np.minimum(np.maximum(a, b), np.maximum(c, d))
    return np.maximum(np.minimum(low, high), np.minimum(np.maximum(low, high), e))
