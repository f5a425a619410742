"""One face of a clip while it is being vectorised: its skin followed, its colours fitted, its frames written."""

from __future__ import annotations

from collections import deque
from concurrent.futures import Future, wait
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pvg._arrays import Bytes, Floats
from pvg.asset import AssetWriter, FaceRecord, FaceSummary, KeyFrame
from pvg.curves import boundary_points, boundary_radius, place, table_labels
from pvg.errors import NoFaceError
from pvg.face import FaceAxes, Landmarks
from pvg.landmarks import FaceShape, FaceTrack, frontal_ratios
from pvg.picture import Picture
from pvg.skin import (
    BodyTracker,
    MaskMethod,
    Matte,
    MatteConsensus,
    NetworkOutput,
    Scene,
    SkinTracker,
    fit_skin_model,
    scene_raster,
)
from pvg.vectorization.exposure import DueKey, ExposureWatch, FacePatch
from pvg.vectorization.key_colors import fit_key_frame
from pvg.vectorization.key_frames import good_rows
from pvg.vectorization.open_skin import skin_sample
from pvg.vectorization.part_colors import part_colors, shows_lips, with_lips_of, without_covered_lips
from pvg.vectorization.plausible import doubts
from pvg.vectorization.shared_threads import SharedThreads
from pvg.vectorization.stretch import KeyView, Stretch, rows_between

ADVISED_FACE_PX = 200  # the paper's least face size
_SAMPLE_MARGIN = 0.06  # of the face's width: reach of what smooths the sampled skin
_PLACE_EVERY = 4  # frames from one place of a face that is kept to the next: others' bodies end where theirs begins
_LIPS_EVERY = 8  # frames from one look for lips that were not seen yet to the next
INSET = 0.02  # boundary samples lie this part of the face's width inside the mask


@dataclass(frozen=True, eq=False)
class _RowColors:
    """Colours that one row of a track shows, 0-255 RGB float32.

    skin: (n, 3) of open skin, none where too little of it is seen;  places: (n, 2) where it is, source pixels;
    parts: (P, 3) of `pvg.face.PARTS`, NaN where a part is not seen.
    """

    skin: Floats
    places: Floats
    parts: Floats

    @classmethod
    def of(cls, picture: Picture, landmarks: Landmarks, matte: Matte) -> _RowColors:
        """Those of a face in a picture, with its matte there."""
        skin, places = _open_skin(picture, landmarks, matte)
        return cls(skin, places, without_covered_lips(part_colors(picture, landmarks, matte), skin))

    @property
    def show_lips(self) -> bool:
        """Whether lips are seen, and skin beside them."""
        return bool(len(self.skin)) and shows_lips(self.parts)


