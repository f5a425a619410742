"""A scene as one of its faces is looked at in it: what all rules for skin off the face go by."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from pvg._arrays import Bytes, Floats
from pvg.skin.cleanup import occupied
from pvg.skin.matte import Matte
from pvg.skin.parameters import SKIN_PRIOR
from pvg.skin.prior import HeadShape
from pvg.skin.scene import Scene

_BODY = SKIN_PRIOR.body


@dataclass(frozen=True, eq=False)
class FaceInScene:
    """A face over the cells (h, w) of a scene.

    rgb: (h, w, 3) uint8, the scene;  person: (h, w) uint8, 255 on people, see `own_people`;
    face_mask: (h, w) float32 in [0, 1], the face's own mask;  head: in the scene's cells.
    """

    rgb: Bytes
    person: Bytes
    face_mask: Floats
    head: HeadShape

    @classmethod
    def of(cls, scene: Scene, face: Matte, head: HeadShape) -> FaceInScene:
        """The face with this matte in a scene."""
        xs, ys = (np.asarray(v, np.float32) for v in scene.raster.centers())
        face_mask = face.raster.read(face.mask.astype(np.float32), xs, ys)
        return cls(scene.rgb, own_people(scene.person, face_mask, head.size), face_mask, head)


def own_people(person: Bytes, face_mask: Floats, size: float) -> Bytes:
    """The person mask (h, w) without small parts that have nothing of the face's own mask (h, w): pots and chairs.

    size: a face size in cells.
    """
    people, face, least = (person > 255 * _BODY.no_person).view(np.uint8), face_mask > 0.5, _BODY.least_person * size**2
    large = people.size - int(np.count_nonzero(people)) > least  # what is nobody's, which is a part as well
    box = occupied(people) if large else (slice(None), slice(None))
    if not people[box].size:
        return person
    count, labels, stats, _ = cv2.connectedComponentsWithStats(people[box])
    kept = stats[:, cv2.CC_STAT_AREA] > least
    kept[0] |= large
    kept |= np.bincount(labels[face[box]], minlength=count) > 0
    if kept.all():
        return person
    out = person.copy()
    out[box] *= kept[labels]
    return out
