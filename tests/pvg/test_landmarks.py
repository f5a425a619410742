"""Faces found, fitted, followed and smoothed."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pvg.landmarks import (
    JD_CLOSED,
    JD_GROUPS,
    SKIN_COUNT,
    SKIN_SLICES,
    FaceTrack,
    detect_faces,
    draw_landmarks,
    face_proportions,
    fit_landmarks,
    head_pose,
    jd_106,
    link_persons,
    skin_88,
    smooth,
    track_faces,
)
from pvg.landmarks.cuts import CutDetector
from pvg.landmarks.detector import box_iou
from pvg.landmarks.mesh import Mesh, region_of_points
from pvg.video import read_frames

MASKS = ("man_cap_beard_dim", "man_fringe_pale", "woman_earrings_bright", "woman_fringe_dark_background")


def _read(path: Path) -> np.ndarray:
    image = cv2.imread(str(path))
    assert image is not None
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


def _fit(rgb: np.ndarray) -> Mesh:
    return fit_landmarks(rgb, detect_faces(rgb)[0])


@pytest.fixture(scope="module")
def portrait(samples: Any) -> np.ndarray:
    return _read(samples.dark_portrait)


@pytest.fixture(scope="module")
def mesh(portrait: np.ndarray) -> Mesh:
    return _fit(portrait)


@pytest.fixture(scope="module")
def face(portrait: np.ndarray, mesh: Mesh) -> np.ndarray:
    """The portrait's head at 100 px width, to paste into scenes."""
    region = region_of_points(mesh.points)
    scale = 200 / region.size
    shift = [100 - scale * region.center_x, 100 - scale * region.center_y]
    matrix = np.array([[scale, 0, shift[0]], [0, scale, shift[1]]])
    return cv2.warpAffine(portrait, matrix, (200, 200), flags=cv2.INTER_AREA)


def _scene(seed: int, width: int = 480, height: int = 320) -> np.ndarray:
    """A smooth background without faces."""
    coarse = np.random.default_rng(seed).integers(30, 220, (4, 6, 3)).astype(np.uint8)
    return cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)


def _with_face(scene: np.ndarray, face: np.ndarray, x: int, y: int) -> np.ndarray:
    picture = scene.copy()
    picture[y : y + face.shape[0], x : x + face.shape[1]] = face
    return picture


# --- one picture ---


@pytest.mark.parametrize("name", ["portrait", "dark_portrait", "pale_portrait"])
def test_landmarks_lie_in_anatomical_order(name: str, samples: Any) -> None:
    rgb = _read(getattr(samples, name))
    fitted = _fit(rgb)
    p = jd_106(fitted.points)
    assert p.shape == (106, 2)
    assert p.dtype == np.float32
    assert fitted.score > 0.95
    region = region_of_points(fitted.points)
    turn = np.array([[np.cos(region.angle), -np.sin(region.angle)], [np.sin(region.angle), np.cos(region.angle)]])
    p = (p @ turn).astype(np.float32)  # eyes level
    x, y = p.T
    assert y[33:43].max() < y[52:64].min() + 0.02 * np.ptp(y)  # upper brow edges above the eyes
    assert y[[43, 44, 45, 46, 49, 87, 93, 16]].tolist() == sorted(y[[43, 44, 45, 46, 49, 87, 93, 16]])
    assert x[33:38].tolist() == sorted(x[33:38])
    assert x[38:43].tolist() == sorted(x[38:43])
    assert x[[52, 55, 58, 61]].tolist() == sorted(x[[52, 55, 58, 61]])
    assert x[84:91].tolist() == sorted(x[84:91])
    around = np.arctan2(x[:33] - x[46], y[:33] - y[46])  # seen from the nose: left, down, right
    assert around.tolist() == sorted(around)
    assert abs(around[16]) < 0.3
    inner = p[33:].copy()
    contour = p[:33].copy()
    # the contour closed over the forehead by the outer brow ends, grown by 2 %
    hull = cv2.convexHull(np.concatenate([contour, p[33:43] - [0, 0.1 * np.ptp(y)]]).astype(np.float32))
    assert all(cv2.pointPolygonTest(hull, (float(a), float(b)), False) > 0 for a, b in inner)
    for pupil, eye in ((104, "eye_left"), (105, "eye_right")):
        polygon = p[list(JD_GROUPS[eye])]
        assert cv2.pointPolygonTest(polygon, (float(x[pupil]), float(y[pupil])), False) > 0


