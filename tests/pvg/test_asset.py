from __future__ import annotations

import json
import zipfile
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
    KeyFrame,
    VectorVideo,
    faces_by_index,
    open_asset,
)
from pvg.curves.labels import BOUNDARY_SAMPLES, boundary_points, table_labels
from pvg.errors import AssetError
from pvg.video import sha256_file

FRAMES = CHUNK_FRAMES * 2 + 5
FIRST = 3


def frame_arrays(i: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(i)
    matte = np.zeros((60, 50), np.uint8)
    matte[10:50, 8:42] = rng.integers(200, 256)
    return {
        "points": (rng.uniform(50, 200, (106, 2)) + i).astype(np.float32),
        "skin_points": rng.uniform(50, 200, (88, 2)).astype(np.float32),
        "radius": rng.uniform(40, 90, BOUNDARY_SAMPLES).astype(np.float32),
        "score": np.array([0.5 + 0.4 * np.sin(i)], np.float32),
        "pose": rng.uniform(-20, 20, 3).astype(np.float32),
        "box": np.array([10 + i, 20, 230 + i, 284], np.float32),
        "matte": matte,
    }


def key_frame() -> KeyFrame:
    rng = np.random.default_rng(99)
    colors = rng.uniform(0, 255, (len(table_labels()), 3)).astype(np.float32)
    return KeyFrame(FIRST, colors, rng.random(len(colors)) > 0.1, rng.uniform(0, 255, (64, 3)).astype(np.float32))


def manifest_of(source: Path, frame_count: int, shots: tuple[int, ...] = (0,)) -> dict[str, object]:
    media = {"kind": "video", "width": 320, "height": 240, "frame_rate": 25.0, "duration_s": 3.0}
    media |= {"frame_count": frame_count, "has_audio": False, "rotation": 0}
    media |= {"codec": "h264", "pixel_format": "yuv420p"}
    return {
        "vectorizer": "test",
        "settings": {"mask": "landmarks", "matching": "table", "reference": False},
        "source_name": source.name,
        "source_sha256": sha256_file(source),
        "media": media,
        "shots": list(shots),
    }


@pytest.fixture
def source(tmp_path: Path) -> Path:
    path = tmp_path / "clip.bin"
    path.write_bytes(b"the clip")
    return path


@pytest.fixture
def asset(tmp_path: Path, source: Path) -> Path:
    path = tmp_path / "clip.pvg"
    with AssetWriter(path) as writer:
        for i in range(FRAMES):
            writer.add_frame(0, frame_arrays(i))
        summary = FaceSummary(0, FIRST, FIRST + FRAMES - 1, 150.0, (200, 150, 120), 0, ("small",))
        writer.add_face(FaceRecord(summary, (key_frame(),)))
        writer.finish(manifest_of(source, FIRST + FRAMES, shots=(0, 40)))
    return path


def test_round_trip_keeps_every_array_to_its_stated_precision(asset: Path, source: Path) -> None:
    with open_asset(asset, source) as video:
        assert video.frame_count == FIRST + FRAMES
        assert video.shots == (0, 40)
        assert video.faces == (FaceSummary(0, FIRST, FIRST + FRAMES - 1, 150.0, (200, 150, 120), 0, ("small",)),)
        for i in (0, 1, CHUNK_FRAMES - 1, CHUNK_FRAMES, FRAMES - 1, 7):  # forwards and back, across chunks
            want, data = frame_arrays(i), video.face_frame(0, FIRST + i)
            assert data is not None
            assert np.abs(data.points - want["points"]).max() <= 1 / 64
            assert np.abs(data.skin_points - want["skin_points"]).max() <= 1 / 64
            assert data.score == want["score"][0]
            np.testing.assert_array_equal(data.pose, want["pose"])
            np.testing.assert_array_equal(data.box, want["box"])
            assert np.abs(data.matte.astype(int) - want["matte"]).max() <= 2
            np.testing.assert_array_equal(data.matte == 0, want["matte"] == 0)
            assert np.abs(data.boundary - boundary_points(want["radius"], want["points"])).max() < 0.15
        assert video.face_frame(0, FIRST - 1) is None
        assert video.face_frame(0, FIRST + FRAMES) is None
        key = video.records[0].key_frame_of(50)
        np.testing.assert_array_equal(key.colors, key_frame().colors)
        np.testing.assert_array_equal(key.visible, key_frame().visible)
        np.testing.assert_array_equal(key.skin, key_frame().skin)
        landmarks = video.landmarks(0)
        assert landmarks.shape == (FRAMES, 106, 2)
        assert landmarks.dtype == np.float32
        json.dumps(video.summary())
        video.verify()


def test_fixed_point_errors_do_not_accumulate_over_frames(asset: Path) -> None:
    with open_asset(asset) as video:
        errors = [np.abs(video.landmarks(0)[i] - frame_arrays(i)["points"]).max() for i in range(FRAMES)]
    assert max(errors) <= 1 / 64


def everything(path: Path) -> bytes:
    with open_asset(path) as video:
        video.verify()
        parts = [video.face_frame(0, i) for i in range(FIRST, FIRST + FRAMES)]
        body = b"".join(p.points.tobytes() + p.matte.tobytes() + p.boundary.tobytes() for p in parts if p)
        return body + json.dumps(video.summary()).encode() + video.records[0].key_frames[0].colors.tobytes()


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
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


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(part=st.floats(0, 0.999))
def test_a_truncated_asset_is_refused(asset: Path, tmp_path: Path, part: float) -> None:
    body = asset.read_bytes()
    cut = tmp_path / "cut.pvg"
    cut.write_bytes(body[: int(part * len(body))])
    with pytest.raises(AssetError):
        open_asset(cut)


def test_another_format_version_is_refused_by_name(asset: Path, tmp_path: Path) -> None:
    import hashlib

    newer = tmp_path / "newer.pvg"
    with zipfile.ZipFile(asset) as old, zipfile.ZipFile(newer, "w") as new:
        manifest = json.loads(old.read("manifest.json"))
        manifest["format"] = 999
        data = json.dumps(manifest).encode()
        new.writestr("manifest.json", data)
        new.comment = hashlib.sha256(data).hexdigest().encode()
    with pytest.raises(AssetError, match="format 999"):
        open_asset(newer)


def test_loading_never_unpickles(asset: Path, tmp_path: Path) -> None:
    """A pickled array with matching digests is still refused."""
    import hashlib
    import io

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


def test_an_aborted_writer_leaves_nothing_behind(tmp_path: Path) -> None:
    def abort() -> None:
        with AssetWriter(tmp_path / "never.pvg") as writer:
            writer.add_frame(0, frame_arrays(0))
            raise RuntimeError

    with pytest.raises(RuntimeError):
        abort()
    assert list(tmp_path.iterdir()) == []


def test_a_temporary_asset_goes_with_its_object(asset: Path) -> None:
    video = VectorVideo(asset, temporary=True)
    saved = asset.with_name("saved.pvg")
    video.save(saved)
    video.close()
    assert not asset.exists()
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


def test_faces_keep_their_frames_whatever_number_their_tracks_were_written_under(tmp_path: Path, source: Path) -> None:
    path = tmp_path / "clip.pvg"
    with AssetWriter(path) as writer:
        for track in (7, 2):
            for i in range(5):
                writer.add_frame(track, frame_arrays(100 * track + i))
        for face, track in enumerate((2, 7)):
            summary = FaceSummary(face, 0, 4, 150.0, (200, 150, 120), face)
            writer.add_face(FaceRecord(summary, (key_frame(),)), track)
        writer.finish(manifest_of(source, 5))
    with open_asset(path) as video:
        for face, track in enumerate((2, 7)):
            data = video.face_frame(face, 3)
            assert data is not None
            assert np.abs(data.points - frame_arrays(100 * track + 3)["points"]).max() <= 1 / 64
            assert np.abs(video.landmarks(face)[3] - data.points).max() == 0
