"""The client, twice: one that blocks and one for asyncio. What they do is in the modules of `calls`' flows."""

from __future__ import annotations

import asyncio
import inspect
import time
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator
from functools import wraps
from types import TracebackType
from typing import Any, Concatenate, Final, ParamSpec, Self, TypeVar

import httpx

from pvg_client import account, deliveries, downloads, links, media, pictures, uploads
from pvg_client import jobs as work
from pvg_client.calls import API_PATH, VISIBLE, Api, Flow, Pause, Send, Work
from pvg_client.events import Following
from pvg_client.models import Job, id_of
from pvg_client.pages import Listing

P = ParamSpec("P")
T = TypeVar("T")
Wrapper = TypeVar("Wrapper", bound=Callable[..., Any])

LOCAL: Final = "http://127.0.0.1:8000"
TIMEOUT_S: Final = 60.0
RETRIES: Final = 8


def _api(base_url: str, key: str | None, timeout: float, retries: int) -> Api:
    url = httpx.URL(base_url)
    if url.userinfo:
        raise ValueError("the address of a service has no user and no password in it: links to results would tell them")
    if url.scheme not in {"http", "https"} or not url.host:
        raise ValueError(f"{base_url!r} is no address of a service; it looks like {LOCAL}")
    # the interface's own path, as addresses in its documentation have it, is added to each call
    url = url.copy_with(path=url.path.rstrip("/").removesuffix(API_PATH) + "/")
    if key is not None:
        key = key.strip()  # as files end in a new line
        if not VISIBLE.fullmatch(key):
            raise ValueError("the key is empty, or has spaces, line breaks or letters that are not ASCII within")
    return Api(url, key, timeout, retries)


def _shown(wrapper: Wrapper, flow: Callable[..., Any]) -> Wrapper:
    """Let a method's signature be its flow's, as `help` shows it, with what it gives in place of the flow."""
    signature = inspect.signature(flow)
    first, *others = signature.parameters.values()
    gives = str(signature.return_annotation).replace("Listing[", "Iterator[")
    gives = gives.removeprefix("Flow[").removesuffix("]") if gives.startswith("Flow[") else gives
    given = [first.replace(name="self", annotation=inspect.Parameter.empty), *others]
    wrapper.__signature__ = signature.replace(parameters=given, return_annotation=gives)  # type: ignore[attr-defined]
    return wrapper


def _blocking(flow: Callable[Concatenate[Api, P], Flow[T]]) -> Callable[Concatenate[Client, P], T]:
    @wraps(flow)
    def method(self: Client, /, *args: P.args, **kwargs: P.kwargs) -> T:
        return self._run(flow(self._api, *args, **kwargs))

    return _shown(method, flow)


def _listed(listing: Callable[Concatenate[Api, P], Listing[T]]) -> Callable[Concatenate[Client, P], Iterator[T]]:
    @wraps(listing)
    def method(self: Client, /, *args: P.args, **kwargs: P.kwargs) -> Iterator[T]:
        wanted, cursor = listing(self._api, *args, **kwargs), None
        while True:
            things, cursor = self._run(wanted.page(self._api, cursor))
            yield from things
            if cursor is None:
                return

    return _shown(method, listing)


def _awaited(
    flow: Callable[Concatenate[Api, P], Flow[T]],
) -> Callable[Concatenate[AsyncClient, P], Coroutine[Any, Any, T]]:
    @wraps(flow)
    async def method(self: AsyncClient, /, *args: P.args, **kwargs: P.kwargs) -> T:
        return await self._run(flow(self._api, *args, **kwargs))

    return _shown(method, flow)


def _listed_async(
    listing: Callable[Concatenate[Api, P], Listing[T]],
) -> Callable[Concatenate[AsyncClient, P], AsyncIterator[T]]:
    @wraps(listing)
    async def method(self: AsyncClient, /, *args: P.args, **kwargs: P.kwargs) -> AsyncIterator[T]:
        wanted, cursor = listing(self._api, *args, **kwargs), None
        while True:
            things, cursor = await self._run(wanted.page(self._api, cursor))
            for thing in things:
                yield thing
            if cursor is None:
                return

    return _shown(method, listing)