def test_closed_groups_are_simple_loops(mesh: Mesh) -> None:
    p = jd_106(mesh.points)
    for name in JD_CLOSED:
        loop = p[list(JD_GROUPS[name])]
        area = abs(cv2.contourArea(loop))
        hull = cv2.contourArea(cv2.convexHull(loop))
        assert area > 0.6 * hull, name  # a wrong order crosses itself and loses area


def test_skin_loops_are_nested_and_disjoint(mesh: Mesh) -> None:
    skin = skin_88(mesh.points)
    assert skin.shape == (SKIN_COUNT, 2) == (88, 2)
    width = float(np.ptp(skin[:, 0]))
    loops = {name: skin[part] for name, part in SKIN_SLICES.items()}
    assert {name: len(loop) for name, loop in loops.items()} == {
        "oval": 36,
        "ring": 36,
        "cheek_left": 8,
        "cheek_right": 8,
    }
    for inside, outside in (("ring", "oval"), ("cheek_left", "ring"), ("cheek_right", "ring")):
        for a, b in loops[inside]:
            depth = cv2.pointPolygonTest(loops[outside], (float(a), float(b)), True)
            assert depth > -0.01 * width, (inside, a, b)  # a turned cheek folds the ring onto the oval
    assert cv2.isContourConvex(loops["oval"].astype(np.float32)) or cv2.contourArea(
        loops["oval"]
    ) > 0.98 * cv2.contourArea(cv2.convexHull(loops["oval"]))
    assert loops["cheek_left"][:, 0].max() < loops["cheek_right"][:, 0].min()


@pytest.mark.parametrize("name", MASKS)
def test_landmarks_fall_on_their_labels(name: str, media_dir: Path) -> None:
    rgb = _read(media_dir / "masks" / f"{name}.jpg")
    labels = cv2.imread(str(media_dir / "masks" / f"{name}_labels.png"), cv2.IMREAD_GRAYSCALE)
    assert labels is not None
    p = jd_106(_fit(rgb).points)
    margin = round(0.015 * float(np.ptp(p[:33, 0])))

    def share(classes: tuple[int, ...], *groups: str) -> float:
        wanted = np.isin(labels, classes).astype(np.uint8)
        assert wanted.any()
        grown = cv2.dilate(wanted, np.ones((2 * margin + 1, 2 * margin + 1), np.uint8))
        points = np.rint(np.concatenate([p[list(JD_GROUPS[group])] for group in groups])).astype(int)
        return float(grown[points[:, 1], points[:, 0]].mean())

    assert share((4, 5), "eye_left", "eye_right", "pupils") >= 0.8
    assert share((11, 12, 13), "lips_outer", "lips_inner") >= 0.95
    assert share((10,), "nose_base", "nose_ridge") >= 0.95
    # hair over the brows is labelled hair in the two with a fringe
    assert share((2, 3, 17), "brow_left", "brow_right") >= 0.8


def test_a_mirrored_face_gives_mirrored_landmarks(portrait: np.ndarray, mesh: Mesh) -> None:
    flipped = np.ascontiguousarray(portrait[:, ::-1])
    other = jd_106(_fit(flipped).points)
    p = jd_106(mesh.points)
    mirrored = portrait.shape[1] - 1 - p[:33, 0][::-1]
    width = np.ptp(p[:33, 0])
    assert np.abs(other[:33, 0] - mirrored).mean() < 0.02 * width
    assert abs(other[104, 0] - (portrait.shape[1] - 1 - p[105, 0])) < 0.02 * width


def test_a_larger_picture_gives_the_same_landmarks(portrait: np.ndarray, mesh: Mesh) -> None:
    large = cv2.resize(portrait, None, fx=3, fy=3, interpolation=cv2.INTER_CUBIC)
    points = (_fit(large).points + 0.5) / 3 - 0.5
    width = np.ptp(mesh.points[:, 0])
    assert np.linalg.norm(points - mesh.points, axis=1).mean() < 0.01 * width


def test_no_face_is_found_in_a_smooth_scene() -> None:
    assert all(fit_landmarks(_scene(1), found).score < 0.5 for found in detect_faces(_scene(1)))


