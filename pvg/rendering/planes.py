"""A correction applied to the samples of one face, in any coded format.

    P' = P + α ((λ − 1)(P − level) + H(g' − λg))            P' = P + α (R(F(S) + w H(g' − F(g))) − R(S))

with S the skin in P (`pvg.rendering.foreground`), which is P but for the matte's edge, the roll-off R towards black and
white, and w = 1 but for what is much darker than skin: brows, lashes and pupils go through black, P g'/g, and not along
the skin's tangent, which would lay a veil over them. λ and F act on luma and chroma one by one, so on the planes a clip
is coded in. Only the rectangle of the face is touched: the result is patches, which a writer lays over the frame it
copies anyway.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pvg._arrays import Doubles, Floats
from pvg.membrane import Lattice
from pvg.raster import sites
from pvg.rendering import _kernels as kernels
from pvg.rendering.correction import Correction
from pvg.rendering.foreground import Foreground, as_they_are
from pvg.rendering.guards import Guard
from pvg.rendering.map_tables import MapTables
from pvg.rendering.plane_samples import OverChroma, luma_bend, with_guards, with_patches
from pvg.rendering.rgb_planes import apply_to_rgb, opponent_of, stacked
from pvg.rendering.tinge import tinged
from pvg.video import Frame, Patch, PixelFormat

# of the skin around: from light like this on a pixel is skin, below it is a brow, a lash, a pupil [by eye]
_DARK = np.float32(0.4), np.float32(0.8)
_NO_FADE = np.empty((0, 0), np.float32)
_NO_ROLL_OFF = np.empty(0, np.float32)


def apply_correction(
    frame: Frame,
    corner: tuple[int, int],
    alpha: Floats,
    correction: Correction,
    *,
    under: Sequence[Patch] = (),
    guards: Sequence[tuple[Guard, float]] = (),
    fade: Floats | None = None,
    skin: Foreground | None = None,
    over_chroma: OverChroma | None = None,
) -> list[Patch]:
    """The new samples of one face in every plane.

    corner: x, y of the source pixel that alpha (h, w) starts at, multiples of the chroma step;  alpha: the face's
    matte, guards taken out;  under: patches of other faces that were laid before;  guards: what was taken out, each
    with what its colours are multiplied by;  fade: (h, w) of `fade_in_dark`, 1 everywhere when None, for F alone;
    skin: of `foreground`, for F alone, what the frame shows when None;  over_chroma: the same for all looks of a frame.
    """
    if frame.format.is_rgb:
        planes = skin.planes if skin else None
        return apply_to_rgb(frame, corner, alpha, correction, under=under, guards=guards, fade=fade, skin=planes)
    (left, upper), (height, width) = corner, alpha.shape
    pixel_format, contrast = frame.format, correction.contrast
    over_chroma = over_chroma or OverChroma(pixel_format)
    chroma_alpha = over_chroma(alpha)
    apply: Callable[[_Samples], None]
    if isinstance(contrast, MapTables):
        shown = skin or as_they_are(frame, corner, alpha)
        chroma_alpha = tinged(contrast, shown.luma_at_chroma, (shown.smooth[1], shown.smooth[2]), chroma_alpha)
        fades = [_NO_FADE] * 3 if fade is None else [fade, *[over_chroma(fade)] * 2]
        apply = partial(_apply_map, correction, contrast, shown, fades)
    else:
        apply = partial(_apply_number, correction, contrast)
    over = [over_chroma(guard.weight) for guard, _ in guards]
    held_over = [(guard, held) for (guard, _), held in zip(guards, over, strict=True)]
    chroma_alpha = with_guards(chroma_alpha, held_over, pixel_format)
    patches = []
    for p in range(len(frame.planes)):
        log2, weight = pixel_format.log2_of(p), chroma_alpha if p else alpha
        rows, columns = weight.shape
        x, y = left >> log2[0], upper >> log2[1]
        before: NDArray[Any] = frame.over(p, (left, upper, left + width, upper + height))
        part = with_patches(before, p, (x, y), under)
        if not correction.mapped:
            before = before.copy()  # contiguous: compiled once
        nodes = _in_nodes(correction.lattice, corner, (columns, rows), log2)
        apply(_Samples(p, part, before, weight, nodes, pixel_format))
        for (guard, gain), held in zip(guards, over, strict=True):
            _scale(part, before, guard, held if p else guard.weight, gain, pixel_format, p)
        patches.append(Patch(p, y, x, part))
    return patches


class _Samples(NamedTuple):
    """The samples of one plane in a face's window, (r, c), which a correction is applied to in place.

    part: what becomes of them;  before: as the frame came;  weight: of the matte;  nodes: see `_in_nodes`.
    """

    plane: int
    part: NDArray[Any]
    before: NDArray[Any]
    weight: Floats
    nodes: tuple[Doubles, Doubles]
    format: PixelFormat

    @property
    def codes(self) -> kernels.Codes:
        """The scale of the plane's codes."""
        return _codes(self.format, self.plane)

    def of_nodes(self, planes: Floats) -> kernels.Grid:
        """What planes (3, h, w) on the nodes of the correction's lattice say of these samples."""
        return kernels.Grid(planes[self.plane], *self.nodes)


