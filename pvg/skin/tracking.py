"""The skin of a face through a clip: what its key frame taught, followed frame by frame."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from pvg._arrays import Bools, Bytes, Floats, smoothstep
from pvg.face import Landmarks
from pvg.haze import without_haze
from pvg.picture import Picture, as_picture
from pvg.raster import Raster
from pvg.skin import network
from pvg.skin._kernels import CellEvidence, ColorOdds, PosteriorWeights, skin_probability
from pvg.skin.cleanup import face_component
from pvg.skin.collar import collar
from pvg.skin.color_model import SkinColors, to_skin_lab
from pvg.skin.consensus import MatteInTime
from pvg.skin.flow import FlowFinder
from pvg.skin.hair import hair_cover
from pvg.skin.in_time import SkinInTime, held, in_levels, moved, moved_layers, places_before, weight_of_before
from pvg.skin.learning import LearnedSkin, SkinModel
from pvg.skin.light import MID_GREY, face_color, gain_back, gain_of, relit
from pvg.skin.matte import Matte
from pvg.skin.network import NetworkOutput
from pvg.skin.occlusion import occluder_alpha
from pvg.skin.parameters import SKIN_PRIOR
from pvg.skin.prior import SpatialPrior, face_area, face_box, head_shape, spatial_prior
from pvg.skin.rasters import first_raster
from pvg.skin.scene import Scene
from pvg.skin.segmentation import red_chroma_mask
from pvg.skin.tint import tint_slopes, without_tilt
from pvg.skin.warp import rbf_warp

_TRACKING, _HAIR, _NETWORK = SKIN_PRIOR.tracking, SKIN_PRIOR.hair, SKIN_PRIOR.network


@dataclass(frozen=True, eq=False)
class _Left:
    """What one frame leaves to the next, over (h, w) cells.

    grey: the picture;  skin: what is held;  predicted: the network's probability of skin.
    """

    grey: Bytes
    skin: SkinInTime
    predicted: Floats


@dataclass(frozen=True, eq=False)
class _Carried:
    """The frame before where its cells are now.

    keep: (h, w) in [0, 1), its weight, less where the picture changed.
    """

    skin: SkinInTime
    predicted: Floats
    keep: Floats

    @property
    def changed(self) -> float:
        """Share of the cells that changed, in [0, 1]."""
        return 1 - float(self.keep.mean()) / _TRACKING.keep


class SkinTracker:
    """Makes the matte of each frame of a track, in order.

    light: (3,) RGB, the face's colour in the last frame;
    in_time: the last frame's matte with what it was made from, for `MatteConsensus`; None before the first frame and by
    the paper's rule;  network_output: the network's of that frame, None likewise.
    """

    def __init__(self, model: SkinModel) -> None:
        self.light = np.full(3, MID_GREY, np.float32) if model.learned is None else model.learned.light
        self._model = model
        self._raster: Raster | None = None
        self._before: _Left | None = None
        self._age = 0  # frames since the network was asked
        self.in_time: MatteInTime | None = None
        self.network_output: NetworkOutput | None = None
        self._flow = FlowFinder()

    def step(self, frame: Picture | Bytes, landmarks: Landmarks, scene: Scene | None = None) -> Matte:
        """The matte of the next frame, a picture or (H, W, 3) uint8 RGB.

        landmarks: source pixels;  scene: the frame's, which tells of haze, and of walls beside ears and neck.
        """
        picture = as_picture(frame)
        learned = self._model.learned
        raster = self._next_raster(landmarks, bald=learned is not None and learned.bald)
        small, visible = picture.cells(raster), raster.inside(picture.size)
        own = landmarks.in_cells(raster)
        if learned is None:
            mask = red_chroma_mask(small, face_area(raster.shape, own), visible)
            return Matte.over(raster.box, mask.astype(np.uint8) * np.uint8(255), mask)
        small = without_haze(small, learned.haze if scene is None else scene.haze)
        prior = spatial_prior(raster.shape, own, bald=learned.bald)
        self.light = face_color(small, prior.sample & visible)
        by_rules, occluder = _by_rules(learned, small, prior, own.stacked, visible)
        grey = np.asarray(cv2.cvtColor(small, cv2.COLOR_RGB2GRAY), np.uint8)
        before = None if self._before is None else self._carry(self._before, grey)
        lit = relit(small, gain_of(self.light))
        predicted = self._predicted(lit, prior, by_rules, before)
        self.network_output = NetworkOutput(raster, predicted)
        probability = _filtered(lit, network.fused(by_rules, predicted), prior)
        if scene is not None:
            probability = _of_people(probability, scene.people(raster), prior)
        probability = probability * (1 - collar(lit, probability, head_shape(own)))
        was = None if before is None else (before.skin, before.keep)
        certain = network.certain(prior, predicted, None if before is None else before.skin.mask)
        mask, skin = held(
            probability, was, lambda _, likely: face_component(likely, certain, prior), _TRACKING.edge_blur
        )
        self._before = _Left(grey, skin, predicted)
        # last, so that skin that comes back is still known
        mask, alpha = mask & (occluder < 0.5), skin.alpha * prior.fade * (1 - occluder)
        levels = in_levels(alpha)
        self.in_time = MatteInTime(raster, levels, mask, small, occluder, visible)
        return self.in_time.matte(levels, mask)

    def _next_raster(self, landmarks: Landmarks, *, bald: bool) -> Raster:
        """A raster of the first one's shape, over the face's box."""
        if self._raster is None:
            self._raster = first_raster(landmarks, bald=bald)
            return self._raster
        box = face_box(landmarks, bald=bald)
        h, w = self._raster.shape
        step = max(1.0, float(box[2] - box[0]) / w, float(box[3] - box[1]) / h)
        self._raster = Raster.centered(box, step, (h, w))
        return self._raster

    def _predicted(self, rgb: Bytes, prior: SpatialPrior, by_rules: Floats, before: _Carried | None) -> Floats:
        """The network's probability of skin (h, w): asked in every few frames, between them moved with the picture.

        Of cells that changed since it was asked it is not sure that they are none: what was before a face may leave.
        """
        self._age += 1
        if before is None or self._age >= _NETWORK.every or before.changed > _NETWORK.changed:
            self._age = 0
            return network.predict_skin(rgb, prior, by_rules)
        changed = before.keep < _NETWORK.unlike
        return np.where(changed, np.maximum(before.predicted, np.float32(_NETWORK.unsure)), before.predicted)

    def _carry(self, before: _Left, grey: Bytes) -> _Carried:
        """The frame before moved by optical flow onto this one, whose picture is `grey` (h, w)."""
        maps = places_before(self._flow.back(grey, before.grey))
        *skin, predicted = moved_layers([*before.skin.layers, before.predicted], maps)
        keep = weight_of_before(moved(before.grey.astype(np.float32), maps), grey.astype(np.float32))
        return _Carried(SkinInTime(*skin), predicted, keep)


def _by_rules(
    learned: LearnedSkin, rgb: Bytes, prior: SpatialPrior, points: Floats, visible: Bools
) -> tuple[Floats, Floats]:
    """The rules' probability of skin (h, w) by this frame alone: its colours, the prior and the key frame's shape.

    And the alpha (h, w) in [0, 1] of what lies in front of the face.
    """
    # a lamp or a cloud that changes the face changes what surrounds it alike: undo it before colours are looked up
    sample = prior.sample & visible
    even = without_tilt(rgb, tint_slopes(rgb, sample, prior.size) - learned.tint, prior.size)
    gain = gain_back(learned.light, face_color(even, sample))
    lit = relit(even, gain)
    lab = to_skin_lab(lit)
    knots = slice(None, None, SKIN_PRIOR.warp.knot_step)
    maps = rbf_warp(prior.face.shape, points[knots], learned.points[knots])
    distance = moved(learned.distance, maps)
    was_open = cv2.remap(learned.open, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
    if gain.min() < _TRACKING.brighter:
        # what the light has driven into clipping shows no hue, and where much of the face is, its gain is unknown
        clipped = rgb.max(axis=2) >= _TRACKING.clipped
        burnt = np.count_nonzero(clipped & sample) > _TRACKING.burnt * np.count_nonzero(sample)
        was_open = np.where(clipped | burnt, 0, was_open)
    occluder = occluder_alpha(lab, learned.colors.scale, np.asarray(was_open, np.float32), prior)
    hair = np.zeros(prior.face.shape, np.float32)
    if learned.hair is not None:
        hair = hair_cover(lit, distance > -_TRACKING.hair_margin, prior, learned.hair)
        if not learned.hair.fair:  # a bowed forehead is taller than the key frame's: what dark hair leaves bare is skin
            bare = (1 - hair) * prior.forehead * smoothstep(distance, *_HAIR.bare_within)
            distance = np.maximum(distance, distance * (1 - np.float32(_HAIR.bare_release) * bare))
            hair = hair - np.float32(_HAIR.bare_log_odds / _HAIR.log_odds) * bare
    # beyond the picture its edge is repeated, and so is the decision there: skin ends at the edge, it does not fade
    return _posterior(learned.colors, lab, prior, distance, hair), occluder


def _filtered(rgb: Bytes, probability: Floats, prior: SpatialPrior) -> Floats:
    """The probability (h, w) smoothed along the picture's edges."""
    radius = max(2, round(_TRACKING.filter_radius * prior.size))
    filtered = cv2.ximgproc.guidedFilter(rgb, probability, radius, _TRACKING.filter_epsilon)
    return np.asarray(np.clip(filtered, 0, 1), np.float32)


