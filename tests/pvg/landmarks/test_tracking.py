from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import cv2
import numpy as np
import pytest

from pvg.landmarks import LOOKBACK, FaceTracker, Mesh, smooth, track_faces
from pvg.landmarks.cuts import RESTING_STEPS
from pvg.landmarks.detector import box_iou
from pvg.landmarks.motion import share_inside
from pvg.landmarks.replacing import EVERY, FaceViews
from pvg.landmarks.tracks import CONFIRMED_SCORE, FACE_GATE, OpenTrack
from pvg.picture import as_picture
from scripts.samples import Samples
from tests.gallery.faces import fit_surest, read_rgb
from tests.gallery.pictures import background, pasted


def moving(head: np.ndarray, count: int, speed: int = 4) -> Iterator[tuple[int, np.ndarray]]:
    scene = background(3)
    for index in range(count):
        yield index, pasted(scene, head, 20 + speed * index, 60)


def test_a_track_follows_a_moving_face(head: np.ndarray) -> None:
    result = track_faces(moving(head, 20))
    assert result.cuts == ()
    assert result.frame_count == 20
    (track,) = result.tracks
    assert (track.first, track.last) == (0, 19)
    assert track.landmarks.points.shape == (20, 106, 2)
    assert track.landmarks.skin_points.shape == (20, 88, 2)
    assert track.pose.shape == (20, 3)
    assert (
        track.landmarks.points.dtype
        == track.landmarks.skin_points.dtype
        == track.score.dtype
        == track.pose.dtype
        == np.float32
    )
    assert (track.score > 0.9).all()
    assert 80 < track.width_px < 140
    steps = np.diff(track.landmarks.points.mean(axis=1), axis=0)
    np.testing.assert_allclose(steps, np.tile([4.0, 0.0], (19, 1)), atol=0.6)


def test_a_cut_ends_the_track_and_starts_another(head: np.ndarray) -> None:
    frames = [(5 + i, pasted(background(3), head, 40, 60)) for i in range(6)]
    frames += [(11 + i, pasted(background(4), head, 260, 90)) for i in range(6)]
    result = track_faces(iter(frames))
    assert result.cuts == (11,)
    assert [(track.first, track.last) for track in result.tracks] == [(5, 10), (11, 16)]


def test_a_face_that_fills_a_short_shot_is_followed(head: np.ndarray) -> None:
    shots = [(3, 40), (4, 200), (5, 120), (6, 260), (7, 60)]  # a scene and where its face lies
    pictures = [pasted(background(seed), head, x, 60) for seed, x in shots for _ in range(3)]
    result = track_faces(enumerate(pictures))
    assert result.cuts == (3, 6, 9, 12)
    assert [(track.first, track.last) for track in result.tracks] == [(k, k + 2) for k in (0, 3, 6, 9, 12)]


def test_a_face_of_a_part_of_a_short_shot_is_none(head: np.ndarray) -> None:
    pictures = [pasted(background(3), head, 40, 60)] * 8 + [background(4)] * 2 + [pasted(background(4), head, 90, 60)]
    pictures += [background(4), *[background(5)] * 8]
    assert [(track.first, track.last) for track in track_faces(enumerate(pictures)).tracks] == [(0, 7)]


def test_a_shot_of_one_frame_is_a_shot_where_a_frame_lasts(head: np.ndarray) -> None:
    """And a flash or a fault elsewhere."""
    shots = [(3, 40), (4, 200), (5, 120), (6, 260), (7, 60)]
    pictures = [pasted(background(seed), head, x, 60) for seed, x in shots]
    slow, fast = (track_faces(enumerate(pictures), frame_rate=rate) for rate in (12, 25))
    assert slow.cuts == fast.cuts == (1, 2, 3, 4)
    assert [(track.first, track.last) for track in slow.tracks] == [(k, k) for k in range(5)]
    assert not slow.too_brief
    assert fast.tracks == ()
    assert fast.too_brief


