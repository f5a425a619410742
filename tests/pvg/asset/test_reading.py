from __future__ import annotations

import copy
import gc
import hashlib
import io
import json
import multiprocessing
import os
import pickle
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pvg.asset import (
    CHUNK_FRAMES,
    AssetWriter,
    FaceRecord,
    FaceSummary,
    VectorVideo,
    faces_by_index,
    open_asset,
    reading,
)
from pvg.asset.arrays import FRAME_ARRAYS
from pvg.asset.writing import replace_manifest
from pvg.curves import boundary_points
from pvg.errors import AssetError
from pvg.face import FaceAxes
from tests.gallery.assets import FIRST, FRAMES, SUMMARY, frame_arrays, key_frame, manifest_of


def test_an_asset_that_was_closed_is_not_called_damaged(asset: Path, source: Path) -> None:
    with open_asset(asset, source) as video:
        pass
    with pytest.raises(AssetError, match=r"has been closed: use it before that, within its `with` block$"):
        video.face_at(0, FIRST)
    assert video.faces == (SUMMARY,)


def test_a_temporary_asset_cannot_be_saved_once_it_was_closed(asset: Path, tmp_path: Path) -> None:
    with VectorVideo(asset, temporary=True) as video:
        video.save(tmp_path / "kept.pvg")
    with pytest.raises(AssetError, match=r"clip\.pvg has been closed"):
        video.save(tmp_path / "late.pvg")
    assert (tmp_path / "kept.pvg").is_file()
    assert not (tmp_path / "late.pvg").exists()


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, pickle.dumps])
def test_an_open_asset_is_neither_copied_nor_pickled(asset: Path, copied: Callable[[object], object]) -> None:
    with VectorVideo(asset) as video:
        with pytest.raises(TypeError, match=r"holds open files and is neither copied nor pickled: pvg\.open_asset"):
            copied(video)
        gc.collect()
        video.verify()


def test_round_trip_keeps_every_array_to_its_stated_precision(asset: Path, source: Path) -> None:
    with open_asset(asset, source) as video:
        assert video.frame_count == FIRST + FRAMES
        assert video.shots == (0, 40)
        assert video.faces == (SUMMARY,)
        for i in (0, 1, CHUNK_FRAMES - 1, CHUNK_FRAMES, FRAMES - 1, 7):  # forwards and back, across chunks
            want, data = frame_arrays(i), video.face_at(0, FIRST + i)
            assert data is not None
            assert np.abs(data.landmarks.points - want["points"]).max() <= 1 / 64
            assert np.abs(data.landmarks.skin_points - want["skin_points"]).max() <= 1 / 64
            assert data.score == want["score"][0]
            np.testing.assert_array_equal(data.pose, want["pose"])
            np.testing.assert_array_equal(data.matte.raster.box, want["box"])
            assert np.abs(data.matte.alpha.astype(int) - want["matte"]).max() <= 2
            np.testing.assert_array_equal(data.matte.alpha == 0, want["matte"] == 0)
            np.testing.assert_array_equal(data.body.alpha, want["body"])
            np.testing.assert_array_equal(data.body.raster.box, [0, 0, 320, 240])
            boundary = boundary_points(want["radius"], FaceAxes.of(want["points"]))
            assert np.abs(data.boundary - boundary).max() < 0.15
        assert video.face_at(0, FIRST - 1) is None
        assert video.face_at(0, FIRST + FRAMES) is None
        key = video.records[0].key_frame_of(50)
        np.testing.assert_array_equal(key.colors, key_frame().colors)
        np.testing.assert_array_equal(key.visible, key_frame().visible)
        np.testing.assert_array_equal(key.skin, key_frame().skin)
        landmarks = video.landmarks(0)
        assert landmarks.shape == (FRAMES, 106, 2)
        assert landmarks.dtype == np.float32
        json.dumps(video.summary())
        video.verify()


def test_a_chunk_that_was_read_again_is_not_the_first_to_go(asset: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reading, "_CACHED_CHUNKS", 2)
    decoded: list[str] = []
    with open_asset(asset) as video:
        decode = video._decoded
        monkeypatch.setattr(video, "_decoded", lambda entry, *rest: decoded.append(entry) or decode(entry, *rest))
        for chunk in (0, 1, 0, 2, 0):
            video.face_at(0, FIRST + chunk * CHUNK_FRAMES)
    assert [entry for entry in decoded if "/points/" in entry] == [f"track0/points/{k:06d}" for k in (0, 1, 2)]


