from __future__ import annotations

import itertools
import struct
import subprocess
import sys
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from pvg.errors import MediaError
from pvg.video import (
    make_plan,
    probe,
    read_frames,
    read_streams,
)
from pvg.video.streams import Chapter
from tests.gallery.clips import (
    change_boxes,
    libav_frame,
    rewrite_clip,
    sound_packets,
    tone_onset,
    write_clip,
)
from tests.gallery.pictures import colorful


def test_sound_is_copied_byte_for_byte_at_the_same_times(sounding_clip: Path, tmp_path: Path) -> None:
    info = probe(sounding_clip)
    assert (info.has_audio, info.audio_codec) == (True, "aac")
    path = write_clip(tmp_path / "o.mp4", list(read_frames(sounding_clip)), info, audio_from=sounding_clip)
    source, copy = sound_packets(sounding_clip), sound_packets(path)
    assert len(source) > 100
    assert copy == source


@pytest.mark.parametrize("suffix", [".mkv", ".webm"])
def test_sound_stays_in_step_in_other_containers(suffix: str, sounding_clip: Path, tmp_path: Path) -> None:
    frames = list(read_frames(sounding_clip))
    path = write_clip(tmp_path / f"o{suffix}", frames, probe(sounding_clip), audio_from=sounding_clip)
    first = next(read_frames(path)).time_s
    assert probe(path).audio_codec == ("opus" if suffix == ".webm" else "aac")
    assert tone_onset(path) - first == pytest.approx(tone_onset(sounding_clip), abs=0.01)


def test_sound_and_pictures_alternate_in_the_file(sounding_clip: Path, tmp_path: Path) -> None:
    path = write_clip(
        tmp_path / "o.mp4", list(read_frames(sounding_clip)), probe(sounding_clip), audio_from=sounding_clip
    )
    with av.open(str(path)) as clip:
        places = sorted((packet.pos or 0, packet.stream.type) for packet in clip.demux() if packet.size)
    kinds = [kind for _, kind in places]
    assert sum(a != b for a, b in itertools.pairwise(kinds)) > 20


def test_no_sound_is_written_unless_asked_for(sounding_clip: Path, tmp_path: Path) -> None:
    path = write_clip(tmp_path / "o.mp4", list(read_frames(sounding_clip)), probe(sounding_clip))
    assert not probe(path).has_audio


def _humming_clip(
    path: Path,
    codec: str,
    layout: str = "mono",
    rate: int = 48000,
    *,
    seconds: float = 0.8,
    ahead_s: float = 0.0,
    **options: str,
) -> Path:
    """Pictures for so many seconds, and as long a tone in every channel, of which `ahead_s` lie before them."""
    picture, count = libav_frame(colorful(1, (96, 64))), round(rate * seconds)
    channels = av.AudioLayout(layout).nb_channels
    wave = (np.sin(2 * np.pi * 440 * np.arange(count) / rate) * 0.3 * 2**15).astype(np.int16)
    with av.open(str(path), "w", options=options) as output:
        video: Any = output.add_stream("mpeg4", rate=25)
        video.width, video.height, video.pix_fmt = 96, 64, "yuv420p"
        sound: Any = output.add_stream(codec, rate=rate)
        sound.codec_context.layout = layout
        sound.codec_context.bit_rate = 64_000 * channels
        block = av.AudioFrame.from_ndarray(np.repeat(wave, channels)[None], format="s16", layout=layout)
        block.sample_rate, block.pts, block.time_base = rate, -round(rate * ahead_s), Fraction(1, rate)
        for k in range(round(25 * seconds)):
            picture.pts, picture.time_base = k, Fraction(1, 25)
            output.mux(video.encode(picture))
        output.mux([*video.encode(None), *sound.encode(block), *sound.encode(None)])
    return path


@pytest.mark.parametrize(
    ("codec", "layout", "rate", "suffix", "becomes"),
    [
        ("ac3", "5.1(side)", 48000, "webm", ("opus", 48000, "5.1")),
        ("pcm_s16le", "7.1(wide)", 48000, "webm", ("opus", 48000, "7.1")),
        ("pcm_s16le", "2.1", 48000, "webm", ("opus", 48000, "5.1")),
        ("pcm_s16le", "4.0", 44100, "webm", ("opus", 48000, "quad")),
        ("pcm_s16le", "quad(side)", 48000, "webm", ("opus", 48000, "quad")),
        ("pcm_s16le", "7.1.4", 48000, "mp4", ("aac", 48000, "7.1")),
        ("pcm_s16le", "downmix", 192000, "mp4", ("aac", 96000, "stereo")),
        ("pcm_s16le", "stereo", 50000, "mp4", ("aac", 48000, "stereo")),
        ("pcm_s16le", "mono", 6000, "mp4", ("aac", 7350, "mono")),
    ],
)
def test_sound_of_any_layout_and_rate_is_coded_anew_in_one_that_the_codec_has(
    codec: str, layout: str, rate: int, suffix: str, becomes: tuple[str, int, str], tmp_path: Path
) -> None:
    source = _humming_clip(tmp_path / "humming.mkv", codec, layout, rate)
    info, streams = probe(source), read_streams(source)
    plan = make_plan(info, container=suffix, source=source, streams=streams)
    path = rewrite_clip(source, tmp_path / f"o.{suffix}", plan)
    (line,) = (line for line in plan.changed if "sound track" in line and "becomes" in line)
    assert (f" of {becomes[1]} Hz (the clip's is of {rate})" in line) == (rate != becomes[1])
    with av.open(str(path)) as clip:
        context = clip.streams.audio[0].codec_context
        assert (context.name.removeprefix("lib"), context.sample_rate, context.layout.name) == becomes
        frames = list(clip.decode(audio=0))
    assert sum(frame.samples for frame in frames) / becomes[1] == pytest.approx(0.8, abs=0.1)
    if becomes[2] != "7.1":  # PyAV crashes where it copies eight channels
        assert max(float(np.abs(frame.to_ndarray()).max()) for frame in frames) > 0.1