def test_tiles_find_the_small_face_of_a_large_frame(face: np.ndarray) -> None:
    small = cv2.resize(face, (90, 90), interpolation=cv2.INTER_AREA)
    frame = _with_face(_scene(2, 1920, 1080), small, 1200, 300)
    meshes = [fit_landmarks(frame, found) for found in detect_faces(frame)]
    hits = [mesh for mesh in meshes if mesh.score > 0.9]
    assert len(hits) == 1
    np.testing.assert_allclose(hits[0].points.mean(axis=0), [1245, 345], atol=6)


def test_every_face_of_a_group_is_found_once(samples: Any) -> None:
    found = detect_faces(_read(samples.several_faces))
    assert len(found) >= 2
    boxes = np.stack([face.box for face in found])
    for number, box in enumerate(boxes):
        others = np.delete(boxes, number, axis=0)
        assert box_iou(box, others).max() < 0.4
    assert [face.score for face in found] == sorted((face.score for face in found), reverse=True)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**16), angle=st.floats(-3, 3), scale=st.floats(0.2, 5))
def test_landmarks_and_skin_points_commute_with_affine_maps(seed: int, angle: float, scale: float) -> None:
    points = np.random.default_rng(seed).normal(0, 100, (3, 478, 2)).astype(np.float32)
    turn = scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]], np.float32)
    shift = np.array([30, -7], np.float32)
    for take in (jd_106, skin_88):
        np.testing.assert_allclose(take(points @ turn + shift), take(points) @ turn + shift, atol=2e-3 * scale)


def test_pose_follows_mirroring_and_turning(portrait: np.ndarray, mesh: Mesh) -> None:
    yaw, pitch, roll = head_pose(mesh)
    flipped = head_pose(_fit(np.ascontiguousarray(portrait[:, ::-1])))
    np.testing.assert_allclose(flipped, [-yaw, pitch, -roll], atol=3)
    height, width = portrait.shape[:2]
    turn = cv2.getRotationMatrix2D((width / 2, height / 2), -15, 1)  # clockwise in the picture
    turned = head_pose(_fit(cv2.warpAffine(portrait, turn, (width, height), borderMode=cv2.BORDER_REPLICATE)))
    np.testing.assert_allclose(turned[2], roll + 15, atol=2)


def test_drawing_leaves_the_picture_alone_and_marks_the_face(portrait: np.ndarray, mesh: Mesh) -> None:
    before = portrait.copy()
    drawn = draw_landmarks(portrait, jd_106(mesh.points))
    np.testing.assert_array_equal(portrait, before)
    changed = np.argwhere((drawn != portrait).any(axis=2))[:, ::-1]
    assert len(changed) > 500
    low, high = jd_106(mesh.points).min(axis=0), jd_106(mesh.points).max(axis=0)
    assert (changed >= low - 6).all()
    assert (changed <= high + 6).all()


# --- tracking ---


def _moving(face: np.ndarray, count: int, speed: int = 4) -> Iterator[tuple[int, np.ndarray]]:
    scene = _scene(3)
    for index in range(count):
        yield index, _with_face(scene, face, 20 + speed * index, 60)


def test_a_track_follows_a_moving_face(face: np.ndarray) -> None:
    result = track_faces(_moving(face, 20))
    assert result.cuts == ()
    assert result.frame_count == 20
    (track,) = result.tracks
    assert (track.first, track.last) == (0, 19)
    assert track.points.shape == (20, 106, 2)
    assert track.skin_points.shape == (20, 88, 2)
    assert track.pose.shape == (20, 3)
    assert track.points.dtype == track.skin_points.dtype == track.score.dtype == track.pose.dtype == np.float32
    assert (track.score > 0.9).all()
    assert 80 < track.width_px < 140
    steps = np.diff(track.points.mean(axis=1), axis=0)
    np.testing.assert_allclose(steps, np.tile([4.0, 0.0], (19, 1)), atol=0.6)


def test_a_cut_ends_the_track_and_starts_another(face: np.ndarray) -> None:
    frames = [(5 + i, _with_face(_scene(3), face, 40, 60)) for i in range(6)]
    frames += [(11 + i, _with_face(_scene(4), face, 260, 90)) for i in range(6)]
    result = track_faces(iter(frames))
    assert result.cuts == (11,)
    assert [(track.first, track.last) for track in result.tracks] == [(5, 10), (11, 16)]


