"""Nothing of a body's matte opens or closes for a single frame, and what opens or closes goes over in three steps.

A part of a body is skin, or none of it is: an arm that is hardly likely enough, or joined to the rest by a few cells,
would come and go from frame to frame. So each cell is held, as the face's are (`pvg.skin.consensus`), to what five
frames say of it and its neighbours, two before and two after; here that is their mean without the least and the
greatest. The cells of a scene stay where they are while people move, so those of other frames are taken from where the
flow leads. What the flow does not explain, as a hand that passes, keeps its own matte.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from pvg._arrays import Bools, Bytes, Floats
from pvg.skin.consensus import REACH, held_to, off_usual, passes
from pvg.skin.in_time import Maps, moved, places_before
from pvg.skin.parameters import SKIN_PRIOR
from pvg.skin.scene import Scene, cells_along

_CONSENSUS = SKIN_PRIOR.consensus


@dataclass(frozen=True, eq=False)
class _BodyInTime:
    """A body's matte alpha (h, w) uint8 in a scene.

    flow: see `Scene`, None where it does not lead to the frame before of this body.
    """

    alpha: Bytes
    scene: Scene
    flow: Floats | None


class BodyConsensus:
    """Brings the body's mattes of a track, in order, to what the frames around each of them agree on."""

    def __init__(self) -> None:
        self._window: deque[_BodyInTime] = deque(maxlen=2 * REACH + 1)
        self._behind = 0  # of the window, frames not given yet

    def add(self, scene: Scene, alpha: Bytes) -> Bytes | None:
        """Take the next frame's matte (h, w) uint8; the one of REACH frames before it, None while there is none."""
        first = not self._window
        frame = _BodyInTime(alpha, scene, None if first or scene.changed else scene.flow)
        if first:
            self._window.extend([frame] * REACH)
        self._window.append(frame)
        self._behind += 1
        if self._behind <= REACH:
            return None
        self._behind -= 1
        return _consensus_of(self._window)

    def end(self) -> list[Bytes]:
        """The mattes of the last frames, when no more come."""
        out = []
        while self._behind:
            last = self._window[-1]
            self._window.append(_BodyInTime(last.alpha, last.scene, None))
            if len(self._window) == 2 * REACH + 1:
                out.append(_consensus_of(self._window))
                self._behind -= 1
        return out


def _consensus_of(window: Sequence[_BodyInTime]) -> Bytes:
    """The matte in the middle of five frames."""
    own = window[REACH]
    if not any(frame.alpha.any() for frame in window):
        return own.alpha
    places = _places(window)
    around = [_at(frame.alpha, own.alpha, place) for frame, place in zip(window, places, strict=True)]
    alpha = held_to(own.alpha, _middle_mean(around))
    if (alpha == own.alpha).all():
        return own.alpha
    shown = own.scene.rgb
    pictures = (_at(frame.scene.rgb, shown, place) for frame, place in zip(window, places, strict=True))
    passing = passes(off_usual(shown, pictures), _CONSENSUS.body_part)
    return np.rint(alpha + passing * (own.alpha.astype(np.float32) - alpha)).astype(np.uint8)


def _middle_mean(values: Sequence[Bytes]) -> Bytes:
    """The mean of five arrays of one shape without the least and the greatest, element by element."""
    least, most = values[0], values[0]
    total = values[0].astype(np.uint16)
    for each in values[1:]:
        least, most, total = np.minimum(least, each), np.maximum(most, each), total + each
    return np.asarray((total - least - most) // np.uint16(len(values) - 2), np.uint8)


def _places(window: Sequence[_BodyInTime]) -> list[Maps | None]:
    """Where each cell of the middle frame is in each of five, None in itself and where no flow leads."""
    shape = window[REACH].alpha.shape
    to_before, to_after = (
        _followed([frame.flow for frame in frames], sign)
        for frames, sign in ((list(window)[REACH:0:-1], 1), (list(window)[REACH + 1 :], -1))
    )
    ways = [*reversed(to_before), None, *to_after]
    return [None if way is None else cells_along(way, shape) for way in ways]


def _followed(flows: Sequence[Floats | None], sign: int) -> list[Floats | None]:
    """The ways (h', w', 2), in blocks of cells, along the first flow, along two of them, and so on; None beyond a gap.

    sign: 1 along the flows, which lead to the frame before, -1 against them. They are smooth, so that the way back is
    about as long where it begins.
    """
    out: list[Floats | None] = []
    way: Floats | None = None
    for i, flow in enumerate(flows):
        if flow is None or (i and way is None):
            way = None
        elif way is None:
            way = np.float32(sign) * flow
        else:
            way = way + np.float32(sign) * moved(flow, places_before(way))
        out.append(way)
    return out


def _at(values: Bytes, own: Bytes, places: Maps | None) -> Bytes:
    """Values (h, w) or (h, w, 3) of another frame at places (h, w), the middle frame's own beyond its edge."""
    if places is None:
        return own
    x, y = places
    h, w = own.shape[:2]
    read = np.asarray(cv2.remap(values, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.uint8)
    beyond: Bools = (x < 0) | (y < 0) | (x > w - 1) | (y > h - 1)
    read[beyond] = own[beyond]
    return read
