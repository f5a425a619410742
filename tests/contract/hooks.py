"""What schemathesis cannot know of this service: which bytes are media, and ids of things that are there.

Loaded by its own process, see `tests.contract.fuzzing`; it sees nothing of the service but its address.
"""

from __future__ import annotations

import json
import os
import re
import uuid
from typing import Any

import schemathesis
from hypothesis import strategies as st

PNG = b"\x89PNG\r\n\x1a\n"
MP4 = b"\x00\x00\x00\x18ftypisom\x00\x00\x02\x00isomiso2"
FILES = st.builds(bytes.__add__, st.sampled_from([PNG, MP4]), st.binary(max_size=64))
#: for which the service lets a request wait
LONGEST_WAIT_S = 60
IDS: dict[str, str] = json.loads(os.environ.get("CONTRACT_IDS", "{}"))

schemathesis.openapi.media_type("application/octet-stream", FILES)
schemathesis.openapi.media_type("application/offset+octet-stream", FILES)


@schemathesis.hook
def map_path_parameters(context: schemathesis.HookContext, path_parameters: dict[str, Any]) -> dict[str, Any]:
    """Half of the calls are about something that is there; what is deleted is not."""
    operation = context.operation
    if path_parameters and operation is not None and operation.method.upper() != "DELETE":
        for name, there in IDS.items():
            if name in path_parameters and len(str(path_parameters[name])) % 2 == 0:
                path_parameters[name] = there
    return path_parameters


@schemathesis.hook
def map_body(context: schemathesis.HookContext, body: Any) -> Any:
    """URLs are of hosts that are not there (RFC 6761, 6.4): nobody is asked for anything."""
    for holder in (body, body.get("webhook")) if isinstance(body, dict) else ():
        if isinstance(holder, dict) and re.match("https?://", str(holder.get("url")), re.IGNORECASE):
            holder["url"] = "https://media.invalid/clip.mp4"
    return body


@schemathesis.hook
def filter_case(context: schemathesis.HookContext, case: schemathesis.Case) -> bool:
    """A header field that nobody knows is no error (RFC 9110, 5.1): a call with one need not be refused."""
    return not any("unknown-property" in name.lower() for name in case.headers or ())


@schemathesis.hook
def before_call(context: schemathesis.HookContext, case: schemathesis.Case, kwargs: dict[str, Any]) -> None:
    """An Idempotency-Key is of one request; nobody waits long for a job that nobody does."""
    query = case.query or {}
    if str(query.get("wait", "")).isdecimal() and 1 < int(query["wait"]) <= LONGEST_WAIT_S:
        query["wait"] = 1
    for name in list(case.headers or ()):
        key = str(case.headers[name])
        if name.lower() == "idempotency-key" and 0 < len(key) < 200 and key.isascii() and key.isprintable():
            case.headers[name] = f"{key.replace(' ', '-')}-{uuid.uuid4().hex}"
        elif name.lower() == "prefer":
            case.headers[name] = re.sub(r"wait=\d+", "wait=1", key)
