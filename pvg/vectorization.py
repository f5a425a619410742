"""Algorithm 1, precomputation: a clip or an image becomes a `VectorVideo`.

Two passes over the clip, frames streamed in both: landmarks of every frame first, because smoothing without lag needs
what comes after; then, with the smoothed landmarks, the skin and its boundary in every frame and the boundary colours
in the key frames. The Poisson regions need no storing: f_i is the Laplacian of the clip itself.
"""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from pvg.asset import AssetWriter, FaceRecord, FaceSummary, KeyFrame, MediaSummary, VectorVideo
from pvg.boundary import fit_boundary_colors
from pvg.complexion import skin_sample
from pvg.curves import (
    BOUNDARY,
    GROUPS,
    Floats,
    boundary_points,
    boundary_radius,
    face_frame,
    place,
    stack_points,
    table_labels,
)
from pvg.errors import FaceTooSmallError, NoFaceError
from pvg.keyframes import best_row, first_good_row, opacity
from pvg.landmarks import FaceTrack, link_persons, smooth, track_faces
from pvg.matching import CHAIN_RESET_FRAMES
from pvg.skin import MaskMethod, Matte, SkinTracker, fit_skin_model
from pvg.video import MediaInfo, MediaLimits, probe, read_frames, sha256_file

Progress = Callable[[str, int, int], None]
Image = NDArray[np.uint8]

VECTORIZER_VERSION = 1  # raised when the same clip would give another asset
MIN_FACE_PX = 64
ADVISED_FACE_PX = 200  # the paper's least face size
_FIT_FACE_PX = 320  # the least-squares fit sees larger faces scaled down to this width
_INSET = 0.012  # boundary samples lie this part of the face's width inside the mask
_STRAY_SPREADS = 2.5
_LEAST_CHROMA_SPREAD = 4.0  # of a* and b*
_REFERENCE_FRAMES = 300  # a reference needs one good frame; the beginning of a clip is enough to find it


def vectorize(
    source: str | Path,
    *,
    asset: str | Path | None = None,
    reference: bool = False,
    mask: MaskMethod = "landmarks",
    matching: Literal["table", "chain"] = "table",
    limits: MediaLimits | None = None,
    progress: Progress | None = None,
    min_face_px: int = MIN_FACE_PX,
    seed: int = 0,
) -> VectorVideo:
    """Vectorise a clip or an image, once for all looks.

    asset: where the asset file is written; a temporary file that goes with the object when None.
    reference: keep only what a reference needs, the best frame of the largest face.
    mask: "landmarks" (default) or "ycbcr", the paper's rule.  matching: "table" maps every frame straight to the key
    frame's colours; "chain" is the paper's frame-to-frame way with new key frames every 120 frames.
    progress: called as (stage, frames done, frames expected); what it raises ends the work and passes through.
    seed: of the pixels that the least-squares fit draws.
    Raises `MediaError` (not a video or image, damaged, over a limit), `NoFaceError`, and `FaceTooSmallError` when
    every face is narrower than `min_face_px`.
    """
    path = Path(source)
    report: Progress = progress or (lambda stage, done, total: None)
    media = probe(path, limits)
    work = _Work(path, media, limits, report, mask, matching, reference, seed)
    tracks, shots, frames = work.track(min_face_px, _REFERENCE_FRAMES if reference else None)
    if reference:
        tracks = (max(tracks, key=lambda track: track.width_px),)
    target = Path(asset) if asset is not None else _temporary_name()
    manifest = {
        "vectorizer": VECTORIZER_VERSION,
        "settings": {"mask": mask, "matching": matching, "reference": reference, "seed": seed},
        "source_name": path.name,
        "source_sha256": sha256_file(path),
        "media": asdict(MediaSummary.of(media, frames)),
        "shots": list(shots),
    }
    with contextlib.ExitStack() as undo:
        if asset is None:
            undo.callback(target.unlink)
        writer = undo.enter_context(AssetWriter(target))
        faces = [work.open_face(index, track, shots, frames) for index, track in enumerate(tracks)]
        if reference:
            for face in faces:
                face.add_key_frame_only(writer)
        else:
            work.follow_skin(faces, writer, frames)
        records = [face.record() for face in faces]
        persons = link_persons([face.track for face in faces], [record.summary.skin_rgb for record in records])
        for record, person in zip(records, persons, strict=True):
            writer.add_face(replace(record, summary=replace(record.summary, person=person)))
        writer.finish(manifest)
        undo.pop_all()
    return VectorVideo(target, path, temporary=asset is None)


