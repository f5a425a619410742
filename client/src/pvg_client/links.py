"""Links by which somebody without a key uploads one file."""

from __future__ import annotations

import os
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import Any, Final, Literal

import httpx

from pvg_client.calls import Api, FilePart, Flow, Patience, answered, asked, attempt, body_of, once, worked
from pvg_client.errors import ApiError, UnreachableError
from pvg_client.files import about_file, sha256_of
from pvg_client.models import Body, Role, Upload, UploadLink, said
from pvg_client.pages import Listing
from pvg_client.paths import path_to

#: seconds in which the service hashes, reads and records the whole file
_LONGEST_RECORD_S: Final = 600.0


def upload_link(
    api: Api,
    *,
    role: Role = "video",
    max_bytes: int | None = None,
    expires_in_s: int | None = None,
    metadata: Mapping[str, str] | None = None,
    webhook: str | None = None,
    mask: Literal["landmarks", "ycbcr"] | None = None,
    matching: Literal["table", "chain"] | None = None,
    input_color: str | None = None,
    idempotency_key: str | None = None,
) -> Flow[UploadLink]:
    """An address by which somebody else may upload one file, for what is said here, without a key.

    It is good for an hour, or ``expires_in_s``, up to 7 days. A browser sends the file with PUT, or as the field `file`
    of a form, `send_upload` does the former; who made the link alone sees what becomes of it.
    """
    given: dict[str, Any] = {
        "role": role,
        "max_bytes": max_bytes,
        "expires_in_s": expires_in_s,
        "metadata": None if metadata is None else dict(metadata),
        "webhook": None if webhook is None else {"url": webhook},
        "mask": mask,
        "matching": matching,
        "input_color": input_color,
    }

    def read(made: Body) -> UploadLink:
        url, expires_at = str(api.named(made["url"])), datetime.fromisoformat(made["expires_at"])
        return UploadLink(made["id"], url, expires_at, made.get("max_bytes"))

    return (yield from asked(api, read, "POST", "/uploads/link", body=said(given), headers=once(idempotency_key)))


def send_upload(api: Api, link: UploadLink | str, file: str | os.PathLike[str]) -> Flow[Upload]:
    """Send the file that a link is for; how much of it is there then. No key is needed.

    Where the service has keys, `media` of the answer is None: who made the link sees it, by `upload_state`.

    The same file may be sent again. Raises `ApiError` (403 and 410 when the link may not be used, or not any more; 409
    when it was used with another file; 413; 415), `UnreachableError`, `DamagedError` when the file becomes shorter
    meanwhile, `OSError` when it cannot be read.
    """
    path, url = Path(file), _address(api, link)
    sha256 = yield from worked(lambda: sha256_of(path))
    size_bytes = path.stat().st_size
    headers = about_file(path, size_bytes, sha256)
    patience = Patience(api)
    while True:
        stream = FilePart(path, size_bytes)
        request = api.request("PUT", url, headers=headers, stream=stream, least_timeout_s=_LONGEST_RECORD_S)
        try:
            return body_of((yield from attempt(request)), Upload.of)
        except (UnreachableError, ApiError) as error:
            yield from patience.after(error)  # of a file that has arrived before, the answer is the same


def upload_state(api: Api, upload: UploadLink | Upload | httpx.URL | str) -> Flow[Upload]:
    """How much of a file is there, and in `media` what it has become.

    By the address of a link, and by a link without a key, `media` is None where the service has keys: it is for the key
    that made the link. With a key give the link, the upload or its id.
    """
    if isinstance(upload, Upload) or (isinstance(upload, UploadLink) and api.key is not None):
        upload = upload.id
    by_id = path_to("uploads", upload) if isinstance(upload, str) and "/" not in upload else None
    url = _address(api, upload) if by_id is None else api.at(by_id)
    return body_of((yield from answered(api, api.request("GET", url))), Upload.of)


def uploads(api: Api) -> Listing[Upload]:
    """Files of the key that have not arrived, in pieces or by links, newest first.

    `upload` goes on with one of them as its ``resume``; `delete` removes what is there of one.
    """
    return Listing("/uploads", [], Upload.of)


def _address(api: Api, link: UploadLink | httpx.URL | str) -> httpx.URL:
    return api.named(link.url) if isinstance(link, UploadLink) else api.named(str(link))