def _of_people(probability: Floats, people: Floats, prior: SpatialPrior) -> Floats:
    """The probability of skin (h, w), none outside of the face's contour where nobody is.

    A network that does not see the face itself is not asked what is beside it.
    """
    seen = people[prior.sample]
    if 2 * np.count_nonzero(seen < 1) >= len(seen):  # their median is less than 1, or there are none
        return probability
    return np.asarray(np.where(prior.face, probability, probability * people), np.float32)


_WEIGHTS = PosteriorWeights(
    prior=np.float32(_TRACKING.prior_weight),
    shape_slope=np.float32(_TRACKING.shape_slope),
    shape_most=np.float32(_TRACKING.shape_most),
    neck_release=np.float32(_TRACKING.neck_release),
    hair=np.float32(SKIN_PRIOR.hair.log_odds),
)


def _posterior(colors: SkinColors, lab: Floats, prior: SpatialPrior, distance: Floats, hair: Floats) -> Floats:
    """Probability of skin (h, w) by colours (h, w, 3), the prior, the carried shape and the hair's cover, (h, w) each.

    Its log-odds are the sum of these with the weights of `PosteriorWeights`; the shape counts less on the neck, which
    does not turn with the head.
    """
    out = np.empty(distance.shape, np.float32)
    odds = ColorOdds(colors.log_ratio, *colors.scale.binning())
    cells = CellEvidence(prior.log_odds, prior.neck, distance, hair)
    skin_probability(lab, odds, cells, _WEIGHTS, out)
    return out
