"""Blocks of a lattice's nodes over one face, on which is seen what is smoother than the nodes are apart."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from pvg._arrays import Floats, Ints
from pvg._compiled import kernel
from pvg.face import FaceAxes
from pvg.membrane import Lattice
from pvg.raster import SUBPIXEL_BITS, fixed_point
from pvg.rendering.node_means import averaged, mean_codes
from pvg.rendering.placed_face import PlacedFace
from pvg.video import Frame

_COARSE = 2  # nodes across a block [measured: a beard that moves flickers in blocks of 3 nodes, not in these]
_FEATHER = 0.05  # of the face's width: how softly the face goes over into what is beside it [by eye]
_LEAST = np.float32(1e-3)  # of alpha: where there is less, no mean is told


@dataclass(frozen=True, eq=False)
class Blocks:
    """Blocks of a lattice over a face in a frame, (h, w) of them, a little less than `_COARSE` nodes wide and high.

    What is read of the frame is read once, for all that look at it.
    """

    frame: Frame
    placed: PlacedFace
    lattice: Lattice
    shape: tuple[int, int]

    @classmethod
    def of(cls, frame: Frame, placed: PlacedFace, lattice: Lattice) -> Blocks:
        """The blocks that a lattice is divided into."""
        return cls(frame, placed, lattice, (-(-lattice.height // _COARSE), -(-lattice.width // _COARSE)))

    @property
    def step(self) -> float:
        """Source pixels from one block to the next, nearly."""
        return _COARSE * self.lattice.step

    @property
    def axes(self) -> FaceAxes:
        """The face's."""
        return self.placed.data.landmarks.axes

    @cached_property
    def below(self) -> Floats:
        """(h, w) how far their middles lie below the face's centre, of its width."""
        return self._along(self.axes.down)

    @cached_property
    def beside(self) -> Floats:
        """(h, w) 0 within the face's oval, 1 well outside it."""
        soft = self.softened(self.inside(self.placed.data.landmarks.oval), _FEATHER * self.axes.width)
        return np.asarray(np.clip(1.0 - 2.0 * soft, 0.0, 1.0), np.float32)

    @cached_property
    def aside(self) -> Floats:
        """(h, w) how far their middles lie across from the face's centre, of its width."""
        return self._along(self.axes.across)

    def inside(self, outline: Floats) -> Floats:
        """(h, w) how much of each lies inside an outline (n, 2) in source pixels."""
        lattice = self.lattice
        nodes = np.array([lattice.width / self.shape[1], lattice.height / self.shape[0]])  # of a block
        first = np.array([lattice.x, lattice.y]) + (nodes - 1) / 2 * lattice.step  # the middle of the first one
        corners = ((outline - first) / (nodes * lattice.step)).astype(np.float32)
        filled = np.zeros(self.shape, np.float32)
        cv2.fillPoly(filled, [fixed_point(corners)], 1.0, lineType=cv2.LINE_AA, shift=SUBPIXEL_BITS)
        return filled

    def softened(self, values: Floats, sigma: float) -> Floats:
        """Values (h, w) or (h, w, C) smoothed;  sigma: source pixels."""
        return np.asarray(cv2.GaussianBlur(values, (0, 0), max(0.5, sigma / self.step)), np.float32)

    def means(self, sigma: float) -> Floats:
        """(h, w, 3) mean codes of luma and chroma around each, as the face's matte weighs them.

        sigma: source pixels.
        """
        means = self.softened(self._weighed_codes, sigma)
        divide_sums(means, self.softened(self.alpha, sigma), self._codes, _LEAST)
        return means

    def _along(self, direction: Floats) -> Floats:
        """(h, w) how far their middles lie from the face's centre in a direction (2,), of its width."""
        lattice, axes = self.lattice, self.axes
        x = _middles(lattice.x, lattice.width, self.shape[1], lattice.step) - axes.center[0]
        y = _middles(lattice.y, lattice.height, self.shape[0], lattice.step) - axes.center[1]
        return np.asarray((x * direction[0] + y[:, None] * direction[1]) / axes.width, np.float32)

    @cached_property
    def alpha(self) -> Floats:
        """(h, w) mean of the face's matte."""
        return averaged(self.placed.alpha, self.shape)

    @cached_property
    def _codes(self) -> Floats:
        return mean_codes(self.frame, self.placed.window, self.shape)

    @cached_property
    def _weighed_codes(self) -> Floats:
        return self.alpha[..., None] * self._codes

    def at_nodes(self, values: Floats) -> Floats:
        """Values (h, w) read at the lattice's nodes."""
        size = (self.lattice.width, self.lattice.height)
        return np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_LINEAR), np.float32)

    def filled(self, which: Ints, values: Floats) -> Floats:
        """(h, w) of values (n,) at the blocks `which` (n,), counted along the rows; 0 elsewhere."""
        out = np.zeros(self.shape, np.float32)
        out.reshape(-1)[which] = values
        return out


def codes_at(which: Ints, codes: Floats) -> Floats:
    """(n, 3) of codes (h, w, 3) at the blocks `which` (n,), counted along the rows; each plane is contiguous."""
    return np.asarray(cv2.transpose(codes.reshape(-1, 3).take(which, axis=0)).T)


@kernel()
def divide_sums(sums: Floats, weight: Floats, codes: Floats, least: np.float32) -> None:
    """sums (h, w, 3) /= weight (h, w), in place; codes (h, w, 3) where that is not more than `least`."""
    for i in range(weight.shape[0]):
        for j in range(weight.shape[1]):
            for p in range(3):
                sums[i, j, p] = sums[i, j, p] / weight[i, j] if weight[i, j] > least else codes[i, j, p]


def _middles(first: float, nodes: int, blocks: int, step: float) -> Floats:
    """Where blocks of nodes have their middles, (blocks,);  first: where the first node is."""
    return np.asarray(first + step * ((np.arange(blocks) + 0.5) * nodes / blocks - 0.5), np.float32)
