"""Code values and RGB: how the planes of a frame relate to red, green and blue, and the frame itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import av
import cv2
import numpy as np
from numpy.typing import NDArray

from pvg._arrays import Bytes, Doubles, Floats
from pvg.errors import MediaError
from pvg.video._kernels import codes_to_rgb, codes_to_sdr
from pvg.video.color import ColorSpace

Plane = NDArray[np.uint8] | NDArray[np.uint16]
Planes = tuple[Plane, Plane, Plane]

UNSPECIFIED = 2
"""The code point of ISO/IEC 23091-2 (H.273) for "not stated": matrix, primaries and transfer alike."""

UNSTATED = (0, UNSPECIFIED, 3)
"""Code points that say nothing, as the reserved ones do; matrix 0 is that of R, G, B, and ProRes's unknown."""

RANGE_LIMITED, RANGE_FULL = 1, 2

SCALER_THREADS = 1
"""Of libav's scaler, which converts layouts: it writes some samples past the end of a row, into the next one, and with
several threads that one may belong to another, which was done with it."""

LUMA_WEIGHTS = {  # H.273 matrix code point -> (K_R, K_B)
    1: (0.2126, 0.0722),  # BT.709
    4: (0.30, 0.11),  # FCC 73.682
    5: (0.299, 0.114),  # BT.601, 625 lines
    6: (0.299, 0.114),  # BT.601, 525 lines
    7: (0.212, 0.087),  # SMPTE 240M
    9: (0.2627, 0.0593),  # BT.2020
}

_CHROMA_NAMES = {(1, 1): "420", (1, 0): "422", (0, 0): "444"}


@dataclass(frozen=True)
class PixelFormat:
    """What the three planes of a frame mean.

    name: the libav name of the layout ("yuv420p", "yuv422p10le", …; "gbrp", "gbrp10le", …, "rgb24" or "rgb48le" for R,
        G, B planes).
    depth: bits a sample: 8, 10 or 12, R, G, B planes also 16; a plane is uint8 at 8 bits and uint16 above.
    chroma_log2: (x, y), the binary logarithm of the chroma planes' subsampling; (0, 0) for RGB.
    luma_weights: (K_R, K_B) of the Y'CbCr matrix; None when the planes are R, G, B themselves.
    full_range: True when black and white are 0 and 2^depth - 1 rather than the studio range.
    color: what the R'G'B' of the planes stands for; None for SDR, whose values are taken as they are.
    """

    name: str
    depth: int
    chroma_log2: tuple[int, int]
    luma_weights: tuple[float, float] | None
    full_range: bool
    color: ColorSpace | None = None

    @property
    def is_rgb(self) -> bool:
        """True when the planes are R, G and B."""
        return self.luma_weights is None

    @property
    def chroma_step(self) -> int:
        """Pixels from one sample of chroma to the next, the longer of both ways."""
        return 1 << max(self.chroma_log2)

    def log2_of(self, plane: int) -> tuple[int, int]:
        """The binary logarithm (x, y) of one plane's subsampling."""
        return self.chroma_log2 if plane else (0, 0)

    @property
    def dtype(self) -> type[np.uint8] | type[np.uint16]:
        """The planes' sample type."""
        return np.uint8 if self.depth == 8 else np.uint16

    @cached_property
    def opponent(self) -> PixelFormat:
        """A format whose planes are luma and chroma: itself, or what R, G, B planes are converted to for that."""
        return replace(self, luma_weights=(0.299, 0.114), full_range=True) if self.is_rgb else self

    @cached_property
    def matrix(self) -> Doubles:
        """(3, 3): change in plane code values per unit of R, G, B on the 0–255 scale; rows are planes."""
        if self.luma_weights is None:
            return np.asarray(np.eye(3) * ((2**self.depth - 1) / 255.0))
        k_r, k_b = self.luma_weights
        luma = np.array([k_r, 1.0 - k_r - k_b, k_b])
        blue = (np.array([0.0, 0.0, 1.0]) - luma) / (2.0 * (1.0 - k_b))
        red = (np.array([1.0, 0.0, 0.0]) - luma) / (2.0 * (1.0 - k_r))
        step = 2 ** (self.depth - 8)
        y_span, c_span = (2**self.depth - 1, 2**self.depth - 1) if self.full_range else (219 * step, 224 * step)
        rows: Doubles = np.stack([y_span * luma, c_span * blue, c_span * red]) / 255.0
        return rows

    @cached_property
    def offset(self) -> Doubles:
        """(3,): the code values of black."""
        if self.luma_weights is None:
            return np.zeros(3)
        middle = float(2 ** (self.depth - 1))
        black = 0.0 if self.full_range else float(16 * 2 ** (self.depth - 8))
        return np.array([black, middle, middle])

    @cached_property
    def levels_a_grey(self) -> float:
        """How many levels of 255 a level of middle SDR grey makes: 1 for SDR, about half for PQ and HLG."""
        return 1.0 if self.color is None else float(self.color.slope(np.array([128.0]))[0])

    def plane_shapes(self, width: int, height: int) -> tuple[tuple[int, int], tuple[int, int], tuple[int, int]]:
        """The (h, w) of the three planes of a width x height picture; chroma sizes round up."""
        x, y = self.chroma_log2
        chroma = (-(-height >> y), -(-width >> x))
        return (height, width), chroma, chroma

    def to_rgb(self, planes: Planes) -> Doubles:
        """(H, W, 3) float64, the clip's own R'G'B', 0–255, neither rounded nor clipped; chroma is raised bilinearly."""
        height, width = planes[0].shape
        full = [planes[0].astype(np.float64)]
        full += [raise_chroma(plane.astype(np.float64), self, width, height) for plane in planes[1:]]
        return (np.stack(full, axis=-1) - self.offset) @ np.linalg.inv(self.matrix).T

    def from_rgb(self, rgb: NDArray[Any]) -> Planes:
        """Planes of (H, W, 3) own R'G'B', 0–255; chroma is the mean of the pixels it covers."""
        codes = np.asarray(rgb, dtype=np.float64) @ self.matrix.T + self.offset
        luma, *chroma = (codes[..., k] for k in range(3))
        lowered = [_lower_chroma(plane, self) for plane in chroma]
        return (self._quantise(luma), self._quantise(lowered[0]), self._quantise(lowered[1]))

    def _quantise(self, codes: Doubles) -> Plane:
        """Code values (h, w) as samples, rounded and held to the depth's range."""
        quantised: Plane = np.clip(np.rint(codes), 0, 2**self.depth - 1).astype(self.dtype)  # type: ignore[assignment]
        return quantised

    def fast_rgb(self, planes: Planes) -> Bytes:
        """(H, W, 3) uint8 RGB as an SDR display shows it.

        For SDR within 2 levels of the rounded `to_rgb` (chroma is raised in code values).
        """
        height, width = planes[0].shape
        if self.color is not None:
            return self.shown(planes[0], *(raise_chroma(plane, self, width, height) for plane in planes[1:]))
        if self.is_rgb:
            merged = cv2.merge(planes)
            return _as_uint8(merged if self.depth == 8 else cv2.convertScaleAbs(merged, alpha=1.0 / self.matrix[0, 0]))
        codes = cv2.merge([planes[0], *(raise_chroma(plane, self, width, height) for plane in planes[1:])])
        inverse = np.linalg.inv(self.matrix)
        affine = np.column_stack([inverse, -inverse @ self.offset])
        if self.depth == 8:
            return _as_uint8(cv2.transform(codes, affine))
        # transform() answers in the depth it was given: 16-bit steps of 1/256 level keep the precision
        return _as_uint8(cv2.convertScaleAbs(cv2.transform(codes, affine * 256.0), alpha=1.0 / 256.0))

    def shown(self, first: NDArray[Any], second: NDArray[Any], third: NDArray[Any]) -> Bytes:
        """(h, w, 3) uint8 RGB as an SDR display shows codes of three planes of one size (h, w), perhaps fractions."""
        out = np.empty((*first.shape, 3), np.uint8)
        if self.color is None:
            codes_to_rgb(first, second, third, *self._affine, out)
        else:
            codes_to_sdr(first, second, third, *self._affine, self.color.tables, out)
        return out

    @cached_property
    def _affine(self) -> tuple[Floats, Floats]:
        """The (3, 3) matrix and (3,) offset from codes to the clip's own R'G'B', 0–255."""
        inverse = np.linalg.inv(self.matrix)
        return inverse.astype(np.float32), (-inverse @ self.offset).astype(np.float32)


