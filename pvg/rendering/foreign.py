"""What is coloured as no skin is stays as it is: letters, stickers, paint.

The map F moves any colour along with the skin's, and yellow letters over a face that is made pale would pale with it.
With m(Y) the chroma that is usual for the skin at a luma, M that of its middle, c the chroma of a pixel and e of
`tinge`,

    d = |c − m| / (max(|m|, 0.7 |M|) + 2 e)

is below 1.6 on skin, crimson ears, blush and the shade of a sky too, and above 2 on letters in plain colours. Between
both the matte fades. Light of another colour moves skin as far, but not by a step: c must be as far, too, from what
the skin nearby has beyond m, by the larger of both chromas, and where there is no skin nearby nothing is told. Skin
that is lit by two lamps differs more than one makes it differ, and what is none of it must be farther off. Grey has a
d of about 1 and is left to `tinge`, lips may be painted in any red, and along the matte's edge, where skin mixes with
what is beside it, `edges` and `foreground` tell what is skin.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np

from pvg._arrays import Bools, Floats
from pvg.asset import FaceRecord
from pvg.face import Landmarks, layout
from pvg.looks import LookMap, SkinMap
from pvg.raster import SUBPIXEL_BITS, fixed_point, square
from pvg.rendering.coding import Coding
from pvg.rendering.map_tables import MapTables
from pvg.rendering.rgb_planes import opponent_matrix
from pvg.video import Frame, PixelFormat

# pixels, or of the face's width, from one pixel to the next that is looked at first: a word has some of them
_SEEN_PX, _SEEN = 4.0, 1 / 144
_BESIDE_PX, _BESIDE = 6.0, 1 / 96  # likewise, from letters to what is no longer mixed with them [by eye]
_EDGE_PX, _EDGE = 4.0, 0.012  # likewise: nearer to the matte's end nothing is told [by eye]
_MATTE = np.float32(0.3)  # of alpha, from which on a pixel lies in the matte
_HOLE = 0.03  # of the face's width: letters may leave holes in the matte
_AROUND = 0.08  # of the face's width: spread of the mean of skin around a pixel [by eye: larger than letters]
_LEAST = np.float32(0.01)  # of such a mean's weights: with less there is no skin around
_LIPS = 0.04  # of the face's width around their outline that is theirs [by eye]
# of d, in the mean from a part to what is beside it: with less there is no edge [measured: lamps 0.8 to 0.95, letters
# 1.3 to 5]
_STEP = 1.2
# of d, that most of a face's own skin is off at most where it is lit by one lamp [measured: 0.3 in the median of 130
# faces, 0.73 at most; 0.95 to 1.32 of four under two lamps]
_ONE_LAMP = 0.75
_NEIGHBOURS = np.ones((3, 3), np.uint8)


def skin_of(record: FaceRecord, frame: int) -> Floats | None:
    """(n, 3) the face's skin as the key frame has it that serves a frame, under whose lamp it is; None without any.

    One that shows none has that of the key frame that shows most.
    """
    serving = record.key_frame_of(frame).skin
    skin = serving if len(serving) else max((key.skin for key in record.key_frames), key=len)
    return skin if len(skin) else None


def own_tables(skin: Floats, pixel_format: PixelFormat) -> MapTables:
    """The tables of the map that leaves skin (n, 3) as it is, which know its colours and how far they are apart.

    The same for all looks, so that none is drawn otherwise for one beside it.
    """
    own = LookMap(SkinMap.between(skin, skin.astype(np.float64)), 1.0, np.ones((1, 5), np.float32))
    tables = MapTables.of(own, pixel_format)
    codes = (Coding(pixel_format).colors(skin) + tables.offset).T[:, :, None]
    off = np.hypot(*tables.off_usual_in_d(np.ascontiguousarray(codes, np.float32)))
    return replace(tables, farther=max(1.0, float(np.percentile(off, 95)) / _ONE_LAMP))


def without_foreign(
    frame: Frame, corner: tuple[int, int], alpha: Floats, tables: MapTables | None, landmarks: Landmarks
) -> Floats:
    """A matte without what is coloured as no skin is; `alpha` itself where there is nothing of it.

    corner: x, y of the source pixel that alpha (h, w) starts at, multiples of the chroma step;  tables, landmarks: of
    the face, the first by `own_tables`.
    """
    if tables is None:
        return alpha
    fine = max(2, frame.format.chroma_step)
    coarse = max(1, round(max(_SEEN_PX, _SEEN * landmarks.axes.width) / fine)) * fine
    window = _Window(frame, corner, alpha, tables, landmarks, coarse)
    if not window.may_be_foreign or not (found := replace(window, apart=fine).foreign()).any():
        return alpha  # as nearly always
    # letters are mixed with skin at their edges, and chroma is coded coarsely
    spread = cv2.dilate(found, _NEIGHBOURS)
    size = fine * spread.shape[1], fine * spread.shape[0]
    taken = cv2.resize(spread, size, interpolation=cv2.INTER_LINEAR)[: alpha.shape[0], : alpha.shape[1]]
    return np.asarray(alpha * (np.float32(1.0) - taken), np.float32)


@dataclass(frozen=True, eq=False)
class _Window:
    """A face's window in a frame, of which every so many pixels are looked at.

    apart: pixels from one that is looked at to the next, a multiple of the chroma step. For the rest see
    `without_foreign`.
    """

    frame: Frame
    corner: tuple[int, int]
    alpha: Floats
    tables: MapTables
    landmarks: Landmarks
    apart: int

    @property
    def may_be_foreign(self) -> bool:
        """Whether any colour in the matte, taken by itself, is none of the skin's."""
        return bool(self.tables.foreign(self._codes, self._in_matte).any())

    def foreign(self) -> Floats:
        """(r, c) in [0, 1], how far pixels are no skin up to an edge, 0 near the matte's end and beyond."""
        alone = self.tables.foreign(self._codes, self._inside, self._lips)
        if not alone.any():
            return alone  # as of lips in a plain red, for which a face is looked at often
        blue, red, known = self._around()
        inside = self._inside & (known > 0.5)
        found = self.tables.foreign(self._codes, inside, self._lips, np.stack([blue, red]))
        return found * self._apart_by_a_step(found, inside) if found.any() else found

    def _around(self) -> Floats:
        """(3, r, c) how far skin around each pixel is off its usual chroma, and from 0 to 1 whether there is any."""
        mixed = cv2.dilate(self.tables.foreign(self._codes, self._inside), square(self._beside))
        skin = np.asarray(self._inside & ~self._lips & (mixed == 0), np.float32)
        rows, columns = skin.shape
        size = -(-columns // self._beside), -(-rows // self._beside)
        few = [
            cv2.resize(one, size, interpolation=cv2.INTER_AREA)
            for one in (skin, *(skin * self.tables.off_usual(self._codes)))
        ]
        sigma = max(1.0, _AROUND * self._width / (self._beside * self.apart))
        mass, *sums = (cv2.GaussianBlur(one, (0, 0), sigma) for one in few)
        around = (*(one / np.maximum(mass, _LEAST) for one in sums), (mass > _LEAST).astype(np.float32))
        return np.stack([cv2.resize(one, (columns, rows), interpolation=cv2.INTER_LINEAR) for one in around])

    def _apart_by_a_step(self, found: Floats, known: Bools) -> Bools:
        """(r, c) whether what is `found` to be foreign is of a part that ends at an edge.

        What goes over into other colours is skin in the light of a lamp.  known: (r, c) where steps can be told.
        """
        every = (found > 0).view(np.uint8)
        x, y, w, h = cv2.boundingRect(every)
        far = 2 * self._beside  # what is beside a part, and what that is measured by
        box = slice(max(y - far, 0), y + h + far), slice(max(x - far, 0), x + w + far)
        part = every[box]
        count, labels = cv2.connectedComponents(part, connectivity=8)
        beside = cv2.dilate(labels.astype(np.float32), square(self._beside)).astype(np.int32) * (part == 0)
        ring = (beside > 0) & (known & ~self._lips)[box]
        steps = self._steps_to(part.astype(np.float32), self._codes[:, *box])[ring]
        seen, step = (np.bincount(beside[ring], one, count) for one in (None, steps))
        kept = step >= _STEP * seen
        kept[0] = False
        apart = np.zeros(found.shape, np.bool_)
        apart[box] = kept[labels]
        return apart

    def _steps_to(self, part: Floats, codes: Floats) -> Floats:
        """(r, c) how far each pixel is off the mean of those of a part (r, c) that lie near, as d is measured.

        codes: (3, r, c) luma and chroma.
        """
        off = self.tables.off_usual_in_d(codes)
        side = 2 * self._beside + 1
        mass, *sums = (cv2.blur(one, (side, side)) for one in (part, *(part * off)))
        return np.asarray(np.hypot(*(off - np.stack(sums) / np.maximum(mass, np.float32(1e-6)))), np.float32)

    @property
    def _beside(self) -> int:
        """How many of the pixels that are looked at lie between a letter and what is not mixed with it."""
        return max(1, round(max(_BESIDE_PX, _BESIDE * self._width) / self.apart))

    @property
    def _width(self) -> float:
        return max(self.landmarks.axes.width, 1.0)

    @cached_property
    def _in_matte(self) -> Bools:
        """(r, c) whether each pixel that is looked at lies in the matte."""
        return np.asarray(np.ascontiguousarray(self.alpha[:: self.apart, :: self.apart]) > _MATTE)

    @cached_property
    def _inside(self) -> Bools:
        """(r, c) what lies in the matte, holes and all, and not near its end."""
        hole, edge = _HOLE * self._width, max(_EDGE_PX, _EDGE * self._width)
        filled = cv2.morphologyEx(self._in_matte.view(np.uint8), cv2.MORPH_CLOSE, square(hole / self.apart))
        return np.asarray(cv2.erode(filled, square(edge / self.apart)), np.bool_)

    @cached_property
    def _lips(self) -> Bools:
        """(r, c) what lies on the lips or beside them."""
        outline = self.landmarks.points[layout.LIPS_OUTER] - np.array(self.corner, np.float32)
        lips = np.zeros(self._in_matte.shape, np.uint8)
        cv2.fillPoly(lips, [fixed_point(outline / np.float32(self.apart))], 1, shift=SUBPIXEL_BITS)
        return np.asarray(cv2.dilate(lips, square(_LIPS * self._width / self.apart)), np.bool_)

    @cached_property
    def _codes(self) -> Floats:
        """(3, r, c) luma and chroma."""
        (left, upper), (rows, columns), form = self.corner, self.alpha.shape, self.frame.format
        codes = np.empty((3, *self._in_matte.shape), np.float32)
        for p in range(3):
            part, (log2x, log2y) = self.frame.over(p, (left, upper, left + columns, upper + rows)), form.log2_of(p)
            codes[p] = part[:: self.apart >> log2y, :: self.apart >> log2x]
        if not form.is_rgb:
            return codes
        opponent = np.einsum("pq,qrc->prc", opponent_matrix(form), codes)
        return np.ascontiguousarray(opponent + form.opponent.offset[:, None, None], np.float32)
