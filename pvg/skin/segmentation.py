"""The skin of one picture: guided by landmarks, or by the paper's fixed range of red chroma."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from pvg._arrays import Bools, Bytes, Floats
from pvg.face import Landmarks
from pvg.haze import haze_of, without_haze
from pvg.skin import network
from pvg.skin.cleanup import face_component, fill_holes, largest_component
from pvg.skin.color_model import ColorScale, SkinColors, median_deviation, squared_distances, to_skin_lab
from pvg.skin.graph_cut import minimum_cut
from pvg.skin.hair import deep_shade, find_hair, hair_cover
from pvg.skin.light import face_color, gain_of, relit
from pvg.skin.parameters import SKIN_PRIOR
from pvg.skin.prior import SpatialPrior, face_area, face_box, goes_on_above, head_shape, logistic, spatial_prior

MaskMethod = Literal["landmarks", "ycbcr"]

_LEARNING, _THROAT = SKIN_PRIOR.learning, SKIN_PRIOR.throat


def skin_mask(rgb: Bytes, landmarks: Landmarks, *, mask: MaskMethod = "landmarks") -> Bools:
    """Skin of one face in one picture: face, ears and neck, with the features inside filled.

    rgb: (H, W, 3) uint8;  landmarks: in its pixels.
    mask: "landmarks", or "ycbcr", the paper's rule over the whole picture: 8-bit Cr in [140, 160].
    Returns (H, W) bool without holes; "ycbcr" and mostly "landmarks" give one connected part, but an ear behind hair
    is a part of its own.
    """
    height, width = rgb.shape[:2]
    if mask == "ycbcr":
        return red_chroma_mask(rgb, face_area((height, width), landmarks))
    rgb = without_haze(rgb, haze_of(rgb))
    found, above = _of_box(rgb, landmarks, bald=False)
    return _of_box(rgb, landmarks, bald=True)[0] if above else found


def _of_box(rgb: Bytes, landmarks: Landmarks, *, bald: bool) -> tuple[Bools, bool]:
    """The mask (H, W), and whether the face's box cuts it off at its top."""
    height, width = rgb.shape[:2]
    box = face_box(landmarks, bald=bald)
    x0, y0 = np.clip(np.floor(box[:2]).astype(int), 0, [width - 1, height - 1])
    x1, y1 = np.clip(np.ceil(box[2:]).astype(int) + 1, [x0 + 1, y0 + 1], [width, height])
    crop = np.ascontiguousarray(rgb[y0:y1, x0:x1])
    scale = min(1.0, _LEARNING.face_px / head_shape(landmarks).size)
    size = (max(2, round((x1 - x0) * scale)), max(2, round((y1 - y0) * scale)))
    ratio = np.array([size[0] / (x1 - x0), size[1] / (y1 - y0)], np.float32)
    small = np.asarray(cv2.resize(crop, size, interpolation=cv2.INTER_AREA), np.uint8)
    offset = np.array([x0, y0], np.float32)
    local = landmarks.moved(-offset).scaled(ratio)
    mask = np.zeros((height, width), np.bool_)
    found = segment(small, local, bald=bald).mask
    mask[y0:y1, x0:x1] = _refine(crop, found, 1 / scale)
    return mask, y0 > 0 and goes_on_above(found, local)


def red_chroma_mask(rgb: Bytes, face: Bools, visible: Bools | None = None) -> Bools:
    """The paper's rule: Cr in [140, 160], the largest component of those that touch `face` (H, W) bool, filled.

    Empty where none does.
    """
    red = cv2.cvtColor(rgb, cv2.COLOR_RGB2YCrCb)[..., 1]
    low, high = SKIN_PRIOR.paper.red_chroma
    skin = (red >= low) & (red <= high)
    if visible is not None:
        skin &= visible
    return fill_holes(largest_component(skin, face)) if (skin & face).any() else np.zeros_like(skin)


@dataclass(frozen=True, eq=False)
class Segmentation:
    """The skin that was cut out of a small picture.

    mask: (h, w) bool;  colors: the colour models it was cut by;  prior: where skin may be;
    color: (3,) RGB, the face's in the picture as it was given;  rgb: (h, w, 3) the picture in usual light, see `relit`.
    """

    mask: Bools
    colors: SkinColors
    prior: SpatialPrior
    color: Floats
    rgb: Bytes


