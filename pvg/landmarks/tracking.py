"""Follow the faces of a clip frame by frame, holding no pixels beyond the frame at hand."""

from __future__ import annotations

from collections.abc import Iterable
from operator import itemgetter

import numpy as np

from pvg._arrays import Bytes, Floats
from pvg.landmarks.association import SAME_FACE_IOU, Appearances, is_taken, lost_near
from pvg.landmarks.cuts import Change, CutDetector
from pvg.landmarks.detector import Detection, box_iou, detect_faces
from pvg.landmarks.mesh import Mesh, fit_landmarks, region_of_points
from pvg.landmarks.motion import carried, share_inside
from pvg.landmarks.replacing import EVERY, LAG
from pvg.landmarks.tracks import CONFIRMED_SCORE, FACE_GATE, FaceTracks, OpenTrack, box_of
from pvg.picture import Picture, as_picture
from pvg.region import Region

MAX_FACES = 12
"""Followed at a time: each costs its time in every frame, and 10 to 30 MB."""
FOLLOWED_PX = 24.0
"""Narrower faces are followed only where they are asked for."""
_LARGER = 1.5  # times as wide as who gives its place to it: less, and two faces would take turns
DETECT_EVERY, _DETECTIONS_A_SECOND = 6, 4
"""Frames from one run of the detector to the next, and how many runs a second there are at least, where every frame has
no more: until then the skin of who comes in may count as another person's. It costs half a millisecond a frame."""
MIN_SEEN, MIN_SEEN_IN_SHOT, _SHOWN_S = 5, 2, 1 / 12
"""Frames that show a face with confidence before its track counts, or all of a shorter shot: of one frame where that
lasts as long. A shot of one frame at 25 a second is a flash or a fault."""
ON_EDGE, LEAST_FITTED, LEAST_SEEN = 0.95, 0.75, 0.1
"""Shares of the mesh's points inside the picture: with fewer than the first a face is on the edge, with fewer than the
second the mesh fits worse than its points go with the picture, with fewer than the last it has left."""
LOOKBACK = 32
"""How many frames ago a cut that is told afterwards can have been: what is further back may be settled."""
BLIND_FITS = 5
"""How many frames a lost face is still looked for where it was last; after that only the detector looks."""
_LOOKED_AT_A_SECOND = 25.0
_LOOKS_WAITED = 3
"""How often another person is seen in a face's place before the picture need not have come to rest."""
_WAY = 0.1, 0.5
"""Shares of the way to another picture: where a face is no longer only its own, and where it is the other's."""


def frames_a_step(frame_rate: float) -> int:
    """Frames from one to the next of those that are compared with each other: all of them below 37.5 a second.

    What is told by how pictures follow each other goes by time: of more frames a second some 25 are looked at.
    """
    return max(1, round(frame_rate / _LOOKED_AT_A_SECOND))


def track_faces(
    frames: Iterable[tuple[int, Picture | Bytes]],
    *,
    max_faces: int = MAX_FACES,
    min_face_px: float = FOLLOWED_PX,
    frame_rate: float = 25.0,
) -> FaceTracks:
    """Follow up to max_faces faces at a time through consecutive frames.

    frames: (index, picture or (H, W, 3) uint8 RGB), indices rising by one. The detector runs on the first frame of a
    shot, while a face is lost and every 6 frames, of slow clips four times a second; otherwise each face's crop
    follows its last landmarks. A track ends at a cut or when its face stays away for more than a second (frame_rate
    frames). Of more faces than max_faces the narrowest gives its place to one that is half as wide again, or at least
    min_face_px wide where it is not; the others are counted. Faces whose mesh measures less than 24 px, or min_face_px
    where that is less, across its longer side are not followed. The points are raw: see `smooth`. Raises ModelError
    without weights, ValueError when an index is skipped.
    """
    tracker = FaceTracker(max_faces=max_faces, min_face_px=min_face_px, frame_rate=frame_rate)
    for index, frame in frames:
        tracker.step(index, as_picture(frame))
    return tracker.result()


