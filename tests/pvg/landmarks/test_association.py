"""Which of the followed faces one that was found is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pvg.landmarks import Mesh, OpenTrack
from pvg.landmarks.association import REJOIN_DISTANCE, REJOIN_SIZE_RATIO, Appearances, is_taken, lost_near
from pvg.landmarks.tracks import box_of
from pvg.picture import as_picture

EMPTY = as_picture(np.zeros((64, 64, 3), np.uint8))


def moved(mesh: Mesh, faces: float, growth: float = 1.0) -> Mesh:
    """The mesh so many of its own sizes further right, grown about its middle."""
    middle, size = mesh.points.mean(axis=0), np.ptp(mesh.points, axis=0).max()
    points = middle + growth * (mesh.points - middle) + np.array([faces * size, 0])
    return replace(mesh, points=points.astype(np.float32))


def seen_in(mesh: Mesh, *frames: int) -> OpenTrack:
    track = OpenTrack(frames[0], mesh)
    for frame in frames:
        track.add(frame, mesh)
    return track


def test_a_place_is_taken_in_the_frame_in_which_a_face_was_seen_there(mesh: Mesh) -> None:
    track = seen_in(mesh, 0, 1)
    assert is_taken([track], 1, box_of(moved(mesh, 0.1).points))
    assert not is_taken([track], 1, box_of(moved(mesh, 0.8).points))
    assert not is_taken([track], 2, box_of(mesh.points))


def test_a_part_of_a_face_on_the_edge_is_no_face_of_its_own(mesh: Mesh) -> None:
    track = seen_in(mesh, 0)
    part = box_of(moved(mesh, 0.0, 0.4).points)
    assert not is_taken([track], 0, part)
    track.carry(1, mesh)
    assert is_taken([track], 1, part)


def test_lost_tracks_are_near_by_place_and_size(mesh: Mesh) -> None:
    lost, followed = seen_in(mesh, 0), seen_in(mesh, 0, 5)
    ((distance, found),) = lost_near([lost, followed], 5, moved(mesh, 0.5))
    assert found is lost
    assert distance == pytest.approx(0.5, abs=1e-3)
    assert lost_near([lost], 5, moved(mesh, REJOIN_DISTANCE + 0.05)) == []
    assert lost_near([lost], 5, moved(mesh, 0.0, REJOIN_SIZE_RATIO + 0.05)) == []


def test_a_face_is_that_of_who_was_seen_last_where_none_is_clearly_liker(mesh: Mesh) -> None:
    late, early = seen_in(moved(mesh, 0.4), 0, 4), seen_in(mesh, 0, 3)
    appearances = Appearances(step=1)
    assert appearances.whose(mesh, [early, late], [], EMPTY) is late
    near, far = seen_in(moved(mesh, 0.1), 0, 4), seen_in(moved(mesh, 0.4), 0, 4)
    assert appearances.whose(mesh, [far, near], [], EMPTY) is near


def test_a_lost_face_that_is_clearly_liker_has_its_track_back(
    mesh: Mesh, head: np.ndarray, other_head: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    finder, lost = seen_in(mesh, 0), seen_in(mesh, 0)
    appearances = Appearances(step=1)
    assert not appearances.look([finder, lost], 0, as_picture(head))
    likeness = {finder: 0.3, lost: 0.9}
    for track, views in appearances._views.items():
        monkeypatch.setattr(views, "likeness", lambda *_, alike=likeness[track]: alike)
    assert appearances.whose(mesh, [finder], [lost], as_picture(other_head)) is lost
    appearances.forget()
    assert appearances.whose(mesh, [finder], [lost], as_picture(other_head)) is finder
