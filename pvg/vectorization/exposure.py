"""Light that changes while a face is followed: when a new key frame is due.

One key frame's colours serve while the face is lit alike. An exposure that runs up or down leaves them behind: what
was moved from dim to bright is moved again by what the source itself gained, until all is white. So the face of each
row is compared with the key's, cell by cell in its own coordinates, and where nearly all of its open skin has become
brighter or darker alike, and stays so, its colours are fitted anew.

A hand, a shadow's edge or a turned head changes some cells and not others, an expression few, noise none on the median;
what covers the whole face changes its pattern. None of them makes a key frame.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import cv2
import numpy as np

from pvg._arrays import Bools, Floats
from pvg.face import Landmarks
from pvg.picture import Picture, rms_contrast
from pvg.raster import centers_in_unit, scaled
from pvg.skin import Matte
from pvg.vectorization.key_frames import shows_well
from pvg.vectorization.veil import Veil

_CHANGE = 0.182  # of log luma against the key's, ±20 %: a new key frame is due
_SAME = 0.047  # of log luma: still the key's own light
_SETTLED = 0.068  # of log luma: what a change that has come to rest may be off its last key
_REST = 0.01  # of log luma over the rows looked ahead: the light is at rest
_NO_REST = 2  # rows after a key that count as light which leaves it at once
LOOKAHEAD = 8  # rows that a change must last; a flash is light and no key
_LEAST_GAP = 6  # rows between two keys: between them colours go over linearly, as a ramp does
_FREE_KEYS, _ROWS_A_KEY = 6, 250  # keys that a track may have beside its first: and one every so many rows
_PATIENCE = 100  # rows that a change must have lasted once they are spent: flicker stops, a new level is still found

_SIDE, _OVERSAMPLED = 24, 3  # cells of a face in its own coordinates, and pixels read a side of each
_PLACES = np.array([(0.3, 0.32), (0.7, 0.32), (0.5, 0.75)], np.float32)  # where eyes and mouth lie
_DARK = 4.0  # levels added to both sides of a ratio
_LEAST_LUMA = 14.0  # levels of the median that colours can be fitted at
_LEAST_SEEN = 0.6  # of the key's open cells
_ALIKE = 0.8  # of the cells seen that changed by half of the median's change or more
_LIKENESS = 0.75  # correlation of the pattern with the key's: less and something else is seen


@dataclass(frozen=True, eq=False)
class FacePatch:
    """A face in its own coordinates.

    luma: (SIDE, SIDE) float32, 0-255;  skin: (SIDE, SIDE) bool, open skin within the face; SIDE is 24.
    """

    luma: Floats
    skin: Bools

    @classmethod
    def of(cls, picture: Picture, landmarks: Landmarks, matte: Matte) -> FacePatch:
        """The patch of a face in a picture, eyes and mouth where they always are."""
        marks = landmarks.eyes_and_mouth
        places, fine = np.asarray(_PLACES * (_SIDE - 1), np.float32), _SIDE * _OVERSAMPLED
        to_source = cv2.getAffineTransform(scaled(places, float(_OVERSAMPLED)), marks)
        read = picture.warp(np.asarray(to_source, np.float64), (fine, fine))
        rgb = cv2.resize(read, (_SIDE, _SIDE), interpolation=cv2.INTER_AREA)
        to_cells = cv2.getAffineTransform(places, matte.raster.to_cells(marks))
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        alpha = cv2.warpAffine(matte.alpha, to_cells, (_SIDE, _SIDE), flags=flags)
        return cls(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY).astype(np.float32), (alpha > 0.9 * 255) & _FACE)

    def gain_over(self, key: FacePatch) -> float:
        """The logarithm of how much brighter the open skin is than on the key's patch; NaN when it cannot be told."""
        both = self.skin & key.skin
        if both.sum() < max(1.0, _LEAST_SEEN * key.skin.sum()) or np.median(self.luma[both]) < _LEAST_LUMA:
            return float("nan")
        change = np.log((self.luma[both] + _DARK) / (key.luma[both] + _DARK))
        gain = float(np.median(change))
        if abs(gain) > _SAME:
            alike = np.mean(change * np.sign(gain) >= abs(gain) / 2)
            with np.errstate(invalid="ignore", divide="ignore"):  # a flat face has no pattern: NaN
                likeness = np.corrcoef(self.luma[_FACE], key.luma[_FACE])[0, 1]
            if alike < _ALIKE or not likeness >= _LIKENESS:
                return float("nan")
        return gain


def _ellipse() -> Bools:
    """(SIDE, SIDE) bool, the cells of a patch within the face."""
    places = centers_in_unit(_SIDE)
    return np.asarray(((places - 0.5) / 0.42) ** 2 + ((places[:, None] - 0.5) / 0.48) ** 2 < 1)


_FACE = _ellipse()


@dataclass(frozen=True, eq=False)
class Sight:
    """A row of a track as it was seen.  patch: None where the face is turned away or not sure."""

    row: int
    picture: Picture
    landmarks: Landmarks
    matte: Matte
    patch: FacePatch | None


@dataclass(frozen=True, eq=False)
class DueKey:
    """A key frame that is due.

    since: the last row that the colours before it serve alone, None when there are none;
    main_from: the row that the track's main key must serve from, as well as where it lies, None when it need not.
    """

    sight: Sight
    since: int | None
    main_from: int | None


