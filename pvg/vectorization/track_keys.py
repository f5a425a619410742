"""The key frames of one track: begun row by row, their colours fitted in a thread, told when the track has ended."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Future, wait
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pvg._arrays import Floats
from pvg.asset import KeyFrame
from pvg.curves import table_labels
from pvg.errors import NoFaceError
from pvg.face import Landmarks
from pvg.picture import Picture, cut_out
from pvg.skin import Matte
from pvg.vectorization.curve_places import curve_positions
from pvg.vectorization.exposure import DueKey
from pvg.vectorization.key_colors import fit_key_frame
from pvg.vectorization.part_colors import shows_lips, with_lips_of
from pvg.vectorization.row_colors import RowColors
from pvg.vectorization.shared_threads import SharedThreads


class TrackKeys:
    """Fits the key frames of one track. Rows are counted from the track's first."""

    def __init__(self, first: int, main_row: int, threads: SharedThreads, seed: int) -> None:
        """Begin without any.

        first: the track's first frame;  main_row: that of its key view;  seed: of the pixels that the fit draws;
        threads: their `fits` are open until the last question is answered.
        """
        self._first = first
        self._main_row = main_row
        self._threads = threads
        self._seed = seed
        self._fits: dict[int, Future[KeyFrame | None]] = {}  # by row; None: no skin there
        self._since: dict[int, int | None] = {}  # by row: `KeyFrame.since`, counted as rows are
        self._main_from: int | None = None  # see `DueKey`
        self._lips: RowColors | None = None  # of the first row that shows lips

    @property
    def last_row(self) -> int:
        """The last row that is a key frame."""
        return max(self._fits)

    @property
    def lips_known(self) -> bool:
        """Whether some row has shown lips."""
        return self._lips is not None

    def look_for_lips(self, colors: RowColors) -> None:
        """Keep the colours of a row if it is the first that shows lips."""
        if self._lips is None and colors.show_lips:
            self._lips = colors

    def begin(self, row: int, picture: Picture, landmarks: Landmarks, matte: Matte) -> None:
        """Make a row a key frame: begin to fit its colours."""
        colors = RowColors.of(picture, landmarks, matte)
        self.look_for_lips(colors)
        frame = self._first + row
        self._fits[row] = self._threads.fits.submit(_key_frame, frame, picture, landmarks, matte, colors, self._seed)

    def begin_due(self, due: Sequence[DueKey]) -> None:
        """Begin the key frames that a change of light asks for."""
        for key in due:
            sight = key.sight
            self.begin(sight.row, sight.picture, sight.landmarks, sight.matte)
            self._since[sight.row] = key.since
            if key.main_from is not None:
                self._main_from = key.main_from

    def main_serves_since(self, since: int | None) -> None:
        """Say from where colours go over to the main key frame's, see `DueKey.since`."""
        self._since[self._main_row] = since

    def wait(self) -> None:
        """Wait until all that was begun is fitted: tracks may end faster than that."""
        wait(self._fits.values())

    def have_skin(self) -> bool:
        """Whether the mask finds skin in one of them; without there is nothing to vectorise."""
        return any(fit.result() is not None for fit in self._fits.values())

    def main(self) -> KeyFrame:
        """The key view's, or the first one in whose frame there is skin. Raises as `all`."""
        return self._fits[self._main_row].result() or self.all()[0]

    def all(self) -> tuple[KeyFrame, ...]:
        """Those in whose frames there is skin, by frame; there is one, see `have_skin`.

        Raises SolverError when the colours of one cannot be fitted.
        """
        keys = {row: key for row, fit in self._fits.items() if (key := fit.result()) is not None}
        if self._main_from is not None:
            keys[self._main_from] = replace(keys[self._main_row], frame=self._first + self._main_from)
        keys = {row: self._with_lips(key) for row, key in keys.items()}
        since = {row: None if last is None else self._first + last for row, last in self._since.items()}
        first = min(keys)
        return tuple(replace(keys[row], since=None if row == first else since.get(row)) for row in sorted(keys))

    def _with_lips(self, key: KeyFrame) -> KeyFrame:
        """A key frame with the lips of another row where it shows none itself."""
        if self._lips is None or not len(key.skin) or shows_lips(key.parts):
            return key
        return replace(key, parts=with_lips_of(key.parts, key.skin, self._lips.parts, self._lips.skin))


def _key_frame(
    frame: int, picture: Picture, landmarks: Landmarks, matte: Matte, row_colors: RowColors, seed: int
) -> KeyFrame | None:
    """A frame as a key frame, its boundary colours fitted (eq. 3); None where the matte shows no skin."""
    positions = curve_positions(landmarks, matte)
    rgb, corner = cut_out(picture, matte.raster.box)
    try:
        colors, visible = fit_key_frame(rgb, matte.crop(corner), positions - corner, landmarks.axes.width, seed)
    except NoFaceError:
        return None
    nearest = _nearest_on_skin(row_colors.places, positions)
    return KeyFrame(frame, colors, visible, row_colors.skin, nearest, row_colors.parts)


def _nearest_on_skin(places: Floats, positions: Floats) -> NDArray[np.int16]:
    """(N,) the sample on a skin curve, of those at `positions` (S, 2), that is nearest to each place (N, 2)."""
    on_skin = np.flatnonzero(table_labels().on_open_skin)
    gaps = places[:, None] - positions[on_skin]
    return np.asarray(on_skin[np.argmin((gaps**2).sum(axis=2), axis=1)], np.int16)
