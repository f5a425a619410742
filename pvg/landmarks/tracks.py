"""Tracks of faces: those being followed, and what comes of them."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from dataclasses import dataclass, field, replace

import numpy as np

from pvg._arrays import Bools, Floats, Ints
from pvg.face import Landmarks, layout
from pvg.landmarks.mesh import Mesh
from pvg.landmarks.pose import head_pose

FACE_GATE = 0.5
CONFIRMED_SCORE = 0.95
"""A track counts as a face when its median score and enough of its frames reach this. Faces of the test clips have
medians above 0.97 however small or dark; lettering and cartoons that pass the frame gate stay below 0.93 or are
brief."""


@dataclass(frozen=True)
class FaceTrack:
    """One face over consecutive frames of one shot.

    first: index of its first frame; landmarks: of n frames, source pixels; score: (n,) float32 in [0, 1], 0 where the
    face was not seen and its points are interpolated;
    pose: (n, 3) float32 yaw, pitch, roll in degrees.
    """

    first: int
    landmarks: Landmarks
    score: Floats
    pose: Floats

    @property
    def last(self) -> int:
        """Index of the last frame."""
        return self.first + len(self.score) - 1

    @property
    def width_px(self) -> float:
        """Median extent of the face contour, in source pixels, over the frames that show it.

        The longer of its extents in x and y, so that a turned or leaning head does not count as a small face.
        """
        return float(np.median(self.extents[self.score > 0]))

    @property
    def extents(self) -> Floats:
        """(n,) the longer extent of the face contour in x or y in every frame, source pixels."""
        return np.asarray(np.ptp(self.landmarks.points[:, layout.CONTOUR], axis=1).max(axis=1), np.float32)


@dataclass(frozen=True)
class FaceTracks:
    """All faces of a clip.

    tracks: ordered by first frame, then from left to right; cuts: first frame of every shot but the first;
    frame_count: how many frames were looked at;  over_limit: how many faces that were wide enough had no place, in the
    frame with most of them;  too_brief: whether there are no tracks, but something was a face for too short a time.
    """

    tracks: tuple[FaceTrack, ...]
    cuts: tuple[int, ...]
    frame_count: int
    over_limit: int = 0
    too_brief: bool = False


@dataclass(frozen=True, eq=False)
class Seen:
    """A face in one frame: its landmarks, the mesh's score in [0, 1], and (3,) yaw, pitch, roll in degrees."""

    landmarks: Landmarks
    score: float
    pose: Floats


