"""Frames into a clip: the source's depth, colours and time stamps, and what else of its file is to be kept."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import BinaryIO

import av.error

from pvg.video.containers import CONTAINERS
from pvg.video.encoding import PictureEncoder
from pvg.video.formats import Frame, Patch, PixelFormat
from pvg.video.info import MediaInfo
from pvg.video.keeping import make_plan
from pvg.video.muxing import ClipMuxer
from pvg.video.plan import Plan
from pvg.video.streams import NO_STREAMS, read_sounds


class VideoWriter:
    """Writes frames as a clip; a context manager.

    path: .mp4, .mov, .mkv or .webm, or any name with `container` given, or a binary stream for the container "nut".
    info: the source clip's; its time base, frame rate, colour tags and pixel aspect are kept. format: that of the
    frames to come.
    codec: see `choose_codec`. crf, preset: the encoder's own scales (for vp9 the preset is cpu-used, 0–8, for av1 it is
    0–13), or for all of them x264's names, "ultrafast" to "veryslow". threads: of the encoder, as many as suit the
    machine when 0; the same number gives the same bytes, but of x264 with AVX-512 (`part_options`). audio_from: the
    clip whose sound is copied, or transcoded where the container cannot hold it; None, or a clip without sound, gives a
    silent clip.
    plan: all that is to be kept, see `make_plan`; then container, codec and audio_from are its own.

    Time stamps are exact in MP4 and MOV, those of an even rate where the source's are rounded (`MediaInfo.even_rate`).
    Matroska and WebM count milliseconds and have no negative ones: sound that leads in moves all tracks by the same
    amount. Subsampled H.264 and HEVC need even sizes: a last odd column or row is dropped; VP9, AV1 and FFV1 keep it.
    When the block is left by an exception the partial file is removed. Raises ValueError for options that do not fit,
    MediaError when encoding fails.
    """

    def __init__(
        self,
        path: str | Path | BinaryIO,
        info: MediaInfo,
        format: PixelFormat,  # noqa: A002 - the name callers know from Frame
        *,
        codec: str = "auto",
        crf: int | None = None,
        preset: str | None = None,
        audio_from: str | Path | None = None,
        container: str | None = None,
        threads: int = 0,
        plan: Plan | None = None,
    ) -> None:
        self.path = Path(path) if isinstance(path, (str, Path)) else None
        self._name = self.path.name if self.path is not None else "the output"
        key = container or (self.path.suffix.lower() if self.path is not None else "")
        if plan is None and key not in CONTAINERS:
            raise ValueError(f"{self._name}: a clip is written as .mp4, .mov, .mkv or .webm")
        if info.time_base is None:
            raise ValueError("a still picture has no time base; write it with write_image")
        if plan is None:
            source = audio_from if info.has_audio else None
            sounds = NO_STREAMS if source is None else read_sounds(source)
            plan = make_plan(info, container=key, codec=codec, source=source, streams=sounds, pixel_format=format)
        self.codec, self.format, self.width, self.height = plan.codec, plan.format, plan.width, plan.height
        self._encoder = PictureEncoder(info, format, plan, crf=crf, preset=preset, threads=threads, name=self._name)
        target = Path(path) if isinstance(path, (str, Path)) else path
        self._muxer = ClipMuxer(target, plan, info.time_base, self._encoder.stream_of, info.even_rate)

    def __enter__(self) -> VideoWriter:
        self._muxer.open()
        return self

    def write(self, frame: Frame, patches: Sequence[Patch] = ()) -> None:
        """Encode one frame; frames come in display order with rising time stamps (ValueError otherwise).

        patches: laid over the frame's planes as these are copied for the encoder.
        """
        packets = self._encoder.encode(frame, patches)
        try:
            self._muxer.write(packets)
        except av.error.FFmpegError as error:
            raise self._encoder.failure(error) from error

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is not None:
            self._muxer.abandon()
            return
        try:
            if self._encoder.frames == 0:
                raise ValueError(f"{self._name}: no frame was written")
            self._muxer.write(self._encoder.rest())
            self._muxer.finish(self._encoder.first_pts, self._encoder.end_pts)
        except av.error.FFmpegError as failed:
            self._muxer.abandon()
            raise self._encoder.failure(failed) from failed
        except BaseException:
            self._muxer.abandon()
            raise