def _as_uint8(array: Any) -> Bytes:
    return np.asarray(array, dtype=np.uint8)


def raise_chroma(plane: NDArray[Any], pixel_format: PixelFormat, width: int, height: int) -> NDArray[Any]:
    """A chroma plane of `pixel_format` at the luma's (height, width), bilinear."""
    x, y = pixel_format.chroma_log2
    if (x, y) == (0, 0):
        return plane
    size = (
        plane.shape[1] << x,
        plane.shape[0] << y,
    )  # resize to the exact factor, so that odd sizes stay in place
    return np.asarray(cv2.resize(plane, size, interpolation=cv2.INTER_LINEAR))[:height, :width]


def _lower_chroma(plane: Doubles, pixel_format: PixelFormat) -> Doubles:
    """A chroma plane (H, W) at the luma's size averaged over the pixels of each sample, the edge repeated."""
    x, y = pixel_format.chroma_log2
    height, width = plane.shape
    padded = np.pad(plane, ((0, -height % (1 << y)), (0, -width % (1 << x))), mode="edge")
    blocks = padded.reshape(padded.shape[0] >> y, 1 << y, padded.shape[1] >> x, 1 << x)
    return np.asarray(blocks.mean(axis=(1, 3)))


RGB24 = PixelFormat("rgb24", 8, (0, 0), None, True)
"""Still pictures: three uint8 planes R, G, B."""

RGB48 = PixelFormat("rgb48le", 16, (0, 0), None, True)
"""Still pictures of 16 bits a sample: three uint16 planes R, G, B."""