def _apply_map(
    correction: Correction, tables: MapTables, shown: Foreground, fades: Sequence[Floats], samples: _Samples
) -> None:
    """F on the samples of a plane, in place;  fades: w of `fade_in_dark` over each plane's."""
    plane = samples.plane
    own, smooth = shown.planes[plane], shown.smooth[plane]
    broad = smooth if plane == 0 or tables.excess > 0 else own
    skin = kernels.Shown(own, broad, shown.luma_at_chroma if plane else smooth)
    shift, tone = samples.of_nodes(correction.shift), _tone_map(tables, samples.format, plane)
    kernels.apply_map(samples.part, skin, samples.weight, shift, fades[plane], tone, samples.codes)


def _tone_map(tables: MapTables, pixel_format: PixelFormat, plane: int) -> kernels.ToneMap:
    """F of one plane."""
    if plane == 0:
        return kernels.ToneMap(tables.tone, np.float32(0.0), luma_bend(pixel_format))
    return kernels.ToneMap(tables.chroma[plane - 1 : plane], np.float32(tables.excess), _NO_ROLL_OFF)


def _codes(pixel_format: PixelFormat, plane: int) -> kernels.Codes:
    """The scale of a plane's codes."""
    return kernels.Codes(np.float32(pixel_format.offset[plane]), np.float32(2**pixel_format.depth - 1))


def _apply_number(correction: Correction, contrast: float, samples: _Samples) -> None:
    """λ on the samples of a plane, in place."""
    part, before, weight, codes = samples.part, samples.before, samples.weight, samples.codes
    if correction.low is not None and contrast != 1.0:
        # open skin is brighter than the curves around it, so I − H(g) has a mean; λ leaves it where it is
        mean = kernels.mean_above(before, weight, samples.of_nodes(correction.low))
        codes = codes._replace(zero=np.float32(mean))
    shift = samples.of_nodes(correction.shift)
    kernels.apply_contrast(part, before, weight, shift, np.float32(contrast - 1.0), codes)


def fade_in_dark(
    frame: Frame,
    corner: tuple[int, int],
    alpha: Floats,
    corrections: Sequence[Correction],
    skin: Foreground | None = None,
) -> Floats | None:
    """w over a face, (h, w), the same for all its corrections by F; None without any.

    corner, alpha, skin: see `apply_correction`.
    """
    one = next((each for each in corrections if each.around is not None), None)
    if one is None or one.around is None:
        return None
    (left, upper), (rows, columns) = corner, alpha.shape
    window = slice(upper, upper + rows), slice(left, left + columns)
    luma: NDArray[Any] = skin.planes[0] if skin else frame.planes[0][window]
    if frame.format.is_rgb:
        shown = np.stack(skin.planes, axis=-1) if skin else stacked(frame, window)
        luma = opponent_of(shown, frame.format)[..., 0]
    fade = np.ones(alpha.shape, np.float32)
    around = kernels.Grid(one.around, *_in_nodes(one.lattice, corner, (columns, rows), (0, 0)))
    black = np.float32(frame.format.offset[0])
    kernels.fade_in_dark(np.ascontiguousarray(luma), alpha, around, black, *_DARK, fade)
    return fade


def _scale(
    part: NDArray[Any],
    before: NDArray[Any],
    guard: Guard,
    weight: Floats,
    gain: float,
    pixel_format: PixelFormat,
    plane: int,
) -> None:
    """Multiply what a guard holds of a plane by its gain, in place; chroma never grows.

    weight: the guard's over the samples of the plane.
    """
    if gain == 1.0:
        return
    if plane:
        gain = min(gain, 1.0)
    log2x, log2y = pixel_format.log2_of(plane)
    top, left = guard.y >> log2y, guard.x >> log2x
    window = slice(top, top + weight.shape[0]), slice(left, left + weight.shape[1])
    bend = _NO_ROLL_OFF if plane else luma_bend(pixel_format)
    more = np.float32(gain - 1.0)
    kernels.scale(part[window], before[window], weight, more, bend, _codes(pixel_format, plane))


def _in_nodes(
    lattice: Lattice, corner: tuple[int, int], size: tuple[int, int], log2: tuple[int, int]
) -> tuple[Doubles, Doubles]:
    """Columns and rows of a plane's samples in the lattice's nodes.

    Chroma sits on the left luma column of its pair and between its rows, the default of H.264 and HEVC.
    """
    columns = corner[0] + np.arange(size[0], dtype=np.float64) * 2.0 ** log2[0]
    rows = corner[1] + sites(size[1], 0.5 ** log2[1]).astype(np.float64)
    return (columns - lattice.x) / lattice.step, (rows - lattice.y) / lattice.step
