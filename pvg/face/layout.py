"""The two point sets kept of a face, both linear in the 478-point mesh: 106 landmarks and 88 skin points.

Left and right are image sides. Within the 106 (JD order): 0–32 face contour from the left temple over the chin (16)
to the right temple, 33–42 upper and 64–71 lower brow edges, 43–46 nose ridge, 47–51 and 78–83 nose, 52–63 and 72–77
eyes, 84–103 lips, 104–105 pupils.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float32]

MESH_COUNT = 478
JD_COUNT = 106

JD_GROUPS: dict[str, tuple[int, ...]] = {
    "contour": tuple(range(33)),
    "brow_left": (33, 34, 35, 36, 37, 67, 66, 65, 64),
    "brow_right": (38, 39, 40, 41, 42, 71, 70, 69, 68),
    "nose_ridge": (43, 44, 45, 46),
    "nose_base": (47, 48, 49, 50, 51),
    "nose_side_left": (78, 80, 82),
    "nose_side_right": (79, 81, 83),
    "eye_left": (52, 53, 72, 54, 55, 56, 73, 57),
    "eye_right": (58, 59, 75, 60, 61, 62, 76, 63),
    "lips_outer": tuple(range(84, 96)),
    "lips_inner": (96, 97, 98, 99, 100, 101, 102, 103),
    "pupils": (104, 105),
}
"""Indices into the 106 landmarks, each group in drawing order; brows, eyes and lips are closed loops."""

JD_CLOSED = frozenset({"brow_left", "brow_right", "eye_left", "eye_right", "lips_outer", "lips_inner"})

# fmt: off
_CONTOUR_LEFT = (127, 234, 93, 132, 58, 172, 136, 150, 149, 176, 148, 152)
_CONTOUR_RIGHT = (356, 454, 323, 361, 288, 397, 365, 379, 378, 400, 377, 152)
# arc lengths between them on the neutral face, centimetres: resampling by the lengths of each picture would
# let the points slide over the skin as the head turns, and curve matching needs them to stay
_CONTOUR_STEPS = (1.748, 1.727, 1.870, 2.040, 1.977, 1.859, 1.778, 1.341, 1.288, 1.171, 1.309)
_REST = (
    70, 63, 105, 66, 107,  336, 296, 334, 293, 300,  168, 197, 5, 4,  98, 97, 2, 326, 327,
    33, 160, 158, 133, 153, 144,  362, 385, 387, 263, 373, 380,  53, 52, 65, 55,  285, 295, 282, 283,
    159, 145, 468,  386, 374, 473,  193, 417, 198, 420, 129, 358,  61, 40, 37, 0, 267, 270, 291,
    321, 405, 17, 181, 91,  78, 81, 13, 311, 308,  402, 14, 178,  468, 473,
)
SKIN_POINTS: dict[str, tuple[int, ...]] = {
    "oval": (
        10, 338, 297, 332, 284, 251, 389, 356, 454, 323, 361, 288, 397, 365, 379, 378, 400, 377,
        152, 148, 176, 149, 150, 136, 172, 58, 132, 93, 234, 127, 162, 21, 54, 103, 67, 109,
    ),
    "ring": (
        151, 337, 299, 333, 298, 301, 368, 264, 447, 366, 401, 435, 367, 364, 394, 395, 369, 396,
        175, 171, 140, 170, 169, 135, 138, 215, 177, 137, 227, 34, 139, 71, 68, 104, 69, 108,
    ),
    "cheek_left": (117, 118, 101, 36, 205, 187, 147, 123),
    "cheek_right": (346, 347, 330, 266, 425, 411, 376, 352),
}
"""Mesh vertices of the skin loops, all closed: the face oval, the ring inside it, one loop on either cheek."""
# fmt: on

SKIN_SLICES: dict[str, slice] = {}
"""Where each loop of SKIN_POINTS lies in an (…, 88, 2) array of skin points."""
_start = 0
for _name, _ids in SKIN_POINTS.items():
    SKIN_SLICES[_name] = slice(_start, _start + len(_ids))
    _start += len(_ids)
SKIN_COUNT = _start
_SKIN_INDEX = np.array([vertex for ids in SKIN_POINTS.values() for vertex in ids])


def _contour_side(vertices: tuple[int, ...]) -> list[tuple[int, int, float]]:
    """Cut one side into 16 equal steps: (vertex before, vertex after, share of the one after), 17 of them."""
    lengths = np.concatenate([[0.0], np.cumsum(_CONTOUR_STEPS)])
    cuts = []
    for position in np.linspace(0, lengths[-1], 17):
        after = min(max(int(np.searchsorted(lengths, position)), 1), len(vertices) - 1)
        share = (position - lengths[after - 1]) / (lengths[after] - lengths[after - 1])
        cuts.append((vertices[after - 1], vertices[after], float(share)))
    return cuts


def _jd_table() -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], FloatArray]:
    cuts = _contour_side(_CONTOUR_LEFT) + _contour_side(_CONTOUR_RIGHT)[-2::-1]
    cuts += [(vertex, vertex, 0.0) for vertex in _REST]
    before, after, share = zip(*cuts, strict=True)
    return np.array(before), np.array(after), np.array(share, np.float32)[:, None]


_BEFORE, _AFTER, _SHARE = _jd_table()


def jd_106(mesh: FloatArray) -> FloatArray:
    """Take the 106 landmarks out of mesh points: (…, 478, k) float32 to (…, 106, k) float32."""
    return np.asarray(mesh[..., _BEFORE, :] * (1 - _SHARE) + mesh[..., _AFTER, :] * _SHARE, dtype=np.float32)


def skin_88(mesh: FloatArray) -> FloatArray:
    """Take the skin points out of mesh points: (…, 478, k) float32 to (…, 88, k) float32, as SKIN_SLICES."""
    return np.asarray(mesh[..., _SKIN_INDEX, :], dtype=np.float32)
