"""Scenes whose truth is known: drawn faces, and a real face on a known path, in known light, behind a known bar."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from pvg.face import Landmarks, layout
from pvg.skin import Matte
from scripts.samples import Samples
from tests.gallery.faces import fit_surest, read_rgb, real_landmarks

TONES = {
    "pale": ((235, 200, 185), (70, 90, 120)),
    "tan": ((190, 140, 105), (40, 60, 50)),
    "dark": ((85, 55, 42), (150, 165, 175)),
    "in blue light": ((120, 115, 190), (60, 70, 60)),
    "grey": ((170, 168, 166), (60, 61, 60)),
}
"""Colours of skin and of the ground behind it."""
_FEATURES = (
    (layout.LEFT_EYE_CONTOUR, 0.3),
    (layout.RIGHT_EYE_CONTOUR, 0.3),
    (layout.LIPS_OUTER, 0.8),
    (layout.LEFT_BROW, 0.35),
    (layout.RIGHT_BROW, 0.35),
)
"""What is darker than skin, and how dark against it."""
_NECK = np.array([[-0.33, -0.5], [0.33, -0.5], [0.33, 0.75], [-0.33, 0.75]])
"""Corners about the chin, in face widths."""


@dataclass(frozen=True, eq=False)
class Scene:
    """A drawn face on a plain ground: rgb (H, W, 3) uint8, its landmarks, and the truth.

    skin: (H, W) bool, with the features inside;  shade: (H, W), its colour over the skin's own.
    """

    rgb: np.ndarray
    landmarks: Landmarks
    skin: np.ndarray
    shade: np.ndarray


def filled(shape: tuple[int, ...], *polygons: np.ndarray) -> np.ndarray:
    """(H, W) bool, true inside any of the polygons (n, 2)."""
    out = np.zeros(shape[:2], np.uint8)
    for polygon in polygons:
        cv2.fillPoly(out, [np.rint(polygon * 16).astype(np.int32)], (1,), shift=4)
    return out > 0


def with_cloth(rgb: np.ndarray, landmarks: Landmarks, color: tuple[int, int, int]) -> np.ndarray:
    """The picture (H, W, 3) with a mask of cloth over nose, mouth and chin."""
    out = rgb.copy()
    out[filled(rgb.shape, landmarks.points[[*range(3, 30), layout.NOSE_TIP]])] = color
    return out


def grown(mask: np.ndarray, side: int) -> np.ndarray:
    """A mask (H, W) grown by squares of `side` pixels."""
    return cv2.dilate(mask.astype(np.uint8), np.ones((side, side), np.uint8)) > 0


def shrunk(mask: np.ndarray, side: int) -> np.ndarray:
    """A mask (H, W) shrunk by squares of `side` pixels."""
    return cv2.erode(mask.astype(np.uint8), np.ones((side, side), np.uint8)) > 0


def drawn_face(
    center: tuple[float, float] = (160, 130),
    width: float = 120,
    tone: str | tuple[tuple[int, ...], tuple[int, ...]] = "tan",
    size: tuple[int, int] = (320, 320),
    gain: float = 1.0,
    seed: int = 0,
) -> Scene:
    """A face with features and a neck, shaded from the side and below the chin, with a sensor's noise.

    tone: one of TONES, or the colours of skin and ground;  gain: of the light;  seed: of the noise.
    """
    face = real_landmarks(width, center)
    chin = face.points[layout.CHIN]
    skin = filled(size, cv2.convexHull(face.stacked)[:, 0], _NECK * width + chin)
    own, ground = (np.array(color, np.float32) for color in (TONES[tone] if isinstance(tone, str) else tone))
    ys, xs = np.mgrid[: size[0], : size[1]]
    shade = 1 - 0.25 * np.clip((xs - center[0]) / width, -1, 1) - 0.15 * np.clip((ys - chin[1]) / width, 0, 1)
    picture = np.where(skin[..., None], own * shade[..., None], ground)
    for feature, dark in _FEATURES:
        picture[filled(size, face.points[feature])] = own * dark
    picture = cv2.GaussianBlur(picture.astype(np.float32), (0, 0), 0.8) * gain
    picture += np.random.default_rng(seed).normal(0, 2, picture.shape)
    return Scene(np.clip(picture, 0, 255).astype(np.uint8), face, skin, shade * gain)


def open_skin(scene: Scene) -> np.ndarray:
    """(H, W) bool: skin well inside a drawn face, away from its features."""
    hulls = [cv2.convexHull(scene.landmarks.points[feature])[:, 0] for feature in layout.FEATURES]
    return shrunk(scene.skin, 13) & ~grown(filled(scene.skin.shape, *hulls), 13)


def mask_of(matte: Matte, shape: tuple[int, ...]) -> np.ndarray:
    """The mask of a matte over a whole picture (H, W, ...)."""
    return matte.mask_at(*_pixels(shape))


def alpha_of(matte: Matte, shape: tuple[int, ...]) -> np.ndarray:
    """A matte over a whole picture (H, W, ...)."""
    return matte.alpha_at(*_pixels(shape))


def _pixels(shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    return np.arange(shape[1], dtype=np.float32), np.arange(shape[0], dtype=np.float32)


# a real face

SIDE, FACE_PX = 360, 150.0
_FACE_AND_NECK = np.array(
    [
        *([106, 84], [111, 78], [118, 66], [124, 50], [127, 35], [131, 22], [137, 12], [146, 6], [160, 3], [175, 3]),
        *([190, 6], [205, 10], [218, 14], [230, 19], [240, 25], [248, 32], [254, 42], [257, 55], [256, 70], [253, 85]),
        *([251, 100], [252, 120], [254, 140], [251, 165], [246, 185], [239, 199], [230, 212], [221, 222], [216, 231]),
        *([215, 239], [206, 250], [193, 257], [180, 257], [168, 256], [160, 253], [150, 246], [140, 238], [130, 229]),
        *([120, 222], [112, 214], [107, 207], [103, 202], [102, 192], [103, 175], [104, 147], [100, 147], [94, 144]),
        *([89, 136], [86, 125], [85, 110], [86, 95], [88, 82], [92, 77], [97, 77], [102, 82]),
    ],
    np.float32,
)
_FAR_EAR = np.array([[266, 132], [268, 140], [264, 152], [259, 166], [253, 176], [252, 168], [256, 154]], np.float32)
"""The resting face's skin, read off an enlarged crop with a grid, drawn back and corrected: pixels of the square."""
BAR_RGB, BAR_PX = (60, 140, 90), 34
Affine = np.ndarray  # (2, 3): where a point of the resting face is in a frame


