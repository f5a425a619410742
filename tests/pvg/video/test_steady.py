from __future__ import annotations

import itertools
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from pvg.video.steady import steady_frames, steady_packets, steady_pcm
from pvg.video.streams import Track
from tests.gallery.clips import libav_frame, rewrite_clip, sound_packets
from tests.gallery.pictures import colorful

_RATE = 48000
_GAP_S = (0.2, 0.5)
_ONSET_S = 0.6


def _gapped_clip(
    path: Path, codec: str, block: int = 960, gap_s: tuple[float, float] = _GAP_S, rate: int = _RATE
) -> Path:
    """Pictures for 0.8 s, and sound without what lies in the gap: silence, then a tone from 0.6 s on."""
    picture = libav_frame(colorful(1, (96, 64)))
    time = np.arange(round(0.8 * rate)) / rate
    wave = (np.sin(2 * np.pi * 440 * time) * (time >= _ONSET_S) * 0.5 * 2**15).astype(np.int16)
    with av.open(str(path), "w") as output:
        video: Any = output.add_stream("mpeg4", rate=25)
        video.width, video.height, video.pix_fmt = 96, 64, "yuv420p"
        sound: Any = output.add_stream(codec, rate=rate)
        sound.codec_context.layout = "mono"
        for k in range(20):
            picture.pts, picture.time_base = k, Fraction(1, 25)
            output.mux(video.encode(picture))
        output.mux(video.encode(None))
        for start in range(0, len(wave), block):
            if not gap_s[0] <= start / rate < gap_s[1]:
                part = av.AudioFrame.from_ndarray(wave[None, start : start + block], format="s16", layout="mono")
                part.sample_rate, part.pts, part.time_base = rate, start, Fraction(1, rate)
                output.mux(sound.encode(part))
        output.mux(sound.encode(None))
    return path


def _onset_s(path: Path) -> float:
    """When its sound gets loud."""
    with av.open(str(path)) as source:
        for frame in source.decode(source.streams.audio[0]):
            samples = frame.to_ndarray()[0].astype(np.float64)
            levels = np.abs(samples - 128 if frame.format.name == "u8" else samples)
            loud = levels > 0.1 * {"u8": 2**7, "s16": 2**15, "s32": 2**31}.get(frame.format.packed.name, 1)
            if loud.any():
                assert frame.time is not None
                return frame.time + int(loud.argmax()) / _RATE
    raise AssertionError("the track is silent")


@pytest.mark.parametrize("codec", ["flac", "pcm_s16le", "pcm_u8"])
def test_sound_after_a_gap_stays_in_step_in_a_mov(codec: str, tmp_path: Path) -> None:
    source = _gapped_clip(tmp_path / "i.mkv", codec)
    assert _onset_s(source) == pytest.approx(_ONSET_S, abs=0.005)
    assert _onset_s(rewrite_clip(source, tmp_path / "o.mov")) == pytest.approx(_ONSET_S, abs=0.005)


def test_a_gap_of_sound_that_is_coded_anew_is_silence(tmp_path: Path) -> None:
    target = rewrite_clip(_gapped_clip(tmp_path / "i.mkv", "pcm_s16le"), tmp_path / "o.mp4")
    starts = [start for _, start in sound_packets(target)]
    assert {later - start for start, later in itertools.pairwise(starts)} == {Fraction(1024, _RATE)}
    assert _onset_s(target) == pytest.approx(_ONSET_S, abs=0.005)


def test_pcm_in_packets_shorter_than_a_tick_of_matroska_goes_into_a_mov(tmp_path: Path) -> None:
    source = _gapped_clip(tmp_path / "i.mkv", "pcm_s16le", block=24, gap_s=(0.0, 0.0))
    assert len({start for _, start in sound_packets(source)}) < len(sound_packets(source))
    assert _onset_s(rewrite_clip(source, tmp_path / "o.mov")) == pytest.approx(_ONSET_S, abs=0.002)


def _track(codec: str) -> Track:
    return Track(1, "sound", codec, rate=_RATE, layout="stereo", channels=2)


def _packet(start: int, size: int = 4) -> av.Packet:
    packet = av.Packet(b"\1" * size)
    packet.pts, packet.time_base = start, Fraction(1, _RATE)
    return packet


