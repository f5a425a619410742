"""Still pictures in and out."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import av
import av.codec
import av.error
import av.packet
import av.video.codeccontext
import av.video.frame
import cv2
import numpy as np
from numpy.typing import NDArray

from pvg.errors import MediaError, TooLargeError
from pvg.video.color import ColorSpace, color_space, named_space
from pvg.video.formats import RGB24, RGB48, SCALER_THREADS, Frame
from pvg.video.icc import profile_space
from pvg.video.jpeg import jpeg_size
from pvg.video.metadata_record import PictureMetadata, TooManyPartsError
from pvg.video.opening import MediaLimits
from pvg.video.picture_metadata import embedded, metadata_of, rgb_profile
from pvg.video.png import grey_key, png_size
from pvg.video.sniffing import check_pixels, sniff
from pvg.video.tiff import tiff_file, tiff_header, upright_bytes
from pvg.video.webp import webp_size

_WRITE_OPTIONS = {
    ".png": [cv2.IMWRITE_PNG_COMPRESSION, 4],
    ".jpg": [cv2.IMWRITE_JPEG_QUALITY, 95],
    ".jpeg": [cv2.IMWRITE_JPEG_QUALITY, 95],
    ".webp": [cv2.IMWRITE_WEBP_QUALITY, 95],
    ".tif": [],
    ".tiff": [],
}
IMAGE_SUFFIXES = tuple(_WRITE_OPTIONS)
_DEEP = (".png", ".tif", ".tiff")
_NO_ALPHA = (".jpg", ".jpeg")
_OVERHEAD_BYTES = 64 * 2**20  # profiles, previews and text beside the samples


def read_image(path: str | Path, limits: MediaLimits | None = None, input_color: str = "auto") -> Frame:
    """Read a JPEG, PNG, TIFF or still WebP picture as one Frame of R, G, B planes: uint8, or uint16 where the file has
    16 bits a sample.

    EXIF orientation is applied. Alpha is kept in `Frame.alpha`, straight (a TIFF's premultiplied colours are divided by
    it). An embedded profile is not applied but read into `Frame.format.color`, one that cannot be read stands for sRGB;
    input_color: one of `color.INPUT_COLORS`, "auto" for the profile.
    The size is checked in the header, before decoding. Raises MediaError.
    """
    path = Path(path)
    limits = limits or MediaLimits()
    kind = sniff(path)
    size, most = path.stat().st_size, _OVERHEAD_BYTES + 8 * limits.max_pixels
    if size > most:
        message = f"{path.name} has {size} bytes, more than a picture within the limits needs"
        raise TooLargeError(message, most, "bytes")
    try:
        data = path.read_bytes()
    except OSError as error:
        raise MediaError(f"{path.name} cannot be read: {error.strerror}") from error
    width, height = image_size(path.name, kind, data)
    check_pixels(path.name, width, height, limits.max_pixels)
    try:
        samples = _tiff_samples(path.name, data) if kind == "tiff" else _decoded(kind, data)
    except (cv2.error, av.error.FFmpegError, ValueError) as error:
        raise MediaError(f"{path.name} is damaged: the {kind} picture cannot be decoded") from error
    if samples is None or samples.shape[:2] != (height, width) or samples.dtype not in (np.uint8, np.uint16):
        raise MediaError(f"{path.name} is damaged: the {kind} picture cannot be decoded")
    metadata = metadata_of(path.name, kind, data)
    samples = _upright(samples, metadata.orientation)
    planes: list[Any] = [np.ascontiguousarray(samples[..., k]) for k in range(samples.shape[2])]
    alpha = planes.pop() if len(planes) in (2, 4) else None
    red, green, blue = planes if len(planes) == 3 else planes * 3
    color = color_of_picture(metadata)[0] if input_color == "auto" else named_space(input_color)
    pixel_format = replace(RGB24 if red.dtype == np.uint8 else RGB48, color=color)
    return Frame(0, 0, 0.0, pixel_format, (red, green, blue), alpha=alpha)


def color_of_picture(metadata: PictureMetadata) -> tuple[ColorSpace | None, str | None]:
    """What R, G, B of a picture stand for by its profile, None for sRGB; and why a profile is not read.

    PNG's cICP comes before a profile (PNG, third edition, 11.3.2.6).
    """
    coded = dict(metadata.png).get(b"cICP", b"")
    try:
        if len(coded) == 4:
            return color_space(coded[0], coded[1]), None
        return (None if metadata.icc is None else profile_space(metadata.icc)), None
    except (ValueError, MediaError) as error:
        return None, f"{error}; the picture is read as sRGB"


def _decoded(kind: str, data: bytes) -> NDArray[Any] | None:
    """(H, W, 1 to 4) samples as stored, colours in the order red, green, blue."""
    flags = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION if kind == "jpeg" else cv2.IMREAD_UNCHANGED
    decoded: NDArray[Any] | None = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), flags)
    if decoded is None:
        return None
    if decoded.ndim == 2:
        key = grey_key(data) if kind == "png" else None
        if key is None:
            return decoded[..., None]
        return np.stack([decoded, (decoded != key) * np.iinfo(decoded.dtype).max], axis=-1).astype(decoded.dtype)
    order = {3: cv2.COLOR_BGR2RGB, 4: cv2.COLOR_BGRA2RGBA}.get(decoded.shape[2])
    return decoded if order is None else np.asarray(cv2.cvtColor(decoded, order))


def _tiff_samples(name: str, data: bytes) -> NDArray[Any] | None:
    """(H, W, C) uint8 or uint16 of a TIFF file, C as stored, alpha not premultiplied; None when it is damaged."""
    header = tiff_header(name, data)
    if not header.plain:
        decoded = _decoded("tiff", upright_bytes(data, header))
        turned = header.negative and header.depth == 16  # OpenCV turns negatives of 8 bits alone
        return 65535 - decoded if turned and decoded is not None else decoded
    # OpenCV's way multiplies 8-bit colours by their alpha; libav's gives all samples as they stand
    context = av.codec.CodecContext.create("tiff", "r")
    assert isinstance(context, av.video.codeccontext.VideoCodecContext)  # noqa: S101 - narrows the binding's union
    pictures = [*context.decode(av.packet.Packet(data)), *context.decode(None)]
    if not pictures or (pictures[0].width, pictures[0].height) != (header.width, header.height):
        return None
    samples = _packed_samples(pictures[0], header.depth)
    return _straight(samples) if header.alpha == "premultiplied" else samples


def _packed_samples(picture: av.video.frame.VideoFrame, depth: int) -> NDArray[Any]:
    """(H, W, C) of a decoded picture: grey, grey and alpha, RGB or RGBA by its components;  depth: 8 or 16 bits."""
    names = ("gray", "ya8", "rgb24", "rgba") if depth == 8 else ("gray16le", "ya16le", "rgb48le", "rgba64le")
    name = names[len(picture.format.components) - 1]
    picture = picture if picture.format.name == name else picture.reformat(format=name, threads=SCALER_THREADS)
    plane, count = picture.planes[0], len(picture.format.components)
    rows = np.frombuffer(memoryview(plane), np.uint8).reshape(-1, plane.line_size)[: picture.height]
    width = picture.width * count * depth // 8
    return np.ascontiguousarray(rows[:, :width]).view("u1" if depth == 8 else "<u2").reshape(picture.height, -1, count)


def _straight(samples: NDArray[Any]) -> NDArray[Any]:
    """Samples (H, W, C) whose colours are divided by their alpha, the last channel; fully transparent ones stay."""
    top = np.iinfo(samples.dtype).max
    alpha = samples[..., -1:].astype(np.uint64)
    colors = (samples[..., :-1].astype(np.uint64) * top + alpha // 2) // np.maximum(alpha, 1)
    divided = np.where(alpha > 0, np.minimum(colors, top), samples[..., :-1]).astype(samples.dtype)
    return np.concatenate([divided, samples[..., -1:]], axis=-1)


def _upright(samples: NDArray[Any], orientation: int) -> NDArray[Any]:
    """Samples (H, W, …) turned by TIFF's orientation (TIFF 6.0, tag 274; 1 is upright)."""
    turned = samples.swapaxes(0, 1) if orientation >= 5 else samples
    rows, columns = (orientation in (3, 4, 7, 8), orientation in (2, 3, 6, 7))
    return turned[:: -1 if rows else 1, :: -1 if columns else 1]


