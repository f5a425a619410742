from __future__ import annotations

import os
import shutil
import tempfile
import threading
import time
import tracemalloc
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
import pytest

import pvg
from benchmarks.quality.lossless import write_lossless
from pvg.face import layout
from pvg.landmarks import FaceTrack
from pvg.vectorization.following import Following
from pvg.video import read_image, write_image
from scripts.samples import Samples
from tests.folders import permissions, umask_of
from tests.gallery.clips import cut_clip, encode_raw, libav_frame
from tests.gallery.faces import fit_widest, read_rgb
from tests.gallery.scenes import resting_face


@pytest.fixture(scope="module")
def brief_clip(samples: Samples, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """12 frames of a woman who smiles."""
    return cut_clip(samples.woman_clip, tmp_path_factory.mktemp("clips") / "brief.mp4", 0, 12)


@pytest.mark.parametrize("size", [(1280, 224), (224, 1280), (68, 68)])
def test_clips_of_any_shape_are_vectorized_and_drawn(samples: Samples, tmp_path: Path, size: tuple[int, int]) -> None:
    """Three screens side by side, a banner, a thumbnail."""
    width, height = size
    side = min(size)
    face = cv2.resize(resting_face(samples).rgb, (side, side), interpolation=cv2.INTER_AREA)
    rgb = np.full((height, width, 3), 90, np.uint8)
    y, x = (height - side) // 2, (width - side) // 2
    rgb[y : y + side, x : x + side] = face
    clip = tmp_path / "clip.mp4"
    write_lossless(clip, (np.roll(rgb, k, axis=1) for k in range(3)))
    with pvg.vectorize(clip, min_face_px=16) as video:
        pvg.render(video, [pvg.transfer(video, video)], [tmp_path / "out.mp4"])
        assert [video.face_at(0, k) is not None for k in range(3)] == [True] * 3
    assert pvg.video.probe(tmp_path / "out.mp4").frame_count == 3


@pytest.mark.parametrize(
    ("failing", "reference"),
    [
        ("pvg.landmarks.tracking.FaceTracker.step", True),
        ("pvg.vectorization.best_row._evenness", True),
        ("pvg.vectorization.following.SceneReader.step", False),
        ("pvg.vectorization.whole_clip._late_key", False),
    ],
)
def test_no_thread_outlives_what_fails_beside_the_reading(
    brief_clip: Path, monkeypatch: pytest.MonkeyPatch, failing: str, reference: bool
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise MemoryError

    monkeypatch.setattr(Following, "_key_view", lambda *_, **__: None)  # so that a clip is read a second time
    monkeypatch.setattr(failing, fail)
    before = set(threading.enumerate())
    with pytest.raises(MemoryError) as failure:
        pvg.vectorize(brief_clip, reference=reference)
    assert set(threading.enumerate()) <= before
    assert failure.tb is not None  # it holds on to all that was in use


def test_every_frame_of_the_clip_has_its_face(video: pvg.VectorVideo) -> None:
    assert video.frame_count == 40
    (face,) = video.faces
    assert (face.first_frame, face.last_frame) == (0, 39)
    assert 120 < face.width_px < 260
    for index in range(40):
        data = video.face_at(0, index)
        assert data is not None
        assert data.score > 0.5
        assert 0.2 < (data.matte.alpha > 127).mean() < 0.8
        contour, box = data.landmarks.points[layout.CONTOUR], data.matte.raster.box
        assert (box[:2] < contour.min(axis=0)).all()
        assert (box[2:] > contour.max(axis=0)).all()


def test_the_same_clip_gives_the_same_bytes_in_the_same_folder_and_progress_counts_every_frame_once(
    short_clip: Path, video: pvg.VectorVideo
) -> None:
    """An asset notes where its clip lies, relative to itself."""
    seen: list[tuple[str, int, int]] = []
    asset = video.path.with_name("again.pvg")
    with pvg.vectorize(short_clip, asset=asset, progress=lambda *report: seen.append(report)) as again:
        assert again.path.read_bytes() == video.path.read_bytes()
    assert seen == [("vectorize", done, 40) for done in range(1, 41)]


def test_opencv_has_one_thread_while_a_clip_is_vectorised_and_its_own_afterwards(brief_clip: Path) -> None:
    before, seen = cv2.getNumThreads(), set()
    cv2.setNumThreads(3)
    try:
        with pvg.vectorize(brief_clip, progress=lambda *_: seen.add(cv2.getNumThreads())):
            assert (seen, cv2.getNumThreads()) == ({1}, 3)
    finally:
        cv2.setNumThreads(before)


def test_a_second_reading_gives_what_one_does(
    short_clip: Path, video: pvg.VectorVideo, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Tracks without a good view in time are followed again with the whole course known."""
    from pvg.vectorization import following

    chunk, lookahead, deferred = following.CHUNK, following.LOOKAHEAD, following.Following.deferred

    def usual_from_here(self: following.Following) -> tuple[tuple[following.DeferredTrack, ...], float]:
        monkeypatch.setattr(following, "CHUNK", chunk)
        monkeypatch.setattr(following, "LOOKAHEAD", lookahead)
        return deferred(self)

    never = lambda track: np.zeros(len(track.score), np.bool_)  # noqa: E731
    monkeypatch.setattr(following, "good_rows", never)
    monkeypatch.setattr(following, "CHUNK", 4)
    monkeypatch.setattr(following, "LOOKAHEAD", 4)
    monkeypatch.setattr(following.Following, "deferred", usual_from_here)
    stages: list[str] = []
    with pvg.vectorize(short_clip, progress=lambda stage, done, total: stages.append(stage)) as again:
        assert stages.count("second reading") == 40
        assert [(face.first_frame, face.last_frame) for face in again.faces] == [(0, 39)]
        for index in range(40):
            one, two = again.face_at(0, index), video.face_at(0, index)
            assert one is not None
            assert two is not None
            np.testing.assert_allclose(one.landmarks.points, two.landmarks.points, atol=1 / 16)
            assert np.abs(one.matte.alpha.astype(int) - two.matte.alpha).mean() < 1


def test_a_cut_more_takes_no_more_memory(samples: Samples, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a track that ended only what tells its person and its colours is left."""
    import pvg.vectorization.clip

    held: list[tuple[int, int]] = []

    def link(faces: list[Any], skin_rgb: Any) -> tuple[int, ...]:
        held.append((len(faces), tracemalloc.get_traced_memory()[0]))
        return tuple(range(len(faces)))

    monkeypatch.setattr(pvg.vectorization.clip, "link_persons", link)
    portraits = [read_rgb(path) for path in (samples.dark_portrait, samples.pale_portrait)]
    shots = [libav_frame(cv2.resize(rgb, (320, 400), interpolation=cv2.INTER_AREA)) for rgb in portraits]
    for count in (2, 3, 6):  # the first one makes what is made once
        frames = [shots[shot % 2] for shot in range(count) for _ in range(5)]
        clip = encode_raw(tmp_path / f"{count}.mp4", frames, "libx264")
        tracemalloc.start()
        try:
            pvg.vectorize(clip).close()
        finally:
            tracemalloc.stop()
    _, (few, least), (many, most) = held
    assert (few, many) == (3, 6)
    assert most - least < (many - few) * 200_000


def test_a_second_reading_knows_the_people_of_the_first(
    samples: Samples, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A person who is followed later takes no more of the others' skin than one who is followed with them."""
    import pvg.vectorization.following

    rgb = read_rgb(samples.several_faces)
    write_lossless(tmp_path / "clip.mp4", (rgb[: len(rgb) // 2 * 2, : rgb.shape[1] // 2 * 2] for _ in range(10)))
    good = pvg.vectorization.following.good_rows
    for name in ("CHUNK", "LOOKAHEAD"):
        monkeypatch.setattr(pvg.vectorization.following, name, 4)
    with pvg.vectorize(tmp_path / "clip.mp4") as together:
        late = max(together.faces, key=lambda face: face.width_px).index
        one = together.face_at(late, 5)
        assert one is not None
        x = float(one.landmarks.points[:, 0].mean())

        def all_but_one(track: FaceTrack) -> np.ndarray:
            here = abs(float(track.landmarks.points[0, :, 0].mean()) - x) < 20
            return np.zeros(len(track.score), np.bool_) if here else good(track)

        monkeypatch.setattr(pvg.vectorization.following, "good_rows", all_but_one)
        stages: list[str] = []
        with pvg.vectorize(tmp_path / "clip.mp4", progress=lambda stage, *_: stages.append(stage)) as apart:
            assert "second reading" in stages
            assert [face.width_px for face in apart.faces] == [face.width_px for face in together.faces]
            two = apart.face_at(late, 5)
            assert two is not None
            ours, theirs = (face.body.alpha.astype(float).sum() / 255 for face in (one, two))
            assert ours > 10
            assert theirs == pytest.approx(ours, rel=0.1)


def test_an_error_in_mid_clip_ends_all_threads(short_clip: Path, tmp_path: Path) -> None:
    damaged, data = tmp_path / "damaged.mp4", bytearray(short_clip.read_bytes())
    start = data.index(b"mdat")
    size = int.from_bytes(data[start - 4 : start], "big")
    low, high = start + size * 6 // 10, start + size * 8 // 10
    data[low:high] = b"\xff" * (high - low)
    damaged.write_bytes(data)
    before = set(threading.enumerate())
    with pytest.raises(pvg.MediaError):
        pvg.vectorize(damaged, asset=tmp_path / "damaged.pvg")
    assert set(threading.enumerate()) <= before  # others of this process may end too
    assert [path.name for path in tmp_path.iterdir()] == ["damaged.mp4"]


def test_an_abort_waits_for_what_was_begun_of_a_face_and_begins_no_more(
    brief_clip: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from pvg.vectorization import vector_face

    class CanceledError(Exception):
        pass

    def cancel(stage: str, done: int, total: int) -> None:
        raise CanceledError

    def slowly(*of_a_row: Any) -> np.ndarray:
        begun.append(1)
        time.sleep(0.2)
        ended.append(1)
        return alpha(*of_a_row)

    begun, ended, alpha = [], [], vector_face.VectorFace._body_alpha
    monkeypatch.setattr(vector_face.VectorFace, "_body_alpha", slowly)
    before = set(threading.enumerate())
    with pytest.raises(CanceledError):
        pvg.vectorize(brief_clip, progress=cancel)
    assert set(threading.enumerate()) <= before
    assert len(begun) == len(ended) < 12


def test_an_abort_leaves_no_asset(brief_clip: Path, tmp_path: Path) -> None:
    class CanceledError(Exception):
        pass

    def cancel(stage: str, done: int, total: int) -> None:
        if stage == "vectorize" and done == 4:
            raise CanceledError

    with pytest.raises(CanceledError):
        pvg.vectorize(brief_clip, asset=tmp_path / "out.pvg", progress=cancel)
    assert list(tmp_path.iterdir()) == []


def test_a_temporary_asset_is_for_its_user_alone_from_its_first_byte_on(
    brief_clip: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    met = set[int]()

    def note(stage: str, done: int, total: int) -> None:
        met.update(permissions(path) for path in tmp_path.iterdir())

    with umask_of(0o022), pvg.vectorize(brief_clip, progress=note) as video:
        note("", 0, 0)
        assert video.path.parent == tmp_path
    assert met == {0o600}
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("end", ["landmarks", "best frame"])
def test_what_progress_raises_passes_through_whatever_it_is(end: str, brief_clip: Path) -> None:
    def enough(stage: str, done: int, total: int) -> None:
        if (stage, done) == (end, 2):
            raise StopIteration(stage)

    with pytest.raises(StopIteration, match=end):
        pvg.vectorize(brief_clip, reference=True, progress=enough)


@pytest.mark.parametrize(
    "options",
    [
        {"mask": "landmark"},
        {"mask": None},
        {"matching": "x"},
        {"reference": "yes"},
        {"strict": 1},
        {"input_color": "slog2"},
        {"seed": -1},
        {"seed": "0"},
        {"min_face_px": float("nan")},
        {"min_face_px": "64"},
        {"advised_face_px": -1},
    ],
)
def test_an_option_that_does_not_fit_is_refused_before_the_first_frame(
    options: dict[str, object], brief_clip: Path, tmp_path: Path
) -> None:
    asset = tmp_path / "good.pvg"
    asset.write_bytes(b"of before")
    seen: list[object] = []
    with pytest.raises(ValueError, match=f"^{next(iter(options))} must be"):
        pvg.vectorize(brief_clip, asset=asset, progress=lambda *report: seen.append(report), **options)  # type: ignore[arg-type]
    assert seen == []
    assert asset.read_bytes() == b"of before"


def test_an_asset_that_cannot_be_written_is_told_before_the_first_frame(brief_clip: Path, tmp_path: Path) -> None:
    own = tmp_path / "own.mp4"
    own.write_bytes(brief_clip.read_bytes())
    (tmp_path / "folder").mkdir()

    def never(*_: object) -> None:
        raise AssertionError

    for asset, error, words in (
        (own, ValueError, "own.mp4 would be replaced while it is read"),
        (tmp_path / "folder" / ".." / "own.mp4", ValueError, "would be replaced"),
        (tmp_path / "folder", IsADirectoryError, "folder"),
        (tmp_path / "none" / "o.pvg", FileNotFoundError, "none"),
    ):
        with pytest.raises(error, match=words):
            pvg.vectorize(own, asset=asset, progress=never)
    assert own.read_bytes() == brief_clip.read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["folder", "own.mp4"]


def test_a_reference_keeps_only_its_key_frame(brief_clip: Path) -> None:
    with pvg.vectorize(brief_clip, reference=True) as reference:
        (face,) = reference.faces
        assert face.first_frame == face.last_frame == reference.records[0].key_frames[0].frame
        assert reference.path.stat().st_size < 60_000


def test_a_reference_whose_face_comes_near_late_is_taken(
    samples: Samples, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After the frames that are usually enough, here 30."""
    import pvg.vectorization.references

    monkeypatch.setattr(pvg.vectorization.references, "_REFERENCE_FRAMES", 30)
    near = resting_face(samples).rgb
    far = cv2.copyMakeBorder(cv2.resize(near, None, fx=0.2, fy=0.2), *[(4 * len(near)) // 10] * 4, cv2.BORDER_REPLICATE)
    far = cv2.resize(far, near.shape[1::-1], interpolation=cv2.INTER_AREA)
    write_lossless(tmp_path / "clip.mp4", (near if k >= 30 else far for k in range(38)))
    with pvg.vectorize(tmp_path / "clip.mp4", reference=True) as reference:
        (face,) = reference.faces
        assert face.first_frame >= 30
        assert face.width_px > 100


def test_a_reference_picture_keeps_all_its_faces(samples: Samples, group: pvg.VectorVideo) -> None:
    with pvg.vectorize(samples.several_faces, reference=True) as reference:
        assert reference.faces == group.faces
        assert len(reference.faces) == 5
        for one, other in zip(reference.records, group.records, strict=True):
            np.testing.assert_array_equal(one.key_frames[0].colors, other.key_frames[0].colors)
            np.testing.assert_array_equal(one.key_frames[0].skin, other.key_frames[0].skin)


def test_a_reference_picture_keeps_the_faces_that_are_wide_enough(samples: Samples, group: pvg.VectorVideo) -> None:
    widths = sorted(face.width_px for face in group.faces)
    with pvg.vectorize(samples.several_faces, reference=True, min_face_px=95, advised_face_px=98) as reference:
        assert sorted(face.width_px for face in reference.faces) == [width for width in widths if width >= 95]
        assert [bool(face.warnings) for face in reference.faces] == [face.width_px < 98 for face in reference.faces]
        assert [face.index for face in reference.faces] == list(range(len(reference.faces)))


def test_no_face_is_an_error_that_says_where(samples: Samples, tmp_path: Path) -> None:
    clip = cut_clip(samples.no_face_clip, tmp_path / "no_face.mp4", 0, 8)
    with pytest.raises(pvg.NoFaceError, match=r"no face found in any of 8 frames of no_face.mp4"):
        pvg.vectorize(clip)


def test_a_small_face_is_refused_and_a_smallish_one_warned_of(samples: Samples, tmp_path: Path) -> None:
    rgb = read_image(samples.portrait).rgb()
    width = np.ptp(fit_widest(rgb).points[layout.CONTOUR, 0])
    sizes = {"tiny.png": 50.0, "smallish.png": 120.0}
    for name, target in sizes.items():
        scale = target / width
        size = (round(rgb.shape[1] * scale), round(rgb.shape[0] * scale))
        write_image(tmp_path / name, np.asarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA), np.uint8))
    with pytest.raises(pvg.FaceTooSmallError, match=r"4\d|5\d px wide; it must be at least 64 px"):
        pvg.vectorize(tmp_path / "tiny.png")
    with pvg.vectorize(tmp_path / "smallish.png") as image:
        assert "200 px or more is advised" in image.faces[0].warnings[0]


def test_what_is_no_media_is_refused(tmp_path: Path) -> None:
    text = tmp_path / "clip.mp4"
    text.write_text("not a clip")
    with pytest.raises(pvg.MediaError):
        pvg.vectorize(text, asset=tmp_path / "clip.pvg")
    assert not (tmp_path / "clip.pvg").exists()


@pytest.mark.parametrize("change", ["replaced", "longer", "written again"])
@pytest.mark.parametrize("reference", [False, True])
def test_a_file_that_changes_while_it_is_read_is_refused(
    samples: Samples, brief_clip: Path, tmp_path: Path, change: str, reference: bool
) -> None:
    path = tmp_path / "clip"
    shutil.copy(samples.woman_clip if reference else brief_clip, path)
    state = path.stat()
    other = tmp_path / "other"
    shutil.copy(brief_clip if reference else samples.woman_clip, other)

    def meddle(stage: str, done: int, total: int) -> None:
        if done != total or not other.exists():
            return
        if change == "replaced":
            other.replace(path)  # what is open is read to its end
            return
        if change == "longer":
            with path.open("ab") as file:
                file.write(bytes(16))
        os.utime(path, ns=(state.st_atime_ns, state.st_mtime_ns + (change == "written again")))
        other.unlink()

    with pytest.raises(pvg.MediaError, match="clip was changed while it was read"):
        pvg.vectorize(path, asset=tmp_path / "clip.pvg", reference=reference, progress=meddle)
    assert list(tmp_path.iterdir()) == [path]


def test_a_face_that_leaves_ends_its_track(samples: Samples, tmp_path: Path) -> None:
    leaving = cut_clip(samples.face_noface_clip, tmp_path / "leaving.mp4", 48, 80)
    with pvg.vectorize(leaving) as clip:
        assert clip.faces[0].first_frame == 0
        assert 16 < clip.faces[0].last_frame < clip.frame_count - 1
        assert clip.face_at(0, clip.frame_count - 1) is None


def test_the_papers_mask_is_a_setting(samples: Samples) -> None:
    with pvg.vectorize(samples.portrait, mask="ycbcr") as image:
        assert image.settings["mask"] == "ycbcr"
        data = image.face_at(0, 0)
        assert data is not None
        assert set(np.unique(data.matte.alpha)) <= {0, 255}


def grey(rgb: np.ndarray) -> np.ndarray:
    return np.repeat(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)[..., None], 3, axis=2)


def written(path: Path, rgb: np.ndarray) -> Path:
    """A picture, or a clip of some frames of it."""
    if path.suffix == ".png":
        write_image(path, rgb)
    else:
        write_lossless(path, (rgb[: len(rgb) // 2 * 2, : rgb.shape[1] // 2 * 2] for _ in range(6)))
    return path


@pytest.mark.parametrize("name", ["grey.png", "grey.mp4"])
@pytest.mark.parametrize("reference", [False, True])
def test_faces_without_skin_by_the_mask_are_no_faces(
    samples: Samples, tmp_path: Path, name: str, reference: bool
) -> None:
    path = written(tmp_path / name, grey(read_rgb(samples.several_faces)))
    with pytest.raises(pvg.NoFaceError, match=rf"no skin found on any of \d faces? of {name}"):
        pvg.vectorize(path, mask="ycbcr", reference=reference)
    assert [one.name for one in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize("name", ["some.png", "some.mp4"])
@pytest.mark.parametrize("matching", ["table", "chain"])
def test_a_face_without_skin_by_the_mask_is_left_out_and_named(
    samples: Samples, tmp_path: Path, name: str, matching: Literal["table", "chain"]
) -> None:
    rgb = read_rgb(samples.several_faces)
    edge = 430  # what is left of it has no colour, and what has is far: a mask by colour takes hair too
    apart = np.full((len(rgb), 300, 3), 128, np.uint8)
    rgb = np.concatenate([grey(rgb[:, :edge]), apart, rgb[:, edge:]], axis=1)
    with pvg.vectorize(written(tmp_path / name, rgb), mask="ycbcr", matching=matching) as some:
        assert some.faces
        assert [face.index for face in some.faces] == list(range(len(some.faces)))
        for face in some.faces:
            assert some.landmarks(face.index)[0, :, 0].mean() > edge
        assert some.media.warnings
        assert all("no skin found on a face" in line for line in some.media.warnings)
        some.verify()


def test_asset_stays_within_its_budget(video: pvg.VectorVideo, short_clip: Path) -> None:
    """15 % of the source or 20 kB a 1080p frame, whichever is larger (scaled to this clip's pixels)."""
    pixels = video.media.width * video.media.height / (1920 * 1080)
    budget = max(0.15 * short_clip.stat().st_size, 20_000 * pixels * video.frame_count)
    assert video.path.stat().st_size <= budget
