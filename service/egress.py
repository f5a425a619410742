"""Requests to addresses that others name: files to fetch, receivers of webhooks.

Whoever names an address must not reach through this service what only the service can reach (server-side request
forgery). So a name is resolved here, once, every address that it has must be a public one, and the connection goes to
the very address that was checked: the URL that is sent to has the address in place of the name, while the Host field
and TLS, server name and certificate, keep the name. A second resolution, which might answer differently (DNS
rebinding), does not take place. Redirects are checked in the same way. Nothing of the environment is used: no proxy, no
password file; and no cookie is kept.
"""

from __future__ import annotations

import asyncio
import ipaddress
import socket
import ssl
from collections.abc import AsyncIterator, Iterator, Mapping
from contextlib import AsyncExitStack, asynccontextmanager, contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import Final
from urllib.parse import urlsplit

import httpx

from service.answers import BoundedTransport, pieces
from service.errors import FetchFailedError, UrlNotAllowedError
from service.resolving import Found, Resolver
from service.settings import Settings

Address = ipaddress.IPv4Address | ipaddress.IPv6Address

MAX_URL_CHARACTERS: Final = 2048
MAX_REDIRECTS: Final = 5
#: of an answer that nobody needs
_DROPPED_BYTES: Final = 64 * 1024
#: seconds to a connection, for each address of a name; to the head of a file's answer
_CONNECT_S: Final = 10.0
_HEAD_S: Final = 30.0
#: below 1024 only the web's own ports: mail and other servers take lines of HTTP for commands
_WEB_PORTS: Final = frozenset({80, 443})
_FIRST_FREE_PORT: Final = 1024
_LAST_PORT: Final = 65_535
#: what a host cannot hold, and readers of URLs disagree about
_NO_HOST: Final = frozenset("[]%")
_REDIRECTS: Final = frozenset({301, 302, 303, 307, 308})

# IANA's registries of special-purpose addresses; Python's `is_global` covers most, which depends on its version
_NOT_PUBLIC_V4: Final = tuple(
    ipaddress.IPv4Network(network)
    for network in (
        "0.0.0.0/8",
        "100.64.0.0/10",  # RFC 6598, of carriers; a cloud has its metadata there
        "192.0.0.0/24",  # RFC 6890; another has them there
        "192.88.99.0/24",  # RFC 7526, relays of 6to4
        "168.63.129.16/32",  # a cloud's own service in each of its networks, though the address looks public
    )
)
#: all that is public of IPv6 (RFC 4291, 2.4); mapped, compatible, translated and local addresses lie outside
_UNICAST_V6: Final = ipaddress.IPv6Network("2000::/3")
_NOT_PUBLIC_V6: Final = tuple(
    ipaddress.IPv6Network(network)
    for network in (
        "2001::/23",  # RFC 2928, of protocols: Teredo (RFC 4380), which holds IPv4 addresses, benchmarks, ORCHID
        "2001:db8::/32",  # RFC 3849, documentation
        "2002::/16",  # RFC 3056, 6to4: holds IPv4 addresses
        "3fff::/20",  # RFC 9637, documentation
    )
)
#: RFC 6052: how a network without IPv4 names addresses of it. That of local use, 64:ff9b:1::/48, is no public one
_NAT64: Final = ipaddress.IPv6Network("64:ff9b::/96")


def is_public(address: Address) -> bool:
    """True for an address of the public internet: no private, local, shared, special or multicast one.

    One that holds an IPv4 address is public when it is of the well-known prefix of NAT64 and that address is public.
    """
    if isinstance(address, ipaddress.IPv6Address):
        if address in _NAT64:
            return is_public(ipaddress.IPv4Address(int(address) & 0xFFFF_FFFF))
        if address.scope_id is not None or address not in _UNICAST_V6:
            return False
        return address.is_global and not any(address in network for network in _NOT_PUBLIC_V6)
    if address.is_multicast or address.is_reserved or any(address in network for network in _NOT_PUBLIC_V4):
        return False
    return address.is_global


@dataclass(frozen=True)
class Fetched:
    """A file that is about to arrive. ``size_bytes`` is what its server says, None when it says nothing."""

    url: str
    size_bytes: int | None
    chunks: AsyncIterator[bytes]


@dataclass(frozen=True)
class Received:
    """What a receiver answered. ``leads_on``: that it is at another place, which is not asked."""

    status: int
    leads_on: bool


