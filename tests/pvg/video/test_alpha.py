"""Alpha and deep R, G, B planes of clips."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from pvg.video import probe, read_frames, read_streams
from tests.gallery.clips import encode_raw, write_clip

SIZE = (64, 48)


def with_alpha(layout: str, shift: int = 0) -> av.VideoFrame:
    """A grey ramp with another ramp as its alpha, in steps of 8 bits."""
    ramp = np.tile(np.arange(64, dtype=np.uint8) * 4, (48, 1))
    alpha = np.roll(np.tile(np.arange(48, dtype=np.uint8)[:, None] * 5, (1, 64)), shift, 0)
    picture = av.VideoFrame.from_ndarray(np.dstack([ramp, ramp, ramp, alpha]), format="rgba")
    return picture if layout == "rgba" else picture.reformat(format=layout)


@pytest.mark.parametrize(
    ("name", "codec", "layout", "delivered", "options", "error"),
    [
        ("a.mov", "prores_ks", "yuva444p10le", "yuv444p12le", {}, 0.003),
        ("a.webm", "libvpx-vp9", "yuva420p", "yuv420p", {"crf": "4", "b": "0"}, 0.01),
        ("b.webm", "libvpx", "yuva420p", "yuv420p", {"auto-alt-ref": "0", "b": "4000000"}, 0.01),
        ("a.mkv", "ffv1", "yuva420p", "yuv420p", {}, 0.004),
        ("b.mkv", "ffv1", "yuva422p10le", "yuv422p10le", {}, 0.004),
        ("c.mkv", "ffv1", "yuva420p16le", "yuv420p12le", {}, 0.004),
        ("d.mkv", "ffv1", "ya8", "yuv420p", {}, 0.004),
        ("e.mkv", "ffv1", "gbrap10le", "gbrp10le", {}, 0.004),
        ("f.mkv", "ffv1", "gbrap12le", "gbrp12le", {}, 0.004),
        ("g.mkv", "ffv1", "rgba64le", "gbrp16le", {}, 0.0001),
        ("b.mov", "qtrle", "argb", "gbrp", {}, 0),
        ("c.mov", "png", "rgba", "gbrp", {}, 0),
    ],
)
def test_alpha_of_clips_is_read(
    name: str, codec: str, layout: str, delivered: str, options: dict[str, str], error: float, tmp_path: Path
) -> None:
    pictures = [with_alpha(layout, k) for k in range(6)]
    path = encode_raw(tmp_path / name, pictures, codec, **options)
    info, frames = probe(path), list(read_frames(path))
    assert info.has_alpha
    assert read_streams(path).alpha
    assert info.format.name == delivered
    assert info.frame_count == len(frames) == 6
    for k, frame in enumerate(frames):
        assert frame.alpha is not None
        assert frame.alpha.dtype == info.format.dtype
        expected = np.roll(np.arange(48) * 5, k)[:, None] / 255.0
        assert np.abs(frame.alpha / (2.0**info.format.depth - 1) - expected).max() <= error + 1e-9
    part = [frame.alpha for frame in read_frames(path, start=3, stop=5)]
    for read, frame in zip(part, frames[3:5], strict=True):
        np.testing.assert_array_equal(read, frame.alpha)


def test_alpha_is_turned_with_its_picture(tmp_path: Path) -> None:
    pictures = [with_alpha("argb") for _ in range(2)]
    (plain, *_), (turned, *_) = (
        list(read_frames(encode_raw(tmp_path / f"{degrees}.mov", pictures, "qtrle", degrees=degrees)))
        for degrees in (0, 90)
    )
    assert plain.alpha is not None
    np.testing.assert_array_equal(turned.alpha, np.rot90(plain.alpha))


def test_an_opaque_clip_has_no_alpha(tmp_path: Path) -> None:
    path = encode_raw(tmp_path / "a.mkv", [with_alpha("yuv420p")], "ffv1")
    assert not probe(path).has_alpha
    assert not read_streams(path).alpha
    assert next(read_frames(path)).alpha is None


@pytest.mark.parametrize(
    ("layout", "delivered"),
    [
        ("gbrp9le", "gbrp10le"),
        ("gbrp10le", "gbrp10le"),
        ("gbrp12le", "gbrp12le"),
        ("gbrp16le", "gbrp16le"),
        ("rgb48le", "gbrp16le"),
    ],
)
def test_deep_rgb_clips_keep_their_depth(layout: str, delivered: str, tmp_path: Path) -> None:
    depth = 16 if "48" in layout else int("".join(c for c in layout if c.isdigit()))
    planes = np.random.default_rng(1).integers(0, 2**depth, (48, 64, 3), dtype=np.uint16)
    if layout == "rgb48le":
        picture = av.VideoFrame.from_ndarray(planes, format=layout)
    else:
        picture = av.VideoFrame(*SIZE, layout)
        for k, component in enumerate(picture.format.components):
            target: Any = picture.planes[component.plane]
            rows = np.frombuffer(memoryview(target), np.uint16).reshape(48, -1)
            rows[:, :64] = planes[..., k]
    path = encode_raw(tmp_path / "a.mkv", [picture], "ffv1")
    frame = next(read_frames(path))
    assert frame.format.name == delivered
    shift = frame.format.depth - depth
    read = np.stack(frame.planes, axis=-1).astype(int)
    assert np.abs(read - (planes.astype(int) << shift)).max() <= (1 if shift else 0)
    assert np.abs(frame.rgb() - planes * (255 / (2**depth - 1))).max() <= 0.75
    # and such frames can be encoded
    written = write_clip(tmp_path / "out.mkv", [frame], probe(path), codec="hevc", crf=0)
    assert probe(written).format.depth == min(12, frame.format.depth)
