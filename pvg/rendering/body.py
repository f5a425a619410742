"""The rest of a person's skin in one frame: the face's map F applied to it by tables.

No curves are needed: F takes luma by a table, and chroma by tables of luma,

    Y' = T(Y)        c' = m'(T(Y)) + k b(c − m(Y))

with T of skin beside the face (`SkinMap.beside`) and b of `bounded`. Slopes above 1 see a smoothed picture: what is
finer is left as it is, as in `planes`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pvg._arrays import Floats
from pvg.rendering import _body_kernels as kernels
from pvg.rendering import _kernels
from pvg.rendering.bounded import beyond_bound
from pvg.rendering.foreground import Foreground
from pvg.rendering.map_tables import MapTables
from pvg.rendering.placed_body import PlacedBody
from pvg.rendering.plane_samples import luma_bend, with_patches, without_fine_detail
from pvg.rendering.rgb_planes import not_beyond, opponent_matrix, rgb_patches, stacked
from pvg.rendering.tinge import tinged, tinged_codes
from pvg.video import Frame, Patch


def apply_body(
    frame: Frame, body: PlacedBody, shown: Foreground, tables: MapTables, under: Sequence[Patch] = ()
) -> list[Patch]:
    """The new samples of a body in every plane.

    shown: what its pixels show of skin, the same for all looks;  under: patches that were laid before.
    """
    if frame.format.is_rgb:
        return _apply_to_rgb(frame, body, shown.planes, tables, under)
    pixel_format, (left, upper), skin = frame.format, (body.x, body.y), shown.planes
    top = np.float32(2**pixel_format.depth - 1)
    h, w = body.alpha.shape
    window = left, upper, left + w, upper + h
    broad, *smooth = shown.smooth
    part = with_patches(frame.over(0, window), 0, (left, upper), under)
    kernels.apply_tone(part, skin[0], broad, body.alpha, tables.tone, luma_bend(pixel_format), top)
    patches = [Patch(0, upper, left, part)]
    log2x, log2y = pixel_format.chroma_log2
    x, y = left >> log2x, upper >> log2y
    by = shown.luma_at_chroma
    chroma = smooth[0], smooth[1]
    weight = tinged(tables, by, chroma, shown.chroma_alpha)
    beyond = beyond_bound(tables, tables.spread, by, chroma, shown.chroma_alpha)
    for p in (1, 2):
        wide = smooth[p - 1] if tables.excess > 0 else skin[p]
        part = with_patches(frame.over(p, window), p, (x, y), under)
        shift, excess = tables.chroma[p - 1], np.float32(tables.excess)
        grey = np.float32(pixel_format.offset[p])
        kernels.apply_chroma(part, skin[p], wide, by, weight, shift, excess, beyond[p - 1], grey, top)
        patches.append(Patch(p, y, x, part))
    return patches


def _apply_to_rgb(
    frame: Frame, body: PlacedBody, skin: Sequence[NDArray[Any]], tables: MapTables, under: Sequence[Patch]
) -> list[Patch]:
    """`apply_body` for R, G, B planes: what luma and chroma gain is added in RGB."""
    (left, upper), (h, w) = (body.x, body.y), body.alpha.shape
    opponent = frame.format.opponent
    before = stacked(frame, (slice(upper, upper + h), slice(left, left + w)))
    to_opponent_codes = opponent_matrix(frame.format)
    source = (np.stack(skin, axis=-1) @ to_opponent_codes.T + opponent.offset).astype(np.float32)
    bend = luma_bend(opponent)
    luma: Floats = np.ascontiguousarray(source[..., 0])
    smooth = without_fine_detail(source)
    gained = tables.gained_of(source, smooth)
    own, *chroma = (np.ascontiguousarray(smooth[..., p]) for p in range(3))
    beyond = beyond_bound(tables, tables.spread, own, (chroma[0], chroma[1]), body.alpha)
    gained[..., 1:] -= np.moveaxis(beyond, 0, -1)
    weights = np.stack([body.alpha, *[tinged_codes(tables, smooth, body.alpha)] * 2], axis=-1)
    gained[..., 0] = _kernels.roll_off(luma + gained[..., 0], bend) - _kernels.roll_off(luma, bend)
    here = np.asarray(before @ to_opponent_codes.T + opponent.offset, np.float32)
    change = not_beyond(weights, here, source, gained, opponent.offset, 2.0**frame.format.depth - 1)
    change = change @ np.linalg.inv(to_opponent_codes).T
    return rgb_patches(before, change, (left, upper), under, frame.format)