def hidden_in(head: np.ndarray, count: int, hidden: range) -> Iterator[tuple[int, np.ndarray]]:
    scene = background(3)
    for index in range(count):
        yield index, scene if index in hidden else pasted(scene, head, 40 + 2 * index, 60)


def test_a_face_lost_for_less_than_a_second_resumes_its_track(head: np.ndarray) -> None:
    (track,) = track_faces(hidden_in(head, 24, range(8, 15))).tracks
    assert (track.first, track.last) == (0, 23)
    np.testing.assert_array_equal(np.flatnonzero(track.score == 0), np.arange(8, 15))
    bridge = track.landmarks.points[7:16]
    np.testing.assert_allclose(np.diff(bridge, 2, axis=0), 0, atol=1e-3)  # a straight line
    centre = smooth(track).landmarks.points.mean(axis=1)[:, 0]
    np.testing.assert_allclose(np.diff(centre), 2, atol=0.5)


def test_a_face_lost_for_longer_starts_a_new_track(head: np.ndarray) -> None:
    result = track_faces(hidden_in(head, 24, range(8, 15)), frame_rate=5)
    assert [(track.first, track.last) for track in result.tracks] == [(0, 7), (15, 23)]


def test_a_face_of_two_frames_is_dropped_unless_the_clip_is_that_short(head: np.ndarray) -> None:
    assert track_faces(hidden_in(head, 12, range(2, 12))).tracks == ()
    (track,) = track_faces(hidden_in(head, 2, range(0))).tracks
    assert track.last == 1
    (still,) = track_faces(hidden_in(head, 1, range(0))).tracks
    assert len(still.score) == 1
    np.testing.assert_array_equal(smooth(still).landmarks.points, still.landmarks.points)


def test_two_tracks_never_sit_on_one_face(head: np.ndarray) -> None:
    scene = pasted(background(5), head, 10, 50)
    mirrored = np.ascontiguousarray(head[:, ::-1])
    frames = [(i, pasted(scene, mirrored, 270 - 3 * i, 70)) for i in range(18)]
    result = track_faces(iter(frames))
    assert [len(track.score) for track in result.tracks] == [18, 18]
    for index in range(18):
        boxes = [
            np.concatenate([track.landmarks.points[index].min(axis=0), track.landmarks.points[index].max(axis=0)])
            for track in result.tracks
        ]
        assert box_iou(boxes[0], boxes[1][None])[0] < 0.2
    assert result.tracks[0].landmarks.points[0, :, 0].mean() < result.tracks[1].landmarks.points[0, :, 0].mean()


