"""Arrays as entries of an asset: small, exact to the stated steps, and never executed."""

from __future__ import annotations

import io
import json
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

FORMAT_VERSION = 3
CHUNK_FRAMES = 32
_POINT_SCALE = 32  # positions are stored in 1/32 px
_RADIUS_SCALE = 8
_MATTE_LEVELS = 63  # 64 levels of opacity: one step of a correction of 70 levels is roughly one level

FRAME_ARRAYS = ("points", "skin_points", "radius", "score", "pose", "box", "matte", "body")
MATTES = ("matte", "body")
_DTYPES = ("<f4", "<i4", "<i2", "|u1", "|b1")
#: the head of a .npy array of two axes of bytes, as numpy writes it
_NPY = re.compile(
    rb"\x93NUMPY\x01\x00..\{'descr': '\|u1', 'fortran_order': (True|False), "
    rb"'shape': \((\d{1,15}), (\d{1,15})\), \} *\n",
    re.DOTALL,
)
_FIXED_POINT = {"points": _POINT_SCALE, "skin_points": _POINT_SCALE, "radius": _RADIUS_SCALE, "box": _RADIUS_SCALE}
_TO_LEVELS = np.rint(np.arange(256) * (_MATTE_LEVELS / 255.0)).astype(np.uint8)
_FROM_LEVELS = np.rint(np.minimum(np.arange(256), _MATTE_LEVELS) * (255.0 / _MATTE_LEVELS)).astype(np.uint8)


def encode(name: str, values: NDArray[Any]) -> NDArray[Any]:
    """A chunk (n, …) of one of FRAME_ARRAYS as it is stored: fixed-point steps from frame to frame, matte levels."""
    if name in MATTES:
        return np.asarray(_TO_LEVELS.take(values))
    if name not in _FIXED_POINT:
        return values
    fixed = np.rint(values * _FIXED_POINT[name]).astype(np.int32)
    return np.diff(fixed, axis=0, prepend=np.zeros_like(fixed[:1]))


def decode(name: str, values: NDArray[Any]) -> NDArray[Any]:
    """The array (rows, …) that `encode` was given, to the stored precision.  name: of `FRAME_ARRAYS`."""
    if name in MATTES:
        return np.asarray(_FROM_LEVELS.take(values))
    if name not in _FIXED_POINT:
        return values
    return (np.cumsum(values, axis=0, dtype=np.int64) / _FIXED_POINT[name]).astype(np.float32)


def to_bytes(array: NDArray[Any]) -> bytes:
    """An array as an entry: a line of JSON with its type and shape, then its bytes as a .npy array.

    The bytes are grouped by significance: steps are small, so their high bytes deflate to nothing.
    """
    header = {"dtype": array.dtype.str, "shape": array.shape}
    planes = np.ascontiguousarray(array).view(np.uint8).reshape(-1, array.itemsize).T
    buffer = io.BytesIO(json.dumps(header).encode() + b"\n")
    buffer.seek(0, io.SEEK_END)
    np.save(buffer, np.ascontiguousarray(planes), allow_pickle=False)
    return buffer.getvalue()


def from_bytes(data: bytes) -> NDArray[Any]:
    """The array of an entry. Raises ValueError, TypeError, KeyError or EOFError when it is none.

    It takes no more memory than the data, whatever that says of itself.
    """
    head, _, body = data.partition(b"\n")
    header = json.loads(head)
    if not isinstance(header, dict) or header["dtype"] not in _DTYPES:
        raise ValueError("it has no type of an asset")
    # numpy reads the array's own header as Python, and raises whatever Python's parser does
    described = _NPY.match(body)
    if described is None:
        raise ValueError("its bytes are no array")
    rows, columns = int(described[2]), int(described[3])
    flat = np.frombuffer(body, np.uint8, offset=described.end())
    if rows * columns != flat.size:
        raise ValueError("its bytes are not those it says")
    planes = flat.reshape((rows, columns), order="F" if described[1] == b"True" else "C")
    if any(type(side) is not int or side < 0 for side in header["shape"]):
        raise ValueError("it has no shape")
    array: NDArray[Any] = np.ascontiguousarray(planes.T).view(np.dtype(header["dtype"])).reshape(header["shape"])
    return array
