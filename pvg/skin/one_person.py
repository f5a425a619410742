"""Which skin is this person's: a network that outlines one person among others.

MediaPipe's pose landmarker ("BlazePose", Bazarevsky et al. 2020) is shown a square around one person and, beside the
body's landmarks, tells which pixels are of that person. Of other people's arms before or behind the person it leaves
out more than colour, place or a mask of all people can. The outline alone is wanted (`pvg.models.networks`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from pvg import models
from pvg._arrays import Bools, Bytes, Doubles, Floats
from pvg.picture import RgbPicture
from pvg.raster import square
from pvg.region import Region
from pvg.skin.in_time import moved_layers
from pvg.skin.parameters import SKIN_PRIOR
from pvg.skin.prior import HeadShape, logistic
from pvg.skin.scene import Scene

_OUTLINE, _BODY, _NETWORK = SKIN_PRIOR.outline, SKIN_PRIOR.body, "pose_landmarks_detector"
_SIDE = 256  # pixels a side of what the network sees
UNSEEN = -1.0
"""What is said of cells beyond the network's square."""
_SURE = 20.0  # nats: its log-odds reach a thousand
_RIM = 2  # cells around another's skin, less likely than that, which go with it


def may_be_others(likely: Bools, oval: Floats, size: float) -> bool:
    """Whether so much of what is likely skin (h, w) lies away from the head that the network is worth its time.

    oval: (h, w), see `HeadShape.of_oval`;  size: a face size in cells.
    """
    return bool(np.count_nonzero(likely & (oval > _OUTLINE.away)) >= _OUTLINE.least * size**2)


def outline_of(rgb: Bytes, head: HeadShape) -> Floats | None:
    """How far each cell (h, w) of a scene (h, w, 3) uint8 RGB is of the person with this head: float32 in [0, 1].

    UNSEEN beyond what the network sees; None when it does not see this face, for then it tells nothing of it.
    Raises ModelError when the weights are not installed.
    """
    x, y = head.middle + _OUTLINE.below * head.size * head.neck
    across, down = (float(v) for v in head.neck)
    region = Region(float(x), float(y), _OUTLINE.sizes * head.size, float(np.arctan2(-across, down)))
    seen = region.read(RgbPicture(rgb), _SIDE)
    session = models.load(_NETWORK)
    (found,) = session.run(None, {session.get_inputs()[0].name: seen[None] * np.float32(1 / 255)})
    own = logistic(np.clip(found[0, ..., 0], -_SURE, _SURE))
    h, w = rgb.shape[:2]
    border = cv2.BORDER_CONSTANT
    out = cv2.warpAffine(own, region.to_source(_SIDE), (w, h), borderMode=border, borderValue=(UNSEEN,))
    face = head.of_oval((h, w)) < _OUTLINE.face
    if not face.any() or float(out[face].mean()) < _OUTLINE.sees:
        return None
    return np.asarray(np.where(out < 0, np.float32(UNSEEN), out), np.float32)


@dataclass(frozen=True, eq=False)
class Known:
    """What one scene leaves to the next, (h, w) float32.

    outline: in [0, 1], see `outline_of`, the mean of some answers, 1 without one;  answers: how many, 0 where nothing
    is known;  others: 0 or 1, what was skin of somebody else.
    """

    outline: Floats
    answers: Floats
    others: Floats


class OthersTracker:
    """Tells what of the likely skin is of other people, in each scene of a track, in order."""

    def __init__(self) -> None:
        self._known: Known | None = None
        self._age = 0  # scenes since the network was asked

    def step(self, scene: Scene, likely: Bools, head: HeadShape, oval: Floats, keep: Floats | None) -> Bools:
        """(h, w) bool, the cells of other people's skin; none where the network was not worth asking.

        likely: (h, w) bool, skin of anybody;  head, oval: see `HeadShape.of_oval`;
        keep: (h, w), see `weight_of_before`, None without a scene before.
        """
        known = self._moved(scene, keep)
        self._age += 1
        if may_be_others(self._asked_for(known, likely), oval, head.size):
            self._age = 0
            known = _with(known, outline_of(scene.rgb, head), likely.shape)
        if known is None or not (likely & (oval > _OUTLINE.away)).any():
            self._known = None
            return np.zeros(likely.shape, np.bool_)
        others = others_skin(likely, known, oval, head.size)
        self._known = replace(known, others=others.astype(np.float32))
        if not others.any():
            return others
        around = cv2.dilate(others.view(np.uint8), square(_RIM)) > 0
        return others | around & ~likely

    def _asked_for(self, known: Known | None, likely: Bools) -> Bools:
        """(h, w) bool, the likely skin of which it is asked now whose it is.

        All of it when it is time, and a little sooner, where others are about, what is new or was asked of once only.
        """
        if known is None or self._age >= _OUTLINE.every:
            return likely
        if self._age < _BODY.person_every or not known.others.any():
            return np.zeros(likely.shape, np.bool_)
        return likely & (known.answers <= 1)

    def _moved(self, scene: Scene, keep: Floats | None) -> Known | None:
        """What is known where its cells are now: nothing of what is new there, and little of it in another's limb."""
        if self._known is None or keep is None or scene.before is None or scene.changed:
            return None
        known = self._known
        outline, answers, others = moved_layers([known.outline, known.answers, known.others], scene.before)
        answers = np.where(keep < _OUTLINE.unlike, np.minimum(answers, np.rint(others)), answers)
        return Known(outline, answers, others)


def _with(known: Known | None, said: Floats | None, shape: tuple[int, ...]) -> Known:
    """What is known (h, w in shape) with one more answer, each of the first as much as any other."""
    if known is None:
        known = Known(np.ones(shape, np.float32), *np.zeros((2, *shape), np.float32))
    if said is None:
        return known
    answers = np.where(said < 0, known.answers, np.minimum(known.answers + 1, np.float32(_OUTLINE.answers)))
    step = np.where(said < 0, 0, (said - known.outline) / np.maximum(answers, 1))
    return Known(np.asarray(known.outline + step, np.float32), np.asarray(answers, np.float32), known.others)


def others_skin(likely: Bools, known: Known, oval: Floats, size: float) -> Bools:
    """(h, w) bool, what is likely skin (h, w), off the face, and of somebody else: whole parts of it, or none.

    The outline ends some cells from where a limb does and is unsure here and there; a limb of two colours is worse than
    one of the wrong colour. So a connected part counts as another's, or not, by its mean; what goes on beside the face
    is this person's. So is what is new and was no other's, until it is asked for.
    oval, size: see `may_be_others`.
    """
    off = likely & (oval > _OUTLINE.off)
    beside = cv2.dilate((likely & ~off).view(np.uint8), square(1)) > 0
    count, labels, stats, _ = cv2.connectedComponentsWithStats(off.view(np.uint8), connectivity=4)
    areas = stats[:, cv2.CC_STAT_AREA]

    def mean_of(values: Floats) -> Doubles:
        return np.asarray(np.bincount(labels.ravel(), weights=values.ravel(), minlength=count) / np.maximum(areas, 1))

    before, asked = mean_of(known.others), mean_of(np.minimum(known.answers, 1))
    others = mean_of(known.outline) < _OUTLINE.others + _OUTLINE.stays * before
    others &= (areas >= _OUTLINE.least * size**2) & (np.maximum(before, asked) > 0.5)
    others[0] = False
    others[labels[beside & off]] = False
    return np.asarray(others[labels], np.bool_)
