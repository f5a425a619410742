"""The skin of a face through a clip: colours learnt on the key frame, followed frame by frame."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from pvg._arrays import Bools, Bytes, Floats
from pvg.face import Landmarks
from pvg.picture import Picture, as_picture
from pvg.raster import Raster
from pvg.skin._kernels import skin_share
from pvg.skin.cleanup import gather
from pvg.skin.color_model import SkinColors, to_skin_lab
from pvg.skin.hair import VEIL_ODDS, Hair, find_hair, veil
from pvg.skin.matte import Matte
from pvg.skin.occlusion import occlusion, open_skin
from pvg.skin.prior import Places, face_area, face_box, head_shape, locate
from pvg.skin.segmentation import WORK_FACE_PX, MaskMethod, chroma_mask, cut_skin
from pvg.skin.warp import spline_map

_CELLS_SMALL, _CELLS_LARGE = 192, 256  # longer side of the raster, for boxes of up to 768 and from 1024 px
_EVERY = 4  # each so many'th landmark is a knot of the spline that carries the key frame's shape
_KEEP = 0.6  # weight of the frame before where the picture did not change
_CHANGE = 6.0  # 8-bit levels of change that end it
_HYSTERESIS = 0.3
_EDGE_CELLS = 2.0
_EDGE = (0.15, 0.8)
_ALPHA_STEP = 5  # the matte's grey levels are multiples of this: 52 of them


def first_raster(landmarks: Landmarks) -> Raster:
    """The raster for a track that starts with these landmarks."""
    box = face_box(landmarks)
    width, height = (float(v) for v in box[2:] - box[:2])
    longer = max(width, height)
    step = max(1.0, longer / min(_CELLS_LARGE, max(_CELLS_SMALL, longer / 4)))
    shape = (max(8, round(height / step)), max(8, round(width / step)))
    return Raster.centered(box, step, shape)


@dataclass(frozen=True, eq=False)
class LearnedSkin:
    """What the key frame teaches about a face's skin.

    colors: likelihood table;  light: (3,) RGB of the middle of the face;
    inside: (h, w) float32 signed distance to the mask's edge in face sizes, positive on skin, over a raster in
    which the stacked landmarks and skin points lie at `points` (194, 2);  open: (h, w) float32, 1 on skin that shows
    its own hue.
    """

    colors: SkinColors
    light: Floats
    hair: Hair | None
    inside: Floats
    open: Floats
    points: Floats


@dataclass(frozen=True, eq=False)
class SkinModel:
    """How the masks of a track are made; `learned` is None for the paper's rule, which learns nothing."""

    method: MaskMethod
    learned: LearnedSkin | None


def fit_skin_model(frame: Picture | Bytes, landmarks: Landmarks, *, method: MaskMethod = "landmarks") -> SkinModel:
    """Learn a face's skin on its key frame.

    frame: a picture or (H, W, 3) uint8 RGB;  landmarks: source pixels.
    """
    if method == "ycbcr":
        return SkinModel(method, None)
    # as fine as stills are cut, whatever the track's raster
    box = face_box(landmarks)
    step = max(1.0, head_shape(landmarks).size / WORK_FACE_PX)
    shape = (max(8, round(float(box[3] - box[1]) / step)), max(8, round(float(box[2] - box[0]) / step)))
    raster = Raster.centered(box, step, shape)
    own = landmarks.in_cells(raster)
    picture = as_picture(frame)
    small, visible = picture.cells(raster), raster.inside(picture.size)
    cut = cut_skin(small, own, visible)
    where = locate(raster.shape, own)
    skin = cut.mask.astype(np.uint8)
    inside = cv2.distanceTransform(skin, cv2.DIST_L2, 5) - cv2.distanceTransform(1 - skin, cv2.DIST_L2, 5)
    learned = LearnedSkin(
        colors=cut.colors,
        light=_light(small, where.sample & visible),
        hair=find_hair(small, cut.mask | ~visible, where),
        inside=np.asarray(inside / where.size, np.float32),
        open=open_skin(to_skin_lab(small), cut.colors.scale, cut.mask),
        points=own.stacked,
    )
    return SkinModel(method, learned)


def _light(rgb: Bytes, sample: Bools) -> Floats:
    """(3,) median colour of the middle of the face."""
    if not sample.any():
        return np.array([128, 128, 128], np.float32)
    return np.asarray(np.maximum(np.median(rgb[sample], axis=0), 4.0), np.float32)


@dataclass(frozen=True, eq=False)
class _Moment:
    """What one frame leaves to the next: its grey picture, skin probability, mask and matte, (h, w) each."""

    grey: Bytes
    skin: Floats
    mask: Floats
    alpha: Floats


