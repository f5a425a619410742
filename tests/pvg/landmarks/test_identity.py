from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from pathlib import Path

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from pvg.face import Landmarks
from pvg.landmarks import FaceShape, face_proportions, link_persons, proportions_of, track_faces
from pvg.landmarks.identity import _ALIKE, _distances
from pvg.video import read_frames
from tests.gallery.faces import rolled
from tests.gallery.tracks import nearly_still_track


def test_tracks_alike_in_shape_and_colour_are_one_person_and_others_are_not(face: Landmarks) -> None:
    one, again = nearly_still_track(face, 0, 20), nearly_still_track(Landmarks.unstack(0.6 * face.stacked + 40), 30, 20)
    longer = nearly_still_track(face, 60, 20, stretch=1.15)
    tan, same_tan, deep = (200, 150, 120), (190, 145, 120), (90, 55, 40)
    assert link_persons([one, again, longer], [tan, same_tan, tan]) == (0, 0, 1)
    assert link_persons([one, longer, again], [tan, tan, same_tan]) == (0, 1, 0)
    assert link_persons([one, again], [tan, deep]) == (0, 1)
    assert link_persons([], np.empty((0, 3))) == ()


def made_up_shapes(rng: np.random.Generator, count: int) -> tuple[list[FaceShape], np.ndarray]:
    """Tracks of a few persons, more or less alike, some of them at the same time and some hardly seen."""
    persons = rng.uniform(0.3, 1.2, (1 + count // 6, 11))
    shapes = []
    for _ in range(count):
        first, seen = int(rng.integers(0, 40 * count)), int(rng.integers(3, 9))
        own = persons[rng.integers(len(persons))] * np.exp(0.03 * rng.uniform(0, 1) * rng.standard_normal(11))
        ratios = own * np.exp(0.01 * rng.standard_normal((seen, 11)))
        shapes.append(FaceShape(first, first + int(rng.integers(0, 60)), proportions_of(ratios.astype(np.float32))))
    return shapes, rng.uniform(180, 205, (count, 3)) - (0, 45, 75)


def linked_by_the_rule(tracks: Sequence[FaceShape], skin_rgb: np.ndarray) -> tuple[int, ...]:
    """Pair by pair, the nearest first: two groups become one where all of one are alike to all of the other."""
    distance = _distances(tracks, skin_rgb.astype(np.float32))
    groups = [{i} for i in range(len(tracks))]
    pairs = [(distance[i, j], i, j) for i in range(len(tracks)) for j in range(i) if distance[i, j] <= _ALIKE]
    for _, i, j in sorted(pairs):
        one, other = (next(group for group in groups if k in group) for k in (i, j))
        if one is not other and all(distance[a, b] <= _ALIKE for a, b in product(one, other)):
            one |= other
            groups.remove(other)
    groups.sort(key=min)
    return tuple(next(p for p, group in enumerate(groups) if i in group) for i in range(len(tracks)))


@given(st.integers(0, 2**32 - 1), st.integers(1, 40))
@settings(max_examples=40)
def test_persons_are_those_of_the_rule(seed: int, count: int) -> None:
    shapes, skin = made_up_shapes(np.random.default_rng(seed), count)
    assert link_persons(shapes, skin) == linked_by_the_rule(shapes, skin)


def test_tracks_seen_at_the_same_time_are_never_one_person(face: Landmarks) -> None:
    tracks = [nearly_still_track(face, 0, 20), nearly_still_track(face, 19, 20), nearly_still_track(face, 60, 20)]
    persons = link_persons(tracks, [(200, 150, 120)] * 3)
    assert persons[0] != persons[1]
    assert persons[2] in persons[:2]


def test_a_face_never_seen_from_the_front_stays_a_person_of_its_own(face: Landmarks) -> None:
    one, away = nearly_still_track(face, 0, 20), nearly_still_track(face, 30, 20)
    away.pose[:, 0] = 40.0
    assert face_proportions(away) is None
    assert link_persons([one, away], [(200, 150, 120)] * 2) == (0, 1)


def test_proportions_ignore_where_how_large_and_how_leaned_a_face_is(face: Landmarks) -> None:
    leaned = Landmarks.unstack(1.7 * rolled(face.stacked, 0.4) + 30)
    straight, other = (
        face_proportions(nearly_still_track(face, 0, 9)),
        face_proportions(nearly_still_track(leaned, 0, 9)),
    )
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
