"""What a reference needs: one view of a face, all faces of an image or the best frame of a clip's largest face."""

from __future__ import annotations

from collections.abc import Iterable

from pvg.asset import AssetWriter
from pvg.landmarks import FaceTracks, smooth, track_faces
from pvg.picture import Picture
from pvg.skin import Matte, SceneReader, haze_over
from pvg.vectorization.best_row import best_row
from pvg.vectorization.face_maker import FaceMaker, FoundFaces
from pvg.vectorization.face_messages import over_limit_warning
from pvg.vectorization.source_reader import SourceReader
from pvg.vectorization.stretch import KeyView
from pvg.vectorization.vector_face import VectorFace

LANDMARKS, BEST_FRAME = "landmarks", "best frame"  # stages of progress

_REFERENCE_FRAMES = 300  # a reference needs one good frame; the beginning of a clip is enough to find it


def write_reference(source: SourceReader, maker: FaceMaker, writer: AssetWriter) -> FoundFaces:
    """Write the key frames that a reference consists of.

    Raises `NoFaceError` or `FaceTooSmallError` when there is no face that can be used.
    """
    return (_all_faces if source.is_image else _best_frame)(source, maker, writer)


def _all_faces(source: SourceReader, maker: FaceMaker, writer: AssetWriter) -> FoundFaces:
    """Write all faces of an image that are wide enough."""
    ((index, picture),) = source.pictures()
    found = _track(source, maker, [(index, picture)])
    _check_width(source, maker, found)
    source.notices.extend(over_limit_warning(found.over_limit))
    scene = None
    if maker.uses_scenes:  # an image can be drawn as well
        scene = SceneReader().step(picture, [track.landmarks[0] for track in found.tracks])
    faces = []
    for number, raw in enumerate(track for track in found.tracks if track.width_px >= maker.min_face_px):
        track = smooth(raw)
        faces.append(maker.face(number, track, KeyView.of(track, 0, picture, scene)))
        faces[-1].add_key_frame_only(track, writer)
    return FoundFaces(tuple(faces), (0,), found.frame_count)


def _best_frame(source: SourceReader, maker: FaceMaker, writer: AssetWriter) -> FoundFaces:
    """Find the best frame of a clip's largest face and write it alone."""
    with source.reported(LANDMARKS, 0, _REFERENCE_FRAMES) as pictures:
        found = _track(source, maker, pictures)
    whole = found.frame_count < _REFERENCE_FRAMES
    if not whole and _widest(found) < maker.min_face_px:  # no usable face so early: look further
        with source.reported(LANDMARKS) as pictures:
            found, whole = _track(source, maker, pictures), True
    _check_width(source, maker, found)
    frame_count = found.frame_count if whole else None
    track = smooth(max(found.tracks, key=lambda track: track.width_px))
    views: dict[int, VectorFace] = {}

    def matte_of(row: int, picture: Picture) -> Matte:
        haze = haze_over(picture) if maker.uses_scenes else 0
        views[row] = maker.face(0, track, KeyView(row, picture, track.landmarks[row], None, haze))
        return views[row].key_matte

    stop = min(track.last + 1, track.first + _REFERENCE_FRAMES)
    with source.reported(BEST_FRAME, track.first, stop, frame_count) as pictures:
        row = best_row(track, pictures, matte_of)
    if row not in views:
        matte_of(row, source.picture(track.first + row, frame_count))
    views[row].add_key_frame_only(track, writer)
    return FoundFaces((views[row],), (0, *found.cuts), found.frame_count)


def _track(source: SourceReader, maker: FaceMaker, frames: Iterable[tuple[int, Picture]]) -> FaceTracks:
    return track_faces(frames, min_face_px=maker.min_face_px, frame_rate=source.frame_rate)


def _widest(found: FaceTracks) -> float:
    """Width in px of the widest face, 0 without one."""
    return max((track.width_px for track in found.tracks), default=0.0)


def _check_width(source: SourceReader, maker: FaceMaker, found: FaceTracks) -> None:
    """Raise `NoFaceError` or `FaceTooSmallError` unless one face is wide enough."""
    widest = _widest(found)
    if widest < maker.min_face_px:
        raise maker.no_usable_face(source, found.frame_count, widest=widest, too_brief=found.too_brief)
