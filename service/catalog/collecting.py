"""Searches for files that no record names: whose files they are, when the last one began, and why there is none.

The database has an id of its own and counts its searches. The store carries both in a file, see `Mark`. So a search
knows the files of another database, and that its own records are older than the files: a backup was restored.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Final, Self

from sqlalchemy import or_, select, update
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from service.catalog.database import changed
from service.catalog.models import Collection
from service.ids import uuid7_hex

_ONLY: Final = 1


@dataclass(frozen=True)
class Mark:
    """Which database searched a store last, and how many searches that had begun by then."""

    database_id: str
    number: int

    def __str__(self) -> str:
        return f"{self.database_id} {self.number}\n"

    @classmethod
    def read(cls, text: str) -> Self:
        """What `str` makes. Text that is no mark is that of a database which nobody has."""
        database_id, _, number = text.strip().partition(" ")
        return cls(database_id, int(number)) if number.isascii() and number.isdecimal() else cls("", 0)


def begin(session: Session, *, now: datetime, unless_since: datetime) -> bool:
    """A search begins. False when one has begun after ``unless_since``, by whichever process."""
    _only(session)
    is_late = or_(Collection.began_at.is_(None), Collection.began_at <= unless_since)
    due = update(Collection).where(Collection.id == _ONLY, is_late)
    return changed(session, due.values(began_at=now)) == 1


def mark(session: Session) -> Mark:
    """What the store should carry."""
    row = _only(session)
    return Mark(row.database_id, row.number)


def was_marked(session: Session) -> bool:
    """The store has carried a mark of this database: a search ended well, and wrote it before it was counted."""
    return bool(session.scalar(select(Collection.number)))


def next_mark(session: Session, *, after: int = 0) -> Mark:
    """What the store is to carry from now on: nothing is in the way of a search. Its number is above ``after``."""
    row = _only(session, locked=True)
    row.number = max(row.number, after) + 1
    row.halted = None
    session.flush()
    return Mark(row.database_id, row.number)


def halt(session: Session, why: str) -> None:
    """Nothing is removed, for this reason, a word or two."""
    _only(session, locked=True).halted = why


def halted(session: Session) -> str | None:
    """Why nothing is removed; None when nothing is in the way."""
    return session.scalar(select(Collection.halted))


def _only(session: Session, *, locked: bool = False) -> Collection:
    """The row. It is made when it is asked for first: a database that is only prepared may be copied."""
    if session.get(Collection, _ONLY) is None:
        try:
            with session.begin_nested():
                session.add(Collection(id=_ONLY, database_id=uuid7_hex(), number=0))
        except IntegrityError:
            pass  # another process was first
    return session.get_one(Collection, _ONLY, with_for_update=locked, populate_existing=True)
