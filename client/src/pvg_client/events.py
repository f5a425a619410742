"""A job as it goes on, by Server-Sent Events (HTML, 9.2), over a line that may break."""

from __future__ import annotations

from collections.abc import Iterator

import httpx

from pvg_client.calls import Api, Flow, Patience, attempt, object_of, understood, unreachable
from pvg_client.errors import ApiError, UnreachableError
from pvg_client.models import Job
from pvg_client.paths import path_to

#: seconds of silence after which the line is thought to be broken; the service sends something every 15
_SILENCE_S = 45.0


class Following:
    """The changes of one job: each stream goes on after the event that arrived last."""

    def __init__(self, api: Api, job_id: str) -> None:
        self._api = api
        self._job_id = job_id
        self._patience = Patience(api)
        self._last_id: str | None = None
        self._rest = b""
        self._fields: dict[str, str] = {}
        self.ended = False

    def opened(self) -> Flow[httpx.Response]:
        """An answer whose body is to be read as it comes. Raises `ApiError` and `UnreachableError`."""
        self._rest, self._fields = b"", {}
        while True:
            try:
                response = yield from attempt(self._request(), left_open=True)
            except (ApiError, UnreachableError) as error:
                yield from self._patience.after(error)
            else:
                # the job's end was told before
                self.ended = response.status_code == httpx.codes.NO_CONTENT
                return response

    def read(self, data: bytes) -> Iterator[Job]:
        """The jobs that a piece of the body tells of."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            name, _, value = understood(self._api.base_url, bytes.decode, line.rstrip(b"\r")).partition(":")
            if not line.strip():
                yield from self._dispatched()
            elif name == "":
                self._patience.renew()  # a comment: the line is good
            else:
                self._fields[name] = value.removeprefix(" ")

    def _dispatched(self) -> Iterator[Job]:
        fields, self._fields = self._fields, {}
        if "data" not in fields:
            return
        job = understood(self._api.base_url, lambda data: Job.of(object_of(data)), fields["data"])
        self._last_id = fields.get("id", self._last_id)
        self._patience.renew()
        self.ended = job.done
        yield job

    def broken(self, error: httpx.HTTPError | None = None) -> Flow[None]:
        """Wait before the next stream: this one broke, or ended before the job did."""
        request = self._request()
        yield from self._patience.after(unreachable(request, error or httpx.RemoteProtocolError("the stream ended")))

    def _request(self) -> httpx.Request:
        headers = {"Accept": "text/event-stream"} | ({"Last-Event-ID": self._last_id} if self._last_id else {})
        path = path_to("jobs", self._job_id, "events")
        return self._api.request("GET", path, headers=headers, least_timeout_s=_SILENCE_S)
