from __future__ import annotations

import errno
import os
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pvg.asset import AssetWriter, FaceRecord, FaceSummary, KeyFrame, open_asset
from tests.gallery.assets import FIRST, FRAMES, SUMMARY, frame_arrays, key_frame, manifest_of


def test_an_aborted_writer_leaves_nothing_behind(tmp_path: Path) -> None:
    def abort() -> None:
        with AssetWriter(tmp_path / "never.pvg") as writer:
            writer.add_frame(0, frame_arrays(0))
            raise RuntimeError

    with pytest.raises(RuntimeError):
        abort()
    assert list(tmp_path.iterdir()) == []


def test_an_end_as_soon_as_the_file_is_there_leaves_nothing_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A signal to end may come between any two steps, and the one after the file is made is no other."""

    def ended(*_: object) -> None:
        assert len(list(tmp_path.iterdir())) == 1
        raise KeyboardInterrupt

    monkeypatch.setattr(zipfile, "ZipFile", ended)
    with pytest.raises(KeyboardInterrupt), AssetWriter(tmp_path / "never.pvg"):
        pass
    assert list(tmp_path.iterdir()) == []


def test_a_disk_that_is_full_at_the_end_leaves_nothing_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(archive: zipfile.ZipFile) -> None:
        monkeypatch.undo()
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def write() -> None:
        with AssetWriter(tmp_path / "never.pvg") as writer:
            writer.add_frame(0, frame_arrays(0))
            monkeypatch.setattr(zipfile.ZipFile, "close", full)

    with pytest.raises(OSError, match="space"):
        write()
    assert list(tmp_path.iterdir()) == []


def test_a_track_that_is_dropped_is_in_no_asset(tmp_path: Path, source: Path) -> None:
    path = tmp_path / "clip.pvg"
    with AssetWriter(path) as writer:
        for track in (0, 1):
            for i in range(FRAMES):
                far = {"box": np.full(4, 1e5, np.float32)} if track == 0 else {}
                writer.add_frame(track, frame_arrays(i) | far)
        writer.drop_track(0)
        writer.add_face(FaceRecord(SUMMARY, (key_frame(),)), 1)
        writer.finish(manifest_of(source, FIRST + FRAMES))
    with open_asset(path) as video:
        video.verify()
        assert {name.split("/")[0] for name in video.manifest["entries"]} == {"track1"}


def test_faces_keep_their_frames_whatever_number_their_tracks_were_written_under(tmp_path: Path, source: Path) -> None:
    """As many tracks that are no face may have been found before."""
    path, tracks = tmp_path / "clip.pvg", (2, 5_000)
    with AssetWriter(path) as writer:
        for face in (1, 0):
            for i in range(5):
                writer.add_frame(tracks[face], frame_arrays(100 * face + i))
        for face, track in enumerate(tracks):
            summary = FaceSummary(face, 0, 4, 150.0, (200, 150, 120), face)
            writer.add_face(FaceRecord(summary, (key_frame(),)), track)
        writer.finish(manifest_of(source, 5))
    with open_asset(path) as video:
        for face in (0, 1):
            data = video.face_at(face, 3)
            assert data is not None
            assert np.abs(data.landmarks.points - frame_arrays(100 * face + 3)["points"]).max() <= 1 / 64
            assert np.abs(video.landmarks(face)[3] - data.landmarks.points).max() == 0


def test_what_no_reader_would_take_replaces_no_asset(tmp_path: Path, source: Path) -> None:
    path = tmp_path / "clip.pvg"
    path.write_bytes(b"of before")
    manifest = manifest_of(source, 5)
    settings = {"mask": "landmark", "matching": "table", "reference": False}

    def write(arrays: dict[str, np.ndarray], key: KeyFrame, manifest: dict[str, object]) -> None:
        with AssetWriter(path) as writer:
            writer.add_frame(0, arrays)
            writer.add_face(FaceRecord(FaceSummary(0, 0, 0, 150.0, (200, 150, 120), 0), (key,)))
            writer.finish(manifest)

    good, key = frame_arrays(0), key_frame()
    for arrays, colors, said, words in (
        (good, key, manifest | {"settings": settings}, "mask"),
        (good, key, manifest | {"shots": [9]}, "shots"),
        (good | {"score": np.array([np.nan], np.float32)}, key, manifest, "no numbers"),
        (good, replace(key, colors=key.colors[:-1]), manifest, "not <f4"),
        (good | {"box": np.array([0, 0, 9 * 320 + 1, 240], np.float32)}, key, manifest, "far from the picture"),
        (good | {"points": good["points"] - 9 * 320}, key, manifest, "far from the picture"),
        (good | {"box": np.array([10, 10, 10.5, 200], np.float32)}, key, manifest, "no pixel"),
        (good, replace(key, skin=np.zeros((70_000, 3), np.float32)), manifest, "more than are read"),
    ):
        with pytest.raises(ValueError, match=words):
            write(arrays, colors, said)
        assert path.read_bytes() == b"of before"
    with AssetWriter(path) as writer, pytest.raises(ValueError, match="no face"):
        writer.finish(manifest)
    assert path.read_bytes() == b"of before"
    write(good, replace(key, frame=0), manifest)
    with open_asset(path) as video:
        video.verify()
    assert [one.name for one in tmp_path.iterdir() if one.name.startswith(".")] == []