@dataclass(frozen=True, eq=False)
class Patch:
    """New samples for a rectangle of a plane: `samples` (h, w) from row y, column x of plane number `plane` on."""

    plane: int
    y: int
    x: int
    samples: NDArray[Any]

    def lay_over(self, target: NDArray[Any]) -> None:
        """Write the samples into a whole plane; what lies beyond it is dropped."""
        part = target[self.y : self.y + self.samples.shape[0], self.x : self.x + self.samples.shape[1]]
        part[:] = self.samples[: part.shape[0], : part.shape[1]]


@dataclass(frozen=True, eq=False)
class Frame:
    """One upright picture of a clip, or a still image.

    index: display order, from 0. pts: time stamp in units of the clip's time base. time_s: the same in seconds.
    duration: in units of the time base; 0 when the container does not say.
    planes: three (h, w) arrays, uint8 or uint16; chroma planes have their own size. Treat them as read-only.
    alpha: (H, W) samples of the planes' type, 0 to 2^depth - 1, as stored beside colours that are not premultiplied;
    None for an opaque picture. No look changes it.
    """

    index: int
    pts: int
    time_s: float
    format: PixelFormat
    planes: Planes
    duration: int = 0
    alpha: Plane | None = None
    _cache: dict[str, Bytes] = field(default_factory=dict, init=False, repr=False)

    @property
    def width(self) -> int:
        """Pixels a row."""
        return int(self.planes[0].shape[1])

    @property
    def height(self) -> int:
        """Rows."""
        return int(self.planes[0].shape[0])

    def over(self, plane: int, window: tuple[int, int, int, int]) -> Plane:
        """The samples of a plane over the pixels x0 … x1 − 1, y0 … y1 − 1, as far as the picture goes; a view.

        window: x0, y0, x1, y1, the first two multiples of the chroma step.
        """
        (x0, y0, x1, y1), (log2x, log2y) = window, self.format.log2_of(plane)
        part: Plane = self.planes[plane][y0 >> log2y : -(-y1 >> log2y), x0 >> log2x : -(-x1 >> log2x)]
        return part

    def rgb(self) -> Bytes:
        """(H, W, 3) uint8 RGB as an SDR display shows the frame, computed once; do not write into it."""
        if "rgb" not in self._cache:
            self._cache["rgb"] = self.format.fast_rgb(self.planes)
            self._cache["rgb"].flags.writeable = False
        return self._cache["rgb"]

    def patched(self, patches: Sequence[Patch]) -> Frame:
        """The same instant with patches laid over copies of its planes, in their order; itself without any."""
        if not patches:
            return self
        first, second, third = (plane.copy() for plane in self.planes)
        for patch in patches:
            patch.lay_over((first, second, third)[patch.plane])
        return replace(self, planes=(first, second, third))


def is_high_definition(width: int, height: int) -> bool:
    """Whether players take an untagged picture of this size for BT.709 rather than BT.601.

    The usual rule (1280 wide, or more than 576 lines) made independent of rotation.
    """
    return max(width, height) >= 1280 or min(width, height) > 576


def resolve_format(
    av_name: str, width: int, height: int, matrix: int, color_range: int, color: ColorSpace | None = None
) -> PixelFormat:
    """The supported format nearest to a decoder's.

    av_name: libav pixel format; matrix, color_range: H.273 code points as coded (2 and 0: unspecified, of the
    matrix also 0 and 3, which Y'CbCr cannot have);
    color: what its R'G'B' stands for.
    Anything RGB-like becomes "gbrp", "gbrp10le", "gbrp12le" or "gbrp16le"; other depths and subsamplings go to the next
    one that loses nothing (Y'CbCr above 12 bits: 12). Raises MediaError for a matrix that is not a plain Y'CbCr one.
    """
    source = av.VideoFormat(av_name, 64, 64)
    bits = max(component.bits for component in source.components)
    if source.is_rgb or source.has_palette or source.is_bayer or av_name.startswith(("xyz", "mono")):
        depth = next((depth for depth in (8, 10, 12) if bits <= depth), 16)
        return PixelFormat("gbrp" if depth == 8 else f"gbrp{depth}le", depth, (0, 0), None, True, color)
    depth = 8 if bits <= 8 else 10 if bits <= 10 else 12
    if matrix in UNSTATED:
        weights = LUMA_WEIGHTS[1 if is_high_definition(width, height) else 6]
    elif matrix in LUMA_WEIGHTS:
        weights = LUMA_WEIGHTS[matrix]
    else:
        raise MediaError(f"colour matrix {matrix} (ISO/IEC 23091-2) is not supported; re-encode the clip as BT.709")
    colored = len(source.components) >= 3
    # 4:1:1 keeps its rows in 4:2:2, 4:4:0 its columns in 4:4:4; grey gets neutral chroma at the least size
    narrow, low = source.chroma_width(64) < 64, source.chroma_height(64) < 64
    chroma = (int(narrow), int(narrow and low)) if colored else (1, 1)
    name = f"yuv{_CHROMA_NAMES[chroma]}p" + ("" if depth == 8 else f"{depth}le")
    full = color_range == RANGE_FULL or av_name.startswith("yuvj")
    return PixelFormat(name, depth, chroma, weights, full, color)
