"""R, G, B planes, as stills have: their luma and chroma, and a correction that is told in those and added in RGB."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pvg._arrays import Doubles, Floats
from pvg.membrane import Membrane
from pvg.rendering import _kernels as kernels
from pvg.rendering.correction import Correction
from pvg.rendering.guards import Guard
from pvg.rendering.map_tables import MapTables
from pvg.rendering.plane_samples import luma_bend, with_guards, with_patches, without_fine_detail
from pvg.rendering.tinge import tinged_codes
from pvg.video import Frame, Patch, PixelFormat


def apply_to_rgb(
    frame: Frame,
    corner: tuple[int, int],
    alpha: Floats,
    correction: Correction,
    *,
    under: Sequence[Patch],
    guards: Sequence[tuple[Guard, float]],
    fade: Floats | None,
    skin: Sequence[NDArray[Any]] | None,
) -> list[Patch]:
    """`planes.apply_correction` for R, G, B planes: what luma and chroma gain is added in RGB."""
    (left, upper), (rows, columns) = corner, alpha.shape
    pixel_format, contrast = frame.format, correction.contrast
    before = stacked(frame, (slice(upper, upper + rows), slice(left, left + columns)))
    here = opponent_of(before, pixel_format)
    guarded = _scaled_rgb(before, here[..., 0].copy(), guards, luma_bend(pixel_format.opponent))

    def over_pixels(nodes: Floats) -> Floats:
        """(3, h, w) of planes (3, …) on the correction's nodes."""
        return Membrane(correction.lattice, nodes).read(left + np.arange(columns), upper + np.arange(rows))

    def weights(of_chroma: Floats) -> Floats:
        """(h, w, 3) of the matte and of what it is for chroma (h, w), guards taken out of that too."""
        held = [(guard, guard.weight) for guard, _ in guards]
        return np.stack([alpha, *[with_guards(of_chroma, held, pixel_format)] * 2], axis=-1)

    shift = over_pixels(correction.shift) * (1.0 if fade is None else fade)
    if isinstance(contrast, MapTables):
        shown = opponent_of(np.stack(skin, axis=-1), pixel_format) if skin else here
        own = shown + np.asarray(pixel_format.opponent.offset, np.float32)
        broad = without_fine_detail(own)
        gained = _gained_by_map(contrast, shown, own, broad, shift, luma_bend(pixel_format.opponent))
        of_chroma = tinged_codes(contrast, broad, alpha)
        gained = not_beyond(weights(of_chroma), here, shown, gained, np.zeros(3), 2.0**pixel_format.depth - 1)
    else:
        low = None if correction.low is None else over_pixels(correction.low)
        gained = weights(alpha) * _gained_by_number(contrast, here, alpha, low, shift)
    gained = gained @ np.linalg.inv(opponent_matrix(pixel_format)).T + guarded
    return rgb_patches(before, gained, corner, under, pixel_format)


def _gained_by_map(tables: MapTables, shown: Floats, own: Floats, broad: Floats, shift: Floats, bend: Floats) -> Floats:
    """What luma and chroma (h, w, 3) gain by F, rolled off.

    shown: the skin, black aside;  own, broad: its codes, and those smoothed;  shift: (3, h, w) H(g' − F(g));
    bend: see `luma_bend`.
    """
    wanted = shown + tables.gained_of(own, broad)
    for p in range(3):
        wanted[..., p] += shift[p]
    gained = wanted - shown
    gained[..., 0] = kernels.roll_off(wanted[..., 0], bend) - kernels.roll_off(shown[..., 0], bend)
    return gained


def _gained_by_number(contrast: float, here: Floats, alpha: Floats, low: Floats | None, shift: Floats) -> Floats:
    """What luma and chroma (h, w, 3) gain by λ.

    here: what they are, black aside;  alpha: (h, w);  low, shift: (3, h, w) H(g), None where λ is 1, and H(g' − λg).
    """
    wanted = here.copy()
    if contrast != 1.0 and low is not None and alpha.any():  # an empty matte weighs nothing
        for p in range(3):
            plane = here[..., p]
            mean = np.average(plane - low[p], weights=alpha)
            wanted[..., p] += (contrast - 1.0) * (plane - np.float32(mean))
    for p in range(3):
        wanted[..., p] += shift[p]
    return wanted - here


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


def not_beyond(weights: Floats, here: Floats, skin: Floats, gained: Floats, grey: Doubles, top: float) -> Floats:
    """What samples of luma and chroma (…, 3) that are `here` gain, by the weights (…, 3) of what `skin` in them gains.

    Where a matte reaches too far at its edge, the background would shine, or take the complement of the hue that the
    skin loses. So luma never rises above the brighter of sample and new skin, and chroma stays between them and what
    is left of the sample's own if it loses its chroma as the skin does: at an edge, skin's chroma is diluted. Luma may
    fall below both: hairs over skin that is made dark keep their distance to it.
    grey: (3,) its codes;  top: the largest code.
    """
    new = skin + gained
    moved = np.minimum(here + weights * gained, np.maximum(here, new))
    faint = np.float32((kernels.FAINT * top) ** 2)
    own, was, becomes = (each[..., 1:] - np.float32(grey[1:]) for each in (here, skin, new))
    kept = own * np.clip((becomes * was + faint) / (was * was + faint), 0, 1)
    ends = np.stack([own, becomes, kept])
    chroma = np.clip(own + weights[..., 1:] * gained[..., 1:], ends.min(axis=0), ends.max(axis=0))
    moved[..., 1:] = chroma + np.float32(grey[1:])
    return np.asarray(moved - here, np.float32)


def opponent_matrix(pixel_format: PixelFormat) -> Doubles:
    """(3, 3) from R, G, B codes to those of luma and chroma, black aside."""
    return np.asarray(pixel_format.opponent.matrix @ np.linalg.inv(pixel_format.matrix))


def stacked(frame: Frame, window: tuple[slice, slice]) -> NDArray[Any]:
    """(h, w, 3) codes of R, G, B planes."""
    return np.stack([plane[window] for plane in frame.planes], axis=-1)


def opponent_of(codes: NDArray[Any], pixel_format: PixelFormat) -> Floats:
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
