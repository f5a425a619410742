"""Jobs: asking for them, waiting for their end, stopping them."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from typing import Any, Final, Literal

from pvg_client.calls import Api, Flow, Params, Pause, asked, of_metadata, once
from pvg_client.errors import JobFailed
from pvg_client.models import Job, Look, Medium, id_of, said
from pvg_client.pages import Listing, each
from pvg_client.paths import path_to
from pvg_client.progress import Bar

#: seconds that one question for a job's end may take
_LONG_POLL_S: Final = 20.0
#: the same where a bar is looked at
_SHORT_POLL_S: Final = 1.0
_LEAST_BETWEEN_S: Final = 0.5

Output = Mapping[str, Any]
Kind = Literal["vectorize", "transfer", "swap"]


def transfer(
    api: Api,
    video: Medium | str,
    looks: Sequence[Look | Medium | str] | Look | Medium | str = (),
    *,
    reference: Medium | str | None = None,
    output: Output | None = None,
    webhook: str | Mapping[str, Any] | None = None,
    metadata: Mapping[str, str] | None = None,
    force: bool = False,
    idempotency_key: str | None = None,
) -> Flow[Job]:
    """Ask for looks of a video: those given, or that of one ``reference`` as it is by default.

    Each of the ``looks`` is one with its options or a reference alone; one needs no list.
    Media that are still vectorised are waited for by the job. ``output`` is as docs/api.md has it, such as
    `{"codec": "hevc"}`; ``webhook`` is the address that is told when the job is done. Without ``force`` the same
    transfer asked for again is answered with the job that was made before.

    Raises `ValueError` when it is given neither looks nor a reference, or both.
    """
    if bool(looks) == (reference is not None):
        raise ValueError("give looks, or one reference")
    given = [looks] if isinstance(looks, Look | Medium | str) else looks
    asked_for = given if reference is None else [reference]
    all_looks = [one if isinstance(one, Look) else Look(one) for one in asked_for]
    body = {"video": id_of(video), "looks": [look.body() for look in all_looks]}
    body |= _rest(output=output, webhook=webhook, metadata=metadata, force=force)
    return (yield from asked(api, Job.of, "POST", "/transfer", body=body, headers=once(idempotency_key)))


def swap(
    api: Api,
    a: Medium | str,
    b: Medium | str | None = None,
    *,
    options: Mapping[str, Any] | None = None,
    output: Output | None = None,
    webhook: str | Mapping[str, Any] | None = None,
    metadata: Mapping[str, str] | None = None,
    force: bool = False,
    idempotency_key: str | None = None,
) -> Flow[Job]:
    """Ask for ``a`` with the colours of ``b`` and ``b`` with those of ``a``, or for two faces of ``a`` exchanged.

    ``options`` are those of a look, as docs/api.md has them: `{"faces": [0, 1], "contrast": [0.8, 1.2]}`.
    """
    body = {"a": id_of(a)} | ({} if b is None else {"b": id_of(b)}) | dict(options or {})
    body |= _rest(output=output, webhook=webhook, metadata=metadata, force=force)
    return (yield from asked(api, Job.of, "POST", "/swap", body=body, headers=once(idempotency_key)))


def _rest(
    *,
    output: Output | None,
    webhook: str | Mapping[str, Any] | None,
    metadata: Mapping[str, str] | None,
    force: bool,
) -> dict[str, Any]:
    told = {"url": webhook} if isinstance(webhook, str) else webhook
    given: dict[str, Any] = {"output": output, "webhook": told, "metadata": metadata, "force": force or None}
    return said(given)


def job(api: Api, job_id: Job | str) -> Flow[Job]:
    """A job, as it is now."""
    return (yield from asked(api, Job.of, "GET", path_to("jobs", id_of(job_id))))


def jobs(
    api: Api,
    *,
    ids: Sequence[str] | str | None = None,
    video: Medium | str | None = None,
    reference: Medium | str | None = None,
    state: Sequence[str] | str = (),
    kind: Sequence[Kind] | Kind = (),
    metadata: Mapping[str, str] | None = None,
) -> Listing[Job]:
    """Jobs, newest first: all, or those that every given filter chooses. One value of a filter needs no list."""
    params: Params = [("id", ",".join(each(ids)))] if ids is not None else []
    params += [("video", id_of(video))] if video is not None else []
    params += [("reference", id_of(reference))] if reference is not None else []
    params += [("state", one) for one in each(state)] + [("kind", one) for one in each(kind)]
    return Listing("/jobs", params + of_metadata(metadata), Job.of)


def wait(api: Api, job: Job | Medium | str, *, progress: bool = True, timeout: float | None = None) -> Flow[Job]:
    """The job once it has succeeded. A medium is waited for until it is vectorised.

    ``progress`` shows a bar, where tqdm is installed and the standard error is a terminal.

    Raises `JobFailed` when the job ends in any other way, and `TimeoutError` when it has not ended within ``timeout``
    seconds, and 2 more for the last answer: a service that is away or silent is asked again until then. Without
    ``timeout`` it is given up after the client's ``retries`` in a row, 8 of connections that are refused in some 30 s:
    `UnreachableError`, or `ApiError` 429, 502, 503 and 504. Other errors, and those that want more than a minute's
    pause, are an `ApiError` at once.
    """
    job_id = job.job if isinstance(job, Medium) else id_of(job)
    until = math.inf if timeout is None else time.monotonic() + timeout
    with Bar(wanted=progress) as bar:
        poll_s = _SHORT_POLL_S if bar.shown else _LONG_POLL_S
        while True:
            began = time.monotonic()
            wait_s = max(0.0, min(poll_s, api.timeout_s / 2, until - began))
            params = [("wait", f"{wait_s:.1f}")]
            seen = yield from asked(api, Job.of, "GET", path_to("jobs", job_id), params=params, until=until)
            bar.show(seen)
            if seen.done:
                break
            if time.monotonic() >= until:
                raise TimeoutError(f"{seen.kind} {seen.id} is {seen.state} after {timeout:g} s")
            # a service that is about to stop answers at once
            yield Pause(max(0.0, _LEAST_BETWEEN_S - (time.monotonic() - began)))
    if seen.state != "succeeded":
        raise JobFailed(seen)
    return seen


def cancel(api: Api, job: Job | str, *, idempotency_key: str | None = None) -> Flow[Job]:
    """Stop a job; it is `canceling` while its worker stops. Raises `ApiError` 409 when it has ended in another way."""
    path = path_to("jobs", id_of(job), "cancel")
    return (yield from asked(api, Job.of, "POST", path, headers=once(idempotency_key)))
