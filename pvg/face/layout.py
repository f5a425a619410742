"""The points kept of a face, by name: the only landmark numbers of the project.

Three numberings meet here. `MESH` numbers are vertices of the 478-point face mesh. A face is kept as 106 landmarks (JD
order: 0–32 contour from the left temple over the chin to the right temple, 33–42 upper and 64–71 lower brow edges,
43–46 nose ridge, 47–51 and 78–83 nose, 52–63 and 72–77 eyes, 84–103 lips, 104–105 pupils) and 88 skin points, both
linear in the mesh. *Stacked*, the skin points follow the landmarks, 194 in all. Left and right are image sides.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

Indices = NDArray[np.intp]

LANDMARK_COUNT: Final = 106
SKIN_COUNT: Final = 88


def _points(*numbers: int | range) -> Indices:
    """A named group: indices in drawing order."""
    flat = [n for number in numbers for n in (number if isinstance(number, range) else (number,))]
    group = np.array(flat, np.intp)
    group.flags.writeable = False
    return group


# groups of the 106 landmarks; brows, eyes and lips are closed loops
CONTOUR: Final = _points(range(33))
CHIN: Final = 16
CONTOUR_WIDTHS: Final = ((0, 32), (4, 28), (8, 24), (11, 21))
"""Pairs of contour points whose distances are widths of the face, from the temples down."""
LEFT_BROW: Final = _points(33, 34, 35, 36, 37, 67, 66, 65, 64)
RIGHT_BROW: Final = _points(38, 39, 40, 41, 42, 71, 70, 69, 68)
UPPER_BROW_EDGES: Final = _points(range(33, 43))
LEFT_LOWER_BROW_EDGE: Final = _points(range(64, 68))
RIGHT_LOWER_BROW_EDGE: Final = _points(range(68, 72))
NOSE_RIDGE: Final = _points(43, 44, 45, 46)
NOSE_TIP: Final = 46
NOSE_BASE: Final = _points(47, 48, 49, 50, 51)
NOSE_BASE_MIDDLE: Final = 49
NOSE_BASE_TO_WINGS: Final = _points(82, 47, 48, 49, 50, 51, 83)
NOSE_WINGS: Final = _points(82, 83)
LEFT_NOSE_SIDE: Final = _points(78, 80, 82)
RIGHT_NOSE_SIDE: Final = _points(79, 81, 83)
LEFT_EYE: Final = _points(52, 53, 72, 54, 55, 56, 73, 57)
RIGHT_EYE: Final = _points(58, 59, 75, 60, 61, 62, 76, 63)
LEFT_EYE_CONTOUR: Final = _points(range(52, 58))
RIGHT_EYE_CONTOUR: Final = _points(range(58, 64))
EYE_CONTOURS: Final = _points(range(52, 64))
LEFT_UPPER_LASHES: Final = _points(52, 53, 72, 54, 55)
RIGHT_UPPER_LASHES: Final = _points(58, 59, 75, 60, 61)
LEFT_EYE_CORNERS: Final = (52, 55)
RIGHT_EYE_CORNERS: Final = (58, 61)
INNER_EYE_CORNERS: Final = (55, 58)
OUTER_EYE_CORNERS: Final = (52, 61)
LEFT_LIDS: Final = (72, 73)
RIGHT_LIDS: Final = (75, 76)
LIPS_OUTER: Final = _points(range(84, 96))
LIPS_INNER: Final = _points(range(96, 104))
MOUTH_CORNERS: Final = (84, 90)
UPPER_LIP_TOP: Final = 87
LIP_GAP: Final = (98, 102)
PUPILS: Final = _points(104, 105)

FEATURES: Final = (LEFT_BROW, RIGHT_BROW, LEFT_EYE_CONTOUR, RIGHT_EYE_CONTOUR, LIPS_OUTER)
"""What has other colours than skin, as outlines whose convex hulls cover it."""

LANDMARK_GROUPS: Final[dict[str, Indices]] = {
    "contour": CONTOUR,
    "left_brow": LEFT_BROW,
    "right_brow": RIGHT_BROW,
    "nose_ridge": NOSE_RIDGE,
    "nose_base": NOSE_BASE,
    "left_nose_side": LEFT_NOSE_SIDE,
    "right_nose_side": RIGHT_NOSE_SIDE,
    "left_eye": LEFT_EYE,
    "right_eye": RIGHT_EYE,
    "lips_outer": LIPS_OUTER,
    "lips_inner": LIPS_INNER,
    "pupils": PUPILS,
}
"""The groups that together hold nearly all landmarks, for drawing and looking."""
CLOSED_GROUPS: Final = frozenset({"left_brow", "right_brow", "left_eye", "right_eye", "lips_outer", "lips_inner"})

# fmt: off
SKIN_POINTS: Final[dict[str, tuple[int, ...]]] = {
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
"""`MESH` vertices of the skin loops, all closed: the face oval, the ring inside it, one loop on either cheek."""
# fmt: on
OVAL: Final = slice(0, 36)
RING: Final = slice(36, 72)
LEFT_CHEEK: Final = slice(72, 80)
RIGHT_CHEEK: Final = slice(80, 88)
"""Where each loop lies in an (…, 88, 2) array of skin points."""


# groups of the 194 stacked points
def _stacked(loop: slice, *numbers: int) -> Indices:
    """Points of a skin loop, all of them unless some are numbered, among the stacked points."""
    return _points(*(LANDMARK_COUNT + loop.start + n for n in numbers or range(loop.stop - loop.start)))


STACKED_RING: Final = _stacked(RING)
STACKED_LEFT_CHEEK: Final = _stacked(LEFT_CHEEK)
STACKED_RIGHT_CHEEK: Final = _stacked(RIGHT_CHEEK)
FOREHEAD: Final = _stacked(OVAL, 32, 33, 34, 35, 0, 1, 2, 3, 4)
"""Along the hair-line, from the left temple to the right one."""


def _across(oval: range, contour: range) -> tuple[int, ...]:
    """Points of oval and ring, counted from the top, and of the contour, from the temple, on both sides of the face."""
    loops = [int(n) for loop in (OVAL, RING) for n in _stacked(loop, *oval, *(-n % 36 for n in oval))]
    return tuple(sorted({*loops, *contour, *(2 * CHIN - n for n in contour)}))


_CHEEKS = (*STACKED_LEFT_CHEEK.tolist(), *STACKED_RIGHT_CHEEK.tolist())
SLICES: Final = (
    _points(*_across(range(10), range(4)), *LEFT_BROW, *RIGHT_BROW, *NOSE_RIDGE[:1]),
    _points(*_across(range(5, 12), range(7)), *_CHEEKS, *NOSE_RIDGE, range(47, 64), range(72, 84)),
    _points(*_across(range(7, 14), range(10)), *_CHEEKS, *NOSE_BASE_TO_WINGS, *LIPS_OUTER),
    _points(*_across(range(9, 19), range(3, 17)), *MOUTH_CORNERS, range(91, 96)),
)
"""The face in slices of stacked points, one over the other: forehead, nose, mouth and chin. A profile has its hollows
between them, at the bridge of the nose, below the nose and below the lips. Cheeks have none, so that slices overlap
there."""

Pairs = tuple[tuple[int, int], ...]


def _pairs(ends: Indices, others: Indices) -> Pairs:
    return tuple(zip(ends.tolist(), others.tolist(), strict=True))


UPPER_LIP_TO_NOSE: Final = _pairs(_points(range(85, 90)), NOSE_BASE)
LOWER_LIP_TO_CHIN: Final = _pairs(_points(84, 95, 94, 93, 92, 91, 90), _stacked(RING, 24, 22, 20, 18, 16, 14, 12))
LEFT_CHEEK_TO_JAW: Final = (
    *_pairs(_stacked(LEFT_CHEEK, 7, 6, 5), _stacked(RING, 26, 25, 24)),
    (84, int(_stacked(LEFT_CHEEK, 5)[0])),
)
RIGHT_CHEEK_TO_JAW: Final = (
    *_pairs(_stacked(RIGHT_CHEEK, 7, 6, 5), _stacked(RING, 10, 11, 12)),
    (90, int(_stacked(RIGHT_CHEEK, 5)[0])),
)
"""Pairs of stacked points with open skin between them."""

# fmt: off
AZIMUTH_DEG: Final = np.array((
    -77, -80, -81, -82, -82, -81, -79, -76, -73, -68, -63, -56, -52, -48, -38, -22, 0, 22, 38, 48, 52, 56, 63, 68,
    73, 76, 79, 81, 82, 82, 81, 80, 77, -52, -39, -24, -16, -20, 20, 16, 24, 39, 52, 0, 0, 0, 0, -45, -35, 0, 35,
    45, -27, -13, -4, -14, 1, -22, 14, 4, 13, 27, 22, -1, -25, -18, -17, -27, 27, 17, 18, 25, -7, -10, -8, 7, 10, 8,
    -43, 43, -65, 65, -47, 47, -29, -42, -16, 0, 16, 42, 29, 40, 31, 0, -31, -40, -34, -30, 0, 30, 34, 30, 0, -30,
    -8, 8, 0, 16, 32, 51, 63, 69, 75, 77, 81, 82, 82, 78, 72, 63, 54, 50, 41, 25, 0, -25, -41, -50, -54, -63, -72,
    -78, -82, -82, -81, -77, -75, -69, -63, -51, -32, -16, 0, 14, 27, 38, 55, 64, 66, 74, 77, 80, 79, 74, 64, 56,
    51, 46, 40, 20, 0, -20, -40, -46, -51, -56, -64, -74, -79, -80, -77, -74, -66, -64, -55, -38, -27, -14, -39,
    -27, -19, -34, -25, -43, -63, -62, 39, 27, 19, 34, 25, 43, 63, 62,
), np.float32)
"""Degrees by which the skin at each of the 106 landmarks and 88 skin points looks to the image's right on a face held
straight. [measured: normals of the fitted mesh, mean of 14 portraits and their mirror images]"""

ELEVATION_DEG: Final = np.array((
    0, 1, 3, 5, 8, 10, 14, 17, 20, 22, 23, 19, 18, 22, 27, 31, 33, 31, 27, 22, 18, 19, 23, 22, 20, 17, 14, 10, 8, 5,
    3, 1, 0, 7, 2, 2, 12, 17, 17, 12, 2, 2, 7, 1, -40, -27, 2, 15, 36, 53, 36, 15, 17, 20, 13, -7, -9, 1, -7, 13,
    20, 17, 1, -9, 23, 28, 35, 22, 22, 35, 28, 23, 17, -5, -3, 17, -5, -3, -4, -4, -25, -25, 4, 4, 16, 27, 16, 16,
    16, 27, 16, -8, -4, 11, -4, -8, 5, 27, 27, 27, 5, -1, -2, -1, -3, -3, -20, -22, -20, -15, -8, -3, -1, 0, 2, 6,
    9, 15, 21, 24, 17, 20, 26, 30, 33, 30, 26, 20, 17, 24, 21, 15, 9, 6, 2, 0, -1, -3, -8, -15, -20, -22, -13, -11,
    -10, -13, -9, -1, -2, 0, 0, 3, 11, 16, 20, 20, 16, 14, 14, 18, 18, 18, 14, 14, 16, 20, 20, 16, 11, 3, 0, 0, -2,
    -1, -9, -13, -10, -11, -16, -17, -18, -14, -2, 11, 7, -3, -16, -17, -18, -14, -2, 11, 7, -3,
), np.float32)
"""Degrees by which it looks down, measured alike."""

# vertices of the mesh
MESH_LEFT_CONTOUR: Final = (127, 234, 93, 132, 58, 172, 136, 150, 149, 176, 148, 152)
MESH_RIGHT_CONTOUR: Final = (356, 454, 323, 361, 288, 397, 365, 379, 378, 400, 377, 152)
# arc lengths between them on the neutral face, centimetres: resampling by the lengths of each picture would
# let the points slide over the skin as the head turns, and curve matching needs them to stay
MESH_CONTOUR_STEPS: Final = (1.748, 1.727, 1.870, 2.040, 1.977, 1.859, 1.778, 1.341, 1.288, 1.171, 1.309)
MESH_AFTER_CONTOUR: Final = (
    70, 63, 105, 66, 107,  336, 296, 334, 293, 300,  168, 197, 5, 4,  98, 97, 2, 326, 327,
    33, 160, 158, 133, 153, 144,  362, 385, 387, 263, 373, 380,  53, 52, 65, 55,  285, 295, 282, 283,
    159, 145, 468,  386, 374, 473,  193, 417, 198, 420, 129, 358,  61, 40, 37, 0, 267, 270, 291,
    321, 405, 17, 181, 91,  78, 81, 13, 311, 308,  402, 14, 178,  468, 473,
)
"""The landmarks 33 to 105, each a vertex."""
MESH_OUTER_EYE_CORNERS: Final = (33, 263)
MESH_MIRROR_PAIRS: Final = (
    (33, 263), (133, 362), (234, 454), (127, 356), (93, 323), (58, 288), (172, 397), (103, 332), (61, 291),
)
"""Left and right vertices whose joining lines all run along the head's own x axis."""
MESH_FOREHEAD: Final = _points(10, 151)
MESH_CHIN: Final = _points(152, 175)
# fmt: on
