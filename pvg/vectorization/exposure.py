"""Light that changes while a face is followed: when a new key frame is due.

One key frame's colours serve while the face is lit alike. An exposure that runs up or down leaves them behind: what
was moved from dim to bright is moved again by what the source itself gained, until all is white. So the face of each
row is compared with the key's, cell by cell in its own coordinates, and where nearly all of its open skin has become
brighter or darker alike, and stays so, its colours are fitted anew.

Light may change its colour and not its brightness, as on a stage: a key frame is due, too, where nearly all of the skin
has turned by the same tint, once that has come to rest.

A hand, a shadow's edge or a turned head changes some cells and not others, an expression few, noise none on the median;
what covers the whole face changes its pattern. None of them makes a key frame.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from pvg.face import Landmarks
from pvg.picture import Picture
from pvg.skin import Matte
from pvg.vectorization.face_patch import SAME_COLOUR, SAME_LIGHT, FacePatch

_CHANGE = 0.182  # of log luma against the key's, ±20 %: a new key frame is due
# of the logarithms of R / G and B / G against the key's: a new key frame is due [measured: in clips of steady light
# 0.04 at most], and what rows that follow may differ by in a colour that is at rest
_TINT, _TINT_RESTS = 0.2, 0.08
_SETTLED = 0.068  # of log luma: what a change that has come to rest may be off its last key
_REST = 0.01  # of log luma over the rows looked ahead: the light is at rest
_NO_REST = 2  # rows after a key that count as light which leaves it at once
LOOKAHEAD = 8  # rows that a change must last; a flash is light and no key
_LEAST_GAP = 6  # rows between two keys: between them colours go over linearly, as a ramp does
_FREE_KEYS, _ROWS_A_KEY = 6, 250  # keys that a track may have beside its first: and one every so many rows
_PATIENCE = 100  # rows that a change must have lasted once they are spent: flicker stops, a new level is still found


@dataclass(frozen=True, eq=False)
class Sight:
    """A row of a track as it was seen.

    patch: what its light is told by, None where it tells nothing: of a face that is turned away, not sure, or veiled.
    """

    row: int
    picture: Picture
    landmarks: Landmarks
    matte: Matte
    patch: FacePatch | None


@dataclass(frozen=True, eq=False)
class DueKey:
    """A key frame that is due.

    since: the last row that the colours before it serve alone, None when there are none;
    main_from: the row from which the track's main key, which lies ahead, serves until this one: its light was already
    there; None when another one serves there.
    """

    sight: Sight
    since: int | None
    main_from: int | None


@dataclass
class ExposureWatch:
    """Watches a track's light, rows in order, and tells when a key frame is due.

    main_row, main: the track's main key frame, which may lie ahead;
    main_since: see `DueKey.since`, of the main key, once its row has passed.
    """

    main_row: int
    main: FacePatch
    main_since: int | None = field(default=None, init=False)
    _waiting: deque[Sight] = field(default_factory=deque, init=False)
    _key: FacePatch | None = field(default=None, init=False)
    _key_row: int | None = field(default=None, init=False)  # None while the main key, still ahead, serves
    _same_row: int | None = field(default=None, init=False)  # the last row in the light of the key …
    _same_gain: float = field(default=0.0, init=False)  # … and how far it had moved there, log luma
    _same_colour_row: int | None = field(default=None, init=False)  # the last row in light of the key's colour
    _rows_passed: int = field(default=0, init=False)
    _keys_made: int = field(default=0, init=False)
    _rows_changed: int = field(default=0, init=False)  # rows since the light left the key's

    def see(self, sight: Sight) -> list[DueKey]:
        """The key frames that are due now that the next row is seen."""
        self._waiting.append(sight)
        return self._pass() if len(self._waiting) > LOOKAHEAD else []

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
        tint = _tint(sight, key)
        if sight.row == self.main_row:
            self.main_since = self._began(sight.row, gain, tint)
            self._serve(self.main, sight.row)
            return []
        if abs(gain) <= SAME_LIGHT:
            self._same_row, self._same_gain = sight.row, gain
        if tint <= SAME_COLOUR:
            self._same_colour_row = sight.row
        if not (np.isnan(gain) and np.isnan(tint)):
            self._rows_changed = self._rows_changed + 1 if abs(gain) > _CHANGE or tint > _TINT else 0
        if not self._may_be_due(sight.row) or not (self._is_due(gain, key) or self._is_due_by_colour(sight, tint)):
            return []
        since = self._began(sight.row, gain, tint)
        # a main key that lies ahead and was true until here serves from there
        main_from = since if self._key_row is None else None
        self._keys_made += 1
        self._serve(sight.patch, sight.row)
        return [DueKey(sight, since, main_from)]

    def _serve(self, key: FacePatch | None, row: int) -> None:
        self._key, self._key_row, self._same_row, self._same_gain, self._rows_changed = key, row, row, 0.0, 0
        self._same_colour_row = row

    def _began(self, row: int, gain: float, tint: float) -> int | None:
        """The row where the light began to leave the key's on its way to the gain and the tint over it in a row.

        Light that changes steadily had left it a little by the last row that counts as in it: so the line through both
        rows' gains is followed back to where it was none. Colours that set off later would have to hurry.
        """
        if tint > _TINT:
            return self._key_row if self._same_colour_row is None else self._same_colour_row
        if self._same_row is None:
            return self._key_row
        if not (gain * self._same_gain > 0.0 and abs(gain) > abs(self._same_gain)):  # a NaN neither
            return self._same_row
        key_row = self._key_row or 0
        began = self._same_row - round((row - self._same_row) * self._same_gain / (gain - self._same_gain))
        return began if began > key_row + _NO_REST else key_row

    def _may_be_due(self, row: int) -> bool:
        """Whether a row is far enough from the key and the track may have one more."""
        if self._key_row is not None and row - self._key_row < _LEAST_GAP:
            return False
        spent = self._keys_made >= _FREE_KEYS + self._rows_passed / _ROWS_A_KEY
        return not spent or self._rows_changed >= _PATIENCE

    def _is_due(self, gain: float, key: FacePatch) -> bool:
        if not abs(gain) > (_CHANGE if self._keys_made == 0 else _SETTLED):  # a NaN neither
            return False
        gains = [ahead.patch.gain_over(key) for ahead in self._waiting if ahead.patch is not None]
        at_end = len(self._waiting) < LOOKAHEAD
        if abs(gain) > _CHANGE:
            lasting = [g for g in gains if g * np.sign(gain) > _CHANGE]
            return len(lasting) >= LOOKAHEAD - 2 or (at_end and not self._waiting and self._keys_made > 0)
        # what is left of a change that has come to rest
        rest = [g for g in gains if abs(g - gain) <= _REST]
        return not self._waiting if at_end else len(rest) == LOOKAHEAD

    def _is_due_by_colour(self, sight: Sight, tint: float) -> bool:
        if not tint > _TINT:
            return False
        rest = [ahead for ahead in self._waiting if ahead.patch is not None and _tint(ahead, sight.patch) < _TINT_RESTS]
        return len(rest) >= LOOKAHEAD - 2


def _tint(sight: Sight, key: FacePatch | None) -> float:
    """How far the light's colour in a row is off the key's; NaN when it cannot be told."""
    if sight.patch is None or key is None:
        return float("nan")
    return float(np.abs(sight.patch.tint_over(key)).max())