@pytest.mark.parametrize(("codec", "silent"), [("pcm_s24le", b"\0"), ("pcm_u8", b"\x80"), ("pcm_alaw", b"\xd5")])
def test_silence_is_what_the_coding_has_for_it(codec: str, silent: bytes) -> None:
    width = 6 if codec == "pcm_s24le" else 2
    packets = list(steady_pcm([_packet(0, width), _packet(4801, width)], _track(codec)))
    assert [(packet.pts, packet.duration) for packet in packets] == [(0, 1), (1, 4800), (4801, 1)]
    assert bytes(packets[1]) == silent * width * 4800


@pytest.mark.parametrize(
    ("stamps", "kept"),
    [
        ([100, 1100, 1500], [100, 101, 102]),  # within 40 ms of what is due: no seam
        ([0, 48000 * 3601, 48000 * 3601], [0, 48000 * 3601, 48000 * 3601 + 1]),  # no hour of silence is made
        ([9600, 0, 9601], [9600, 9601]),  # sound of a time that was heard already
        ([0, 96001], [0, 1, 48001, 96001]),  # silence comes a second at a time
    ],
)
def test_time_stamps_are_followed_only_where_they_leave_what_is_due(stamps: list[int], kept: list[int]) -> None:
    assert [packet.pts for packet in steady_pcm(map(_packet, stamps), _track("pcm_s16le"))] == kept


def test_the_silence_of_a_track_is_an_hour_at_most() -> None:
    """Each gap was filled that was shorter: packets an hour apart made as many hours of it."""
    apart = 48000 * 2400
    packets = list(steady_pcm(map(_packet, (0, apart, 2 * apart, 3 * apart)), _track("pcm_s16le")))
    assert sum(packet.duration or 0 for packet in packets) == apart + 3
    assert [packet.pts for packet in packets][-3:] == [apart, 2 * apart, 3 * apart]


def test_decoded_sound_is_filled_as_its_packets_are() -> None:
    frames = [av.AudioFrame("u8", "mono", 10) for _ in range(2)]
    for frame, start in zip(frames, (0, 4810), strict=True):
        frame.sample_rate, frame.pts, frame.time_base = _RATE, start, Fraction(1, _RATE)
    filled = list(steady_frames(frames))
    assert [(frame.pts, frame.samples) for frame in filled] == [(0, 10), (10, 4800), (4810, 10)]
    assert set(filled[1].to_ndarray()[0]) == {128}


@pytest.mark.parametrize(("codec", "samples"), [("aac", 1024), ("libmp3lame", 1152), ("ac3", 1536), ("alac", 4096)])
def test_packets_whose_stamps_matroska_has_rounded_have_even_steps_in_an_mp4(
    codec: str, samples: int, tmp_path: Path
) -> None:
    source = _gapped_clip(tmp_path / "i.mkv", codec, gap_s=(0.0, 0.0), rate=44100)
    rounded, even = (
        {later - start for (_, start), (_, later) in itertools.pairwise(sound_packets(path))}
        for path in (source, rewrite_clip(source, tmp_path / "o.mp4"))
    )
    assert len(rounded) > 1
    assert even == {Fraction(samples, 44100)}


def test_the_last_packet_of_alac_out_of_matroska_is_heard(tmp_path: Path) -> None:
    """Matroska does not tell how long it is, so that an MP4 had it last for no time, and it was cut off."""
    source = _gapped_clip(tmp_path / "i.mkv", "alac", gap_s=(0.0, 0.0))
    lengths = []
    for path in (source, rewrite_clip(source, tmp_path / "o.mp4"), rewrite_clip(source, tmp_path / "o.mov")):
        with av.open(str(path)) as clip:
            lengths.append(sum(frame.samples for frame in clip.decode(audio=0)))
    assert lengths == [round(0.8 * _RATE)] * 3


def test_packets_that_are_off_by_more_than_rounding_stay_when_they_are() -> None:
    packets = [av.Packet(b"\0") for _ in range(5)]
    for packet, ms in zip(packets, (5, 26, 48, 70, 85), strict=True):
        packet.pts = packet.dts = ms
        packet.time_base, packet.duration = Fraction(1, 1000), 21 if ms < 85 else 10
    steady = list(steady_packets(packets, 1024, _RATE))
    assert [(packet.pts or 0) - 240 for packet in steady] == [0, 1024, 2048, 3072, 85 * 48 - 240]
    assert [packet.duration for packet in steady] == [1024, 1024, 1024, 1024, 480]
