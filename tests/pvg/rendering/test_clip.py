from __future__ import annotations

import ctypes
import inspect
import io
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pvg
from pvg.looks import LookOptions
from pvg.rendering import Renderer, render_part, source_frame
from pvg.video import (
    Frame,
    PictureMetadata,
    PixelFormat,
    VideoWriter,
    lost_in_picture,
    probe,
    read_frames,
    read_image,
    read_picture_metadata,
    write_image,
)
from scripts.samples import Samples
from tests.gallery.clips import cut_clip


def test_render_writes_every_look_with_the_clips_own_time_stamps(
    video: pvg.VectorVideo, dark_reference: pvg.VectorVideo, pale_reference: pvg.VectorVideo, tmp_path: Path
) -> None:
    looks = [pvg.transfer(video, reference) for reference in (dark_reference, pale_reference)]
    paths = [tmp_path / "dark.mp4", tmp_path / "pale.mp4"]
    seen: list[tuple[str, int, int]] = []
    pvg.render(video, looks, paths, crf=10, progress=lambda *report: seen.append(report))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["dark.mp4", "pale.mp4"]
    assert seen == [("render", i + 1, video.frame_count) for i in range(video.frame_count)]
    source = [frame.pts for frame in read_frames(video.require_source())]
    info = probe(video.require_source())
    for look, path in zip(looks, paths, strict=True):
        written = list(read_frames(path))
        assert probe(path).time_base == info.time_base
        assert [frame.pts for frame in written] == source
        error = written[20].rgb().astype(float) - pvg.render_frame(video, look, 20)
        assert np.abs(error).mean() < 2.0
    dark, pale = (next(iter(read_frames(path, start=20, stop=21))).rgb().astype(float) for path in paths)
    assert np.abs(dark - pale).mean() > 3.0


def test_an_aborted_render_leaves_no_file(
    video: pvg.VectorVideo, dark_reference: pvg.VectorVideo, tmp_path: Path
) -> None:
    class CanceledError(Exception):
        pass

    def cancel(stage: str, done: int, total: int) -> None:
        if done == 5:
            raise CanceledError

    with pytest.raises(CanceledError):
        pvg.render(video, [pvg.transfer(video, dark_reference)], [tmp_path / "out.mp4"], progress=cancel)
    assert list(tmp_path.iterdir()) == []


def test_two_looks_cannot_share_a_path(video: pvg.VectorVideo, dark_reference: pvg.VectorVideo, tmp_path: Path) -> None:
    look = pvg.transfer(video, dark_reference)
    with pytest.raises(ValueError, match="same path"):
        pvg.render(video, [look, look], [tmp_path / "a.mp4", tmp_path / "a.mp4"])
    with pytest.raises(ValueError, match="paths"):
        pvg.render(video, [look, look], [tmp_path / "a.mp4"])
    with pytest.raises(ValueError, match="paths must be a sequence, one for each look, not str"):
        pvg.render(video, [look], "a.mp4")
    with pytest.raises(ValueError, match="looks must be a sequence, one for each look, not Look"):
        pvg.render(video, look, [tmp_path / "a.mp4"])  # type: ignore[arg-type]


@pytest.mark.parametrize("path", [None, b"out.mp4", io.StringIO()])
def test_what_is_no_path_and_no_binary_stream_is_refused(
    path: object, video: pvg.VectorVideo, dark_reference: pvg.VectorVideo
) -> None:
    with pytest.raises(ValueError, match="each of paths must be a path or a binary stream, not "):
        pvg.render(video, [pvg.transfer(video, dark_reference)], [path])  # type: ignore[list-item]


@pytest.mark.parametrize("pictures", ["clip.nut", io.StringIO("YUV4MPEG2")])
def test_pictures_that_are_no_binary_stream_are_refused(
    video: pvg.VectorVideo, dark_reference: pvg.VectorVideo, tmp_path: Path, pictures: object
) -> None:
    look = pvg.transfer(video, dark_reference)
    with pytest.raises(ValueError, match="pictures must be a binary stream, not "):
        pvg.render(video, [look], [tmp_path / "out.mp4"], pictures=pictures)  # type: ignore[arg-type]


