"""What the text of a setting may be: each function returns what it stands for, or raises `ValueError` and says why."""

from __future__ import annotations

import ipaddress
import re
from typing import Final
from urllib.parse import urlsplit

#: of any time: a date that lies so far ahead can still be written
LONGEST_S: Final = 100 * 366 * 86_400

#: pages have no origin of these schemes: what is loaded by them has `null`, if it is a page at all
_NO_PAGES: Final = frozenset({"", "data", "file", "ftp", "javascript", "ws", "wss"})
#: of a kind that is installed, with a port that is one; as SQLAlchemy reads it, which takes long to load
_DATABASE_URL = re.compile(
    r"(?:postgresql(?:\+psycopg)?|postgres|sqlite(?:\+pysqlite)?)://"
    r"(?>(?:[^:/]*(?::[^@]*)?@)?)(?:\[[^\]/?]+\]|[^:/?\[\]]*)(?::\d+)?(?:[/?].*)?"
)
_LOG_LEVELS: Final = ("DEBUG", "INFO", "WARNING", "ERROR", "CRITICAL")
#: as a Host field has them, which is ASCII
_HOST_NAME = re.compile(r"[A-Za-z0-9_]([A-Za-z0-9_.-]*[A-Za-z0-9_])?")
#: of what a path may have (RFC 3986, 3.3), but for what HTML would have to escape
_ROOT_PATH = re.compile(r"(/[A-Za-z0-9._~%!$()*+,;=:@-]+)*/?")
#: as the store of S3 reads them
_BUCKETS: Final = ("s3://", "s3a://")


def log_level(name: str) -> str:
    """A level by the one name that Celery knows it by too. Raises `ValueError` for what is none."""
    level = name.strip().upper()
    level = {"WARN": "WARNING", "FATAL": "CRITICAL"}.get(level, level)
    if level not in _LOG_LEVELS:
        raise ValueError(f"{name!r} is none of {', '.join(_LOG_LEVELS)}")
    return level


def broker_url(url: str) -> str:
    """An address of Redis, or none. Raises `ValueError` for any other, which is not told: it may hold a password."""
    if not url or url.startswith("filesystem://"):
        return url
    parts = urlsplit(url)
    try:
        is_one = parts.scheme in {"redis", "rediss"} and parts.hostname and (parts.port or True)
        if parts.scheme == "redis+socket" and parts.path.strip("/"):  # of this machine, by the path of a socket
            return url
    except ValueError:  # its port is no number
        is_one = False
    if not is_one or not re.fullmatch(r"/?\d*", parts.path):
        raise ValueError(
            "it is not of the form redis://host:6379/0, or rediss:// for TLS, with the number of a database"
        )
    return url


def database_url(url: str) -> str:
    """An address of a database that the service knows, or none. Raises `ValueError` for others, which are not told."""
    if url and not _DATABASE_URL.fullmatch(url):
        raise ValueError("it is not of the form postgresql://user:password@host:5432/name; without one it is SQLite")
    return url


def storage_url(url: str) -> str:
    """A bucket, a folder, or none. Any other store would count as away for ever, and a mistyped one as a folder."""
    parts = urlsplit(url)
    if parts.scheme == "file":  # of this machine (RFC 8089)
        is_one = parts.netloc in {"", "localhost"} and parts.path.startswith("/")
    elif url.startswith(_BUCKETS):
        is_one = bool(parts.netloc)
    else:
        is_one = not parts.scheme
    if not is_one:
        raise ValueError("it is neither a folder nor of the form s3://bucket/prefix")
    return url


def folder(path: object) -> object:
    """A folder that is named: by an empty text it would be the one in which the process was started."""
    if path == "":
        raise ValueError("it names no folder")
    return path


def address(host: str) -> str:
    """Where to listen. An empty text would be all addresses, which nobody means who leaves a variable empty."""
    if not host.strip():
        raise ValueError("it names no address; 0.0.0.0 and :: stand for all")
    return host


def root_path(path: str) -> str:
    """A path as addresses begin with it, without a slash at its end; or none."""
    if not _ROOT_PATH.fullmatch(path):
        raise ValueError("it is not a path such as /faces")
    return path.rstrip("/")


def host_names(text: str) -> str:
    """Names and addresses of hosts, with commas, or `*`. Others are in no Host field, and would allow nobody."""
    for name in listed(text):
        if name != "*" and not _HOST_NAME.fullmatch(name) and not _is_address(name.strip("[]")):
            raise ValueError(f"{name} is not the name of a host, without scheme and port, such as faces.example")
    return text


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def origins(text: str) -> str:
    """Origins of web pages, with commas."""
    for origin in listed(text):
        name = origin.lower().rstrip("/")
        parts = urlsplit(name)
        if parts.scheme in _NO_PAGES or name != f"{parts.scheme}://{parts.netloc}" or not parts.netloc:
            raise ValueError(f"{origin} is not an origin, such as https://studio.example")
    return text


def networks(text: str) -> str:
    """Networks of IPv4 and IPv6, with commas."""
    for network in listed(text):
        try:
            ipaddress.ip_network(network)
        except ValueError as error:
            raise ValueError(f"{network} is not a network, such as 10.1.2.0/24") from error
    return text


def listed(text: str) -> list[str]:
    """What stands between commas, but for what is empty."""
    return [part.strip() for part in text.split(",") if part.strip()]
