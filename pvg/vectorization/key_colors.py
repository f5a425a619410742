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

    rgb: (H, W, 3);  positions: (S, 2) curve samples, source pixels;  face_width: pixels.
    Returns (S, 3) float32 colours, 0-255, and (S,) bool. Raises NoFaceError when the matte shows no skin to fit.
    """
    h, w = rgb.shape[:2]
    box = matte.raster.box
    x0, y0 = max(0, int(box[0])), max(0, int(box[1]))
    x1, y1 = min(w, int(box[2]) + 1), min(h, int(box[3]) + 1)
    scale = min(1.0, _FIT_FACE_PX / face_width)
    crop = rgb[y0:y1, x0:x1]
    size = (max(1, round(crop.shape[1] * scale)), max(1, round(crop.shape[0] * scale)))
    scale_xy = np.array([size[0] / crop.shape[1], size[1] / crop.shape[0]], np.float32)
    small = cv2.resize(crop, size, interpolation=cv2.INTER_AREA) if scale < 1 else crop
    local = scaled(positions - np.array([x0, y0], np.float32), scale_xy)
    domain = matte.mask_at(sites(size[0], scale_xy[0]) + x0, sites(size[1], scale_xy[1]) + y0)
    if not domain.any():
        raise NoFaceError("no skin found on the key frame of a face")
    fit = fit_boundary_colors(
        small, domain, local, h_min=max(1.0, face_width * scale / 100), rng=np.random.default_rng(seed)
    )
    near = cv2.dilate(domain.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(np.bool_)
    col, row = np.rint(local[:, 0]).astype(int), np.rint(local[:, 1]).astype(int)
    inside = (col >= 0) & (row >= 0) & (col < size[0]) & (row < size[1])
    visible = inside & near[np.clip(row, 0, size[1] - 1), np.clip(col, 0, size[0] - 1)]
    return fit.colors, visible & ~_stray(fit.colors, visible)


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
