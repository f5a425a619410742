"""Clips whose files hold much beside the pictures, made on the spot: sounds, subtitles, chapters, tags, fields, HDR."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import av.codec.context
import numpy as np
from av.stream import Disposition
from av.subtitles.subtitle import SubtitleSet

from tests.gallery.pictures import colorful

FRAMES = 6
_RATE = 48000
_STEP = Fraction(1, 1000)
_STYLES = (
    b"[Script Info]\nScriptType: v4.00+\n\n[V4+ Styles]\nFormat: Name, Fontname, Fontsize, PrimaryColour, "
    b"SecondaryColour, OutlineColour, BackColour, Bold, Italic, Underline, StrikeOut, ScaleX, ScaleY, Spacing, Angle, "
    b"BorderStyle, Outline, Shadow, Alignment, MarginL, MarginR, MarginV, Encoding\nStyle: Default,Arial,16,&Hffffff,"
    b"&Hffffff,&H0,&H0,0,0,0,0,100,100,0,0,1,1,0,2,10,10,10,0\n\n[Events]\n"
    b"Format: Layer, Start, End, Style, Name, MarginL, MarginR, MarginV, Effect, Text\n"
)


@dataclass(frozen=True)
class Other:
    """A sound or subtitle track to be made: its libav encoder, language, title and what it is marked as."""

    encoder: str
    language: str | None = None
    title: str | None = None
    marks: Disposition = Disposition(0)  # noqa: RUF009 - a number


@dataclass(frozen=True)
class Rich:
    """A clip to be made. suffix: of its container; codec, layout: of the pictures, as libav names them."""

    suffix: str
    codec: str = "libx264"
    layout: str = "yuv420p"
    size: tuple[int, int] = (64, 64)
    options: dict[str, str] = field(default_factory=dict)
    fields: str | None = None
    color: tuple[int, int, int, int] = (1, 1, 1, 1)  # matrix, primaries, transfer, range
    sounds: Sequence[Other] = ()
    subtitles: Sequence[Other] = ()
    chapters: int = 0
    tags: dict[str, str] = field(default_factory=dict)
    timecode: str | None = None
    attachment: bytes | None = None

    def write(self, folder: Path, name: str) -> Path:
        """Make it; 6 frames at 25 a second, as much sound, a line of text every tenth of a second."""
        path = folder / f"{name}{self.suffix}"
        movflags = {"movflags": "use_metadata_tags"} if self.suffix in (".mp4", ".mov") else {}
        with av.open(str(path), "w", options=movflags) as output:
            output.metadata.update(self.tags)
            pictures = self._pictures(output)
            sounds = [_described(output.add_stream(one.encoder, rate=_RATE), one) for one in self.sounds]
            texts = [_text_stream(output, one) for one in self.subtitles]
            if self.timecode is not None:
                (output if self.suffix == ".mkv" else pictures).metadata["timecode"] = self.timecode
            if self.attachment is not None:
                output.add_attachment("font.ttf", "font/ttf", self.attachment)
            output.set_chapters(
                [
                    {
                        "id": k,
                        "start": 120 * k,
                        "end": 120 * (k + 1),
                        "time_base": _STEP,
                        "metadata": {"title": f"Part {k}"},
                    }
                    for k in range(self.chapters)
                ]
            )
            for picture in self._frames():
                output.mux(pictures.encode(picture))
            output.mux(pictures.encode(None))
            for stream in sounds:
                _write_tone(output, stream)
            for stream in texts:
                _write_lines(output, stream)
        return path

    def _pictures(self, output: av.container.OutputContainer) -> Any:
        stream: Any = output.add_stream(self.codec, rate=25, options=self.options)
        context = stream.codec_context
        context.width, context.height = self.size
        context.pix_fmt = self.layout
        context.colorspace, context.color_primaries, context.color_trc, context.color_range = self.color
        if self.fields is not None:
            context.flags |= av.codec.context.Flags.interlaced_dct | av.codec.context.Flags.interlaced_me
            context.field_order = {"tff": 4, "bff": 5}[self.fields]
        return stream

    def _frames(self) -> list[Any]:
        base = colorful(3, self.size)
        marked = None
        frames = []
        for k in range(FRAMES):
            frame: Any = av.VideoFrame.from_ndarray(np.roll(base, k, axis=1), format="rgb24").reformat(
                format=self.layout, dst_colorspace=1
            )
            frame.pts, frame.time_base = k, Fraction(1, 25)
            frame.colorspace, frame.color_primaries, frame.color_trc, frame.color_range = self.color
            if self.fields is not None:
                marked = marked or _marks(frame, self.fields)
                marked.push(frame)
                frame = marked.pull()
            frames.append(frame)
        return frames


def _marks(frame: Any, fields: str) -> av.filter.Graph:
    graph = av.filter.Graph()
    source = graph.add_buffer(width=frame.width, height=frame.height, format=frame.format, time_base=frame.time_base)
    marks, sink = graph.add("setfield", fields), graph.add("buffersink")
    source.link_to(marks)
    marks.link_to(sink)
    graph.configure()
    return graph


def _described(stream: Any, one: Other) -> Any:
    if one.language is not None:
        stream.metadata["language"] = one.language
    if one.title is not None:
        stream.metadata["title"] = one.title
    stream.disposition = one.marks
    return stream


def _text_stream(output: av.container.OutputContainer, one: Other) -> Any:
    stream: Any = output.add_stream(one.encoder)
    stream.codec_context.subtitle_header = _STYLES
    stream.codec_context.time_base = _STEP
    return _described(stream, one)


def _write_tone(output: av.container.OutputContainer, stream: Any) -> None:
    resampler = av.AudioResampler(stream.codec_context.format.name, "stereo", _RATE)
    for k in range(12):
        noise = np.random.default_rng(k).normal(0.0, 0.1, (2, 1024)).astype(np.float32)
        block = av.AudioFrame.from_ndarray(noise, format="fltp", layout="stereo")
        block.sample_rate, block.pts, block.time_base = _RATE, 1024 * k, Fraction(1, _RATE)
        for part in resampler.resample(block):
            output.mux(stream.encode(part))
    output.mux(stream.encode(None))


def _write_lines(output: av.container.OutputContainer, stream: Any) -> None:
    for k in range(2):
        text = f"{k},0,Default,,0,0,0,,Line {k}".encode()
        packet = stream.codec_context.encode_subtitle(SubtitleSet.create(text, 0, 80, pts=100_000 * k))
        packet.stream, packet.time_base = stream, _STEP
        packet.pts = packet.dts = 100 * k
        packet.duration = 80
        output.mux_one(packet)
