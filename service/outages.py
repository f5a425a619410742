"""Which errors mean that the database or the storage is away, or full, for a while, and not that we are wrong."""

from __future__ import annotations

import errno
import re
import sqlite3
from typing import Final

from obstore.exceptions import BaseError, GenericError, JoinError, PermissionDeniedError, UnauthenticatedError
from sqlalchemy.exc import DBAPIError
from sqlalchemy.exc import TimeoutError as PoolTimeoutError

_SQLITE_LOCKED: Final = frozenset({sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED})
_SQLITE_AWAY: Final = _SQLITE_LOCKED | {sqlite3.SQLITE_IOERR, sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_PROTOCOL}
#: SQLSTATEs, by their beginning: connection lost, no resources, server stops or starts, serialisation and deadlocks,
#: a lock that is not had in time, a server that only reads since another took over, a transaction that stood still
_SERVER_AWAY: Final = ("08", "53", "57", "40", "55P03", "25006", "25P03")
#: errors of psycopg that have no SQLSTATE
_OF_CONNECTIONS: Final = frozenset({"OperationalError", "InterfaceError", "ConnectionTimeout"})
#: what a server that speaks English says of them; a connection that fails has no SQLSTATE
_REFUSED: Final = re.compile(r"FATAL:.*(authentication failed|does not exist)|no password supplied")
_SERVER_LOCKED: Final = "55P03"
_SERVER_FULL: Final = "53100"
_FULL: Final = frozenset({errno.ENOSPC, errno.EDQUOT})
#: a store whose credentials are being changed refuses for a while
_STORE_AWAY: Final = (GenericError, JoinError, PermissionDeniedError, UnauthenticatedError)
#: what a store that was asked answers, and its word for why
_STATUS: Final = re.compile(r"status code: (\d{3}(?: [A-Z][A-Za-z]*)*)")
_CODE: Final = re.compile(r"<Code>([A-Za-z]{1,64})</Code>")
#: what may stand below the first line of a store's error, and what it means
_CAUSES: Final = (
    ("BadScheme", "http is allowed by AWS_ALLOW_HTTP=true alone"),
    ("ConnectionRefused", "connection refused"),
    ("dns error", "its name is not known"),
    ("Certificate", "its certificate is not trusted"),
    ("TimedOut", "no answer in time"),
)
#: the modules of what the broker's errors are, and how Redis' own begin
_BROKERS: Final = ("kombu.", "redis.")
_REDIS_CODE: Final = re.compile(r"[A-Z]{4,}\b")
#: a word that is no address, path, id or time
_WORD: Final = re.compile(r"`?[A-Za-z][a-z'-]*`?[,.:;]?|[A-Z]{2,8}:?,?|S3|ETag|\.[a-z]+:")


def is_outage(error: BaseException) -> bool:
    """True when the same call may succeed later, without anybody changing it."""
    if isinstance(error, DBAPIError):
        return error.connection_invalidated or _is_away(error.orig, in_statement=error.statement is not None)
    return isinstance(error, PoolTimeoutError) or (isinstance(error, BaseError) and isinstance(error, _STORE_AWAY))


def is_refusal(error: DBAPIError) -> bool:
    """True when a server knows no such user, password or database: it answers, and will not answer otherwise."""
    return _REFUSED.search(str(error.orig)) is not None


def is_locked(error: BaseException) -> bool:
    """True when a writer has waited in vain for another one; nothing was changed."""
    if not isinstance(error, DBAPIError):
        return False
    code = _sqlite_code(error.orig)
    return code in _SQLITE_LOCKED if code is not None else getattr(error.orig, "sqlstate", None) == _SERVER_LOCKED


def is_partly_locked(error: BaseException) -> bool:
    """The same of a server, where others keep some rows, or a table, and no more; SQLite is locked as a whole."""
    return is_locked(error) and _sqlite_code(getattr(error, "orig", None)) is None


def is_disk_full(error: BaseException) -> bool:
    """True when there was no room to write: on this machine's disk, or on that of the database's server."""
    if isinstance(error, DBAPIError):
        code = _sqlite_code(error.orig)
        return code == sqlite3.SQLITE_FULL or getattr(error.orig, "sqlstate", None) == _SERVER_FULL
    return getattr(error, "errno", None) in _FULL


def told(error: BaseException) -> dict[str, str]:
    """How a log line tells an error: its kind, and of a store's or the broker's also the reason.

    That is the end of its first line and what lies below it, without addresses, secrets and names of files. Of an
    answer that is quoted there, only the status and its code are told. Of a broker's error it is what led to it.
    """
    kind = {"error": type(error).__name__}
    if type(error).__module__.startswith(_BROKERS):
        return kind | {"reason": _cause(error)}
    if not isinstance(error, BaseError):
        return kind
    first, _, details = str(error).partition("\n")
    if status := _STATUS.search(first):
        said = [status[1], *_CODE.findall(f"{first}\n{details}")[:1]]
    else:
        words = [word if _WORD.fullmatch(word) else "…" for word in first.rpartition(" - ")[2].split()[:40]]
        said = [" ".join(words), *[meaning for word, meaning in _CAUSES if word in details][:1]]
    return kind | {"reason": "; ".join(said)}


def _cause(error: BaseException) -> str:
    """What led to an error: the words of the system, or its kind and the word of Redis for it, such as WRONGPASS."""
    seen: BaseException | None = error
    told = type(error).__name__
    while seen is not None:
        if isinstance(seen, OSError) and seen.strerror:
            return seen.strerror
        if type(seen).__module__.startswith(_BROKERS):
            code = _REDIS_CODE.match(str(seen))
            told = f"{type(seen).__name__} {code[0]}" if code else type(seen).__name__
        seen = seen.__cause__ or seen.__context__
    return told


def _is_away(error: BaseException | None, *, in_statement: bool) -> bool:
    code = _sqlite_code(error)
    if code is not None:
        return code in _SQLITE_AWAY
    state: str | None = getattr(error, "sqlstate", None)
    if state is not None:
        return state.startswith(_SERVER_AWAY)
    # psycopg's errors without a state are of the connection itself, or of a statement that it does not send, as one of
    # too many parameters: the connection that such a one leaves is as good as before
    is_psycopg = type(error).__module__.startswith("psycopg")
    return is_psycopg and type(error).__name__ in _OF_CONNECTIONS and not in_statement


def _sqlite_code(error: BaseException | None) -> int | None:
    """The primary result code of SQLite; None for another engine's error."""
    code: int | None = getattr(error, "sqlite_errorcode", None) if isinstance(error, sqlite3.Error) else None
    return None if code is None else code & 0xFF
