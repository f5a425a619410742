"""The methods compared, ours and others', behind one call: a frame in, one picture a reference out.

Every peer sees the same decoded frames. Those that work on the face get our own soft matte and landmarks (a gift: they
would have to find them), except the paper's mask, which is a row of its own. Whole-frame ones are given whole
pictures, as their users do.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import sqrtm
from scipy.spatial import KDTree

import pvg
from benchmarks.quality.faces import Bools, Floats, Image, Reference, View, sample_pixels
from pvg.asset import KeyFrame
from pvg.looks import sliced_transport
from pvg.rendering import Renderer
from pvg.rendering.placed_face import PlacedFace
from pvg.skin import skin_mask
from pvg.vectorization.key_colors import fit_key_frame
from pvg.video import Frame

try:
    from skimage.exposure import match_histograms
except ImportError:
    match_histograms = None
try:
    from color_matcher import ColorMatcher  # type: ignore[import-untyped, unused-ignore]
except ImportError:
    ColorMatcher = None

DEEP = "ours, λ = 1, in 12 bits"
OURS = ("ours", "ours, λ = 1", "ours, scene = 0")  # the defaults; then without contrast, and with nothing for the scene
AT_LAMBDA_ONE = OURS[1:2]
FULL = "ours, full light and parts"  # drawn where the measure asks for it, when the library has those options
PAPER = "the paper's way"  # all colours transported, the chain with reset, λ = 1, our mask
PAPER_MASK = "the paper's way, its Cr mask"
MK, LINEAR, REINHARD = "masked Monge-Kantorovich (Lab)", "masked linear (RGB)", "masked Reinhard (Lab)"
RASTER = "raster OMT"
HISTOGRAMS = "match_histograms"
PAPERS_TRANSFER: dict[str, Any] = {"contrast": 1.0, "match": "color"}
NEEDS = {HISTOGRAMS: "scikit-image", "color-matcher mkl": "color-matcher"}
_OMT_SAMPLE = 4000
_LIKE = 8
_MORE_BITS = 4


@dataclass(frozen=True, eq=False)
class Drawn:
    """A result: rgb (H, W, 3) uint8, and its luma plane where the method writes the clip's own planes."""

    rgb: Image
    plane: NDArray[Any] | None = None

    def luma(self, frame: Frame, window: tuple[slice, slice]) -> Floats:
        """Luma over a window as the clip's format stores it, rounded, in code values: (h, w) float32."""
        if self.plane is not None:
            return self.plane[window].astype(np.float32)
        # a clip keeps 8-bit luma, so pictures computed in RGB are rounded to it as well
        row = frame.format.matrix[:1].astype(np.float32)
        luma = cv2.transform(self.rgb[window].astype(np.float32), row)
        return np.asarray(np.rint(luma + np.float32(frame.format.offset[0])), np.float32)


class Method(Protocol):
    """A method opened for one clip and its references."""

    @property
    def name(self) -> str:
        """Its column in the tables."""

    @property
    def costly(self) -> bool:
        """Whether it is slow and drawn on pairs of frames only."""

    def draw(self, frame: Frame, view: View) -> list[Drawn]:
        """The frame in the colours of every reference."""


@dataclass(frozen=True, eq=False)
class Looks:
    """Our renderer on an asset: ours, or the paper's way when the asset was made with its chain."""

    name: str
    renderer: Renderer
    costly: bool = False

    @classmethod
    def of(cls, name: str, video: pvg.VectorVideo, face: int, references: Sequence[Reference], **options: Any) -> Looks:
        """One look a reference, on one face."""
        looks = [pvg.transfer(video, reference.video, faces=[face], **options) for reference in references]
        return cls(name, Renderer(video, looks))

    def draw(self, frame: Frame, view: View) -> list[Drawn]:
        return [_of_frame(drawn) for drawn in self.renderer.draw(frame)]


def _of_frame(frame: Frame) -> Drawn:
    return Drawn(frame.rgb(), None if frame.format.is_rgb else frame.planes[0])


