"""ICC profiles made for tests."""

from __future__ import annotations

import struct

import numpy as np

P3 = ((0.5151, 0.2920, 0.1571), (0.2412, 0.6922, 0.0666), (-0.0011, 0.0419, 0.7841))
"""XYZ under D50 of Display P3's red, green and blue, rows X, Y, Z."""
SRGB = ((0.4361, 0.3851, 0.1431), (0.2225, 0.7169, 0.0606), (0.0139, 0.0971, 0.7141))
ADOBE = ((0.6097, 0.2053, 0.1492), (0.3111, 0.6257, 0.0632), (0.0195, 0.0609, 0.7446))


def srgb_curve() -> bytes:
    """sRGB's tone curve, parametric of type 3."""
    values = (2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)
    return struct.pack(">4sIHH5i", b"para", 0, 3, 0, *(round(v * 65536) for v in values))


def gamma_curve(gamma: float) -> bytes:
    """A power as a curve of one number."""
    return struct.pack(">4sIIH", b"curv", 0, 1, round(gamma * 256))


def table_curve(gamma: float, count: int = 256) -> bytes:
    """A power as a table."""
    values = np.rint(np.linspace(0, 1, count) ** gamma * 65535).astype(int).tolist()
    return struct.pack(f">4sII{count}H", b"curv", 0, count, *values)


def profile(
    colorants: tuple[tuple[float, ...], ...], curve: bytes, *, kind: bytes = b"RGB ", pcs: bytes = b"XYZ "
) -> bytes:
    """A profile of a matrix (columns are R, G, B) and one tone curve for all three."""
    names = [b"rXYZ", b"gXYZ", b"bXYZ", b"rTRC", b"gTRC", b"bTRC"]
    data = [struct.pack(">4sI3i", b"XYZ ", 0, *(round(row[k] * 65536) for row in colorants)) for k in range(3)]
    data += [curve] * 3
    at = 128 + 4 + 12 * len(names)
    table, body = struct.pack(">I", len(names)), b""
    for name, one in zip(names, data, strict=True):
        padded = one + b"\0" * (-len(one) % 4)
        table += struct.pack(">4sII", name, at + len(body), len(one))
        body += padded
    header = bytearray(128)
    header[:4] = struct.pack(">I", at + len(body))
    header[8:12], header[12:16], header[16:20], header[20:24] = b"\x04\0\0\0", b"mntr", kind, pcs
    header[36:40] = b"acsp"
    return bytes(header) + table + body
