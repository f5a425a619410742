"""Languages of tracks as MOV has them: QuickTime's own numbers, which libav knows by names of its own."""

from __future__ import annotations

import re

_LISTED = (
    "alb amh ara arm asm aym aze baq bel ben bul bur cat ces chi dan dut dzo eng epo est fin fra geo ger gre grn "
    "guj heb hin hun ice ind ita jav jpn kan kas kaz khm kin kir kor kur lao lat lav lit mac mal mar may mlg mlt "
    "mol mon nep nor nya ori orm per pol por pus que ron run rus san sin slk slv smi snd som spa swa tam tat tel "
    "tgk tgl tha tib tir tuk tur uig ukr urd uzb vie wel yid"
)
"""ISO 639-2 codes that libav writes as they are."""
_SAME = {
    **{"sqi": "alb", "hye": "arm", "eus": "baq", "mya": "bur", "cze": "ces", "zho": "chi", "nld": "dut", "fre": "fra"},
    **{"kat": "geo", "deu": "ger", "ell": "gre", "isl": "ice", "mkd": "mac", "msa": "may", "fas": "per", "rum": "ron"},
    **{"slo": "slk", "bod": "tib", "cym": "wel"},
}
"""The other code of the same language in ISO 639-2."""
_MISNAMED = {"fao": "fo ", "gle": "iri", "hrv": "hr ", "pan": "pa ", "srp": "sr ", "swe": "sve"}
"""What libav calls some, by their code."""


def language_in(container: str, language: str | None) -> str | None:
    """A track's language as the container's muxer takes it, None for none and where it has no place for it."""
    if language is None:
        return None
    if container == "mov":
        return mov_language(language)
    return language if container != "mp4" or re.fullmatch(r"[a-z]{3}", language) else None


def mov_language(language: str) -> str | None:
    """What libav's muxer is told for a language of ISO 639-2; None for one that MOV has no number for."""
    if language in _LISTED.split():
        return language
    return _SAME.get(language) or _MISNAMED.get(language)


def stated_language(name: str) -> str:
    """The code of ISO 639-2 for what libav's demuxer calls a language."""
    return next((language for language, misnamed in _MISNAMED.items() if misnamed == name), name)