@dataclass(frozen=True, eq=False)
class Subject:
    """A resting face: rgb (SIDE, SIDE, 3) uint8 and its skin (SIDE, SIDE) bool, drawn by hand."""

    rgb: np.ndarray
    skin: np.ndarray

    @property
    def inner(self) -> np.ndarray:
        """Skin well inside the matte's edge."""
        return shrunk(self.skin, 13)

    @property
    def around(self) -> np.ndarray:
        """Skin and a margin, so that the matte's edge counts."""
        return grown(self.skin, 9)


def resting_face(samples: Samples) -> Subject:
    """The pale portrait, its face FACE_PX wide in the middle of a square."""
    rgb = read_rgb(samples.pale_portrait)
    face = Landmarks.from_mesh(fit_surest(rgb).points)
    contour = face.points[layout.CONTOUR]
    scale = FACE_PX / np.ptp(contour[:, 0])
    center = (contour.min(axis=0) + contour.max(axis=0)) / 2
    place = np.array([[scale, 0, SIDE / 2 - scale * center[0]], [0, scale, 0.45 * SIDE - scale * center[1]]])
    blurred = cv2.GaussianBlur(rgb, (0, 0), max(0.5, 0.4 / scale))
    small = cv2.warpAffine(blurred, place, (SIDE, SIDE), borderMode=cv2.BORDER_REPLICATE)
    return Subject(np.asarray(small, np.uint8), filled((SIDE, SIDE), _FACE_AND_NECK, _FAR_EAR))


def path(k: int) -> Affine:
    """Where the face is in frame `k`: it sways, turns a little and comes nearer."""
    affine = cv2.getRotationMatrix2D((SIDE / 2, SIDE / 2), 4 * np.sin(k / 3), 1 + 0.04 * np.sin(k / 5))
    affine[:, 2] += (2.5 * k - 15, 4 * np.sin(k / 2))
    return np.asarray(affine)


def on_path(picture: np.ndarray, affine: Affine) -> np.ndarray:
    """The resting picture as a frame sees it."""
    return cv2.warpAffine(picture, affine, (SIDE, SIDE), borderMode=cv2.BORDER_REPLICATE)


def at_rest(picture: np.ndarray, affine: Affine) -> np.ndarray:
    """A frame seen from the resting face."""
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return cv2.warpAffine(
        picture.astype(np.float32), affine, (SIDE, SIDE), flags=flags, borderMode=cv2.BORDER_REPLICATE
    )


def in_shade(picture: np.ndarray, seed: int) -> np.ndarray:
    """The picture under a light that falls off to the right, which the face moves through, and a sensor's noise."""
    light = 1.05 - 0.3 * np.arange(SIDE) / SIDE
    noise = np.random.default_rng(seed).normal(0, 1, picture.shape)
    return np.clip(np.rint(picture * light[None, :, None] + noise), 0, 255).astype(np.uint8)


def passing_bar() -> np.ndarray:
    """(frames, SIDE, SIDE) bool: a bar that comes in from the left, passes in front of the face and leaves."""
    left = np.array([-BAR_PX, -BAR_PX, *np.linspace(60, 270, 11), SIDE, SIDE, SIDE])
    columns = np.arange(SIDE)
    bars = (columns >= left[:, None]) & (columns < left[:, None] + BAR_PX)
    return np.repeat(bars[:, None, :], SIDE, axis=1)


def behind_bar(picture: np.ndarray, bar: np.ndarray, seed: int) -> np.ndarray:
    """The picture with the bar before it, and a sensor's noise."""
    noise = np.random.default_rng(seed).normal(0, 1, picture.shape)
    drawn = np.where(bar[..., None], np.array(BAR_RGB), picture) + noise
    return np.clip(np.rint(drawn), 0, 255).astype(np.uint8)


def with_forehead(scene: Scene, taller: float) -> tuple[np.ndarray, np.ndarray]:
    """Picture and skin of a drawn face with the forehead so many times as high, its landmarks where they were."""
    brow = float(scene.landmarks.points[layout.LEFT_BROW, 1].min())
    ys, xs = np.mgrid[: scene.rgb.shape[0], : scene.rgb.shape[1]].astype(np.float32)
    to = np.where(ys < brow, brow - (brow - ys) / np.float32(taller), ys).astype(np.float32)
    rgb = cv2.remap(scene.rgb, xs, to, cv2.INTER_LINEAR)
    return rgb, cv2.remap(scene.skin.astype(np.uint8), xs, to, cv2.INTER_NEAREST) > 0
