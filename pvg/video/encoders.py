"""Encoders: which one a clip gets, the format nearest to the clip's that it takes, and its options."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Integral
from typing import Literal

import av.codec

from pvg._processors import are_more_seen, processors
from pvg.video.containers import CONTAINER_FORMATS, PIPED, label_of, short_name
from pvg.video.formats import PixelFormat
from pvg.video.mastering import ContentLight, MasteringDisplay

Codec = Literal["auto", "h264", "hevc", "vp9", "av1", "prores", "prores4444", "dnxhr", "ffv1", "raw"]
FieldOrder = Literal["tff", "bff"]
"""Which field of an interlaced picture is the earlier: the top one (rows 0, 2, …) or the bottom one."""

_VP9, _AV1 = tuple(map(str, range(9))), tuple(map(str, range(14)))  # cpu-used, SVT-AV1's presets
_NAMES = ("veryslow", "slower", "slow", "medium", "fast", "faster", "veryfast", "superfast", "ultrafast")


@dataclass(frozen=True)
class Encoder:
    """What is to be known of one codec.

    library: libav's name of the encoder. label: the codec's name in messages. formats: those taken of the encoder's,
    all when empty. crf, crf_most: its quality scale, default and end; None without one. preset: its default effort;
    None without such a scale; efforts: those beside x264's names. fields: codes the two fields of interlaced pictures.
    alpha: has a plane of it that common tools read. mastering: writes HDR10's mastering display and content light
    level. limited: studio range only. whole: keeps odd sizes. least: (width, height) below which it refuses.
    """

    library: str
    label: str
    formats: tuple[str, ...] = ()
    crf: int | None = None
    crf_most: int = 51
    preset: str | None = None
    efforts: tuple[str, ...] = ()
    fields: bool = False
    alpha: bool = False
    mastering: bool = False
    limited: bool = False
    whole: bool = False
    least: tuple[int, int] = (1, 1)


ENCODERS = {
    "h264": Encoder("libx264", "H.264", crf=18, preset="veryfast", efforts=("placebo",), fields=True, mastering=True),
    "hevc": Encoder("libx265", "HEVC", crf=20, preset="veryfast", efforts=("placebo",), mastering=True),
    "vp9": Encoder("libvpx-vp9", "VP9", crf=28, crf_most=63, preset="6", efforts=_VP9, whole=True),
    "av1": Encoder("libsvtav1", "AV1", crf=26, crf_most=63, preset="8", efforts=_AV1, mastering=True, whole=True),
    "prores": Encoder("prores_ks", "ProRes 422 HQ", ("yuv422p10le",), fields=True, limited=True),
    "prores4444": Encoder(
        "prores_ks", "ProRes 4444", ("yuv444p10le", "yuva444p10le"), fields=True, alpha=True, limited=True
    ),
    "dnxhr": Encoder("dnxhd", "DNxHR", ("yuv422p", "yuv422p10le", "yuv444p10le"), limited=True, least=(256, 120)),
    "ffv1": Encoder("ffv1", "FFV1", fields=True, alpha=True, whole=True),
    "raw": Encoder("rawvideo", "uncompressed video", fields=True, alpha=True, whole=True),
}
_BY_PREFERENCE = {
    False: ("h264", "hevc", "vp9", "av1", "raw"),
    True: ("hevc", "av1", "vp9", "h264", "raw"),
}

_NAMED_EFFORT = {  # x264's names on the scales of the two that count
    "vp9": {name: str(k) for k, name in enumerate(_NAMES)},
    "av1": {name: str(k + 2) for k, name in enumerate(_NAMES)},
}
_DNXHR_PROFILES = {"yuv422p": "dnxhr_hq", "yuv422p10le": "dnxhr_hqx", "yuv444p10le": "dnxhr_444"}
_RAW_DEPTHS = ("", "10le", "12le")


def choose_codec(codec: str, container: str, depth: int, *, interlaced: bool = False) -> str:
    """The codec "auto" stands for, or the codec itself.

    container: of `CONTAINER_FORMATS`. auto: h264 for 8 bits and hevc above (WebM: vp9, av1 above; pipes:
    raw), or what comes next where PyAV was built without that encoder, as x264 and x265 often are left out for their
    licence; of interlaced clips those that keep fields alone. Raises ValueError for a codec that is unknown, unfit
    for the container, without fields for an interlaced clip, or has no encoder here.
    """
    held = CONTAINER_FORMATS[container].codecs
    if codec == "auto":
        wanted = [name for name in _BY_PREFERENCE[depth > 8] if name in held]
        wanted += ["ffv1"] * (container == "nut")
        fit = [name for name in wanted if not interlaced or _keeps_fields(name, container)]
        if not fit:
            raise ValueError(
                f"the clip is interlaced and {label_of(container)} holds no codec with fields; write .mp4, .mov or .mkv"
            )
        there = next((name for name in fit if _has_encoder(name)), None)
        if there is None:
            raise ValueError(f"this PyAV has no encoder for {container}: none of {_encoders_of(fit)}")
        return there
    if codec not in ENCODERS:
        raise ValueError(f"codec {codec!r} is not one of auto, {', '.join(ENCODERS)}")
    if codec not in held:
        others = [name for name, one in CONTAINER_FORMATS.items() if codec in one.codecs]
        raise ValueError(f"{label_of(container)} holds {_listed(held)}, not {codec}; write {_written_as(others)}")
    if not _has_encoder(codec):
        raise ValueError(f"this PyAV has no {ENCODERS[codec].library} for {codec}; leave the codec to auto")
    if interlaced and not _keeps_fields(codec, container):
        with_fields = [name for name in held if _keeps_fields(name, container)]
        raise ValueError(
            f"the clip is interlaced and {ENCODERS[codec].label} has no fields here; write it as "
            f"{_listed(with_fields) if with_fields else 'H.264 in .mp4, .mov or .mkv'}"
        )
    return codec


def _keeps_fields(codec: str, container: str) -> bool:
    return ENCODERS[codec].fields and (codec, container) != ("raw", "nut")  # which says nothing of fields


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} or {names[-1]}"


def _written_as(containers: Sequence[str]) -> str:
    return _listed([f"--container {name}" if name in PIPED else f".{short_name(name)}" for name in containers])


def _has_encoder(codec: str) -> bool:
    try:
        av.codec.Codec(ENCODERS[codec].library, "w")
    except ValueError:  # PyAV's UnknownCodecError
        return False
    return True


def _encoders_of(codecs: Sequence[str]) -> str:
    return ", ".join(ENCODERS[codec].library for codec in codecs)


def _formats(codec: str) -> set[str]:
    encoder = ENCODERS[codec]
    if codec == "raw":
        yuv = {f"yuv{digits}p{depth}" for digits in ("420", "422", "444") for depth in _RAW_DEPTHS}
        return yuv | {name.replace("yuv", "yuva") for name in yuv} | {"gbrp", "gbrp10le", "gbrp12le"}
    if encoder.formats:
        return set(encoder.formats)
    return {item.name for item in av.codec.Codec(encoder.library, "w").video_formats or ()}


def encoder_format(source: PixelFormat, codec: str) -> PixelFormat:
    """The format nearest to `source` that the encoder of `codec` takes: the same depth before the same chroma.

    FFV1 and NUT's uncompressed pictures keep R, G, B; everywhere else these become BT.709. A codec of the studio range
    alone gets that.
    """
    formats, encoder = _formats(codec), ENCODERS[codec]
    weights, full = source.luma_weights, source.full_range
    if weights is None:
        if layout_of(source, codec) in formats:
            return source
        weights, full = (0.2126, 0.0722), False
    full = full and not encoder.limited
    if codec == "dnxhr" and source.chroma_log2 == (0, 0):  # its only 4:4:4 has 10 bits
        return PixelFormat("yuv444p10le", 10, (0, 0), weights, full)
    depths = sorted((8, 10, 12), key=lambda depth: (depth != source.depth, -depth if depth < source.depth else depth))
    chromas = sorted(
        (((1, 1), "420"), ((1, 0), "422"), ((0, 0), "444")),
        key=lambda item: (item[0] != source.chroma_log2, sum(item[0]) > sum(source.chroma_log2), -sum(item[0])),
    )
    for depth in depths:
        for chroma, digits in chromas:
            name = f"yuv{digits}p" + ("" if depth == 8 else f"{depth}le")
            if name in formats:
                return PixelFormat(name, depth, chroma, weights, full)
    raise ValueError(f"the {codec} encoder takes no planar Y'CbCr")


def layout_of(target: PixelFormat, codec: str, *, alpha: bool = False) -> str:
    """libav's name of what the encoder of `codec` is given for a format, with a plane of alpha or without."""
    name = planar_layout(target, alpha=alpha)
    if codec == "ffv1":  # it packs R, G, B of 8 bits
        return {"gbrp": "bgr0", "gbrap": "bgra"}.get(name, name)
    return name


