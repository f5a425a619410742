"""Pictures without faces, and frames made of them."""

from __future__ import annotations

import cv2
import numpy as np

from pvg.video import RGB24, RGB48, Frame, PixelFormat

YUV420 = PixelFormat("yuv420p", 8, (1, 1), (0.2126, 0.0722), False)
YUV422_10 = PixelFormat("yuv422p10le", 10, (1, 0), (0.2126, 0.0722), False)
YUV444 = PixelFormat("yuv444p", 8, (0, 0), (0.299, 0.114), True)
FORMATS = (YUV420, YUV422_10, YUV444, RGB24, RGB48)
"""Every kind of planes: three depths, three samplings of chroma, limited and full range, and RGB."""


def frame_of(rgb: np.ndarray, pixel_format: PixelFormat) -> Frame:
    """A picture as the planes of a frame."""
    return Frame(0, 0, 0.0, pixel_format, pixel_format.from_rgb(rgb))


def colorful(seed: int, size: tuple[int, int] = (96, 64)) -> np.ndarray:
    """A smooth picture (H, W, 3) uint8 of strong colours; size: (width, height)."""
    noise = np.random.default_rng(seed).uniform(0, 255, (size[1], size[0], 3)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 4)
    return np.asarray(np.clip((smooth - 127.5) * 6 + 127.5, 0, 255), dtype=np.uint8)


def waves(height: int, width: int) -> np.ndarray:
    """Muted colours (H, W, 3) that change slowly, so that subsampled chroma holds them."""
    y, x = np.mgrid[:height, :width]
    shades = [np.sin(x / 17 + k) * np.cos(y / 23 - k) for k in range(3)]
    return np.clip(128 + 40 * np.stack(shades, axis=-1), 0, 255)


def patchwork(seed: int) -> np.ndarray:
    """48x48 pixels (48, 48, 3) in squares of flat colours, with noise."""
    rng = np.random.default_rng(seed)
    squares = rng.uniform(30, 220, (6, 6, 3)).repeat(8, axis=0).repeat(8, axis=1)
    return np.asarray(np.clip(squares + rng.normal(0, 6, squares.shape), 0, 255))


def texture(shift: tuple[int, int] = (0, 0), size: int = 160) -> np.ndarray:
    """A square (size, size, 3) uint8 of fine texture that has moved by `shift` (x, y) pixels."""
    noise = np.random.default_rng(1).normal(0, 1, (size + 40, size + 40, 3)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 2.5)
    picture = np.clip(128 + 200 * smooth, 0, 255).astype(np.uint8)
    y, x = 20 - shift[1], 20 - shift[0]
    return np.ascontiguousarray(picture[y : y + size, x : x + size])


def background(seed: int, width: int = 480, height: int = 320) -> np.ndarray:
    """A blurred room: large soft patches of colour (H, W, 3) uint8 in which no face is found."""
    coarse = np.random.default_rng(seed).integers(30, 220, (4, 6, 3)).astype(np.uint8)
    return cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)


def pasted(picture: np.ndarray, part: np.ndarray, x: int, y: int) -> np.ndarray:
    """A copy of a picture with a smaller one laid over it, its corner at x, y."""
    out = picture.copy()
    out[y : y + part.shape[0], x : x + part.shape[1]] = part
    return out