class VectorFace:
    """The asset's part of one track, made row by row.

    number: of the track;  first: its first frame;  left_to_right: its place in that frame, pixels.
    """

    def __init__(
        self,
        number: int,
        begin: FaceTrack,
        key: KeyView,
        threads: SharedThreads,
        *,
        method: MaskMethod,
        seed: int,
        reset: int | None,
        advised_px: float = ADVISED_FACE_PX,
    ) -> None:
        """Begin a face at its track's first rows.

        begin: these rows or all;  key: the view whose colours the track is known by;
        threads: shared by all faces of the clip, open until `record` was called;  method: of the mask, see `skin_mask`;
        seed: of the pixels that the least-squares fit draws;  advised_px: narrower faces get a warning;
        reset: frames from one key frame to the next, None for one key frame and those that a change of light asks for.
        """
        self.number = number
        self.first = begin.first
        self.left_to_right = float(begin.landmarks.points[0, :, 0].mean())
        self._last = begin.first
        self._reset = reset
        self._seed = seed
        self._advised_px = advised_px
        self._extents: list[Floats] = []
        self._ratios: list[Floats] = []
        self._places: dict[int, Landmarks] = {}  # by the frame, some of them
        self._keys: dict[int, Future[KeyFrame | None]] = {}  # None: no skin there
        self._since: dict[int, int | None] = {}  # by a key's row, see `KeyFrame.since`
        self._main_from: int | None = None
        self._haze = key.haze
        model = fit_skin_model(key.picture, key.landmarks, method=method, haze=key.haze)
        self._skin = SkinTracker(model)
        learned = model.learned
        self._body = None if learned is None else BodyTracker(learned)
        self._color_trust = 1.0 if self._body is None else self._body.color_trust
        self._consensus = MatteConsensus()
        # rows that wait for the frames after them: one of some rows, its opacity, the body's alpha
        self._unwritten: deque[tuple[FaceTrack, int, float, Future[Bytes]]] = deque()
        self._threads = threads
        self._key_row = key.row
        self._key: KeyView | None = key
        skin = SkinTracker(model)
        self.key_matte, self._key_skin = skin.step(key.picture, key.landmarks, key.scene), skin
        self._no_body = np.zeros(scene_raster(key.picture.size).shape, np.uint8)
        self._lips: _RowColors | None = None  # of the first row that shows lips
        self._watch: ExposureWatch | None = None
        if reset is None:
            contrast = None if key.scene is None else key.scene.contrast
            patch = FacePatch.of(key.picture, key.landmarks, self.key_matte)
            self._watch = ExposureWatch(key.row, patch, contrast)

    def add(self, stretch: Stretch, writer: AssetWriter) -> None:
        """Follow the skin through the next rows and write them."""
        self._fit_key()
        for k, picture in enumerate(stretch.pictures):
            rows, row = stretch.rows, stretch.start + k
            scene = stretch.scenes[k] if stretch.scenes else None
            matte = self._skin.step(picture, rows.landmarks[k], scene)
            if self._reset is not None and rows.score[k] > 0 and row - max(self._keys) >= self._reset:
                self._fit(row, picture, rows.landmarks[k], matte)
            visible = float(stretch.visible[k])
            if self._watch is not None:
                score, pose = float(rows.score[k]), rows.pose[k]
                contrast = None if scene is None else scene.contrast
                self._fit_due(self._watch.see(row, picture, rows.landmarks[k], matte, score, pose, contrast))
                visible *= self._watch.transmission
            if self._lips is None and row % _LIPS_EVERY == 0 and good_rows(rows)[k]:
                self._look_for_lips(_RowColors.of(picture, rows.landmarks[k], matte))
            light, output = self._skin.light, self._skin.network_output
            body = self._threads.bodies.submit(self._body_alpha, scene, rows.landmarks[k], matte, light, output)
            self._unwritten.append((rows, k, visible, body))
            steady = matte if self._skin.in_time is None else self._consensus.add(self._skin.in_time)
            if steady is not None:
                self._write_first(steady, writer)
        self._remember(stretch.rows)

    def finish(self, writer: AssetWriter) -> None:
        """Write the last rows, once all are added, and keep only what is told of the track: clips have many of them."""
        for steady in self._consensus.end():
            self._write_first(steady, writer)
        writer.end_track(self.number)
        if self._watch is not None:
            self._fit_due(self._watch.end())
            self._since[self._key_row] = self._watch.main_since
        wait(self._keys.values())  # tracks may end faster than their colours are fitted
        del self._skin, self._key_skin, self.key_matte, self._body, self._no_body, self._consensus, self._watch

    def add_key_frame_only(self, track: FaceTrack, writer: AssetWriter) -> None:
        """Write just the key frame of the track, which is all that a reference needs."""
        scene = None if self._key is None else self._key.scene
        self._fit_key()
        self.first = track.first + self._key_row
        light, output = self._key_skin.light, self._key_skin.network_output
        body = self._body_alpha(scene, track.landmarks[self._key_row], self.key_matte, light, output)
        self._write(track, self._key_row, 1.0, body, self.key_matte, writer)
        self._remember(rows_between(track, self.first, self.first + 1))
        self.finish(writer)

    def shape(self) -> FaceShape:
        """What tells the person."""
        return FaceShape(self.first, self._last, np.concatenate(self._ratios))

    def has_skin(self) -> bool:
        """Whether its mask finds skin on one of its key frames; without there is nothing to vectorise."""
        return any(fitting.result() is not None for fitting in self._keys.values())

    def record(self, index: int) -> FaceRecord:
        """The face's summary and key frames, once all its rows are added, of a face that has skin.

        Raises SolverError when the colours of a key frame cannot be fitted.
        """
        keys = self._key_frames()
        main = self._keys[self._key_row].result() or keys[0]
        skin = main.visible & table_labels().on_open_skin
        colors = main.colors[skin] if skin.any() else main.colors
        width = float(np.median(np.concatenate(self._extents)))
        warnings = []
        if width < self._advised_px:
            warnings.append(f"the face is {width:.0f} px wide; {self._advised_px:g} px or more is advised")
        if self._color_trust < 0.5:
            warnings.append("its skin has next to no colour; skin beside the face is left as it is")
        warnings += doubts(main.skin)
        summary = FaceSummary(
            index=index,
            first_frame=self.first,
            last_frame=self._last,
            width_px=round(width, 1),
            skin_rgb=tuple(int(v) for v in np.rint(np.median(colors, axis=0))),  # type: ignore[arg-type]
            person=index,
            warnings=tuple(warnings),
        )
        return FaceRecord(summary, keys, self._haze)

    def _key_frames(self) -> tuple[KeyFrame, ...]:
        keys = {row: key for row, fitting in self._keys.items() if (key := fitting.result()) is not None}
        if self._main_from is not None:
            keys[self._main_from] = replace(keys[self._key_row], frame=self.first + self._main_from)
        since = {row: None if last is None else self.first + last for row, last in self._since.items()}
        if self._lips is not None:
            for row, key in keys.items():
                if len(key.skin) and not shows_lips(key.parts):
                    keys[row] = replace(key, parts=with_lips_of(key.parts, key.skin, self._lips.parts, self._lips.skin))
        first = min(keys)
        return tuple(replace(keys[row], since=None if row == first else since.get(row)) for row in sorted(keys))

    def _remember(self, rows: FaceTrack) -> None:
        self._last = rows.last
        self._extents.append(rows.extents[rows.score > 0])
        self._ratios.append(frontal_ratios(rows))
        for k in range(-rows.first % _PLACE_EVERY, len(rows.score), _PLACE_EVERY):
            self._places[rows.first + k] = rows.landmarks[k].copy()

    def place(self, frame: int) -> Landmarks | None:
        """About where the face is in a frame, source pixels; None where it is not."""
        if not self.first <= frame <= self._last:
            return None
        before = frame - frame % _PLACE_EVERY
        return self._places.get(before, self._places.get(before + _PLACE_EVERY))

    def _fit_key(self) -> None:
        """Fit the key view's colours and let go of its picture, once."""
        key, self._key = self._key, None
        if key is not None:
            self._fit(key.row, key.picture, key.landmarks, self.key_matte)

    def _fit_due(self, due: list[DueKey]) -> None:
        """Fit the key frames that a change of light asks for."""
        for key in due:
            sight = key.sight
            self._fit(sight.row, sight.picture, sight.landmarks, sight.matte)
            self._since[sight.row] = key.since
            if key.main_from is not None:
                self._main_from = key.main_from

    def _fit(self, row: int, picture: Picture, landmarks: Landmarks, matte: Matte) -> None:
        """Begin to fit a row's colours."""
        frame = self.first + row
        colors = _RowColors.of(picture, landmarks, matte)
        if self._lips is None:
            self._look_for_lips(colors)
        self._keys[row] = self._threads.fits.submit(_key_frame, frame, picture, landmarks, matte, colors, self._seed)

    def _look_for_lips(self, colors: _RowColors) -> None:
        """Keep the colours of a row that shows lips."""
        if colors.show_lips:
            self._lips = colors

    def _body_alpha(
        self, scene: Scene | None, landmarks: Landmarks, matte: Matte, light: Floats, output: NetworkOutput | None
    ) -> Bytes:
        """The matte of the person's other skin in the scene of a row, nothing where none was made.

        matte: the face's in that row;  light, output: see `SkinTracker`.
        """
        if scene is None or self._body is None:
            return self._no_body
        return self._body.step(scene, landmarks, matte, light, output).alpha

    def _write_first(self, matte: Matte, writer: AssetWriter) -> None:
        """Write the first of the rows that wait, with its face's matte."""
        rows, k, visible, body = self._unwritten.popleft()
        self._write(rows, k, visible, body.result(), matte, writer)

    def _write(self, rows: FaceTrack, k: int, visible: float, body: Bytes, matte: Matte, writer: AssetWriter) -> None:
        """Write row `k` of some rows.

        visible: in [0, 1], what both mattes are multiplied by;  body: (h, w) alpha of the person's other skin, 0-255;
        matte: of the face.
        """
        face, body = (a if visible == 1 else np.rint(a * visible).astype(np.uint8) for a in (matte.alpha, body))
        arrays: dict[str, NDArray[Any]] = {
            "points": rows.landmarks.points[k],
            "skin_points": rows.landmarks.skin_points[k],
            "radius": _radius(rows.landmarks[k], matte),
            "score": rows.score[k : k + 1].astype(np.float32),
            "pose": rows.pose[k].astype(np.float32),
            "box": matte.raster.box,
            "matte": face,
            "body": body,
        }
        writer.add_frame(self.number, arrays)


