"""Uploads: in one request, or in pieces (tus 1.0, tus.io) so that what has arrived is not sent again."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal, get_args

from pvg_client import tus
from pvg_client.calls import Api, FilePart, Flow, Params, answered, body_of, of_metadata, once, worked
from pvg_client.errors import DamagedError
from pvg_client.files import about_file, sha256_of
from pvg_client.media import medium
from pvg_client.models import Medium, Role, Upload, said

#: from this size on a file goes in pieces when nothing else is said
RESUMABLE_BYTES: Final = 32 * 1024**2
#: seconds: more than the service takes for a file that it fetches before it answers
_LONGEST_FETCH_S: Final = 3700.0


@dataclass(frozen=True, slots=True)
class _Asked:
    """What an upload is to become."""

    role: Role
    settings: dict[str, str]
    metadata: Mapping[str, str]
    webhook: str | None


def upload(
    api: Api,
    file: str | os.PathLike[str] | None = None,
    *,
    url: str | None = None,
    role: Role = "video",
    metadata: Mapping[str, str] | None = None,
    webhook: str | None = None,
    mask: Literal["landmarks", "ycbcr"] | None = None,
    matching: Literal["table", "chain"] | None = None,
    input_color: str | None = None,
    resume: bool | Upload | None = None,
    idempotency_key: str | None = None,
) -> Flow[Medium]:
    """Send a file, or let the service fetch it from ``url``; the medium, which is vectorised and may be used at once.

    What arrives is checked against the file's sha256. With ``resume``, which is the default from 32 MiB on, it goes in
    pieces: a broken connection costs one of them, and calling this again for the same file, also in another process,
    goes on where the last one ended. With one of `uploads` as ``resume`` that one goes on, for what was said when it
    was begun: nothing but the file is given beside it. A URL is at a public address; it has been fetched when the call
    comes back. ``webhook`` is the address that is told when the file is vectorised, or has failed.

    Raises `ApiError` (`url-not-allowed` and `fetch-failed` of URLs), `UnreachableError`, `OSError` when the file
    cannot be read, `ValueError` when it is given neither a file nor a URL, or both, for another role, or for a file
    that is not of the size of the upload that is to go on. A file that changes while it is sent is an `ApiError`, one
    that becomes shorter a `DamagedError`; what is written behind its end meanwhile is not sent. In pieces both are a
    `DamagedError`: where the service has made a medium of them it names that, and calling this again sends the file as
    it is then, if with another ``idempotency_key``.
    """
    settings = said({"mask": mask, "matching": matching, "input_color": input_color})
    given = _Asked(role, settings, metadata or {}, webhook)
    if (file is None) == (url is None):
        raise ValueError("give a file, or a url")
    if role not in get_args(Role):
        raise ValueError(f"there is no role {role!r}: a file is a video or a reference")
    if isinstance(resume, Upload):
        if file is None or settings or metadata or webhook is not None or idempotency_key is not None:
            raise ValueError("what an upload is for was said when it was begun: give the file alone")
        return (yield from _on_with(api, Path(file), resume))
    if file is None:
        return (yield from _from_url(api, url, given, idempotency_key))
    path = Path(file)
    size_bytes = path.stat().st_size
    sha256 = yield from worked(lambda: sha256_of(path))
    if resume if resume is not None else size_bytes >= RESUMABLE_BYTES:
        return (yield from _in_pieces(api, path, size_bytes, sha256, given, idempotency_key))
    return (yield from _at_once(api, path, size_bytes, sha256, given, idempotency_key))


def _from_url(api: Api, url: str | None, given: _Asked, key: str | None) -> Flow[Medium]:
    told = {} if given.webhook is None else {"webhook": {"url": given.webhook}}
    body = {"url": url, **given.settings, "metadata": dict(given.metadata), **told}
    request = api.request("POST", f"/{given.role}s/url", body=body, headers=once(key), least_timeout_s=_LONGEST_FETCH_S)
    return body_of((yield from answered(api, request)), Medium.of)


def _at_once(api: Api, path: Path, size_bytes: int, sha256: str, given: _Asked, key: str | None) -> Flow[Medium]:
    params: Params = [
        *given.settings.items(),
        *of_metadata(given.metadata),
        *([] if given.webhook is None else [("webhook", given.webhook)]),
    ]
    headers = about_file(path, size_bytes, sha256) | once(key)
    stream = FilePart(path, size_bytes)
    request = api.request("POST", f"/{given.role}s", params=params, headers=headers, stream=stream)
    response = yield from answered(api, request)
    return body_of(response, Medium.of)


def _in_pieces(api: Api, path: Path, size_bytes: int, sha256: str, given: _Asked, key: str | None) -> Flow[Medium]:
    about = {"filename": path.name, "role": given.role} | given.settings
    about |= {f"metadata.{name}": value for name, value in given.metadata.items()}
    about |= {} if given.webhook is None else {"webhook": given.webhook}
    return (yield from _checked(api, path, sha256, (yield from tus.send(api, path, size_bytes, sha256, about, key))))


def _on_with(api: Api, path: Path, begun: Upload) -> Flow[Medium]:
    size_bytes = path.stat().st_size
    if begun.size_bytes != size_bytes:
        raise ValueError(f"{path} has {size_bytes} bytes: {begun.id} is of a file of {begun.size_bytes}")
    sha256 = yield from worked(lambda: sha256_of(path))
    return (yield from _checked(api, path, sha256, (yield from tus.go_on(api, path, size_bytes, begun.id))))


def _checked(api: Api, path: Path, sha256: str, medium_id: str) -> Flow[Medium]:
    """The medium that was made of a file. Raises `DamagedError` when it is of another one."""
    made = yield from medium(api, medium_id)
    if made.sha256 != sha256:
        raise DamagedError(f"{path} has changed while it was sent: {made.id} is not that file")
    return made