def _hidden(face: np.ndarray, count: int, hidden: range) -> Iterator[tuple[int, np.ndarray]]:
    scene = _scene(3)
    for index in range(count):
        yield index, scene if index in hidden else _with_face(scene, face, 40 + 2 * index, 60)


def test_a_face_lost_for_less_than_a_second_resumes_its_track(face: np.ndarray) -> None:
    (track,) = track_faces(_hidden(face, 24, range(8, 15))).tracks
    assert (track.first, track.last) == (0, 23)
    np.testing.assert_array_equal(np.flatnonzero(track.score == 0), np.arange(8, 15))
    bridge = track.points[7:16]
    np.testing.assert_allclose(np.diff(bridge, 2, axis=0), 0, atol=1e-3)  # a straight line
    centre = smooth(track).points.mean(axis=1)[:, 0]
    np.testing.assert_allclose(np.diff(centre), 2, atol=0.5)


def test_a_face_lost_for_longer_starts_a_new_track(face: np.ndarray) -> None:
    result = track_faces(_hidden(face, 24, range(8, 15)), frame_rate=5)
    assert [(track.first, track.last) for track in result.tracks] == [(0, 7), (15, 23)]


def test_a_face_of_two_frames_is_dropped_unless_the_clip_is_that_short(face: np.ndarray) -> None:
    assert track_faces(_hidden(face, 12, range(2, 12))).tracks == ()
    (track,) = track_faces(_hidden(face, 2, range(0))).tracks
    assert track.last == 1
    (still,) = track_faces(_hidden(face, 1, range(0))).tracks
    assert len(still.score) == 1
    np.testing.assert_array_equal(smooth(still).points, still.points)


def test_two_tracks_never_sit_on_one_face(face: np.ndarray) -> None:
    scene = _with_face(_scene(5), face, 10, 50)
    mirrored = np.ascontiguousarray(face[:, ::-1])
    frames = [(i, _with_face(scene, mirrored, 270 - 3 * i, 70)) for i in range(18)]
    result = track_faces(iter(frames))
    assert [len(track.score) for track in result.tracks] == [18, 18]
    for index in range(18):
        boxes = [
            np.concatenate([track.points[index].min(axis=0), track.points[index].max(axis=0)])
            for track in result.tracks
        ]
        assert box_iou(boxes[0], boxes[1][None])[0] < 0.2
    assert result.tracks[0].points[0, :, 0].mean() < result.tracks[1].points[0, :, 0].mean()


def test_at_most_max_faces_are_followed(face: np.ndarray) -> None:
    frames = ((i, _with_face(_with_face(_scene(5), face, 10, 50), face, 270, 70)) for i in range(4))
    assert len(track_faces(frames, max_faces=1).tracks) == 1


def test_frames_without_a_face_are_fine(samples: Any) -> None:
    assert track_faces(iter([])).tracks == ()
    result = track_faces((i, _scene(6)) for i in range(20))
    assert result.tracks == ()
    assert result.frame_count == 20


def test_skipped_frames_are_refused(face: np.ndarray) -> None:
    with pytest.raises(ValueError, match="frame 3 follows frame 1"):
        track_faces(iter([(1, _scene(1)), (3, _scene(1))]))


def test_on_frame_sees_every_frame_and_may_abort() -> None:
    seen: list[int] = []

    def stop_at_three(index: int) -> None:
        seen.append(index)
        if index == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        track_faces(((i, _scene(1)) for i in range(10)), on_frame=stop_at_three)
    assert seen == [0, 1, 2, 3]


@pytest.mark.parametrize("change", ["darker", "shifted", "noisy"])
def test_exposure_motion_and_noise_are_not_cuts(change: str) -> None:
    scene = _scene(7)
    other = {
        "darker": (scene * 0.5).astype(np.uint8),
        "shifted": np.roll(scene, 12, axis=1),
        "noisy": np.clip(scene + np.random.default_rng(0).normal(0, 15, scene.shape), 0, 255).astype(np.uint8),
    }[change]
    detector = CutDetector()
    assert not detector.is_cut(scene)
    assert not detector.is_cut(other)
    assert detector.is_cut(_scene(8))


# --- smoothing ---


