"""Pictures of what an asset holds in one frame: landmarks, mask, matte, curves, low and high frequencies."""

from __future__ import annotations

import cv2
import numpy as np

from pvg._arrays import Bytes
from pvg.asset import VectorVideo
from pvg.curves import table_labels
from pvg.errors import UncutError
from pvg.landmarks import draw_landmarks
from pvg.raster import SUBPIXEL_BITS, fixed_point
from pvg.rendering.clip import placed_faces, source_frame
from pvg.rendering.placed_face import PlacedFace
from pvg.video import Frame

LAYERS = ("image", "landmarks", "mask", "matte", "curves", "low", "high")
_GROUP_COLORS = ((255, 200, 0), (0, 220, 255), (80, 255, 80), (255, 60, 120))  # skin, brows, eyes, lips
_MID_GREY = 128


def layer(video: VectorVideo, index: int, name: str, *, frame: Frame | None = None) -> Bytes:
    """Draw layer `name` of frame `index`: (H, W, 3) uint8 RGB.

    image: the source;  landmarks: the 106 points on it;  mask, matte: skin in white;  curves: the diffusion curves in
    their boundary colours g over the dimmed source;  low: LF = H(g);  high: HF = I - H(g) around mid grey.
    frame: frame `index` of the source, where it was read before. Raises `ValueError` on an unknown layer or frame.
    """
    if name not in LAYERS:
        raise ValueError(f"no layer {name!r}; known are {', '.join(LAYERS)}")
    image = (source_frame(video, index) if frame is None else frame).rgb()
    if name in ("mask", "matte"):
        out: Bytes = np.zeros_like(image)
    elif name == "high":
        out = np.full_like(image, _MID_GREY)
    else:
        out = image // 3 if name in ("curves", "low") else image.copy()
    for face, placed in placed_faces(video, index):
        if name == "landmarks":
            out = draw_landmarks(out, placed.data.landmarks.points)
        elif name == "curves":
            _draw_curves(out, placed)
        elif name != "image":
            _draw_face(out, image, video, face, placed, index, name)
    return out


def _draw_curves(out: Bytes, placed: PlacedFace) -> None:
    labels = table_labels()
    for start, stop, closed in labels.spans:
        color = _GROUP_COLORS[int(labels.group[start])]
        corners = fixed_point(placed.positions[start:stop])
        cv2.polylines(out, [corners], closed, color, 1, cv2.LINE_AA, SUBPIXEL_BITS)


def _draw_face(
    out: Bytes, image: Bytes, video: VectorVideo, face: int, placed: PlacedFace, index: int, name: str
) -> None:
    h, w = placed.alpha.shape
    window = (slice(placed.y, placed.y + h), slice(placed.x, placed.x + w))
    if name in ("mask", "matte"):
        shown = placed.alpha if name == "matte" else (placed.alpha >= 0.5).astype(np.float32)
        out[window] = np.maximum(out[window], np.rint(255 * shown)[..., None].astype(np.uint8))
        return
    record = video.records[face]
    colors = record.blended([key.colors for key in record.key_frames], index)
    try:
        low = placed.membrane(colors).crop(placed.x, placed.y, w, h)
    except UncutError:  # as when a look is drawn
        return
    field = low if name == "low" else image[window] - low + _MID_GREY
    alpha = placed.alpha[..., None]
    out[window] = np.clip(np.rint(alpha * field + (1 - alpha) * out[window]), 0, 255).astype(np.uint8)
