"""Connected parts of a person's skin off the face: which are kept, filled, joined to the face or left out as hair."""

from __future__ import annotations

import cv2
import numpy as np

from pvg._arrays import Bools, Floats, ramp
from pvg.raster import Raster, block, square
from pvg.skin.cleanup import goes_over, occupied
from pvg.skin.color_model import ColorScale
from pvg.skin.face_in_scene import FaceInScene
from pvg.skin.light import lab_in_light
from pvg.skin.matte import Matte
from pvg.skin.parameters import SKIN_PRIOR

_BODY = SKIN_PRIOR.body
_TOUCHING = 2  # cells around the face's mask that a part touches it by


def beyond_box(face: Matte, raster: Raster, face_mask: Floats, by_rules: Floats, hair: Floats) -> Floats:
    """The face's mask (h, w) in [0, 1] with what is skin by the rules and goes on where the face's box cuts it.

    The end of a box is no skin's end, and a network that is shown one draws it there.
    face: its own matte;  raster: of the cells;  face_mask, by_rules: (h, w) in [0, 1];  hair: (h, w) nats.
    """
    x0, y0, x1, y1 = face.raster.box
    xs, ys = raster.centers()
    inside = ((ys > y0) & (ys < y1))[:, None] & (xs > x0) & (xs < x1)
    on = ((by_rules > _BODY.beyond) & (hair < _BODY.gap_hair) & ~inside).view(np.uint8)
    beside = cv2.dilate(((face_mask > 0.5) & inside).view(np.uint8), square(_TOUCHING)) > 0
    count, labels = cv2.connectedComponents(on, connectivity=4)
    cut = np.bincount(labels[beside], minlength=count) > 0
    cut[0] = False
    return np.maximum(face_mask, cut[labels].astype(np.float32))


def fill_gaps(
    probability: Floats, face: Floats, predicted: Floats, hair: Floats, seen: FaceInScene, gain: Floats
) -> None:
    """Raise the probability (h, w), in place, where a hand on the face is cut by the end of the face's matte.

    Around the face nothing counts as the body's, and the face's matte ends with its box: what lies between both, is no
    hair and skin to the network is their hand's or neck's. It goes over into them, where a collar begins at an edge.
    All (h, w);  face: its matte in [0, 1];  predicted: by the network;  hair: log-odds of hair, nats;
    seen, gain: see `hair_odds`.
    """
    likely, of_face = (where.astype(np.uint8) for where in (probability > 0.5, face > _BODY.gap_face))
    either = likely | of_face
    closed = cv2.morphologyEx(either, cv2.MORPH_CLOSE, square(_BODY.gap * seen.head.size))
    gap = (closed > either) & (predicted > _BODY.gap_predicted) & (hair < _BODY.gap_hair)
    if not gap.any():
        return
    count, labels, stats, _ = cv2.connectedComponentsWithStats(gap.astype(np.uint8), connectivity=8)
    beside = [cv2.dilate(one, square(1)) > 0 for one in (likely, of_face)]
    between = np.all([np.bincount(labels[one], minlength=count) > 0 for one in beside], axis=0)
    for part in np.flatnonzero(between[1:]) + 1:
        x, y, w, h = (int(v) for v in stats[part, :4])
        box = slice(max(0, y - 1), y + h + 1), slice(max(0, x - 1), x + w + 1)
        inside = labels[box] == part
        skin = either[box].view(np.bool_)
        share = ramp(goes_over(lab_in_light(seen.rgb[box], gain), inside, skin), *_BODY.gap_over)
        raised = probability[box] + share * np.maximum(predicted[box] - probability[box], 0)
        np.copyto(probability[box], raised.astype(np.float32), where=inside)


def fill_small_holes(probability: Floats, face: Floats, size: float) -> None:
    """Raise the probability (h, w), in place, in small holes of the person's skin: the inside of an ear is blood-red.

    face: (h, w) the face's matte in [0, 1];  size: a face size in cells.
    """
    skin = ((probability > 0.5) | (face > 0.5)).view(np.uint8)
    box = occupied(skin, 1)  # what reaches its edge reaches the picture's
    within = skin[box]
    if not within.size:
        return
    _, labels, stats, _ = cv2.connectedComponentsWithStats(1 - within, connectivity=4)
    x, y, w, h, area = stats.T
    rows, columns = within.shape
    holes = (area <= _BODY.hole * size**2) & (x > 0) & (y > 0) & (x + w < columns) & (y + h < rows)
    holes[0] = False
    if holes.any():
        part = probability[box]
        np.copyto(part, np.maximum(part, np.float32(_BODY.hole_probability)), where=holes[labels])


