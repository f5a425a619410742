"""Files of a few kilobytes that ask a reader for gigabytes or minutes: refused by their headers, or harmless."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from pvg.video import probe
from pvg.video.indexes import index_entries
from pvg.video.sniffing import sniff
from scripts.samples import Samples
from tests.gallery import hostile
from tests.gallery.clips import add_tone
from tests.promises import Drill

#: read as they are: what is inflated of them is bounded
HARMLESS = {hostile.inflated_profile, hostile.inflated_text, hostile.index_beyond_all_files}
REFUSED = {
    hostile.compressed_index: "compressed index",
    hostile.compressed_index_aside: "compressed index",
    hostile.nested_boxes: "too deep",
    hostile.many_boxes: "too many",
    hostile.many_tracks: "headers of more than",
    hostile.many_cues: "headers of more than",
    hostile.many_chapters: "headers of more than",
    hostile.many_tags: "headers of more than",
    hostile.many_attachments: "attachments",
    hostile.many_scans: "scans",
    hostile.many_chunks: "chunks",
    hostile.many_chunks_of_webp: "chunks",
    hostile.many_segments: "segments",
    hostile.second_header: "damaged",
    hostile.many_strips: "2000000 values",
    hostile.huge_tile: "tile",
}
MOST_MB, MOST_S = 64, 5

#: probes each file of its arguments, and tells of each what became of it, the growth of the peak of memory, the time
CHILD = """
import json, sys, time
from pathlib import Path
from pvg.errors import MediaError
from pvg.video import probe

def peak_mb():
    return int(Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0]) / 1024

for path in sys.argv[1:]:
    Path("/proc/self/clear_refs").write_text("5")
    before, began = peak_mb(), time.process_time()
    try:
        said = f"{probe(path).frame_count} frames"
    except MediaError as error:
        said = str(error)
    print(json.dumps([said, peak_mb() - before, time.process_time() - began]))
"""


@pytest.fixture(scope="module")
def probed(tmp_path_factory: pytest.TempPathFactory) -> dict[Callable[[Path], Path], list[Any]]:
    """What a process of its own found of each file."""
    folder = tmp_path_factory.mktemp("hostile")
    makers = (*hostile.CLIPS, *hostile.PICTURES)
    paths = [str(make(folder)) for make in makers]
    done = subprocess.run(
        [sys.executable, "-c", CHILD, *paths], capture_output=True, text=True, timeout=500, check=True
    )
    return dict(zip(makers, map(json.loads, done.stdout.splitlines()), strict=True))


@pytest.mark.parametrize("make", [*hostile.CLIPS, *hostile.PICTURES], ids=lambda make: make.__name__)
def test_what_headers_ask_for_is_bounded(
    make: Callable[[Path], Path], probed: dict[Callable[[Path], Path], list[Any]]
) -> None:
    said, grown_mb, taken_s = probed[make]
    assert said.endswith(" frames") if make in HARMLESS else REFUSED.get(make, "samples; at most 2000000") in said
    assert "\n" not in said
    assert grown_mb < MOST_MB
    assert taken_s < 4 * MOST_S


def test_hostile_files_take_neither_memory_nor_time(
    probed: dict[Callable[[Path], Path], list[Any]], promise: Callable[..., Drill]
) -> None:
    drill = promise("R14", wanted=f"clear error; < {MOST_MB} MB, < {MOST_S} s for small files with large headers")
    most_mb, most_s = (max(found[k] for found in probed.values()) for k in (1, 2))
    drill.measured = f"{len(probed)} files: at most {most_mb:.0f} MB, {most_s:.1f} s"
    drill.keep_to(most_s, MOST_S)
    assert most_mb < MOST_MB


def plain_sound(path: Path) -> Path:
    """10 s of pictures and of PCM sound, whose table says 480,000 samples."""
    with av.open(str(path), "w") as output:
        pictures: Any = output.add_stream("libx264", rate=25)
        pictures.width, pictures.height, pictures.pix_fmt = 96, 64, "yuv420p"
        sound: Any = output.add_stream("pcm_s16le", rate=48000, layout="mono")
        for second in range(10):
            for frame in range(25):
                picture = av.VideoFrame(96, 64, "yuv420p")
                picture.pts, picture.time_base = 25 * second + frame, Fraction(1, 25)
                output.mux(pictures.encode(picture))
            block = av.AudioFrame.from_ndarray(np.zeros((1, 48000), np.int16), format="s16", layout="mono")
            block.sample_rate, block.pts = 48000, 48000 * second
            output.mux(sound.encode(block))
        output.mux(pictures.encode(None))
    return path


def test_an_index_is_counted_as_libav_builds_it(samples: Samples, tmp_path: Path) -> None:
    paths = [
        samples.woman_clip,
        plain_sound(tmp_path / "plain.mov"),
        add_tone(samples.woman_clip, 3, 1, tmp_path / "a.mp4"),
    ]
    for path in paths:
        with av.open(str(path)) as clip:
            built = sum(len(stream.index_entries) for stream in clip.streams)
        assert index_entries(path, sniff(path)) == built
        assert probe(path).has_audio or path == samples.woman_clip


@pytest.mark.parametrize("name", ["a.mp4", "a.mov", "a.mkv", "a.avi"])
def test_honest_clips_pass(name: str, tmp_path: Path) -> None:
    hostile.honest_clip(tmp_path / name)
    assert probe(tmp_path / name).frame_count == 12
    assert index_entries(tmp_path / name, sniff(tmp_path / name)) <= 24


def test_a_cover_that_happens_to_spell_a_table_is_no_table(tmp_path: Path) -> None:
    path = tmp_path / "cover.mp4"
    data = hostile.honest_clip(path, movflags="faststart")
    cover = hostile.box(b"covr", hostile.box(b"data", bytes(8) + b"stsz" + b"\xff" * 12))
    tags = hostile.box(b"udta", hostile.box(b"meta", bytes(4) + hostile.box(b"ilst", cover)))
    at = data.index(b"moov") - 4
    size = int.from_bytes(data[at : at + 4], "big")
    path.write_bytes(
        data[:at] + (size + len(tags)).to_bytes(4, "big") + data[at + 4 : at + size] + tags + data[at + size :]
    )
    assert index_entries(path, "mp4") == 12