def write_image(
    path: str | Path,
    rgb: NDArray[Any],
    *,
    alpha: NDArray[Any] | None = None,
    metadata: PictureMetadata | None = None,
) -> None:
    """Write a picture as .png, .tif, .tiff, .jpg or .webp (quality 95), by the name's suffix.

    rgb: (H, W, 3) uint8, 0 to 255, or uint16, 0 to 65535: PNG and TIFF keep 16 bits, the others get the nearest 8.
    alpha: (H, W) of the same type, straight; JPEG leaves it out. metadata: its profile and EXIF are put in.
    Raises ValueError for another suffix or array, OSError where the file cannot be written.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in _WRITE_OPTIONS:
        raise ValueError(f"{path.name}: a picture is written as {', '.join(sorted(_WRITE_OPTIONS))}")
    if rgb.ndim != 3 or rgb.shape[2] != 3 or not rgb.size or rgb.dtype not in (np.uint8, np.uint16):
        raise ValueError(f"a picture is (H, W, 3) uint8 or uint16, not {rgb.shape} {rgb.dtype}")
    if alpha is not None and (alpha.shape != rgb.shape[:2] or alpha.dtype != rgb.dtype):
        raise ValueError(f"alpha is {alpha.shape} {alpha.dtype}, the picture is {rgb.shape[:2]} {rgb.dtype}")
    samples: NDArray[Any] = rgb
    if alpha is not None and suffix not in _NO_ALPHA:
        samples = np.concatenate([rgb, alpha[..., None]], axis=-1)
    if suffix not in _DEEP and samples.dtype == np.uint16:
        samples = ((samples.astype(np.uint32) + 128) // 257).astype(np.uint8)
    path.write_bytes(_encoded(path, samples, metadata or PictureMetadata()))


def _encoded(path: Path, samples: NDArray[Any], metadata: PictureMetadata) -> bytes:
    suffix, (height, width, channels) = path.suffix.lower(), samples.shape
    if suffix in (".tif", ".tiff"):
        return tiff_file(samples, rgb_profile(metadata.icc), metadata.exif)
    order = cv2.COLOR_RGB2BGR if channels == 3 else cv2.COLOR_RGBA2BGRA
    try:
        done, encoded = cv2.imencode(suffix, cv2.cvtColor(samples, order), _WRITE_OPTIONS[suffix])
    except cv2.error:
        done = False
    if not done:
        raise ValueError(f"{path.name}: the picture of {width}x{height} cannot be encoded")
    return embedded(suffix, encoded.tobytes(), metadata, (width, height))


def image_size(name: str, kind: str, data: bytes) -> tuple[int, int]:
    """(width, height) as stored, from the headers; MediaError when the file is cut short or has no size."""
    readers: dict[str, Any] = {"jpeg": jpeg_size, "png": png_size, "webp": webp_size}
    if kind == "tiff":
        header = tiff_header(name, data)
        return header.width, header.height
    if kind not in readers:
        raise MediaError(f"{name} is a clip, not a picture")
    try:
        size = readers[kind](data)
    except TooManyPartsError as error:
        raise MediaError(f"{name} has more than {error}; save it again") from None
    except (struct.error, IndexError):
        size = None
    if size is None or min(size) < 1:
        raise MediaError(f"{name} is damaged or cut short: the {kind} picture is not complete; upload it again")
    return int(size[0]), int(size[1])
