from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

import pvg
from benchmarks.quality.lossless import write_lossless
from pvg.landmarks import MAX_FACES, FaceTracker
from pvg.video import write_image
from scripts.samples import Samples
from tests.gallery.faces import fit_surest, read_rgb
from tests.gallery.pictures import background, pasted
from tests.threads import own_threads


@pytest.fixture(scope="module")
def head(samples: Samples) -> np.ndarray:
    """(160, 150, 3) of a portrait; its face is some 80 px wide."""
    rgb = read_rgb(samples.portrait)
    points = fit_surest(rgb).points
    scale = 80 / np.ptp(points[:, 0])
    shift = np.array([75, 80]) - scale * points.mean(axis=0)
    return cv2.warpAffine(rgb, np.array([[scale, 0, shift[0]], [0, scale, shift[1]]]), (150, 160), flags=cv2.INTER_AREA)


def test_a_group_that_is_too_large_is_told_who_is_left_out(head: np.ndarray, tmp_path: Path) -> None:
    """And of as many faces as are followed each has no threads of its own."""
    group = np.zeros((4 * 160, 5 * 150, 3), np.uint8)
    for k in range(MAX_FACES + 2):
        y, x = 160 * (k // 5), 150 * (k % 5)
        group[y : y + 160, x : x + 150] = head
    write_image(tmp_path / "group.png", group)
    own, running = own_threads(), []

    def count(stage: str, done: int, expected: int) -> None:
        running.append(len(own()))

    with pvg.vectorize(tmp_path / "group.png", mask="ycbcr", progress=count) as video:
        assert len(video.faces) == MAX_FACES
        (warning,) = video.media.warnings
    assert warning == f"2 more faces are left out: at most {MAX_FACES} are followed at a time"
    assert max(running) <= 6
    with pvg.vectorize(tmp_path / "group.png", reference=True) as reference:
        assert len(reference.faces) == MAX_FACES
        assert reference.media.warnings == (warning,)


def test_shots_of_one_frame_are_told_to_be_too_short(head: np.ndarray, tmp_path: Path) -> None:
    rooms = [np.random.default_rng(seed).integers(30, 220, (4, 6, 3)).astype(np.uint8) for seed in range(4)]
    frames = [cv2.resize(room, (480, 320), interpolation=cv2.INTER_CUBIC) for room in rooms]
    for k, frame in enumerate(frames):
        frame[60:220, 20 + 80 * k : 170 + 80 * k] = head
    write_lossless(tmp_path / "brief.mp4", iter(frames))
    with pytest.raises(pvg.NoFaceError, match=r"no face is seen for long enough in the 4 frames of brief\.mp4"):
        pvg.vectorize(tmp_path / "brief.mp4")
    with pytest.raises(pvg.NoFaceError, match=r"no face is seen for long enough in the 4 frames of brief\.mp4"):
        pvg.vectorize(tmp_path / "brief.mp4", reference=True)


def test_a_limit_below_usual_widths_is_the_one_that_is_named(samples: Samples, tmp_path: Path) -> None:
    rgb = read_rgb(samples.portrait)
    scale = 18 / np.ptp(fit_surest(rgb).points, axis=0).max()
    small = np.asarray(cv2.resize(rgb, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8)
    write_image(tmp_path / "small.png", small)
    with pvg.vectorize(tmp_path / "small.png", min_face_px=12) as video:
        assert 14 < video.faces[0].width_px < 22


def test_who_gives_a_place_to_a_larger_face_keeps_the_frames_before(
    head: np.ndarray, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert FaceTracker.__init__.__kwdefaults__ is not None
    monkeypatch.setitem(FaceTracker.__init__.__kwdefaults__, "max_faces", 1)
    large = cv2.resize(head, (240, 256), interpolation=cv2.INTER_CUBIC)
    small = pasted(background(5, 900, 480), head, 10, 50)  # the larger face is no cut
    frames = [small if k < 14 else pasted(small, large, 300, 60) for k in range(24)]
    write_lossless(tmp_path / "crowd.mp4", iter(frames))
    with pvg.vectorize(tmp_path / "crowd.mp4") as video:
        spans = sorted((face.first_frame, face.last_frame) for face in video.faces)
        assert video.media.warnings == ("1 more face is left out: at most 12 are followed at a time",)
    (_, until), (since, last) = spans
    assert until == since - 1
    assert 14 <= since <= 20
    assert last == 23