@dataclass(frozen=True, eq=False)
class DeepLooks:
    """Our renderer on the same frames held in 12 bits: what is lost to rounding in 8 bits, and what by the method."""

    name: str
    renderer: Renderer
    costly: bool = True

    def draw(self, frame: Frame, view: View) -> list[Drawn]:
        if frame.format.is_rgb or frame.format.depth != 8:
            return [_of_frame(drawn) for drawn in self.renderer.draw(frame)]
        deep = replace(frame.format, name=f"{frame.format.name}12le", depth=12)
        y, b, r = (np.asarray(plane.astype(np.uint16) << _MORE_BITS, np.uint16) for plane in frame.planes)
        drawn = self.renderer.draw(replace(frame, format=deep, planes=(y, b, r)))
        return [Drawn(picture.rgb(), picture.planes[0] / np.float32(1 << _MORE_BITS)) for picture in drawn]


def _blend(rgb: Image, view: View, new: NDArray[Any]) -> Image:
    """The frame with `new` (h, w, 3) in the view's window, under the matte."""
    out = rgb.copy()
    part = out[view.window]
    mixed = part + view.alpha[..., None] * (np.asarray(new, np.float32) - part)
    part[:] = np.clip(np.rint(mixed), 0, 255).astype(np.uint8)
    return out


def _window_of(placed: PlacedFace) -> tuple[slice, slice]:
    """Rows and columns of the picture that a face is drawn in."""
    h, w = placed.alpha.shape
    return slice(placed.y, placed.y + h), slice(placed.x, placed.x + w)


def _laid_in(rgb: Image, placed: PlacedFace, share: Floats | Bools, changes: Sequence[Floats]) -> list[Drawn]:
    """The frame with the membrane of each change (S, 3) of the curves' colours, by the share (h, w) of each pixel."""
    h, w = placed.alpha.shape
    window = _window_of(placed)
    field = placed.membrane(np.concatenate(changes, axis=1)).crop(placed.x, placed.y, w, h)
    pictures = []
    for k in range(len(changes)):
        out = rgb.copy()
        moved = rgb[window] + share[..., None] * field[..., 3 * k : 3 * k + 3]
        out[window] = np.clip(np.rint(moved), 0, 255).astype(np.uint8)
        pictures.append(Drawn(out))
    return pictures


@dataclass(frozen=True, eq=False)
class PerFrame:
    """Every frame vectorised and transported on its own, as the image method extended to a clip frame by frame does.

    The rotations are seeded alike in every frame; fresh ones would flicker more.
    """

    references: Sequence[Reference]
    name: str = "per-frame vectorisation"
    costly: bool = True

    def draw(self, frame: Frame, view: View) -> list[Drawn]:
        rgb, placed = frame.rgb(), view.placed
        if placed is None:
            return [Drawn(rgb)] * len(self.references)
        g, visible = fit_key_frame(rgb, view.matte, placed.positions, view.width, 0)
        changes = [self._change(g, visible, reference) for reference in self.references]
        return _laid_in(rgb, placed, placed.alpha, changes)

    def _change(self, g: Floats, visible: NDArray[np.bool_], reference: Reference) -> Floats:
        wanted = reference.key.colors[reference.key.visible]
        new = sliced_transport(g[visible], wanted, rng=np.random.default_rng(0))
        shift = np.zeros_like(g)
        shift[visible] = new - g[visible]
        if not visible.all():  # hidden samples follow the visible ones of like colour
            count = min(_LIKE, int(visible.sum()))
            _, nearest = KDTree(g[visible]).query(g[~visible], k=count)
            shift[~visible] = shift[visible][np.asarray(nearest).reshape(-1, count)].mean(axis=1)
        return np.asarray(np.clip(g + shift, 0, 255) - g, np.float32)


@dataclass(frozen=True, eq=False)
class RasterTransport:
    """The sliced transport of eq. (7, 8) on the face's pixels, frame by frame; equal colours are moved once."""

    references: Sequence[Reference]
    name: str = RASTER
    costly: bool = True

    def draw(self, frame: Frame, view: View) -> list[Drawn]:
        rgb = frame.rgb()
        part = view.crop(rgb)
        touched = view.alpha > 0
        codes = part[touched].astype(np.uint32) @ np.array([1 << 16, 1 << 8, 1], np.uint32)
        values, back, counts = np.unique(codes, return_inverse=True, return_counts=True)
        colors = np.stack([values >> 16, (values >> 8) & 255, values & 255], axis=1).astype(np.float64)
        pictures = []
        for reference in self.references:
            wanted = sample_pixels(reference.face, _OMT_SAMPLE)
            moved = sliced_transport(colors, wanted, rng=np.random.default_rng(0), weights=counts)
            new = part.astype(np.float32)
            new[touched] = moved[back]
            pictures.append(Drawn(_blend(rgb, view, new)))
        return pictures