def test_faces_that_are_gone_leave_the_cache(tmp_path: Path, source: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reading, "_CACHED_CHUNKS", 1)
    path, faces = tmp_path / "clip.pvg", 12
    with AssetWriter(path) as writer:
        for face in range(faces):  # two in every frame but the first and the last
            writer.add_frame(face, frame_arrays(face))
            writer.add_frame(face, frame_arrays(face))
            summary = FaceSummary(face, face, face + 1, 150.0, (200, 150, 120), face)
            writer.add_face(FaceRecord(summary, (key_frame(),)))
        writer.finish(manifest_of(source, faces + 1))
    decoded: list[str] = []
    with open_asset(path) as video:
        decode = video._decoded
        monkeypatch.setattr(video, "_decoded", lambda entry, *rest: decoded.append(entry) or decode(entry, *rest))
        for frame in range(faces + 1):
            seen = [face for face in range(faces) if video.face_at(face, frame) is not None]
            assert seen == [face for face in (frame - 1, frame) if 0 <= face < faces]
            assert len(video._cache) <= 2 * len(FRAME_ARRAYS)
    assert len(decoded) == len(set(decoded)) == faces * len(FRAME_ARRAYS)


def test_frames_are_read_by_several_threads_at_once(asset: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reading, "_CACHED_CHUNKS", 1)
    with open_asset(asset) as video:
        want = {i: frame_arrays(i)["score"] for i in range(0, FRAMES, CHUNK_FRAMES)}

        def read(thread: int) -> int:
            order = np.random.default_rng(thread).permutation(np.repeat(list(want), 40))
            return sum(video.face_at(0, FIRST + int(i)).score != want[int(i)][0] for i in order)  # type: ignore[union-attr]

        before = sys.getswitchinterval()
        sys.setswitchinterval(1e-6)
        try:
            with ThreadPoolExecutor(4) as threads:
                assert list(threads.map(read, range(4))) == [0] * 4
        finally:
            sys.setswitchinterval(before)


_OF_FORKS = "ignore:.*multi-threaded, use of fork:DeprecationWarning"


@pytest.mark.filterwarnings(_OF_FORKS)
def test_frames_are_read_by_forked_processes_at_once(asset: Path) -> None:
    """They share the parent's open file, and with it the place in it that the system keeps."""
    with open_asset(asset) as video, multiprocessing.get_context("fork").Pool(3, _share, [video]) as pool:
        assert pool.map_async(_verified, range(6), chunksize=1).get(timeout=120) == [""] * 6


_shared: list[VectorVideo] = []


def _share(video: VectorVideo) -> None:
    _shared[:] = [video]


def _verified(_: int) -> str:
    try:
        for _ in range(40):
            _shared[0].verify()
    except AssetError as error:
        return str(error)
    return ""


@pytest.mark.filterwarnings(_OF_FORKS)
def test_a_temporary_asset_goes_with_the_process_that_made_it(asset: Path) -> None:
    video = VectorVideo(asset, temporary=True)
    child = os.fork()
    if child == 0:
        try:
            video.close()
        finally:
            os._exit(0)
    assert os.waitpid(child, 0)[1] == 0
    video.verify()
    assert asset.exists()
    video.close()
    assert not asset.exists()


def test_fixed_point_errors_do_not_accumulate_over_frames(asset: Path) -> None:
    with open_asset(asset) as video:
        errors = [np.abs(video.landmarks(0)[i] - frame_arrays(i)["points"]).max() for i in range(FRAMES)]
    assert max(errors) <= 1 / 64


def everything(path: Path) -> bytes:
    with open_asset(path) as video:
        video.verify()
        parts = [video.face_at(0, i) for i in range(FIRST, FIRST + FRAMES)]
        body = b"".join(
            p.landmarks.points.tobytes() + p.matte.alpha.tobytes() + p.boundary.tobytes() for p in parts if p
        )
        return body + json.dumps(video.summary()).encode() + video.records[0].key_frames[0].colors.tobytes()


@settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow]
)
@given(data=st.data())
def test_an_altered_byte_is_refused_or_changes_nothing(asset: Path, tmp_path: Path, data: st.DataObject) -> None:
    body = bytearray(asset.read_bytes())
    good = everything(asset)
    position = data.draw(st.integers(0, len(body) - 1))
    body[position] ^= data.draw(st.integers(1, 255))
    altered = tmp_path / "altered.pvg"
    altered.write_bytes(body)
    try:
        read = everything(altered)
    except AssetError:
        return
    assert read == good  # a byte that carries nothing, such as an archive date