def planar_layout(pixel_format: PixelFormat, *, alpha: bool = False) -> str:
    """libav's name of the planes of a format, with a plane of alpha or without."""
    name = "gbrp" if pixel_format.name == "rgb24" else pixel_format.name
    return name.replace("yuv", "yuva").replace("gbrp", "gbrap") if alpha else name


def holds_alpha(target: PixelFormat, codec: str, container: str) -> bool:
    """Whether pictures of this format keep their alpha."""
    if container == "y4m" or not ENCODERS[codec].alpha:
        return False
    return codec == "raw" or layout_of(target, codec, alpha=True) in _formats(codec)


def encoded_size(width: int, height: int, target: PixelFormat, codec: str, *, interlaced: bool) -> tuple[int, int]:
    """(width, height) of what is encoded: the last columns or rows go where the codec has no place for them."""
    if ENCODERS[codec].whole:
        return width, height
    x, y = target.chroma_log2
    y += interlaced and codec == "h264"  # its fields have whole blocks of chroma
    return width >> x << x, height >> y << y


def check_scales(codec: str, crf: int | None, preset: str | None) -> None:
    """Raise ValueError for a quality or an effort that the encoder of `codec` does not have; "auto": that none has."""
    if codec not in ("auto", *ENCODERS):
        raise ValueError(f"codec {codec!r} is not one of auto, {', '.join(ENCODERS)}")
    named = [ENCODERS[codec]] if codec in ENCODERS else list(ENCODERS.values())
    encoders = [encoder for encoder in named if encoder.crf is not None and encoder.preset is not None]
    for name, given in (("crf", crf), ("preset", preset)):
        if given is not None and not encoders:
            raise ValueError(f"{named[0].label} has no {name}: leave it out")
    of = f" of {named[0].label}" if len(named) == 1 else ""
    if crf is not None:
        most = max((encoder.crf_most for encoder in encoders), default=0)
        if isinstance(crf, bool) or not isinstance(crf, Integral) or not 0 <= crf <= most:
            raise ValueError(f"crf{of} is a whole number from 0 to {most}, not {crf!r}")
    if preset is not None:
        others = [word for encoder in encoders for word in encoder.efforts]
        if not isinstance(preset, str) or preset not in (*_NAMES, *others):
            numbers = f" or {others[0]} to {others[-1]}" if of and others[0].isdecimal() else ""
            raise ValueError(f"preset{of} is one of {', '.join(_NAMES)}{numbers}, not {preset!r}")