Change = Callable[[Floats], NDArray[Any]]
"""Colours (..., 3) float32, 0-255 RGB, to new ones."""


@dataclass(eq=False)
class Replayed:
    """A map of colours fitted on the face of the first frame that is drawn, and replayed under our matte."""

    name: str
    references: Sequence[Reference]
    fit: Callable[[Image, Image], Change]
    costly: bool = False
    _changes: list[Change] | None = None

    def draw(self, frame: Frame, view: View) -> list[Drawn]:
        rgb = frame.rgb()
        part = view.crop(rgb)
        if self._changes is None:
            self._changes = [self.fit(part[view.face], reference.face) for reference in self.references]
        new = part.astype(np.float32)
        return [Drawn(_blend(rgb, view, change(new))) for change in self._changes]


def _to_lab(rgb: Floats) -> Floats:
    """OpenCV's CIELAB of colours (h, w, 3) or (n, 3), 0-255."""
    return np.asarray(cv2.cvtColor(np.atleast_3d(rgb / 255).reshape(len(rgb), -1, 3), cv2.COLOR_RGB2Lab), np.float32)


def _from_lab(colors: NDArray[Any]) -> Floats:
    return np.asarray(255 * cv2.cvtColor(colors.astype(np.float32), cv2.COLOR_Lab2RGB), np.float32)


def fit_linear(pixels: Image, wanted: Image) -> Change:
    """The Monge-Kantorovich map of RGB."""
    matrix, offset = linear_map(pixels.astype(np.float64), wanted.astype(np.float64))
    return lambda colors: np.asarray(colors @ matrix.T.astype(np.float32) + offset)


def fit_mk(pixels: Image, wanted: Image) -> Change:
    """The Monge-Kantorovich map of CIELAB."""
    first, second = (_to_lab(colors.astype(np.float32))[:, 0].astype(np.float64) for colors in (pixels, wanted))
    matrix, offset = linear_map(first, second)
    return lambda colors: _from_lab(_to_lab(colors) @ matrix.T.astype(np.float32) + offset)


def fit_reinhard(pixels: Image, wanted: Image) -> Change:
    """Means and standard deviations of CIELAB matched (Reinhard et al. 2001)."""
    first, second = (_to_lab(colors.astype(np.float32))[:, 0] for colors in (pixels, wanted))
    scale = second.std(axis=0) / np.maximum(first.std(axis=0), 1e-6)
    offset = second.mean(axis=0) - scale * first.mean(axis=0)
    return lambda colors: _from_lab(_to_lab(colors) * scale + offset)


@dataclass(frozen=True, eq=False)
class PaperMask:
    """The paper's way under its own rule for skin, pixel by pixel: 8-bit Cr in [140, 160], the largest component."""

    looks: Sequence[pvg.Look]
    keys: Sequence[KeyFrame]
    face: int
    name: str = PAPER_MASK
    costly: bool = False

    def draw(self, frame: Frame, view: View) -> list[Drawn]:
        rgb, placed = frame.rgb(), view.placed
        if placed is None:
            return [Drawn(rgb)] * len(self.looks)
        key = max((k for k, one in enumerate(self.keys) if one.frame <= frame.index), default=0)
        changes = [look.colors[self.face][key] - self.keys[key].colors for look in self.looks]
        corner = -np.array([placed.x, placed.y], np.float32)
        skin = skin_mask(rgb[_window_of(placed)], view.data.landmarks.moved(corner), mask="ycbcr")
        return _laid_in(rgb, placed, skin, changes)