def test_every_altered_byte_of_the_directory_is_refused_or_changes_nothing(asset: Path, tmp_path: Path) -> None:
    body = asset.read_bytes()
    good = everything(asset)
    altered = tmp_path / "altered.pvg"
    start = body.rindex(b"PK\x01\x02", 0, body.rindex(b"PK\x05\x06"))  # the last entry's record, then the end record
    for position in range(start, len(body)):
        for flip in (0x01, 0x40, 0xFF):
            altered.write_bytes(body[:position] + bytes([body[position] ^ flip]) + body[position + 1 :])
            try:
                read = everything(altered)
            except AssetError:
                continue
            assert read == good, position


@settings(
    max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow]
)
@given(part=st.floats(0, 0.999))
def test_a_truncated_asset_is_refused(asset: Path, tmp_path: Path, part: float) -> None:
    body = asset.read_bytes()
    cut = tmp_path / "cut.pvg"
    cut.write_bytes(body[: int(part * len(body))])
    with pytest.raises(AssetError):
        open_asset(cut)


def test_another_format_version_is_refused_by_name(asset: Path, tmp_path: Path) -> None:
    newer = tmp_path / "newer.pvg"
    with zipfile.ZipFile(asset) as old, zipfile.ZipFile(newer, "w") as new:
        manifest = json.loads(old.read("manifest.json"))
        manifest["format"] = 999
        data = json.dumps(manifest).encode()
        new.writestr("manifest.json", data)
        new.comment = hashlib.sha256(data).hexdigest().encode()
    with pytest.raises(AssetError, match="format 999"):
        open_asset(newer)


def test_an_asset_without_a_face_is_refused_in_words(asset: Path) -> None:
    """Nothing could be drawn on it, and no colour had of it."""
    with open_asset(asset) as video:
        replace_manifest(asset, {**video.manifest, "faces": []})
    with pytest.raises(AssetError, match=r"^clip\.pvg has no face; vectorise a clip or portrait that shows one$"):
        open_asset(asset)


def test_loading_never_unpickles(asset: Path, tmp_path: Path) -> None:
    """A pickled array with matching digests is still refused."""
    buffer = io.BytesIO()
    np.save(buffer, np.array([{"a": 1}], dtype=object), allow_pickle=True)
    evil = tmp_path / "evil.pvg"
    with zipfile.ZipFile(asset) as old, zipfile.ZipFile(evil, "w") as new:
        manifest = json.loads(old.read("manifest.json"))
        payload = b'{"dtype": "<f4", "shape": [1]}\n' + buffer.getvalue()
        manifest["entries"]["track0/colors"] = hashlib.sha256(payload).hexdigest()
        data = json.dumps(manifest).encode()
        new.writestr("track0/colors", payload)
        new.writestr("manifest.json", data)
        new.comment = hashlib.sha256(data).hexdigest().encode()
    with open_asset(evil) as video, pytest.raises(AssetError):
        _ = video.records


def test_rendering_needs_the_very_clip_it_was_made_from(asset: Path, source: Path, tmp_path: Path) -> None:
    with open_asset(asset, source) as video:
        assert video.require_source() == source
    other = tmp_path / "other.bin"
    other.write_bytes(b"another clip")
    with open_asset(asset, other) as video, pytest.raises(AssetError, match="not the clip"):
        video.require_source()
    with open_asset(asset, find_source=False) as video, pytest.raises(AssetError, match="without its source"):
        video.require_source()
    with open_asset(asset, tmp_path / "gone") as video, pytest.raises(AssetError, match="missing"):
        video.require_source()


@pytest.mark.filterwarnings(_OF_FORKS)
def test_a_temporary_asset_goes_with_its_object(asset: Path) -> None:
    video = VectorVideo(asset, temporary=True)
    saved = asset.with_name("saved.pvg")
    video.save(saved)
    video.close()
    assert not asset.exists()
    everything(saved)


def test_a_temporary_asset_goes_with_the_process_though_something_refers_to_its_object(asset: Path) -> None:
    code = f"import sys, pvg.asset; sys.kept = pvg.asset.VectorVideo({os.fspath(asset)!r}, temporary=True)"
    subprocess.run([sys.executable, "-c", code], check=True)
    assert not asset.exists()


