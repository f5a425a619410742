"""All frames of a clip: every face followed in one reading, and in a second one what the first had to defer."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass

from pvg._arrays import Floats
from pvg._threads import ahead
from pvg.asset import AssetWriter
from pvg.landmarks import FaceTrack
from pvg.picture import Picture
from pvg.skin import Scene, SceneReader
from pvg.vectorization.face_maker import FaceMaker, FoundFaces
from pvg.vectorization.face_messages import over_limit_warning
from pvg.vectorization.fading import opacity
from pvg.vectorization.following import CHUNK, DeferredTrack, Following
from pvg.vectorization.source_reader import SourceReader
from pvg.vectorization.stretch import KeyView, Stretch, rows_between
from pvg.vectorization.vector_face import VectorFace

VECTORIZE, SECOND_READING = "vectorize", "second reading"  # stages of progress

_AHEAD = CHUNK + 4  # frames: a face's frames come a chunk at a time, and landmarks go on while their skin is found


def follow_all_faces(source: SourceReader, maker: FaceMaker, writer: AssetWriter) -> FoundFaces:
    """Follow every face of the clip and write all its frames.

    Raises `NoFaceError` or `FaceTooSmallError` when there is none that can be used.
    """
    following = Following(
        min_face_px=maker.min_face_px,
        frame_rate=source.frame_rate,
        from_first_row=maker.is_chain,
        scenes=maker.uses_scenes,
    )
    faces = _first_reading(source, maker, following, writer)
    shots, frame_count = (0, *following.cuts), following.frame_count
    source.notices.extend(over_limit_warning(following.over_limit))
    deferred, widest = following.deferred()
    if deferred:
        first = max(faces, default=-1) + 1
        tracks = dict(enumerate(deferred, first))
        faces |= _second_reading(source, maker, following, tracks, shots, writer)
    if not faces:
        raise maker.no_usable_face(source, frame_count, widest=widest, too_brief=following.too_brief)
    return FoundFaces(tuple(faces.values()), shots, frame_count)


def _first_reading(
    source: SourceReader, maker: FaceMaker, following: Following, writer: AssetWriter
) -> dict[int, VectorFace]:
    """The faces that can be followed while the clip is read, by the number of their track."""
    faces: dict[int, VectorFace] = {}
    settled = 0
    with (
        contextlib.closing(source.pictures()) as pictures,
        contextlib.closing(ahead(following.advances(pictures), _AHEAD)) as advances,
    ):
        for advance in advances:
            for stretch in advance.stretches:
                if stretch.key is not None:
                    faces[stretch.number] = maker.face(stretch.number, stretch.rows, stretch.key)
                faces[stretch.number].add(stretch, writer)
            for done in range(settled + 1, advance.settled + 1):
                source.report(VECTORIZE, done, max(source.media.frame_count, done))
            settled = max(settled, advance.settled)
            for stretch in advance.stretches:
                if stretch.last:
                    faces[stretch.number].finish(writer)
    return faces


def _second_reading(
    source: SourceReader,
    maker: FaceMaker,
    following: Following,
    deferred: dict[int, DeferredTrack],
    shots: tuple[int, ...],
    writer: AssetWriter,
) -> dict[int, VectorFace]:
    """Follow tracks that are known from end to end, by number."""
    frame_count = following.frame_count
    late = {number: _LateTrack.of(number, one, shots, frame_count) for number, one in deferred.items()}
    faces: dict[int, VectorFace] = {}
    start, stop = min(one.track.first for one in late.values()), max(one.track.last for one in late.values()) + 1
    reader = SceneReader()
    with source.reported(SECOND_READING, start, stop, frame_count) as pictures:
        for index, picture in pictures:
            now = [one for one in late.values() if one.track.first <= index <= one.track.last]
            there = [one.track.landmarks[index - one.track.first] for one in now]
            there += following.places.near(index)
            scenes: tuple[Scene, ...] = ()
            if maker.uses_scenes:
                scenes = (reader.step(picture, there, cut=index in shots),)
            for one in now:
                number, track = one.number, one.track
                if index == track.first:
                    key = _late_key(source, maker, track, following.key_row(track), frame_count)
                    faces[number] = maker.face(number, track, key)
                faces[number].add(one.stretch(index, picture, scenes), writer)
                if index == track.last:
                    faces[number].finish(writer)
    return faces


@dataclass(frozen=True, eq=False)
class _LateTrack:
    """A track that is known from end to end, smoothed;  visible: (n,) float32 in [0, 1], see `opacity`."""

    number: int
    track: FaceTrack
    visible: Floats

    @classmethod
    def of(cls, number: int, deferred: DeferredTrack, shots: tuple[int, ...], frame_count: int) -> _LateTrack:
        """A deferred track of a clip with these shots."""
        track = deferred.smoothed()
        return cls(number, track, opacity(track, shots, frame_count, left_picture=deferred.left_picture))

    def stretch(self, index: int, picture: Picture, scenes: tuple[Scene, ...]) -> Stretch:
        """Its row in the frame `index` alone."""
        row, rows = index - self.track.first, rows_between(self.track, index, index + 1)
        last = index == self.track.last
        return Stretch(self.number, row, rows, (picture,), self.visible[row : row + 1], scenes, None, last)


def _late_key(source: SourceReader, maker: FaceMaker, track: FaceTrack, row: int, frame_count: int) -> KeyView:
    """The key view of a track that is known from end to end, read from the clip."""
    picture = source.picture(track.first + row, frame_count)
    scene = SceneReader().step(picture, [track.landmarks[row]]) if maker.uses_scenes else None
    return KeyView.of(track, row, picture, scene)
