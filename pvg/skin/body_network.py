"""Two networks' opinion of a person's skin off the face: what colour and place do not tell of a whole picture.

Long fair hair on shoulders, cloth and walls of the skin's colour. The first is made as the one of the face's box is
(`pvg.skin.network`), and asked of the whole scene at 24 cells a face size, or the scene's own if those are larger: the
colours, plain and beside the face's own, the person mask, the face's mask, where the head is, how uneven the scene is
there, and what the rules think.
"""

from __future__ import annotations

import cv2
import numpy as np

from pvg._arrays import Floats, smoothstep
from pvg.skin.face_in_scene import FaceInScene
from pvg.skin.features import Features, features_around
from pvg.skin.network import fused, run_network
from pvg.skin.parameters import SKIN_PRIOR

_BODY, _NETWORK = SKIN_PRIOR.body_network, SKIN_PRIOR.network
_BY_SHAPES, _BY_THINGS = "body_skin", "body_things"
_NEAR = 3  # cells a side over which unevenness is measured


def body_fields(seen: FaceInScene, light: Floats, probability: Floats) -> Floats:
    """What both networks are shown: (FIELDS, h', w') float32.

    seen: in usual light;  light: (3,) RGB, the face's colour there;  probability: (h, w), of skin so far.
    """
    rgb, face_mask = seen.rgb, seen.face_mask
    h, w = face_mask.shape
    ratio = min(1.0, _BODY.face_cells / seen.head.size)
    size = (max(1, round(w * ratio)), max(1, round(h * ratio)))

    def small(values: Floats) -> Floats:
        return np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_AREA), np.float32)

    color = small(rgb.astype(np.float32))
    beside = np.log(color + _NETWORK.dark) - np.log(light.astype(np.float32) + _NETWORK.dark)
    green = rgb[..., 1].astype(np.float32)
    mean = cv2.blur(green, (_NEAR, _NEAR))
    spread = np.sqrt(np.maximum(cv2.blur(green * green, (_NEAR, _NEAR)) - mean * mean, 0))
    side, depth = seen.head.places(face_mask.shape)
    fields = [*np.moveaxis(color / 255 - 0.5, 2, 0), *np.moveaxis(beside, 2, 0)]
    fields += [
        small(seen.person.astype(np.float32)) / 255 - 0.5,
        small(face_mask),
        small(np.tanh(np.abs(side) / _BODY.far)),
        small(np.tanh(depth / _BODY.far)),
        small(spread / (mean + _NETWORK.dark)),
        small(probability) - 0.5,
    ]
    return np.stack(fields).astype(np.float32)


def over_fields(features: Features, shape: tuple[int, ...], fields: Floats) -> Floats:
    """All maps over the cells of fields (FIELDS, h', w') of a scene (h, w) in shape: (c, h', w') float32."""
    rows, columns = ((np.arange(n) + 0.5) * length / n for n, length in zip(fields.shape[1:], shape, strict=True))
    return features.over(columns, rows)


def predict_body_skin(seen: FaceInScene, light: Floats, probability: Floats) -> Floats:
    """The networks' probability of anybody's skin (h, w) float32; see `body_fields`."""
    shape = probability.shape
    fields, features = body_fields(seen, light, probability), features_around(seen.rgb, seen.head)
    by_shapes = run_network(_BY_SHAPES, fields, shape, _BODY.margin)
    things = np.concatenate([fields, over_fields(features.components(), shape, fields)])
    by_things = run_network(_BY_THINGS, things, shape, multiple=1)
    counts = features.inside((shape[0], shape[1]), _BODY.seen_edge * seen.head.size)
    off_face = smoothstep(seen.head.of_oval(shape), 1.0, _BODY.rise[0])  # it was fitted to nothing of a face
    return fused(by_shapes, by_things, _BODY.by_things * counts * off_face)