class FaceTracker:
    """Follows faces through frames given one at a time; see `track_faces`.

    open: the faces being followed, oldest first;  closed: those that ended;  cuts: first frames of the shots but the
    first;  frame_count: frames seen;  over_limit: see `FaceTracks`.
    """

    def __init__(
        self, *, max_faces: int = MAX_FACES, min_face_px: float = FOLLOWED_PX, frame_rate: float = 25.0
    ) -> None:
        self._max_faces = max_faces
        self._min_face_px = min_face_px
        self._max_lost = round(frame_rate)
        self._detect_every = max(1, min(DETECT_EVERY, round(frame_rate / _DETECTIONS_A_SECOND)))
        self._min_seen_in_shot = max(1, min(MIN_SEEN_IN_SHOT, round(frame_rate * _SHOWN_S)))
        self._step = frames_a_step(frame_rate)
        self._cut_detector = CutDetector(remembered=LOOKBACK, step=self._step)
        self._appearances = Appearances(self._step)
        self._seen_another = 0  # times that another person seemed to be in a face's place, since the last cut
        self.cuts: list[int] = []
        self.open: list[OpenTrack] = []
        self.closed: list[OpenTrack] = []
        self.frame_count = 0
        self.over_limit = 0
        self._last_detection: int | None = None
        self._expected: int | None = None
        self._before: Picture | None = None

    def step(self, index: int, picture: Picture) -> None:
        """Take the next frame. Raises ValueError when an index is skipped."""
        if self._expected is not None and index != self._expected:
            raise ValueError(f"frame {index} follows frame {self._expected - 1}; frames must be consecutive")
        self._expected = index + 1
        self.frame_count += 1
        if self._cut_detector.is_cut(picture):
            self._cut(index, self._cut_detector.dissolve, picture.size)
        self._follow(index, picture)
        lost = any(track.last != index for track in self.open)
        due = self._last_detection is None or index - self._last_detection >= self._detect_every
        if due or lost or not self.open:
            # tiles cost four more runs, so a clip without faces pays for them only now and then
            self._acquire(index, detect_faces(picture, tiles=due and not self.open), picture)
            if due:
                self._last_detection = index
        kept = [track for track in self.open if index - track.last <= self._max_lost]
        self.closed += [track for track in self.open if index - track.last > self._max_lost]
        self.open = kept
        self._before = picture if kept else None
        if index % (EVERY * self._step) == 0:
            self._appearances.look(self.open, index, picture)
            if self.open and self._is_replaced():
                self._cut(index, self._cut_detector.change(LAG), picture.size)

    def _is_replaced(self) -> bool:
        """Whether another person has come with another picture.

        That is told when the picture rests, or cannot be waited for any longer: else the rest of it would be one more.
        """
        another = self._cut_detector.is_another_since(LAG)
        seen = another and self._appearances.show_another()
        self._seen_another += seen
        if not another and not self._seen_another:
            return False
        change = self._cut_detector.change(LAG)
        if change.rests:
            return self._seen_another > 0 or (change.is_over and not self._appearances.show_same())
        return self._seen_another > (_LOOKS_WAITED if seen else 0)

    def _cut(self, index: int, change: Change | None, size: tuple[int, int]) -> None:
        """Begin a new shot with this frame, or where a change that is told with it had gone half of its way.

        That is where it had in the part that faces were in before. Who was found on the way is of the new shot.
        size: (height, width) of the picture.
        """
        self._cut_detector.forget()
        self._appearances.forget()
        self._last_detection = None
        self._seen_another = 0
        cut = began = first = index
        if change is not None:
            first = max(index - self._step * (len(change.lumas) - 1), index - LOOKBACK)
            part = self._part(first, size)
            began, cut = (max(index - self._step * change.steps_since(share, part), first + 1) for share in _WAY)
        else:
            self._before = None
        self.cuts.append(cut)
        tracks, self.open = self.open, []
        for track in tracks:
            if track.last < cut:
                self.closed.append(track)
            elif track.first >= began:
                self.open.append(track)
            else:
                self.open.append(track.split(cut, min(began, cut)))
                self.closed.append(track)

    def _part(self, frame: int, size: tuple[int, int]) -> Floats:
        """The part of a picture of (height, width) that the faces of a frame were in.

        Returns (4,) x0, y0, x1, y1 in shares of it, all of it where there were none.
        """
        boxes = [box_of(track.seen_by(frame).landmarks.points) for track in self.open if track.first <= frame]
        if not boxes:
            return np.array((0, 0, 1, 1), np.float32)
        box = np.concatenate([np.min(boxes, axis=0)[:2], np.max(boxes, axis=0)[2:]])
        return np.asarray(np.clip(box / (size[1], size[0], size[1], size[0]), 0, 1), np.float32)

    def _follow(self, index: int, picture: Picture) -> None:
        """Find the face of every open track where it was last seen.

        Where one face passes another, both tracks find the one in front, or one finds the other's: a face stays with
        whose it is, and who is behind is lost for the while.
        """
        found = self._found(index, picture)
        boxes = np.stack([box_of(mesh.points) for _, mesh in found]) if found else np.empty((0, 4), np.float32)
        for (_, mesh), box in zip(found, boxes, strict=True):
            if not is_taken(self.open, index, box):
                same = [found[k][0] for k in np.flatnonzero(box_iou(box, boxes) > SAME_FACE_IOU)]
                finders = [finder for finder in same if finder.last != index]  # who has another face has no second one
                near = [other for _, other in lost_near(self.open, index, mesh) if other.last < index - 1]
                lost = [other for other in near if all(other is not finder for finder, _ in found)]
                self._appearances.whose(mesh, finders, lost, picture).add(index, mesh)

    def _found(self, index: int, picture: Picture) -> list[tuple[OpenTrack, Mesh]]:
        """The open tracks that find a face where theirs was last seen, and that face.

        Of faces that leave the picture the mesh is carried with it, which settles where they are.
        """
        found = []
        for track in self.open:
            if index - track.last > BLIND_FITS:
                continue
            mesh = self._fit(picture, region_of_points(track.last_mesh.points))
            if mesh is None or share_inside(mesh.points, picture.size) < LEAST_FITTED:
                moved = self._carried(track, index, picture)
                if moved is not None:
                    track.left_picture = share_inside(moved.points, picture.size) < LEAST_SEEN
                    if not track.left_picture:
                        track.carry(index, moved)
                    continue
            if mesh is not None:
                found.append((track, mesh))
        return found

    def _carried(self, track: OpenTrack, index: int, picture: Picture) -> Mesh | None:
        """A face that was on the picture's edge in the frame before, where the picture's motion took it."""
        if self._before is None or track.last != index - 1:
            return None
        if share_inside(track.last_mesh.points, picture.size) > ON_EDGE:
            return None
        return carried(track.last_mesh, self._before, picture)

    def _acquire(self, index: int, detections: tuple[Detection, ...], picture: Picture) -> None:
        """Give detections nobody follows to lost tracks nearby, or to new ones, and count those left out."""
        without_place: list[Floats] = []  # boxes: who has given its place is detected once more
        for detection in detections:
            if is_taken(self.open, index, detection.box):
                continue
            mesh = self._fit(picture, detection)
            if mesh is None or is_taken(self.open, index, box_of(mesh.points)):
                continue
            track = self._continued(index, mesh, picture)
            if track is None:
                crowded_out = self._crowded_out(index, mesh) if len(self.open) >= self._max_faces else None
                if crowded_out is not None and self._is_wanted(crowded_out):
                    box = box_of(crowded_out.points)
                    if not without_place or float(box_iou(box, np.stack(without_place)).max()) <= SAME_FACE_IOU:
                        without_place.append(box)
                if crowded_out is mesh:
                    continue
                track = OpenTrack(index, mesh)
                self.open.append(track)
            track.add(index, mesh)
        self.over_limit = max(self.over_limit, len(without_place))

    def _crowded_out(self, index: int, mesh: Mesh) -> Mesh:
        """Who has no place now that a new face needs one: that face itself, or the narrowest, whose track ends."""
        narrowest = min(self.open, key=lambda track: _width(track.last_mesh))
        width, least = _width(mesh), _width(narrowest.last_mesh)
        gives_way = width >= _LARGER * least or width >= self._min_face_px > least
        if not gives_way or mesh.score < CONFIRMED_SCORE:
            return mesh
        self.open.remove(narrowest)
        mesh = narrowest.last_mesh
        if narrowest.first < index:
            narrowest.take_back(index)
            self.closed.append(narrowest)
        return mesh

    def _is_wanted(self, mesh: Mesh) -> bool:
        """Whether a mesh is a face for sure, and wide enough."""
        return mesh.score >= CONFIRMED_SCORE and _width(mesh) >= self._min_face_px

    def _fit(self, picture: Picture, region: Region | Detection) -> Mesh | None:
        """The mesh, if it is a face, large enough, and has its centre in the picture."""
        mesh = fit_landmarks(picture, region)
        height, width = picture.size
        x, y = mesh.points.mean(axis=0)
        inside = 0 <= x < width and 0 <= y < height
        if mesh.score < FACE_GATE or not inside or _width(mesh) < min(FOLLOWED_PX, self._min_face_px):
            return None
        return mesh

    def _continued(self, index: int, mesh: Mesh, picture: Picture) -> OpenTrack | None:
        """The lost track that this face most likely continues: of several nearby the likest, else the nearest."""
        near = lost_near(self.open, index, mesh)
        if not near:
            return None
        return self._appearances.likest([track for _, track in near], mesh, picture) or min(near, key=itemgetter(0))[1]

    def is_face(self, track: OpenTrack, *, finished: bool) -> bool:
        """Whether a track is neither too short nor too doubtful to be a face; finished: whether the clip has ended."""
        begin = max((cut for cut in self.cuts if cut <= track.first), default=0)
        end = next((cut for cut in self.cuts if cut > track.first), self.frame_count if finished else None)
        enough = MIN_SEEN if end is None else min(MIN_SEEN, max(self._min_seen_in_shot, end - begin))
        return track.is_confident(min(enough, self.frame_count) if finished else enough)

    def end(self) -> None:
        """Close what is still open: there are no more frames."""
        self.closed += self.open
        self.open = []

    def take_closed(self) -> list[OpenTrack]:
        """The tracks that have ended since they were taken before; `result` has none of them then."""
        closed, self.closed = self.closed, []
        return closed

    def result(self) -> FaceTracks:
        """All tracks without those too short or too doubtful to be a face."""
        every = self.closed + self.open
        done = [track.raw() for track in every if self.is_face(track, finished=True)]
        too_brief = not done and any(track.is_confident(1) for track in every)
        done.sort(key=lambda track: (track.first, float(track.landmarks.points[0, :, 0].mean())))
        return FaceTracks(tuple(done), tuple(self.cuts), self.frame_count, self.over_limit, too_brief)


def _width(mesh: Mesh) -> float:
    """The longer extent of a mesh in x or y, px."""
    return float(np.ptp(mesh.points, axis=0).max())
