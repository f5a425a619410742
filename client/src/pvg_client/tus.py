"""An upload in pieces by tus 1.0 (tus.io/protocols/resumable-upload), which goes on where it was broken off."""

from __future__ import annotations

import base64
import hashlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import httpx

from pvg_client.calls import Api, Flow, Patience, answered, attempt, body_of, headed, once, understood, worked
from pvg_client.errors import ApiError, DamagedError, UnreachableError
from pvg_client.files import in_base64
from pvg_client.paths import path_to

#: bytes of one piece: what a broken connection costs at most
PIECE_BYTES: Final = 8 * 1024**2
#: where connections do not last for a piece, the next is half as long; the shortest is this part of the longest
_SHORTEST: Final = 128
#: seconds in which the service joins, reads and records the whole file
_LONGEST_JOIN_S: Final = 600.0
_HEADERS: Final = {"Tus-Resumable": "1.0.0"}
#: what an upload is asked with for its state; a browser gets a page
_STATE: Final = {"Accept": "application/json"}
#: a piece whose checksum is wrong, by the checksum extension
_CHECKSUM_MISMATCH: Final = 460
_GONE: Final = frozenset({403, 404, 410})
#: what no further piece changes: the upload is gone, too large, or no medium
_HOPELESS: Final = _GONE | {413, 415, 422}


class _Note:
    """Where an upload that is under way is kept in mind between runs: its address, and nothing of the file."""

    def __init__(self, api: Api, sha256: str, about: Mapping[str, str], key: str | None) -> None:
        named = [] if key is None else [key]
        what = json.dumps([str(api.base_url), api.key, sha256, dict(about), *named], sort_keys=True)
        self._name = hashlib.sha256(what.encode()).hexdigest()

    @property
    def _path(self) -> Path:
        try:
            cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
        except RuntimeError as error:
            raise FileNotFoundError("this user has no home") from error
        return cache / "pvg-client" / "uploads" / self._name

    def read(self) -> str | None:
        try:
            return self._path.read_text(encoding="utf-8") or None
        except OSError:
            return None

    def write(self, url: str) -> None:
        try:
            self._path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            self._path.touch(mode=0o600)
            self._path.write_text(url, encoding="utf-8")
        except OSError:
            return  # no home to write in: this run alone can go on

    def drop(self) -> None:
        try:
            self._path.unlink(missing_ok=True)
        except OSError:
            return


def send(
    api: Api, path: Path, size_bytes: int, sha256: str, about: Mapping[str, str], key: str | None = None
) -> Flow[str]:
    """Upload a file with what is said ``about`` it; the id of the medium that it became.

    With ``key``, an Idempotency-Key, it is begun once; another file with the same one is an `ApiError`.

    Raises `DamagedError` when a piece arrives damaged each time, `ApiError`, `UnreachableError`.
    """
    note = _Note(api, sha256, about, key)
    if key is not None:
        # by a name that the service passes over, files of one size differ for it before they have arrived
        about = {**about, "relativePath": sha256}
    url, offset = yield from _begun(api, note, size_bytes, about, key)
    return (yield from _sent(api, path, size_bytes, url, offset, note))


def go_on(api: Api, path: Path, size_bytes: int, upload_id: str) -> Flow[str]:
    """Send what is missing of a file whose upload was begun before; the id of the medium that it became.

    Raises as `send`, and `ApiError` 404 when it is over.
    """
    url = api.at(path_to("uploads", upload_id))
    return (yield from _sent(api, path, size_bytes, url, (yield from _offset(api, url))))