def keep_to_permissions() -> None:
    """From now on this thread writes where anybody may: root's otherwise does everywhere."""
    version_3, override, read_search = 0x2008_0522, 1 << 1, 1 << 2
    header = (ctypes.c_uint32 * 2)(version_3, 0)
    held = (ctypes.c_uint32 * 6)()
    libc = ctypes.CDLL(None)
    assert libc.capget(header, held) == 0
    for which in range(3):  # effective, permitted, inheritable
        held[which] &= ~(override | read_search)
    assert libc.capset(header, held) == 0


def never(*_: object) -> None:
    raise AssertionError("something was drawn")


@pytest.fixture
def own_clip(video: pvg.VectorVideo, tmp_path: Path) -> Iterator[pvg.VectorVideo]:
    """The short clip in a folder of its own, with its asset."""
    source, asset = tmp_path / "own.mp4", tmp_path / "own.pvg"
    source.write_bytes(video.require_source().read_bytes())
    asset.write_bytes(video.path.read_bytes())
    with pvg.open_asset(asset, source) as opened:
        yield opened


@pytest.mark.parametrize("given", [float("nan"), -5, 0, True, "1", None])
def test_memory_is_a_number_of_bytes(given: Any, video: pvg.VectorVideo, tmp_path: Path) -> None:
    looks = [pvg.transfer(video, video)]
    with pytest.raises(ValueError, match="memory_bytes must be a whole number from 1, not"):
        pvg.render(video, looks, [tmp_path / "o.mp4"], memory_bytes=given, progress=never)
    with pytest.raises(ValueError, match="memory_bytes must be a whole number from 1, not"):
        render_part(video, looks, [tmp_path / "o"], start=0, stop=2, container="mp4", memory_bytes=given)
    assert list(tmp_path.iterdir()) == []


def test_paths_are_looked_at_before_anything_is_drawn(
    own_clip: pvg.VectorVideo, dark_reference: pvg.VectorVideo, tmp_path: Path
) -> None:
    (tmp_path / "dir.mp4").mkdir()
    before = own_clip.require_source().read_bytes()
    look = pvg.transfer(own_clip, dark_reference)
    first, again = tmp_path / "q.mp4", tmp_path / "dir.mp4" / ".." / "q.mp4"
    (tmp_path / "link.mp4").symlink_to(own_clip.require_source())
    cases: list[tuple[list[Path], type[Exception], str]] = [
        ([first, tmp_path / "own.mp4"], ValueError, "own.mp4 would be replaced while it is read"),
        ([first, tmp_path / "link.mp4"], ValueError, "link.mp4 would be replaced while it is read"),
        ([first, again], ValueError, "same path"),
        ([first, tmp_path / "dir.mp4"], IsADirectoryError, "dir.mp4"),
        ([first, tmp_path / "none" / "x.mp4"], FileNotFoundError, "none"),
        ([first, tmp_path / "x.avi"], ValueError, "x.avi"),
        ([first, tmp_path / "a\0b.mp4"], ValueError, "has a NUL in it"),
    ]
    for paths, error, words in cases:
        with pytest.raises(error, match=words):
            pvg.render(own_clip, [look, look], paths, progress=never)
    (tmp_path / "sealed").mkdir(0o500)
    with ThreadPoolExecutor(1, initializer=keep_to_permissions) as own:
        done = own.submit(pvg.render, own_clip, [look], [tmp_path / "sealed" / "x.mp4"], progress=never)
        with pytest.raises(PermissionError, match="sealed"):
            done.result()
    assert own_clip.require_source().read_bytes() == before
    assert not first.exists()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"crf": 52}, "crf of H.264 is a whole number from 0 to 51, not 52"),
        ({"crf": -1}, "crf is a whole number from 0 to 63, not -1"),
        ({"crf": 18.5}, "crf is a whole number"),
        ({"crf": True, "codec": "vp9"}, "crf of VP9 is a whole number from 0 to 63"),
        ({"crf": "18"}, "crf is a whole number"),
        ({"preset": "quick"}, "preset is one of veryslow, slower"),
        ({"preset": 5}, "preset is one of"),
        ({"preset": "9", "codec": "vp9"}, "preset of VP9 is one of .* or 0 to 8"),
        ({"preset": "5", "codec": "h264"}, "preset of H.264 is one of"),
        ({"crf": 20, "codec": "prores"}, "ProRes 422 HQ has no crf"),
        ({"audio": "mp3"}, "audio must be one of copy, none"),
        ({"audio": None}, "audio must be one of"),
        ({"codec": "mpeg2"}, "codec 'mpeg2' is not one of"),
    ],
)
def test_how_to_encode_is_looked_at_before_anything_is_drawn(
    options: dict[str, object],
    words: str,
    video: pvg.VectorVideo,
    group: pvg.VectorVideo,
    dark_reference: pvg.VectorVideo,
    tmp_path: Path,
) -> None:
    suffix = ".mov" if options.get("codec") == "prores" else ".mp4"
    with pytest.raises(ValueError, match=words):
        pvg.render(video, [pvg.transfer(video, dark_reference)], [tmp_path / f"o{suffix}"], progress=never, **options)  # type: ignore[arg-type]
    if "H.264" not in words or "codec" in options:  # a picture has none of these, and they are wrong all the same
        with pytest.raises(ValueError, match=words):
            pvg.render(group, [pvg.transfer(group, dark_reference, faces=[0])], [tmp_path / "o.png"], **options)  # type: ignore[arg-type]
    assert list(tmp_path.iterdir()) == []


