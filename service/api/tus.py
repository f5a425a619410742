"""The header fields of tus 1.0, a protocol for resumable uploads (https://tus.io/protocols/resumable-upload)."""

from __future__ import annotations

import base64
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from service.errors import BadRequestError, PreconditionError, UnsupportedMediaError

VERSION: Final = "1.0.0"
EXTENSIONS: Final = "creation,termination,expiration,checksum"
#: SHA-1 because the protocol asks for it; it finds what was damaged, not what was forged
ALGORITHMS: Final = ("sha256", "sha1")
CONTENT_TYPE: Final = "application/offset+octet-stream"

#: characters of Upload-Metadata
MAX_METADATA: Final = 8192  # all that `metadata` may be in ASCII takes less
_NUMBER: Final = re.compile(r"[0-9]{1,18}")
_PAIR: Final = re.compile(r"([\x21-\x2b\x2d-\x7e]+)(?: ([A-Za-z0-9+/]*={0,2}))?")


@dataclass(frozen=True)
class Checksum:
    """What a piece should be."""

    algorithm: str
    digest: bytes


def check_version(headers: Mapping[str, str]) -> None:
    """Raise `PreconditionError` for a request that is not of this version."""
    if headers.get("tus-resumable") != VERSION:
        raise PreconditionError(f"send Tus-Resumable: {VERSION}", headers={"Tus-Version": VERSION})


def check_whole(headers: Mapping[str, str]) -> None:
    """Raise `BadRequestError` for one of several uploads that shall be joined: alone it would become a medium."""
    if "upload-concat" in headers:
        raise BadRequestError("Upload-Concat is not supported: send the file as one upload, its pieces one by one")


def number(headers: Mapping[str, str], name: str) -> int:
    """The number in a header field. Raises `BadRequestError` when there is none."""
    text = headers.get(name)
    if text is None:
        raise BadRequestError(f"send {name}, a number of bytes")
    if not _NUMBER.fullmatch(text):
        raise BadRequestError(f"{name} is not a number of bytes")
    return int(text)


def announced(headers: Mapping[str, str]) -> int:
    """The size of a file. Raises `BadRequestError` when there is none, or it is to be said later all the same."""
    size_bytes = number(headers, "Upload-Length")
    if "upload-defer-length" in headers:
        raise BadRequestError("send Upload-Length alone: with Upload-Defer-Length the length is not known yet")
    return size_bytes


def check_content_type(headers: Mapping[str, str]) -> None:
    """Raise `UnsupportedMediaError` for a body that is no piece of a file."""
    if headers.get("content-type", "").partition(";")[0].strip().lower() != CONTENT_TYPE:
        raise UnsupportedMediaError(f"send the bytes as {CONTENT_TYPE}")


def checksum(headers: Mapping[str, str]) -> Checksum | None:
    """The checksum of the body, or None. Raises `BadRequestError` for one that cannot be checked."""
    given = headers.get("upload-checksum")
    if given is None:
        return None
    algorithm, _, encoded = given.strip().partition(" ")
    if algorithm not in ALGORITHMS:
        raise BadRequestError(f"Upload-Checksum: use one of {', '.join(ALGORITHMS)}")
    try:
        return Checksum(algorithm, base64.b64decode(encoded, validate=True))
    except ValueError as error:  # also for what is not ASCII, which is no `binascii.Error`
        raise BadRequestError("Upload-Checksum is not an algorithm and a digest in base64") from error


def metadata(text: str) -> dict[str, str]:
    """What Upload-Metadata says. Raises `BadRequestError` for what is malformed, too long, or said twice."""
    if len(text) > MAX_METADATA:
        raise BadRequestError(f"Upload-Metadata is longer than {MAX_METADATA} characters")
    found: dict[str, str] = {}
    for pair in text.split(",") if text.strip() else ():
        parts = _PAIR.fullmatch(pair.strip(" "))
        try:
            if parts is None or parts[1] in found:
                raise ValueError
            found[parts[1]] = base64.b64decode(parts[2] or "", validate=True).decode()
        except ValueError as error:
            raise BadRequestError(
                "Upload-Metadata is not a list of different names, each with a value in base64"
            ) from error
    return found
