"""Where an asset finds its clip: a path relative to itself, which is never more than a hint."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pvg.asset import AssetWriter, FaceRecord, VectorVideo, open_asset, source_note
from pvg.asset.writing import replace_manifest
from pvg.errors import AssetError
from tests.gallery.assets import FIRST, FRAMES, SUMMARY, frame_arrays, key_frame, manifest_of, write_asset


@pytest.fixture
def asset(tmp_path: Path, source: Path) -> Path:
    """An asset beside its clip."""
    path = tmp_path / "clip.pvg"
    with AssetWriter(path) as writer:
        for i in range(FRAMES):
            writer.add_frame(0, frame_arrays(i))
        writer.add_face(FaceRecord(SUMMARY, (key_frame(),)))
        writer.finish(manifest_of(source, FIRST + FRAMES) | source_note(source, path))
    return path


def _with_note(asset: Path, **note: object) -> Path:
    """A copy in a folder of its own whose manifest says so of its clip."""
    copy = asset.parent / "assets" / "copy.pvg"
    copy.parent.mkdir(exist_ok=True)
    copy.write_bytes(asset.read_bytes())
    with VectorVideo(copy) as video:
        manifest = {k: v for k, v in video.manifest.items() if not k.startswith("source_")}
        manifest["source_sha256"] = video.source_sha256
    replace_manifest(copy, {**manifest, **note})
    return copy


def test_an_asset_finds_its_clip_elsewhere_and_after_both_have_moved(asset: Path, source: Path, tmp_path: Path) -> None:
    clips = tmp_path / "clips"
    clips.mkdir()
    elsewhere = source.rename(clips / "other name.bin")
    copy = _with_note(asset, **source_note(elsewhere, tmp_path / "assets" / "copy.pvg"))
    with open_asset(copy) as video:
        assert video.manifest["source_path"] == "../clips/other name.bin"
        assert video.require_source().samefile(elsewhere)
    moved = tmp_path / "moved"
    moved.mkdir()
    clips.rename(moved / "clips")
    copy.parent.rename(moved / "assets")
    with open_asset(moved / "assets" / "copy.pvg") as video:
        assert video.require_source().samefile(moved / "clips" / "other name.bin")


def test_a_noted_path_is_a_hint_only(asset: Path, source: Path, tmp_path: Path) -> None:
    """Whoever made the file may have written anything there."""
    other = tmp_path / "secret.bin"
    other.write_bytes(b"not the clip")
    for path in (str(other), "C:\\secret.bin", "\\\\host\\share\\clip.bin", "", ".", "..", "\0", 3, "x" * 9999):
        with open_asset(_with_note(asset, source_path=path)) as video:
            assert video.source is None, path
    guessed = _with_note(asset, source_path="../secret.bin")
    with open_asset(guessed) as video, pytest.raises(AssetError, match="not the clip"):
        video.require_source()
    hinted = _with_note(asset, **source_note(source, tmp_path / "assets" / "copy.pvg"))
    with VectorVideo(hinted) as video, open_asset(hinted, find_source=False) as same:
        assert video.source is same.source is None
    with open_asset(hinted, other) as video:  # what is given is not replaced by what is noted
        assert video.source == other


def test_a_saved_copy_notes_where_the_clip_lies_from_there(asset: Path, source: Path, tmp_path: Path) -> None:
    folder = tmp_path / "a" / "b"
    folder.mkdir(parents=True)
    with VectorVideo(asset, source) as video:
        video.save(folder / "saved.pvg")
    with open_asset(folder / "saved.pvg") as video:
        assert video.manifest["source_path"] == "../../clip.bin"
        assert video.require_source().samefile(source)


def test_the_clip_is_found_from_another_folder(
    asset: Path, source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path)
    with VectorVideo(asset.name, source.name) as named, open_asset(asset.name) as found:
        monkeypatch.chdir("elsewhere")
        for video in (named, found):
            assert video.require_source().samefile(source)
            video.save("saved.pvg")
            with open_asset("saved.pvg") as saved:
                assert saved.require_source().samefile(source)


def test_what_is_saved_is_what_was_opened(asset: Path, source: Path, tmp_path: Path) -> None:
    other = write_asset(tmp_path / "other.pvg", source, seed=1)
    with VectorVideo(asset, source) as video:
        points = video.landmarks(0)
        other.replace(asset)  # as when its clip is vectorised again
        video.save(tmp_path / "saved.pvg")
    with open_asset(tmp_path / "saved.pvg") as saved, open_asset(asset) as newer:
        saved.verify()
        np.testing.assert_array_equal(saved.landmarks(0), points)
        assert (newer.landmarks(0) != points).any()


def test_a_copy_never_takes_the_place_of_the_clip(asset: Path, source: Path, tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    with VectorVideo(asset, source) as video:
        with pytest.raises(ValueError, match="would be replaced"):
            video.save(tmp_path / "folder" / ".." / source.name)
        with pytest.raises(IsADirectoryError, match="folder"):
            video.save(tmp_path / "folder")
        with pytest.raises(FileNotFoundError, match="none"):
            video.save(tmp_path / "none" / "saved.pvg")
    assert source.read_bytes() == b"the clip"


def test_a_temporary_asset_notes_no_path(tmp_path: Path) -> None:
    assert source_note(tmp_path / "clip.mp4", None) == {"source_name": "clip.mp4"}


def test_beside_it_the_clip_is_found_by_its_name(asset: Path, source: Path) -> None:
    copy = _with_note(asset, source_name=source.name)
    with open_asset(copy) as video:
        assert video.source is None
    source.rename(copy.with_name(source.name))
    with open_asset(copy) as video:
        assert video.require_source().name == source.name