def _temporary_name() -> Path:
    handle, name = tempfile.mkstemp(suffix=".pvg")
    os.close(handle)
    return Path(name)


@dataclass(frozen=True)
class _Work:
    """One clip being vectorised: its file and the settings."""

    path: Path
    media: MediaInfo
    limits: MediaLimits | None
    report: Progress
    mask: MaskMethod
    matching: str
    reference: bool
    seed: int

    def frames(self, stage: str, stop: int | None = None) -> Iterator[tuple[int, Image]]:
        """(index, RGB) of every frame before `stop`, reporting progress."""
        expected = self.media.frame_count if stop is None else min(stop, self.media.frame_count)
        for frame in read_frames(self.path, stop=stop, limits=self.limits):
            yield frame.index, frame.rgb()
            self.report(stage, frame.index + 1, max(expected, frame.index + 1))

    def frame(self, index: int) -> Image:
        (frame,) = read_frames(self.path, start=index, stop=index + 1, limits=self.limits)
        return frame.rgb()

    def track(self, min_face_px: int, stop: int | None) -> tuple[tuple[FaceTrack, ...], tuple[int, ...], int]:
        """First pass: smoothed tracks wide enough, first frames of the shots, number of frames looked at.

        stop: where to stop looking, if a face was found by then.
        """
        rate = float(self.media.frame_rate or 25)
        result = track_faces(self.frames("landmarks", stop), frame_rate=rate)
        if stop is not None and not result.tracks:  # no face so early: look further
            result = track_faces(self.frames("landmarks"), frame_rate=rate)
        if not result.tracks:
            what = "in the picture" if self.media.kind == "image" else f"in any of {result.frame_count} frames"
            raise NoFaceError(
                f"no face found {what} of {self.path.name}; a face at least {min_face_px} px wide is needed"
            )
        wide = tuple(track for track in result.tracks if track.width_px >= min_face_px)
        if not wide:
            widest = max(track.width_px for track in result.tracks)
            raise FaceTooSmallError(
                f"the largest face in {self.path.name} is {widest:.0f} px wide; it must be at least {min_face_px} px, "
                f"and {ADVISED_FACE_PX} px is advised"
            )
        return tuple(smooth(track) for track in wide), (0, *result.cuts), result.frame_count

    def open_face(self, index: int, track: FaceTrack, shots: tuple[int, ...], frame_count: int) -> _Face:
        """Read the track's key frame, learn its skin and fit its boundary colours."""
        chain = self.matching == "chain" and not self.reference
        if self.reference and len(track.score) > 1:
            row = self._best_row(track)
        else:
            row = 0 if chain else first_good_row(track)
        resets = tuple(range(0, len(track.score), CHAIN_RESET_FRAMES)) if chain else (row,)
        skin = SkinFollower(self.mask, track, row, self.frame(track.first + row))
        return _Face(index, track, resets, skin, opacity(track, shots, frame_count), seed=self.seed)

    def _best_row(self, track: FaceTrack) -> int:
        def matte_of(row: int, rgb: Image) -> Matte:
            return SkinFollower(self.mask, track, row, rgb).key_matte

        stop = min(track.last + 1, track.first + _REFERENCE_FRAMES)
        return best_row(track, self.frames("best frame", stop), matte_of)

    def follow_skin(self, faces: list[_Face], writer: AssetWriter, frames: int) -> None:
        """Second pass: matte and boundary of every face in every frame."""
        for index, rgb in self.frames("skin"):
            for face in faces:
                face.add_frame(index, rgb, writer)


