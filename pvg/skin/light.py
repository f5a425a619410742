"""A face's colour, and dim or tinted pictures brought to the light in which skin is told.

Colour distances, hair, edges and the networks know people as they are photographed: on a third of a picture's levels
a fair fringe is the skin's colour and cloth as grey as a hand, and lavender skin is no skin.
"""

from __future__ import annotations

import cv2
import numpy as np

from pvg._arrays import Bools, Bytes, Floats, ramp, short_turn
from pvg.skin._kernels import level_quantiles
from pvg.skin.color_model import to_skin_lab
from pvg.skin.parameters import SKIN_PRIOR

_LIGHT = SKIN_PRIOR.light

_MIDDLE, _MIDDLE_AND_LIT = np.array([0.5]), np.array([0.5, *_LIGHT.lit])

MID_GREY = 128  # 8-bit levels, where nothing of the face is seen


def face_color(rgb: Bytes, sample: Bools) -> Floats:
    """(3,) median colour of the middle of a face, RGB levels: the cells `sample` (h, w) bool of rgb (h, w, 3).

    A face of which more than half lies in the shade counts as brighter than its median, so that its lit part is not
    driven into white where that is brought to usual light (`gain_of`).
    """
    levels = np.empty((len(_MIDDLE_AND_LIT), 3), np.float64)
    if not level_quantiles(rgb, sample, _MIDDLE_AND_LIT, levels):
        return np.full(3, MID_GREY, np.float32)
    levels = np.maximum(levels, _LIGHT.dimmest)
    middle, lit = (
        levels[0],
        levels[1:].mean(axis=0),
    )  # of several quantiles: one leaps where light and shade have an edge
    return np.asarray(middle * max(1.0, float(lit.max()) * _LIGHT.level / 255 / float(middle.max())), np.float32)


def median_color(rgb: Bytes, sample: Bools) -> Floats | None:
    """(3,) the median of rgb (h, w, 3) in the cells `sample` (h, w), channel by channel; None where there are none."""
    color = np.empty((1, 3), np.float64)
    return color[0].astype(np.float32) if level_quantiles(rgb, sample, _MIDDLE, color) else None


def most_chroma(rgb: Bytes, visible: Bools, color: Floats) -> float:
    """The chroma in Lab, at one lightness, that few cells `visible` (h, w) of a picture (h, w, 3) around a face pass.

    color: (3,) RGB levels, the face's. A dim face is lit for it, but not made usual: then a nearly black-and-white
    picture would have the chroma of others.
    """
    lab = to_skin_lab(relit(rgb, np.full(3, _brightness(color), np.float32)))[visible]
    return float(np.percentile(np.hypot(lab[:, 1], lab[:, 2]), _LIGHT.few)) if len(lab) else 0.0


def gain_of(color: Floats) -> Floats:
    """(3,) float32, the gain to usual light for a picture in which a face has the colour (3,), RGB levels.

    1 where skin has a usual hue and chroma and light enough. Others are the light's or the camera's, but for greys,
    whose hue is chance (von Kries' rule on the levels).
    """
    usual = _of_usual_tint(color)
    return np.asarray(_brightness(usual) * usual / color, np.float32)


def gain_back(learned: Floats, color: Floats) -> Floats:
    """(3,) float32, the gain from a picture in which a face has the colour (3,) to the light it was `learned` in.

    The face was learned in usual light (`gain_of`), however far that is; what has limits is the change beyond it, since
    the face may be what changed.
    """
    usual = gain_of(color)
    return np.asarray(usual * np.clip(learned / (usual * color), *_LIGHT.change), np.float32)


def _brightness(color: Floats) -> float:
    return float(np.clip(_LIGHT.level / color.max(), 1, _LIGHT.most))


def _of_usual_tint(color: Floats) -> Floats:
    """A face's colour (3,), brought to a hue and chroma of skin as far as it has none.

    Lamps of any colour turn the hue far, and it is turned to the middle of skin's. A camera's white that is too cool
    reddens skin and makes it pale, one that is too warm makes it vivid: such skin is brought to the nearest usual.
    """
    lab = cv2.cvtColor(np.reshape(color / 255, (1, 1, 3)).astype(np.float32), cv2.COLOR_RGB2Lab)[0, 0]
    chroma = float(np.hypot(*lab[1:]))
    off = short_turn(float(np.degrees(np.arctan2(lab[2], lab[1]))) - _LIGHT.hue)
    near = max(off, _LIGHT.reddest)
    reddened = ramp(near - off, 0.0, _LIGHT.reddened)
    palest = _LIGHT.palest + reddened * (_LIGHT.palest_red - _LIGHT.palest)
    light = ((float(lab[0]) + 16) / (SKIN_PRIOR.colors.lightness + 16)) ** 0.5
    usual = min(max(chroma, light * palest), light * _LIGHT.most_vivid)
    far = ramp(abs(off), *_LIGHT.strange)
    if near == off and far == 0 and usual == chroma:
        return color
    least, most = _LIGHT.chroma
    usual += far * (min(max(chroma, least), most) - usual)
    share = ramp(chroma, *_LIGHT.hueless)
    angle = np.radians(_LIGHT.hue + (1 - far) * near)
    moved = np.array([[[lab[0], usual * np.cos(angle), usual * np.sin(angle)]]], np.float32)
    turned = cv2.cvtColor(moved, cv2.COLOR_Lab2RGB)[0, 0]
    return np.asarray(color + share * (np.clip(255 * turned, _LIGHT.dimmest, 255) - color), np.float32)


def relit(rgb: Bytes, gain: Floats) -> Bytes:
    """A picture (h, w, 3) uint8 times a gain (3,), in whole levels rounded down."""
    if (gain == 1).all():
        return rgb
    levels = np.clip(np.arange(256)[:, None] * gain, 0, 255).astype(np.uint8)
    return np.asarray(cv2.LUT(rgb, levels[None]), np.uint8)


def lab_in_light(rgb: Bytes, gain: Floats) -> Floats:
    """Colours (h, w, 3) times a gain (3,), in Lab at one lightness, see `to_skin_lab`."""
    return to_skin_lab(relit(rgb, gain))
