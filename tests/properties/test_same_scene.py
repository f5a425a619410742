"""One scene, coded as SDR, PQ, HLG and camera logarithms, gets one look: its skin is the same when shown in SDR."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from skimage.color import deltaE_ciede2000, rgb2lab

import pvg
from pvg.face import layout
from pvg.rendering import source_frame
from pvg.video import ColorSpace, Frame, PixelFormat, VideoWriter, color_space, named_space, probe, read_frames

FRAMES = 3
BT2020 = (0.2627, 0.0593)
WAYS: dict[str, tuple[ColorSpace | None, tuple[int, int, int], str]] = {  # space, H.273 tags, input_color
    "pq": (color_space(9, 16), (9, 9, 16), "auto"),
    "hlg": (color_space(9, 18), (9, 9, 18), "auto"),
    "wide": (color_space(9, 14), (9, 9, 14), "auto"),
    "slog3": (named_space("slog3"), (1, 1, 1), "slog3"),
    "logc3": (named_space("logc3"), (1, 1, 1), "logc3"),
}


def coded(source: Path, folder: Path, way: str) -> Path:
    """The first frames of a clip coded in 10 bits, 4:2:0, without loss, by one of WAYS or as SDR."""
    info = probe(source)
    space, tags, _ = WAYS.get(way, (None, (1, 1, 1), "auto"))
    weights = BT2020 if tags[0] == 9 else (0.2126, 0.0722)
    target = PixelFormat("yuv420p10le", 10, (1, 1), weights, False, space)
    info = replace(info, color_matrix=tags[0], color_primaries=tags[1], color_transfer=tags[2], has_audio=False)
    path = folder / f"{way}.mkv"
    with VideoWriter(path, info, target, codec="hevc", crf=0) as writer:
        for frame in read_frames(source, stop=FRAMES):
            shown = frame.format.to_rgb(frame.planes)
            own = shown if space is None else space.from_sdr(shown.reshape(-1, 3)).reshape(shown.shape)
            writer.write(Frame(frame.index, frame.pts, frame.time_s, target, target.from_rgb(own), frame.duration))
    return path


@pytest.fixture(scope="module")
def looked_at(
    dark_reference: pvg.VectorVideo, short_clip: Path, tmp_path_factory: pytest.TempPathFactory
) -> Callable[[str], tuple[np.ndarray, np.ndarray]]:
    """For a way of coding: a frame as an SDR display shows it, without and with a dark portrait's look and make-up."""
    folder = tmp_path_factory.mktemp("same")
    done: dict[str, tuple[np.ndarray, np.ndarray]] = {}

    def look_at(way: str) -> tuple[np.ndarray, np.ndarray]:
        if way not in done:
            path = coded(short_clip, folder, way)
            color = WAYS[way][2] if way in WAYS else "auto"
            with pvg.vectorize(path, input_color=color) as video:
                plain = source_frame(video, 2).rgb()
                done[way] = plain, pvg.render_frame(video, pvg.transfer(video, dark_reference, makeup=1.0), 2)
        return done[way]

    return look_at


@pytest.fixture(scope="module")
def skin(looked_at: Callable[[str], tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """(H, W) bool: pixels that the look changes clearly in SDR."""
    plain, drawn = (rgb2lab(rgb) for rgb in looked_at("sdr"))
    return np.asarray(np.abs(plain - drawn).sum(axis=-1) > 12.0)


@pytest.fixture(scope="module")
def lips(short_clip: Path, skin: np.ndarray) -> np.ndarray:
    """(H, W) bool: pixels between the outlines of the lips."""
    drawn = np.zeros(skin.shape, np.uint8)
    with pvg.vectorize(short_clip) as video:
        points = video.face_at(0, 2).landmarks.points
    for outline, inside in ((layout.LIPS_OUTER, 1), (layout.LIPS_INNER, 0)):
        cv2.fillPoly(drawn, [np.rint(points[outline]).astype(np.int32)], inside)
    return np.asarray(drawn > 0)


@pytest.mark.parametrize("way", WAYS)
def test_the_same_scene_gets_the_same_skin(
    way: str, looked_at: Callable[[str], tuple[np.ndarray, np.ndarray]], skin: np.ndarray
) -> None:
    wanted, drawn = (rgb2lab(looked_at(one)[1][skin]) for one in ("sdr", way))
    assert skin.mean() > 0.05
    assert float(deltaE_ciede2000(np.median(wanted, axis=0), np.median(drawn, axis=0))) < 2.0
    assert float(np.median(deltaE_ciede2000(wanted, drawn))) < 2.0


@pytest.mark.parametrize("way", WAYS)
def test_the_same_scene_gets_the_same_lips(
    way: str, looked_at: Callable[[str], tuple[np.ndarray, np.ndarray]], lips: np.ndarray
) -> None:
    wanted, drawn = (np.median(rgb2lab(looked_at(one)[1][lips]), axis=0) for one in ("sdr", way))
    assert float(deltaE_ciede2000(wanted, drawn)) < 1.5


@pytest.mark.parametrize("way", ["pq", "hlg"])
def test_taken_for_sdr_the_same_skin_would_be_glaringly_off(
    way: str,
    looked_at: Callable[[str], tuple[np.ndarray, np.ndarray]],
    skin: np.ndarray,
    tmp_path: Path,
    short_clip: Path,
) -> None:
    plain = looked_at("sdr")[0][skin]
    (frame,) = read_frames(coded(short_clip, tmp_path, way), start=2, stop=3, input_color="sdr")
    assert float(np.median(deltaE_ciede2000(rgb2lab(plain), rgb2lab(frame.rgb()[skin])))) > 5.0
