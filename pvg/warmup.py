"""Compile the numba kernels into their cache, so that the first clip does not wait for it: `python -m pvg.warmup`."""

from __future__ import annotations

import multiprocessing
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pvg._arrays import Bytes, Floats
from pvg.curves import boundary_radius
from pvg.face import FaceAxes, Landmarks, layout
from pvg.harmonic import fit_boundary_colors
from pvg.membrane import Lattice, Membrane, build_membrane, cut_edges
from pvg.rendering import warm_up as warm_up_rendering
from pvg.skin import warm_up as warm_up_skin
from pvg.video import RGB24, Frame, PixelFormat, named_space, picture_of

_SIZE = 64


def warm_up() -> None:
    """Run the skin tracker, the least-squares fit, the membrane solver and the renderer once on a small disc."""
    membrane, colors = _solve()
    _follow_and_show()
    warm_up_rendering(_frames(), membrane, colors)


def compile_kernels() -> None:
    """`warm_up`, where nothing is compiled yet: that of rendering, half of all, is compiled by another process."""
    beside = multiprocessing.get_context("spawn").Process(target=_render)
    beside.start()
    try:
        _solve()
        _follow_and_show()
    finally:
        beside.join()
    warm_up()  # what one of them could not do is done here, or raises


def _solve() -> tuple[Membrane, Floats]:
    """A membrane over the picture, and the colours at its curve."""
    turn = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    circle = np.stack([32 + 20 * np.cos(turn), 32 + 20 * np.sin(turn)], axis=1).astype(np.float32)
    y, x = np.mgrid[:_SIZE, :_SIZE]
    domain = np.hypot(x - 32, y - 32) < 22
    fit = fit_boundary_colors(_image(), domain, circle, h_min=2.0, rng=np.random.default_rng(0))
    cuts = cut_edges(circle, ((0, len(circle), True),), _lattice())
    membrane = build_membrane(cuts).solve(fit.colors)
    membrane.crop(8, 8, 32, 32)
    return membrane, fit.colors


def _render() -> None:
    """Render with a membrane that was not solved."""
    lattice = _lattice()
    planes = np.ones((3, lattice.height, lattice.width), np.float32)
    warm_up_rendering(_frames(), Membrane(lattice, planes), np.full((48, 3), 128, np.float32))


def _follow_and_show() -> None:
    frames = _frames()
    for frame in frames[:-1]:
        _follow(frame)
    _show(frames)


def _lattice() -> Lattice:
    return Lattice.over((0, 0, _SIZE, _SIZE))


def _image() -> Bytes:
    y, x = np.mgrid[:_SIZE, :_SIZE]
    return np.stack([x, y, x + y], axis=-1).astype(np.uint8)


def _frames() -> list[Frame]:
    """Of a clip in 8 bits, of one in 10, and a still."""
    image = _image()
    red, green, blue = (np.ascontiguousarray(image[..., channel]) for channel in range(3))
    return [*(_frame(image, depth) for depth in (8, 10)), Frame(0, 0, 0.0, RGB24, (red, green, blue))]


def _frame(rgb: Bytes, depth: int) -> Frame:
    """A frame of so many bits."""
    pixel_format = PixelFormat("yuv420p", depth, (1, 1), (0.299, 0.114), False)
    first, second, third = pixel_format.from_rgb(rgb)
    for plane in (first, second, third):
        plane.flags.writeable = False  # as the decoder's are: kernels are compiled for that
    # rows of the decoder's planes are longer than the picture's
    return Frame(0, 0, 0.0, pixel_format, (first[:, :60], second[:, :30], third[:, :30]))


def _show(frames: Sequence[Frame]) -> None:
    """Look at frames as if they were in another colour space, as portraits with profiles and HDR clips are."""
    for frame in frames:
        wide = replace(frame.format, color=named_space("hlg"))
        wide.fast_rgb(frame.planes)
        codes = np.zeros((8, 8), frame.planes[0].dtype)
        wide.shown(codes, codes, codes)
        wide.shown(*[codes.astype(np.float32)] * 3)


def _follow(frame: Frame) -> None:
    """Follow the skin of a made-up face, in the whole picture and in a part of it."""
    turn = np.linspace(0, 2 * np.pi, 106, endpoint=False)
    points = np.stack([32 + 14 * np.sin(turn), 34 - 16 * np.cos(turn)], axis=1).astype(np.float32)
    points[layout.UPPER_BROW_EDGES, 1], points[layout.LEFT_EYE_CONTOUR] = 28, (26, 31)
    points[layout.RIGHT_EYE_CONTOUR], points[layout.LIPS_OUTER] = (38, 31), (32, 42)
    face = Landmarks(points, points[np.arange(layout.SKIN_COUNT) * layout.LANDMARK_COUNT // layout.SKIN_COUNT])
    whole = picture_of(frame)
    for picture in (whole, whole.part((0, 0, 60, 60))):
        picture.thumbnail((16, 9))
        picture.warp(np.eye(2, 3), (16, 16))
        matte = warm_up_skin(picture, face)
    boundary_radius(matte.alpha.astype(np.float32), FaceAxes.of(matte.raster.to_cells(points)))


if __name__ == "__main__":
    compile_kernels()
    print("kernels are compiled")
