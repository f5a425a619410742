"""What vectorising keeps of frames that have gone by: next to nothing, but all that is asked for."""

from __future__ import annotations

import gc
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import pvg
from pvg.face import Landmarks
from pvg.landmarks import FaceTrack, Mesh, OpenTrack, face_proportions
from pvg.vectorization.following import CHUNK, DeferredTrack, Following
from pvg.vectorization.places import Places
from pvg.vectorization.stretch import rows_between
from pvg.vectorization.track_notes import TrackNotes
from tests.gallery.tracks import nearly_still_track
from tests.pvg.vectorization.test_following import joined
from tests.pvg.vectorization.test_following_at_random import (  # noqa: F401
    BLACK,
    Clip,
    Frame,
    Tracker,
    face,
)

Following_ = Callable[[Clip], Following]
MOST_BYTES = 55  # of a frame and face: 44 of its proportions and 4 of its width, and what arrays have to spare


class Scenes:
    """Scenes of which nothing but their contrast is told, another one in each."""

    def step(self, picture: Frame, faces: object, *, cut: bool) -> Any:
        return SimpleNamespace(contrast=contrast_in(picture.index), haze=0)


def contrast_in(frame: int) -> float:
    return 0.5 + 0.4 * float(np.sin(frame))


@pytest.fixture
def follow(face: Mesh, monkeypatch: pytest.MonkeyPatch) -> Following_:  # noqa: F811
    def begin(clip: Clip) -> Following:
        tracker = Tracker(clip, face)
        monkeypatch.setattr("pvg.landmarks.tracking.detect_faces", tracker.detections)
        monkeypatch.setattr("pvg.landmarks.tracking.fit_landmarks", tracker.fit)
        following = Following(min_face_px=64, frame_rate=clip.rate)
        following._tracker = tracker
        following._scene_reader = Scenes()  # type: ignore[assignment]
        return following

    return begin


def doubtful_at_first(clip: Clip, person: int, frames: int) -> Clip:
    """The clip, but that so many frames show one person too badly to begin with."""
    scores = clip.scores.copy()
    begin = int(np.flatnonzero(scores[:, person])[0])
    scores[begin : begin + frames, person] = np.minimum(scores[begin : begin + frames, person], 0.7)
    return replace(clip, scores=scores)


@pytest.mark.parametrize("seed", range(45, 61))
def test_what_a_second_reading_asks_for_is_as_if_everything_were_kept(seed: int, follow: Following_) -> None:
    clip = doubtful_at_first(Clip.at_random(seed), seed % 3, 66)
    following, everything = follow(clip), Places()
    for advance in following.advances((k, Frame(BLACK, index=k)) for k in range(len(clip.scores))):
        for stretch in advance.stretches:
            everything.add(stretch.number, stretch.rows)
    deferred, _ = following.deferred()
    for track in (one.track for one in deferred):
        for frame in range(track.first, track.last + 1):
            kept, wanted = following.places.near(frame), everything.near(frame)
            assert len(kept) == len(wanted)
            for one, other in zip(kept, wanted, strict=True):
                np.testing.assert_array_equal(one.stacked, other.stacked)
            assert following._contrasts[frame] == contrast_in(frame)


def bytes_of_notes() -> int:
    """What is held of a clip but pictures, whose parts are as large as the face happens to be."""
    root = Path(pvg.__file__).parent
    noting = [tracemalloc.Filter(True, f"{root / name}/*") for name in ("vectorization", "landmarks", "face")]
    return sum(trace.size for trace in tracemalloc.take_snapshot().filter_traces(noting).traces)


