"""What a mouth's outline shows: lips, or fingers, a microphone, or what is beside an outline that is a little off.

Lips are told from what else is there by what sets them apart from the skin on the key frame, the tint c: chroma over
luma, which light changes little, and a little of how dark they are beside what lies around the mouth:

    t = (c − c_skin) · (c_lips − c_skin) / |c_lips − c_skin|²        1 on lips, 0 on skin

A change meant for lips is given to what is at least some way from skin to lips. Where lips have nearly the tint of the
skin, t is their shade, and light from above or from one side takes it from a part of them: when most of them is shown,
all of it is. A finger before an open mouth is no tooth: it is skin if it has the skin's tint, is as bright as the skin
around the mouth, and enters the mouth where its outline shows no lips. Its colour alone does not tell: yellow and
blurred teeth have it too. Where lips have the tint of the skin, no finger is told from them. A key frame without lips
that stand out from the skin shows a hand before them in all of its frames, which would be painted: it has no lips. Nor
has a frame whose outline shows what lies around it: a hand, or a mask of cloth, covers the mouth, and neither lips nor
teeth are there.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from pvg._arrays import Bools, Floats, ramp, smoothstep
from pvg.asset import KeyFrame
from pvg.face import PARTS, Landmarks, layout
from pvg.looks import to_opponent
from pvg.membrane import Lattice
from pvg.raster import block, inside, square
from pvg.rendering.coding import Coding
from pvg.rendering.node_means import mean_codes
from pvg.video import Frame

# how far lips are off the skin, from where they may be lips to where they are: in tint, and in hue beside what the
# skin's own differs by. What is near in both is a hand, or make-up that hides them [measured: lips seen in 16 clips and
# on 16 portraits 0.067 to 0.40, 1.3 to 13 in hue; with black lifted 0.022 to 0.16, and 2.0 to 12; a hand 0.046, and 1.7
# or 2.0 with black lifted]
_APART, _BESIDE_SKIN = (0.048, 0.065), (2.0, 2.5)
_ONE_SIGMA, _LEAST_SPREAD = 0.68, 0.005  # quantile, and tint: what has hardly any hue is off nothing
# of how far lips are off the skin: how far they look off what lies around them [measured: 0.29 at least in the frames
# of 14 clips, 0.11 at most on masks of six colours, a hand from 0.06]
_OFF_AROUND = (0.12, 0.22)
_RING = 0.02  # of the face's width from the outline: the nearest that lies around lips [by eye]
_FEW = 256  # of the key frame's skin that tell its spread
_SHOWN = (0.0, 0.4)  # t from which lips begin, and are all lips: highlights on them are pale [by eye]
_AROUND = 0.02  # of the face's width: spread of the mean that t is taken of, against noise [by eye]
_MARGIN = 0.06  # of the face's width around the outline
_LUMA = np.float32(0.3)  # of the logarithm of luma beside chroma over luma: grey lips are told by it [by eye]
_OTHER = np.float32(0.15)  # of that, at most: by how much the light of the frame may be another one
_OFF_TINT, _OFF_LUMA = np.float32(0.45), np.float32(0.5)  # of the skin's tint, of log luma: no skin [by eye]
_IS_SKIN = (0.5, 0.9)  # of both together: what is nearer is skin, what is farther none [by eye]
_FINGER = 0.05  # of the face's width [by eye]
_OTHER_TINT = 0.2  # of the skin's tint: lips nearer to it differ in shade alone, as skin does [by eye]
_BY_TINT = (0.3, 0.45)  # of the skin's tint: how far off it lips are told by it, below by their shade [by eye]
_MOSTLY = (0.4, 0.65)  # of the lips shown, from which those that are told by their shade are all shown [by eye]
_NO_LIPS = 0.2  # of how far lips are shown, below which a finger crosses them [by eye]
_OPEN = 0.02  # of the face's width between the lips: narrower mouths show neither teeth nor fingers [by eye]
_DARKEST = np.float32(8.0)  # levels of luma above black: below, a tint says nothing


@dataclass(frozen=True, eq=False)
class Mouth:
    """What a mouth's outline shows, on the nodes (h, w) of a face's lattice, float32 in [0, 1].

    lips: how far each shows lips, 1 away from the mouth; None: the key frame tells nothing of them.
    skin: how far each shows skin that comes into an open mouth, a finger, 0 away from it, or what covers all of the
    mouth; None: there is none.
    """

    lips: Floats | None = None
    skin: Floats | None = None


@dataclass(frozen=True, eq=False)
class _Window:
    """The nodes of a face's lattice around the outline of its mouth.

    rows, columns: which they are;  box: left, upper, right and lower end of the pixels that they stand for;
    width: the face's, source pixels.
    """

    lattice: Lattice
    rows: slice
    columns: slice
    box: tuple[int, int, int, int]
    width: float

    @classmethod
    def around(cls, frame: Frame, outline: Floats, width: float, lattice: Lattice) -> _Window | None:
        """The nodes around an outline (n, 2), of a face of some width; None without any."""
        low, high = outline.min(axis=0) - _MARGIN * width, outline.max(axis=0) + _MARGIN * width
        corner = np.array([lattice.x, lattice.y], np.float32)
        first = np.maximum(np.floor((low - corner) / lattice.step), 0).astype(np.intp)
        last = np.minimum(np.ceil((high - corner) / lattice.step).astype(np.intp) + 1, [lattice.width, lattice.height])
        align = frame.format.chroma_step
        begin = (corner + first * np.float32(lattice.step)).astype(int) // align * align
        end = np.minimum((corner + last * np.float32(lattice.step)).astype(int), [frame.width, frame.height])
        if (last - first).min() < 2 or (end - begin).min() < 2:
            return None
        columns, rows = (slice(int(one), int(other)) for one, other in zip(first, last, strict=True))
        return cls(lattice, rows, columns, (int(begin[0]), int(begin[1]), int(end[0]), int(end[1])), width)

    @property
    def shape(self) -> tuple[int, int]:
        """(h, w) how many nodes."""
        return self.rows.stop - self.rows.start, self.columns.stop - self.columns.start

    def nodes(self, share: float) -> float:
        """So much of the face's width, in nodes."""
        return share * self.width / self.lattice.step

    def codes(self, frame: Frame) -> Floats:
        """(h, w, 3) luma and chroma, black and grey aside, against noise the mean around each node."""
        codes = mean_codes(frame, self.box, self.shape)
        codes -= np.asarray(frame.format.opponent.offset, np.float32)
        return np.asarray(cv2.GaussianBlur(codes, (0, 0), max(0.5, self.nodes(_AROUND))), np.float32)

    def inside(self, outline: Floats) -> Bools:
        """(h, w) the nodes inside an outline (n, 2) in the picture."""
        corner = np.array([self.lattice.x, self.lattice.y], np.float32)
        first = np.array([self.columns.start, self.rows.start])
        return inside((outline - corner) / self.lattice.step - first, self.shape)

    def on_lattice(self, part: Floats, away: float) -> Floats:
        """What is known of these nodes (h, w), on all nodes of the lattice; `away` from these."""
        whole = np.full((self.lattice.height, self.lattice.width), away, np.float32)
        whole[self.rows, self.columns] = part
        return whole


