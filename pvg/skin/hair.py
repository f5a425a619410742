"""What lies over the forehead: hair, whose colours mix with the skin nearby, and the deep shade of a brim."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from pvg._arrays import Bools, Bytes, Floats, smoothstep
from pvg.skin._kernels import mixture_share
from pvg.skin.prior import Places

VEIL_ODDS = 7.0  # nats against skin where hair covers it
_NEAR = 0.06  # face sizes: reach of the average that says what skin looks like here
_COARSE = 4  # cells of the picture a cell of that average
_RING = (0.06, 0.30)  # face sizes outside the contour: the hair that may hang down, beyond the shade of a hat's brim
_LEAST_RING = 30  # cells
_FAIR = 20.0  # in L: hair that differs less from skin is told by its hue
_NOISE = 10.0  # 8-bit levels
_FAIR_SPREAD = np.array([4.0, 1.5, 1.5], np.float32)  # Lab
_LEAST_CONTRAST = 2.0  # spreads between skin and hair
_OFF_LINE = {True: 0.7, False: 0.35}  # of the contrast: colours further from the line between both are no mixture
_LITTLE, _MUCH = 0.33, 0.63  # shares of hair: from a shade that may be skin's to hair
_ROUNDS = 4
_FALLEN = (0.6, 0.9)  # shares of what is above a brow's cell that hair covers: a gap between locks bares no brow
_SHADE = 0.35  # of the skin's brightness: deeper shade shows no colour to tell skin by
_SHADE_NOISE = 8.0  # 8-bit levels
_UNLIKE_HAIR = (25.0, 50.0)  # 8-bit levels between a shade and the hair or hat above it
_SHADE_REACH = 0.12  # face sizes outside the contour: a brim stands off the forehead
_TRUST = {True: 0.3, False: 1e-3}  # weight of the cheeks' colour beside that of skin nearby, for fair and dark hair


@dataclass(frozen=True, eq=False)
class Hair:
    """What may hang before the forehead.

    fair: whether its lightness is like the skin's; then colours are Lab, else RGB;
    color: (3,);  precision: (3, 3), the inverse covariance of its and the skin's colours.
    """

    fair: bool
    color: Floats
    precision: Floats


def find_hair(rgb: Bytes, skin: Bools, where: Places) -> Hair | None:
    """The colours about the forehead, or None where nothing of it is seen.

    rgb: (h, w, 3) uint8;  skin: (h, w) bool, what is not to count.
    """
    ring = where.upper & (where.outside > _RING[0]) & (where.outside < _RING[1]) & ~skin
    if int(ring.sum()) < _LEAST_RING or int(where.sample.sum()) < _LEAST_RING:
        return None
    lab = _space(rgb, fair=True)
    colors, own = lab[ring], lab[where.sample]
    center, tone = np.median(colors, axis=0), np.median(own, axis=0)
    if abs(float(center[0] - tone[0])) > _FAIR:
        return Hair(False, np.median(rgb[ring], axis=0).astype(np.float32), np.eye(3, dtype=np.float32) / _NOISE**2)
    spread = np.diag(_FAIR_SPREAD**2)
    for part in (colors - center, own - tone):
        near = part[(np.abs(part) <= 3 * 1.4826 * np.median(np.abs(part), axis=0) + 1).all(axis=1)]
        spread = spread + near.T @ near / max(len(near), 1)
    return Hair(True, center.astype(np.float32), np.linalg.inv(spread).astype(np.float32))


def veil(rgb: Bytes, skin: Bools, where: Places, hair: Hair) -> Floats:
    """How surely hair covers each cell of the forehead: (h, w) float32 in [0, 1].

    rgb: (h, w, 3) uint8;  skin: (h, w) bool, a first mask.
    A cell is a mixture, colour = (1 - t) skin + t hair. The skin's colour is averaged nearby without what is covered,
    so that it follows the forehead's shading. t is told along Fisher's direction: for fair hair, whose strands are as
    light as skin, mostly by hue.
    """
    color = _space(rgb, fair=hair.fair)
    weight = (where.sample | (skin & where.upper)).astype(np.float32)
    h, w = weight.shape
    size = (max(1, w // _COARSE), max(1, h // _COARSE))
    small = np.asarray(cv2.resize(color, size, interpolation=cv2.INTER_AREA), np.float32)
    bare = np.asarray(cv2.resize(weight, size, interpolation=cv2.INTER_AREA), np.float32)
    base = np.median(color[where.sample], axis=0) if where.sample.any() else color.mean(axis=(0, 1))
    sigma = max(0.5, _NEAR * where.size / _COARSE)
    own = np.asarray(np.broadcast_to(base, small.shape), np.float32)
    for _ in range(_ROUNDS):
        seen = bare * np.clip(1 - 2 * _share(small, own, hair), 0, 1) ** 2
        total = cv2.GaussianBlur(small * seen[..., None], (0, 0), sigma) + _TRUST[hair.fair] * base
        own = np.asarray(total / (cv2.GaussianBlur(seen, (0, 0), sigma) + _TRUST[hair.fair])[..., None], np.float32)
    share = _share(color, np.asarray(cv2.resize(own, (w, h)), np.float32), hair)
    covered = np.where(where.sure, 0, smoothstep(share, _LITTLE, _MUCH))
    if not covered[where.brows].any():
        return np.asarray(covered * where.upper, np.float32)
    # brows are as dark as hair: they are covered where the forehead is, from above
    out = np.asarray(covered * where.upper, np.float32)
    reach = len(where.above) // 2
    about = tuple(_span(np.asarray(where.brows.any(axis=axis)), reach) for axis in (1, 0))
    above = where.above.astype(np.float32) / max(1, int(where.above.sum()))
    share_above = np.asarray(cv2.filter2D(covered[about], -1, above, borderType=cv2.BORDER_REPLICATE), np.float32)
    fallen = covered[about] * smoothstep(share_above, *_FALLEN)
    out[about] = np.where(where.brows[about], fallen, out[about])
    return out


def _span(used: Bools, margin: int) -> slice:
    """The indices from the first to the last True of `used` (n,), and `margin` more on either side."""
    first, last = np.flatnonzero(used)[[0, -1]]
    return slice(max(0, int(first) - margin), int(last) + margin + 1)


def deep_shade(rgb: Bytes, where: Places, hair: Hair) -> Floats:
    """How surely a dark cell of the forehead is skin in the shade of what is above it: (h, w) float32 in [0, 1].

    rgb: (h, w, 3) uint8. Such a cell has the skin's colour times a small factor and is unlike the hair or hat.
    """
    shape = where.upper.shape
    if hair.fair or not where.sample.any():
        return np.zeros(shape, np.float32)
    color = np.asarray(rgb, np.float32)
    own = np.median(color[where.sample], axis=0)
    light = (color @ own) / max(float(own @ own), 1.0)
    off = np.linalg.norm(color - light[..., None] * own, axis=2)
    unlike = smoothstep(np.asarray(np.linalg.norm(color - hair.color, axis=2), np.float32), *_UNLIKE_HAIR)
    shade = unlike * np.exp(-((off / _SHADE_NOISE) ** 2)) * (light < _SHADE)
    return np.asarray(shade * (where.upper & (where.outside < _SHADE_REACH)), np.float32)


def _space(rgb: Bytes, *, fair: bool) -> Floats:
    """(h, w, 3) float32: Lab for fair hair, RGB 0-255 for other."""
    color = np.asarray(rgb, np.float32)
    return np.asarray(cv2.cvtColor(color / 255, cv2.COLOR_RGB2Lab), np.float32) if fair else color


def _share(color: Floats, own: Floats, hair: Hair) -> Floats:
    """t (h, w) of color = (1 - t) own + t hair, for (h, w, 3) colours; 0 for those that are no such mixture."""
    share = np.empty(color.shape[:2], np.float32)
    least, width = np.float32(_LEAST_CONTRAST**2), np.float32(_OFF_LINE[hair.fair])
    mixture_share(color, own, hair.color, hair.precision, least, width, share)
    return share