def test_a_copy_may_have_the_longest_name(asset: Path) -> None:
    saved = asset.with_name("x" * 251 + ".pvg")
    with open_asset(asset) as video:
        video.save(saved)
    everything(saved)


def test_faces_are_chosen_by_number(asset: Path) -> None:
    with open_asset(asset) as video:
        assert faces_by_index(video, "all") == (0,)
        assert faces_by_index(video, [0]) == (0,)
        with pytest.raises(ValueError, match="no face 3"):
            faces_by_index(video, [3])


def test_no_file_is_a_clear_error(tmp_path: Path) -> None:
    with pytest.raises(AssetError, match="no asset file"):
        open_asset(tmp_path / "none.pvg")
    text = tmp_path / "text.pvg"
    text.write_text("hello")
    with pytest.raises(AssetError, match="not an asset"):
        open_asset(text)


def test_faces_of_a_person_stand_together_the_longest_first(tmp_path: Path, source: Path) -> None:
    path = tmp_path / "clip.pvg"
    spans = ((0, 4, 0), (0, 9, 1), (10, 29, 0), (30, 39, 0))
    with AssetWriter(path) as writer:
        for face, (first, last, person) in enumerate(spans):
            for i in range(first, last + 1):
                writer.add_frame(face, frame_arrays(i))
            writer.add_face(FaceRecord(FaceSummary(face, first, last, 150.0, (200, 150, 120), person), (key_frame(),)))
        writer.finish(manifest_of(source, 40))
    with open_asset(path) as video:
        assert video.persons == ((2, 3, 0), (1,))
        assert [face["person"] for face in video.summary()["faces"]] == [0, 1, 0, 0]


def test_colours_go_over_from_key_frame_to_key_frame(source: Path, tmp_path: Path) -> None:
    first = key_frame()
    second = replace(first, frame=40, colors=first.colors + 8, since=30)
    third = replace(first, frame=60, colors=first.colors + 16)
    with AssetWriter(tmp_path / "keys.pvg") as writer:
        for i in range(FRAMES):
            writer.add_frame(0, frame_arrays(i))
        writer.add_face(FaceRecord(SUMMARY, (first, second, third)))
        writer.finish(manifest_of(source, FIRST + FRAMES))
    with open_asset(tmp_path / "keys.pvg") as video:
        (record,) = video.records
        assert [key.since for key in record.key_frames] == [None, 30, None]
        assert record.keys_at(0) == record.keys_at(30) == (0, 0, 0.0)
        assert record.keys_at(35) == (0, 1, 0.5)
        assert record.keys_at(40) == record.keys_at(59) == (1, 1, 0.0)
        assert record.keys_at(60) == record.keys_at(70) == (2, 2, 0.0)
        tables = [key.colors for key in record.key_frames]
        added = [float(np.mean(record.blended(tables, f) - first.colors)) for f in range(71)]
        np.testing.assert_allclose(added[30:41], 0.8 * np.arange(11), atol=1e-3)
        served = np.zeros(3)
        for first_key, second_key, share in map(record.keys_at, range(FIRST, FIRST + FRAMES)):
            served[first_key] += 1.0 - share
            served[second_key] += share
        np.testing.assert_allclose(record.served(), served, atol=1e-9)


@pytest.mark.parametrize(("haze", "warmth"), [(0, 0), (70, 31)])
def test_a_face_keeps_the_haze_and_the_warmth_that_it_was_seen_in(
    source: Path, tmp_path: Path, haze: int, warmth: int
) -> None:
    with AssetWriter(tmp_path / "clip.pvg") as writer:
        for i in range(FRAMES):
            writer.add_frame(0, frame_arrays(i))
        writer.add_face(FaceRecord(SUMMARY, (key_frame(),), haze, warmth))
        writer.finish(manifest_of(source, FIRST + FRAMES))
    with open_asset(tmp_path / "clip.pvg") as video:
        assert [(record.haze, record.warmth) for record in video.records] == [(haze, warmth)]


def test_an_asset_of_before_there_was_word_of_haze_and_warmth_has_neither(asset: Path, tmp_path: Path) -> None:
    with open_asset(asset) as video:
        manifest = dict(video.manifest)
    faces = [
        {name: value for name, value in face.items() if name not in {"haze", "warmth"}} for face in manifest["faces"]
    ]
    older = Path(shutil.copy(asset, tmp_path / "older.pvg"))
    replace_manifest(older, {**manifest, "faces": faces})
    with open_asset(older) as video:
        assert [(record.haze, record.warmth) for record in video.records] == [(0, 0)]