def test_a_picture_is_named_as_one(group: pvg.VectorVideo, dark_reference: pvg.VectorVideo, tmp_path: Path) -> None:
    look = pvg.transfer(group, dark_reference, faces=[0])
    with pytest.raises(ValueError, match=r"o\.gif: a picture is written as"):
        pvg.render(group, [look], [tmp_path / "o.gif"])
    with pytest.raises(ValueError, match="not named as jpg is"):
        pvg.render(group, [look], [tmp_path / "o.png"], container="jpg")
    pvg.render(group, [look], [tmp_path / "o.jpeg"], container="jpg")
    assert [path.name for path in tmp_path.iterdir()] == ["o.jpeg"]


def test_a_look_is_drawn_on_its_own_clip_alone(
    video: pvg.VectorVideo, group: pvg.VectorVideo, dark_reference: pvg.VectorVideo, tmp_path: Path
) -> None:
    of_group = pvg.transfer(group, dark_reference)
    with pytest.raises(ValueError, match="of another clip than"):
        pvg.render(video, [of_group], [tmp_path / "o.mp4"], progress=never)
    with pytest.raises(ValueError, match="of another clip than"):
        pvg.render_frame(video, of_group, 0)
    with pytest.raises(ValueError, match="of another clip than"):
        pvg.export(video, of_group, tmp_path / "suite", progress=never)
    unsaid = replace(of_group, source_sha256=None)
    with pytest.raises(ValueError, match="does not fit face 1"):
        pvg.render(video, [unsaid], [tmp_path / "o.mp4"], progress=never)
    own = pvg.transfer(video, dark_reference)
    other = replace(own, colors={0: np.concatenate([own.colors[0]] * 2)})  # of more key frames
    with pytest.raises(ValueError, match="does not fit face 0"):
        pvg.render(video, [own, other], [tmp_path / "o.mp4", tmp_path / "p.mp4"], progress=never)
    for face in (-1, 0, 1):  # of no key frames, where there is no such face, too
        none = pvg.Look({face: np.zeros((0, *own.colors[0].shape[1:]), np.float32)})
        with pytest.raises(ValueError, match=f"does not fit face {face}"):
            pvg.render_frame(video, none, 0)
    assert list(tmp_path.iterdir()) == []


