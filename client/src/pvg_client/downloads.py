"""Results, what was made beside them, and uploaded files, into files that are whole or not there."""

from __future__ import annotations

import errno
import os
import re
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, Final, Literal
from urllib.parse import unquote

import httpx

from pvg_client.calls import Api, Flow, Patience, asked, attempt, headed, once, understood, worked
from pvg_client.errors import ApiError, DamagedError, UnreachableError
from pvg_client.files import PartFile, local_name, sha256_of, there_already
from pvg_client.media import path_of
from pvg_client.models import Body, Extra, JobLook, Link, Medium, Result, said
from pvg_client.paths import path_to

#: of a file: its sha256; a proxy that packs answers makes it a weak one
_ETAG: Final = re.compile(r'(?:W/)?"([0-9a-f]{64})"')
#: how often a file is fetched from its beginning because its bytes were not right
_FETCHES: Final = 2


@dataclass(frozen=True, slots=True)
class _Remote:
    """A file of the service, and the name it has there, if that was asked for."""

    url: httpx.URL
    sha256: str
    name: str | None = None


def download(api: Api, file: Result | Extra | JobLook | Medium | str, path: str | os.PathLike[str]) -> Flow[Path]:
    """Fetch a result, an extra of one, or the file that a medium was made of, to ``path``; where it is then.

    It appears when it is whole and its sha256 is right, in place of what was there. Until then its bytes are beside it
    under a hidden name, from which the next attempt, or the next run, goes on. Of two at a time to one path the one
    that ends last stays.

    In a folder it has the name that the service has for it, and replaces nothing: where another file has that name it
    gets a number, as ``look (2).mp4``; a file of that name, or that with a number, which has its bytes already is it.

    Raises `ApiError` (410 after its retention), `DamagedError` when its bytes are wrong twice, `UnreachableError`,
    `ValueError` for a look that has no result, `TypeError` for what is no file, such as a link, which is for others,
    `FileNotFoundError` for a folder that is not there, which a slash at the end of ``path`` tells from a file.
    """
    target = Path(path)
    if os.fspath(path).endswith(("/", os.sep)) and not target.is_dir():
        raise FileNotFoundError(errno.ENOENT, "there is no such folder", os.fspath(path))
    remote = yield from _located(api, file, named=target.is_dir())
    if remote.name is not None:
        target /= remote.name
        found = yield from worked(lambda: there_already(target, remote.sha256))
        if found is not None:
            return found
    part = PartFile(target, remote.sha256)
    try:
        for _ in range(_FETCHES):
            yield from _fill(api, remote, part)
            if (yield from worked(lambda: sha256_of(part.path))) == remote.sha256:
                if remote.name is not None:
                    return (yield from worked(lambda: part.put_beside(target)))
                part.put(target)
                return target
            part.clear()
    finally:
        part.close()
    raise DamagedError(f"the bytes of {remote.url.path} are not those that the service has")


def link(
    api: Api,
    result: Result | JobLook | str,
    *,
    expires_in_s: int | None = None,
    part: Literal["look.cube", "matte"] | None = None,
    person: int | None = None,
    idempotency_key: str | None = None,
) -> Flow[Link]:
    """An address of a result, or of a part beside it, for a browser or somebody else: it needs no key.

    It is good for an hour, or ``expires_in_s``, up to 7 days, and not longer than the file is kept.
    """
    given: dict[str, Any] = {"expires_in_s": expires_in_s, "part": part, "person": person}
    result_id = result if isinstance(result, str) else _of_look(result).id
    path = path_to("results", result_id, "link")

    def read(made: Body) -> Link:
        return Link(str(api.named(made["url"])), datetime.fromisoformat(made["expires_at"]))

    return (yield from asked(api, read, "POST", path, body=said(given), headers=once(idempotency_key)))


def _of_look(result: Result | JobLook) -> Result:
    if isinstance(result, Result):
        return result
    if result.result is None:
        raise ValueError(f"the look has no result: it is {result.result_gone or result.state}")
    return result.result


def _located(api: Api, file: Result | Extra | JobLook | Medium | str, *, named: bool) -> Flow[_Remote]:
    if isinstance(file, JobLook):
        file = _of_look(file)
    if isinstance(file, str):
        url = api.at(path_to("results", file) if file.startswith("res_") else path_of(file) + "/file")
    elif not isinstance(file, Result | Extra | Medium):
        raise TypeError(f"a {type(file).__name__} is no file: give a result, an extra, a look of a job, or a medium")
    else:
        url = api.at(path_of(file.id) + "/file") if isinstance(file, Medium) else api.named(file.url)
        if file.sha256 is not None and not named:
            return _Remote(url, file.sha256)
    # its ETag is the hash of its bytes
    headers = yield from headed(api, url, to_get={"Range": "bytes=0-0"})
    sha256 = understood(url, _sha256_in, headers)
    return _Remote(url, sha256, _name_in(headers, url) if named else None)


def _sha256_in(headers: httpx.Headers) -> str:
    found = _ETAG.fullmatch(headers["etag"])
    if found is None:
        raise ValueError("its ETag is no hash")
    return found[1]


def _name_in(headers: httpx.Headers, url: httpx.URL) -> str:
    """The file's name (RFC 6266) without folders, or the last part of its address; as a file here may be called."""
    said = unquote(headers.get("content-disposition", "").partition("filename*=UTF-8''")[2].partition(";")[0])
    names = (re.split(r"[/\\\0]", name)[-1] for name in (said, url.path))
    return local_name(next(name for name in names if name not in {"", ".", ".."}))


def _fill(api: Api, remote: _Remote, part: PartFile) -> Flow[None]:
    """Fetch what is missing of a part, until nothing is."""
    patience = Patience(api)
    while True:
        before = part.size
        goes_on = {"Range": f"bytes={before}-", "If-Range": f'"{remote.sha256}"'} if before else {}
        try:
            yield from attempt(api.request("GET", remote.url, headers=goes_on), part)
        except ApiError as error:
            if before and error.status == httpx.codes.REQUESTED_RANGE_NOT_SATISFIABLE:
                return  # nothing is missing
            yield from patience.after(error)
        except UnreachableError as error:
            if part.size > before:
                patience.renew()
            yield from patience.after(error)
        else:
            return
