"""Find faces in one picture: BlazeFace (back camera, 256 px), its anchors and a weighted suppression."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np

from pvg import models
from pvg._arrays import Bytes, Floats
from pvg.picture import Picture, as_picture
from pvg.raster import centers_in_unit, from_edge

INPUT_PX = 256
MIN_SCORE = 0.5
MERGE_IOU = 0.3
MIN_TILED_PX = 512
"""A frame whose longer side is below this gains nothing from tiles: its faces are seen at over half size."""
SURE_SCORE = 0.75
"""Below this the best detection of the whole frame may be nothing, so that tiles are worth their runs."""
TILE_PX, MAX_TILES = 1280, 4
TILE_OVERLAP = 1.2


@dataclass(frozen=True)
class Detection:
    """One face seen by the detector, in source pixels.

    box: (4,) float32 x0, y0, x1, y1, brow to chin; key_points: (6, 2) float32 eyes (image left first), nose tip,
    mouth, ear fronts (image left first); score in [0, 1].
    """

    box: Floats
    key_points: Floats
    score: float


@cache
def _anchors() -> Floats:
    """Anchor centres (896, 2) in [0, 1]: 2 per cell of the 16×16 grid, then 6 per cell of the 8×8 grid."""
    grids = []
    for cells, per_cell in ((16, 2), (8, 6)):
        centres = centers_in_unit(cells)
        x, y = np.meshgrid(centres, centres)
        grids.append(np.repeat(np.stack([x, y], axis=-1).reshape(-1, 2), per_cell, axis=0))
    return np.concatenate(grids)


def detect_faces(picture: Picture | Bytes, *, tiles: bool = True) -> tuple[Detection, ...]:
    """Return the faces of one picture, best score first.

    picture: a picture or (H, W, 3) uint8 RGB. The whole is looked at letterboxed; when that shows nothing sure, a
    large one is looked at again in 2×2 overlapping tiles (3×3 or 4×4 from 2.5 thousand pixels on), which finds faces
    down to some 1/30 of its side; tiles=False saves those runs. Raises ModelError when the weights are not installed.
    """
    picture = as_picture(picture)
    height, width = picture.size
    found = _detect_in(picture)
    longer = max(height, width)
    if tiles and longer >= MIN_TILED_PX and all(detection.score < SURE_SCORE for detection in found):
        count = int(np.clip(-(-longer // TILE_PX), 2, MAX_TILES))
        tile_w, tile_h = (round(size * TILE_OVERLAP / count) for size in (width, height))
        for y in np.linspace(0, height - tile_h, count).astype(int):
            for x in np.linspace(0, width - tile_w, count).astype(int):
                tile = picture.part((int(x), int(y), int(x) + tile_w, int(y) + tile_h))
                found += _detect_in(tile)
    return tuple(_merge(found))


@dataclass(frozen=True, eq=False)
class _Letterbox:
    """What a picture holds, whole in the middle of the network's square.

    square: (1, INPUT_PX, INPUT_PX, 3) float32 in [-1, 1];  pad: (2,) x and y of the picture's first pixel in it;
    scale: (2,) source pixels a pixel of it;  origin: (2,) where the picture's edges meet, source pixels.
    """

    square: Floats
    pad: Floats
    scale: Floats
    origin: Floats

    @classmethod
    def of(cls, picture: Picture) -> _Letterbox:
        """That of a picture, averaged down where it is larger."""
        left, top, right, bottom = picture.box
        smaller, factor = picture.reduced(max(right - left, bottom - top) / INPUT_PX)
        rgb = smaller.rgb()
        height, width = rgb.shape[:2]
        ratio = INPUT_PX / max(height, width)
        w, h = max(1, round(width * ratio)), max(1, round(height * ratio))
        small = cv2.resize(rgb, (w, h), interpolation=cv2.INTER_AREA if ratio < 1 else cv2.INTER_LINEAR)
        x, y = (INPUT_PX - w) // 2, (INPUT_PX - h) // 2
        square = np.zeros((1, INPUT_PX, INPUT_PX, 3), np.float32)
        square[0, y : y + h, x : x + w] = small
        square *= 2 / 255
        square -= 1
        scale = np.array([width / w, height / h], np.float32) * factor
        return cls(square, np.array([x, y], np.float32), scale, from_edge(np.array([left, top], np.float32)))

    def to_source(self, points: Floats) -> Floats:
        """Points (…, 2) of the square, from its edge, in source pixels."""
        return np.asarray((points - self.pad) * self.scale + self.origin)


def _detect_in(picture: Picture) -> list[Detection]:
    """Raw detections in what a picture holds."""
    box = _Letterbox.of(picture)
    session = models.load("face_detection_back")
    regressors, logits = session.run(["regressors", "classificators"], {session.get_inputs()[0].name: box.square})
    scores = 1 / (1 + np.exp(-np.clip(logits[0, :, 0], -80, 80)))
    kept = np.flatnonzero(scores >= MIN_SCORE)
    # centre, size, then the key points; all but the size are relative to the anchor
    raw = regressors[0, kept].reshape(-1, 8, 2)
    points = raw + _anchors()[kept, None] * INPUT_PX
    centres, key_points = box.to_source(points[:, 0]), box.to_source(points[:, 2:])
    halves = raw[:, 1] * box.scale / 2
    boxes = np.concatenate([centres - halves, centres + halves], axis=1)
    return [
        Detection(boxes[i].astype(np.float32), key_points[i].astype(np.float32), float(scores[kept[i]]))
        for i in range(len(kept))
    ]


def box_iou(box: Floats, others: Floats) -> Floats:
    """Intersection over union of one box (4,) with others (n, 4), as (n,) float32; boxes are x0, y0, x1, y1."""
    low = np.maximum(box[:2], others[:, :2])
    high = np.minimum(box[2:], others[:, 2:])
    common = np.prod(np.clip(high - low, 0, None), axis=1)
    areas = np.prod(others[:, 2:] - others[:, :2], axis=1)
    union = np.prod(box[2:] - box[:2]) + areas - common
    return np.asarray(common / np.maximum(union, 1e-6), np.float32)


def _merge(found: list[Detection]) -> list[Detection]:
    """Weighted suppression: overlapping detections become their score-weighted mean under the best score."""
    left = sorted(found, key=lambda detection: -detection.score)
    merged = []
    while left:
        boxes = np.stack([detection.box for detection in left])
        overlaps = box_iou(boxes[0], boxes) > MERGE_IOU
        overlaps[0] = True
        group = [detection for detection, overlap in zip(left, overlaps, strict=True) if overlap]
        left = [detection for detection, overlap in zip(left, overlaps, strict=True) if not overlap]
        weights = np.array([detection.score for detection in group], np.float32)
        weights /= weights.sum()
        box = np.einsum("n,nk->k", weights, np.stack([detection.box for detection in group]))
        key_points = np.einsum("n,nkc->kc", weights, np.stack([detection.key_points for detection in group]))
        merged.append(Detection(box, key_points, group[0].score))
    return merged
