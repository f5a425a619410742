from __future__ import annotations

import itertools
from pathlib import Path

import av
import pytest

from pvg.video import (
    probe,
    read_frames,
)
from tests.gallery.clips import (
    sound_packets,
    tone_onset,
    write_clip,
)


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
