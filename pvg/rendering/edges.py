"""The matte's edge at picture resolution: a band around it follows the colours of the picture.

A matte is kept in cells of some pixels. Between those that are skin and those that are not lies a band whose pixels
the frame itself decides: nearby skin and nearby surroundings have a mean colour each, and a pixel's alpha is where it
lies on the line from one to the other. So strands of hair stay dark, and the edge lies where the picture has it. Chroma
is coded coarsely and spreads farther than luma: beside a wall the first part of that way is still wall, or a pale line
would be drawn along a jaw. Hair mixes with skin, and its roots take what they have of it. The line is linear in the
coded planes, its coefficients vary slowly and are computed on blocks of cells; where both colours are alike, or one is
not seen nearby, the cells' own alpha stays.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from pvg._arrays import Bytes, Floats
from pvg.asset import VectorVideo
from pvg.raster import Raster, square
from pvg.rendering import _edge_kernels as kernels
from pvg.rendering.placed_face import PlacedFace
from pvg.skin import Matte
from pvg.video import Frame, PixelFormat


@dataclass(frozen=True)
class EdgeNumbers:
    """The matte's edge at picture resolution: the line of colours between skin and its surroundings."""

    certain: tuple[float, float] = (0.1, 0.9)  # of a cell's alpha [measured: as rise]: between both the picture decides
    reach: int = 2  # blocks of 2×2 cells to either side [measured: as rise]: whose colours count
    noise: float = 1000.0  # squared levels [measured: less flickers more]: colours that differ by less tell nothing
    few: float = 6.0  # cells of either side [by eye]: fewer are trusted in proportion
    chroma: float = 2.0  # weight of chroma beside luma [by eye]
    # of the way to skin's colour, beside what is darker than the skin [by blind choice: narrower leaves a ring of the
    # old colour at hair, wider bleaches roots] and beside what is not [by blind choice: else a pale line at walls]
    rise: tuple[float, float] = (0.0, 0.9)
    rise_at_walls: tuple[float, float] = (0.15, 0.9)
    as_bright: tuple[float, float] = (0.6, 0.9)  # of the skin's luma [by eye]: from hair to walls


EDGES = EdgeNumbers()

_RULE = kernels.LineRule(
    reach=EDGES.reach,
    noise=EDGES.noise,
    few=EDGES.few,
    rise=np.array([EDGES.rise, EDGES.rise_at_walls], np.float32),
    as_bright=np.array(EDGES.as_bright, np.float32),
)
_CROSS = np.asarray(cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3)), np.uint8)
_NEIGHBOURS = np.ones((3, 3), np.uint8)
_SKIN, _AROUND = 1, 2  # kinds of cells, see `kernels.gather`


def follows_edges(video: VectorVideo) -> bool:
    """Whether the mattes of a clip's faces follow the picture's edges: the paper's rule knows no soft ones."""
    return bool(video.settings["mask"] == "landmarks")


def follow_edges(face: PlacedFace, frame: Frame) -> PlacedFace:
    """The face with a matte that follows the edges of the frame it is placed in."""
    alpha = face.alpha.copy()
    refine(alpha, (face.x, face.y), face.data.matte, frame)
    return replace(face, alpha=alpha)


def refine(alpha: Floats, window: tuple[int, int], matte: Matte, frame: Frame) -> None:
    """Let a matte as read at pixels, alpha (h, w) with its first pixel at `window` (x, y), follow a frame, in place."""
    full = int(matte.alpha.max())
    if full == 0:
        return
    kind = _kinds(matte.alpha, full)
    unknown = np.asarray(kind == 0, np.uint8)
    touched = np.asarray(cv2.dilate(unknown, _NEIGHBOURS), np.uint8)
    planes, (x, y) = _cut_out(frame, matte.raster, window, alpha.shape)
    weights = _weights(frame.format)
    near = _near(touched)
    wanted = np.asarray(cv2.dilate(near, square(EDGES.reach)), np.bool_)
    cells = kernels.Cells((matte.raster.origin - np.array([x, y])).astype(np.float32), float(matte.raster.step))
    sums = np.zeros((*near.shape, 2 * kernels.SUMS), np.float32)
    kernels.gather(planes, weights, cells, kind, wanted, sums)
    of_blocks = np.empty((*near.shape, kernels.LINE), np.float32)
    kernels.color_lines(sums, weights, near, _RULE, of_blocks)
    lines = np.empty((*kind.shape, kernels.LINE), np.float32)
    kernels.spread_to_cells(of_blocks, touched, lines)
    opacity = np.float32(full / 255.0)
    begin = window[0] - x, window[1] - y
    kernels.follow_lines(planes, begin, cells, unknown, lines, opacity, alpha)


def _cut_out(
    frame: Frame, raster: Raster, window: tuple[int, int], shape: tuple[int, ...]
) -> tuple[kernels.Planes, tuple[int, int]]:
    """What the planes show of a raster and of a window of (h, w) pixels, and x, y of its first pixel."""
    x0, y0, x1, y1 = raster.box
    log2x, log2y = frame.format.chroma_log2
    x, y = (
        max(0, int(min(low, at))) >> log2 << log2
        for low, at, log2 in zip((x0, y0), window, (log2x, log2y), strict=True)
    )
    right, bottom = max(int(x1) + 1, window[0] + shape[1]), max(int(y1) + 1, window[1] + shape[0])

    # copies are of one type whatever the planes are: compiled once
    first, second, third = (frame.over(p, (x, y, right, bottom)).copy() for p in range(3))
    return kernels.Planes(first, second, third, log2x, log2y), (x, y)


def _kinds(alpha: Bytes, full: int) -> Bytes:
    """(h, w) uint8: cells of skin, cells of its surroundings, and 0 for those between, on which the picture decides.

    alpha: (h, w) of a matte whose skin is `full`.
    """
    low, high = (np.uint8(round(share * full)) for share in EDGES.certain)
    around = cv2.erode((alpha <= low).view(np.uint8), _CROSS)
    return np.asarray((alpha > high) * np.uint8(_SKIN) + around * np.uint8(_AROUND), np.uint8)


def _near(touched: Bytes) -> Bytes:
    """The blocks of 2×2 cells that touched cells are read from, (rows, columns) uint8."""
    # block b is read by the cells from 2 b − 1 to 2 b + 2
    return np.ascontiguousarray(cv2.dilate(touched, square(2))[::2, ::2])


def _weights(pixel_format: PixelFormat) -> Floats:
    """(3,) what a code of each plane counts, in SDR levels."""
    levels = 2.0 ** (8 - pixel_format.depth) / pixel_format.levels_a_grey
    if pixel_format.is_rgb:
        return np.full(3, levels / np.sqrt(3.0), np.float32)  # as long as luma for greys
    return np.array([levels, levels * EDGES.chroma, levels * EDGES.chroma], np.float32)
