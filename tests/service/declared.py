"""Whether answers have the header fields that the schema declares of them, and no others."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, Final

import httpx
from fastapi import FastAPI

from service.addresses import PREFIX

#: what HTTP says of any message, and what stands before every route
_OF_ANY: Final = frozenset(
    {
        *("allow", "cache-control", "connection", "content-length", "content-type", "date", "transfer-encoding"),
        *("vary", "server"),
        *("content-security-policy", "cross-origin-opener-policy", "cross-origin-resource-policy", "referrer-policy"),
        *("x-accel-buffering", "x-content-type-options", "x-frame-options"),
    }
)


Paths = list[tuple[re.Pattern[str], dict[str, Any]]]
#: the same whatever the settings are
_PATHS: Final[Paths] = []


def _paths(app: FastAPI) -> Paths:
    """The operations of the schema, by path, then by method; a word that has a meaning of its own, before ids."""
    if not _PATHS:
        paths = app.openapi()["paths"]
        for path in sorted(paths, key=lambda path: path.count("{")):
            _PATHS.append((re.compile(re.sub(r"\{\w+\}", "[^/]+", path)), paths[path]))
    return _PATHS


class Declared:
    """The header fields of the schema's answers: a hook of a client, which looks at each of its answers."""

    def __init__(self, app: FastAPI) -> None:
        self._app = app

    def __call__(self, answer: httpx.Response) -> None:
        """Fail when an answer has a field that its operation does not declare."""
        declared = self.fields(answer)
        if declared is None:
            return
        extra = {name for name in answer.headers if name not in declared | _OF_ANY}
        extra -= {name for name in extra if name.startswith("access-control-")}
        asked = f"{answer.request.method} {answer.request.url.path}"
        assert not extra, f"{asked}, {answer.status_code}: the schema does not declare {sorted(extra)}"

    def fields(self, answer: httpx.Response) -> frozenset[str] | None:
        """The names, in lower case, that the schema has of such an answer; None when it has no such answer."""
        method = answer.request.method.lower()
        operation = self._operation(answer.request.url.path, "get" if method == "head" else method)
        told = operation.get("responses", {}).get(str(answer.status_code))
        if told is None or (method == "head" and operation["operationId"] == "get_upload"):  # tus has its own HEAD
            return None
        return frozenset(name.lower() for name in told.get("headers", {}))

    def _operation(self, path: str, method: str) -> Mapping[str, Any]:
        paths = _paths(self._app)
        for place in (path, f"{PREFIX}{path}"):
            for pattern, methods in paths:
                if method in methods and pattern.fullmatch(place):
                    return methods[method]
        return {}