def _sent(api: Api, path: Path, size_bytes: int, url: httpx.URL, offset: int, note: _Note | None = None) -> Flow[str]:
    """The file from the offset on."""
    patience, length = Patience(api), PIECE_BYTES
    while offset < size_bytes:
        end = min(offset + length, size_bytes)  # of a file that is still written, what was hashed
        piece = yield from worked(lambda at=offset, end=end: _read(path, at, end))  # type: ignore[misc]
        if not piece:
            raise DamagedError(f"{path} has become shorter while it was sent")
        try:
            offset = yield from _patch(api, url, offset, piece, is_last=offset + len(piece) == size_bytes)
            patience.renew()
            length = min(2 * length, PIECE_BYTES)
        except (ApiError, UnreachableError) as error:
            if isinstance(error, ApiError) and error.status in _HOPELESS:
                _drop(note)  # the next call begins anew
            if isinstance(error, UnreachableError):
                length = max(length // 2, PIECE_BYTES // _SHORTEST)
            yield from _before_another(patience, error)
            offset = yield from _offset(api, url)
    response = yield from answered(api, api.request("GET", url, headers=_STATE))
    medium_id = body_of(response, lambda body: body.get("media"))
    _drop(note)
    if medium_id is None:
        raise UnreachableError(f"all of {path} has arrived, and the service made nothing of it", worth_another=False)
    return str(medium_id)


def _drop(note: _Note | None) -> None:
    if note is not None:
        note.drop()


def _begun(
    api: Api, note: _Note, size_bytes: int, about: Mapping[str, str], key: str | None
) -> Flow[tuple[httpx.URL, int]]:
    """The address of the upload, an old one or a new one, and how much of it is there."""
    known = note.read()
    if known is not None:
        try:
            url = api.named(known)
            return url, (yield from _offset(api, url))
        except ApiError as error:
            if error.status not in _GONE:
                raise
            note.drop()
    # of an empty value there is the name alone: a header ends in no space
    said = ",".join(
        f"{name} {base64.b64encode(value.encode(errors='replace')).decode()}".rstrip() for name, value in about.items()
    )
    headers = _HEADERS | {"Upload-Length": str(size_bytes), "Upload-Metadata": said} | once(key)
    response = yield from answered(api, api.request("POST", "/uploads", headers=headers))
    location, url = understood(response.url, lambda headers: _place(api, headers), response.headers)
    note.write(location)
    begun_before = "idempotent-replayed" in response.headers
    return url, (yield from _offset(api, url)) if begun_before else 0


def _offset(api: Api, url: httpx.URL) -> Flow[int]:
    headers = yield from headed(api, url, headers=_HEADERS, to_get=_STATE)
    return understood(url, _arrived, headers)


def _place(api: Api, headers: httpx.Headers) -> tuple[str, httpx.URL]:
    return headers["location"], api.named(headers["location"])


def _arrived(headers: httpx.Headers) -> int:
    count = int(headers["upload-offset"])
    if count < 0:
        raise ValueError("it is less than nothing")
    return count


def _patch(api: Api, url: httpx.URL, offset: int, piece: bytes, *, is_last: bool) -> Flow[int]:
    headers = _HEADERS | {
        "Content-Type": "application/offset+octet-stream",
        "Upload-Offset": str(offset),
        "Upload-Checksum": f"sha256 {in_base64(hashlib.sha256(piece).hexdigest())}",
    }
    # after the last one the service puts all of them together before it answers
    least_s = _LONGEST_JOIN_S if is_last else 0.0
    request = api.request("PATCH", url, headers=headers, content=piece, least_timeout_s=least_s)
    response = yield from attempt(request)
    return understood(url, _arrived, response.headers)


def _before_another(patience: Patience, error: ApiError | UnreachableError) -> Flow[None]:
    """Wait; at another offset than the service's, and for a damaged piece, as after a broken connection."""
    if isinstance(error, ApiError) and error.status in {httpx.codes.CONFLICT, _CHECKSUM_MISMATCH}:
        error = UnreachableError(str(error))
    yield from patience.after(error)


def _read(path: Path, start: int, end: int) -> bytes:
    with path.open("rb") as file:
        file.seek(start)
        return file.read(end - start)
