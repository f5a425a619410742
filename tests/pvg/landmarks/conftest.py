"""Fixtures of the landmarks' tests: a real portrait, its mesh, and its head to paste into scenes."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from pvg.face import Landmarks
from pvg.landmarks import Mesh
from pvg.landmarks.mesh import region_of_points
from scripts.samples import Samples
from tests.gallery.faces import fit_surest, read_rgb


@pytest.fixture(scope="session")
def portrait(samples: Samples) -> np.ndarray:
    return read_rgb(samples.dark_portrait)


@pytest.fixture(scope="session")
def mesh(portrait: np.ndarray) -> Mesh:
    return fit_surest(portrait)


@pytest.fixture(scope="session")
def face(mesh: Mesh) -> Landmarks:
    return Landmarks.from_mesh(mesh.points)


def _head(portrait: np.ndarray, mesh: Mesh) -> np.ndarray:
    """A portrait's head, (200, 200, 3), its face about 100 px wide."""
    region = region_of_points(mesh.points)
    scale = 200 / region.size
    shift = [100 - scale * region.center_x, 100 - scale * region.center_y]
    matrix = np.array([[scale, 0, shift[0]], [0, scale, shift[1]]])
    return cv2.warpAffine(portrait, matrix, (200, 200), flags=cv2.INTER_AREA)


@pytest.fixture(scope="session")
def head(portrait: np.ndarray, mesh: Mesh) -> np.ndarray:
    """The portrait's head at 100 px width, to paste into scenes."""
    return _head(portrait, mesh)


@pytest.fixture(scope="session")
def other_head(samples: Samples) -> np.ndarray:
    """Another person's head, likewise."""
    portrait = read_rgb(samples.pale_portrait)
    return _head(portrait, fit_surest(portrait))
