from __future__ import annotations

from collections.abc import Iterable
from operator import attrgetter

import cv2
import numpy as np
import pytest

from pvg.face import Landmarks
from pvg.landmarks import FaceTrack, smooth, track_faces
from pvg.picture import Picture, RgbPicture
from pvg.vectorization.fading import opacity
from pvg.vectorization.following import CHUNK, LOOKAHEAD, DeferredTrack, Following
from pvg.vectorization.stretch import Stretch
from pvg.video import picture_of, read_frames
from scripts.samples import Samples
from tests.gallery.faces import fit_surest, read_rgb

Frames = list[tuple[int, Picture]]


@pytest.fixture(scope="module")
def clip(samples: Samples) -> Frames:
    frames: Frames = [(frame.index, picture_of(frame)) for frame in read_frames(samples.woman_clip, stop=120)]
    assert len(frames) == 120
    return frames


def blank(picture: Picture) -> Picture:
    height, width = picture.size
    return RgbPicture(np.full((height, width, 3), 90, np.uint8))


def blurred(picture: Picture) -> Picture:
    return RgbPicture(cv2.blur(picture.rgb(), (151, 151)))


def follow(
    frames: Iterable[tuple[int, Picture]], min_face_px: float = 64, frame_rate: float = 25
) -> tuple[list[Stretch], Following]:
    following = Following(min_face_px=min_face_px, frame_rate=frame_rate)
    settled, stretches = 0, []
    for advance in following.advances(frames):
        assert advance.settled >= settled
        settled = advance.settled
        stretches += advance.stretches
    assert settled == following.frame_count
    return stretches, following


def joined(stretches: list[Stretch]) -> FaceTrack:
    """All stretches of a track as one; they follow on each other."""
    first = stretches[0].rows.first
    for stretch in stretches:
        assert stretch.start == stretch.rows.first - first
        assert len(stretch.pictures) == len(stretch.visible) == len(stretch.rows.score)
    firsts = np.array([stretch.rows.first for stretch in stretches])
    lengths = np.array([len(stretch.pictures) for stretch in stretches])
    np.testing.assert_array_equal(firsts[1:], (firsts + lengths)[:-1])

    def all_of(name: str) -> np.ndarray:
        return np.concatenate([attrgetter(name)(stretch.rows) for stretch in stretches])

    landmarks = Landmarks(*(all_of(f"landmarks.{name}") for name in ("points", "skin_points")))
    return FaceTrack(first, landmarks, all_of("score"), all_of("pose"))


def test_one_reading_gives_the_track_that_two_give(clip: Frames) -> None:
    stretches, following = follow(clip)
    (whole,) = track_faces(clip).tracks
    track, wanted = joined(stretches), smooth(whole)
    assert len(stretches) > 2
    assert (track.first, track.last) == (wanted.first, wanted.last) == (0, 119)
    np.testing.assert_array_equal(track.score, wanted.score)
    apart = np.linalg.norm(track.landmarks.points - wanted.landmarks.points, axis=2)
    # jitter is told from movement by the frames nearby instead of by the whole clip
    assert apart.mean() < 0.0006 * wanted.width_px
    assert apart.max() < 0.01 * wanted.width_px
    accelerations = [np.abs(np.diff(t.landmarks.points, 2, axis=0)).mean() for t in (track, wanted)]
    assert accelerations[0] < 1.05 * accelerations[1]
    assert following.cuts == ()
    assert following.deferred() == ((), 0.0)
    later = DeferredTrack(whole, left_picture=False).smoothed()
    np.testing.assert_array_equal(later.landmarks.stacked, track.landmarks.stacked)
    np.testing.assert_array_equal(later.pose, track.pose)


def test_a_short_track_is_smoothed_as_a_whole(clip: Frames) -> None:
    stretches, _ = follow(clip[:40])
    (whole,) = track_faces(clip[:40]).tracks
    np.testing.assert_array_equal(joined(stretches).landmarks.points, smooth(whole).landmarks.points)


def test_pictures_are_kept_for_a_bounded_time_only(clip: Frames) -> None:
    following = Following(min_face_px=64, frame_rate=25)
    for count, advance in enumerate(following.advances(clip), start=1):
        if count < len(clip):
            assert count - advance.settled <= CHUNK + LOOKAHEAD + 1
        for stretch in advance.stretches:
            for picture in stretch.pictures:
                x0, y0, x1, y1 = picture.box
                assert (x1 - x0) * (y1 - y0) < 0.9 * 360 * 640


def test_faces_side_by_side_share_the_pictures_that_are_kept(clip: Frames) -> None:
    """Parts of their own would take the more memory the more faces there are."""
    points = track_faces(clip[:1]).tracks[0].landmarks.points[0]
    (x0, y0), (x1, y1) = points.min(axis=0).astype(int) - 20, points.max(axis=0).astype(int) + 20
    heads = [picture.rgb()[y0:y1, x0:x1] for _, picture in clip[:8]]
    frames: Frames = [(k, RgbPicture(np.concatenate([head] * 3, axis=1))) for k, head in enumerate(heads)]
    stretches, _ = follow(frames)
    assert len({stretch.number for stretch in stretches}) == 3
    assert len({id(picture) for stretch in stretches for picture in stretch.pictures}) == len(frames)