def test_a_swap_writes_both_or_none(
    own_clip: pvg.VectorVideo, video: pvg.VectorVideo, group: pvg.VectorVideo, tmp_path: Path
) -> None:
    before, first = own_clip.require_source().read_bytes(), tmp_path / "w1.mp4"
    first.write_bytes(b"of before")
    for second, words in (
        (tmp_path / "w2.avi", "w2.avi"),
        (first, "same path"),
        (tmp_path / "own.mp4", "would be replaced"),
    ):
        with pytest.raises(ValueError, match=words):
            pvg.swap(own_clip, group, [first, second], progress=never)
    with pytest.raises(ValueError, match="would be replaced"):
        pvg.swap(group, own_clip, [tmp_path / "own.mp4", first], progress=never)

    def fail(*_: object) -> None:
        raise KeyboardInterrupt

    for one, other, paths in (
        (group, own_clip, [tmp_path / "w.png", first]),  # the picture is drawn by then
        (own_clip, group, [first, tmp_path / "w.png"]),
    ):
        with pytest.raises(KeyboardInterrupt):
            pvg.swap(one, other, paths, progress=fail)
    assert {path.name for path in tmp_path.iterdir()} == {"own.mp4", "own.pvg", "w1.mp4"}
    assert first.read_bytes() == b"of before"
    assert own_clip.require_source().read_bytes() == before


@pytest.mark.parametrize("index", [True, 1.0, "1", None])
def test_a_frame_has_a_whole_number(video: pvg.VectorVideo, index: Any) -> None:
    with pytest.raises(ValueError, match="index must be a whole number"):
        pvg.render_frame(video, None, index)


def test_clips_and_looks_say_in_short_what_they_are(video: pvg.VectorVideo) -> None:
    assert repr(video).startswith(f"<VectorVideo {video.path.name}: ")
    assert repr(pvg.transfer(video, video)) == f"<Look of {len(video.faces)} faces>"


def test_an_image_is_rendered_as_an_image(samples: Samples, dark_reference: pvg.VectorVideo, tmp_path: Path) -> None:
    with pvg.vectorize(samples.portrait) as image:
        assert image.media.kind == "image"
        look = pvg.transfer(image, dark_reference)
        told: list[tuple[str, int, int]] = []
        paths = [tmp_path / "out.png", *(tmp_path / f"{k}.jpg" for k in range(3))]
        pvg.render(image, [look] * 4, paths, progress=lambda *one: told.append(one))
        assert told == [("render", 1, 1)]
        (frame,) = read_frames(tmp_path / "out.png")
        np.testing.assert_array_equal(frame.rgb(), pvg.render_frame(image, look, 0))
        own = pvg.render_frame(image, pvg.transfer(image, image), 0)
        np.testing.assert_array_equal(own, pvg.render_frame(image, None, 0))


def test_a_swap_has_a_contrast_for_each_side(video: pvg.VectorVideo, samples: Samples, tmp_path: Path) -> None:
    with pvg.vectorize(samples.dark_portrait) as image:
        told: list[tuple[str, int, int]] = []
        paths = [tmp_path / "a.mp4", tmp_path / "b.png"]
        how = {"contrast": (0.8, 1.2), "preset": "ultrafast", "progress": lambda *one: told.append(one)}
        pvg.swap(video, image, paths, **how)  # type: ignore[arg-type]
        count = video.frame_count + 1
        assert told == [("render", done, count) for done in range(1, count + 1)]
        (drawn,) = read_frames(tmp_path / "b.png")
        expected = pvg.render_frame(image, pvg.transfer(image, video, contrast=1.2), 0)
        np.testing.assert_array_equal(drawn.rgb(), expected)