class Client:
    """A service, spoken to in blocking calls. It may be shared between threads. Its address has no password in it.

    ``key`` is one of `pvg-service keys create`, if the service has any. ``timeout``, in seconds, is that of each
    connection, read and write, not of a whole call. A call that fails for a passing reason (no connection, 429, 502,
    503, 504) is made again up to ``retries`` times in a row, after what the service asks for or ever longer pauses; it
    is done once all the same. ``transport`` is httpx's, for proxies, certificates of one's own, or tests.
    """

    def __init__(
        self,
        base_url: str = LOCAL,
        key: str | None = None,
        *,
        timeout: float = TIMEOUT_S,
        retries: int = RETRIES,
        transport: httpx.BaseTransport | None = None,
    ) -> None:
        self._api = _api(base_url, key, timeout, retries)
        self._http = httpx.Client(transport=transport)

    def _run(self, flow: Flow[T]) -> T:
        outcome: Any = None
        failure: httpx.HTTPError | None = None
        try:
            while True:
                step = flow.throw(failure) if failure else flow.send(outcome)
                outcome = failure = None
                match step:
                    case Send():
                        try:
                            outcome = self._send(step)
                        except httpx.HTTPError as error:
                            failure = error
                    case Pause():
                        time.sleep(step.seconds)
                    case Work():
                        outcome = step.do()
        except StopIteration as end:
            result: T = end.value
            return result
        finally:
            flow.close()

    def _send(self, step: Send) -> httpx.Response:
        response = self._http.send(step.request, stream=True)
        if step.left_open and response.is_success:
            return response
        try:
            if step.into is not None and response.is_success:
                step.into.begin(response)
                for data in response.iter_raw():
                    step.into.write(data)
            else:
                response.read()
        finally:
            response.close()
        return response

    upload = _blocking(uploads.upload)
    medium = _blocking(media.medium)
    videos = _listed(media.videos)
    references = _listed(media.references)
    delete = _blocking(media.delete)
    transfer = _blocking(work.transfer)
    swap = _blocking(work.swap)
    job = _blocking(work.job)
    jobs = _listed(work.jobs)
    wait = _blocking(work.wait)
    cancel = _blocking(work.cancel)
    download = _blocking(downloads.download)
    link = _blocking(downloads.link)
    upload_link = _blocking(links.upload_link)
    send_upload = _blocking(links.send_upload)
    upload_state = _blocking(links.upload_state)
    uploads = _listed(links.uploads)
    webhooks = _listed(deliveries.webhooks)
    webhook = _blocking(deliveries.webhook)
    replay = _blocking(deliveries.replay)
    webhook_secret = _blocking(deliveries.webhook_secret)
    rotate_webhook_secret = _blocking(deliveries.rotate_webhook_secret)
    preview = _blocking(pictures.preview)
    frame = _blocking(pictures.frame)
    poster = _blocking(pictures.poster)
    thumbnail = _blocking(pictures.thumbnail)
    usage = _blocking(account.usage)
    limits = _blocking(account.limits)

    def events(self, job: Job | str) -> Iterator[Job]:
        """The job as it stands, then after each of its changes, to its end, however that is.

        A stream that breaks is taken up after the event that arrived last. Raises `ApiError` and `UnreachableError`.
        """
        following = Following(self._api, id_of(job))
        while not following.ended:
            failure = None
            response = self._run(following.opened())
            try:
                for data in response.iter_bytes():
                    yield from following.read(data)
            except httpx.HTTPError as error:
                failure = error
            finally:
                response.close()
            if not following.ended:
                self._run(following.broken(failure))

    def close(self) -> None:
        """Close the connections."""
        self._http.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class AsyncClient:
    """The same for asyncio: each call is awaited, lists are gone through with `async for`."""

    def __init__(
        self,
        base_url: str = LOCAL,
        key: str | None = None,
        *,
        timeout: float = TIMEOUT_S,
        retries: int = RETRIES,
        transport: httpx.AsyncBaseTransport | None = None,
    ) -> None:
        self._api = _api(base_url, key, timeout, retries)
        self._http = httpx.AsyncClient(transport=transport)

    async def _run(self, flow: Flow[T]) -> T:
        outcome: Any = None
        failure: httpx.HTTPError | None = None
        try:
            while True:
                step = flow.throw(failure) if failure else flow.send(outcome)
                outcome = failure = None
                match step:
                    case Send():
                        try:
                            outcome = await self._send(step)
                        except httpx.HTTPError as error:
                            failure = error
                    case Pause():
                        await asyncio.sleep(step.seconds)
                    case Work():
                        outcome = await asyncio.to_thread(step.do)
        except StopIteration as end:
            result: T = end.value
            return result
        finally:
            flow.close()

    async def _send(self, step: Send) -> httpx.Response:
        response = await self._http.send(step.request, stream=True)
        if step.left_open and response.is_success:
            return response
        try:
            if step.into is not None and response.is_success:
                step.into.begin(response)
                async for data in response.aiter_raw():
                    await asyncio.to_thread(step.into.write, data)
            else:
                await response.aread()
        finally:
            await response.aclose()
        return response

    upload = _awaited(uploads.upload)
    medium = _awaited(media.medium)
    videos = _listed_async(media.videos)
    references = _listed_async(media.references)
    delete = _awaited(media.delete)
    transfer = _awaited(work.transfer)
    swap = _awaited(work.swap)
    job = _awaited(work.job)
    jobs = _listed_async(work.jobs)
    wait = _awaited(work.wait)
    cancel = _awaited(work.cancel)
    download = _awaited(downloads.download)
    link = _awaited(downloads.link)
    upload_link = _awaited(links.upload_link)
    send_upload = _awaited(links.send_upload)
    upload_state = _awaited(links.upload_state)
    uploads = _listed_async(links.uploads)
    webhooks = _listed_async(deliveries.webhooks)
    webhook = _awaited(deliveries.webhook)
    replay = _awaited(deliveries.replay)
    webhook_secret = _awaited(deliveries.webhook_secret)
    rotate_webhook_secret = _awaited(deliveries.rotate_webhook_secret)
    preview = _awaited(pictures.preview)
    frame = _awaited(pictures.frame)
    poster = _awaited(pictures.poster)
    thumbnail = _awaited(pictures.thumbnail)
    usage = _awaited(account.usage)
    limits = _awaited(account.limits)

    async def events(self, job: Job | str) -> AsyncIterator[Job]:
        """The job as it stands, then after each of its changes, to its end, however that is.

        A stream that breaks is taken up after the event that arrived last. Raises `ApiError` and `UnreachableError`.
        """
        following = Following(self._api, id_of(job))
        while not following.ended:
            failure = None
            response = await self._run(following.opened())
            try:
                async for data in response.aiter_bytes():
                    for change in following.read(data):
                        yield change
            except httpx.HTTPError as error:
                failure = error
            finally:
                await response.aclose()
            if not following.ended:
                await self._run(following.broken(failure))

    async def aclose(self) -> None:
        """Close the connections."""
        await self._http.aclose()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.aclose()
