"""The boundary colours of a key frame: least squares over its skin, strays left out."""

from __future__ import annotations

import cv2
import numpy as np

from pvg._arrays import Bools, Bytes, Floats
from pvg.curves import table_labels
from pvg.errors import NoFaceError
from pvg.harmonic import fit_boundary_colors
from pvg.raster import scaled, sites
from pvg.skin import Matte

_FIT_FACE_PX = 320  # the least-squares fit sees larger faces scaled down to this width
_STRAY_SPREADS = 2.5
_LEAST_CHROMA_SPREAD = 4.0  # of a* and b*


def fit_key_frame(rgb: Bytes, matte: Matte, positions: Floats, face_width: float, seed: int) -> tuple[Floats, Bools]:
    """Boundary colours g of a key frame (eq. 3) and which samples lie on visible skin or features.

    rgb: (H, W, 3);  matte: of the face in its pixels;  positions: (S, 2) curve samples in its pixels;
    face_width: pixels;  seed: of the pixels that the fit draws.
    Returns (S, 3) float32 colours, 0-255, and (S,) bool. Raises NoFaceError when the matte shows no skin to fit.
    """
    crop, (x0, y0) = _within(rgb, matte.raster.box)
    scale = min(1.0, _FIT_FACE_PX / face_width)
    small = _reduced(crop, scale)
    h, w = small.shape[:2]
    ratio = np.array([w / crop.shape[1], h / crop.shape[0]], np.float32)
    local = scaled(positions - np.array([x0, y0], np.float32), ratio)
    domain = matte.mask_at(sites(w, ratio[0]) + x0, sites(h, ratio[1]) + y0)
    if not domain.any():
        raise NoFaceError("no skin found on the key frame of a face")
    h_min = max(1.0, face_width * scale / 100)
    fit = fit_boundary_colors(small, domain, local, h_min=h_min, rng=np.random.default_rng(seed))
    visible = _touching(domain, local)
    return fit.colors, visible & ~_stray(fit.colors, visible)


def _within(rgb: Bytes, box: Floats) -> tuple[Bytes, tuple[int, int]]:
    """The part of a picture (H, W, 3) in a box (4,) x0, y0, x1, y1, which may reach over its edge, and its corner."""
    h, w = rgb.shape[:2]
    x0, y0 = max(0, int(box[0])), max(0, int(box[1]))
    x1, y1 = min(w, int(box[2]) + 1), min(h, int(box[3]) + 1)
    return rgb[y0:y1, x0:x1], (x0, y0)


def _reduced(rgb: Bytes, scale: float) -> Bytes:
    """A picture (H, W, 3) at `scale` of its size, at most 1, in whole pixels."""
    if scale >= 1:
        return rgb
    size = max(1, round(rgb.shape[1] * scale)), max(1, round(rgb.shape[0] * scale))
    return np.asarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA), np.uint8)


def _touching(domain: Bools, places: Floats) -> Bools:
    """(S,) whether places (S, 2) lie in the domain (H, W) or on a pixel beside it."""
    h, w = domain.shape
    near = cv2.dilate(domain.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(np.bool_)
    column, row = np.rint(places[:, 0]).astype(int), np.rint(places[:, 1]).astype(int)
    inside = (column >= 0) & (row >= 0) & (column < w) & (row < h)
    return np.asarray(inside & near[np.clip(row, 0, h - 1), np.clip(column, 0, w - 1)])


def _stray(colors: Floats, visible: Bools) -> Bools:
    """(S,) whether a skin sample has a hue that the face's visible skin has not: hair, collar or background in it.

    Transport matches extremes to extremes, so a few such samples would tint a face's highlights or shadows.
    """
    skin = table_labels().on_group("skin")
    if not (skin & visible).any():
        return np.zeros(len(colors), np.bool_)
    chroma = cv2.cvtColor(colors[None] / np.float32(255.0), cv2.COLOR_RGB2Lab)[0, :, 1:]
    middle = np.median(chroma[skin & visible], axis=0)
    distance = np.hypot(*(chroma - middle).T)
    spread = max(1.48 * float(np.median(distance[skin & visible])), _LEAST_CHROMA_SPREAD)
    stray: Bools = skin & (distance > _STRAY_SPREADS * spread)
    return stray