def see_mouth(frame: Frame, landmarks: Landmarks, key: KeyFrame, lattice: Lattice) -> Mouth:
    """What the outline of a mouth shows in a frame;  key: whose lips and skin are compared."""
    lips = key.parts[PARTS.index("lips")]
    if not len(key.skin) or np.isnan(lips).any():
        return Mouth()
    coding = Coding(frame.format)
    own, skin = _tints(coding, coding.colors(np.stack([lips, key.skin_median]).astype(np.float32)))
    way = own - skin
    apart, skin_tint = float(np.linalg.norm(way)), float(np.linalg.norm(skin[:2]))
    off_tint = float(np.linalg.norm(way[:2])) / max(skin_tint, 1e-3)
    are_lips = _are_lips(key, lips, apart)
    if are_lips == 0.0:
        return Mouth(lips=np.zeros((lattice.height, lattice.width), np.float32))
    outline, opening = (landmarks.points[part] for part in (layout.LIPS_OUTER, layout.LIPS_INNER))
    width = max(landmarks.axes.width, 1.0)
    window = _Window.around(frame, outline, width, lattice)
    if window is None:
        return Mouth()

    tints = _tints(coding, window.codes(frame))
    beside = _beside(tints[..., 2], window.nodes(_MARGIN))
    off_skin = _off_skin(tints, skin, beside)
    tints[..., 2] += np.clip(skin[2] - beside, -_OTHER, _OTHER)  # to the key frame's light
    outer, inner = window.inside(outline), window.inside(opening)
    shown = smoothstep((tints - skin) @ way / float(way @ way), *_SHOWN)
    shown = _whole(shown, outer & ~inner, off_tint)
    covered = _covered(tints, apart, outer, inner, window.nodes(_RING))

    gap = float(np.linalg.norm(opening[2] - opening[6]))  # from the middle of the upper lip to that of the lower one
    in_front: Floats | None = None  # of an open mouth: skin
    if gap > _OPEN * width and off_tint > _OTHER_TINT:
        likely = 1.0 - smoothstep(off_skin, *_IS_SKIN)
        in_front = _crossing(likely, shown, outer, inner, window.nodes(_FINGER))
    if gap > _OPEN * width and covered > 0.0:
        in_front = np.maximum(np.float32(covered), np.zeros_like(shown) if in_front is None else in_front)
    return Mouth(
        lips=window.on_lattice(np.float32(are_lips * (1.0 - covered)) * shown, away=1.0),
        skin=None if in_front is None else window.on_lattice(in_front, away=0.0),
    )


