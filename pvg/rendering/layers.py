"""Pictures of what an asset holds in one frame: landmarks, mask, matte, curves, low and high frequencies."""

from __future__ import annotations

import itertools

import cv2
import numpy as np

from pvg._arrays import Bytes, Floats
from pvg.asset import VectorVideo
from pvg.errors import UncutError
from pvg.landmarks import draw_landmarks
from pvg.picture import slices_of
from pvg.raster import SUBPIXEL_BITS, fixed_point
from pvg.rendering.clip import placed_faces, source_frame
from pvg.rendering.edges import follow_edges, follows_edges
from pvg.rendering.placed_body import PlacedBody, place_body
from pvg.rendering.placed_face import PlacedFace, add_alpha, divide_overlaps
from pvg.video import Frame

LAYERS = ("image", "landmarks", "mask", "matte", "curves", "low", "high")
_MID_GREY = 128


def layer(video: VectorVideo, index: int, name: str, *, frame: Frame | None = None) -> Bytes:
    """Draw layer `name` of frame `index`: (H, W, 3) uint8 RGB.

    image: the source;  landmarks: the 106 points on it;  mask: the skin of faces in white, hard, as the paper's method
    has it;  matte: all that looks may change in white, soft, chest, arms and hands too;  curves: the diffusion curves
    in their boundary colours g over the dimmed source;  low: LF = H(g);  high: HF = I - H(g) around mid grey, both of
    faces.  frame: frame `index` of the source, where it was read before. Raises `ValueError` on an unknown layer or
    frame.
    """
    if name not in LAYERS:
        raise ValueError(f"no layer {name!r}; known are {', '.join(LAYERS)}")
    frame = source_frame(video, index) if frame is None else frame
    if name == "matte":
        faces = [placed for _, placed in placed_faces(video, index)]
        if follows_edges(video):
            faces = [follow_edges(placed, frame) for placed in faces]
        return _matte(frame, divide_overlaps(faces))
    image = frame.rgb()
    if name == "mask":
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


def _matte(frame: Frame, faces: list[PlacedFace]) -> Bytes:
    """The mattes of faces and of the other skin of their persons, which gives way to them."""
    total = np.zeros((frame.height, frame.width), np.float32)
    bodies: list[PlacedBody] = []
    for face in faces:
        bodies += place_body(frame, face.data.body, faces, bodies)
    every: list[PlacedFace | PlacedBody] = [*faces, *bodies]
    for placed in every:
        add_alpha(total, placed.x, placed.y, placed.alpha)
    white = np.rint(255 * np.minimum(total, 1)).astype(np.uint8)
    return np.repeat(white[..., None], 3, axis=-1)


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
    window = slices_of(placed.window, (0, 0))
    if name == "mask":
        out[window][placed.alpha >= 0.5] = 255
        return
    try:
        low = placed.membrane(_boundary_colors(video, face, index)).crop(placed.x, placed.y, *placed.alpha.shape[::-1])
    except UncutError:  # as when a look is drawn
        return
    field = low if name == "low" else image[window] - low + _MID_GREY
    alpha = placed.alpha[..., None]
    out[window] = np.clip(np.rint(alpha * field + (1 - alpha) * out[window]), 0, 255).astype(np.uint8)