def _key_frame(
    frame: int, picture: Picture, landmarks: Landmarks, matte: Matte, row_colors: _RowColors, seed: int
) -> KeyFrame | None:
    """A frame as a key frame, its boundary colours fitted (eq. 3); None where the matte shows no skin."""
    boundary = boundary_points(_radius(landmarks, matte), landmarks.axes)
    positions = place(table_labels(), landmarks, boundary)
    rgb, corner = _cut_out(picture, matte.raster.box)
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


def _radius(landmarks: Landmarks, matte: Matte) -> Floats:
    """(192,) float32 radii of the mask's boundary around the face's centre, source pixels, see `boundary_radius`."""
    inset = INSET * landmarks.axes.width
    axes = FaceAxes.of(matte.raster.to_cells(landmarks.points))
    cells = boundary_radius(matte.alpha.astype(np.float32) / 255.0, axes)
    radius: Floats = np.maximum(cells * matte.raster.step - inset, 0.0).astype(np.float32)
    return radius


def _cut_out(picture: Picture, box: Floats) -> tuple[Bytes, Floats]:
    """The picture within a box (4,) and where it begins, (2,)."""
    x0, y0, x1, y1 = (int(v) for v in box)
    part = picture.part((x0 - 2, y0 - 2, x1 + 3, y1 + 3))
    return part.rgb(), np.array(part.box[:2], np.float32)


def _open_skin(picture: Picture, landmarks: Landmarks, matte: Matte) -> tuple[Floats, Floats]:
    """The open skin and where it is in the picture, see `skin_sample`; looked for within the face contour only."""
    margin, skin = _SAMPLE_MARGIN * landmarks.axes.width + 2, landmarks.skin_points
    rgb, corner = _cut_out(picture, np.concatenate([skin.min(axis=0) - margin, skin.max(axis=0) + margin]))
    alpha = matte.crop(corner).alpha_at(*(np.arange(n, dtype=np.float32) for n in (rgb.shape[1], rgb.shape[0])))
    colors, places = skin_sample(rgb, alpha, landmarks.moved(-corner))
    return colors, places + corner
