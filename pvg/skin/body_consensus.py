"""Nothing of a body's matte opens or closes for a single frame, and what opens or closes goes over in three steps.

A part of a body is skin, or none of it is: an arm that is hardly likely enough, or joined to the rest by a few cells,
would come and go from frame to frame. So each cell is held, as the face's are (`pvg.skin.consensus`), to what five
frames say of it and its neighbours, two before and two after; here that is their mean without the least and the
greatest, within what two of them in a row say. The cells of a scene stay where they are while people move, so those of
other frames are taken from where the flow leads. Where the picture is not what the flow makes of it, as under a hand
that passes, a frame keeps its own matte. Parts that are narrower than three cells are left as they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np

from pvg._arrays import Bools, Bytes, Floats
from pvg.skin.cleanup import occupied
from pvg.skin.consensus import REACH, Consensus, held_to, most_off, passes
from pvg.skin.in_time import Maps, in_levels, moved, places_before
from pvg.skin.parameters import SKIN_PRIOR
from pvg.skin.scene import Scene, cells_along

_CONSENSUS = SKIN_PRIOR.consensus
_SEEN = 25  # levels of alpha [by eye]: less is not looked at
_MARGIN = 8  # cells around what changes [by eye]: what decides it lies nearer
Box = tuple[slice, slice]
"""Rows and columns of cells."""


@dataclass(frozen=True, eq=False)
class BodyInTime:
    """A body's matte and what it was made from.

    alpha: (h, w) uint8, over the scene's cells.
    """

    alpha: Bytes
    scene: Scene


_Seen = tuple[BodyInTime, Floats | None]
"""A frame, and the way (h', w', 2) there from the middle one, in blocks of cells; None in itself."""


class BodyConsensus(Consensus[BodyInTime, Bytes]):
    """Brings the mattes of a body, (h, w) uint8, to what the frames around each of them agree on."""

    def __init__(self) -> None:
        super().__init__(_consensus_of)


def _consensus_of(window: Sequence[BodyInTime]) -> Bytes:
    """The matte in the middle of five frames."""
    own = window[REACH]
    box = occupied(np.asarray(np.max([frame.alpha for frame in window], axis=0), np.uint8), _MARGIN)
    if not own.alpha[box].size:
        return own.alpha
    seen = [*_followed(window[REACH::-1], 1)[::-1], (own, None), *_followed(window[REACH:], -1)]
    if not any(way is not None and _moves(way, own.alpha.shape, box) for _, way in seen):
        # nothing moves: what the frames agree on needs a look along the flow only where it is not what is there
        box = _within(box, _changed(own.alpha[box], [frame.alpha[box] for frame, _ in seen]))
        if not own.alpha[box].size:
            return own.alpha
    places = [None if way is None else _cut(cells_along(way, own.alpha.shape), box) for _, way in seen]
    mattes = [_at(frame.alpha, own.alpha[box], place) for (frame, _), place in zip(seen, places, strict=True)]
    part = _changed(own.alpha[box], mattes)
    box, places = _within(box, part), [None if place is None else _cut(place, part) for place in places]
    alpha, shown = own.alpha[box], own.scene.rgb[box]
    if not alpha.size:
        return own.alpha
    alike = []
    for (frame, _), matte, place in zip(seen, mattes, places, strict=True):
        picture = _at(frame.scene.rgb, shown, place)
        alike.append(alpha if place is None else _where_alike(matte[part], picture, alpha, shown))
    out = own.alpha.copy()
    held = held_to(alpha, _usual(alike), _CONSENSUS.body_around)
    out[box] = in_levels(np.asarray(held / np.float32(255), np.float32))
    return out


def _changed(own: Bytes, mattes: Sequence[Bytes]) -> Box:
    """The box around where mattes (h, w) of five frames agree on another one than `own`; empty without."""
    off = cv2.absdiff(own, held_to(own, _usual(mattes), _CONSENSUS.body_around)) > _SEEN
    return occupied(np.asarray(off, np.bool_).view(np.uint8), _MARGIN)


def _where_alike(matte: Bytes, picture: Bytes, own: Bytes, shown: Bytes) -> Bytes:
    """A matte (h, w) of another frame, and the middle frame's `own` where something else is seen there.

    picture, shown: (h, w, 3), of that frame and of the middle one.
    """
    other = passes(most_off(picture, shown), _CONSENSUS.body_part)
    return np.rint(matte + other * (own.astype(np.float32) - matte)).astype(np.uint8)


def _cut(places: Maps, box: Box) -> Maps:
    """Places (h, w) in a box of them."""
    x, y = places
    return x[box], y[box]


def _within(box: Box, part: Box) -> Box:
    """A box of cells within another one, in those that the other is in."""
    rows, columns = (
        slice(outer.start + inner.start, min(outer.stop, outer.start + inner.stop))
        for outer, inner in zip(box, part, strict=True)
    )
    return rows, columns


def _usual(mattes: Sequence[Bytes]) -> Bytes:
    """What mattes (h, w) of frames in their order agree on: their mean without the least and the greatest.

    What only single frames have, however many, counts for nothing.
    """
    least = most = mattes[0]
    total = mattes[0].astype(np.uint16)
    for each in mattes[1:]:
        least, most, total = np.minimum(least, each), np.maximum(most, each), total + each
    mean = (total - least - most) // np.uint16(len(mattes) - 2)
    pairs = list(pairwise(mattes))
    lasting = np.max([np.minimum(*pair) for pair in pairs], axis=0)
    missing = np.min([np.maximum(*pair) for pair in pairs], axis=0)
    return np.asarray(np.maximum(np.minimum(mean, lasting), missing), np.uint8)


def _moves(way: Floats, shape: tuple[int, ...], box: Box) -> bool:
    """Whether a way (h', w', 2) leads a cell or farther somewhere in a box of a scene of `shape` (h, w)."""
    rows, columns = (
        slice(one.start * blocks // cells, -(-one.stop * blocks // cells))
        for one, blocks, cells in zip(box, way.shape, shape, strict=False)
    )
    part = way[rows, columns]
    return bool(part.size) and float(np.abs(part).max()) * shape[0] >= way.shape[0]


def _followed(frames: Sequence[BodyInTime], sign: int) -> list[_Seen]:
    """The frames after the first of these that the flow leads to from there, and the ways; the last of them goes on.

    sign: 1 towards earlier frames, along the flows; -1 towards later ones, against them. Flows are smooth, so that the
    way back is about as long where it begins.
    """
    out: list[_Seen] = []
    last: _Seen = frames[0], None
    for near, far in pairwise(frames):
        flow = (near if sign > 0 else far).scene.flow
        if near is not last[0] or far is near or flow is None:
            out.append(last)
            continue
        way = last[1]
        step = np.float32(sign) * (flow if way is None else moved(flow, places_before(way)))
        last = far, step if way is None else way + step
        out.append(last)
    return out


def _at(values: Bytes, own: Bytes, places: Maps | None) -> Bytes:
    """Values (H, W) or (H, W, 3) of another frame at places (h, w), the middle frame's own where that is no picture."""
    if places is None:
        return own
    x, y = places
    h, w = values.shape[:2]
    read = np.asarray(cv2.remap(values, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.uint8)
    beyond: Bools = (x < -1) | (y < -1) | (x > w) | (y > h)  # nearer, the edge goes on
    read[beyond] = own[beyond]
    return read
