"""Connections and transactions, the same way on SQLite and PostgreSQL."""

from __future__ import annotations

import math
import shutil
import sqlite3
import threading
import time
from collections import defaultdict, deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from datetime import datetime
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, Final, cast

import structlog
from sqlalchemy import Connection, CursorResult, Engine, Executable, create_engine, event, text
from sqlalchemy.engine import make_url
from sqlalchemy.engine.interfaces import DBAPIConnection, DBAPICursor, ExceptionContext
from sqlalchemy.exc import OperationalError
from sqlalchemy.orm import Session
from sqlalchemy.pool import ConnectionPoolEntry

from service.catalog.clock import Clock, ServerClock, utc_now

log = structlog.get_logger(__name__)

#: seconds that a writer waits for another one
LOCK_WAIT_S = 15.0
#: what a server is told of each session, in milliseconds, and seconds for the keepalives: it notices that a machine has
#: lost its power or its network, and what that had locked is free again before the leases that it renewed last are
#: over. No transaction here stands still for as long
_OF_SESSIONS: Final = {
    "idle_in_transaction_session_timeout": 20_000,
    "tcp_keepalives_idle": 10,
    "tcp_keepalives_interval": 5,
    "tcp_keepalives_count": 2,
    "tcp_user_timeout": 20_000,
}
#: seconds to connect to a database server, and to get one of the connections that are open
_CONNECT_S = 3
_POOL_S = 5.0
#: a file of SQLite is written anew after so many seconds, or so many times as long as that takes
_REWRITE_S: Final = 3600.0
_REWRITE_SHARE: Final = 1000
#: what has to be free for that, in its own sizes: a copy and the log take one each
_REWRITE_SIZES: Final = 3
#: values in one statement
_BATCH: Final = 500
#: steps before the commit, in `Session.info`
_LAST: Final = "last_steps"


class _Line:
    """A lock that is had in the order in which it was asked for.

    A `threading.Lock` goes to whoever comes first once it is free: of several threads that want it all the time, one
    is overtaken again and again.
    """

    def __init__(self) -> None:
        self._guard = threading.Lock()
        self._taken = False
        #: of each that waits, a lock that is opened when it is its turn
        self._waiting: deque[threading.Lock] = deque()

    def acquire(self, timeout_s: float) -> bool:
        """Take it; False when others have it for longer than that."""
        with self._guard:
            if not self._taken:
                self._taken = True
                return True
            mine = threading.Lock()
            mine.acquire()
            self._waiting.append(mine)
        if mine.acquire(timeout=timeout_s):
            return True
        with self._guard:
            if mine in self._waiting:
                self._waiting.remove(mine)
                return False
        return True  # handed over at the last moment

    def release(self) -> None:
        """Hand it to the next in line."""
        with self._guard:
            if self._waiting:
                self._waiting.popleft().release()
            else:
                self._taken = False


#: one for each SQLite database, by its URL
_turns: defaultdict[str, _Line] = defaultdict(_Line)


class _WritersTurn:
    """Lets the writers of this process on one SQLite database take turns, each for as long as its block.

    A SQLite writer that finds another one at work looks again after a sleep, up to 0.1 s later: of several threads that
    write all the time, one waits for many such sleeps. Raises what SQLite raises when the wait takes longer than
    ``wait_s``.
    """

    def __init__(self, url: str, wait_s: float) -> None:
        self._wait_s = wait_s
        self._line = _turns[url]

    def __enter__(self) -> None:
        if not self._line.acquire(self._wait_s):
            locked = sqlite3.OperationalError("database is locked")
            locked.sqlite_errorcode, locked.sqlite_errorname = sqlite3.SQLITE_BUSY, "SQLITE_BUSY"
            raise OperationalError("BEGIN IMMEDIATE", None, locked)

    def __exit__(self, *_: object) -> None:
        self._line.release()


