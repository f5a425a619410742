"""Algorithm 1, precomputation: a clip or an image becomes a `VectorVideo`.

One reading of the clip, frames streamed: decoding, the landmarks some dozens of frames ahead, and then the skin and its
boundary in every frame and the boundary colours in the key frames, each in a thread of its own. The Poisson regions
need no storing: f_i is the Laplacian of the clip itself.
"""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Literal, get_args

from pvg._checks import check_switch, check_word, real_number, whole_number
from pvg._targets import check_file
from pvg._threads import ahead, one_blas_thread, one_opencv_thread
from pvg.asset import AssetWriter, MediaSummary, VectorVideo, source_note
from pvg.curves import CHAIN_RESET_FRAMES
from pvg.errors import FaceTooSmallError, NoFaceError
from pvg.landmarks import FaceTrack, FaceTracks, link_persons, smooth, track_faces
from pvg.picture import Picture
from pvg.skin import MaskMethod, Matte, Scene, SceneReader
from pvg.vectorization.face_messages import no_usable_face, over_limit_warning
from pvg.vectorization.fading import opacity
from pvg.vectorization.following import CHUNK, DeferredTrack, Following, KeyView, Stretch, key_view, rows_between
from pvg.vectorization.key_frames import best_row
from pvg.vectorization.shared_threads import SharedThreads
from pvg.vectorization.vector_face import ADVISED_FACE_PX, VectorFace
from pvg.video import (
    INPUT_COLORS,
    Frame,
    InputColor,
    MediaInfo,
    MediaLimits,
    picture_of,
    probe,
    read_frames,
    sha256_file,
)

Progress = Callable[[str, int, int], None]
Matching = Literal["table", "chain"]

VECTORIZER_VERSION = 17  # raised when the same clip would give another asset
MIN_FACE_PX = 64
_WIDEST_PX = 65_535  # no picture has more
STAGES = ("vectorize", "second reading", "landmarks", "best frame")  # of the progress callback, in their order
_VECTORIZE, _SECOND_READING, _LANDMARKS, _BEST_FRAME = STAGES
_AHEAD = CHUNK + 4  # frames: a face's frames come a chunk at a time, and landmarks go on while their skin is found
_REFERENCE_FRAMES = 300  # a reference needs one good frame; the beginning of a clip is enough to find it