class Egress:
    """Requests to addresses that others name. One is for one process; it may be used by several threads."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._networks = settings.networks
        self._resolver = Resolver()

    @cached_property
    def _tls(self) -> ssl.SSLContext:
        return httpx.create_ssl_context()

    def close(self) -> None:
        """Let the threads go, once their names are looked up; the process may end before.

        Requests whose names are not being looked up yet, and later ones, raise `StoppingError`.
        """
        self._resolver.close()

    def check(self, url: str) -> httpx.URL:
        """The URL, if it may be asked for as far as that is known before its name is resolved.

        Raises `UrlNotAllowedError` for what is no URL of http or https, has a name and password, a port that is none of
        the web's, or an address that is not public, in whatever notation the resolver would take.
        """
        if len(url) > MAX_URL_CHARACTERS:
            raise UrlNotAllowedError(f"the URL is longer than {MAX_URL_CHARACTERS} characters")
        try:
            parsed = httpx.URL(url)
            host = parsed.raw_host.decode("ascii")
            if _NO_HOST & set(host):  # the brackets of an address are gone by here
                raise ValueError(host)
            urlsplit(url)  # the library's own reader takes it too: others use that one
        except (httpx.InvalidURL, UnicodeError, ValueError) as error:
            raise UrlNotAllowedError("this is not a URL") from error
        if parsed.scheme not in {"http", "https"} or not host:
            raise UrlNotAllowedError("the URL must begin with https:// or http:// and name a host")
        if parsed.userinfo:
            raise UrlNotAllowedError("the URL must not hold a name or a password")
        port = _port(parsed)
        if port not in _WEB_PORTS and not _FIRST_FREE_PORT <= port <= _LAST_PORT:
            raise UrlNotAllowedError(f"port {port} is not one of the web; allowed are 80, 443 and those from 1024")
        try:
            literal = socket.getaddrinfo(host.rstrip("."), port, type=socket.SOCK_STREAM, flags=socket.AI_NUMERICHOST)
        except (OSError, UnicodeError):
            return parsed  # a name
        self._checked(literal)
        return parsed

    def post(
        self, url: str, *, headers: Mapping[str, str], content: bytes, timeout_s: float, owner: str = ""
    ) -> Received:
        """Send ``content`` and return what was answered, without its body. Redirects are not followed.

        ``owner`` is in whose share of the lookups its name is looked up. For threads without an event loop. All of it
        takes ``timeout_s`` at most. Raises `UrlNotAllowedError`, `FetchFailedError` when there is no answer, and
        `StoppingError`.
        """
        return asyncio.run(self._post(url, headers, content, timeout_s, owner))

    async def _post(
        self, url: str, headers: Mapping[str, str], content: bytes, timeout_s: float, owner: str
    ) -> Received:
        received: Received | None = None
        limits = {"head_s": timeout_s, "silence_s": timeout_s}
        try:
            async with (
                asyncio.timeout(timeout_s),
                self._sent("POST", self.check(url), owner, headers=headers, content=content, **limits) as response,
            ):
                received = Received(response.status_code, _place(response) is not None)
                dropped = 0
                async for chunk in pieces(response):
                    dropped += len(chunk)
                    if dropped > _DROPPED_BYTES:
                        break
        except (TimeoutError, httpx.HTTPError) as error:
            if received is None:
                raise _failed(error) from error
            # it was received, whatever becomes of the rest
        return received

    @asynccontextmanager
    async def stream(self, url: str, *, owner: str = "") -> AsyncIterator[Fetched]:
        """Fetch a file; inside the block its bytes arrive. At most `MAX_REDIRECTS` redirects are followed.

        How much is taken is up to the reader; ``owner`` is as for `post`. Raises `UrlNotAllowedError`, also for a
        redirect, and `FetchFailedError` when there is no answer, one that is no file, one that comes too slowly
        (``min_body_bytes_per_s`` over ``body_timeout_s``), or not within ``fetch_timeout_s``; and `StoppingError`.
        What the reader itself raises passes through.
        """
        limit = asyncio.timeout(self._settings.fetch_timeout_s)
        try:
            async with limit, AsyncExitStack() as held:
                yield await self._found(url, owner, held)
        except TimeoutError as error:
            if limit.expired():
                raise _failed(error) from error
            raise  # of the reader, such as of a disk that it writes to

    async def _found(self, url: str, owner: str, held: AsyncExitStack) -> Fetched:
        """The file that a URL leads to, whose connection is kept until ``held`` is closed; raises as `stream`."""
        try:
            for hop in range(MAX_REDIRECTS + 1):
                async with AsyncExitStack() as asked:
                    with _of_hop(hop):  # what it leads to is checked as the first was
                        target, silence_s = self.check(url), self._settings.body_timeout_s
                        asking = self._sent("GET", target, owner, head_s=_HEAD_S, silence_s=silence_s)
                        response = await asked.enter_async_context(asking)
                    place = _place(response)
                    if place is None:
                        await held.enter_async_context(asked.pop_all())
                        return self._file(target, response)
                url = str(target.join(place))
        except (httpx.InvalidURL, UnicodeError) as error:
            raise UrlNotAllowedError("the address leads to what is not a URL") from error
        except (TimeoutError, httpx.HTTPError) as error:
            raise _failed(error) from error
        raise FetchFailedError(f"the address leads to more than {MAX_REDIRECTS} others")

    def _file(self, target: httpx.URL, response: httpx.Response) -> Fetched:
        if response.status_code != httpx.codes.OK:
            raise FetchFailedError(f"the address answers with status {response.status_code}")
        if response.headers.get("content-encoding", "identity").lower() != "identity":
            raise FetchFailedError("the address answers with compressed content, which was not asked for")
        declared = response.headers.get("content-length", "")
        size_bytes = int(declared) if declared.isdecimal() and len(declared) < 20 else None
        return Fetched(str(target), size_bytes, self._chunks(response))

    async def _chunks(self, response: httpx.Response) -> AsyncIterator[bytes]:
        """The bytes as they come. Silence ends in httpx's own time limit."""
        window_s, least = self._settings.body_timeout_s, self._settings.min_body_bytes_per_s
        now = asyncio.get_running_loop().time
        began, received = now(), 0
        try:
            async for chunk in pieces(response):
                received += len(chunk)
                if (passed := now() - began) >= window_s:
                    if received < least * passed:
                        raise FetchFailedError(f"the file comes at fewer than {least:g} bytes a second")
                    began, received = now(), 0
                yield chunk
        except (TimeoutError, httpx.HTTPError) as error:
            raise _failed(error) from error

    @asynccontextmanager
    async def _sent(
        self,
        method: str,
        target: httpx.URL,
        owner: str,
        *,
        head_s: float,
        silence_s: float,
        headers: Mapping[str, str] | None = None,
        content: bytes | None = None,
    ) -> AsyncIterator[httpx.Response]:
        """One request, without redirects, to the addresses that its host has now, until one takes the connection.

        The head of the answer is there within ``head_s``, and between two pieces there are ``silence_s`` at most.
        """
        name = target.raw_host.decode("ascii")
        sent = {"User-Agent": "pvg-service", "Accept": "*/*", "Accept-Encoding": "identity", "Connection": "close"}
        sent |= {**(headers or {}), "Host": target.netloc.decode("ascii")}
        limits = httpx.Timeout(silence_s, connect=_CONNECT_S).as_dict()
        # the transport alone: what a client adds, redirects, cookies and proxies, is what is not wanted here
        async with BoundedTransport(self._tls) as transport:
            async with asyncio.timeout(head_s):
                addresses = await self._addresses(target, owner)
                while True:
                    request = httpx.Request(
                        method,
                        target.copy_with(host=addresses.pop(0), fragment=None),
                        headers=sent,
                        content=content,
                        # what TLS asks for and what the certificate must be of
                        extensions={"timeout": limits, "sni_hostname": name.rstrip(".")},
                    )
                    try:
                        response = await transport.handle_async_request(request)
                    except (httpx.ConnectError, httpx.ConnectTimeout):
                        if not addresses:
                            raise
                    else:
                        break
            try:
                yield response
            finally:
                await response.aclose()

    async def _addresses(self, target: httpx.URL, owner: str) -> list[str]:
        """The addresses of the host, at least one, all of which may be connected to."""
        name, port = target.raw_host.decode("ascii"), _port(target)
        try:
            found = await asyncio.wrap_future(self._resolver.look_up(owner, name, port))
        except (OSError, UnicodeError) as error:
            raise FetchFailedError("the host of the URL has no address") from error
        return self._checked(found)

    def _checked(self, found: Found) -> list[str]:
        addresses = [ipaddress.ip_address(one[4][0]) for one in found]
        if not all(self._may_reach(one) for one in addresses):
            raise UrlNotAllowedError("the host of the URL is not at a public address")
        return list(dict.fromkeys(map(str, addresses)))

    def _may_reach(self, address: Address) -> bool:
        """A public address, or one that the settings allow; none that needs the name of an interface."""
        if is_public(address):
            return True
        allowed = self._settings.allow_private_networks or any(address in network for network in self._networks)
        return allowed and not _has_zone(address)


def _has_zone(address: Address) -> bool:
    return isinstance(address, ipaddress.IPv6Address) and address.scope_id is not None


def _place(response: httpx.Response) -> str | None:
    """Where a redirect leads to; None for what is none, or says no place."""
    return response.headers.get("location") if response.status_code in _REDIRECTS else None


def _port(url: httpx.URL) -> int:
    return url.port if url.port is not None else 443 if url.scheme == "https" else 80


@contextmanager
def _of_hop(hop: int) -> Iterator[None]:
    """Inside the block what is wrong with an address that another one led to is told as of that."""
    try:
        yield
    except (UrlNotAllowedError, FetchFailedError) as error:
        if hop == 0:
            raise
        raise type(error)(f"the address leads to another one: {error.detail}") from error


def _failed(error: Exception) -> FetchFailedError:
    if isinstance(error, TimeoutError | httpx.TimeoutException):
        return FetchFailedError("the address does not answer in time")
    if isinstance(error, httpx.ConnectError):
        return FetchFailedError("there is no connection to the address, or its certificate is not good")
    return FetchFailedError("the address breaks off, or does not answer as HTTP has it")
