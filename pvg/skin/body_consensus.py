"""Nothing of a body's matte opens or closes for a single frame, and what opens or closes goes over in three steps.

A part of a body is skin, or none of it is: an arm that is hardly likely enough, or joined to the rest by a few cells,
would come and go from frame to frame. So each cell is held, as the face's are (`pvg.skin.consensus`), to what five
frames say of it and its neighbours, two before and two after; here that is their mean without the least and the
greatest. The cells of a scene stay where they are while people move, so those of other frames are taken from where the
flow leads. What the flow does not explain, as a hand that passes, keeps its own matte.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np

from pvg._arrays import Bools, Bytes, Floats
from pvg.skin.cleanup import occupied
from pvg.skin.consensus import REACH, FramesAround, held_to, off_usual, passes
from pvg.skin.in_time import Maps, in_levels, moved, places_before
from pvg.skin.parameters import SKIN_PRIOR
from pvg.skin.scene import Scene, cells_along

_CONSENSUS = SKIN_PRIOR.consensus
_SEEN = 25  # levels of alpha [by eye]: less is not looked at
_MARGIN = 8  # cells around what changes [by eye]: what decides it lies nearer


@dataclass(frozen=True, eq=False)
class _BodyInTime:
    """A body's matte alpha (h, w) uint8 in a scene."""

    alpha: Bytes
    scene: Scene

    def flow_to(self, before: _BodyInTime) -> Floats | None:
        """The flow to the frame before, see `Scene`; None where it tells nothing of it."""
        return None if before is self or self.scene.changed else self.scene.flow


class BodyConsensus:
    """Brings the body's mattes of a track, in order, to what the frames around each of them agree on."""

    def __init__(self) -> None:
        self._frames = FramesAround[_BodyInTime]()

    def add(self, scene: Scene, alpha: Bytes) -> Bytes | None:
        """Take the next frame's matte (h, w) uint8; the one of REACH frames before it, None while there is none."""
        around = self._frames.add(_BodyInTime(alpha, scene))
        return None if around is None else _consensus_of(around)

    def end(self) -> list[Bytes]:
        """The mattes of the last frames, when no more come."""
        return [_consensus_of(around) for around in self._frames.end()]


def _consensus_of(window: Sequence[_BodyInTime]) -> Bytes:
    """The matte in the middle of five frames."""
    own = window[REACH].alpha
    # where nothing moves, which is nearly everywhere, what the frames agree on is as it would be along the flow
    box = _changed(own, held_to(own, _middle_mean([frame.alpha for frame in window])))
    if box is None:
        return own
    shown = window[REACH].scene.rgb
    places = [None if one is None else (one[0][box], one[1][box]) for one in _places(window)]
    around = [_at(frame.alpha, own[box], place) for frame, place in zip(window, places, strict=True)]
    held = held_to(own[box], _middle_mean(around))
    if (held == own[box]).all():
        return own
    pictures = (_at(frame.scene.rgb, shown[box], place) for frame, place in zip(window, places, strict=True))
    passing = passes(off_usual(shown[box], pictures), _CONSENSUS.body_part)
    out = own.copy()
    mixed = held + passing * (own[box].astype(np.float32) - held)
    out[box] = in_levels(np.asarray(mixed / 255, np.float32))
    return out


def _changed(own: Bytes, other: Bytes) -> tuple[slice, slice] | None:
    """Rows and columns of where two mattes (h, w) differ and of what lies around it; None where nowhere."""
    off = np.asarray(cv2.absdiff(own, other) > _SEEN).view(np.uint8)
    return occupied(off, _MARGIN) if off.any() else None


def _middle_mean(values: Sequence[Bytes]) -> Bytes:
    """The mean of arrays of one shape without the least and the greatest, element by element."""
    least = most = values[0]
    total = values[0].astype(np.uint16)
    for each in values[1:]:
        least, most, total = np.minimum(least, each), np.maximum(most, each), total + each
    return np.asarray((total - least - most) // np.uint16(len(values) - 2), np.uint8)


def _places(window: Sequence[_BodyInTime]) -> list[Maps | None]:
    """Where each cell of the middle frame is in each of five, None in itself and where no flow leads."""
    shape = window[REACH].alpha.shape
    flows = [frame.flow_to(before) for before, frame in pairwise(window)]
    to_before, to_after = _followed(flows[:REACH][::-1], 1), _followed(flows[REACH:], -1)
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
    """Values (H, W) or (H, W, 3) of another frame at places (h, w), the middle frame's own where that is no picture."""
    if places is None:
        return own
    x, y = places
    h, w = values.shape[:2]
    read = np.asarray(cv2.remap(values, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.uint8)
    beyond: Bools = (x < 0) | (y < 0) | (x > w - 1) | (y > h - 1)
    read[beyond] = own[beyond]
    return read