def vectorize(
    source: str | Path,
    *,
    asset: str | Path | None = None,
    reference: bool = False,
    mask: MaskMethod = "landmarks",
    matching: Matching = "table",
    input_color: InputColor = "auto",
    limits: MediaLimits | None = None,
    progress: Progress | None = None,
    min_face_px: float = MIN_FACE_PX,
    advised_face_px: float = ADVISED_FACE_PX,
    seed: int = 0,
    strict: bool = False,
) -> VectorVideo:
    """Vectorise a clip or an image, once for all looks.

    asset: where the asset file is written; a temporary file that goes with the object when None.
    reference: keep only what a reference needs: all faces of an image; of a clip the best frame of the largest face in
    its first 300 frames, or in all of it where none of those is wide enough.
    mask: "landmarks" (default) or "ycbcr", the paper's rule.  matching: "table" maps every frame straight to the key
    frame's colours; "chain" is the paper's frame-to-frame way with new key frames every 120 frames.
    input_color: how the clip is coded: "auto" believes its tags, of HDR too; camera logarithms, which files do not
    name, are "slog3", "logc3", "logc4", "vlog", "applelog"; "sdr", "pq" and "hlg" stand for wrong or missing tags.
    progress: called as (stage, frames done, frames expected) with one of STAGES; what it raises ends the work and
    passes through. A clip has the stage "vectorize", and "second reading" if a track needs one; a reference
    "landmarks" and "best frame".
    limits: what is accepted, whenever the clip is read; to `open_asset` they are said again.
    min_face_px: of faces that are followed;  advised_face_px: narrower ones get a warning;  seed: of the pixels that
    the least-squares fit draws.  strict: a clip whose end is cut off, whose colour tags or range change, or that goes
    on interlaced, is refused; else its frames up to there are used, and all are read as the first one, with a warning.
    Raises `MediaError` (not a video or image, damaged, over a limit), `NoFaceError`, and `FaceTooSmallError` when
    every face is narrower than `min_face_px`. Before any frame is read: `ValueError` for an option that is none of
    these and for an asset in the place of the source, `OSError` where the asset cannot be written. A file that is there
    is replaced by a whole asset only.
    """
    path = Path(source)
    _check_options(mask, matching, input_color, reference=reference, strict=strict)
    min_face_px = real_number("min_face_px", min_face_px, 0, _WIDEST_PX)
    advised_face_px = real_number("advised_face_px", advised_face_px, 0, _WIDEST_PX)
    seed = whole_number("seed", seed)
    if asset is not None:
        check_file(Path(asset), [path])
    report: Progress = progress or (lambda stage, done, total: None)
    media = probe(path, limits, input_color=input_color, strict=strict)
    target = Path(asset) if asset is not None else _temporary_name()
    with one_blas_thread(), contextlib.ExitStack() as undo, SharedThreads() as threads:
        if asset is None:
            undo.callback(target.unlink)
        if media.kind == "video" and not reference:
            undo.enter_context(one_opencv_thread())
        writer = undo.enter_context(AssetWriter(target))
        work = _Work(
            path=path,
            media=media,
            limits=limits,
            input_color=input_color,
            strict=strict,
            report=report,
            mask=mask,
            matching=matching,
            seed=seed,
            min_face_px=min_face_px,
            advised_face_px=advised_face_px,
            threads=threads,
        )
        try:
            done = work.key_views(writer) if reference else work.whole_clip(writer)
        except _EndedByCallerError as ended:
            raise ended.error from None
        faces, no_skin = work.with_skin(done, writer)
        records = [face.record(index) for index, face in enumerate(faces)]
        persons = link_persons([face.shape() for face in faces], [record.summary.skin_rgb for record in records])
        for face, record, person in zip(faces, records, persons, strict=True):
            writer.add_face(replace(record, summary=replace(record.summary, person=person)), face.number)
        summary, noticed = MediaSummary.of(media, done.frame_count), tuple(dict.fromkeys(work.notices))
        writer.finish(
            {
                "vectorizer": VECTORIZER_VERSION,
                "settings": {
                    **{"mask": mask, "matching": matching, "reference": reference, "seed": seed},
                    "input_color": input_color,
                },
                **source_note(path, None if asset is None else target),
                "source_sha256": sha256_file(path),
                "media": {**asdict(summary), "warnings": summary.warnings + noticed + no_skin},
                "shots": list(done.shots),
            }
        )
        undo.pop_all()
    return VectorVideo(target, path, limits=limits, temporary=asset is None)


def _check_options(mask: str, matching: str, input_color: str, **switches: bool) -> None:
    for name, value, known in (
        ("mask", mask, get_args(MaskMethod)),
        ("matching", matching, get_args(Matching)),
        ("input_color", input_color, INPUT_COLORS),
    ):
        check_word(name, value, known)
    for name, switch in switches.items():
        check_switch(name, switch)


def _widest(found: FaceTracks) -> float:
    """Width in px of the widest face, 0 without one."""
    return max((track.width_px for track in found.tracks), default=0.0)


def _temporary_name() -> Path:
    handle, name = tempfile.mkstemp(suffix=".pvg")
    os.close(handle)
    return Path(name)


class _EndedByCallerError(Exception):
    """What `progress` raised, on its way through generators."""

    def __init__(self, error: StopIteration) -> None:
        super().__init__(error)
        self.error = error


@dataclass(frozen=True, eq=False)
class _Done:
    """What the reading of a clip gave."""

    faces: tuple[VectorFace, ...]
    shots: tuple[int, ...]
    frame_count: int