_WRITTEN_ANEW = """
import sys
from pathlib import Path
from pvg.video import read_streams
from tests.gallery.clips import rewrite_clip
source = Path(sys.argv[1])
read_streams(source)
for suffix in (".mp4", ".mov", ".mkv", ".webm"):
    rewrite_clip(source, source.with_name("o").with_suffix(suffix))
"""


@pytest.mark.parametrize(("layout", "tag"), [("6.1", 125 << 16 | 7), ("7.1", 128 << 16 | 8)])
def test_pcm_whose_channels_a_mov_has_in_an_order_of_its_own_is_read_and_kept(
    layout: str, tag: int, tmp_path: Path
) -> None:
    """In a process of its own, which PyAV once ended. tag: QuickTime's, of L R C LFE Ls Rs and those at the back."""
    source = tmp_path / "many.mov"
    channels = av.AudioLayout(layout).nb_channels
    with av.open(str(source), "w") as output:
        video: Any = output.add_stream("mpeg4", rate=25)
        video.width, video.height, video.pix_fmt = 96, 64, "yuv420p"
        sound: Any = output.add_stream("pcm_s16le", rate=48000)
        sound.codec_context.layout = layout
        block = av.AudioFrame.from_ndarray(
            np.tile(np.arange(channels, dtype=np.int16), 9600)[None], format="s16", layout=layout
        )
        block.sample_rate, block.pts, block.time_base = 48000, 0, Fraction(1, 48000)
        for k in range(5):
            picture = libav_frame(colorful(1, (96, 64)))
            picture.pts, picture.time_base = k, Fraction(1, 25)
            output.mux(video.encode(picture))
        output.mux([*video.encode(None), *sound.encode(block), *sound.encode(None)])
    data = source.read_bytes()
    at = data.index(b"chan", data.index(b"moov")) + 8
    source.write_bytes(data[:at] + struct.pack(">III", tag, 0, 0) + data[at + 12 :])
    done = subprocess.run([sys.executable, "-c", _WRITTEN_ANEW, source], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    (track,) = read_streams(source).tracks
    assert (track.layout, track.channels) == (layout, channels)
    assert track.order, "a layout of which MOV has the channels in another order"
    (same,) = read_streams(tmp_path / "o.mov").tracks
    assert same.order == track.order
    assert (sound_packets(tmp_path / "o.mov"))[0] == sound_packets(source)[0]
    first = np.frombuffer(sound_packets(tmp_path / "o.mkv")[0][0], np.int16)[:channels]
    names = [channel.name for channel in av.AudioLayout(layout).channels]
    assert [track.order[k] for k in first] == names, "Matroska's order is that of the layout"
    line = "PCM of the same samples, its channels in the order that Matroska has them in"
    assert line in make_plan(probe(source), container="mkv", source=source, streams=read_streams(source)).changed[0]
    for suffix in (".mp4", ".webm"):
        assert read_streams(tmp_path / f"o{suffix}").tracks[0].channels == channels


def _starts_s(path: Path) -> list[float]:
    with av.open(str(path)) as clip:
        return [float(packet.pts * packet.time_base) for packet in clip.demux(audio=0) if packet.pts is not None]


@pytest.mark.parametrize("suffix", [".mkv", ".mov", ".mp4"])
def test_sound_that_was_cut_away_is_not_heard_again(suffix: str, tmp_path: Path) -> None:
    source = _humming_clip(tmp_path / "cut.mp4", "aac", seconds=1.0, ahead_s=0.5)
    with av.open(str(source)) as clip:
        assert any(packet.is_discard for packet in clip.demux(audio=0)), "the cut is in an edit list"
    target = rewrite_clip(source, tmp_path / f"o{suffix}")
    picture = next(read_frames(target)).time_s
    starts = _starts_s(target)
    assert -0.2 < starts[0] - picture < 0.01
    assert starts[-1] - picture == pytest.approx(0.5, abs=0.05)


@pytest.mark.parametrize("suffix", [".mkv", ".mov", ".mp4"])
def test_sound_that_was_cut_away_from_fragments_is_not_heard_again(suffix: str, tmp_path: Path) -> None:
    flags = {"movflags": "frag_keyframe+delay_moov", "avoid_negative_ts": "disabled"}
    source = _humming_clip(tmp_path / "cut.mp4", "aac", seconds=1.0, ahead_s=0.5, **flags)
    with av.open(str(source)) as clip:
        packets = list(clip.demux(audio=0))
        assert min(packet.pts for packet in packets if packet.pts is not None) * packets[0].time_base < -0.4
        assert not any(packet.is_discard for packet in packets), "libav does not mark what is cut"
    target = rewrite_clip(source, tmp_path / f"o{suffix}")
    picture = next(read_frames(target)).time_s
    starts = _starts_s(target)
    assert -0.2 < starts[0] - picture < 0.01
    assert starts[-1] - picture == pytest.approx(0.5, abs=0.05)


@pytest.mark.parametrize(("ahead_s", "moved_s"), [(0.0, 0.021), (0.5, 0.021)])
def test_a_container_without_edit_lists_begins_a_packet_before_what_is_heard(
    ahead_s: float, moved_s: float, tmp_path: Path
) -> None:
    """All is moved by it, chapters too."""
    source = _humming_clip(tmp_path / "cut.mp4", "aac", seconds=1.0, ahead_s=ahead_s)
    plan = make_plan(probe(source), container="mkv", source=source, streams=read_streams(source))
    chapters = (Chapter(Fraction(0), Fraction(1, 2), "One"), Chapter(Fraction(1, 2), Fraction(1), "Two"))
    target = rewrite_clip(source, tmp_path / "o.mkv", replace(plan, chapters=chapters))
    picture = next(read_frames(target)).time_s
    assert picture == pytest.approx(moved_s, abs=0.011)
    assert _starts_s(target)[0] == 0
    found = [float(chapter.start_s) for chapter in read_streams(target).chapters]
    assert found == pytest.approx([picture, picture + 0.5], abs=1e-3)


@pytest.mark.parametrize("suffix", [".mkv", ".mov", ".mp4", ".webm"])
def test_sound_of_an_edit_list_of_two_parts_is_that_of_both(suffix: str, tmp_path: Path) -> None:
    """13 pictures from the beginning, and then as many from the second second on."""
    source, scales = _humming_clip(tmp_path / "edited.mp4", "aac", seconds=2.0), iter((12800, 48000))

    def halves(edits: bytes) -> bytes:
        (begin,) = struct.unpack_from(">i", edits, 12)
        return struct.pack(">IIIiIIiI", 0, 2, 520, begin, 1 << 16, 520, begin + next(scales), 1 << 16)

    change_boxes(source, b"elst", halves)
    with av.open(str(source)) as clip:
        stamps = [packet.dts for packet in clip.demux(audio=0) if packet.dts is not None]
        assert min(np.diff(stamps)) < 0, "the second part begins before the first one ends"
    target = rewrite_clip(source, tmp_path / f"o{suffix}")
    assert probe(target).frame_count == 26
    per_packet = 960 if suffix == ".webm" else 1024
    starts = np.array(_starts_s(target)) - next(read_frames(target)).time_s
    assert len(starts) == pytest.approx(1.04 * 48000 / per_packet, abs=4)
    assert min(np.diff(starts)) > 0
    assert starts[-1] == pytest.approx(1.02, abs=0.05)


@pytest.mark.parametrize(("codec", "suffix"), [("wmav2", ".mp4"), ("wmav2", ".mkv"), ("adpcm_ms", ".webm")])
def test_sound_that_an_avi_counts_in_blocks_has_even_steps(codec: str, suffix: str, tmp_path: Path) -> None:
    target = rewrite_clip(_humming_clip(tmp_path / "i.avi", codec, seconds=1.0), tmp_path / f"o{suffix}")
    steps = np.diff(_starts_s(target))
    assert len(steps) > 20
    assert steps[1:-1] == pytest.approx(float(np.median(steps)), abs=0.002)


@pytest.mark.parametrize(("suffix", "at"), [(".mp4", 3), (".mov", 20)])
def test_sound_that_a_muxer_calls_damaged_is_what_the_error_names(suffix: str, at: int, tmp_path: Path) -> None:
    source = _humming_clip(tmp_path / "i.mkv", "ac3", seconds=1.0)
    data, spoilt = bytearray(source.read_bytes()), -1
    for _ in range(at):
        spoilt = data.index(b"\x0b\x77", spoilt + 1)  # AC-3's sync word
    data[spoilt : spoilt + 8] = bytes(8)
    source.write_bytes(data)
    with pytest.raises(MediaError, match=r"i\.mkv: its sound or subtitles are damaged \(invalid data"):
        rewrite_clip(source, tmp_path / f"o{suffix}")
    assert not (tmp_path / f"o{suffix}").exists()