def linear_map(
    pixels: NDArray[np.float64], wanted: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(T, t) of x -> T x + t that takes mean and covariance of `pixels` to those of `wanted`, T symmetric."""
    ridge = 1e-3 * np.eye(3)
    source, target = np.cov(pixels.T) + ridge, np.cov(wanted.T) + ridge
    root = np.real(sqrtm(source))
    inverse = np.linalg.inv(root)
    matrix = inverse @ np.real(sqrtm(root @ target @ root)) @ inverse
    return matrix, wanted.mean(axis=0) - matrix @ pixels.mean(axis=0)


@dataclass(frozen=True, eq=False)
class WholeFrame:
    """A function (frame, reference) -> picture on whole pictures, frame by frame."""

    name: str
    references: Sequence[Reference]
    function: Callable[[Image, Image], Image]
    costly: bool = True

    def draw(self, frame: Frame, view: View) -> list[Drawn]:
        return [Drawn(self.function(frame.rgb(), reference.rgb)) for reference in self.references]


def lab_mean_std(rgb: Image, reference: Image) -> Image:
    """Means and standard deviations of Lab matched (Reinhard et al. 2001, in OpenCV's CIELAB)."""
    source, target = (cv2.cvtColor(picture.astype(np.float32) / 255, cv2.COLOR_RGB2Lab) for picture in (rgb, reference))
    mean, spread = cv2.meanStdDev(source)
    wanted_mean, wanted_spread = cv2.meanStdDev(target)
    scale = (wanted_spread / np.maximum(spread, 1e-6)).ravel()
    moved = (source - mean.ravel()) * scale + wanted_mean.ravel()
    back = cv2.cvtColor(moved.astype(np.float32), cv2.COLOR_Lab2RGB)
    return np.asarray(np.clip(np.rint(back * 255), 0, 255), np.uint8)


def histograms(rgb: Image, reference: Image) -> Image:
    """scikit-image's histogram matching, channel by channel."""
    matched = match_histograms(rgb, reference, channel_axis=-1)
    return np.asarray(np.clip(np.rint(matched), 0, 255), np.uint8)


def color_matcher_mkl(rgb: Image, reference: Image) -> Image:
    """color-matcher's Monge-Kantorovich linear map."""
    matched = ColorMatcher().transfer(src=rgb.astype(np.float64), ref=reference.astype(np.float64), method="mkl")
    return np.asarray(np.clip(np.rint(matched), 0, 255), np.uint8)


def missing() -> dict[str, str]:
    """Method -> package, of the peers that are not installed."""
    absent = {HISTOGRAMS: match_histograms is None, "color-matcher mkl": ColorMatcher is None}
    return {name: NEEDS[name] for name, gone in absent.items() if gone}


def method_names() -> tuple[str, ...]:
    """All methods in the order of the tables' columns."""
    others = (PAPER, PAPER_MASK, MK, LINEAR, REINHARD, RASTER, HISTOGRAMS)
    return (*OURS, *(name for name in others if name not in missing()), DEEP)


def has_option(name: str) -> bool:
    """Whether the library's `transfer` knows an option."""
    return name in inspect.signature(pvg.transfer).parameters


def full_options() -> dict[str, Any]:
    """The options that carry light and parts wholly, those that the library has."""
    return {name: 1.0 for name in ("light", "makeup") if has_option(name)}


def open_methods(
    video: pvg.VectorVideo,
    face: int,
    paper: tuple[pvg.VectorVideo, int] | None,
    references: Sequence[Reference],
    *,
    full: bool = False,
) -> list[Method]:
    """All methods of the quality report; `paper` is the clip with the paper's chain and its face there.

    full: also ours with light and parts carried wholly, if the library has such options.
    """
    methods: list[Method] = [
        Looks.of(OURS[0], video, face, references),
        Looks.of(OURS[1], video, face, references, contrast=1.0),
        Looks.of(OURS[2], video, face, references, scene=0.0),
    ]
    if full and full_options():
        methods.append(Looks.of(FULL, video, face, references, **full_options()))
    if paper is not None:
        of_paper = Looks.of(PAPER, paper[0], paper[1], references, **PAPERS_TRANSFER)
        keys = paper[0].records[paper[1]].key_frames
        methods += [of_paper, PaperMask(of_paper.renderer.looks, keys, paper[1])]
    methods += [
        Replayed(MK, references, fit_mk),
        Replayed(LINEAR, references, fit_linear),
        Replayed(REINHARD, references, fit_reinhard),
        RasterTransport(references),
    ]
    if match_histograms is not None:
        methods.append(WholeFrame(HISTOGRAMS, references, histograms))
    methods.append(DeepLooks(DEEP, Looks.of(DEEP, video, face, references, contrast=1.0).renderer))
    return methods


def open_peers(references: Sequence[Reference]) -> list[Method]:
    """What a user could take instead, as the speed benchmark times it."""
    methods: list[Method] = [
        PerFrame(references),
        RasterTransport(references),
        Replayed(LINEAR, references, fit_linear),
    ]
    if match_histograms is not None:
        methods.append(WholeFrame(HISTOGRAMS, references, histograms))
    methods.append(WholeFrame("Lab mean/std", references, lab_mean_std))
    if ColorMatcher is not None:
        methods.append(WholeFrame("color-matcher mkl", references, color_matcher_mkl))
    return methods
