"""The skin of one picture: guided by landmarks, or by the paper's fixed range of red chroma."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from pvg._arrays import Bools, Bytes, Floats
from pvg.face import Landmarks
from pvg.skin.cleanup import biggest_part, fill_holes, gather
from pvg.skin.color_model import SkinColors, fit_colors, skin_scale, strangeness, to_skin_lab
from pvg.skin.graph_cut import minimum_cut
from pvg.skin.hair import VEIL_ODDS, deep_shade, find_hair, veil
from pvg.skin.prior import Places, face_area, face_box, head_shape, locate, logistic

MaskMethod = Literal["landmarks", "ycbcr"]

_CR_LOW, _CR_HIGH = 140, 160
WORK_FACE_PX = 150.0  # the colour decision is made on a picture scaled to faces of this size
_ROUNDS = 3
# weight of the contour's inside in learning what is not skin: hair there is like hair above, but shade is skin
_INSIDE = 0.2
_LEAST_SAMPLE = 16  # cells
_GLASSES_DARKER = 15.0  # than the cheeks, in L
_PRIOR_IN_LEARNING = 0.4
_BEARD_DARKER = 25.0  # than the open skin, in L
_BEARD_SPREAD = 40.0  # 8-bit levels
_BEARD_ODDS = 0.5  # nats: a beard is the face's, whatever lies behind it
_SHADE_ODDS = 1.5  # nats for skin where it lies in deep shade


def skin_mask(rgb: Bytes, landmarks: Landmarks, *, method: MaskMethod = "landmarks") -> Bools:
    """Skin of one face in one picture: face, ears and neck, with the features inside filled.

    rgb: (H, W, 3) uint8;  landmarks: in its pixels.
    method: "landmarks", or "ycbcr", the paper's rule over the whole picture: 8-bit Cr in [140, 160].
    Returns (H, W) bool without holes; "ycbcr" and mostly "landmarks" give one connected part, but an ear behind hair
    is a part of its own.
    """
    height, width = rgb.shape[:2]
    if method == "ycbcr":
        return chroma_mask(rgb, face_area((height, width), landmarks))
    box = face_box(landmarks)
    x0, y0 = np.clip(np.floor(box[:2]).astype(int), 0, [width - 1, height - 1])
    x1, y1 = np.clip(np.ceil(box[2:]).astype(int) + 1, [x0 + 1, y0 + 1], [width, height])
    crop = np.ascontiguousarray(rgb[y0:y1, x0:x1])
    scale = min(1.0, WORK_FACE_PX / head_shape(landmarks).size)
    size = (max(2, round((x1 - x0) * scale)), max(2, round((y1 - y0) * scale)))
    ratio = np.array([size[0] / (x1 - x0), size[1] / (y1 - y0)], np.float32)
    small = np.asarray(cv2.resize(crop, size, interpolation=cv2.INTER_AREA), np.uint8)
    offset = np.array([x0, y0], np.float32)
    local = landmarks.moved(-offset).scaled(ratio)
    mask = np.zeros((height, width), np.bool_)
    mask[y0:y1, x0:x1] = _refine(crop, cut_skin(small, local).mask, 1 / scale)
    return mask


def chroma_mask(rgb: Bytes, face: Bools, visible: Bools | None = None) -> Bools:
    """The paper's rule: Cr in [140, 160], the largest part of those that touch `face` (H, W) bool, filled."""
    red = cv2.cvtColor(rgb, cv2.COLOR_RGB2YCrCb)[..., 1]
    skin = (red >= _CR_LOW) & (red <= _CR_HIGH)
    return fill_holes(biggest_part(skin if visible is None else skin & visible, face))


@dataclass(frozen=True, eq=False)
class SkinCut:
    """mask: (h, w) bool;  colors: the likelihoods that it was cut by."""

    mask: Bools
    colors: SkinColors


