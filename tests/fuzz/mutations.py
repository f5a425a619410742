"""Changed copies of bytes: what damage and malice do to a file."""

from __future__ import annotations

from collections.abc import Callable
from random import Random

_EXTREMES = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0x8000, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF)


def _flipped(data: bytearray, rng: Random) -> None:
    for _ in range(rng.choice((1, 1, 2, 8, 64))):
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)


def _extreme(data: bytearray, rng: Random) -> None:
    width, at = rng.choice((1, 2, 4, 8)), rng.randrange(len(data))
    order = rng.choice(("big", "little"))
    data[at : at + width] = (rng.choice(_EXTREMES) & (1 << 8 * width) - 1).to_bytes(width, order)


def _cut(data: bytearray, rng: Random) -> None:
    del data[rng.randrange(len(data)) :]


def _removed(data: bytearray, rng: Random) -> None:
    at = rng.randrange(len(data))
    del data[at : at + rng.choice((1, 2, 4, 16, 256))]


def _repeated(data: bytearray, rng: Random) -> None:
    at = rng.randrange(len(data))
    piece = data[at : at + rng.choice((1, 4, 16, 64, 1024))]
    data[at:at] = piece * rng.choice((1, 2, 50))


def _moved(data: bytearray, rng: Random) -> None:
    at, length = rng.randrange(len(data)), rng.choice((4, 16, 64, 512))
    piece = data[at : at + length]
    del data[at : at + length]
    to = rng.randrange(len(data) + 1)
    data[to:to] = piece


_WAYS: tuple[Callable[[bytearray, Random], None], ...] = (
    *(_flipped, _flipped, _extreme, _extreme, _extreme, _cut),
    *(_removed, _repeated, _moved),
)


def mutated(data: bytes, rng: Random) -> bytes:
    """The bytes with one to four changes. Half of them fall into the first 1,024 bytes, where headers are."""
    head, tail = (data[:1024], data[1024:]) if rng.random() < 0.5 else (data, b"")
    changed = bytearray(head)
    for _ in range(rng.choice((1, 1, 2, 4))):
        if changed:
            rng.choice(_WAYS)(changed, rng)
    return bytes(changed) + tail