def encoder_options(codec: str, crf: int | None, preset: str | None) -> dict[str, str]:
    """Options of the libav encoder; crf 0 is lossless for h264 (8 bit), hevc and vp9. See `format_options`."""
    check_scales(codec, crf, preset)
    encoder = ENCODERS[codec]
    quality = encoder.crf if crf is None else crf
    effort = encoder.preset if preset is None else _NAMED_EFFORT.get(codec, {}).get(preset, preset)
    if quality is None or effort is None:
        return {"level": "3", "g": "1", "slicecrc": "1"} if codec == "ffv1" else {}
    if codec == "h264":
        return {"crf": str(quality), "preset": effort}
    if codec == "hevc":
        lossless = ":lossless=1" if quality == 0 else ""
        return {"crf": str(quality), "preset": effort, "x265-params": f"log-level=none{lossless}"}
    if codec == "av1":
        os.environ.setdefault("SVT_LOG", "1")  # the library's only switch: errors, not a page of settings
        return {"crf": str(quality), "preset": effort}
    options = {"crf": str(quality), "b": "0", "deadline": "realtime", "cpu-used": effort, "row-mt": "1"}
    return options | ({"lossless": "1"} if quality == 0 else {})


def format_options(
    codec: str,
    target: PixelFormat,
    size: tuple[int, int],
    *,
    alpha: bool = False,
    fields: FieldOrder | None = None,
    mastering: MasteringDisplay | None = None,
    light: ContentLight | None = None,
) -> dict[str, str]:
    """Further options, by what the pictures are; a key of `encoder_options` is to be joined to it by a colon.

    size: (width, height) of the pictures.
    """
    if codec == "ffv1":
        # slices begin between samples of chroma: of odd sizes libav finds a number that does, and refuses others
        odd = any(side % (1 << shift) for side, shift in zip(size, target.chroma_log2, strict=True))
        return {} if odd else {"slices": "4"}
    if codec == "prores":
        return {"profile": "hq", "vendor": "apl0"}
    if codec == "prores4444":
        return {"profile": "4444", "vendor": "apl0", "alpha_bits": "16" if alpha else "0"}
    if codec == "dnxhr":
        return {"profile": _DNXHR_PROFILES[target.name]}
    parts: list[str] = []
    if codec == "h264" and fields is not None:
        parts.append(f"{fields}=1")
    if mastering is not None and codec in ("h264", "hevc", "av1"):
        key = "master-display" if codec == "hevc" else "mastering-display"
        parts.append(f"{key}={mastering.decimal() if codec == 'av1' else mastering.integral()}")
    if light is not None and codec in ("h264", "hevc", "av1"):
        key = {"h264": "cll", "hevc": "max-cll", "av1": "content-light"}[codec]
        parts.append(f"{key}={light.max_content},{light.max_average}")
    key = {"h264": "x264-params", "hevc": "x265-params", "av1": "svtav1-params"}.get(codec, "")
    return {key: ":".join(parts)} if parts else {}