def cut_skin(rgb: Bytes, landmarks: Landmarks, visible: Bools | None = None) -> SkinCut:
    """Cut the skin out of a small picture (h, w, 3): colours and mask learn from each other in a few rounds.

    Only the last round cuts along the picture's edges: the others learn the same from the sign of the odds.

    landmarks: in the picture's pixels;  visible: (h, w) bool, where the picture is real.
    """
    shape = rgb.shape[:2]
    where = locate(shape, landmarks)
    visible = np.ones(shape, np.bool_) if visible is None else visible
    lab = to_skin_lab(rgb)
    sample = _sample(lab, where, visible)
    scale = skin_scale(lab[sample])
    far, far_in_tone = strangeness(lab, lab[sample], where.face)
    odd = where.sure & (far > 16)  # eyes, lips, glasses, beard: inside, but not to learn skin from
    like_sample = np.exp(-0.15 * np.maximum(far_in_tone - 9, 0))
    belief = np.where(where.sure, 1.0, logistic(where.prior) * np.exp(-0.25 * np.maximum(far - 6, 0)))
    nearby = np.exp(-2 * np.maximum(where.outside - 0.1, 0)) * np.where(where.face, _INSIDE, 1)
    beard = _beard(rgb, lab, where, sample)
    covered, shaded = np.zeros((2, *shape), np.float32)
    for turn in range(_ROUNDS):
        # learn: without the anchor to the sample, a fringe once taken for skin would teach that hair is skin
        inner = np.where(odd, 0, belief * like_sample) * visible
        outer = np.where(where.sure, 0, 1 - belief * like_sample) * nearby * visible
        colors = fit_colors(scale, lab, inner.astype(np.float32), outer.astype(np.float32))
        # cut
        evidence = colors.evidence(lab)
        evidence = np.where(where.sure, np.maximum(evidence, 0), evidence)
        evidence = np.maximum(evidence, np.where(beard, _BEARD_ODDS, evidence))
        evidence = evidence + shaded * np.maximum(_SHADE_ODDS - evidence, 0) - VEIL_ODDS * covered
        odds = np.where(visible, where.prior + evidence, -9).astype(np.float32)
        if turn == _ROUNDS - 1:
            break
        skin = gather(odds > 0, where) & visible
        belief = logistic(evidence + _PRIOR_IN_LEARNING * where.prior)
        belief = np.where(skin, np.maximum(belief, 0.6), np.minimum(belief, 0.4))
        hair = find_hair(rgb, skin | ~visible, where)
        if hair is not None:
            covered, shaded = veil(rgb, skin, where, hair), deep_shade(rgb, where, hair)
    return SkinCut(gather(minimum_cut(rgb, odds), where) & visible, colors)


def _beard(rgb: Bytes, lab: Floats, where: Places, sample: Bools) -> Bools:
    """(h, w) bool: cells about the jaw of a full beard's colour; none unless the chin is darker than the `sample`."""
    nothing: Bools = np.zeros(sample.shape, np.bool_)
    if min(int(where.chin.sum()), int(sample.sum())) < _LEAST_SAMPLE:
        return nothing
    if float(np.median(lab[sample][:, 0]) - np.median(lab[where.chin][:, 0])) < _BEARD_DARKER:
        return nothing
    color = rgb.astype(np.float32)
    alike: Bools = np.linalg.norm(color - np.median(color[where.chin], axis=0), axis=2) < _BEARD_SPREAD
    return alike & where.jaw


def _sample(lab: Floats, where: Places, visible: Bools) -> Bools:
    """(h, w) bool: the cells whose colours lab (h, w, 3) stand for the skin's."""
    sample, cheeks = where.sample & visible, where.cheeks & visible
    if int(sample.sum()) < _LEAST_SAMPLE:
        sample = where.face & visible
        return sample if int(sample.sum()) >= _LEAST_SAMPLE else np.ones(visible.shape, np.bool_)
    upper = sample & ~cheeks
    if min(int(cheeks.sum()), int(upper.sum())) < _LEAST_SAMPLE:
        return sample
    # dark glasses outweigh the cheeks
    dark = float(np.median(lab[cheeks][:, 0]) - np.median(lab[upper][:, 0])) > _GLASSES_DARKER
    return cheeks if dark else sample


def _refine(rgb: Bytes, small: Bools, factor: float) -> Bools:
    """The small mask at the picture's own size, its edge moved to the picture's."""
    h, w = rgb.shape[:2]
    large = cv2.resize(small.astype(np.float32), (w, h), interpolation=cv2.INTER_LINEAR)
    alpha = cv2.ximgproc.guidedFilter(rgb, large, max(2, round(2 * factor)), 100.0)
    return fill_holes(alpha > 0.5)