class SkinFollower:
    """The skin of one track, frame after frame."""

    def __init__(self, method: MaskMethod, track: FaceTrack, key_row: int, rgb: Image) -> None:
        model = fit_skin_model(rgb, track.points[key_row], track.skin_points[key_row], method=method)
        self._tracker = SkinTracker(model)
        self.key_row = key_row
        self.key_matte = SkinTracker(model).step(rgb, track.points[key_row], track.skin_points[key_row])
        self.key_rgb = rgb

    def step(self, rgb: Image, points: Floats, skin_points: Floats) -> Matte:
        """The matte of the next frame."""
        return self._tracker.step(rgb, points, skin_points)


class _Face:
    """One face while its track is being written."""

    def __init__(
        self,
        index: int,
        track: FaceTrack,
        key_rows: tuple[int, ...],
        skin: SkinFollower,
        visible: Floats,
        *,
        seed: int,
    ) -> None:
        self.index = index
        self.track = track
        self._skin = skin
        self._seed = seed
        self._opacity = visible
        self._key_rows = key_rows
        self._keys: dict[int, KeyFrame] = {}
        self._fit(skin.key_row, skin.key_rgb, skin.key_matte)

    def add_frame(self, index: int, rgb: Image, writer: AssetWriter) -> None:
        """Write one frame of the clip, if it belongs to the track."""
        row = index - self.track.first
        if not 0 <= row < len(self.track.score):
            return
        matte = self._skin.step(rgb, self.track.points[row], self.track.skin_points[row])
        if row in self._key_rows and row not in self._keys:
            self._fit(row, rgb, matte)
        self._write(row, matte, writer)

    def add_key_frame_only(self, writer: AssetWriter) -> None:
        """Write just the key frame: all that a reference needs."""
        self._write(self._key_rows[0], self._skin.key_matte, writer)
        row = self._key_rows[0]
        self.track = FaceTrack(
            first=self.track.first + row,
            points=self.track.points[row : row + 1],
            skin_points=self.track.skin_points[row : row + 1],
            score=self.track.score[row : row + 1],
            pose=self.track.pose[row : row + 1],
        )
        self._keys = {0: self._keys[row]}

    def record(self) -> FaceRecord:
        """The face's summary and key frames."""
        keys = tuple(self._keys[row] for row in sorted(self._keys))
        skin = keys[0].visible & (table_labels().group == 0) & (table_labels().curve != BOUNDARY)
        colors = keys[0].colors[skin] if skin.any() else keys[0].colors
        width = self.track.width_px
        warnings: tuple[str, ...] = ()
        if width < ADVISED_FACE_PX:
            warnings = (f"the face is {width:.0f} px wide; {ADVISED_FACE_PX} px or more is advised",)
        summary = FaceSummary(
            index=self.index,
            first_frame=self.track.first,
            last_frame=self.track.first + len(self.track.score) - 1,
            width_px=round(width, 1),
            skin_rgb=tuple(int(v) for v in np.rint(np.median(colors, axis=0))),  # type: ignore[arg-type]
            person=self.index,
            warnings=warnings,
        )
        return FaceRecord(summary, keys)

    def _radius(self, row: int, matte: Matte) -> Floats:
        """Boundary radii in source pixels, from the matte over its box."""
        to_box = matte.to_raster(self.track.points[row])
        step = matte.step
        inset = _INSET * face_frame(self.track.points[row]).width
        radius: Floats = np.maximum(boundary_radius(matte.alpha.astype(np.float32) / 255.0, to_box) * step - inset, 0.0)
        return radius

    def _fit(self, row: int, rgb: Image, matte: Matte) -> None:
        points, skin_points = self.track.points[row], self.track.skin_points[row]
        boundary = boundary_points(self._radius(row, matte), points)
        positions = place(table_labels(), stack_points(points, skin_points), boundary)
        colors, visible = fit_key_frame(rgb, matte, positions, face_frame(points).width, self._seed)
        matte_here = matte.alpha_at(*(np.arange(n, dtype=np.float32) for n in (rgb.shape[1], rgb.shape[0])))
        skin = skin_sample(rgb, matte_here, points, skin_points)
        self._keys[row] = KeyFrame(self.track.first + row, colors, visible, skin)

    def _write(self, row: int, matte: Matte, writer: AssetWriter) -> None:
        arrays: dict[str, NDArray[Any]] = {
            "points": self.track.points[row],
            "skin_points": self.track.skin_points[row],
            "radius": self._radius(row, matte),
            "score": self.track.score[row : row + 1].astype(np.float32),
            "pose": self.track.pose[row].astype(np.float32),
            "box": matte.box,
            "matte": np.rint(matte.alpha * self._opacity[row]).astype(np.uint8),
        }
        writer.add_frame(self.index, arrays)


