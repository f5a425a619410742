from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import pytest
from av.subtitles.subtitle import SubtitleSet

from pvg.video.subtitles import Line, one_at_a_time
from tests.gallery.clips import libav_frame, rewrite_clip
from tests.gallery.pictures import colorful

HEAD = b"0,0,Default,,0,0,0,,"


@pytest.mark.parametrize(
    ("lines", "shown"),
    [
        ([(0, 500, "a"), (700, 900, "b")], [(0, 500, "a"), (700, 900, "b")]),
        ([(0, 500, "a"), (500, 900, "b")], [(0, 500, "a"), (500, 900, "b")]),
        ([(0, 800, "a"), (200, 500, "b")], [(0, 200, "a"), (200, 500, "a+b"), (500, 800, "a")]),
        ([(0, 500, "a"), (200, 800, "b")], [(0, 200, "a"), (200, 500, "a+b"), (500, 800, "b")]),
        ([(100, 500, "a"), (100, 500, "b")], [(100, 500, "a+b")]),
        (
            [(0, 300, "a"), (100, 300, "b"), (200, 900, "c")],
            [(0, 100, "a"), (100, 200, "a+b"), (200, 300, "a+b+c"), (300, 900, "c")],
        ),
        ([(500, 900, "a"), (200, 700, "b")], [(500, 700, "a+b"), (700, 900, "a")]),
        ([], []),
    ],
)
def test_lines_of_several_speakers_are_seen_one_after_the_other(
    lines: list[tuple[int, int, str]], shown: list[tuple[int, int, str]]
) -> None:
    given = [Line(start, end, HEAD + text.encode()) for start, end, text in lines]
    found = [(line.start_ms, line.end_ms, line.event) for line in one_at_a_time(given)]
    assert found == [(start, end, HEAD + text.replace("+", r"\N").encode()) for start, end, text in shown]


def talking_clip(path: Path, times: list[tuple[int, int]]) -> Path:
    """1 s of pictures, and a line of text from each time in ms to the other."""
    picture = libav_frame(colorful(1, (96, 64)))
    with av.open(str(path), "w") as output:
        video: Any = output.add_stream("libx264", rate=25)
        video.width, video.height, video.pix_fmt = 96, 64, "yuv420p"
        words: Any = output.add_stream("srt")
        words.codec_context.time_base = Fraction(1, 1000)
        words.codec_context.subtitle_header = b"[Script Info]\nScriptType: v4.00+\n"
        for k in range(25):
            picture.pts, picture.time_base = k, Fraction(1, 25)
            output.mux(video.encode(picture))
        output.mux(video.encode(None))
        for number, (start, end) in enumerate(times):
            line = SubtitleSet.create(HEAD + b"Line %d" % number, 0, end - start, pts=start * 1000)
            packet = words.codec_context.encode_subtitle(line)
            packet.stream, packet.time_base = words, Fraction(1, 1000)
            packet.pts = packet.dts = start
            packet.duration = end - start
            output.mux_one(packet)
    return path


@pytest.mark.parametrize("suffix", [".mp4", ".mov", ".mkv"])
def test_lines_that_overlap_begin_when_they_did(suffix: str, tmp_path: Path) -> None:
    times = [(0, 500), (100, 400), (300, 700), (800, 900)]
    source, target = talking_clip(tmp_path / "i.mkv", times), tmp_path / f"o{suffix}"
    rewrite_clip(source, target)
    first: dict[bytes, Fraction] = {}
    with av.open(str(target)) as opened:
        (stream,) = opened.streams.subtitles
        for packet in opened.demux(stream):
            for shown in packet.decode() if packet.size else ():
                for line in shown.dialogue.split(b"\n"):
                    first.setdefault(line, packet.pts * packet.time_base)
    assert first == {b"Line %d" % number: Fraction(start, 1000) for number, (start, _) in enumerate(times)}