@dataclass(eq=False)
class OpenTrack:
    """A face being followed. `frames` and `seen` run parallel and skip the frames where it was not seen.

    first: its first frame, also once the beginning is forgotten; last_mesh: where it was last seen; scores: of the
    frames that showed it whole, of which as many are forgotten; left_picture: whether it left the picture after them;
    split_from: the track that it was a part of.
    """

    first: int
    last_mesh: Mesh
    frames: list[int] = field(default_factory=list)
    seen: list[Seen] = field(default_factory=list)
    scores: list[float] = field(default_factory=list)
    left_picture: bool = False
    split_from: OpenTrack | None = None

    def add(self, index: int, mesh: Mesh) -> None:
        """The face was seen in frame `index`."""
        self.scores.append(mesh.score)
        self._append(index, mesh)

    def carry(self, index: int, mesh: Mesh) -> None:
        """Part of the face is in frame `index`, its points moved with the picture: this says nothing of what it is."""
        self._append(index, replace(mesh, score=FACE_GATE))

    def take_back(self, index: int) -> None:
        """The face was not seen in frame `index` after all, the last of its frames but not the only one."""
        if self.last == index:
            if not self.is_carried:
                self.scores.pop()
            self.frames.pop()
            self.seen.pop()

    def split(self, frame: int, mixed_from: int) -> OpenTrack:
        """End before `frame`, which is not the first that showed the face. Returns what came from there on.

        mixed_from: from this frame on, no later one, it may show two faces: no colours are to be taken from there.
        """
        begin, mixed = bisect_left(self.frames, frame), bisect_left(self.frames, mixed_from)
        scores = len(self.scores) - sum(one.score > FACE_GATE for one in self.seen[begin:])
        self.seen[mixed:] = [replace(one, score=FACE_GATE) for one in self.seen[mixed:]]
        rest = OpenTrack(self.frames[begin], self.last_mesh, split_from=self, left_picture=self.left_picture)
        rest.frames, rest.seen, rest.scores = self.frames[begin:], self.seen[begin:], self.scores[scores:]
        del self.frames[begin:], self.seen[begin:], self.scores[scores:]
        self.left_picture = False
        return rest

    def _append(self, index: int, mesh: Mesh) -> None:
        self.left_picture = False
        self.frames.append(index)
        self.seen.append(Seen(Landmarks.from_mesh(mesh.points), mesh.score, head_pose(mesh)))
        self.last_mesh = mesh

    def seen_by(self, frame: int) -> Seen:
        """What the last frame at or before `frame` showed that showed the face; it must not be forgotten."""
        return self.seen[bisect_right(self.frames, frame) - 1]

    @property
    def last(self) -> int:
        """The last frame that showed it."""
        return self.frames[-1]

    @property
    def is_carried(self) -> bool:
        """Whether where it was last seen its points went with the picture."""
        return self.seen[-1].score <= FACE_GATE

    @property
    def box(self) -> Floats:
        """(4,) x0, y0, x1, y1 of the mesh where it was last seen."""
        return box_of(self.last_mesh.points)

    def is_confident(self, enough: int) -> bool:
        """Whether at least `enough` of its frames, and most of them, were seen with confidence."""
        scores = np.array(self.scores)
        confident = scores >= CONFIRMED_SCORE
        return int(confident.sum()) >= enough and float(np.median(scores)) >= CONFIRMED_SCORE

    def raw(self, start: int | None = None) -> FaceTrack:
        """The track so far, gaps filled linearly, from the last frame at or before `start` that showed the face."""
        begin = 0 if start is None else max(0, bisect_right(self.frames, start) - 1)
        seen = np.array(self.frames[begin:])
        every = np.arange(seen[0], seen[-1] + 1)
        rows = self.seen[begin:]
        score = np.zeros(len(every), np.float32)
        score[seen - seen[0]] = [row.score for row in rows]
        stacked = np.stack([row.landmarks.stacked for row in rows])
        return FaceTrack(
            first=int(seen[0]),
            landmarks=Landmarks.unstack(fill_gaps(stacked, seen, every)),
            score=score,
            pose=fill_gaps(np.stack([row.pose for row in rows]), seen, every),
        )

    def forget(self, frame: int) -> None:
        """Drop what came before the last frame at or before `frame` that showed the face.

        Of a track that is known to be a face: `is_confident` tells of what is left.
        """
        begin = max(0, bisect_right(self.frames, frame) - 1)
        del self.scores[: sum(one.score > FACE_GATE for one in self.seen[:begin])]
        del self.frames[:begin], self.seen[:begin]

    def shows(self, start: int, stop: int) -> Bools:
        """(stop − start,) whether each frame showed the face; it must not be forgotten."""
        shown = np.zeros(stop - start, np.bool_)
        shown[np.array(self.frames[bisect_left(self.frames, start) : bisect_left(self.frames, stop)], int) - start] = (
            True
        )
        return shown


def fill_gaps(values: Floats, seen: Ints, every: Ints) -> Floats:
    """Interpolate values (n, …) known at frames `seen` linearly to the frames `every`."""
    if len(seen) == len(every):
        return values
    after = np.clip(np.searchsorted(seen, every), 1, len(seen) - 1)
    share = (every - seen[after - 1]) / (seen[after] - seen[after - 1])
    share = share.reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray(values[after - 1] * (1 - share) + values[after] * share, np.float32)


def box_of(points: Floats) -> Floats:
    """(4,) x0, y0, x1, y1 of points (n, 2)."""
    return np.concatenate([points.min(axis=0), points.max(axis=0)])