def segment(rgb: Bytes, landmarks: Landmarks, visible: Bools | None = None, *, bald: bool = False) -> Segmentation:
    """Cut the skin out of a small picture (h, w, 3): colours and mask learn from each other in a few rounds.

    Only the last round cuts along the picture's edges: the others learn the same from the sign of the log-odds.

    landmarks: in the picture's pixels;  visible: (h, w) bool, where the picture is real;  bald: see `spatial_prior`.
    """
    shape = rgb.shape[:2]
    prior = spatial_prior(shape, landmarks, bald=bald)
    visible = np.ones(shape, np.bool_) if visible is None else visible
    color = face_color(rgb, prior.sample & visible)
    rgb = relit(rgb, gain_of(color))
    lab = to_skin_lab(rgb)
    sample = _sample(lab, prior, visible)
    scale = ColorScale.fit(lab[sample])
    distance, tonal = _distances(lab, sample, _bare_throat(lab, prior, visible, scale), prior)

    lessons = _Lessons.of(scale, lab, tonal, prior, visible)
    unlike_first = np.exp(-_LEARNING.first_decay * np.maximum(distance - _LEARNING.first_from, 0))
    probability = np.where(prior.foreground, 1.0, logistic(prior.log_odds) * unlike_first)
    hair, shade = np.zeros((2, *shape), np.float32)
    for _ in range(_LEARNING.rounds - 1):
        evidence = _evidence(lessons.colors(probability), lessons.bins, hair, shade)
        skin = face_component(_log_odds(evidence, prior, visible) > 0, prior.foreground, prior) & visible
        probability = logistic(evidence + _LEARNING.prior_weight * prior.log_odds)
        taken, refused = np.maximum(probability, _LEARNING.agree), np.minimum(probability, _LEARNING.disagree)
        probability = np.where(skin, taken, refused)
        found = find_hair(rgb, skin | ~visible, prior)
        if found is not None:
            hair, shade = hair_cover(rgb, skin, prior, found), deep_shade(rgb, prior, found)
    colors = lessons.colors(probability)
    by_rules = logistic(_log_odds(_evidence(colors, lessons.bins, hair, shade), prior, visible))
    predicted = network.predict_skin(rgb, prior, by_rules)
    final = np.where(visible, network.fused(by_rules, predicted), 0)
    cut = minimum_cut(rgb, network.log_odds(final))
    mask = face_component(cut, network.certain(prior, predicted), prior) & visible
    return Segmentation(mask, colors, prior, color, rgb)


@dataclass(frozen=True, eq=False)
class _Lessons:
    """What the cells (h, w) of a picture teach of the colours of skin and of what is around it.

    bins: the cells' colours, of `scale`;  likeness: in [0, 1], to the sample of the skin;
    foreground, visible: bool, what is skin for sure, and within the picture;
    around: weight as surroundings of what is none;  unsure: probability of skin that a cell has at least beside those.
    """

    scale: ColorScale
    bins: NDArray[np.intp]
    likeness: Floats
    foreground: Bools
    visible: Bools
    around: Floats
    unsure: Floats

    @classmethod
    def of(cls, scale: ColorScale, lab: Floats, tonal: Floats, prior: SpatialPrior, visible: Bools) -> _Lessons:
        """Those of colours lab (h, w, 3);  tonal: (h, w) their distance to the skin's, see `squared_distances`."""
        likeness = np.exp(-_LEARNING.likeness_decay * np.maximum(tonal - _LEARNING.likeness_from, 0))
        away = np.exp(-_LEARNING.around_decay * np.maximum(prior.outside - _LEARNING.around_from, 0))
        around = away * np.where(prior.face, _LEARNING.inside_weight, 1)
        # how high a forehead rises nobody knows: what is like skin there does not teach that the skin's colour is none
        unsure = _LEARNING.unsure * likeness**2 * prior.forehead
        return cls(scale, scale.bins(lab), likeness, prior.foreground, visible, around, unsure)

    def colors(self, probability: Floats) -> SkinColors:
        """The colour models that cells teach when they are skin with this probability (h, w)."""
        # without the anchor to the sample, a fringe once taken for skin would teach that hair is skin
        own = probability * self.likeness
        other = np.where(self.foreground, 0, 1 - np.maximum(own, self.unsure)) * self.around
        inner, outer = own * self.visible, other * self.visible
        return SkinColors.fit(self.scale, self.bins, inner.astype(np.float32), outer.astype(np.float32))