def encoder_threads(codec: str, threads: int) -> tuple[int, dict[str, str]]:
    """libav's number of threads for an encoder that may have ``threads``, 0 for as many as suit the machine, and
    further options; to be joined to the others.

    Encoders count the machine's processors, and take memory by them. Where this process may use fewer they are told a
    number, which x265 and SVT-AV1 do not take from libav.
    """
    told = are_more_seen()
    if threads == 0 and told:
        threads = processors()
    if codec == "hevc" and (told or threads > 1):
        at_once = 3 if threads >= 8 else 2 if threads >= 4 else 1  # frames, by x265's own rule
        return at_once, {"x265-params": f"pools={threads}"}
    if codec == "av1" and (told or threads > 1):
        level = sum(threads >= least for least in (1, 2, 4, 6))  # SVT-AV1's own, again
        return threads, {"svtav1-params": f"lp={level}"}
    return threads, {}


def part_options(codec: str) -> dict[str, str]:
    """What makes an encoder of one thread give the same bytes each time; to be joined to the others."""
    if codec == "h264" and _has_avx512():
        # [measured: with AVX-512, of 100 encodes 288 pixels wide six differ: its macroblock tree reads unset memory]
        return {"x264-params": "asm=AVX2"}
    if codec == "hevc":  # its threads are the machine's; wavefronts and the processor are written into the stream
        return {"x265-params": "pools=none:wpp=0:frame-threads=1:info=0"}
    return {"svtav1-params": "lp=1"} if codec == "av1" else {}


def _has_avx512() -> bool:
    import llvmlite.binding  # noqa: PLC0415 - it takes long, and numba has loaded it where pictures are drawn

    try:
        return bool(llvmlite.binding.get_host_cpu_features().get("avx512f"))
    except RuntimeError:  # LLVM does not know this processor
        return False


def joined(first: dict[str, str], second: dict[str, str]) -> dict[str, str]:
    """Both sets of options, those of one key joined by a colon."""
    return first | {key: f"{first[key]}:{value}" if key in first else value for key, value in second.items()}
