"""The whole picture at a small size: what all skin of a person is found in, once a frame for all faces.

A scene has the picture over square cells, the person mask of a network, how the cells moved since the scene before, and
the faces. The network is asked in every fourth frame only, and at once where the flow does not explain the picture, as
of fast hands; between, its mask moves with the picture.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from pvg import models
from pvg._arrays import Bytes, Floats, ramp
from pvg.face import Landmarks
from pvg.haze import haze_of, without_haze
from pvg.picture import Picture, as_picture, rms_contrast
from pvg.raster import Raster, first_reading
from pvg.skin.flow import FlowFinder
from pvg.skin.in_time import Maps, moved, places_before
from pvg.skin.parameters import SKIN_PRIOR

_BODY = SKIN_PRIOR.body
_STEADY = 6  # levels: less more or less haze than in the frame before is none [by eye]
_NETWORK = "selfie_segmenter"
_NETWORK_PX = 256
_WALL_PX = 63  # of the network's square: the picture's first row, smoothed over so many, stands for what is above it
_FLOW_CELLS = 2  # cells a side of one vector of the flow


def person_mask(rgb: Bytes) -> Floats:
    """Where people are: (h, w) float32 in [0, 1] of a picture (h, w, 3) uint8 RGB.

    The network takes squares; a picture that is squeezed into one makes it see people in tables and plants, so that it
    stays in the middle and its last row is repeated: people go on below a picture. Above it they do not, and its first
    row, repeated, would draw what is behind a head out into a tall hat: there it is smoothed to a wall. Beside it is
    the middle colour of its first and last column: an arm that is cut there would become a bar, which is no person.
    Raises ModelError when the weights are not installed.
    """
    height, width = rgb.shape[:2]
    scale = _NETWORK_PX / max(height, width)
    h, w = max(1, round(height * scale)), max(1, round(width * scale))
    small = cv2.resize(rgb, (w, h), interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR)
    top, left = (_NETWORK_PX - h) // 2, (_NETWORK_PX - w) // 2
    edges = top, _NETWORK_PX - h - top, left, _NETWORK_PX - w - left
    square = cv2.copyMakeBorder(small, *edges, cv2.BORDER_REPLICATE)
    square[:top] = cv2.blur(square[top : top + 1], (_WALL_PX, 1))
    square[:, :left], square[:, left + w :] = np.median(small[:, [0, -1]], axis=0)
    session = models.load(_NETWORK)
    (out,) = session.run(None, {session.get_inputs()[0].name: square[None] * np.float32(1 / 255)})
    mask = np.ascontiguousarray(out[0, top : top + h, left : left + w, 0], np.float32)
    return np.asarray(np.clip(cv2.resize(mask, (width, height), interpolation=cv2.INTER_LINEAR), 0, 1), np.float32)


def scene_raster(size: tuple[int, int]) -> Raster:
    """The cells over a whole picture of `size` (height, width); the last row may reach over its edge."""
    height, width = size
    columns = max(_BODY.least_side, round(width / max(_BODY.least_cell_px, max(size) / _BODY.cells)))
    step = width / columns
    rows = max(_BODY.least_side, int(np.ceil(height / step - 1e-6)))
    return Raster.over(np.array([0, 0, width, height], np.float32), (rows, columns))


def haze_over(picture: Picture) -> int:
    """Levels of haze over a whole picture, see `pvg.haze`."""
    return haze_of(_cells(picture, scene_raster(picture.size)))


@dataclass(frozen=True, eq=False)
class Scene:
    """A whole picture at a small size.

    raster: its cells;  rgb: (h, w, 3) uint8, without haze;  person: (h, w) uint8, 255 on people;
    flow: (h', w', 2) float32, from blocks of cells to where they were in the scene before, None without one;
    faces: all that are known to be there, source pixels;
    changed: whether more of the picture changed than the flow explains: what was known of the scene before is not where
    the flow has it;
    haze: levels of it over the picture as it is, see `pvg.haze`;
    contrast: of the picture as it is, see `pvg.picture.rms_contrast`.
    """

    raster: Raster
    rgb: Bytes
    person: Bytes
    flow: Floats | None
    faces: tuple[Landmarks, ...]
    changed: bool
    haze: int
    contrast: float

    @cached_property
    def before(self) -> Maps | None:
        """Maps x, y (h, w) from the cells to where they were in the scene before, None without one."""
        if self.flow is None:
            return None
        return cells_along(self.flow, self.raster.shape)

    def people(self, raster: Raster) -> Floats:
        """Where people may be in the cells (h, w) of another raster: float32, 0 where none are, up to 1.

        Beyond the picture its edge is repeated: people do not end there.
        """
        xs, ys = (
            np.asarray(np.clip(other, own[0], own[-1]), np.float32)
            for other, own in zip(raster.centers(), self.raster.centers(), strict=True)
        )
        person = self.raster.read(self.person.astype(np.float32) / np.float32(255), xs, ys)
        return ramp(person, *_BODY.any_person)


def cells_along(flow: Floats, shape: tuple[int, int]) -> Maps:
    """Maps x, y (h, w) of where cells are along a flow (h', w', 2) of blocks of them, in blocks."""
    h, w = shape
    return places_before(cv2.resize(flow, (w, h), interpolation=cv2.INTER_LINEAR) * np.float32(_FLOW_CELLS))


def _changed(before: Bytes, grey: Bytes, flow: Floats) -> bool:
    """Whether a picture (h, w) is another than the one before, moved by the flow (h, w, 2), in much of it."""
    off = cv2.blur(cv2.absdiff(moved(before, places_before(flow)), grey), (3, 3)) > _BODY.unexplained
    return bool(off.mean() > _BODY.much)


class SceneReader:
    """Makes the scene of each picture of a clip, in order."""

    def __init__(self) -> None:
        self._flow = FlowFinder()
        self._grey: Bytes | None = None
        self._person: Bytes | None = None
        self._age = 0  # scenes since the network was asked
        self._haze: int | None = None

    def step(self, frame: Picture | Bytes, faces: Sequence[Landmarks] = (), *, cut: bool = False) -> Scene:
        """The scene of the next frame, a picture or (H, W, 3) uint8 RGB.

        faces: source pixels;  cut: whether a shot begins with it.
        """
        picture = as_picture(frame)
        raster = scene_raster(picture.size)
        seen = _cells(picture, raster)
        haze = self._steady_haze(seen, cut=cut)
        rgb = without_haze(seen, haze)
        small = (max(1, raster.shape[1] // _FLOW_CELLS), max(1, raster.shape[0] // _FLOW_CELLS))
        averaged = cv2.resize(rgb, small, interpolation=cv2.INTER_AREA)
        grey = np.asarray(cv2.cvtColor(averaged, cv2.COLOR_RGB2GRAY), np.uint8)
        flow, changed = None, False
        if not cut and self._grey is not None and self._grey.shape == grey.shape:
            flow = self._flow.back(grey, self._grey)
            changed = _changed(self._grey, grey, flow)
        person = self._people(rgb, flow, changed=changed)
        self._grey, self._person = grey, person
        contrast = rms_contrast(np.asarray(cv2.cvtColor(seen, cv2.COLOR_RGB2GRAY), np.uint8))
        return Scene(raster, rgb, person, flow, tuple(faces), changed, haze, contrast)

    def _steady_haze(self, seen: Bytes, *, cut: bool) -> int:
        """Levels of haze over a picture (h, w, 3): those of the one before unless it has clearly more or less."""
        haze = haze_of(seen)
        if cut or self._haze is None or abs(haze - self._haze) > _STEADY:
            self._haze = haze
        return self._haze

    def _people(self, rgb: Bytes, flow: Floats | None, *, changed: bool) -> Bytes:
        """The person mask (h, w), 255 on people: the one before moved by the flow, and a new one now and then.

        rgb: (h, w, 3);  flow: to the scene before, None without one;  changed: see `Scene`.
        """
        self._age += 1
        person: Bytes | None = None
        if flow is not None and self._person is not None:
            person = moved(self._person, cells_along(flow, rgb.shape[:2]))
        if person is not None and not changed and self._age < _BODY.person_every:
            return person
        self._age = 0
        new: Bytes = np.asarray(np.rint(person_mask(rgb) * 255), np.uint8)
        return new if person is None else np.asarray(cv2.addWeighted(new, 0.5, person, 0.5, 0), np.uint8)


def _cells(picture: Picture, raster: Raster) -> Bytes:
    """The picture over the raster's cells: halved as far as may be, then read at their centres, which is cheap."""
    smaller, factor = picture.reduced(raster.step)
    step = raster.step / factor
    x, y = (first_reading(float(corner) / factor, step) for corner in raster.origin)
    return smaller.warp(np.array([[step, 0, x], [0, step, y]]), (raster.shape[1], raster.shape[0]))