def _evidence(colors: SkinColors, bins: NDArray[np.intp], hair: Floats, shade: Floats) -> Floats:
    """(h, w) nats for skin by colour, less under hair, and more in a brim's shade;  hair, shade: (h, w) in [0, 1]."""
    evidence = colors.evidence_of(bins)
    evidence = evidence + shade * np.maximum(SKIN_PRIOR.shade.log_odds - evidence, 0)
    return np.asarray(evidence - SKIN_PRIOR.hair.log_odds * hair)


def _log_odds(evidence: Floats, prior: SpatialPrior, visible: Bools) -> Floats:
    """(h, w) float32 log-odds of skin by place and evidence; beyond the picture there is none."""
    log_odds: Floats = np.where(visible, prior.log_odds + evidence, _LEARNING.unseen).astype(np.float32)
    return log_odds


def _distances(lab: Floats, sample: Bools, throat: Bools, prior: SpatialPrior) -> tuple[Floats, Floats]:
    """`squared_distances` (h, w) of colours (h, w, 3) to the skin's; on the neck to those of a bare throat, if less.

    sample, throat: (h, w) bool, the cells that stand for face and throat.
    """
    of_face = squared_distances(lab, lab[sample], prior.face)
    if not throat.any():
        return of_face
    of_throat = squared_distances(lab, lab[throat], prior.face)
    on_neck = prior.neck > _THROAT.neck
    distance, tonal = (
        np.where(on_neck, np.minimum(face, own), face) for face, own in zip(of_face, of_throat, strict=True)
    )
    return distance, tonal


def _bare_throat(lab: Floats, prior: SpatialPrior, visible: Bools, scale: ColorScale) -> Bools:
    """(h, w) bool: cells of the throat, if it is bare; none where it is covered, or cannot be told.

    A neck is lit by other light than the face: its colour may lie further from the face's than cloth does. It is skin
    if it has the hue of skin, is even, and is not what the shoulders wear.
    """
    (from_chin, to_collar), (from_collar, to_chest) = _THROAT.along, _THROAT.shoulders
    along, off = prior.along, prior.off
    throat = (along > from_chin) & (along < to_collar) & (off < _THROAT.off) & visible
    nothing: Bools = np.zeros(visible.shape, np.bool_)
    if int(throat.sum()) < _LEARNING.least_sample:
        return nothing
    center = np.median(lab[throat], axis=0)
    chroma, own = (float(np.hypot(*one[1:])) for one in (center, scale.center))
    hue = float(np.arctan2(center[2], center[1]))
    is_skin = (
        -_THROAT.darker < float(center[0] - scale.center[0]) < _THROAT.lighter
        and center[1] > _THROAT.least_red
        and chroma > _THROAT.least_chroma * own
        and _THROAT.hue[0] < hue < _THROAT.hue[1]
    )
    uneven = float(np.linalg.norm(median_deviation(lab[throat], center) / scale.spread))
    if not is_skin or uneven > _THROAT.uneven:
        return nothing
    shoulders = (along > from_collar) & (along < to_chest) & (off > _THROAT.beside) & visible
    if int(shoulders.sum()) >= _LEARNING.least_sample:
        worn = np.median(lab[shoulders], axis=0)
        if float(np.linalg.norm((worn - center) / scale.spread)) < _THROAT.cloth:
            return nothing
    return throat


def _sample(lab: Floats, prior: SpatialPrior, visible: Bools) -> Bools:
    """(h, w) bool: the cells whose colours lab (h, w, 3) stand for the skin's."""
    sample, cheeks = prior.sample & visible, prior.cheeks & visible
    if int(sample.sum()) < _LEARNING.least_sample:
        sample = prior.face & visible
        return sample if int(sample.sum()) >= _LEARNING.least_sample else np.ones(visible.shape, np.bool_)
    upper = sample & ~cheeks
    if min(int(cheeks.sum()), int(upper.sum())) < _LEARNING.least_sample:
        return sample
    # dark glasses outweigh the cheeks
    glasses = float(np.median(lab[cheeks][:, 0]) - np.median(lab[upper][:, 0])) > _LEARNING.glasses_darker
    return cheeks if glasses else sample


def _refine(rgb: Bytes, small: Bools, factor: float) -> Bools:
    """A small mask (h', w') at the size of rgb (h, w, 3), its edge moved to the picture's edges by a guided filter.

    factor: how many times as large the picture is.
    """
    h, w = rgb.shape[:2]
    large = cv2.resize(small.astype(np.float32), (w, h), interpolation=cv2.INTER_LINEAR)
    radius = max(2, round(_LEARNING.refine_radius * factor))
    return fill_holes(cv2.ximgproc.guidedFilter(rgb, large, radius, _LEARNING.refine_epsilon) > 0.5)