def leave_out_hair(probability: Floats, seen: FaceInScene, hair: Floats, scale: ColorScale, gain: Floats) -> None:
    """Set the probability (h, w) to 0, in place, in parts beside the face that are cut out of hair of one colour.

    The place of an ear makes up for a colour that is not quite the skin's. An ear ends where its colour does; a
    part whose surroundings have its own colour ends where that place does. What is far redder than the skin is an ear
    full of blood, whatever is behind it: hair is yellower. What is far lighter than what is around it is no strand of
    that hair.

    seen, scale, gain: see `hair_odds`;  hair: (h, w) nats, its result.
    """
    head = seen.head
    y, x = (along.astype(np.float32) for along in np.ogrid[: probability.shape[0], : probability.shape[1]])
    down = head.axes.down
    above = (x - head.chin[0]) * down[0] + (y - head.chin[1]) * down[1] < -_BODY.hair_above * head.size
    likely, off_face = probability > 0.5, seen.face_mask < 0.5
    parts = (likely & off_face & above).view(np.uint8)
    rows, columns = occupied(parts)
    if not parts[rows, columns].size:
        return
    labels = np.zeros(parts.shape, np.int32)
    count, labels[rows, columns], stats, _ = cv2.connectedComponentsWithStats(parts[rows, columns], connectivity=8)
    stats[:, :2] += columns.start, rows.start
    around = off_face & ~likely & (seen.person > 255 * _BODY.no_person)
    least, most = _BODY.hair_cells, _BODY.hair_most * head.size**2
    for part in range(1, count):
        x0, y0, w, h, area = (int(v) for v in stats[part])
        if not least <= area <= most:
            continue
        reach = _BODY.hair_reach
        box = slice(max(0, y0 - reach), y0 + h + reach), slice(max(0, x0 - reach), x0 + w + reach)
        inside = labels[box] == part
        mean_hair = float(hair[box][inside].mean())
        if mean_hair < _BODY.hair_least:
            continue
        near, far = (cv2.dilate(inside.astype(np.uint8), square(r)) > 0 for r in (1, reach))
        ring = far & ~near & around[box]
        if int(ring.sum()) < least:
            continue
        if _is_of_hair(lab_in_light(seen.rgb[box], gain), inside, ring, mean_hair, scale):
            probability[box][inside] = 0.0


def _is_of_hair(lab: Floats, part: Bools, ring: Bools, hair: float, scale: ColorScale) -> bool:
    """Whether a part (h, w) of colours (h, w, 3) has those of the ring (h, w) around it, and is no ear.

    hair: nats that speak for it in the mean: the more, the less alike both need be.
    """
    own, beside = np.median(lab[part], axis=0), np.median(lab[ring], axis=0)
    along, across = scale.of_hue(own)
    blood = along > 0 and across < -_BODY.hair_redder
    if blood or float(own[0] - beside[0]) > _BODY.hair_lighter:
        return False
    return float(np.linalg.norm((own - beside) / scale.spread)) < _BODY.hair_alike + hair


def body_parts(probability: Floats, likely: Bools, seen: FaceInScene, before: Floats | None = None) -> Bools:
    """The parts of `likely` (h, w) that are a body's: what touches the face, and what is large and likely enough.

    What touches nothing must be likelier where the person mask is not sure, as on a wall or floor of the skin's colour.
    A part is kept or left as a whole, so that one near a bound would come and go: what was kept may be less likely.

    before: (h, w) in [0, 1], how far each cell was kept in the scene before and shows the same now; None without one.
    """
    face = (seen.face_mask > 0.5).astype(np.uint8)
    joined = cv2.morphologyEx(likely.astype(np.uint8) | face, cv2.MORPH_CLOSE, block(_BODY.join))
    whole: Bools = np.zeros(likely.shape, np.bool_)
    held = occupied(np.asarray(joined, np.uint8))
    if not joined[held].size:
        return whole
    count, labels, stats, _ = cv2.connectedComponentsWithStats(joined[held], connectivity=8)
    touching = cv2.dilate(face, square(_TOUCHING))[held] > 0
    likely, probability, person = likely[held], probability[held], seen.person[held]
    was = None if before is None else before[held]
    kept = np.bincount(labels[touching], minlength=count) > 0
    kept[0] = False
    least = _BODY.least_part * seen.head.size**2
    for part in np.flatnonzero(~kept & (stats[:, cv2.CC_STAT_AREA] > least)):
        if part == 0:
            continue
        x, y, w, h = (int(v) for v in stats[part, :4])
        box = slice(y, y + h), slice(x, x + w)
        cells = likely[box] & (labels[box] == part)
        if int(cells.sum()) <= least:
            continue
        persons = float(person[box][cells].mean()) > 255 * _BODY.part_person
        least_sure = _BODY.sure if persons else _BODY.sure_alone
        stays = 0.0 if was is None else _BODY.stays * float(was[box][cells].mean())
        kept[part] = float(probability[box][cells].mean()) > least_sure - stays
    whole[held] = likely & kept[labels]
    return whole