class SkinTracker:
    """Makes the matte of each frame of a track, in order."""

    def __init__(self, model: SkinModel) -> None:
        self._model = model
        self._raster: Raster | None = None
        self._before: _Moment | None = None
        self._flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_ULTRAFAST)

    def step(self, frame: Picture | Bytes, landmarks: Landmarks) -> Matte:
        """The matte of the next frame, a picture or (H, W, 3) uint8 RGB;  landmarks: source pixels."""
        picture = as_picture(frame)
        raster = self._next_raster(landmarks)
        small, visible = picture.cells(raster), raster.inside(picture.size)
        own = landmarks.in_cells(raster)
        if self._model.learned is None:
            mask = chroma_mask(small, face_area(raster.shape, own), visible)
            return Matte.over(raster.box, mask.astype(np.uint8) * np.uint8(255), mask)
        where = locate(raster.shape, own)
        skin, hidden = _skin_now(self._model.learned, small, where, own.stacked, visible)
        mask, alpha = self._settle(small, skin, where, visible)
        mask, alpha = mask & (hidden < 0.5), alpha * (1 - hidden)  # last, so that what comes back is still known
        levels = np.rint(alpha * (255 / _ALPHA_STEP)) * _ALPHA_STEP
        return Matte.over(raster.box, levels.astype(np.uint8), mask)

    def _next_raster(self, landmarks: Landmarks) -> Raster:
        if self._raster is None:
            self._raster = first_raster(landmarks)
            return self._raster
        box = face_box(landmarks)
        h, w = self._raster.shape
        step = max(1.0, float(box[2] - box[0]) / w, float(box[3] - box[1]) / h)
        self._raster = Raster.centered(box, step, (h, w))
        return self._raster

    def _settle(self, rgb: Bytes, skin: Floats, where: Places, visible: Bools) -> tuple[Bools, Floats]:
        """Mask and matte (h, w) of this frame's skin, held to those of the frame before where nothing changed."""
        grey = np.asarray(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), np.uint8)
        if self._before is None:
            mask = gather(skin > 0.5, where)
            alpha = _soft_edge(skin, mask)
        else:
            before, keep = self._carry(self._before, grey)
            skin = (skin + keep * (before.skin - skin)).astype(np.float32)
            mask = gather(skin + _HYSTERESIS * keep * (before.mask - 0.5) > 0.5, where)
            alpha = _soft_edge(skin, mask)
            alpha = (alpha + keep * (before.alpha - alpha)).astype(np.float32)
        self._before = _Moment(grey, skin, mask.astype(np.float32), alpha)
        # a cell more than is seen, or sampling the matte would fade it along the picture's edge
        seen = cv2.dilate(visible.astype(np.uint8), np.ones((3, 3), np.uint8)) if visible.any() else 0
        return mask & visible, (alpha * seen * where.fade).astype(np.float32)

    def _carry(self, before: _Moment, grey: Bytes) -> tuple[_Moment, Floats]:
        """The frame before moved onto this one by optical flow, and how far to trust it: (h, w) in [0, 1)."""
        h, w = grey.shape
        flow = self._flow.calc(grey, before.grey, np.zeros((h, w, 2), np.float32))
        map_x = np.asarray(flow[..., 0] + np.arange(w), np.float32)
        map_y = np.asarray(flow[..., 1] + np.arange(h)[:, None], np.float32)

        def moved(values: Floats) -> Floats:
            out = cv2.remap(values, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            return np.asarray(out, np.float32)

        seen = moved(before.grey.astype(np.float32))
        change = cv2.blur(np.abs(seen - grey), (5, 5))
        keep = np.asarray(_KEEP * np.exp(-((change / _CHANGE) ** 2)), np.float32)
        return _Moment(grey, moved(before.skin), moved(before.mask), moved(before.alpha)), keep


def _skin_now(learned: LearnedSkin, rgb: Bytes, where: Places, points: Floats, visible: Bools) -> tuple[Floats, Floats]:
    """Probability of skin (h, w) from this frame alone: colours, the face's places and the key frame's shape.

    And how surely something lies before it, (h, w) in [0, 1].
    """
    # a lamp or a cloud that changes the face changes what surrounds it alike: undo it before colours are looked up
    gain = np.clip(learned.light / _light(rgb, where.sample & visible), 0.2, 5.0)
    levels = np.clip(np.arange(256)[:, None] * gain, 0, 255).astype(np.uint8)
    lit = np.asarray(cv2.LUT(rgb, levels[None]), np.uint8)
    lab = to_skin_lab(lit)
    map_x, map_y = spline_map(where.face.shape, points[::_EVERY], learned.points[::_EVERY])
    inside = cv2.remap(learned.inside, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    was_open = cv2.remap(learned.open, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
    hidden = occlusion(lab, learned.colors.scale, np.asarray(was_open, np.float32), where)
    covered = np.zeros(where.face.shape, np.float32)
    if learned.hair is not None:
        covered = veil(lit, inside > -0.02, where, learned.hair)
    # beyond the picture its edge is repeated, and so is the decision there: skin ends at the edge, it does not fade
    share = _share(learned.colors, lab, where, np.asarray(inside, np.float32), covered)
    radius = max(2, round(0.035 * where.size))
    filtered = cv2.ximgproc.guidedFilter(rgb, share, radius, 120.0)
    return np.asarray(np.clip(filtered, 0, 1), np.float32), hidden


def _share(colors: SkinColors, lab: Floats, where: Places, inside: Floats, covered: Floats) -> Floats:
    """Probability of skin (h, w) by colours (h, w, 3), the carried shape `inside` and what hair covers, (h, w) each."""
    share = np.empty(inside.shape, np.float32)
    cell = colors.scale.cell()
    prior, neck = (where.prior, where.neckness)  # the neck does not turn with the head
    skin_share(lab, *cell, colors.table, where.sure, prior, neck, inside, covered, np.float32(VEIL_ODDS), share)
    return share


def _soft_edge(skin: Floats, mask: Bools) -> Floats:
    """The matte: the skin probability about the mask's edge, 1 inside and 0 away from it."""
    near = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), _EDGE_CELLS)
    alpha = np.clip((skin - _EDGE[0]) / (_EDGE[1] - _EDGE[0]), 0, 1)
    return np.asarray(np.where(near > 0.97, 1.0, np.where(near < 0.03, 0.0, alpha)), np.float32)