def test_a_swap_takes_the_options_of_a_look_and_of_an_output(group: pvg.VectorVideo) -> None:
    own, look, output = (inspect.signature(one).parameters for one in (pvg.swap, pvg.transfer, pvg.render))
    of_looks = {name for name, one in look.items() if one.kind is one.KEYWORD_ONLY}
    assert LookOptions.__annotations__.keys() == of_looks - {"contrast", "faces", "reference_face"}
    of_outputs = {name: one.default for name, one in output.items() if one.kind is one.KEYWORD_ONLY}
    del of_outputs["pictures"]
    assert {name: own[name].default for name in of_outputs} == of_outputs
    assert all(name in (pvg.swap.__doc__ or "") for name in {*of_looks, *of_outputs})
    for unknown in ("strenght", "pictures"):
        with pytest.raises(TypeError, match=f"unexpected keyword argument '{unknown}'"):
            pvg.swap(group, paths="never.png", faces=(0, 1), **{unknown: 1})  # type: ignore[arg-type]


def test_a_swap_within_one_clip_exchanges_two_faces_and_leaves_the_others(
    group: pvg.VectorVideo, tmp_path: Path
) -> None:
    pvg.swap(group, paths=tmp_path / "swapped.png", faces=(1, 4), contrast=(0.8, "auto"))
    (swapped,) = read_frames(tmp_path / "swapped.png")
    look = pvg.exchange(group, (1, 4), contrast=(0.8, "auto"))
    np.testing.assert_array_equal(swapped.rgb(), pvg.render_frame(group, look, 0))
    changed = (swapped.rgb() != pvg.render_frame(group, None, 0)).any(axis=2)
    for face in group.faces:
        found = group.face_at(face.index, 0)
        assert found is not None
        x, y = found.landmarks.points.mean(axis=0).astype(int)
        share = changed[y - 20 : y + 20, x - 20 : x + 20].mean()
        assert share > 0.9 if face.index in (1, 4) else share == 0


def test_one_look_of_two_faces_draws_what_two_looks_do(group: pvg.VectorVideo) -> None:
    """Also where one λ is a number and the other the map."""
    one = pvg.transfer(group, group, faces=[1], reference_face=4, contrast=0.8)
    two = pvg.transfer(group, group, faces=[4], reference_face=1)
    plain, first, second, both = (
        pvg.render_frame(group, look, 0).astype(int) for look in (None, one, two, one.merged(two))
    )
    np.testing.assert_array_equal(both, first + second - plain)
    assert np.abs(both - plain).max() > 20


def test_a_clip_is_not_swapped_with_itself(video: pvg.VectorVideo, group: pvg.VectorVideo, tmp_path: Path) -> None:
    out = tmp_path / "out.png"
    with pytest.raises(ValueError, match="swapped with itself"):
        pvg.swap(video, video, [out, out])
    with pytest.raises(ValueError, match="of two faces"):
        pvg.swap(group, paths=out)
    with pytest.raises(ValueError, match="two different faces"):
        pvg.swap(group, paths=out, faces=(1, 1))
    with pytest.raises(ValueError, match="no face 7"):
        pvg.swap(group, paths=out, faces=(0, 7))
    with pytest.raises(ValueError, match="one path"):
        pvg.swap(group, paths=[out, out], faces=(0, 1))
    with pytest.raises(ValueError, match="one for each"):
        pvg.swap(group, paths=out, faces=(0, 1), contrast=(1.0, 1.0, 1.0))
    with pytest.raises(ValueError, match="contrast must be"):
        pvg.swap(group, paths=out, faces=(0, 1), contrast=(1.0, 2.0))
    assert list(tmp_path.iterdir()) == []


