"""A track on its way from who follows it to who vectorises it: its key view, then its rows, stretch by stretch."""

from __future__ import annotations

from dataclasses import dataclass, replace

from pvg._arrays import Floats
from pvg.face import Landmarks
from pvg.landmarks import FaceTrack
from pvg.picture import Picture
from pvg.skin import Scene


@dataclass(frozen=True, eq=False)
class KeyView:
    """The frame whose colours a track is known by.

    row: counted from the track's first frame;  scene: of that frame, if there is one;  haze: see `pvg.haze`.
    """

    row: int
    picture: Picture
    landmarks: Landmarks
    scene: Scene | None
    haze: int = 0

    @classmethod
    def of(cls, track: FaceTrack, row: int, picture: Picture, scene: Scene | None) -> KeyView:
        """A row of a track, seen in a picture."""
        return cls(row, picture, track.landmarks[row], scene, 0 if scene is None else scene.haze)


@dataclass(frozen=True, eq=False)
class Stretch:
    """Some consecutive frames of one track, with the final landmarks; of one that has ended perhaps none.

    number: the track's, in the order they were found;  start: its first row here, counted from the track's first;
    rows: their landmarks;  pictures: of every row, the face's surroundings;
    visible: (n,) float32 in [0, 1], see `fading.opacity`;
    scenes: of every row, the whole picture, or none where they were not asked for;  key: with a track's first stretch;
    last: whether the track ends with it.
    """

    number: int
    start: int
    rows: FaceTrack
    pictures: tuple[Picture, ...]
    visible: Floats
    scenes: tuple[Scene, ...]
    key: KeyView | None
    last: bool


def rows_between(track: FaceTrack, start: int, stop: int) -> FaceTrack:
    """The part of a track in the frames [start, stop)."""
    part = slice(start - track.first, stop - track.first)
    return replace(
        track,
        first=start,
        landmarks=track.landmarks[part],
        score=track.score[part],
        pose=track.pose[part],
    )
