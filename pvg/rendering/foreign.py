"""What is coloured as no skin is stays as it is: letters, stickers, paint.

The map F moves any colour along with the skin's, and yellow letters over a face that is made pale would pale with it.
With m(Y) the chroma that is usual for the skin at a luma, M that of its middle, c the chroma of a pixel and e of
`tinge`,

    d = |c − m| / (max(|m|, 0.7 |M|) + 2 e)

is below 1.6 on skin, crimson ears, blush and the shade of a sky too, and above 2 on letters in plain colours. Between
both the matte fades. Grey has a d of about 1 and is left to `tinge`, lips may be painted in any red, and along the
matte's edge, where skin mixes with what is beside it, `edges` and `foreground` tell what is skin.
"""

from __future__ import annotations

import cv2
import numpy as np

from pvg._arrays import Bools, Bytes, Floats
from pvg.asset import FaceRecord
from pvg.face import Landmarks, layout
from pvg.looks import LookMap, SkinMap
from pvg.raster import SUBPIXEL_BITS, fixed_point
from pvg.rendering.map_tables import MapTables
from pvg.rendering.rgb_planes import opponent_matrix
from pvg.video import Frame, PixelFormat

# pixels, or of the face's width, from one pixel to the next that is looked at first: finer letters are not seen
_SEEN_PX, _SEEN = 6.0, 1 / 96
_EDGE_PX, _EDGE = 4.0, 0.012  # likewise: nearer to the matte's end nothing is told [by eye]
_MATTE = np.float32(0.3)  # of alpha, from which on a pixel lies in the matte
_HOLE = 0.03  # of the face's width: letters may leave holes in the matte
_LIPS = 0.04  # of the face's width around their outline that is theirs [by eye]
_NEIGHBOURS = np.ones((3, 3), np.uint8)


def own_tables(record: FaceRecord, pixel_format: PixelFormat) -> MapTables | None:
    """The tables of the map that leaves a face's skin as it is, which know its colours; None where it shows none.

    The same for all looks, so that none is drawn otherwise for one beside it.
    """
    skin = max((key.skin for key in record.key_frames), key=len)
    if not len(skin):
        return None
    own = LookMap(SkinMap.between(skin, skin.astype(np.float64)), 1.0, np.ones((1, 2), np.float32))
    return MapTables.of(own, pixel_format)


def without_foreign(
    frame: Frame, corner: tuple[int, int], alpha: Floats, tables: MapTables | None, landmarks: Landmarks
) -> Floats:
    """A matte without what is coloured as no skin is; `alpha` itself where there is nothing of it.

    corner: x, y of the source pixel that alpha (h, w) starts at, multiples of the chroma step;  tables, landmarks: of
    the face, the first by `own_tables`.
    """
    if tables is None:
        return alpha
    fine = max(2, 2 ** max(frame.format.chroma_log2))
    coarse = max(1, round(max(_SEEN_PX, _SEEN * landmarks.axes.width) / fine)) * fine
    seen = _in_matte(alpha, coarse)
    beyond = tables.foreign(_samples(frame, corner, alpha.shape, coarse), seen, ~seen)
    if not beyond.any() or not _foreign(frame, corner, alpha, tables, landmarks, coarse).any():
        return alpha  # as nearly always
    # letters are mixed with skin at their edges, and chroma is coded coarsely
    spread = cv2.dilate(_foreign(frame, corner, alpha, tables, landmarks, fine), _NEIGHBOURS)
    size = fine * spread.shape[1], fine * spread.shape[0]
    taken = cv2.resize(spread, size, interpolation=cv2.INTER_LINEAR)[: alpha.shape[0], : alpha.shape[1]]
    return np.asarray(alpha * (np.float32(1.0) - taken), np.float32)


def _foreign(
    frame: Frame, corner: tuple[int, int], alpha: Floats, tables: MapTables, landmarks: Landmarks, apart: int
) -> Floats:
    """(r, c) in [0, 1], how far pixels of a window are none of the skin's colours, 0 near the matte's end and beyond.

    apart: pixels from one that is looked at to the next, a multiple of the chroma step.
    """
    width = max(landmarks.axes.width, 1.0)
    matte = _in_matte(alpha, apart)
    filled = cv2.morphologyEx(matte.view(np.uint8), cv2.MORPH_CLOSE, _square(_HOLE * width / apart))
    inside = np.asarray(cv2.erode(filled, _square(max(_EDGE_PX, _EDGE * width) / apart)), np.bool_)
    outline = (landmarks.points[layout.LIPS_OUTER] - np.array(corner, np.float32)) / np.float32(apart)
    lips = np.zeros(matte.shape, np.uint8)
    cv2.fillPoly(lips, [fixed_point(outline)], 1, shift=SUBPIXEL_BITS)
    around = np.asarray(cv2.dilate(lips, _square(_LIPS * width / apart)), np.bool_)
    return tables.foreign(_samples(frame, corner, alpha.shape, apart), inside, around)


def _in_matte(alpha: Floats, apart: int) -> Bools:
    """(r, c) whether every `apart`-th pixel of a window (h, w) lies in its matte."""
    return np.asarray(np.ascontiguousarray(alpha[::apart, ::apart]) > _MATTE)


def _samples(frame: Frame, corner: tuple[int, int], shape: tuple[int, ...], apart: int) -> Floats:
    """(3, r, c) codes of luma and chroma of every `apart`-th pixel of a window (h, w)."""
    (left, upper), (rows, columns) = corner, shape
    codes = np.empty((3, -(-rows // apart), -(-columns // apart)), np.float32)
    for p, plane in enumerate(frame.planes[:3]):
        log2x, log2y = frame.format.chroma_log2 if p and not frame.format.is_rgb else (0, 0)
        window = plane[upper >> log2y : -(-(upper + rows) >> log2y), left >> log2x : -(-(left + columns) >> log2x)]
        codes[p] = window[:: apart >> log2y, :: apart >> log2x]
    if not frame.format.is_rgb:
        return codes
    opponent = np.einsum("pq,qrc->prc", opponent_matrix(frame.format), codes)
    return np.ascontiguousarray(opponent + frame.format.opponent.offset[:, None, None], np.float32)


def _square(reach: float) -> Bytes:
    """A kernel that reaches so many samples to each side, one at least."""
    return np.ones((2 * max(1, round(reach)) + 1,) * 2, np.uint8)
