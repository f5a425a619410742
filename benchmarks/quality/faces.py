"""The face in a frame as all methods and measures see it: one matte, one skin, one window."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

import pvg
from benchmarks.quality.color import ita, lab
from pvg.asset import FaceInFrame, KeyFrame
from pvg.curves import table_labels
from pvg.face import Landmarks, layout
from pvg.rendering import PlacedFace, source_frame
from pvg.rendering.placed_face import place_face
from pvg.skin import Matte

Image = NDArray[np.uint8]
Bools = NDArray[np.bool_]
Floats = NDArray[np.float32]

_FEATURES = (
    layout.LEFT_BROW,
    layout.RIGHT_BROW,
    layout.LEFT_EYE,
    layout.RIGHT_EYE,
    layout.LIPS_OUTER,
    layout.NOSE_BASE,
)
_MARGIN = 0.03  # of the face's width: features grow and the matte shrinks by it before skin is measured
_LID, _LASHES = 0.055, 0.01  # of the face's width around the eye: lids, and what is eye or lashes
_RING = (0.03, 0.10)  # of the face's width outside the lips
_LEAST_SKIN = 200  # pixels
_BEARD = 17.0  # CIELAB distance of upper and lower face [measured: bearded ones 19 to 43, others at most 16]
_MOST_PIXELS = 20_000


def odd_kernel(radius: float) -> NDArray[np.uint8]:
    """A round structuring element."""
    size = 2 * max(1, round(radius)) + 1
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)), np.uint8)


def hulls(shape: tuple[int, int], polygons: list[Floats]) -> Bools:
    """(h, w) bool, the convex hulls of polygons (n, 2), drawn to a sixteenth of a pixel."""
    out = np.zeros(shape, np.uint8)
    for polygon in polygons:
        hull = cv2.convexHull(np.ascontiguousarray(polygon, np.float32))[:, 0]
        cv2.fillPoly(out, [np.rint(hull * 16).astype(np.int32)], (1,), shift=4)
    return out.astype(np.bool_)


@dataclass(frozen=True, eq=False)
class View:
    """One face in one frame over a window of the picture.

    window: rows and columns of the picture;  size: (width, height) of the picture;
    bearded: whether the lower face shows a beard and no skin, see `looked_at`.
    """

    data: FaceInFrame
    window: tuple[slice, slice]
    size: tuple[int, int]
    bearded: bool = False

    @cached_property
    def alpha(self) -> Floats:
        """(h, w) float32, the matte in [0, 1] over the window."""
        rows, columns = self.window
        xs = np.arange(columns.start, columns.stop, dtype=np.float32)
        return self.matte.alpha_at(xs, np.arange(rows.start, rows.stop, dtype=np.float32))

    @property
    def matte(self) -> Matte:
        """The matte over its own box."""
        return self.data.matte

    @property
    def width(self) -> float:
        """Width of the face in pixels."""
        return self.data.landmarks.axes.width

    @cached_property
    def face(self) -> Bools:
        """(h, w) bool: the matte above one half."""
        return self.alpha > 0.5

    @cached_property
    def inner(self) -> Bools:
        """(h, w) bool: `face`, shrunk."""
        return cv2.erode(self.face.astype(np.uint8), odd_kernel(_MARGIN * self.width)).astype(np.bool_)

    @cached_property
    def around(self) -> Bools:
        """(h, w) bool: `face`, grown, so that its edge counts."""
        return cv2.dilate(self.face.astype(np.uint8), odd_kernel(_MARGIN * self.width)).astype(np.bool_)

    @property
    def skin(self) -> Bools:
        """(h, w) bool: open skin of the face: `shaven`, or `bare` where there is a beard."""
        return self.bare if self.bearded else self.shaven

    def looked_at(self, rgb: Image) -> View:
        """This view of a picture (H, W, 3) with `bearded` by what it shows.

        A lower face that is a beard is darker than the upper one and at least `_BEARD` from it in CIELAB, medians.
        """
        part = self.crop(rgb)
        upper, lower = part[self.bare], part[self.shaven & ~self.bare]
        if min(len(upper), len(lower)) < _LEAST_SKIN:
            return self
        above, below = (lab(np.median(pixels, axis=0)) for pixels in (upper, lower))
        return replace(self, bearded=bool(below[0] < above[0] and np.linalg.norm(below - above) > _BEARD))

    @cached_property
    def shaven(self) -> Bools:
        """(h, w) bool: `inner` within the oval, without brows, eyes, lips and nostrils."""
        face = self._in_window
        features = hulls(self.alpha.shape, [face.points[feature] for feature in _FEATURES])
        grown = cv2.dilate(features.astype(np.uint8), odd_kernel(_MARGIN * self.width)).astype(np.bool_)
        within = self.inner & hulls(self.alpha.shape, [face.oval])
        return within & ~grown

    @cached_property
    def bare(self) -> Bools:
        """(h, w) bool: `shaven` above the nose's base, where no beard grows."""
        origin = np.array([self.window[1].start, self.window[0].start], np.float32)
        down = self.data.landmarks.axes.down
        base = float((self.data.landmarks.points[layout.NOSE_BASE].mean(axis=0) - origin) @ down)
        ys, xs = np.indices(self.shaven.shape, np.float32)
        return np.asarray(self.shaven & (xs * down[0] + ys * down[1] < base), np.bool_)

    @cached_property
    def parts(self) -> dict[str, Bools]:
        """(h, w) bool of lips, lids, cheeks, forehead and ring: the skin 3 to 10 % of the width outside the lips."""
        face = self._in_window
        shape, width = self.alpha.shape, self.width
        mouth, gap = (hulls(shape, [face.points[loop]]) for loop in (layout.LIPS_OUTER, layout.LIPS_INNER))
        eyes = hulls(shape, [face.points[loop] for loop in (layout.LEFT_EYE, layout.RIGHT_EYE)]).astype(np.uint8)
        brows = hulls(shape, [face.points[loop] for loop in (layout.LEFT_BROW, layout.RIGHT_BROW)])
        near, open_eyes = (cv2.dilate(eyes, odd_kernel(share * width)).astype(np.bool_) for share in (_LID, _LASHES))
        down = self.data.landmarks.axes.down
        ys, xs = np.indices(shape, np.float32)
        below = xs * down[0] + ys * down[1]
        away = cv2.distanceTransform((~mouth).astype(np.uint8), cv2.DIST_L2, 5) / width
        cheeks = hulls(shape, [face.skin_points[loop] for loop in (layout.LEFT_CHEEK, layout.RIGHT_CHEEK)])
        pupils, brow_tops = (float((face.points[g] @ down).mean()) for g in (layout.PUPILS, layout.UPPER_BROW_EDGES))
        return {
            "lips": mouth & ~gap & self.face,
            "lids": near & ~open_eyes & ~brows & (below < pupils) & self.face,
            "cheeks": cheeks & self.skin,
            "forehead": self.skin & (below < brow_tops),
            "ring": self.inner & (away >= _RING[0]) & (away <= _RING[1]) & hulls(shape, [face.oval]),
        }

    @property
    def _in_window(self) -> Landmarks:
        return self.data.landmarks.moved(-np.array([self.window[1].start, self.window[0].start], np.float32))

    @cached_property
    def placed(self) -> PlacedFace | None:
        """Curves and matte as the renderer places them."""
        return place_face(self.data, table_labels(), *self.size)

    def crop(self, picture: Image) -> Image:
        """The picture's part in the window."""
        return picture[self.window]

    def over_picture(self, mask: Bools) -> Bools:
        """A mask (h, w) of the window as one of the whole picture."""
        whole = np.zeros((self.size[1], self.size[0]), np.bool_)
        whole[self.window] = mask
        return whole


