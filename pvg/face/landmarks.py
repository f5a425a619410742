"""The landmarks of a face: one value that goes from the tracker to the asset and the renderer."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pvg._arrays import Floats, Ints
from pvg.face import layout
from pvg.face.axes import FaceAxes
from pvg.raster import Raster, scaled

_EYES_AND_MOUTH = (layout.LEFT_EYE_CONTOUR, layout.RIGHT_EYE_CONTOUR, layout.LIPS_OUTER)


@dataclass(frozen=True, eq=False)
class Landmarks:
    """106 landmarks and 88 skin points of one face, in one picture or in several.

    points: (…, 106, 2) float32;  skin_points: (…, 88, 2) float32, x and y in pixels of the picture, centres of pixels
    at integers. See `pvg.face.layout` for the names of the points.
    """

    points: Floats
    skin_points: Floats

    @classmethod
    def from_mesh(cls, mesh: Floats) -> Landmarks:
        """The points that are kept of a fitted mesh: (…, 478, 2) float32."""
        before, after, share = _CUTS
        points = mesh[..., before, :] * (1 - share) + mesh[..., after, :] * share
        return cls(np.asarray(points, np.float32), np.asarray(mesh[..., _SKIN_VERTICES, :], np.float32))

    @classmethod
    def unstack(cls, stacked: Floats) -> Landmarks:
        """The landmarks whose stacked points are (…, 194, 2)."""
        return cls(stacked[..., : layout.LANDMARK_COUNT, :], stacked[..., layout.LANDMARK_COUNT :, :])

    def __getitem__(self, rows: int | slice | NDArray[np.generic]) -> Landmarks:
        """One picture's or some pictures' points of several."""
        return Landmarks(self.points[rows], self.skin_points[rows])

    def copy(self) -> Landmarks:
        """The same points in memory of their own: part of a track holds all of the track's."""
        return Landmarks(self.points.copy(), self.skin_points.copy())

    def __len__(self) -> int:
        return len(self.points)

    @cached_property
    def stacked(self) -> Floats:
        """(…, 194, 2): the landmarks, then the skin points."""
        return np.concatenate([self.points, self.skin_points], axis=-2)

    @cached_property
    def oval(self) -> Floats:
        """(…, 36, 2) outline of the face with its forehead, closed."""
        return self.skin_points[..., layout.OVAL, :]

    @cached_property
    def eyes_and_mouth(self) -> Floats:
        """(3, 2) float32 middles of the left eye, the right eye and the lips: a face is laid straight by them.

        For the landmarks of one picture.
        """
        return np.stack([self.points[part].mean(axis=0) for part in _EYES_AND_MOUTH]).astype(np.float32)

    @cached_property
    def axes(self) -> FaceAxes:
        """The face's axes; for the landmarks of one picture."""
        return FaceAxes.of(self.points)

    def in_cells(self, raster: Raster) -> Landmarks:
        """The same face in the cells of a raster."""
        return Landmarks(raster.to_cells(self.points), raster.to_cells(self.skin_points))

    def scaled(self, ratio: Floats | float) -> Landmarks:
        """The same face in a copy of the picture whose sides are `ratio` (2,) times as long."""
        points, skin_points = (scaled(one, ratio).astype(np.float32) for one in (self.points, self.skin_points))
        return Landmarks(points, skin_points)

    def moved(self, shift: Floats) -> Landmarks:
        """All points moved by `shift` (2,)."""
        return Landmarks(self.points + shift, self.skin_points + shift)


def _contour_side(vertices: tuple[int, ...]) -> list[tuple[int, int, float]]:
    """Cut one side into 16 equal steps: (vertex before, vertex after, share of the one after), 17 of them."""
    lengths = np.concatenate([[0.0], np.cumsum(layout.MESH_CONTOUR_STEPS)])
    cuts = []
    for position in np.linspace(0, lengths[-1], layout.CHIN + 1):
        after = min(max(int(np.searchsorted(lengths, position)), 1), len(vertices) - 1)
        share = (position - lengths[after - 1]) / (lengths[after] - lengths[after - 1])
        cuts.append((vertices[after - 1], vertices[after], float(share)))
    return cuts


def _landmark_cuts() -> tuple[Ints, Ints, Floats]:
    """Of each landmark the vertices around it (106,) and how far it lies on the way between them (106, 1)."""
    cuts = _contour_side(layout.MESH_LEFT_CONTOUR) + _contour_side(layout.MESH_RIGHT_CONTOUR)[-2::-1]
    cuts += [(vertex, vertex, 0.0) for vertex in layout.MESH_AFTER_CONTOUR]
    before, after, share = zip(*cuts, strict=True)
    return np.array(before), np.array(after), np.array(share, np.float32)[:, None]


_CUTS = _landmark_cuts()
_SKIN_VERTICES = np.array([vertex for loop in layout.SKIN_POINTS.values() for vertex in loop])
