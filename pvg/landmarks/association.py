"""Data association: which of the followed faces one that was found is, by where it is and by how it looks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pvg._arrays import Floats
from pvg.face import Landmarks
from pvg.landmarks.detector import box_iou
from pvg.landmarks.mesh import Mesh
from pvg.landmarks.pose import head_pose
from pvg.landmarks.replacing import FaceViews
from pvg.landmarks.tracks import OpenTrack, box_of
from pvg.picture import Picture

SAME_FACE_IOU, SAME_FACE_WITHIN = 0.4, 0.8
REJOIN_DISTANCE = 1.0
REJOIN_SIZE_RATIO = 1.6
_CLEARLY_LIKER, _SURELY_LIKE = 0.2, 0.8  # correlations of views of a face


class Appearances:
    """How the faces of tracks have looked of late, and which of them another face is likest to.

    step: frames, see `frames_a_step`.
    """

    def __init__(self, step: int) -> None:
        self._step = step
        self._views: dict[OpenTrack, FaceViews] = {}
        self._seen: list[FaceViews] = []  # of those that the last frame showed

    def forget(self) -> None:
        """Begin anew, at a cut."""
        self._views.clear()
        self._seen.clear()

    def look(self, tracks: Sequence[OpenTrack], index: int, picture: Picture) -> None:
        """Remember how the faces of a frame look."""
        self._views = {track: self._views.get(track, FaceViews(self._step)) for track in tracks}
        seen = [track for track in tracks if track.last == index and not track.is_carried]
        for track in seen:
            self._views[track].add(index, picture, track.seen[-1].landmarks, track.seen[-1].pose)
        self._seen = [self._views[track] for track in seen]

    def show_another(self) -> bool:
        """Whether another person seems to have taken the place of one of those that were looked at last."""
        return any(views.show_another() for views in self._seen)

    def show_same(self) -> bool:
        """Whether one of those that were looked at last is surely who it was: who is lost may have gone."""
        return any(views.show_same() for views in self._seen)

    def whose(self, mesh: Mesh, finders: Sequence[OpenTrack], lost: Sequence[OpenTrack], picture: Picture) -> OpenTrack:
        """Whose face it is that tracks have found, while others nearby are lost: that of the one that it is likest to.

        Where that is not clear, it is of one of the finders that was seen last; of several such of the one that is
        nearest to where it was.
        """
        if len(finders) == 1 and not lost:
            return finders[0]
        clear = self.likest([*finders, *lost], mesh, picture)
        if clear is not None:
            return clear

        def steady(track: OpenTrack) -> tuple[int, float]:
            return -track.last, float(np.linalg.norm((mesh.points - track.last_mesh.points).mean(axis=0)))

        return min(finders, key=steady)

    def likest(self, tracks: Sequence[OpenTrack], mesh: Mesh, picture: Picture) -> OpenTrack | None:
        """The track whose face is likest to the one at a mesh, if that is clear.

        Of one whose views are in other poses nothing is known: then the likest is to be surely it.
        """
        landmarks, pose = Landmarks.from_mesh(mesh.points), head_pose(mesh)
        asked = [self._views.get(track, FaceViews()).likeness(picture, landmarks, pose) for track in tracks]
        alike = np.array([_SURELY_LIKE - _CLEARLY_LIKER if one is None else one for one in asked])
        first = int(np.argmax(alike))
        others = np.delete(alike, first)
        is_clear = asked[first] is not None and bool((alike[first] - others >= _CLEARLY_LIKER).all())
        return tracks[first] if is_clear else None


def is_taken(tracks: Sequence[OpenTrack], index: int, box: Floats) -> bool:
    """Whether one of the tracks has its face in this box, (4,), in this frame.

    Of a face on the picture's edge the detector may take a part for a small face.
    """
    here = [track for track in tracks if track.last == index]
    if not here:
        return False
    part = [track.is_carried and _share_within(box, track.box) > SAME_FACE_WITHIN for track in here]
    return any(part) or bool((box_iou(box, np.stack([track.box for track in here])) > SAME_FACE_IOU).any())


def lost_near(tracks: Sequence[OpenTrack], index: int, mesh: Mesh) -> list[tuple[float, OpenTrack]]:
    """The tracks not seen in this frame that are near a face in place and size, and how far off in its sizes."""
    near: list[tuple[float, OpenTrack]] = []
    box = box_of(mesh.points)
    side = float((box[2:] - box[:2]).max())
    for track in tracks:
        if track.last == index:
            continue
        before = track.box
        before_side = float((before[2:] - before[:2]).max())
        shift = float(np.linalg.norm((box[:2] + box[2:] - before[:2] - before[2:]) / 2))
        distance = shift / max(side, before_side)
        ratio = max(side, before_side) / max(min(side, before_side), 1e-6)
        if ratio <= REJOIN_SIZE_RATIO and distance < REJOIN_DISTANCE:
            near.append((distance, track))
    return near


def _share_within(box: Floats, other: Floats) -> float:
    """Share of a box (4,) x0, y0, x1, y1 that lies in another."""
    both = np.minimum(box[2:], other[2:]) - np.maximum(box[:2], other[:2])
    return float(np.prod(np.maximum(both, 0)) / max(np.prod(box[2:] - box[:2]), 1e-6))