class Database:
    """The catalog's database.

    `read` and `write` open one transaction each; `write` commits at the end of the block and rolls back on an
    error. On SQLite a writer takes its lock at once (BEGIN IMMEDIATE): one that starts as a reader and upgrades
    fails without waiting when another writes. A writer waits ``lock_wait_s`` for others, then raises.
    ``before_freeing`` runs before one that ``frees``: that deletes, cancels or expires. It may make room for it.

    `now` is the database's time: a server's own; that of this machine for SQLite, all of whose users are on it. Tests
    give a ``clock`` that moves when told to.
    """

    def __init__(
        self,
        url: str,
        *,
        clock: Clock | None = None,
        lock_wait_s: float = LOCK_WAIT_S,
        before_freeing: Callable[[], None] = lambda: None,
    ) -> None:
        self.url = url
        self._engine = make_engine(url, lock_wait_s=lock_wait_s)
        self._writer = self._engine.execution_options(pvg_writes=True)
        is_sqlite = self._engine.dialect.name == "sqlite"
        self._server = None if is_sqlite else ServerClock()
        self.now: Clock = clock or self._now
        self._before_freeing = before_freeing
        self._turn = _WritersTurn(url, lock_wait_s) if is_sqlite else nullcontext()
        self._lock_wait_s = lock_wait_s
        self._closed = False
        self._rewrite_at = -math.inf
        event.listen(self._engine, "checkin", self._close_when_closed)

    @contextmanager
    def read(self) -> Iterator[Session]:
        """A transaction that changes nothing."""
        with Session(self._engine, expire_on_commit=False) as session:
            self._set_clock(session)
            yield session

    @contextmanager
    def write(self, *, frees: bool = False) -> Iterator[Session]:
        """A transaction that is committed when the block ends."""
        if frees:
            self._before_freeing()
        with self._turn, Session(self._writer, expire_on_commit=False) as session, session.begin():
            self._set_clock(session)
            yield session
            _take_last_steps(session)

    def _now(self) -> datetime:
        if self._server is None:
            return utc_now()
        known = self._server.now()
        if known is None:
            with self.read():
                known = self._server.now()
        assert known is not None, "reading asks for the time"  # noqa: S101
        return known

    def _set_clock(self, session: Session) -> None:
        if self._server is not None and self._server.is_due:
            self._server.ask(session.connection())

    def ping(self) -> None:
        """Raise when the database does not answer."""
        with self._engine.connect() as connection:
            connection.execute(text("SELECT 1"))

    def forget(self, *, wholly: bool = False) -> None:
        """Remove what was deleted from the files of SQLite too; while others read or write, try again later.

        The rows are overwritten in the database's file, but pages of before wait in its log until they are copied: the
        log is emptied. And where rows moved from page to page, SQLite leaves copies of them behind, which outlive the
        rows: the file is written anew, ``wholly`` now, else when that is due.
        """
        if self._engine.dialect.name != "sqlite":
            return
        connection = self._engine.raw_connection()
        try:
            cursor = connection.cursor()
            try:
                if wholly or self._may_rewrite(cursor):
                    self._rewrite(cursor)
            finally:
                self._empty_log(cursor)
        finally:
            connection.close()

    def _empty_log(self, cursor: DBAPICursor) -> None:
        cursor.execute("PRAGMA busy_timeout=500")
        try:
            cursor.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        finally:  # the next one who has this connection waits for its turn as all do
            cursor.execute(f"PRAGMA busy_timeout={round(self._lock_wait_s * 1000)}")

    def _may_rewrite(self, cursor: DBAPICursor) -> bool:
        """Writing the file anew is due. Where that would fill the disk it is put off, for others need it."""
        if (now := time.monotonic()) < self._rewrite_at:
            return False
        cursor.execute("PRAGMA database_list")
        file = Path(cursor.fetchall()[0][2])
        size_bytes, free_bytes = file.stat().st_size, shutil.disk_usage(file).free
        if free_bytes >= _REWRITE_SIZES * size_bytes:
            return True
        log.warning("no room to write the file of SQLite anew", size_bytes=size_bytes, free_bytes=free_bytes)
        self._rewrite_at = now + _REWRITE_S
        return False

    def _rewrite(self, cursor: DBAPICursor) -> None:
        """Write the file anew, with what the tables hold and nothing else. Nobody else writes meanwhile."""
        with self._turn:
            began = time.monotonic()
            try:
                cursor.execute("VACUUM")
            except sqlite3.Error as error:  # who calls knows those of statements that are made of SQLAlchemy
                raise OperationalError("VACUUM", None, error) from error
            took_s = time.monotonic() - began
        self._rewrite_at = began + max(_REWRITE_S, _REWRITE_SHARE * took_s)

    def close(self) -> None:
        """Close every pooled connection, and those in use once they come back."""
        self._closed = True
        self._engine.dispose()

    def _close_when_closed(self, connection: DBAPIConnection, record: ConnectionPoolEntry) -> None:
        if self._closed:
            record.invalidate()


