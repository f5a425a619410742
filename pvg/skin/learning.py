"""What a face's key frame teaches of its skin: colours, light, the shape of the mask, the hair around it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from pvg._arrays import Bools, Bytes, Doubles, Floats
from pvg.face import Landmarks
from pvg.haze import without_haze
from pvg.picture import Picture, as_picture
from pvg.skin.color_model import SkinColors, to_skin_lab
from pvg.skin.hair import Hair, find_hair
from pvg.skin.light import face_color, most_chroma
from pvg.skin.occlusion import open_skin
from pvg.skin.prior import goes_on_above
from pvg.skin.rasters import learning_raster
from pvg.skin.segmentation import MaskMethod, segment
from pvg.skin.tint import tint_slopes


@dataclass(frozen=True, eq=False)
class LearnedSkin:
    """What the key frame teaches of a face's skin.

    colors: log-likelihood ratios;  haze: levels of it over the frame they were learned from, see `pvg.haze`;
    light: (3,) RGB, the face's colour there in usual light;
    chroma: the most that it and its surroundings have there, see `most_chroma`;
    hair: the hair around the forehead, None where none is seen;
    distance: (h, w) float32 signed distance to the mask's edge in face sizes, positive on skin, over a raster in whose
    cells the stacked landmarks and skin points lie at `points` (194, 2);
    open: (h, w) float32 over the same raster, 1 on skin that shows its own hue;
    tint: (2, 2) how the light's colour changes over the face, see `tint_slopes`;
    bald: whether skin goes on above the forehead, up to the crown.
    """

    colors: SkinColors
    haze: int
    light: Floats
    chroma: float
    hair: Hair | None
    distance: Floats
    open: Floats
    points: Floats
    tint: Doubles
    bald: bool


@dataclass(frozen=True, eq=False)
class SkinModel:
    """How the masks of a track are made; `learned` is None for the paper's rule, which learns nothing."""

    learned: LearnedSkin | None


def fit_skin_model(
    frame: Picture | Bytes, landmarks: Landmarks, *, mask: MaskMethod = "landmarks", haze: int = 0
) -> SkinModel:
    """Learn a face's skin on its key frame.

    frame: a picture or (H, W, 3) uint8 RGB;  landmarks: source pixels;  mask: see `skin_mask`;
    haze: levels of it over the frame, see `pvg.haze`.
    """
    if mask == "ycbcr":
        return SkinModel(None)
    picture = as_picture(frame)
    learned, above = _learn(picture, landmarks, haze, bald=False)
    return SkinModel(_learn(picture, landmarks, haze, bald=True)[0] if above else learned)


def _learn(picture: Picture, landmarks: Landmarks, haze: int, *, bald: bool) -> tuple[LearnedSkin, bool]:
    """What a key frame teaches, and whether the face's box cuts its skin off at its top."""
    raster = learning_raster(landmarks, bald=bald)
    own = landmarks.in_cells(raster)
    visible = raster.inside(picture.size)
    seen = without_haze(picture.cells(raster), haze)
    found = segment(seen, own, visible, bald=bald)
    small, prior = found.rgb, found.prior
    sample = prior.sample & visible
    learned = LearnedSkin(
        colors=found.colors,
        haze=haze,
        light=face_color(small, sample),
        chroma=most_chroma(seen, visible, found.color),
        hair=find_hair(small, found.mask | ~visible, prior),
        distance=np.asarray(_signed_distance(found.mask) / prior.size, np.float32),
        open=open_skin(to_skin_lab(small), found.colors.scale, found.mask),
        points=own.stacked,
        tint=tint_slopes(small, sample, prior.size),
        bald=bald,
    )
    return learned, bool(visible[0].any()) and goes_on_above(found.mask, own)


def _signed_distance(mask: Bools) -> Floats:
    """(h, w) distance in cells to the edge of a mask, positive inside."""
    skin = mask.astype(np.uint8)
    inside, outside = (cv2.distanceTransform(part, cv2.DIST_L2, cv2.DIST_MASK_5) for part in (skin, 1 - skin))
    return np.asarray(inside - outside, np.float32)
