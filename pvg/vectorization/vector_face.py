"""One face of a clip while it is being vectorised: its skin followed, its key frames begun, its frames written."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pvg._arrays import Bytes, Floats
from pvg.asset import AssetWriter, FaceRecord, FaceSummary
from pvg.curves import table_labels
from pvg.face import Landmarks
from pvg.landmarks import FaceShape, FaceTrack
from pvg.skin import (
    BodyTracker,
    MaskMethod,
    Matte,
    NetworkOutput,
    Scene,
    SkinTracker,
    fit_skin_model,
    scene_raster,
)
from pvg.vectorization.curve_places import inset_radius
from pvg.vectorization.exposure import ExposureWatch, Sight
from pvg.vectorization.face_patch import FacePatch
from pvg.vectorization.key_frames import good_rows
from pvg.vectorization.plausible import doubts
from pvg.vectorization.row_colors import RowColors
from pvg.vectorization.shared_threads import SharedThreads
from pvg.vectorization.steady_mattes import MatteQueue, SteadyRow
from pvg.vectorization.stretch import KeyView, Stretch, rows_between
from pvg.vectorization.track_keys import TrackKeys
from pvg.vectorization.track_notes import TrackNotes
from pvg.vectorization.veil import VeilWatch
from pvg.warmth import warmth_of

ADVISED_FACE_PX = 200  # the paper's least face size
_LIPS_EVERY = 8  # frames from one look for lips that were not seen yet to the next


@dataclass(frozen=True, eq=False)
class _Row:
    """Row `k` of some rows.

    visible: in [0, 1], what its mattes are multiplied by.
    """

    rows: FaceTrack
    k: int
    visible: float


class VectorFace:
    """The asset's part of one track, made row by row.

    number: of the track;  left_to_right: its place in its first frame, pixels;
    key_matte: the face's matte in the key view.
    """

    def __init__(
        self,
        number: int,
        begin: FaceTrack,
        key: KeyView,
        threads: SharedThreads,
        *,
        mask: MaskMethod,
        seed: int,
        reset: int | None,
        advised_px: float = ADVISED_FACE_PX,
    ) -> None:
        """Begin a face at its track's first rows.

        begin: these rows or all;  key: the view whose colours the track is known by;
        threads: shared by all faces of the clip, open until `record` was called;  mask: see `skin_mask`;
        seed: of the pixels that the least-squares fit draws;  advised_px: narrower faces get a warning;
        reset: frames from one key frame to the next, None for one key frame and those that a change of light asks for.
        """
        self.number = number
        self.left_to_right = float(begin.landmarks.points[0, :, 0].mean())
        self._reset = reset
        self._advised_px = advised_px
        self._notes = TrackNotes(begin.first)
        self._keys = TrackKeys(begin.first, key.row, threads, seed)
        self._haze = key.haze
        self._warmth = 0 if key.scene is None else warmth_of(key.scene.rgb, key.scene.person)
        model = fit_skin_model(key.picture, key.landmarks, mask=mask, haze=key.haze)
        self._skin = SkinTracker(model)
        self._body = None if model.learned is None else BodyTracker(model.learned)
        self._no_body = np.zeros(scene_raster(key.picture.size).shape, np.uint8)
        self._color_trust = 1.0 if self._body is None else self._body.color_trust
        self._mattes = MatteQueue[_Row](threads)
        self._key_row = key.row
        self._key: KeyView | None = key  # until its colours are begun
        self._key_skin = SkinTracker(model)
        self.key_matte = self._key_skin.step(key.picture, key.landmarks, key.scene)
        self._light: tuple[VeilWatch, ExposureWatch] | None = None  # of the paper's chain nobody asks
        if reset is None:
            patch = FacePatch.of(key.picture, key.landmarks, self.key_matte)
            self._light = VeilWatch(patch, _contrast_of(key.scene)), ExposureWatch(key.row, patch)

    @property
    def first(self) -> int:
        """Its first frame."""
        return self._notes.first

    def add(self, stretch: Stretch, writer: AssetWriter) -> None:
        """Follow the skin through the next rows and write them."""
        self._begin_key()
        rows, good = stretch.rows, good_rows(stretch.rows)
        for k, picture in enumerate(stretch.pictures):
            row, landmarks = stretch.start + k, rows.landmarks[k]
            scene = stretch.scenes[k] if stretch.scenes else None
            matte = self._skin.step(picture, landmarks, scene)
            if self._reset is not None and rows.score[k] > 0 and row - self._keys.last_row >= self._reset:
                self._keys.begin(row, picture, landmarks, matte)
            visible = float(stretch.visible[k])
            if self._light is not None:
                veil, exposure = self._light
                patch = FacePatch.of(picture, landmarks, matte) if good[k] else None
                transmission = veil.see(patch, _contrast_of(scene))
                of_light = patch if transmission == 1 else None  # a veil is no light
                self._keys.begin_due(exposure.see(Sight(row, picture, landmarks, matte, of_light)))
                visible *= transmission
            if not self._keys.lips_known and row % _LIPS_EVERY == 0 and good[k]:
                self._keys.look_for_lips(RowColors.of(picture, landmarks, matte))
            light, output = self._skin.light, self._skin.network_output
            face = matte if self._skin.in_time is None else self._skin.in_time
            make_body = partial(self._body_alpha, scene, landmarks, matte, light, output)
            self._write_all(self._mattes.add(_Row(rows, k, visible), face, scene, make_body), writer)
        self._notes.add(rows)

    def finish(self, writer: AssetWriter) -> None:
        """Write the last rows, once all are added, and keep only what is told of the track: clips have many of them."""
        self._write_all(self._mattes.end(), writer)
        writer.end_track(self.number)
        if self._light is not None:
            _, exposure = self._light
            self._keys.begin_due(exposure.end())
            self._keys.main_serves_since(exposure.main_since)
        self._keys.wait()
        self._notes.end()
        del self._skin, self._key_skin, self.key_matte, self._body, self._no_body, self._mattes, self._light

    def add_key_frame_only(self, track: FaceTrack, writer: AssetWriter) -> None:
        """Write just the key frame of the track, which is all that a reference needs."""
        scene = None if self._key is None else self._key.scene
        self._begin_key()
        landmarks, frame = track.landmarks[self._key_row], track.first + self._key_row
        light, output = self._key_skin.light, self._key_skin.network_output
        body = self._body_alpha(scene, landmarks, self.key_matte, light, output)
        self._write(_Row(track, self._key_row, 1.0), self.key_matte, body, writer)
        self._notes = TrackNotes(frame)
        self._notes.add(rows_between(track, frame, frame + 1))
        self.finish(writer)

    def shape(self) -> FaceShape:
        """What tells the person, once all its rows are added."""
        return self._notes.shape

    def has_skin(self) -> bool:
        """Whether its mask finds skin on one of its key frames; without there is nothing to vectorise."""
        return self._keys.have_skin()

    def record(self, index: int) -> FaceRecord:
        """The face's summary and key frames, once all its rows are added, of a face that has skin.

        Raises SolverError when the colours of a key frame cannot be fitted.
        """
        main, width = self._keys.main(), self._notes.width_px
        skin = main.visible & table_labels().on_open_skin
        colors = main.colors[skin] if skin.any() else main.colors
        warnings = []
        if width < self._advised_px:
            warnings.append(f"the face is {width:.0f} px wide; {self._advised_px:g} px or more is advised")
        if self._color_trust < 0.5:
            warnings.append("its skin has next to no colour; skin beside the face is left as it is")
        warnings += doubts(main.skin)
        summary = FaceSummary(
            index=index,
            first_frame=self._notes.first,
            last_frame=self._notes.last,
            width_px=round(width, 1),
            skin_rgb=tuple(int(v) for v in np.rint(np.median(colors, axis=0))),  # type: ignore[arg-type]
            person=index,
            warnings=tuple(warnings),
        )
        return FaceRecord(summary, self._keys.all(), self._haze, self._warmth)

    def _begin_key(self) -> None:
        """Begin to fit the key view's colours and let go of its picture, once."""
        key, self._key = self._key, None
        if key is not None:
            self._keys.begin(key.row, key.picture, key.landmarks, self.key_matte)

    def _body_alpha(
        self, scene: Scene | None, landmarks: Landmarks, matte: Matte, light: Floats, output: NetworkOutput | None
    ) -> Bytes:
        """The matte of the person's other skin in the scene of a row, nothing where none was made.

        matte: the face's in that row;  light, output: see `SkinTracker`.
        """
        if scene is None or self._body is None:
            return self._no_body
        return self._body.step(scene, landmarks, matte, light, output).alpha

    def _write_all(self, known: Iterable[SteadyRow[_Row]], writer: AssetWriter) -> None:
        for row, face, body in known:
            self._write(row, face, body, writer)

    def _write(self, row: _Row, matte: Matte, body: Bytes, writer: AssetWriter) -> None:
        """Write a row;  matte: of the face;  body: alpha (h, w) of the person's other skin in the scene, 0-255."""
        rows, k, visible = row.rows, row.k, row.visible
        face, body = (a if visible == 1 else np.rint(a * visible).astype(np.uint8) for a in (matte.alpha, body))
        arrays: dict[str, NDArray[Any]] = {
            "points": rows.landmarks.points[k],
            "skin_points": rows.landmarks.skin_points[k],
            "radius": inset_radius(rows.landmarks[k], matte),
            "score": rows.score[k : k + 1].astype(np.float32),
            "pose": rows.pose[k].astype(np.float32),
            "box": matte.raster.box,
            "matte": face,
            "body": body,
        }
        writer.add_frame(self.number, arrays)


def _contrast_of(scene: Scene | None) -> float | None:
    """That of a whole picture, None where it was not looked at."""
    return None if scene is None else scene.contrast