def _are_lips(key: KeyFrame, lips: Floats, apart: float) -> float:
    """How surely a key frame's lips (3,) are lips, in [0, 1];  apart: how far off the skin their tint is."""
    by_tint = ramp(apart, *_APART)
    if by_tint < 1.0:  # else the spread of the skin would be looked at in every frame for nothing
        return max(by_tint, ramp(_beside_skin(key, lips), *_BESIDE_SKIN))
    return by_tint


def _beside_skin(key: KeyFrame, lips: Floats) -> float:
    """How far the hue of lips (3,) is off the skin's on the key frame, in spreads of the skin's own along that way.

    It is the same in a faded picture, where all tints lie nearer to each other.
    """
    few = key.skin[:: max(1, len(key.skin) // _FEW)]
    luma, *chroma = to_opponent(np.vstack([lips[None], key.skin_median[None], few])).T
    tints = np.stack(chroma, axis=1) / np.maximum(luma, float(_DARKEST))[:, None]
    off = tints - tints[1]
    far = float(np.linalg.norm(off[0]))
    spread = float(np.quantile(np.abs(off[2:] @ off[0]), _ONE_SIGMA)) / max(far, 1e-6)
    return far / max(spread, _LEAST_SPREAD)


def _whole(shown: Floats, lips: Bools, off_tint: float) -> Floats:
    """(h, w) how far lips are shown, where they are told by their shade: all of them when most are.

    shown: (h, w) as each node tells;  lips: (h, w) the nodes between their outlines;
    off_tint: of the skin's tint, how far lips are off it.
    """
    if not lips.any():
        return shown
    mostly = smoothstep(shown[lips].mean(keepdims=True), *_MOSTLY)
    by_shade = 1.0 - smoothstep(np.array([off_tint], np.float32), *_BY_TINT)
    return np.asarray(np.maximum(shown, mostly * by_shade), np.float32)


def _covered(tints: Floats, apart: float, outer: Bools, inner: Bools, gap: float) -> float:
    """How far a mouth's outline shows what lies around it, in [0, 1].

    tints: (h, w, 3);  apart: how far lips are off the skin;  outer, inner: (h, w) the nodes inside the lips' outlines;
    gap: nodes from the outline to the nearest that lies around it.
    """
    lips = (outer & ~inner).view(np.uint8)
    around = (cv2.dilate(outer.view(np.uint8), square(gap)) == 0).view(np.uint8)
    if not lips.any() or not around.any():
        return 0.0
    off = np.subtract(cv2.mean(tints, lips), cv2.mean(tints, around))
    return 1.0 - ramp(float(np.linalg.norm(off)) / apart, *_OFF_AROUND)


def _crossing(skin: Floats, lips: Floats, outer: Bools, inner: Bools, finger: float) -> Floats | None:
    """(h, w) of `skin` (h, w), how far nodes look like skin, that comes into a mouth across its lips; None without any.

    lips: (h, w) how far nodes show lips;  outer, inner: (h, w) the nodes inside the lips' outlines;
    finger: nodes, the width of the thinnest.
    """
    likely = skin > 0.5
    bare = likely & outer & ~inner & (lips < _NO_LIPS)
    side = max(1, round(finger))
    seeds = cv2.morphologyEx(bare.astype(np.uint8), cv2.MORPH_OPEN, block(side))
    if not seeds.any():
        return None
    _, labels = cv2.connectedComponents((likely & outer).astype(np.uint8))
    kept = np.isin(labels, np.unique(labels[seeds > 0]))
    return np.asarray(skin * cv2.GaussianBlur(kept.astype(np.float32), (0, 0), 1.0), np.float32)


def _off_skin(tints: Floats, skin: Floats, beside: Floats) -> Floats:
    """(h, w) how far tints (h, w, 3) are off that of the skin (3,) and off the luma of the skin `beside` (h, w)."""
    tint = np.linalg.norm(tints[..., :2] - skin[:2], axis=-1) / max(float(np.linalg.norm(skin[:2])), 1e-3)
    luma = (tints[..., 2] - beside) / _LUMA
    return np.asarray(np.hypot(tint / _OFF_TINT, luma / _OFF_LUMA), np.float32)


def _beside(plane: Floats, margin: float) -> Floats:
    """What a plane (h, w) would be if all of it were the skin along its border: its median and slopes there.

    Light from one side makes lips on that side as bright as skin on the other one.
    """
    h, w = plane.shape
    border = np.ones((h, w), np.bool_)
    wide = max(1, int(0.5 * margin))
    border[wide:-wide, wide:-wide] = False
    y, x = (np.arange(n, dtype=np.float32) - (n - 1) / 2 for n in (h, w))
    y = y[:, None]
    values = plane[border]
    middle = np.median(values)
    off = np.clip(values - middle, -_OTHER, _OTHER)
    # even about the middle, so that each slope is told alone
    x_border, y_border = (np.broadcast_to(along, (h, w))[border] for along in (x, y))
    slopes = [float(off @ at) / float(at @ at) for at in (x_border, y_border)]
    return np.asarray(middle + slopes[0] * x + slopes[1] * y, np.float32)


def _tints(coding: Coding, codes: Floats) -> Floats:
    """(…, 3) chroma over luma, and the logarithm of luma, of codes (…, 3), black and grey aside."""
    codes, a_level = coding.in_sdr(codes), np.float32(2.0 ** (coding.format.depth - 8))
    luma = np.maximum(codes[..., :1], _DARKEST * a_level)
    return np.asarray(np.concatenate([codes[..., 1:] / luma, _LUMA * np.log(luma)], axis=-1), np.float32)