def _track(points: np.ndarray, score: np.ndarray | None = None) -> FaceTrack:
    """A track of the 194 points (n, 194, 2), with its pose made of the first points."""
    count = len(points)
    return FaceTrack(
        first=0,
        points=points[:, :106].astype(np.float32),
        skin_points=points[:, 106:].astype(np.float32),
        score=np.ones(count, np.float32) if score is None else score.astype(np.float32),
        pose=points[:, :3, 0].astype(np.float32),
    )


@pytest.fixture(scope="module")
def shape(mesh: Mesh) -> np.ndarray:
    """(194, 2) both point sets of a real face, 240 px wide."""
    points = np.concatenate([jd_106(mesh.points), skin_88(mesh.points)]).astype(np.float64)
    return points * (240 / np.ptp(points[:33, 0]))


@pytest.mark.parametrize("jitter_px", [0.1, 0.3])
@pytest.mark.parametrize("together", [False, True])
def test_jitter_of_a_still_face_falls_at_least_threefold(shape: np.ndarray, jitter_px: float, together: bool) -> None:
    rng = np.random.default_rng(0)
    noise = jitter_px * rng.standard_normal((100, 1 if together else len(shape), 2))
    track = _track(shape + noise)
    calm = smooth(track)
    for name in ("points", "skin_points"):
        before = np.diff(getattr(track, name), 2, axis=0).std()
        after = np.diff(getattr(calm, name), 2, axis=0).std()
        assert after * 3 < before


@pytest.mark.parametrize("amplitude_px", [4.0, 10.0])
def test_speech_keeps_its_peaks_and_timing(shape: np.ndarray, amplitude_px: float) -> None:
    time_s = np.arange(100) / 25
    motion = amplitude_px * np.sin(2 * np.pi * 4 * time_s)
    points = np.tile(shape, (100, 1, 1))
    points[:, 84:104, 1] += motion[:, None]
    noisy = points + 0.15 * np.random.default_rng(1).standard_normal(points.shape)
    result = smooth(_track(noisy)).points[:, 84:104, 1].mean(axis=1) - shape[84:104, 1].mean()
    gain = (result @ motion) / (motion @ motion)
    assert 0.96 < gain < 1.04
    shifts = [float(np.roll(motion, lag)[5:-5] @ result[5:-5]) for lag in (-1, 0, 1)]
    assert int(np.argmax(shifts)) == 1


def test_a_blink_keeps_its_depth_and_its_frame(shape: np.ndarray) -> None:
    points = np.tile(shape, (60, 1, 1)) + 0.1 * np.random.default_rng(2).standard_normal((60, len(shape), 2))
    lid = [53, 72, 54]
    points[30:33, lid, 1] += np.array([5.0, 9.0, 4.0])[:, None]
    result = smooth(_track(points)).points[:, lid, 1].mean(axis=1) - shape[lid, 1].mean()
    assert int(result.argmax()) == 31
    assert result.max() > 8.5
    assert np.abs(result[:26]).max() < 0.3


def test_a_steady_turn_is_not_held_back(shape: np.ndarray) -> None:
    drift = np.arange(40)[:, None, None] * np.array([3.0, -1.0])
    track = _track(shape + drift)
    calm = smooth(track)
    np.testing.assert_allclose(calm.points, track.points, atol=2e-3)
    np.testing.assert_allclose(calm.skin_points, track.skin_points, atol=2e-3)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**16), count=st.integers(1, 40), size=st.floats(0.05, 5))
def test_smoothing_commutes_with_time_reversal(seed: int, count: int, size: float) -> None:
    rng = np.random.default_rng(seed)
    base = rng.uniform(0, 200, (1, 194, 2))
    points = base + size * rng.standard_normal((count, 194, 2)).cumsum(axis=0)
    forward = smooth(_track(points))
    backward = smooth(_track(points[::-1]))
    np.testing.assert_allclose(backward.points[::-1], forward.points, atol=1e-2)
    np.testing.assert_allclose(backward.pose[::-1], forward.pose, atol=1e-2)


