"""A correction applied to the samples of one face, in any coded format.

    P' = P + α ((λ − 1)(P − level) + H(g' − λg))            P' = P + α (R(F(S) + w H(g' − F(g))) − R(S))

with S the skin in P (`pvg.rendering.foreground`), which is P but for the matte's edge, the roll-off R towards black and
white, and w = 1 but for what is much darker than skin: brows, lashes and pupils go through black, P g'/g, and not along
the skin's tangent, which would lay a veil over them. λ and F act on luma and chroma one by one, so on the planes a clip
is coded in. Only the rectangle of the face is touched: the result is patches, which a writer lays over the frame it
copies anyway.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from pvg._arrays import Doubles, Floats
from pvg.membrane import Lattice, Membrane
from pvg.raster import sites
from pvg.rendering import _kernels as kernels
from pvg.rendering.correction import Correction
from pvg.rendering.guards import Guard
from pvg.rendering.map_tables import MapTables
from pvg.rendering.tinge import tinge, tinge_of
from pvg.video import Frame, Patch, PixelFormat

_FINE_PX = 5  # side of the boxes that take fine detail out [by eye: white specks go, brows and lids stay]
_TOE, _KNEE = 0.05, 0.88  # of the way from black to white, where luma begins to roll off [by eye]
# of the skin around: from light like this on a pixel is skin, below it is a brow, a lash, a pupil [by eye]
_DARK = np.float32(0.4), np.float32(0.8)
_TINTED = np.float32(0.5)  # of the skin's change of chroma that eyes and teeth take [by eye: without, eyes look blue]
_NO_FADE = np.empty((0, 0), np.float32)
_NO_ROLL_OFF = np.empty(0, np.float32)


def luma_bend(pixel_format: PixelFormat) -> Floats:
    """The roll-off of luma, (4,) for `_kernels.roll_off`."""
    black = float(pixel_format.offset[0])
    span = float(pixel_format.matrix[0].sum()) * 255.0
    return np.array([black + _TOE * span, _TOE * span, black + _KNEE * span, (1 - _KNEE) * span], np.float32)


def without_fine_detail(plane: NDArray[Any], log2: int = 0) -> NDArray[Any]:
    """A plane whose columns are 2^log2 pixels apart, smoothed by two boxes, nearly a bell; chroma at half size by one.

    Slopes of F above 1 enlarge what is left: brows, lids and shades of skin go with the skin's brightness. Finer is
    noise as well, and single bright pixels beside lips and in the corners of eyes, which would turn white.
    """
    if log2:
        return cv2.blur(plane, (_FINE_PX >> log2 | 1,) * 2)  # rounded once: chroma is nearly even, twice would move it
    return cv2.blur(cv2.blur(plane, (_FINE_PX, _FINE_PX)), (_FINE_PX, _FINE_PX))


def apply_correction(
    frame: Frame,
    corner: tuple[int, int],
    alpha: Floats,
    correction: Correction,
    under: Sequence[Patch] = (),
    guards: Sequence[tuple[Guard, float]] = (),
    fade: Floats | None = None,
    skin: Sequence[NDArray[Any]] | None = None,
) -> list[Patch]:
    """The new samples of one face in every plane.

    corner: x, y of the source pixel that alpha (h, w) starts at, multiples of the chroma step;  alpha: the face's
    matte, guards taken out;  under: patches of other faces that were laid before;  guards: what was taken out, each
    with what its colours are multiplied by;  fade: (h, w) of `fade_in_dark`, 1 everywhere when None, for F alone;
    skin: the planes of `foreground`, for F alone, those of the frame when None.
    """
    if frame.format.is_rgb:
        return _apply_to_rgb(frame, corner, alpha, correction, under, guards, fade, skin)
    left, upper = corner
    pixel_format, contrast = frame.format, correction.contrast
    log2x, _ = pixel_format.chroma_log2
    patches = []
    chroma_alpha = over_chroma(alpha, pixel_format)
    fades = [_NO_FADE] * 3 if fade is None else [fade, *[over_chroma(fade, pixel_format)] * 2]
    if isinstance(contrast, MapTables):
        luma = without_fine_detail(skin[0] if skin else _samples(frame, 0, corner, alpha.shape))
        blue, red = (
            without_fine_detail(skin[p] if skin else _samples(frame, p, corner, chroma_alpha.shape), log2x)
            for p in (1, 2)
        )
        by = at_chroma(luma, pixel_format)
        chroma_alpha = chroma_alpha * tinge(contrast, by, (blue, red))
    chroma_alpha = _with_guards(chroma_alpha, guards, pixel_format)
    for p in range(len(frame.planes)):
        log2 = pixel_format.chroma_log2 if p else (0, 0)
        weight = chroma_alpha if p else alpha
        rows, columns = weight.shape
        x, y = left >> log2[0], upper >> log2[1]
        before = _samples(frame, p, corner, weight.shape)
        if skin is None:
            before = before.copy()  # contiguous as what is smoothed is: compiled once
        part = with_patches(before, p, (x, y), under)
        nodes = _in_nodes(correction.lattice, corner, (columns, rows), log2)
        if isinstance(contrast, MapTables):
            own = skin[p] if skin else before
            wide = (luma, blue, red)[p] if p == 0 or contrast.excess > 0 else own
            shown = own, wide, by if p else luma
            _apply_map(part, shown, weight, nodes, correction.shift[p], contrast, fades[p], pixel_format, p)
        else:
            _apply_number(part, before, weight, nodes, correction, contrast, pixel_format, p)
        _scale_all(part, before, guards, pixel_format, p)
        patches.append(Patch(p, y, x, part))
    return patches


def _apply_map(
    part: NDArray[Any],
    shown: tuple[NDArray[Any], NDArray[Any], NDArray[Any]],
    weight: Floats,
    nodes: tuple[Doubles, Doubles],
    shift: Floats,
    tables: MapTables,
    fade: Floats,
    pixel_format: PixelFormat,
    plane: int,
) -> None:
    """F on the samples of a plane, in place; all (r, c).

    shown: the skin in them, the same or smoothed where F enlarges it, and its smoothed luma;  nodes: see `_in_nodes`;
    shift: of the plane, at the nodes;  fade: w, (0, 0) for 1.
    """
    kernels.apply_map(
        part,
        *shown,
        weight,
        *nodes,
        shift,
        tables.chroma[plane - 1 : plane] if plane else tables.tone,
        np.float32(tables.excess if plane else 0.0),
        fade,
        _NO_ROLL_OFF if plane else luma_bend(pixel_format),
        np.float32(2**pixel_format.depth - 1),
    )


def _apply_number(
    part: NDArray[Any],
    before: NDArray[Any],
    weight: Floats,
    nodes: tuple[Doubles, Doubles],
    correction: Correction,
    contrast: float,
    pixel_format: PixelFormat,
    plane: int,
) -> None:
    """λ on the samples of a plane, in place;  part, before, weight: (r, c);  nodes: see `_in_nodes`."""
    level, top = float(pixel_format.offset[plane]), np.float32(2**pixel_format.depth - 1)
    if correction.low is not None and contrast != 1.0:
        # open skin is brighter than the curves around it, so I − H(g) has a mean; λ leaves it where it is
        level = kernels.mean_above(before, weight, *nodes, correction.low[plane])
    # this is λ − 1, written so that it is rounded in float32 as it always was: else a sample in a million would move by
    # a code
    excess = np.float32(1.0) + (np.float32(contrast - 1.0) - np.float32(1.0))
    kernels.apply_contrast(part, before, weight, *nodes, correction.shift[plane], excess, np.float32(level), top)


def at_chroma(luma: NDArray[Any], pixel_format: PixelFormat) -> NDArray[Any]:
    """Luma (h, w) at the first pixel of each chroma sample, (r, c)."""
    log2x, log2y = pixel_format.chroma_log2
    return np.ascontiguousarray(luma[:: 1 << log2y, :: 1 << log2x])


def _samples(frame: Frame, p: int, corner: tuple[int, int], shape: tuple[int, ...]) -> NDArray[Any]:
    """Those of plane p over a face whose first pixel is at `corner` (x, y), (r, c)."""
    log2x, log2y = frame.format.chroma_log2 if p else (0, 0)
    x, y = corner[0] >> log2x, corner[1] >> log2y
    return frame.planes[p][y : y + shape[0], x : x + shape[1]]


def _with_guards(weight: Floats, guards: Sequence[tuple[Guard, float]], pixel_format: PixelFormat) -> Floats:
    """The weight of chroma with a part of what guards took out: in warm light white is a little warm."""
    out = weight.copy() if guards else weight
    log2x, log2y = pixel_format.chroma_log2
    for guard, _ in guards:
        held = _TINTED * over_chroma(guard.weight, pixel_format)
        top, left = guard.y >> log2y, guard.x >> log2x
        out[top : top + held.shape[0], left : left + held.shape[1]] += held
    return out


def fade_in_dark(
    frame: Frame,
    corner: tuple[int, int],
    alpha: Floats,
    corrections: Sequence[Correction],
    skin: Sequence[NDArray[Any]] | None = None,
) -> Floats | None:
    """w over a face, (h, w), the same for all its corrections by F; None without any.

    corner, alpha, skin: see `apply_correction`.
    """
    one = next((each for each in corrections if each.around is not None), None)
    if one is None or one.around is None:
        return None
    (left, upper), (rows, columns) = corner, alpha.shape
    window = slice(upper, upper + rows), slice(left, left + columns)
    luma: NDArray[Any] = skin[0] if skin else frame.planes[0][window]
    if frame.format.is_rgb:
        shown = np.stack(skin, axis=-1) if skin else _stacked(frame, window)
        luma = _opponent_of(shown, frame.format)[..., 0]
    fade = np.ones(alpha.shape, np.float32)
    nodes = _in_nodes(one.lattice, corner, (columns, rows), (0, 0))
    black = np.float32(frame.format.offset[0])
    kernels.fade_in_dark(np.ascontiguousarray(luma), alpha, *nodes, one.around, black, *_DARK, fade)
    return fade


def _scale_all(
    part: NDArray[Any],
    before: NDArray[Any],
    guards: Sequence[tuple[Guard, float]],
    pixel_format: PixelFormat,
    plane: int,
) -> None:
    for guard, gain in guards:
        if gain != 1.0:
            _scale(part, before, guard, gain, pixel_format, plane)


def _scale(
    part: NDArray[Any], before: NDArray[Any], guard: Guard, gain: float, pixel_format: PixelFormat, plane: int
) -> None:
    """Multiply what a guard holds of a plane by its gain, in place; chroma never grows."""
    if plane:
        gain = min(gain, 1.0)
    log2x, log2y = pixel_format.chroma_log2 if plane else (0, 0)
    weight = over_chroma(guard.weight, pixel_format) if plane else guard.weight
    top, left = guard.y >> log2y, guard.x >> log2x
    window = slice(top, top + weight.shape[0]), slice(left, left + weight.shape[1])
    bend = _NO_ROLL_OFF if plane else luma_bend(pixel_format)
    least, most = np.float32(pixel_format.offset[plane]), np.float32(2**pixel_format.depth - 1)
    kernels.scale(part[window], before[window], weight, np.float32(gain - 1.0), least, bend, most)


def over_chroma(alpha: Floats, pixel_format: PixelFormat) -> Floats:
    """The matte (h, w) averaged over the pixels of each chroma sample, as (r, c)."""
    log2x, log2y = pixel_format.chroma_log2
    if not (log2x or log2y):
        return alpha
    rows, columns = (-(-size // 2**log2) for size, log2 in zip(alpha.shape, (log2y, log2x), strict=True))
    out = np.empty((rows, columns), np.float32)
    kernels.block_means(alpha, log2x, log2y, out)
    return out


def _apply_to_rgb(
    frame: Frame,
    corner: tuple[int, int],
    alpha: Floats,
    correction: Correction,
    under: Sequence[Patch],
    guards: Sequence[tuple[Guard, float]],
    fade: Floats | None,
    skin: Sequence[NDArray[Any]] | None,
) -> list[Patch]:
    """`apply_correction` for R, G, B planes, as stills have: what luma and chroma gain is added in RGB."""
    (left, upper), (rows, columns) = corner, alpha.shape
    opponent = frame.format.opponent
    window = slice(upper, upper + rows), slice(left, left + columns)
    before = _stacked(frame, window)
    here = _opponent_of(before, frame.format)
    guarded = _scaled_rgb(before, here[..., 0].copy(), guards, luma_bend(opponent))
    source = _opponent_of(np.stack(skin, axis=-1), frame.format) if skin and correction.mapped else here
    wanted = source.copy()

    def over_pixels(nodes: Floats) -> Floats:
        return Membrane(correction.lattice, nodes[None]).crop(left, upper, columns, rows)[..., 0]

    contrast, weight = correction.contrast, alpha
    if isinstance(contrast, MapTables):
        own = source + np.asarray(opponent.offset, np.float32)
        broad = without_fine_detail(own)
        wanted += contrast.gained_of(own, broad)
        weight = alpha * tinge_of(contrast, broad)
    elif contrast != 1.0 and correction.low is not None and alpha.any():  # an empty matte weighs nothing
        for p in range(3):
            plane = source[..., p]
            mean = np.average(plane - over_pixels(correction.low[p]), weights=alpha)
            wanted[..., p] += (contrast - 1.0) * (plane - np.float32(mean))
    for p in range(3):
        wanted[..., p] += over_pixels(correction.shift[p]) * (1.0 if fade is None else fade)
    gained = wanted - source
    if correction.mapped:
        bend = luma_bend(opponent)
        gained[..., 0] = kernels.roll_off(wanted[..., 0], bend) - kernels.roll_off(source[..., 0], bend)
    weights = np.stack([alpha, *[_with_guards(weight, guards, frame.format)] * 2], axis=-1)
    weighted = weights * gained
    gained = not_beyond(weighted, here, source + gained) if correction.mapped else weighted
    gained = gained @ np.linalg.inv(opponent_matrix(frame.format)).T + guarded
    return rgb_patches(before, gained, corner, under, frame.format)


def rgb_patches(
    before: NDArray[Any],
    gained: NDArray[Any],
    corner: tuple[int, int],
    under: Sequence[Patch],
    pixel_format: PixelFormat,
) -> list[Patch]:
    """The patches of R, G, B planes whose codes `before` (h, w, 3), the first at `corner` (x, y), gain `gained`.

    under: patches that were laid before;  gained: (h, w, 3) codes, not rounded.
    """
    patches = []
    for p in range(3):
        part = with_patches(before[..., p], p, corner, under)
        new = np.clip(np.rint(gained[..., p] + part), 0, 2**pixel_format.depth - 1).astype(pixel_format.dtype)
        patches.append(Patch(p, corner[1], corner[0], new))
    return patches


def not_beyond(gained: Floats, here: Floats, skin: Floats) -> Floats:
    """What samples of luma and chroma (…, 3) that were `here` gain, bounded by `skin`, what the skin in them becomes.

    Where a matte reaches too far at its edge, the background would shine, or take the complement of the hue that the
    skin loses. So luma never rises above the brighter of the two, and chroma stays between them. Luma may fall below
    both: hairs over skin that is made dark keep their distance to it.
    """
    moved = np.minimum(here + gained, np.maximum(here, skin))
    moved[..., 1:] = np.maximum(moved[..., 1:], np.minimum(here, skin)[..., 1:])
    return np.asarray(moved - here, np.float32)


def opponent_matrix(pixel_format: PixelFormat) -> Doubles:
    """(3, 3) from R, G, B codes to those of luma and chroma, black aside."""
    return np.asarray(pixel_format.opponent.matrix @ np.linalg.inv(pixel_format.matrix))


def _stacked(frame: Frame, window: tuple[slice, slice]) -> NDArray[Any]:
    """(h, w, 3) codes of R, G, B planes."""
    return np.stack([plane[window] for plane in frame.planes], axis=-1)


def _opponent_of(codes: NDArray[Any], pixel_format: PixelFormat) -> Floats:
    """(h, w, 3) luma and chroma, black aside, of R, G, B codes (h, w, 3)."""
    return np.asarray(codes @ opponent_matrix(pixel_format).T, np.float32)


def _scaled_rgb(before: NDArray[Any], luma: Floats, guards: Sequence[tuple[Guard, float]], bend: Floats) -> Floats:
    """(h, w, 3) what R, G, B (h, w, 3) of luma (h, w) gain within guards."""
    gained = np.zeros(before.shape, np.float32)
    for guard, gain in guards:
        rows, columns = guard.weight.shape
        window = slice(guard.y, guard.y + rows), slice(guard.x, guard.x + columns)
        own = np.ascontiguousarray(luma[window])
        change = guard.weight * (kernels.roll_off(np.float32(gain) * own, bend) - kernels.roll_off(own, bend))
        if gain > 1.0:  # what luma gains, R, G and B gain alike: chroma never grows
            gained[window] += change[..., None]
        else:
            gained[window] += (change / np.maximum(own, np.float32(1.0)))[..., None] * before[window]
    return gained


def with_patches(samples: NDArray[Any], plane: int, corner: tuple[int, int], patches: Sequence[Patch]) -> NDArray[Any]:
    """A copy of samples of a plane, the first of them at `corner` (x, y), with what the patches lay over them."""
    part = samples.copy()
    for patch in patches:
        if patch.plane == plane:
            _lay(part, corner, patch)
    return part


def _lay(part: NDArray[Any], corner: tuple[int, int], patch: Patch) -> None:
    """Copy what a patch shares with `part`, whose first sample is at `corner` (x, y), in place."""
    x, y = corner
    rows, columns = part.shape
    height, width = patch.samples.shape
    x0, x1 = max(x, patch.x), min(x + columns, patch.x + width)
    y0, y1 = max(y, patch.y), min(y + rows, patch.y + height)
    if x0 < x1 and y0 < y1:
        part[y0 - y : y1 - y, x0 - x : x1 - x] = patch.samples[y0 - patch.y : y1 - patch.y, x0 - patch.x : x1 - patch.x]


def _in_nodes(
    lattice: Lattice, corner: tuple[int, int], size: tuple[int, int], log2: tuple[int, int]
) -> tuple[Doubles, Doubles]:
    """Columns and rows of a plane's samples in the lattice's nodes.

    Chroma sits on the left luma column of its pair and between its rows, the default of H.264 and HEVC.
    """
    columns = corner[0] + np.arange(size[0], dtype=np.float64) * 2.0 ** log2[0]
    rows = corner[1] + sites(size[1], 0.5 ** log2[1]).astype(np.float64)
    return (columns - lattice.x) / lattice.step, (rows - lattice.y) / lattice.step
