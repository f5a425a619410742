"""TIFF 6.0 pictures: what the header says, checked before a decoder sees the file, and pictures written."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from pvg.errors import MediaError
from pvg.video.exif import ORIENTATION, placed_in
from pvg.video.ifd import HEADER, Block, Directory, Entry, longs, numbers_of, opaque, shorts, written

_SUBFILE, _WIDTH, _HEIGHT, _BITS, _COMPRESSION, _PHOTOMETRIC = 254, 256, 257, 258, 259, 262
_STRIPS, _SAMPLES, _ROWS, _STRIP_BYTES, _PLANAR, _PREDICTOR = 273, 277, 278, 279, 284, 317
_TILE_SIZE, _LEAST_TILE = (322, 323), 1 << 20
_TILES, _TILE_BYTES, _EXTRA, _FORMAT, ICC_TAG, _DNG = 324, 325, 338, 339, 34675, 50706
_WHITE_IS_ZERO, _GREY, _RGB, _PALETTE, _YCBCR = 0, 1, 2, 3, 6  # what samples stand for (PhotometricInterpretation)
_DEFLATE, _HORIZONTAL, _STRIP_SIZE = 8, 2, 1 << 20
_PLAIN_PACKINGS, _JPEG_PACKINGS = (1, 5, 8, 32773, 32946), (6, 7)  # none, LZW, Deflate, PackBits, Deflate's old code
_MOST_PAGES = 64


@dataclass(frozen=True)
class TiffHeader:
    """What the first directory says: size as stored, bits a sample (8 or 16), and how transparency is kept.

    alpha: "none", "straight" (unassociated) or "premultiplied" (associated, ExtraSamples 1). plain: grey or RGB in
    strips, packed without loss, with or without alpha; RGB also with a plane for each of its samples. negative: grey
    whose zero is white. orientation_at: where the value of the orientation tag lies in the file, or None.
    """

    width: int
    height: int
    depth: int
    alpha: str
    plain: bool
    negative: bool
    orientation_at: int | None


def tiff_header(name: str, data: bytes) -> TiffHeader:
    """The header of a TIFF file. Raises MediaError in one line for what is not read: several pages, raw pictures of
    cameras, other depths than 8 and 16 bits, CMYK and Lab, tiles of absurd size, and files that are cut short."""
    try:
        return _header(name, data)
    except ValueError as error:
        raise MediaError(f"{name} is damaged or cut short: {error}; upload it again") from error


def _header(name: str, data: bytes) -> TiffHeader:
    """See `tiff_header`. Raises ValueError too, for tags that cannot be read."""
    block = Block(data)
    directory, following = block.directory(block.first)
    _check_pages(name, block, following)
    orientation_at = block.place_of(block.first, ORIENTATION)
    if numbers_of(directory, _SUBFILE, (0,))[0] & 1 or _DNG in directory or data[8:10] == b"CR":
        raise MediaError(f"{name} is a camera's raw picture or a preview; develop it and save it as 16-bit TIFF or PNG")
    width, height = _size(name, directory)
    depth, samples = _samples(name, directory)
    photometric = numbers_of(directory, _PHOTOMETRIC, (1,))[0]
    if photometric not in (_WHITE_IS_ZERO, _GREY, _RGB, _PALETTE, _YCBCR):
        raise MediaError(f"{name} is a TIFF in CMYK, Lab or another way of colour; save it as RGB")
    _check_whole(name, directory, len(data))
    alpha = _alpha(name, directory, samples, 3 if photometric in (_RGB, _YCBCR) else 1)
    packed = numbers_of(directory, _COMPRESSION, (1,))[0]
    if packed not in (*_PLAIN_PACKINGS, *_JPEG_PACKINGS):
        raise MediaError(f"{name} is a TIFF packed in a way that is not read ({packed}); save it with LZW or Deflate")
    planes = numbers_of(directory, _PLANAR, (1,))[0] != 1
    strips = _TILES not in directory and (photometric == _RGB or not planes)
    plain = photometric in (_GREY, _RGB) and strips and packed in _PLAIN_PACKINGS
    if alpha != "none" and not plain:
        raise MediaError(f"{name} is a TIFF with alpha in tiles, planes or a palette; save it as plain RGB with alpha")
    if planes and samples > 1 and depth == 16 and not plain:  # OpenCV gives whatever lay in its memory
        raise MediaError(f"{name} is a TIFF of 16 bits in tiles and planes; save it with its samples interleaved")
    return TiffHeader(width, height, depth, alpha, plain, photometric == _WHITE_IS_ZERO, orientation_at)


def _size(name: str, directory: Directory) -> tuple[int, int]:
    """(width, height) of the picture as stored. Raises MediaError where it or its tiles cannot be."""
    width, height = (numbers_of(directory, tag, (0,))[0] for tag in (_WIDTH, _HEIGHT))
    if min(width, height) < 1:
        raise MediaError(f"{name} is damaged: the tiff picture has no size; upload it again")
    if (tile := _tile_pixels(directory)) > max(4 * width * height, _LEAST_TILE):
        raise MediaError(f"{name} is damaged: a tile of the tiff picture has {tile} pixels; upload it again")
    return width, height


def _check_whole(name: str, directory: Directory, size: int) -> None:
    """Raise MediaError where strips or tiles lie past the end of a file of `size` bytes."""
    for places, counts in ((_STRIPS, _STRIP_BYTES), (_TILES, _TILE_BYTES)):
        parts = zip(numbers_of(directory, places), numbers_of(directory, counts), strict=False)
        if any(start + length > size for start, length in parts):
            raise MediaError(f"{name} is cut short: samples of the tiff picture lie past its end; upload it whole")


def _alpha(name: str, directory: Directory, samples: int, colors: int) -> str:
    """How transparency is kept, see `TiffHeader`, of a picture of so many samples and colours a pixel."""
    if samples not in (colors, colors + 1):
        raise MediaError(f"{name} is a TIFF of {samples} samples a pixel; save it as RGB, with or without alpha")
    if samples == colors:
        return "none"
    return "premultiplied" if numbers_of(directory, _EXTRA, (0,))[0] == 1 else "straight"


def _tile_pixels(directory: Directory) -> int:
    """Pixels that a decoder makes room for at once, 0 without tiles."""
    across, down = (numbers_of(directory, tag, (0,))[0] for tag in _TILE_SIZE)
    return across * down


def _check_pages(name: str, block: Block, following: int) -> None:
    for _ in range(_MOST_PAGES):
        if not following:
            return
        page, following = block.directory(following)
        if not numbers_of(page, _SUBFILE, (0,))[0] & 1:  # smaller copies of the first page may follow
            break
    raise MediaError(f"{name} is a TIFF of several pages; save the one that is meant as a file of its own")


def _samples(name: str, directory: Directory) -> tuple[int, int]:
    """Bits a sample, 8 or 16, and samples a pixel. Raises MediaError for samples that are not read."""
    bits, samples = numbers_of(directory, _BITS, (1,)), numbers_of(directory, _SAMPLES, (1,))[0]
    formats = set(numbers_of(directory, _FORMAT, (1,)))
    if set(bits) not in ({8}, {16}) or formats != {1}:
        kind = (
            "floating-point or signed" if formats != {1} else " and ".join(str(b) for b in sorted(set(bits))) + "-bit"
        )
        raise MediaError(f"{name} is a TIFF of {kind} samples; save it with 8 or 16 bits a sample")
    return bits[0], samples


def upright_bytes(data: bytes, header: TiffHeader) -> bytes:
    """The file with orientation 1, for decoders that would turn the picture on their own."""
    if header.orientation_at is None:
        return data
    order = "<H" if data[:2] == b"II" else ">H"
    changed = bytearray(data)
    struct.pack_into(order, changed, header.orientation_at, 1)
    return bytes(changed)


def tiff_file(samples: NDArray[Any], icc: bytes | None, exif: bytes | None) -> bytes:
    """A TIFF 6.0 file of (H, W, 3) RGB or (H, W, 4) RGB and straight alpha, uint8 or uint16.

    Lossless: Deflate with horizontal differences (TIFF Technical Note 2 and section 14), in strips of about 1 MB.
    icc: the profile, in tag 34675 (ICC.1, annex B.4). exif: a block of `Exif.block`, whose tags join the file's.
    Raises ValueError above the 4 GB that the format can address.
    """
    height, width, channels = samples.shape
    rows = max(1, _STRIP_SIZE // (width * channels * samples.itemsize))
    strips = [_packed(samples[top : top + rows]) for top in range(0, height, rows)]
    start = 8 + sum(len(strip) + len(strip) % 2 for strip in strips)
    if start > 2**32 - 2**26:
        raise ValueError(f"a picture of {width}x{height} is too large for TIFF; write .png")
    places, at, body = [], 8, []
    for strip in strips:
        places.append(at)
        body.append(strip + b"\0" * (len(strip) % 2))
        at += len(body[-1])
    directory: dict[int, Entry] = {
        _WIDTH: longs([width]),
        _HEIGHT: longs([height]),
        _BITS: shorts(*[8 * samples.itemsize] * channels),
        _COMPRESSION: shorts(_DEFLATE),
        _PHOTOMETRIC: shorts(2),
        _STRIPS: longs(places),
        ORIENTATION: shorts(1),
        _SAMPLES: shorts(channels),
        _ROWS: longs([rows]),
        _STRIP_BYTES: longs(len(strip) for strip in strips),
        _PLANAR: shorts(1),
        _PREDICTOR: shorts(_HORIZONTAL),
    }
    if channels == 4:
        directory[_EXTRA] = shorts(2)
    if icc is not None:
        directory[ICC_TAG] = opaque(icc)
    everything, children = placed_in(directory, exif)
    return HEADER + struct.pack("<I", start) + b"".join(body) + written(everything, children, start)


def _packed(rows: NDArray[Any]) -> bytes:
    steps = rows.copy()
    steps[:, 1:] -= rows[:, :-1]  # modulo 2^depth, as the predictor asks
    return zlib.compress(steps.astype(steps.dtype.newbyteorder("<")).tobytes(), 5)