def test_smoothing_does_not_reach_across_a_gap(shape: np.ndarray) -> None:
    rng = np.random.default_rng(3)
    points = shape + 0.2 * rng.standard_normal((60, len(shape), 2))
    score = np.ones(60)
    score[25:30] = 0
    moved = points.copy()
    moved[30:] += 40
    calm = smooth(_track(points, score))
    other = smooth(_track(moved, score))
    np.testing.assert_array_equal(other.points[:25], calm.points[:25])
    np.testing.assert_allclose(other.points[30:], calm.points[30:] + 40, atol=5e-2)
    np.testing.assert_allclose(np.diff(other.points[24:31], 2, axis=0), 0, atol=1e-3)
    np.testing.assert_array_equal(other.score, score.astype(np.float32))


# Persons


def _posed(shape: np.ndarray, first: int, count: int, stretch: float = 1.0) -> FaceTrack:
    """A track of a still face; stretch makes the lower half of the face that much longer."""
    points = np.tile(shape[:194], (count, 1, 1)).astype(np.float32)
    middle = points[:, 43:44, 1:]
    points[..., 1:] = np.where(points[..., 1:] > middle, middle + stretch * (points[..., 1:] - middle), points[..., 1:])
    points += 0.1 * np.random.default_rng(first).standard_normal(points.shape).astype(np.float32)
    pose = np.zeros((count, 3), np.float32)
    return FaceTrack(first, points[:, :106], points[:, 106:], np.ones(count, np.float32), pose)


def test_tracks_alike_in_shape_and_colour_are_one_person_and_others_are_not(mesh: Mesh) -> None:
    shape = np.concatenate([jd_106(mesh.points), skin_88(mesh.points)])
    one, again = _posed(shape, 0, 20), _posed(0.6 * shape + 40, 30, 20)
    longer = _posed(shape, 60, 20, stretch=1.15)
    tan, same_tan, deep = (200, 150, 120), (190, 145, 120), (90, 55, 40)
    assert link_persons([one, again, longer], [tan, same_tan, tan]) == (0, 0, 1)
    assert link_persons([one, longer, again], [tan, tan, same_tan]) == (0, 1, 0)
    assert link_persons([one, again], [tan, deep]) == (0, 1)
    assert link_persons([], np.empty((0, 3))) == ()


def test_tracks_seen_at_the_same_time_are_never_one_person(mesh: Mesh) -> None:
    shape = np.concatenate([jd_106(mesh.points), skin_88(mesh.points)])
    tracks = [_posed(shape, 0, 20), _posed(shape, 19, 20), _posed(shape, 60, 20)]
    persons = link_persons(tracks, [(200, 150, 120)] * 3)
    assert persons[0] != persons[1]
    assert persons[2] in persons[:2]


def test_a_face_never_seen_from_the_front_stays_a_person_of_its_own(mesh: Mesh) -> None:
    shape = np.concatenate([jd_106(mesh.points), skin_88(mesh.points)])
    one, away = _posed(shape, 0, 20), _posed(shape, 30, 20)
    away.pose[:, 0] = 40.0
    assert face_proportions(away) is None
    assert link_persons([one, away], [(200, 150, 120)] * 2) == (0, 1)


def test_proportions_ignore_where_how_large_and_how_leaned_a_face_is(mesh: Mesh) -> None:
    shape = np.concatenate([jd_106(mesh.points), skin_88(mesh.points)])
    cos, sin = np.cos(0.4), np.sin(0.4)
    leaned = 1.7 * shape @ np.array([[cos, sin], [-sin, cos]], np.float32) + 30
    straight, other = face_proportions(_posed(shape, 0, 9)), face_proportions(_posed(leaned, 0, 9))
    assert straight is not None
    assert other is not None
    np.testing.assert_allclose(straight, other, atol=0.02)


def test_two_women_across_a_cut_are_two_persons_and_one_in_two_clips_is_one(media_dir: Path) -> None:
    clips = media_dir / "clips"
    cut = clips / "scene_cut_dark_to_bright_two_women_720p.mp4"
    frames = ((frame.index, frame.rgb()) for frame in read_frames(cut, start=100, stop=145))
    blonde, redhead = track_faces(frames).tracks
    assert redhead.first == 120
    other = clips / "woman_pale_redhair_moving_camera_720p.mp4"
    frames = ((200 + frame.index, frame.rgb()) for frame in read_frames(other, start=120, stop=145))
    (again,) = track_faces(frames).tracks
    skin = [(200, 150, 120)] * 3  # shape alone has to tell them apart
    assert link_persons([blonde, redhead, again], skin) == (0, 1, 1)
