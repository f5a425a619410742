"""Uploaded media: what is there, and its deletion; uploads themselves are in `uploads`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import httpx

from pvg_client.calls import Api, Flow, Params, Patience, asked, attempt, of_metadata, understood
from pvg_client.errors import ApiError, UnreachableError
from pvg_client.models import Job, Medium, Result, Upload, id_of, role_of
from pvg_client.pages import Listing, each
from pvg_client.paths import path_to

#: what is deleted without more, by how its ids begin
_ALONE: Final = {"res_": "results", "job_": "jobs", "upl_": "uploads"}
_GATEWAYS: Final = frozenset({httpx.codes.BAD_GATEWAY, httpx.codes.GATEWAY_TIMEOUT})


def medium(api: Api, medium_id: Medium | str) -> Flow[Medium]:
    """A video or a reference, as it is now."""
    return (yield from asked(api, Medium.of, "GET", path_of(id_of(medium_id))))


def videos(api: Api, *, state: Sequence[str] | str = (), metadata: Mapping[str, str] | None = None) -> Listing[Medium]:
    """Videos, newest first: all, or those that every given filter chooses."""
    return Listing("/videos", _filter(state, metadata), Medium.of)


def references(
    api: Api, *, state: Sequence[str] | str = (), metadata: Mapping[str, str] | None = None
) -> Listing[Medium]:
    """References, newest first: all, or those that every given filter chooses."""
    return Listing("/references", _filter(state, metadata), Medium.of)


def _filter(state: Sequence[str] | str, metadata: Mapping[str, str] | None) -> Params:
    return [("state", one) for one in each(state)] + of_metadata(metadata)


def delete(api: Api, thing: Medium | Result | Job | Upload | str, *, cancel_jobs: bool = False) -> Flow[None]:
    """Delete a video or reference with everything derived from it, a job that has ended with its results, or a result.

    Of an upload goes what has arrived, and not the medium that it has become. Jobs that need a medium refuse, or are
    canceled with ``cancel_jobs``.
    """
    params = [("cancel_jobs", "true")] if cancel_jobs else []
    thing_id = id_of(thing)
    kind = _ALONE.get(thing_id[:4])
    path = path_of(thing_id) if kind is None else path_to(kind, thing_id)
    request = api.request("DELETE", path, params=params)
    patience, unsure = Patience(api), False
    while True:
        try:
            understood(request.url, _deleted, (yield from attempt(request)))
        except UnreachableError as error:
            unsure = True
            yield from patience.after(error)
        except ApiError as error:
            if unsure and error.code == "not-found":
                return  # it was deleted, and the answer was lost
            # a proxy does not know what became of the request
            unsure = unsure or error.status in _GATEWAYS or not error.code
            yield from patience.after(error)
        else:
            return


def _deleted(response: httpx.Response) -> None:
    if response.status_code != httpx.codes.NO_CONTENT:
        raise ValueError("this service answers a deletion with 204")


def path_of(medium_id: str) -> str:
    """Where a medium is. Raises `ValueError` for what is no id."""
    return path_to(f"{role_of(medium_id)}s", medium_id)