def fit_key_frame(
    rgb: Image, matte: Matte, positions: Floats, face_width: float, seed: int
) -> tuple[Floats, NDArray[np.bool_]]:
    """Boundary colours g of a key frame (eq. 3) and which samples lie on visible skin or features.

    rgb: (H, W, 3);  positions: (S, 2) curve samples, source pixels;  face_width: pixels.
    Returns (S, 3) float32 colours, 0-255, and (S,) bool.
    """
    h, w = rgb.shape[:2]
    x0, y0 = max(0, int(matte.box[0])), max(0, int(matte.box[1]))
    x1, y1 = min(w, int(matte.box[2]) + 1), min(h, int(matte.box[3]) + 1)
    scale = min(1.0, _FIT_FACE_PX / face_width)
    crop = rgb[y0:y1, x0:x1]
    size = (max(1, round(crop.shape[1] * scale)), max(1, round(crop.shape[0] * scale)))
    scale_xy = np.array([size[0] / crop.shape[1], size[1] / crop.shape[0]], np.float32)
    small = cv2.resize(crop, size, interpolation=cv2.INTER_AREA) if scale < 1 else crop
    # pixel centres are at integers: (p + 1/2) scales, not p
    local = (positions - np.array([x0, y0], np.float32) + 0.5) * scale_xy - 0.5
    grid_x = (np.arange(size[0], dtype=np.float32) + 0.5) / scale_xy[0] - 0.5 + x0
    grid_y = (np.arange(size[1], dtype=np.float32) + 0.5) / scale_xy[1] - 0.5 + y0
    domain = matte.mask_at(grid_x, grid_y)
    fit = fit_boundary_colors(
        small, domain, local, h_min=max(1.0, face_width * scale / 100), rng=np.random.default_rng(seed)
    )
    near = cv2.dilate(domain.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(np.bool_)
    col, row = np.rint(local[:, 0]).astype(int), np.rint(local[:, 1]).astype(int)
    inside = (col >= 0) & (row >= 0) & (col < size[0]) & (row < size[1])
    visible = inside & near[np.clip(row, 0, size[1] - 1), np.clip(col, 0, size[0] - 1)]
    return fit.colors, visible & ~_stray(fit.colors, visible)


def _stray(colors: Floats, visible: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(S,) whether a skin sample has a hue that the face's visible skin has not: hair, collar or background in it.

    Transport matches extremes to extremes, so a few such samples would tint a face's highlights or shadows.
    """
    skin = table_labels().group == GROUPS.index("skin")
    if not (skin & visible).any():
        return np.zeros(len(colors), np.bool_)
    chroma = cv2.cvtColor(colors[None] / np.float32(255.0), cv2.COLOR_RGB2Lab)[0, :, 1:]
    middle = np.median(chroma[skin & visible], axis=0)
    distance = np.hypot(*(chroma - middle).T)
    spread = max(1.48 * float(np.median(distance[skin & visible])), _LEAST_CHROMA_SPREAD)
    stray: NDArray[np.bool_] = skin & (distance > _STRAY_SPREADS * spread)
    return stray
