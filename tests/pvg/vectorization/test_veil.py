"""Fades from and to white: what a look changes fades alike."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import pvg
from benchmarks.quality.lossless import write_lossless
from pvg.picture import rms_contrast
from pvg.rendering import source_frame
from pvg.vectorization import following
from pvg.vectorization.veil import Veil
from scripts.samples import Samples
from tests.gallery.scenes import Subject, resting_face

PICTURE = np.random.default_rng(4).uniform(20, 230, (40, 60))
FACE = PICTURE[10:30, 20:40]


def shown(picture: np.ndarray) -> float:
    """How far the face shows through in a picture (40, 60)."""
    key = Veil(rms_contrast(FACE), rms_contrast(PICTURE), float(FACE.mean()))
    return key.transmission(rms_contrast(picture[10:30, 20:40]), rms_contrast(picture))


@pytest.mark.parametrize("share", [0.3, 0.5, 0.8, 1.0])
def test_a_face_shows_through_a_veil_by_what_is_left_of_it(share: float) -> None:
    assert shown(PICTURE + share * (255 - PICTURE)) == pytest.approx((1 - share) / 0.9, abs=0.05)


def test_light_that_changes_is_no_veil() -> None:
    assert shown(0.3 * PICTURE) == pytest.approx(1.0)
    softer = PICTURE.copy()
    softer[10:30, 20:40] += 0.6 * (FACE.mean() - FACE)
    assert shown(softer) > 0.99
    elsewhere = 125 + 0.3 * (PICTURE - 125)
    elsewhere[10:30, 20:40] = FACE
    assert shown(elsewhere) > 0.99


def fading(subject: Subject, path: Path, shares: np.ndarray) -> Path:
    """A face at rest, that share of the way to white in each frame."""
    rgb = subject.rgb.astype(np.float64)
    write_lossless(path, (np.rint(rgb + share * (255 - rgb)).astype(np.uint8) for share in shares))
    return path


@pytest.mark.parametrize("readings", [1, 2])
@pytest.mark.parametrize("comes", [False, True], ids=["to white", "from white"])
def test_a_look_fades_with_the_picture(
    samples: Samples,
    dark_reference: pvg.VectorVideo,
    tmp_path: Path,
    comes: bool,
    readings: int,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    if readings == 2:  # as of a face without a good view in time
        monkeypatch.setattr(following, "good_rows", lambda track: np.zeros(len(track.score), np.bool_))
        monkeypatch.setattr(following, "CHUNK", 4)
        monkeypatch.setattr(following, "LOOKAHEAD", 4)
    subject, shares = resting_face(samples), np.concatenate([np.zeros(10), np.linspace(0, 0.95, 10)])
    shares = shares[::-1] if comes else shares
    with pvg.vectorize(fading(subject, tmp_path / "clip.mp4", shares)) as video:
        (record,) = video.records
        assert [shares[key.frame] < 0.06 for key in record.key_frames] == [True]
        look, change = pvg.transfer(video, dark_reference, scene=0.0), {}
        for index in (15, 12, 10, 5) if not comes else (4, 7, 9, 14):
            drawn, source = pvg.render_frame(video, look, index), source_frame(video, index).rgb()
            change[index] = np.abs(drawn.astype(float) - source)[subject.inner].mean()
        whole = max(change.values())
        assert whole > 15
        for index, mean in change.items():
            assert mean < 1.3 * (1 - shares[index]) * whole