def test_a_track_takes_one_face_a_frame(mesh: Mesh, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of three in a row that overlap, the middle one is the likest to either of the others."""
    step = np.array([0.4 * np.ptp(mesh.points[:, 0]), 0], np.float32)
    meshes = [replace(mesh, points=mesh.points + k * step) for k in range(3)]
    tracker = FaceTracker()
    tracker.open = [OpenTrack(0, one) for one in meshes]
    for track, one in zip(tracker.open, meshes, strict=True):
        track.add(0, one)
    _, middle, _ = tracker.open
    found = iter(meshes)
    monkeypatch.setattr(tracker, "_fit", lambda *_: next(found))
    monkeypatch.setattr(tracker._appearances, "likest", lambda tracks, *_: middle if middle in tracks else None)
    tracker._follow(1, as_picture(np.zeros((2000, 2000, 3), np.uint8)))
    assert [track.frames for track in tracker.open] == [[0], [0, 1], [0, 1]]


@pytest.mark.parametrize("mirrored", [False, True])
def test_faces_that_pass_each_other_keep_their_tracks(head: np.ndarray, other_head: np.ndarray, mirrored: bool) -> None:
    """One is hidden behind the other for a while, and both come from either side, for tracks are asked in turn."""
    behind, before = np.arange(20, 556, 8), np.arange(540, 4, -8)
    scene = background(3, 760, 320)
    tracker = FaceTracker()
    for index, (x, in_front) in enumerate(zip(behind, before, strict=True)):
        picture = pasted(pasted(scene, head, int(x), 60), other_head, int(in_front), 60)
        tracker.step(index, as_picture(np.ascontiguousarray(picture[:, ::-1]) if mirrored else picture))
    tracks = tracker.result().tracks
    assert [(track.first, track.last) for track in tracks] == [(0, len(behind) - 1)] * 2
    hidden = 0
    for track in tracks:
        middle = track.landmarks.points[..., 0].mean(axis=1)
        middle = 759 - middle if mirrored else middle
        places = np.stack([behind, before]) + head.shape[1] / 2
        off = np.abs(middle - places)
        whose = int(off[:, 0].argmin())
        seen = track.score > 0
        assert (off[whose][seen] < 30).all()
        hidden += int((~seen).sum())
    assert 5 < hidden < 25


def test_at_most_max_faces_are_followed(head: np.ndarray) -> None:
    frames = ((i, pasted(pasted(background(5), head, 10, 50), head, 270, 70)) for i in range(20))
    result = track_faces(frames, max_faces=1)
    assert [(track.first, track.last) for track in result.tracks] == [(0, 19)]
    assert result.over_limit == 1


def test_nobody_is_left_out_while_there_is_room(head: np.ndarray) -> None:
    frames = ((i, pasted(pasted(background(5), head, 10, 50), head, 270, 70)) for i in range(8))
    assert track_faces(frames, max_faces=2).over_limit == 0


def joined_by(head: np.ndarray, growth: float, since: int) -> Iterator[tuple[int, np.ndarray]]:
    """A face of some 100 px from the first of 20 frames on, and a larger one from another."""
    small = pasted(background(5, 640, 480), head, 10, 50)
    both = pasted(small, cv2.resize(head, None, fx=growth, fy=growth, interpolation=cv2.INTER_CUBIC), 250, 20)
    for index in range(20):
        yield index, both if index >= since else small


@pytest.mark.parametrize(
    ("growth", "min_face_px", "gives_place"), [(1.8, 24, True), (1.3, 24, False), (1.3, 145, True), (1.8, 250, True)]
)
def test_a_full_tracker_gives_the_narrowest_faces_place_to_a_larger_one(
    head: np.ndarray, growth: float, min_face_px: float, gives_place: bool
) -> None:
    """One half as wide again, or one that is wide enough where the other is not."""
    result = track_faces(joined_by(head, growth, 7), max_faces=1, min_face_px=min_face_px)
    spans = [(track.first, track.last) for track in result.tracks]
    assert spans == ([(0, 11), (12, 19)] if gives_place else [(0, 19)])
    assert result.over_limit == (min_face_px == 24)  # the narrow ones are none that anybody misses


def test_of_a_picture_with_too_many_faces_the_widest_are_kept(head: np.ndarray) -> None:
    ((_, picture),) = list(joined_by(head, 1.8, 0))[:1]
    for mirrored in (picture, np.ascontiguousarray(picture[:, ::-1])):
        result = track_faces([(0, mirrored)], max_faces=1)
        (track,) = result.tracks
        assert track.width_px > 150
        assert result.over_limit == 1


def test_what_may_be_no_face_takes_no_place(head: np.ndarray, mesh: Mesh) -> None:
    tracker = FaceTracker(max_faces=1)
    tracker.open = [OpenTrack(0, replace(mesh, points=mesh.points / 4))]
    tracker.open[0].add(0, tracker.open[0].last_mesh)
    doubtful = replace(mesh, score=CONFIRMED_SCORE - 0.01)
    assert tracker._crowded_out(1, doubtful) is doubtful
    assert len(tracker.open) == 1


def test_narrower_faces_than_usual_are_followed_where_they_are_asked_for(head: np.ndarray) -> None:
    scale = 0.16
    small = cv2.resize(head, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    picture = pasted(background(5, 160, 120), small, 60, 40)
    assert track_faces([(0, picture)]).tracks == ()
    (track,) = track_faces([(0, picture)], min_face_px=12).tracks
    assert 16 < track.width_px < 24
    assert track_faces([(0, picture)], min_face_px=23.5).tracks == ()


@pytest.mark.parametrize(("frame_rate", "late"), [(1, 0), (4, 0), (8, 1), (25, 5)])
def test_who_comes_in_is_found_within_a_quarter_of_a_second(head: np.ndarray, frame_rate: float, late: int) -> None:
    alone = pasted(background(5), head, 10, 50)
    both = pasted(alone, head, 270, 70)
    tracks = track_faces(((i, both if i >= 7 else alone) for i in range(20)), frame_rate=frame_rate).tracks
    assert [track.first for track in tracks] == [0, 7 + late]


def test_frames_without_a_face_are_fine() -> None:
    assert track_faces(iter([])).tracks == ()
    result = track_faces((i, background(6)) for i in range(20))
    assert result.tracks == ()
    assert result.frame_count == 20
    assert not result.too_brief


def test_skipped_frames_are_refused() -> None:
    with pytest.raises(ValueError, match="frame 3 follows frame 1"):
        track_faces(iter([(1, background(1)), (3, background(1))]))


def window(portrait: np.ndarray, center: np.ndarray, growth: float = 1.0) -> np.ndarray:
    """A portrait seen through a window of 400 x 400 px around a place in it."""
    to_window = np.array([[growth, 0, 200 - growth * center[0]], [0, growth, 200 - growth * center[1]]])
    return cv2.warpAffine(portrait, to_window, (400, 400), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)


@pytest.mark.parametrize("step", [(10, 0), (-10, 0), (0, 10)])
def test_a_face_that_leaves_is_followed_until_it_is_gone(
    portrait: np.ndarray, mesh: Mesh, step: tuple[int, int]
) -> None:
    tracker = FaceTracker()
    center = mesh.points.mean(axis=0)
    for index in range(40):
        tracker.step(index, as_picture(window(portrait, center + index * np.array(step))))
    (track,) = tracker.open + tracker.closed
    assert track.left_picture
    rows = track.raw()
    points = rows.landmarks.points
    assert share_inside(points[-1], (400, 400)) < 0.25
    # its points went on with the picture and kept their places in the face
    moved = points[-1] + (len(points) - 1) * np.array(step) - points[0]
    assert np.linalg.norm(moved, axis=1).mean() < 0.05 * rows.extents[0]


def test_a_face_that_overfills_the_picture_is_followed(portrait: np.ndarray, mesh: Mesh) -> None:
    center = mesh.points.mean(axis=0)
    growth = np.linspace(1, 5, 40)
    (track,) = track_faces(enumerate(window(portrait, center, by) for by in growth)).tracks
    assert (track.first, track.last) == (0, 39)
    assert (track.score > 0).all()
    carried = np.flatnonzero(track.score <= FACE_GATE)
    assert len(carried) > 20
    widths = track.extents[carried] / growth[carried]
    np.testing.assert_allclose(widths, widths[0], rtol=0.06)


def test_a_face_covered_within_the_picture_does_not_go_with_what_covers_it(head: np.ndarray) -> None:
    scene = background(3)
    frames = [pasted(scene, head, 120, 60)] * 8 + [scene] * 8
    (track,) = track_faces(enumerate(frames)).tracks
    assert track.last == 7


def wiped(before: np.ndarray, after: np.ndarray, length: int = 24, hold: int = 30) -> Iterator[tuple[int, np.ndarray]]:
    """A wipe from the left, between two pictures that are held."""
    for index in range(2 * hold + length):
        edge = round(before.shape[1] * np.clip((index - hold + 1) / (length + 1), 0, 1))
        yield index, np.concatenate([after[:, :edge], before[:, edge:]], axis=1)


def two_people(portrait: np.ndarray, samples: Samples) -> tuple[np.ndarray, np.ndarray]:
    """Windows of two portraits with the face in the middle of each."""
    one, other = (
        window(rgb, fit_surest(rgb).points.mean(axis=0)) for rgb in (portrait, read_rgb(samples.pale_portrait))
    )
    return one, other


@pytest.mark.parametrize("frame_rate", [25, 50, 120])
def test_who_comes_with_a_wipe_is_another_person(portrait: np.ndarray, samples: Samples, frame_rate: int) -> None:
    before, after = two_people(portrait, samples)
    step = round(frame_rate / 25)
    result = track_faces(wiped(before, after, 24 * step, 30 * step), frame_rate=frame_rate)
    (cut,) = result.cuts
    told = (30 + 24 + RESTING_STEPS + EVERY) * step
    assert (30 + 12 - 2) * step <= cut <= max((30 + 12 + 2) * step, told - LOOKBACK)
    assert [(track.first, track.last) for track in result.tracks] == [(0, cut - 1), (cut, 84 * step - 1)]


def test_who_comes_with_a_wipe_and_is_alike_is_another_person(
    portrait: np.ndarray, samples: Samples, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where views of two faces do not differ, the picture tells."""
    monkeypatch.setattr(FaceViews, "show_another", lambda _: False)
    before, after = two_people(portrait, samples)
    result = track_faces(wiped(before, after))
    (cut,) = result.cuts
    assert abs(cut - 42) <= 2
    assert [(track.first, track.last) for track in result.tracks] == [(0, cut - 1), (cut, 83)]


def test_who_has_gone_with_the_picture_does_not_speak_for_who_is_alike(
    portrait: np.ndarray, samples: Samples, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of two people one is lost in the wipe: how she looked before says nothing of who has the other's place."""
    monkeypatch.setattr(FaceViews, "show_another", lambda _: False)
    one, other = two_people(portrait, samples)
    wall = cv2.resize(background(5), (400, 400))
    two, alone = np.concatenate([one, one[:, ::-1]], axis=1), np.concatenate([other, wall], axis=1)
    result = track_faces(wiped(two, alone, 10))
    (cut,) = result.cuts
    assert 30 < cut < 40
    assert [(track.first, track.last) for track in result.tracks] == [(0, cut - 1), (0, cut - 1), (cut, 69)]


@pytest.mark.parametrize("shown", [16, 24])
def test_who_is_found_shortly_before_a_dissolve_is_not_who_comes_by_it(
    portrait: np.ndarray, samples: Samples, shown: int
) -> None:
    """Also where that is within the time by which the cut may be laid back, but before the picture began to change."""
    before, after = two_people(portrait, samples)
    hidden = before.copy()
    hidden[60:340, 60:340] = cv2.GaussianBlur(before, (0, 0), 60)[60:340, 60:340]
    shares = np.clip((np.arange(80) - 30) / 14, 0, 1)
    frames = [
        (k, cv2.addWeighted(hidden if k < shown else before, 1 - share, after, share, 0))
        for k, share in enumerate(shares)
    ]
    result = track_faces(frames)
    (cut,) = result.cuts
    assert abs(cut - 37) <= 2
    assert [(track.first, track.last) for track in result.tracks] == [(shown, cut - 1), (cut, 79)]


def test_a_track_that_is_split_gives_no_colours_while_it_may_show_two_faces(mesh: Mesh) -> None:
    track = OpenTrack(0, mesh)
    for index in range(6):
        track.add(index, replace(mesh, score=0.99))
    track.carry(6, mesh)
    track.add(7, replace(mesh, score=0.9))
    rest = track.split(5, 3)
    assert (track.frames, rest.frames) == ([0, 1, 2, 3, 4], [5, 6, 7])
    assert (len(track.scores), rest.scores) == (5, [0.99, 0.9])
    assert [one.score > FACE_GATE for one in track.seen + rest.seen] == [True] * 3 + [False] * 5
    assert (rest.first, rest.split_from) == (5, track)


def test_the_same_person_before_another_wall_is_the_same(portrait: np.ndarray, head: np.ndarray) -> None:
    before, after = (pasted(background(seed), head, 180, 60) for seed in (3, 8))
    result = track_faces(wiped(before, after))
    assert result.cuts == ()
    assert [(track.first, track.last) for track in result.tracks] == [(0, 83)]