def test_a_face_costs_some_bytes_a_frame_however_long_it_is_followed(follow: Following_) -> None:
    """4 to 5 MB an hour. It was 600 bytes a frame once, most of them places that nobody came to ask for."""
    count, begin, end = 1400, 256, 1280  # where an array's spare room is a small part
    clip = Clip(25, np.full((count, 3), (0.99, 0, 0)), np.zeros((count, 3), bool), frozenset(), {})
    following, notes, held = follow(clip), TrackNotes(0), {}
    tracemalloc.start()
    try:
        for k, advance in enumerate(following.advances((k, Frame(BLACK, index=k)) for k in range(count))):
            for stretch in advance.stretches:
                notes.add(stretch.rows)
                if stretch.start in (begin, end):
                    gc.collect()
                    held[k] = bytes_of_notes()
    finally:
        tracemalloc.stop()
    (first, before), (last, after) = held.items()
    assert last - first == end - begin
    assert (after - before) / (last - first) < MOST_BYTES
    notes.end()
    assert notes.shape.proportions is not None


def test_notes_of_stretches_tell_what_the_whole_track_does(face: Mesh) -> None:  # noqa: F811
    track = nearly_still_track(Landmarks.from_mesh(face.points), 40, 75)
    track.score[10:14] = 0
    notes = TrackNotes(track.first)
    for start in range(track.first, track.last + 1, CHUNK):
        notes.add(rows_between(track, start, min(start + CHUNK, track.last + 1)))
    notes.end()
    wanted = face_proportions(track)
    assert (notes.first, notes.last, notes.width_px) == (40, 114, track.width_px)
    assert wanted is not None
    assert notes.shape.proportions is not None
    np.testing.assert_array_equal(notes.shape.proportions, wanted)


def hidden_now_and_then(count: int) -> np.ndarray:
    """(count,) scores of a face that is hidden for up to ten frames at a time, but not at its ends."""
    scores, rng = np.full(count, 0.99), np.random.default_rng(3)
    for begin in range(8, count - 16, 24):
        scores[begin : begin + rng.integers(1, 11)] = 0
    return scores


def track_of(clip: Clip, face: Mesh) -> FaceTrack:  # noqa: F811
    """The first person's track, whole and not smoothed."""
    tracker, shown = Tracker(clip, face), np.flatnonzero(clip.scores[:, 0])
    track = OpenTrack(int(shown[0]), tracker.mesh(int(shown[0]), 0))
    for frame in shown:
        track.add(int(frame), tracker.mesh(int(frame), 0))
    return track.raw()


@pytest.mark.parametrize("count", [20, 300])
def test_a_face_that_is_followed_later_is_as_if_it_had_been_at_once(
    count: int,
    follow: Following_,
    face: Mesh,  # noqa: F811
) -> None:
    scores = np.zeros((count, 3))
    scores[:, 0] = hidden_now_and_then(count)
    clip = Clip(25, scores, np.zeros((count, 3), bool), frozenset(), {})
    frames = ((k, Frame(BLACK, index=k)) for k in range(count))
    at_once = joined([one for advance in follow(clip).advances(frames) for one in advance.stretches])
    raw = track_of(clip, face)
    later = DeferredTrack(raw, left_picture=False).smoothed()
    assert count == 20 or (raw.score == 0).any()
    assert count == 20 or np.abs(later.landmarks.stacked - raw.landmarks.stacked).max() > 0.05
    np.testing.assert_array_equal(later.landmarks.stacked, at_once.landmarks.stacked)
    np.testing.assert_array_equal(later.pose, at_once.pose)
    np.testing.assert_array_equal(later.score, at_once.score)


def test_a_long_face_that_is_followed_later_needs_memory_for_its_rows_alone(face: Mesh) -> None:  # noqa: F811
    """It was 36 kB a frame, 3.2 GB an hour, in which everything was smoothed at once."""
    most = []
    for count in (500, 1500):
        scores = np.full((count, 3), (0.99, 0, 0))
        clip = Clip(25, scores, np.zeros((count, 3), bool), frozenset(), {})
        waiting = DeferredTrack(track_of(clip, face), left_picture=False)
        tracemalloc.start()
        try:
            waiting.smoothed()
            most.append(tracemalloc.get_traced_memory()[1])
        finally:
            tracemalloc.stop()
    assert (most[1] - most[0]) / 1000 < 2.5 * waiting.track.landmarks.stacked[0].nbytes
