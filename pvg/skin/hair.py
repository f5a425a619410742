"""What lies over the forehead: hair, whose colours mix with those of the skin nearby, and the deep shade of a brim."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from pvg._arrays import Bools, Bytes, Floats, smoothstep
from pvg.skin._kernels import hair_fraction
from pvg.skin.color_model import inlier_covariance
from pvg.skin.light import median_color
from pvg.skin.parameters import SKIN_PRIOR
from pvg.skin.prior import SpatialPrior

_HAIR, _SHADE = SKIN_PRIOR.hair, SKIN_PRIOR.shade


@dataclass(frozen=True, eq=False)
class Hair:
    """What may hang in front of the forehead.

    fair: whether its lightness is like the skin's; then colours are Lab, else RGB;
    color: (3,);  precision: (3, 3), the inverse covariance of its and the skin's colours.
    """

    fair: bool
    color: Floats
    precision: Floats


def find_hair(rgb: Bytes, skin: Bools, prior: SpatialPrior) -> Hair | None:
    """The colours around the forehead, or None where nothing of it is seen.

    rgb: (h, w, 3) uint8;  skin: (h, w) bool, what is not to count.
    """
    nearest, furthest = _HAIR.ring
    ring = prior.forehead & (prior.outside > nearest) & (prior.outside < furthest) & ~skin
    if int(ring.sum()) < _HAIR.least_ring or int(prior.sample.sum()) < _HAIR.least_ring:
        return None
    lab = _color_space(rgb, fair=True)
    colors, own = lab[ring], lab[prior.sample]
    center, tone = np.median(colors, axis=0), np.median(own, axis=0)
    if abs(float(center[0] - tone[0])) > _HAIR.fair_within:
        precision = np.eye(3, dtype=np.float32) / _HAIR.dark_noise**2
        return Hair(False, np.median(rgb[ring], axis=0).astype(np.float32), precision)
    covariance = np.diag(np.array(_HAIR.fair_noise, np.float32) ** 2)
    for values, middle in ((colors, center), (own, tone)):
        covariance = covariance + inlier_covariance(values, middle, _HAIR.inlier, _HAIR.inlier_margin)
    return Hair(True, center.astype(np.float32), np.linalg.inv(covariance).astype(np.float32))


def hair_cover(rgb: Bytes, skin: Bools, prior: SpatialPrior, hair: Hair) -> Floats:
    """How surely hair covers each cell of the forehead: (h, w) float32 in [0, 1].

    rgb: (h, w, 3) uint8;  skin: (h, w) bool, a first mask.
    A cell is a mixture, colour = (1 − t) skin + t hair. The skin's colour is averaged nearby without what is covered,
    so that it follows the forehead's shading. t is told along Fisher's direction: for fair hair, whose strands are as
    light as skin, mostly by hue.
    """
    color = _color_space(rgb, fair=hair.fair)
    weight = (prior.sample | (skin & prior.forehead)).astype(np.float32)
    cheeks = None if hair.fair else median_color(rgb, prior.sample)  # of whole levels it is found sooner
    fraction = _hair_fraction(color, _local_skin(color, weight, prior, hair, cheeks), hair)
    covered = np.where(prior.foreground, 0, smoothstep(fraction, *_HAIR.cover_rise))
    return np.asarray(covered * prior.forehead, np.float32)


def _local_skin(color: Floats, weight: Floats, prior: SpatialPrior, hair: Hair, cheeks: Floats | None) -> Floats:
    """(h, w, 3): the skin's colour around each cell, from colours (h, w, 3) with weights (h, w) that hair may cover.

    Averages and fractions of hair are computed in turn, on coarser cells.  cheeks: (3,) median colour of the prior's
    sample, where it is known.
    """
    h, w = weight.shape
    size = (max(1, w // _HAIR.coarse), max(1, h // _HAIR.coarse))
    small = np.asarray(cv2.resize(color, size, interpolation=cv2.INTER_AREA), np.float32)
    weight = np.asarray(cv2.resize(weight, size, interpolation=cv2.INTER_AREA), np.float32)
    if cheeks is None:
        cheeks = np.median(color[prior.sample], axis=0) if prior.sample.any() else color.mean(axis=(0, 1))
    trust = _HAIR.fair_trust if hair.fair else _HAIR.dark_trust
    sigma = max(_HAIR.least_sigma, _HAIR.near * prior.size / _HAIR.coarse)
    skin = np.asarray(np.broadcast_to(cheeks, small.shape), np.float32)
    for _ in range(_HAIR.rounds):
        bare = weight * np.clip(1 - _HAIR.bare * _hair_fraction(small, skin, hair), 0, 1) ** 2
        total = cv2.GaussianBlur(small * bare[..., None], (0, 0), sigma) + trust * cheeks
        skin = np.asarray(total / (cv2.GaussianBlur(bare, (0, 0), sigma) + trust)[..., None], np.float32)
    return np.asarray(cv2.resize(skin, (w, h)), np.float32)


def deep_shade(rgb: Bytes, prior: SpatialPrior, hair: Hair) -> Floats:
    """How surely a dark cell of the forehead is skin in the shade of what is above it: (h, w) float32 in [0, 1].

    rgb: (h, w, 3) uint8. Such a cell has the skin's colour times a small factor and is unlike the hair or hat.
    """
    shape = prior.forehead.shape
    if hair.fair or not prior.sample.any():
        return np.zeros(shape, np.float32)
    color = np.asarray(rgb, np.float32)
    skin = np.median(color[prior.sample], axis=0)
    light = (color @ skin) / max(float(skin @ skin), 1.0)
    off = np.linalg.norm(color - light[..., None] * skin, axis=2)
    unlike = smoothstep(np.asarray(np.linalg.norm(color - hair.color, axis=2), np.float32), *_SHADE.unlike_hair)
    shade = unlike * np.exp(-((off / _SHADE.noise) ** 2)) * (light < _SHADE.darker)
    return np.asarray(shade * (prior.forehead & (prior.outside < _SHADE.reach)), np.float32)


def _color_space(rgb: Bytes, *, fair: bool) -> Floats:
    """(h, w, 3) float32: Lab for fair hair, RGB 0–255 for other."""
    color = np.asarray(rgb, np.float32)
    return np.asarray(cv2.cvtColor(color / 255, cv2.COLOR_RGB2Lab), np.float32) if fair else color


def _hair_fraction(color: Floats, skin: Floats, hair: Hair) -> Floats:
    """t (h, w) of color = (1 − t) skin + t hair, for (h, w, 3) colours; 0 for those that are no such mixture."""
    fraction = np.empty(color.shape[:2], np.float32)
    least, width = np.float32(_HAIR.least_contrast**2), np.float32(_HAIR.fair_line if hair.fair else _HAIR.dark_line)
    hair_fraction(color, skin, hair.color, hair.precision, least, width, np.float32(_HAIR.most), fraction)
    return fraction