@dataclass
class ExposureWatch:
    """Watches a track's light, rows in order, and tells when a key frame is due.

    main_row, main: the track's main key frame, which may lie ahead;
    main_contrast: that of its whole picture, None where it is not known;
    transmission: how far the face shows through in the row that was seen last, in [0, 1], see `veil`;
    main_since: see `DueKey.since`, of the main key, once its row has passed.
    """

    main_row: int
    main: FacePatch
    main_contrast: float | None = None
    transmission: float = field(default=1.0, init=False)
    main_since: int | None = field(default=None, init=False)
    _waiting: deque[Sight] = field(default_factory=deque, init=False)
    _key: FacePatch | None = field(default=None, init=False)
    _key_row: int | None = field(default=None, init=False)  # None while the main key, still ahead, serves
    _same_row: int | None = field(default=None, init=False)  # the last row in the light of the key …
    _same_gain: float = field(default=0.0, init=False)  # … and how far it had moved there, log luma
    _rows_passed: int = field(default=0, init=False)
    _keys_made: int = field(default=0, init=False)
    _rows_changed: int = field(default=0, init=False)  # rows since the light left the key's
    _face_contrast: float = field(default=1.0, init=False)  # when it was last seen well
    _veil: Veil | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        if self.main_contrast is not None:
            luma = self.main.luma[_FACE]
            self._veil = Veil(rms_contrast(luma), self.main_contrast, float(luma.mean()))

    def see(
        self,
        row: int,
        picture: Picture,
        landmarks: Landmarks,
        matte: Matte,
        score: float,
        pose: Floats,
        picture_contrast: float | None = None,
    ) -> list[DueKey]:
        """The key frames that are due now that the next row is seen.

        score, pose: see `shows_well`;  picture_contrast: of its whole picture, None where that is not known.
        """
        sure = bool(shows_well(np.array(score, np.float32), pose))
        patch = FacePatch.of(picture, landmarks, matte) if sure else None
        self.transmission = self._transmission(patch, picture_contrast)
        if self.transmission < 1.0:  # a veil is no light
            patch = None
        self._waiting.append(Sight(row, picture, landmarks, matte, patch))
        return self._pass() if len(self._waiting) > LOOKAHEAD else []

    def _transmission(self, patch: FacePatch | None, picture_contrast: float | None) -> float:
        if picture_contrast is None or self._veil is None:
            return 1.0
        if patch is not None:
            self._face_contrast = rms_contrast(patch.luma[_FACE])
        return self._veil.transmission(self._face_contrast, picture_contrast)

    def end(self) -> list[DueKey]:
        """The key frames that are due when the track has ended."""
        due = []
        while self._waiting:
            due += self._pass()
        return due

    def _pass(self) -> list[DueKey]:
        """Judge the first row that waits, by those behind it."""
        sight = self._waiting.popleft()
        self._rows_passed += 1
        key = self._key or self.main
        gain = float("nan") if sight.patch is None else sight.patch.gain_over(key)
        if sight.row == self.main_row:
            self.main_since = self._began(sight.row, gain)
            self._serve(self.main, sight.row)
            return []
        if np.isnan(gain):
            return []
        if abs(gain) <= _SAME:
            self._same_row, self._same_gain = sight.row, gain
        self._rows_changed = self._rows_changed + 1 if abs(gain) > _CHANGE else 0
        if not self._is_due(sight.row, gain, key):
            return []
        since = self._began(sight.row, gain)
        # a main key that lies ahead and was true until here serves from there
        main_from = since if self._key_row is None else None
        self._keys_made += 1
        self._serve(sight.patch, sight.row)
        return [DueKey(sight, since, main_from)]

    def _serve(self, key: FacePatch | None, row: int) -> None:
        self._key, self._key_row, self._same_row, self._same_gain, self._rows_changed = key, row, row, 0.0, 0

    def _began(self, row: int, gain: float) -> int | None:
        """The row where the light began to leave the key's on its way to the gain over it in a row.

        Light that runs steadily had moved a little in the last row that counts as the key's: from there back on the
        same line, for colours that set off late would have to hurry.
        """
        if self._same_row is None:
            return self._key_row
        if not (gain * self._same_gain > 0.0 and abs(gain) > abs(self._same_gain)):  # a NaN neither
            return self._same_row
        key_row = self._key_row or 0
        began = self._same_row - round((row - self._same_row) * self._same_gain / (gain - self._same_gain))
        return began if began > key_row + _NO_REST else key_row

    def _is_due(self, row: int, gain: float, key: FacePatch) -> bool:
        if self._key_row is not None and row - self._key_row < _LEAST_GAP:
            return False
        if self._keys_made >= _FREE_KEYS + self._rows_passed / _ROWS_A_KEY and self._rows_changed < _PATIENCE:
            return False
        if abs(gain) <= (_CHANGE if self._keys_made == 0 else _SETTLED):
            return False
        gains = [ahead.patch.gain_over(key) for ahead in self._waiting if ahead.patch is not None]
        at_end = len(self._waiting) < LOOKAHEAD
        if abs(gain) > _CHANGE:
            lasting = [g for g in gains if g * np.sign(gain) > _CHANGE]
            return len(lasting) >= LOOKAHEAD - 2 or (at_end and not self._waiting and self._keys_made > 0)
        # what is left of a change that has come to rest
        rest = [g for g in gains if abs(g - gain) <= _REST]
        return not self._waiting if at_end else len(rest) == LOOKAHEAD
