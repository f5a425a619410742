"""How a sound track goes into a container: copied, as PCM of the same samples, or encoded at what rate and layout."""

from __future__ import annotations

from pvg.video.containers import CONTAINER_FORMATS, label_of
from pvg.video.streams import Track

_EXACT = {"s16": "pcm_s16le", "s32": "pcm_s32le", "flt": "pcm_f32le", "dbl": "pcm_f64le", "u8": "pcm_u8"}
_LOSSLESS = {"flac", "alac", "truehd", "mlp", "wavpack", "tta", "ape", "tak"}
_USUAL_LAYOUTS = {1: "mono", 2: "stereo", 3: "2.1", 4: "quad", 5: "5.0", 6: "5.1", 7: "6.1", 8: "7.1"}
_OPUS_RATE, _OPUS_LAYOUTS = 48000, _USUAL_LAYOUTS | {3: "3.0"}
_AAC_RATES = (96000, 88200, 64000, 48000, 44100, 32000, 24000, 22050, 16000, 12000, 11025, 8000, 7350)
_AAC_LAYOUTS = {
    *("mono", "stereo", "2.1", "3.0", "3.0(back)", "3.1", "4.0", "4.1", "quad", "quad(side)", "5.0", "5.0(side)"),
    *("5.1", "5.1(side)", "6.0", "6.0(front)", "hexagonal", "6.1", "6.1(back)", "6.1(front)", "7.0", "7.0(front)"),
    *("7.1", "7.1(wide)", "7.1(wide-side)", "octagonal", "hexadecagonal"),
}
"""Rates and layouts that libav's encoders open with, and by the number of channels those that Opus has."""
_WITH_LFE = {"2.1", "3.1", "4.1"}


def carry_sound(track: Track, container: str) -> tuple[str | None, str | None]:
    """(what it becomes or "itself", the encoder or None); (None, None) when it cannot go along."""
    # PCM says in MOV alone which channel is which; elsewhere they come in the order of their layout
    ordered = not track.order or container == "mov" or not track.codec.startswith("pcm_")
    if ordered and track.codec.removeprefix("lib") in CONTAINER_FORMATS[container].sounds:
        return "itself", None
    if track.codec == "unknown" or container == "y4m":
        return None, None
    exact = _EXACT.get((track.sample or "").removesuffix("p"))
    lossless = track.codec.startswith("pcm_") or track.codec in _LOSSLESS
    if CONTAINER_FORMATS[container].takes_pcm and exact is not None and (lossless or container == "nut"):
        if not ordered:
            return f"PCM of the same samples, its channels in the order that {label_of(container)} has them in", exact
        return f"PCM of the same samples, which {label_of(container)} holds", exact
    encoder, name = ("libopus", "Opus") if container == "webm" else ("aac", "AAC")
    rate, layout = sound_shape(track, encoder)
    shape = f" of {rate} Hz (the clip's is of {track.rate})" if track.rate not in (0, rate) else ""
    place = track.layout.partition("(")[0]
    if place not in ("", layout.partition("(")[0]) and " channels" not in track.layout:
        shape += f" in {layout} (the clip's is {track.layout})"
    return f"{name}{shape}: {label_of(container)} does not hold {track.codec}", encoder


def sound_shape(track: Track, encoder: str) -> tuple[int, str]:
    """The rate and the channel layout, by libav's name, that an encoder takes a sound track in: its own if it can.

    A layout that only counts its channels is taken for the usual one of that many. More than eight channels that the
    encoder has no layout for are mixed to 7.1.
    """
    rate, layout = track.rate or _OPUS_RATE, track.layout
    if layout.endswith(" channels") or not layout:
        layout = _USUAL_LAYOUTS.get(track.channels, layout or "stereo")
    if encoder == "libopus":
        fewest = 6 if layout in _WITH_LFE else 1  # Opus has none of fewer with a channel for the lowest sound
        return _OPUS_RATE, _OPUS_LAYOUTS[min(8, max(fewest, track.channels))]
    if encoder == "aac":
        layout = layout if layout in _AAC_LAYOUTS else _USUAL_LAYOUTS[min(8, max(1, track.channels))]
        return min(_AAC_RATES, key=lambda one: abs(one - rate)), layout
    return rate, layout