def view_of(data: FaceInFrame, size: tuple[int, int], window: tuple[slice, slice] | None = None) -> View:
    """The face over its own box, or over a given window."""
    return View(data, window or window_of([data], size), size)


def window_of(faces: list[FaceInFrame], size: tuple[int, int]) -> tuple[slice, slice]:
    """The smallest even window of a picture (width, height) that holds the boxes of all faces."""
    boxes = np.stack([data.matte.raster.box for data in faces])
    low = np.maximum(np.floor(boxes[:, :2].min(axis=0)), 0).astype(int) // 2 * 2
    high = np.minimum(np.ceil(boxes[:, 2:].max(axis=0)) + 1, size).astype(int)
    return slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0]))


def sample_pixels(pixels: NDArray[np.uint8], count: int, seed: int = 0) -> NDArray[np.uint8]:
    """At most `count` rows, drawn alike every time."""
    if len(pixels) <= count:
        return pixels
    return pixels[np.sort(np.random.default_rng(seed).choice(len(pixels), count, replace=False))]


@dataclass(frozen=True, eq=False)
class Reference:
    """A portrait whose face colours are wanted.

    rgb: the whole picture, as whole-frame methods take it;  face: (n, 3) pixels under its matte;
    skin: (m, 3) its open face skin;  bare: (k, 3) that above the nose's base;  key: its curve colours.
    """

    name: str
    video: pvg.VectorVideo
    key: KeyFrame
    rgb: Image
    face: NDArray[np.uint8]
    skin: NDArray[np.uint8]
    bare: NDArray[np.uint8]
    ita: float
    view: View


def read_reference(path: Path, asset: Path) -> Reference:
    """Open a portrait vectorised as a reference. Raises `ValueError` when too little open skin is seen."""
    video = pvg.open_asset(asset, path)
    frame = video.faces[0].first_frame
    data = video.face_at(0, frame)
    if data is None:
        raise ValueError(f"{path.name} has no face in its key frame")
    rgb = source_frame(video, frame).rgb()
    view = view_of(data, (rgb.shape[1], rgb.shape[0])).looked_at(rgb)
    part = view.crop(rgb)
    skin, bare = part[view.skin], part[view.bare]
    if len(bare) < _LEAST_SKIN:
        raise ValueError(f"{path.name} shows too little open skin to compare with")
    return Reference(
        path.stem,
        video,
        video.records[0].key_frames[0],
        rgb,
        sample_pixels(part[view.face], _MOST_PIXELS),
        sample_pixels(skin, _MOST_PIXELS),
        sample_pixels(bare, _MOST_PIXELS),
        ita(np.median(bare, axis=0)),
        view,
    )


@contextmanager
def references_of(portraits: dict[Path, Path]) -> Iterator[list[Reference]]:
    """Open all portraits (path -> asset) as references and close them afterwards."""
    opened = [read_reference(path, asset) for path, asset in portraits.items()]
    try:
        yield opened
    finally:
        for reference in opened:
            reference.video.close()
