"""Clips by a pipe: YUV4MPEG2 and NUT, written and read."""

from __future__ import annotations

import io
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from pvg.errors import MediaError
from pvg.video import MediaInfo, MediaLimits, PipeReader, Streams, VideoWriter, Y4mWriter, make_plan
from tests.gallery.clips import media_info, pixel_format, smooth_frames


class Pipe(io.RawIOBase):
    """Bytes that come in small parts and cannot be gone back in."""

    def __init__(self, content: bytes) -> None:
        self._content = io.BytesIO(content)

    def read(self, size: int = -1) -> bytes:
        return self._content.read(min(size, 1000) if size >= 0 else 1000)

    def seekable(self) -> bool:
        return False


def written(name: str, container: str, codec: str = "auto", count: int = 4, **facts: Any) -> tuple[bytes, MediaInfo]:
    fmt = pixel_format(name)
    info = media_info(fmt, time_base=Fraction(1, 25), **facts)
    target = io.BytesIO()
    plan = make_plan(info, container=container, codec=codec)
    made = Y4mWriter(target, info, fmt, plan) if container == "y4m" else VideoWriter(target, info, fmt, plan=plan)
    with made as writer:
        for k, frame in enumerate(smooth_frames(count, fmt)):
            writer.write(replace(frame, pts=k, duration=1))
    return target.getvalue(), info


@pytest.mark.parametrize("name", ["yuv420p", "yuv422p", "yuv444p", "yuv420p10le", "yuv422p10le", "yuv444p12le"])
@pytest.mark.parametrize(("container", "codec"), [("y4m", "auto"), ("nut", "auto"), ("nut", "ffv1")])
def test_pictures_come_back_as_they_went(name: str, container: str, codec: str) -> None:
    content, info = written(name, container, codec)
    with PipeReader(Pipe(content), (1, 1)) as clip:  # type: ignore[arg-type]
        assert (clip.width, clip.height, clip.frame_rate) == (info.width, info.height, 25)
        assert clip.format == info.format
        frames = list(clip.frames)
    expected = smooth_frames(4, info.format)
    assert [frame.time_s for frame in frames] == [k / 25 for k in range(4)]
    for frame, before in zip(frames, expected, strict=True):
        for plane, other in zip(frame.planes, before.planes, strict=True):
            np.testing.assert_array_equal(plane, other)


@pytest.mark.parametrize("name", ["yuv420p", "yuv422p10le"])
def test_a_stream_is_given_bytes_that_it_can_count(name: str) -> None:
    class Counting(io.BytesIO):
        given = 0

        def write(self, data: Any) -> int:
            self.given += len(data)
            return super().write(data)

    fmt, target = pixel_format(name), Counting()
    info = media_info(fmt, time_base=Fraction(1, 25))
    with Y4mWriter(target, info, fmt, make_plan(info, container="y4m")) as writer:
        for frame in smooth_frames(2, fmt):
            writer.write(frame)
    assert target.given == len(target.getvalue())


def test_the_first_line_says_what_it_is() -> None:
    content, _ = written("yuv422p10le", "y4m", sample_aspect_ratio=Fraction(4, 3))
    assert content.split(b"\n")[0] == b"YUV4MPEG2 W96 H64 F25:1 Ip A4:3 C422p10 XCOLORRANGE=LIMITED"
    fmt = pixel_format()
    plan = make_plan(media_info(fmt), container="y4m", streams=Streams(fields="bff"))
    target = io.BytesIO()
    with Y4mWriter(target, media_info(fmt), fmt, plan) as writer:
        writer.write(smooth_frames(1, fmt)[0])
    assert b" Ib " in target.getvalue().split(b"\n")[0]
    with PipeReader(io.BytesIO(target.getvalue())) as clip:
        assert clip.fields == "bff"


