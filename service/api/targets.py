"""Request targets: what follows the method. Applications know the origin form; a server must take the absolute too."""

from __future__ import annotations

import re
from typing import Final

import h11

_ABSOLUTE: Final = re.compile(rb"https?://([^/?#]*)([^#]*)", re.IGNORECASE)


def in_origin_form(request: h11.Request) -> h11.Request:
    """The request with its path and query as the target, and the host that it is for as its Host.

    A target in absolute form, as clients send it to proxies, names that host itself, whatever the Host field says
    (RFC 9112, 3.2.2). Raises `h11.RemoteProtocolError` for a URL that has no host, a user or a fragment.
    """
    if request.target.startswith(b"/") or not _ABSOLUTE.match(request.target):
        return request
    url = _ABSOLUTE.fullmatch(request.target)
    if url is None or not url[1] or b"@" in url[1]:
        raise h11.RemoteProtocolError("the target is no http URL of a host")
    target = url[2] if url[2].startswith(b"/") else b"/" + url[2]
    others = [(name, value) for name, value in request.headers if name != b"host"]
    return h11.Request(
        method=request.method, target=target, headers=[(b"host", url[1]), *others], http_version=request.http_version
    )
