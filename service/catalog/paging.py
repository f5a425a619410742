"""Pages of records, newest first."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import TypeVar

from sqlalchemy import ColumnElement, select, union_all
from sqlalchemy.orm import Session

from service.catalog.models import Job, Media

Row = TypeVar("Row", Job, Media)


def newest(
    session: Session, model: type[Row], chosen: Sequence[ColumnElement[bool]], states: Collection[str], *, limit: int
) -> list[Row]:
    """At most ``limit`` rows for which all of ``chosen`` hold, in one of ``states`` if any are named; ids tell the age.

    Each state is asked for by itself: an index has the rows of one in the order of their ids, those of several it has
    not, and all of them would be read and sorted.
    """
    query = select(model).order_by(model.id.desc()).limit(limit)
    asked = sorted(set(states))
    if len(asked) > 1:
        first = select(model.id).where(*chosen).order_by(model.id.desc()).limit(limit)
        each = [first.where(model.state == state).subquery() for state in asked]
        return list(session.scalars(query.where(model.id.in_(union_all(*(select(one.c.id) for one in each))))))
    of_state = [model.state == state for state in asked]
    return list(session.scalars(query.where(*chosen, *of_state)))