@dataclass(frozen=True)
class _Work:
    """One clip being vectorised: its file and the settings;  notices: what reading it told of, a line each."""

    path: Path
    media: MediaInfo
    limits: MediaLimits | None
    input_color: InputColor
    strict: bool
    report: Progress
    mask: MaskMethod
    matching: str
    seed: int
    min_face_px: float
    advised_face_px: float
    threads: SharedThreads
    notices: list[str] = field(default_factory=list)

    @property
    def rate(self) -> float:
        """Frames a second, some usual number for images."""
        return float(self.media.frame_rate or 25)

    def _read(self, start: int, stop: int | None, frame_count: int | None) -> Iterator[Frame]:
        """frame_count: of the clip, where it has been read to its end."""
        limits, color, strict = self.limits, self.input_color, self.strict
        return read_frames(
            self.path,
            start=start,
            stop=stop,
            limits=limits,
            input_color=color,
            strict=strict,
            frame_count=frame_count,
            notice=self.notices.append,
        )

    def pictures(
        self, start: int = 0, stop: int | None = None, frame_count: int | None = None
    ) -> Generator[tuple[int, Picture], None, None]:
        """(index, picture) of the frames [start, stop), decoded ahead in a thread."""
        reading = self._read(start, stop, frame_count)
        with contextlib.closing(ahead(reading)) as frames:
            for frame in frames:
                yield frame.index, picture_of(frame)

    def reported(
        self, stage: str, start: int = 0, stop: int | None = None, frame_count: int | None = None
    ) -> Generator[tuple[int, Picture], None, None]:
        """`pictures`, with progress."""
        expected = (self.media.frame_count if stop is None else min(stop, self.media.frame_count)) - start
        with contextlib.closing(self.pictures(start, stop, frame_count)) as pictures:
            for index, picture in pictures:
                yield index, picture
                done = index + 1 - start
                try:
                    self.report(stage, done, max(expected, done))
                except StopIteration as error:  # of which a generator makes another error
                    raise _EndedByCallerError(error) from error

    def face(self, number: int, rows: FaceTrack, key: KeyView) -> VectorFace:
        """A face that begins with these rows."""
        reset = CHAIN_RESET_FRAMES if self.matching == "chain" else None
        return VectorFace(
            number,
            rows,
            key,
            self.threads,
            method=self.mask,
            seed=self.seed,
            reset=reset,
            advised_px=self.advised_face_px,
        )

    def whole_clip(self, writer: AssetWriter) -> _Done:
        """Follow every face of the clip and write all its frames."""
        following = Following(
            min_face_px=self.min_face_px,
            frame_rate=self.rate,
            from_first_row=self.matching == "chain",
            scenes=self.mask == "landmarks",
        )
        faces: dict[int, VectorFace] = {}
        settled = 0
        with contextlib.closing(ahead(following.advances(self.pictures()), _AHEAD)) as advances:
            for advance in advances:
                for stretch in advance.stretches:
                    if stretch.key is not None:
                        faces[stretch.number] = self.face(stretch.number, stretch.rows, stretch.key)
                    faces[stretch.number].add(stretch, writer)
                for done in range(settled + 1, advance.settled + 1):
                    self.report(_VECTORIZE, done, max(self.media.frame_count, done))
                settled = max(settled, advance.settled)
                for stretch in advance.stretches:
                    if stretch.last:
                        faces[stretch.number].finish(writer)
        shots, frame_count = (0, *following.cuts), following.frame_count
        self.notices.extend(over_limit_warning(following.over_limit))
        deferred, widest = following.deferred()
        if deferred:
            first = max(faces, default=-1) + 1
            others = tuple(faces.values())
            faces |= self._second_reading(following, dict(enumerate(deferred, first)), others, shots, writer)
        if not faces:
            raise self._no_usable_face(widest, frame_count, following.too_brief)
        return _Done(tuple(faces.values()), shots, frame_count)

    def _second_reading(
        self,
        following: Following,
        deferred: dict[int, DeferredTrack],
        others: Sequence[VectorFace],
        shots: tuple[int, ...],
        writer: AssetWriter,
    ) -> dict[int, VectorFace]:
        """Follow tracks that are known from end to end, by number;  others: the faces of the first reading."""
        frame_count = following.frame_count
        tracks = {number: smooth(one.track) for number, one in deferred.items()}
        visible = {
            number: opacity(track, shots, frame_count, left_picture=deferred[number].left_picture)
            for number, track in tracks.items()
        }
        faces: dict[int, VectorFace] = {}
        start, stop = min(t.first for t in tracks.values()), max(t.last for t in tracks.values()) + 1
        reader = SceneReader()
        for index, picture in self.reported(_SECOND_READING, start, stop, frame_count):
            there = [t.landmarks[index - t.first] for t in tracks.values() if t.first <= index <= t.last]
            there += [place for other in others if (place := other.place(index)) is not None]
            scenes: tuple[Scene, ...] = ()
            if self.mask == "landmarks":
                scenes = (reader.step(picture, there, cut=index in shots),)
            for number, track in tracks.items():
                row = index - track.first
                if row == 0:
                    key = self._late_key(track, following.key_row(track), frame_count)
                    faces[number] = self.face(number, track, key)
                if 0 <= row < len(track.score):
                    rows = rows_between(track, index, index + 1)
                    seen = visible[number][row : row + 1]
                    last = index == track.last
                    faces[number].add(Stretch(number, row, rows, (picture,), seen, scenes, None, last), writer)
                    if last:
                        faces[number].finish(writer)
        return faces

    def _late_key(self, track: FaceTrack, row: int, frame_count: int) -> KeyView:
        """The key view of a track that is known from end to end, read from the clip."""
        picture = self._picture(track.first + row, frame_count)
        scene = SceneReader().step(picture, [track.landmarks[row]]) if self.mask == "landmarks" else None
        return key_view(track, row, picture, scene)

    def _picture(self, index: int, frame_count: int | None) -> Picture:
        (frame,) = self._read(index, index + 1, frame_count)
        return picture_of(frame)

    def key_views(self, writer: AssetWriter) -> _Done:
        """Write what a reference needs: one view of a face."""
        return self._all_faces(writer) if self.media.kind == "image" else self._best_frame(writer)

    def _all_faces(self, writer: AssetWriter) -> _Done:
        """Write all faces of an image that are wide enough."""
        ((index, picture),) = self.pictures()
        result = self._track([(index, picture)])
        self._check_width(result)
        self.notices.extend(over_limit_warning(result.over_limit))
        scene = None
        if self.mask == "landmarks":  # an image can be drawn as well
            scene = SceneReader().step(picture, [track.landmarks[0] for track in result.tracks])
        faces = []
        for number, found in enumerate(t for t in result.tracks if t.width_px >= self.min_face_px):
            track = smooth(found)
            faces.append(self.face(number, track, key_view(track, 0, picture, scene)))
            faces[-1].add_key_frame_only(track, writer)
        return _Done(tuple(faces), (0,), result.frame_count)

    def _best_frame(self, writer: AssetWriter) -> _Done:
        """Find the best frame of a clip's largest face and write it alone."""
        result = self._track(self.reported(_LANDMARKS, 0, _REFERENCE_FRAMES))
        whole = result.frame_count < _REFERENCE_FRAMES
        if not whole and _widest(result) < self.min_face_px:  # no usable face so early: look further
            result, whole = self._track(self.reported(_LANDMARKS)), True
        self._check_width(result)
        frame_count = result.frame_count if whole else None
        track = smooth(max(result.tracks, key=lambda track: track.width_px))
        views: dict[int, VectorFace] = {}

        def matte_of(row: int, picture: Picture) -> Matte:
            views[row] = self.face(0, track, key_view(track, row, picture))
            return views[row].key_matte

        stop = min(track.last + 1, track.first + _REFERENCE_FRAMES)
        row = best_row(track, self.reported(_BEST_FRAME, track.first, stop, frame_count), matte_of)
        if row not in views:
            matte_of(row, self._picture(track.first + row, frame_count))
        views[row].add_key_frame_only(track, writer)
        return _Done((views[row],), (0, *result.cuts), result.frame_count)

    def with_skin(self, done: _Done, writer: AssetWriter) -> tuple[list[VectorFace], tuple[str, ...]]:
        """The faces whose mask finds skin, in their order, and a line for each of the others, which are left out.

        Raises `NoFaceError` when it finds none.
        """
        faces = sorted(done.faces, key=lambda face: (face.first, face.left_to_right))
        bare = [face for face in faces if not face.has_skin()]
        advice = ': mask="ycbcr" tells it by its colour, mask="landmarks" does not' if self.mask == "ycbcr" else ""
        if len(bare) == len(faces):
            count = f"{len(faces)} face" + ("s" if len(faces) > 1 else "")
            raise NoFaceError(f"no skin found on any of {count} of {self.path.name}{advice}")
        for face in bare:
            writer.drop_track(face.number)
        lines = (f"no skin found on a face seen from frame {face.first} on, which is left out{advice}" for face in bare)
        return [face for face in faces if face not in bare], tuple(lines)

    def _track(self, frames: Iterable[tuple[int, Picture]]) -> FaceTracks:
        return track_faces(frames, min_face_px=self.min_face_px, frame_rate=self.rate)

    def _check_width(self, found: FaceTracks) -> None:
        """Raise `NoFaceError` or `FaceTooSmallError` unless one face is wide enough."""
        widest = _widest(found)
        if widest < self.min_face_px:
            raise self._no_usable_face(widest, found.frame_count, found.too_brief)

    def _no_usable_face(self, widest: float, frame_count: int, too_brief: bool) -> NoFaceError | FaceTooSmallError:
        return no_usable_face(
            self.path.name,
            frame_count,
            widest=widest,
            too_brief=too_brief,
            image=self.media.kind == "image",
            min_px=self.min_face_px,
            advised_px=self.advised_face_px,
        )
