"""Faces followed in one reading of a clip: landmarks run ahead, what needs their smoothed course comes behind.

Smoothing without lag needs what comes after, and a track counts as a face only once enough of it was seen. Instead of
reading the clip twice, the surroundings of each face are kept for some dozens of frames, a tenth of a frame each, and
the whole picture at a small size; the whole clip is never held. What cannot be told that soon is left for a second
reading: tracks that begin too doubtful, too small, or without one good view of the face.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from pvg._arrays import Floats
from pvg.face import Landmarks
from pvg.landmarks import LOOKBACK, FaceTrack, FaceTracker, OpenTrack, smooth
from pvg.picture import Box, Picture, clipped
from pvg.skin import Scene, SceneReader
from pvg.vectorization.fading import FADE_REACH, faded
from pvg.vectorization.key_frames import first_good_row, good_rows
from pvg.vectorization.places import Places
from pvg.vectorization.stretch import KeyView, Stretch, rows_between
from pvg.vectorization.surroundings import surroundings

CHUNK = 32  # frames a face is followed by at a time
# frames that must be known after the last of them: cuts that are told afterwards lie back that far, and the smoothing's
# filters reach 22
LOOKAHEAD = LOOKBACK
HISTORY = 96  # frames before them that tell jitter from movement
# of the contrast of a shot's pictures: less is a fade, more is none [measured: 0.8 and more in clips without one]
_FADED, _CLEAR = 0.75, 0.95


@dataclass(frozen=True, eq=False)
class Advance:
    """What one more frame of the clip made final.

    settled: how many of the clip's first frames need nothing more;  stretches: what became final.
    """

    settled: int
    stretches: tuple[Stretch, ...]


@dataclass
class _Course:
    """A track on its way: what is kept until its landmarks are final."""

    number: int
    track: OpenTrack
    aspect: float  # of the raster that its skin is cut on
    pictures: dict[int, Picture] = field(default_factory=dict)
    done: int = 0  # the next frame to settle
    begun: bool = False
    deferred: bool = False  # to a second reading


@dataclass(frozen=True, eq=False)
class DeferredTrack:
    """A track for a second reading, not smoothed;  left_picture: whether its face leaves the picture after it."""

    track: FaceTrack
    left_picture: bool

    def smoothed(self) -> FaceTrack:
        """The track as it would be if it had been followed: smoothing a long one at once takes ten times its memory."""
        track = self.track
        shown = (track.first + np.flatnonzero(track.score > 0)).tolist()
        stacked, pose = np.empty_like(track.landmarks.stacked), np.empty_like(track.pose)
        for start in range(track.first, track.last + 1, CHUNK):
            stop = min(start + CHUNK, track.last + 1)
            # gaps are filled between the frames at their ends
            begin = shown[max(0, bisect_right(shown, start - HISTORY) - 1)]
            end = shown[min(len(shown) - 1, bisect_left(shown, start + CHUNK + LOOKAHEAD))] + 1
            rows = rows_between(smooth(rows_between(track, begin, end)), start, stop)
            stacked[start - track.first : stop - track.first] = rows.landmarks.stacked
            pose[start - track.first : stop - track.first] = rows.pose
        return replace(track, landmarks=Landmarks.unstack(stacked), pose=pose)


class Following:
    """Follows all faces of a clip; `advances` is to be run through once.

    Then `cuts`, `frame_count`, `over_limit`, `too_brief` and `deferred` tell of the whole clip, and `places` and
    `key_row` of the frames of tracks for a second reading: of others nothing is kept.
    """

    def __init__(
        self, *, min_face_px: float, frame_rate: float, from_first_row: bool = False, scenes: bool = True
    ) -> None:
        """from_first_row: whether a track's key view is its first row;  scenes: whether stretches have them."""
        self._scene_reader = SceneReader() if scenes else None
        self._scenes: dict[int, Scene] = {}
        self._contrasts: dict[int, float] = {}  # of them, and of those that are gone and come again
        self._kept_from = 0  # the first frame of which everything is kept
        #: of the faces that are followed
        self.places = Places()
        self._looked = -1  # the last frame with a scene
        self._tracker = FaceTracker(min_face_px=min_face_px, frame_rate=frame_rate)
        self._min_face_px = min_face_px
        self._from_first_row = from_first_row
        self._courses: list[_Course] = []
        self._deferred: list[tuple[OpenTrack, float]] = []  # with its width, px
        self._found = 0
        self._finished = False

    @property
    def cuts(self) -> tuple[int, ...]:
        """First frames of the shots but the first."""
        return tuple(self._tracker.cuts)

    @property
    def frame_count(self) -> int:
        """Frames that were read."""
        return self._tracker.frame_count

    @property
    def over_limit(self) -> int:
        """How many faces that are wide enough had no place, in the frame with most of them."""
        return self._tracker.over_limit

    @property
    def too_brief(self) -> bool:
        """Whether something left was a face for too short a time, or too doubtful in its other frames."""
        return any(track.is_confident(1) for track, _ in self._deferred)

    def deferred(self) -> tuple[tuple[DeferredTrack, ...], float]:
        """After all frames: the tracks for a second reading, and the width in px of the widest face that is too small.

        The width is 0 without one.
        """
        faces = [(track, width) for track, width in self._deferred if self._tracker.is_face(track, finished=True)]
        narrow = [width for _, width in faces if width < self._min_face_px]
        wide = (track for track, width in faces if width >= self._min_face_px)
        return tuple(DeferredTrack(track.raw(), track.left_picture) for track in wide), max(narrow, default=0.0)

    def advances(self, frames: Iterable[tuple[int, Picture]]) -> Iterator[Advance]:
        """What becomes final with each frame; frames: (index, picture) of the whole clip in order."""
        for index, picture in frames:
            cuts = len(self._tracker.cuts)
            self._tracker.step(index, picture)
            self._split()
            stretches = self._close()
            self._look_around(index, picture, cut=len(self._tracker.cuts) > cuts)
            stretches += self._look_at_faces(index, picture)
            settled = self._settled(index + 1)
            self._forget(settled)
            yield Advance(settled, tuple(stretches))
        self._tracker.end()
        self._finished = True
        yield Advance(self.frame_count, tuple(self._close()))

    def _forget(self, settled: int) -> None:
        """Let go of what was kept of the frames that are settled, but of what a second reading asks for."""
        for frame in [frame for frame in self._scenes if frame < settled]:
            del self._scenes[frame]
        for frame in range(self._kept_from, settled):
            if not self._comes_again(frame, frame):
                self._contrasts.pop(frame, None)
        self.places.forget(self._kept_from, settled, but=self._comes_again)
        self._kept_from = settled

    def _comes_again(self, start: int, last: int) -> bool:
        """Whether a second reading may come to one of the frames from `start` to `last`, which are settled."""
        return any(course.deferred and course.track.first <= last for course in self._courses) or any(
            track.first <= last and start <= track.last for track, _ in self._deferred if track.frames
        )

    def _look_around(self, index: int, picture: Picture, *, cut: bool) -> None:
        """Keep the scene of a frame with faces;  cut: whether one was told with it."""
        if self._scene_reader is not None and self._tracker.open:
            faces = [track.seen[-1].landmarks for track in self._tracker.open]
            scene = self._scene_reader.step(picture, faces, cut=cut or index - 1 != self._looked)
            self._looked = index
            self._scenes[index], self._contrasts[index] = scene, scene.contrast

    def _look_at_faces(self, index: int, picture: Picture) -> list[Stretch]:
        """Keep the surroundings of a frame's faces, and settle the tracks that are far enough ahead."""
        followed = [(track, self._course(track)) for track in self._tracker.open]
        followed = [(track, course) for track, course in followed if not course.deferred]
        around = [surroundings(track.seen[-1].landmarks, course.aspect) for track, course in followed]
        whole = _take_more(around, picture.size)
        out = []
        for (track, course), box in zip(followed, around, strict=True):
            course.pictures[index] = picture if whole else picture.part(box)
            if track.last - LOOKAHEAD - course.done >= CHUNK:
                out += self._settle(course, course.done + CHUNK)
        return out

    def _settled(self, upto: int) -> int:
        return min([upto, *(course.done for course in self._courses if not course.deferred)])

    def _course(self, track: OpenTrack) -> _Course:
        for course in self._courses:
            if course.track is track:
                return course
        x0, y0, x1, y1 = surroundings(track.seen[0].landmarks)
        return self._begin(track, (x1 - x0) / (y1 - y0))

    def _begin(self, track: OpenTrack, aspect: float) -> _Course:
        course = _Course(self._found, track, aspect, done=track.first)
        self._found += 1
        self._courses.append(course)
        return course

    def _split(self) -> None:
        """Give what is kept of a track that a cut has split, told afterwards, to who comes after it."""
        for track in self._tracker.open:
            if track.split_from is not None:
                before = self._course(track.split_from)
                after = self._begin(track, before.aspect)
                after.deferred = before.deferred
                after.pictures = {k: before.pictures.pop(k) for k in list(before.pictures) if k >= track.first}
                track.split_from = None

    def _close(self) -> list[Stretch]:
        """Settle all that is left of the tracks that ended."""
        closed = {id(track) for track in self._tracker.take_closed()}
        ended = [course for course in self._courses if id(course.track) in closed]
        self._courses = [course for course in self._courses if id(course.track) not in closed]
        out = []
        for course in ended:
            if not course.deferred:
                # frames without the face may be settled when a cut, told afterwards, ends it before them
                out += self._settle(course, max(course.track.last + 1, course.done))
            if course.deferred:
                width = course.track.raw().width_px
                if width < self._min_face_px:  # nobody follows it: a crowd's faces would fill the memory
                    course.track.seen.clear()
                    course.track.frames.clear()
                self._deferred.append((course.track, width))
        return out

    def _settle(self, course: _Course, stop: int) -> list[Stretch]:
        """Make the landmarks of the frames up to `stop` final, if the track is one to follow.

        When it has ended that may be none: its last stretch is empty then.
        """
        track, start, last = course.track, course.done, stop > course.track.last
        window = smooth(track.raw(start - HISTORY))
        key = None
        if not course.begun:
            key = self._key_view(course, window, ended=last)
            if key is None:
                course.deferred = True
                course.pictures.clear()
                return []
            course.begun = True
        visible = self._visible(track, start, stop)
        pictures = tuple(course.pictures.pop(frame) for frame in range(start, stop))
        scenes = tuple(self._scenes[frame] for frame in range(start, stop)) if self._scene_reader else ()
        course.done = stop
        track.forget(stop - HISTORY)
        rows = rows_between(window, start, stop)
        self.places.add(course.number, rows)
        return [Stretch(course.number, start - track.first, rows, pictures, visible, scenes, key, last)]

    def _visible(self, track: OpenTrack, start: int, stop: int) -> Floats:
        """(stop − start,) float32 in [0, 1], `fading.opacity` in the frames [start, stop) of a track."""
        if start == stop:
            return np.empty(0, np.float32)
        before, beyond = max(track.first, start - FADE_REACH - 1), min(track.last + 1, stop + FADE_REACH + 1)
        near = faded(
            track.shows(before, beyond),
            before=before > track.first or track.first == 0 or track.first in self._tracker.cuts,
            after=beyond <= track.last or track.left_picture or self._whole_to(track.last + 1),
        )
        return near[start - before : stop - before]

    def _whole_to(self, frame: int) -> bool:
        """Whether a shot or the clip ends before `frame`."""
        return frame in self._tracker.cuts or (self._finished and frame >= self.frame_count)

    def _key_view(self, course: _Course, window: FaceTrack, *, ended: bool) -> KeyView | None:
        """The view that a track starts from; None when it is no face yet, too small, or shows none that is good."""
        if not self._tracker.is_face(course.track, finished=self._finished) or window.width_px < self._min_face_px:
            return None
        row = self.key_row(window)
        if not (ended or self._from_first_row or good_rows(window)[row]):
            return None
        frame = window.first + row
        return KeyView.of(window, row, course.pictures[frame], self._scenes.get(frame))

    def key_row(self, window: FaceTrack) -> int:
        """The first row that shows the face well and lies in no fade from or to white, if those are known.

        Or the first of all, where tracks begin there.
        """
        if self._from_first_row:
            return 0
        row, frames = first_good_row(window), range(window.first, window.last + 1)
        if not all(frame in self._contrasts for frame in frames):
            return row
        contrasts = np.array([self._contrasts[frame] for frame in frames])
        if contrasts[row] >= _FADED * contrasts.max():
            return row
        return first_good_row(window, np.asarray(contrasts >= _CLEAR * contrasts.max()))


def _take_more(boxes: Iterable[Box], size: tuple[int, int]) -> bool:
    """Whether parts of a picture, (height, width), take more than the whole: of many faces or large ones."""
    held = [clipped(box, (0, 0, size[1], size[0])) for box in boxes]
    return sum((x1 - x0) * (y1 - y0) for x0, y0, x1, y1 in held) > size[0] * size[1]
