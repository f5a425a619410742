"""Pictures of what an asset holds in one frame: landmarks, mask, matte, curves, low and high frequencies."""

from __future__ import annotations

import itertools

import cv2
import numpy as np

from pvg._arrays import Bytes, Floats
from pvg.asset import VectorVideo
from pvg.errors import UncutError
from pvg.landmarks import draw_landmarks
from pvg.raster import SUBPIXEL_BITS, fixed_point
from pvg.rendering.clip import placed_faces, source_frame
from pvg.rendering.placed_face import PlacedFace
from pvg.video import Frame

LAYERS = ("image", "landmarks", "mask", "matte", "curves", "low", "high")
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
            _draw_curves(out, placed, _boundary_colors(video, face, index))
        elif name != "image":
            _draw_face(out, image, video, face, placed, index, name)
    return out


def _boundary_colors(video: VectorVideo, face: int, index: int) -> Floats:
    """(S, 3) float32 g in frame `index`, 0-255 RGB, on the table's labels."""
    record = video.records[face]
    return record.blended([key.colors for key in record.key_frames], index)


def _draw_curves(out: Bytes, placed: PlacedFace, colors: Floats) -> None:
    corners = fixed_point(placed.positions)
    for start, stop, closed in placed.labels.spans:
        ends = list(range(start, stop)) + ([start] if closed else [])
        for a, b in itertools.pairwise(ends):
            color = np.rint((colors[a] + colors[b]) / 2).clip(0, 255).tolist()
            cv2.line(out, corners[a], corners[b], color, 1, cv2.LINE_AA, SUBPIXEL_BITS)


def _draw_face(
    out: Bytes, image: Bytes, video: VectorVideo, face: int, placed: PlacedFace, index: int, name: str
) -> None:
    h, w = placed.alpha.shape
    window = (slice(placed.y, placed.y + h), slice(placed.x, placed.x + w))
    if name in ("mask", "matte"):
        shown = placed.alpha if name == "matte" else (placed.alpha >= 0.5).astype(np.float32)
        out[window] = np.maximum(out[window], np.rint(255 * shown)[..., None].astype(np.uint8))
        return
    try:
        low = placed.membrane(_boundary_colors(video, face, index)).crop(placed.x, placed.y, w, h)
    except UncutError:  # as when a look is drawn
        return
    field = low if name == "low" else image[window] - low + _MID_GREY
    alpha = placed.alpha[..., None]
    out[window] = np.clip(np.rint(alpha * field + (1 - alpha) * out[window]), 0, 255).astype(np.uint8)