def make_engine(url: str, *, lock_wait_s: float = LOCK_WAIT_S) -> Engine:
    """An engine with the settings each database engine needs."""
    parsed = make_url(url)
    if parsed.get_backend_name() != "sqlite":
        # a server that is gone is noticed: no call waits for it for longer than a few seconds
        patience = {"connect_timeout": _CONNECT_S, "tcp_user_timeout": 10_000, "keepalives_idle": 10}
        given = {name: value for name, value in patience.items() if name not in parsed.query}
        engine = create_engine(
            url,
            connect_args=given,
            pool_pre_ping=True,
            pool_size=20,
            max_overflow=20,
            pool_timeout=_POOL_S,
            hide_parameters=True,  # an error ends in the log; secrets, names of files and metadata do not
        )
        event.listen(engine, "connect", partial(_prepare_server, round(lock_wait_s * 1000)))
        event.listen(engine, "handle_error", _hide_row)
        return engine
    if parsed.database and parsed.database != ":memory:":
        Path(parsed.database).parent.mkdir(parents=True, exist_ok=True)
    engine = create_engine(
        url,
        connect_args={"timeout": lock_wait_s, "check_same_thread": False},
        pool_size=20,
        max_overflow=20,
        pool_timeout=_POOL_S,
        hide_parameters=True,
    )
    if parsed.database and parsed.database != ":memory:":
        event.listen(engine, "first_connect", partial(_place_copies, Path(parsed.database).resolve().parent))
    event.listen(engine, "connect", _prepare_sqlite)
    event.listen(engine, "begin", _begin_sqlite)
    return engine


def _prepare_server(lock_wait_ms: int, connection: DBAPIConnection, _: ConnectionPoolEntry) -> None:
    cursor = connection.cursor()
    wanted = {"lock_timeout": lock_wait_ms, **_OF_SESSIONS}
    cursor.execute("; ".join(f"SET {name} = {value:d}" for name, value in wanted.items()))
    cursor.close()
    connection.commit()


def _hide_row(context: ExceptionContext) -> None:
    """PostgreSQL says of a row that it refuses what is in it, which `hide_parameters` leaves."""
    detail: str | None = getattr(getattr(context.original_exception, "diag", None), "message_detail", None)
    for error in (context.original_exception, context.sqlalchemy_exception):
        if detail and error is not None:
            error.args = tuple(str(part).replace(detail, "hidden") for part in error.args)


def _place_copies(folder: Path, connection: DBAPIConnection, _: ConnectionPoolEntry) -> None:
    """Have SQLite's temporary files beside its database.

    The file as it is written anew is one, with all that the database holds: `/tmp` may be open to more people, lie on a
    disk that is not encrypted, or have no room for it. A folder that cannot be written is told by what writes there.
    """
    cursor = connection.cursor()
    cursor.execute("PRAGMA temp_store_directory")
    # it is one for the whole process, and not to be set again beside those who use it
    if cursor.fetchone() != (str(folder),):
        quoted = str(folder).replace("'", "''")  # it takes no parameters
        with suppress(sqlite3.OperationalError):
            cursor.execute(f"PRAGMA temp_store_directory = '{quoted}'")
    cursor.close()


def _prepare_sqlite(connection: DBAPIConnection, _: ConnectionPoolEntry) -> None:
    connection.isolation_level = None  # BEGIN is sent by _begin_sqlite
    cursor = connection.cursor()
    cursor.execute("PRAGMA journal_mode=WAL")
    cursor.execute("PRAGMA synchronous=NORMAL")
    cursor.execute("PRAGMA foreign_keys=ON")
    cursor.execute("PRAGMA secure_delete=ON")  # what a removed row held is overwritten
    cursor.close()


def _begin_sqlite(connection: Connection) -> None:
    writes = connection.get_execution_options().get("pvg_writes", False)
    connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")


def in_batches(values: Iterable[str]) -> Iterator[list[str]]:
    """Values for a statement, some at a time: a server takes 65,535 parameters in one."""
    left = iter(values)
    while batch := list(islice(left, _BATCH)):
        yield batch


def at_last(session: Session, step: Callable[[Session], None]) -> None:
    """Have a step taken once all else of a transaction of `Database.write` is done, right before its commit.

    A step that is asked for again is taken once. It is for rows that many transactions change: they are locked for as
    long as a commit takes, and by one that waits for no other lock.
    """
    session.info.setdefault(_LAST, {})[step] = None


def _take_last_steps(session: Session) -> None:
    if not session.in_transaction():  # it was rolled back, with all that the steps are for
        return
    session.flush()  # what is not written yet is locked before them, too
    steps: dict[Callable[[Session], None], None] = session.info.pop(_LAST, {})
    for step in steps:
        step(session)


def changed(session: Session, statement: Executable) -> int:
    """Run an UPDATE or DELETE and say how many rows it changed."""
    result = session.execute(statement, execution_options={"synchronize_session": False})
    return int(cast("CursorResult[Any]", result).rowcount)