class LikeAPath:
    """What stands for a path without being one, as entries of folders do."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __fspath__(self) -> str:
        return str(self._path)


def test_a_path_may_be_anything_that_stands_for_one(group: pvg.VectorVideo, tmp_path: Path) -> None:
    out = tmp_path / "out.png"
    pvg.swap(group, paths=LikeAPath(out), faces=(0, 1))  # type: ignore[arg-type]
    assert out.is_file()
    with pytest.raises(ValueError, match="is a path: give what"):
        pvg.transfer(LikeAPath(out), group)  # type: ignore[arg-type]


def test_swap_gives_each_the_others_colours(video: pvg.VectorVideo, samples: Samples, tmp_path: Path) -> None:
    with pvg.vectorize(samples.dark_portrait) as image:
        pvg.swap(video, image, [tmp_path / "a.mp4", tmp_path / "b.png"], crf=10, memory_bytes=10**9)
        key, other = video.records[0].key_frames[0], image.records[0].key_frames[0]
        expected = pvg.render_frame(image, pvg.transfer(image, video), 0)
        (swapped,) = read_frames(tmp_path / "b.png")
        np.testing.assert_array_equal(swapped.rgb(), expected)
        gap = np.linalg.norm(key.colors.mean(axis=0) - other.colors.mean(axis=0))
        assert gap > 20
        assert probe(tmp_path / "a.mp4").frame_count == video.frame_count


def test_a_reference_asset_cannot_be_rendered(samples: Samples, tmp_path: Path) -> None:
    clip = cut_clip(samples.woman_clip, tmp_path / "clip.mp4", 0, 12)
    with pvg.vectorize(clip, reference=True) as reference:
        assert reference.media.kind == "video"
        look = pvg.transfer(reference, reference)
        with pytest.raises(pvg.AssetError, match="reference"):
            pvg.render(reference, [look], [tmp_path / "out.mp4"])


def test_another_clip_is_refused(video: pvg.VectorVideo, dark_reference: pvg.VectorVideo, tmp_path: Path) -> None:
    other = tmp_path / "other.mp4"
    other.write_bytes(video.require_source().read_bytes() + b"\0")
    with pvg.open_asset(video.path, other) as opened:
        look = pvg.transfer(opened, dark_reference)
        with pytest.raises(pvg.AssetError, match="not the clip"):
            pvg.render(opened, [look], [tmp_path / "out.mp4"])


def test_more_looks_than_are_drawn_at_once_take_further_passes(
    video: pvg.VectorVideo, dark_reference: pvg.VectorVideo, tmp_path: Path
) -> None:
    strengths = (0.0, 0.25, 0.5, 0.75, 1.0)
    looks = [pvg.transfer(video, dark_reference, strength=strength) for strength in strengths]
    paths = [tmp_path / f"{k}.mp4" for k in range(len(looks))]
    seen: list[tuple[int, int]] = []
    pvg.render(video, looks, paths, crf=0, progress=lambda _, done, total: seen.append((done, total)))
    assert seen == [(k, 2 * video.frame_count) for k in range(1, 2 * video.frame_count + 1)]
    for look, path in zip(looks, paths, strict=True):
        written = [frame.planes for frame in read_frames(path)]
        assert len(written) == video.frame_count
        (drawn,) = Renderer(video, [look]).draw(source_frame(video, 30))
        for one, other in zip(drawn.planes, written[30], strict=True):
            np.testing.assert_array_equal(one, other)


def deep_portrait(samples: Samples, path: Path) -> Path:
    """A portrait of 16 bits a sample whose low bits carry something, with alpha and a profile."""
    rgb = read_image(samples.portrait).rgb().astype(np.int64) * 257
    noise = np.random.default_rng(0).integers(-128, 129, rgb.shape)
    deep = np.clip(rgb + noise, 0, 65535).astype(np.uint16)
    alpha = np.broadcast_to(np.arange(deep.shape[1], dtype=np.uint16) * 17, deep.shape[:2])
    icc = (200).to_bytes(4, "big") + bytes(12) + b"RGB " + bytes(16) + b"acsp" + bytes(160)
    write_image(path, deep, alpha=np.ascontiguousarray(alpha), metadata=PictureMetadata(icc=icc))
    return path


@pytest.mark.parametrize("suffix", [".png", ".tiff"])
def test_own_colours_give_a_16_bit_picture_back_bit_for_bit(suffix: str, samples: Samples, tmp_path: Path) -> None:
    source = deep_portrait(samples, tmp_path / f"deep{suffix}")
    with pvg.vectorize(source) as image:
        out = tmp_path / f"own{suffix}"
        pvg.render(image, [pvg.transfer(image, image)], [out])
    before, after = read_image(source), read_image(out)
    assert after.format.depth == 16
    for was, now in zip((*before.planes, before.alpha), (*after.planes, after.alpha), strict=True):
        np.testing.assert_array_equal(now, was)
    assert read_picture_metadata(out).icc == read_picture_metadata(source).icc is not None
    assert not lost_in_picture(source, out)


def test_a_look_on_16_bits_has_finer_steps_and_the_same_colours(
    samples: Samples, dark_reference: pvg.VectorVideo, tmp_path: Path
) -> None:
    source = deep_portrait(samples, tmp_path / "deep.png")
    drawn = {}
    with pvg.vectorize(source) as image:
        look = pvg.transfer(image, dark_reference)
        paths = [tmp_path / name for name in ("out.png", "out.tiff", "out.jpg")]
        pvg.render(image, [look] * 3, paths)
        drawn = {path.suffix: read_image(path) for path in paths}
    flat_source = tmp_path / "flat.png"
    write_image(flat_source, read_image(source).rgb())
    with pvg.vectorize(flat_source) as image:
        flat = pvg.render_frame(image, replace(look, source_sha256=None), 0)  # of the same faces in another file
    deep, before = drawn[".png"], read_image(source)
    for a, b in zip((*deep.planes, deep.alpha), (*drawn[".tiff"].planes, drawn[".tiff"].alpha), strict=True):
        np.testing.assert_array_equal(a, b)
    changed = deep.planes[0] != before.planes[0]
    assert changed.mean() > 0.02
    assert len(np.unique(deep.planes[0][changed])) > 20 * len(np.unique(flat[..., 0][changed]))
    assert len(np.unique(deep.planes[0][changed] % 257)) > 250  # the steps between two of 8 bits are used
    error = np.abs(np.stack(deep.planes, axis=-1) / 257.0 - flat)
    assert error[changed].mean() < 1.0
    assert drawn[".jpg"].format.depth == 8
    assert len(lost_in_picture(source, paths[2])) == 2  # depth and alpha


def test_a_clips_alpha_goes_from_its_file_to_a_looks(samples: Samples, tmp_path: Path) -> None:
    info = probe(samples.woman_clip)
    target = PixelFormat("yuv444p10le", 10, (0, 0), (0.2126, 0.0722), False)
    info = replace(info, format=target, has_alpha=True, has_audio=False, color_matrix=1, color_range=1)
    alpha = np.broadcast_to(np.linspace(0, 1023, info.width).astype(np.uint16), (info.height, info.width))
    source = tmp_path / "source.mkv"
    with VideoWriter(source, info, target, codec="ffv1") as writer:
        for frame in read_frames(samples.woman_clip, start=20, stop=24):
            planes = target.from_rgb(frame.rgb())
            writer.write(
                Frame(frame.index, frame.pts, frame.time_s, target, planes, frame.duration, alpha=alpha.copy())
            )
    assert probe(source).has_alpha
    with pvg.vectorize(source) as clip:
        own = pvg.transfer(clip, clip)
        outs = [tmp_path / name for name in ("exact.mkv", "editing.mov", "plain.mp4")]
        warnings = [
            pvg.render(clip, [own], [out], codec=codec)[0]
            for out, codec in zip(outs, ("ffv1", "prores4444", "hevc"), strict=True)
        ]
    before = list(read_frames(source))
    for frame, was in zip(read_frames(outs[0]), before, strict=True):
        assert frame.alpha is not None
        np.testing.assert_array_equal(frame.alpha, was.alpha)
        for plane, same in zip(frame.planes, was.planes, strict=True):
            np.testing.assert_array_equal(plane, same)
    editing = next(read_frames(outs[1]))
    assert editing.alpha is not None
    top = 2**editing.format.depth - 1
    assert np.abs(editing.alpha / top - alpha / 1023.0).max() < 0.02
    assert next(read_frames(outs[2])).alpha is None
    assert not any("alpha" in line for line in warnings[0] + warnings[1])
    assert any(line.startswith("alpha is not kept") for line in warnings[2])