def test_the_shortest_first_line_is_read() -> None:
    """As long as what is read to know the format, with the mark of the first frame or without."""
    for size, head in ((2, b"YUV4MPEG2 W2 H2 F1:1\n"), (1, b"YUV4MPEG2 W1 H1 F1\n")):
        content = head + (b"FRAME\n" + bytes([16] * size * size + [128] * 2)) * 2
        with PipeReader(io.BytesIO(content)) as clip:
            assert [frame.planes[0].tolist() for frame in clip.frames] == [[[16] * size] * size] * 2


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "neither NUT nor YUV4MPEG2"),
        (b"hello, this is not a clip at all", "neither NUT nor YUV4MPEG2"),
        (b"nut/multimedia container\0", "its header cannot be read"),
        (b"YUV4MPEG2 W2 H2\nFRAME\n      ", "cannot be read"),
        (b"YUV4MPEG2 W2 H2 F0:1 C420\nFRAME\n", "cannot be read"),
        (b"YUV4MPEG2 W2 H2 F1:0 C420\nFRAME\n", "cannot be read"),
        (b"YUV4MPEG2 W2 H2 F25:1 C411 Ip A1:1\nFRAME\n", "taken are 420, 422 and 444"),
        (b"YUV4MPEG2 W99999 H99999 F25:1 C420\nFRAME\n", "are accepted"),
    ],
)
def test_what_is_no_clip_is_refused(content: bytes, words: str) -> None:
    with pytest.raises(MediaError, match=words), PipeReader(io.BytesIO(content), limits=MediaLimits()):
        pass


def test_an_aspect_below_zero_is_refused() -> None:
    line = b"YUV4MPEG2 W16 H16 F25:1 A-4:3 C420\n"
    with pytest.raises(MediaError, match="cannot be read"), PipeReader(io.BytesIO(line)):
        pass


def test_a_stream_is_called_by_its_name(tmp_path: Path) -> None:
    path = tmp_path / "clip.y4m"
    path.write_bytes(b"no clip")
    with path.open("rb") as file, pytest.raises(MediaError, match=r"^clip\.y4m is neither"), PipeReader(file):
        pass
    with pytest.raises(MediaError, match=r"^the stream of pictures is neither"), PipeReader(io.BytesIO(b"")):
        pass

    class Standard(io.BytesIO):
        name = "<stdin>"

    with pytest.raises(MediaError, match=r"^standard input is neither"), PipeReader(Standard()):
        pass


def test_a_pipe_that_is_refused_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    content, _ = written("yuv420p", "nut")
    opened = []

    def remembered(*args: Any, **options: Any) -> Any:
        opened.append(av_open(*args, **options))
        return opened[-1]

    av_open = av.open
    monkeypatch.setattr(av, "open", remembered)
    with pytest.raises(MediaError, match="are accepted"):
        PipeReader(io.BytesIO(content), limits=MediaLimits(max_pixels=100)).__enter__()
    (container,) = opened
    with pytest.raises(AssertionError, match="not open"):
        next(container.demux())


def test_a_pipe_that_ends_early_is_named() -> None:
    content, _ = written("yuv420p", "y4m")
    for cut, words in (
        (len(content) - 10, "ends within frame 3"),
        (len(content) - 96 * 64 * 3 // 2 - 3, "damaged after"),
    ):
        with PipeReader(io.BytesIO(content[:cut])) as clip, pytest.raises(MediaError, match=words):
            list(clip.frames)


@pytest.mark.parametrize("name", ["yuv420p10le", "yuv444p12le"])
@pytest.mark.parametrize("container", ["y4m", "nut"])
def test_samples_beyond_the_depth_are_refused_with_their_frame(name: str, container: str) -> None:
    fmt = pixel_format(name)
    info = media_info(fmt, time_base=Fraction(1, 25))
    plan = make_plan(info, container=container)
    for plane in range(3):
        target = io.BytesIO()
        frames = [replace(frame, pts=frame.index, duration=1) for frame in smooth_frames(3, fmt)]
        beyond = [plane.copy() for plane in frames[2].planes]
        beyond[plane][-1, -1] = 2**fmt.depth
        frames[2] = replace(frames[2], planes=(beyond[0], beyond[1], beyond[2]))
        made = Y4mWriter(target, info, fmt, plan) if container == "y4m" else VideoWriter(target, info, fmt, plan=plan)
        with made as writer:
            for frame in frames:
                writer.write(frame)
        with PipeReader(io.BytesIO(target.getvalue()), (1, 1)) as clip:
            assert next(clip.frames).index == 0
            assert next(clip.frames).index == 1
            with pytest.raises(MediaError, match=f"beyond {fmt.depth} bits in frame 2"):
                next(clip.frames)