def test_visibility_is_that_of_the_whole_track(clip: Frames) -> None:
    gone = range(70, 82)
    frames = [(i, blank(picture) if i in gone else picture) for i, picture in clip[:110]]
    frames += [(i, blank(picture)) for i, picture in clip[110:]]
    stretches, following = follow(frames)
    shots = (0, *following.cuts)
    by_number = {number: [s for s in stretches if s.number == number] for number in {s.number for s in stretches}}
    assert by_number
    for own in by_number.values():
        track = joined(own)
        visible = np.concatenate([stretch.visible for stretch in own])
        np.testing.assert_allclose(visible, opacity(track, shots, following.frame_count))


@pytest.fixture(scope="module")
def another(clip: Frames, samples: Samples) -> np.ndarray:
    """A picture of another person, whose face lies where that of the clip does."""
    pale = read_rgb(samples.pale_portrait)
    (own,) = track_faces(clip[:1]).tracks
    theirs = Landmarks.from_mesh(fit_surest(pale).points)
    to_clip = cv2.getAffineTransform(theirs.eyes_and_mouth, own.landmarks[0].eyes_and_mouth)
    return cv2.warpAffine(pale, to_clip, clip[0][1].size[::-1], borderMode=cv2.BORDER_REFLECT)


def dissolved(frames: Frames, into: np.ndarray, shares: np.ndarray) -> Frames:
    return [
        (k, RgbPicture(cv2.addWeighted(picture.rgb(), 1 - share, into, share, 0)))
        for (k, picture), share in zip(frames, shares, strict=True)
    ]


@pytest.mark.parametrize("before", [30, 75])
def test_who_comes_with_a_slow_dissolve_has_rows_from_its_middle_on(
    clip: Frames, another: np.ndarray, before: int
) -> None:
    """Though it is told when it has ended: their first colours are of a frame that shows hardly anybody else."""
    shares = np.clip((np.arange(120) - before + 1) / 20, 0, 1)
    stretches, following = follow(dissolved(clip, another, shares))
    (cut,) = following.cuts
    assert abs(cut - before - 10) <= 4
    first, second = (joined([one for one in stretches if one.number == number]) for number in (0, 1))
    assert (first.first, first.last, second.first, second.last) == (0, cut - 1, cut, 119)
    assert all((one.visible == 1).all() for one in stretches)
    (key,) = (one.key for one in stretches if one.number == 1 and one.key is not None)
    assert shares[cut + key.row] >= 0.95


@pytest.mark.parametrize("lost", [18, 26])
def test_a_face_may_end_before_frames_that_were_settled_without_it(
    clip: Frames, another: np.ndarray, lost: int
) -> None:
    """It was lost before the middle of a dissolve that is told when the frames after that are settled."""
    frames = dissolved(clip[:112], another, np.clip((np.arange(112) - 59) / 40, 0, 1))
    frames = [(k, blurred(picture)) if 80 - lost <= k < 80 else (k, picture) for k, picture in frames]
    stretches, following = follow(frames, frame_rate=60)
    (cut,) = following.cuts
    own = [one for one in stretches if one.number == 0]
    assert [one.last for one in own] == [False, False, True]
    assert len(own[-1].pictures) == 0
    track = joined(own)
    assert np.flatnonzero(track.score)[-1] < track.last < cut


def test_a_narrow_face_is_named_and_not_followed(clip: Frames) -> None:
    stretches, following = follow(clip[:30], min_face_px=1000)
    assert stretches == []
    tracks, widest = following.deferred()
    assert tracks == ()
    assert widest > 100
    assert [len(track.seen) for track, _ in following._deferred] == [0]  # its width is all that is asked of it


def test_a_face_without_a_good_view_in_time_is_left_for_a_second_reading(
    clip: Frames, monkeypatch: pytest.MonkeyPatch
) -> None:
    import pvg.vectorization.following

    monkeypatch.setattr(pvg.vectorization.following, "good_rows", lambda track: np.zeros(len(track.score), np.bool_))
    stretches, following = follow(clip)
    assert stretches == []
    (deferred,), _ = following.deferred()
    (whole,) = track_faces(clip).tracks
    np.testing.assert_array_equal(deferred.track.landmarks.points, whole.landmarks.points)


def test_every_stretch_begins_with_a_key_view_once(clip: Frames) -> None:
    stretches, _ = follow(clip)
    keys = [stretch.key for stretch in stretches]
    assert keys[0] is not None
    assert keys[1:] == [None] * (len(keys) - 1)
