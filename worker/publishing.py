"""Looks that are drawn, and their end: they are named, stored and recorded, and the job ends with them."""

from __future__ import annotations

import unicodedata
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path

from service.catalog import Look, Media, Output, PartName, PartOf, Report, content_type_of, media, results
from service.ids import new_id
from worker.run import Run
from worker.unpublished import Unpublished


@dataclass(frozen=True)
class DrawnExtra:
    """A part of a look as a file, not yet stored; see `PartOf`."""

    part: PartName
    person: int
    path: Path


@dataclass(frozen=True)
class DrawnLook:
    """One look as a file, not yet stored, and what was made beside it."""

    look: Look
    path: Path
    report: Report
    extras: tuple[DrawnExtra, ...]


def publish(run: Run, drawn: list[DrawnLook], present: dict[str, Media]) -> bool:
    """Store the looks and end the job with them. False when its lease was lost: nothing was published."""
    names = names_of_files(drawn, present)
    with Unpublished(run) as unpublished:
        with run.timed("store_s"):
            outputs = [output for one in drawn for output in _store(unpublished, one, names[one.look.position])]
        return unpublished.record(lambda: _record(run, outputs, present))


def _record(run: Run, outputs: list[Output], present: Collection[str]) -> bool:
    """End the job with its outputs, whose media are ``present`` and are used until then: results go with them.

    True as well when a call before has done so, and its answer was lost.
    """
    with run.database.write() as session:
        now = run.database.now()
        used = media.locked(session, present)  # before the job, as who asks for looks of them does
        published = results.publish(
            session, run.lease, outputs, now=now, timings=run.timings, ttl_s=run.settings.result_ttl_s
        )
        if published:
            media.use(used, now=now, ttl_s=run.settings.media_ttl_s)
        return published or (bool(outputs) and results.get(session, outputs[0].result_id) is not None)


def names_of_files(drawn: Collection[DrawnLook], present: dict[str, Media]) -> dict[int, tuple[str, ...]]:
    """What the files of a job's looks are called, by the looks' positions: each result's, then those of its extras.

    They are made of the names of video and reference. Of looks that would share a name the first in order has it, and
    those after it have a number, which no other look's own name ends with. All of a job are distinct, also where a
    folder tells no case.
    """
    looks = sorted(drawn, key=lambda one: one.look.position)
    stems = [f"{_stem(present[one.look.video_id])}-{_stem(present[one.look.reference_id])}" for one in looks]
    own = set().union(*(_as_compared(_names(one, stem)) for one, stem in zip(looks, stems, strict=True)))
    names: dict[int, tuple[str, ...]] = {}
    taken: set[str] = set()
    for one, stem in zip(looks, stems, strict=True):
        found, number = _names(one, stem), 1
        while not taken.isdisjoint(_as_compared(found)) or (number > 1 and not own.isdisjoint(_as_compared(found))):
            number += 1
            found = _names(one, f"{stem}-{number}")
        names[one.look.position] = found
        taken |= _as_compared(found)
    return names


def _names(drawn: DrawnLook, stem: str) -> tuple[str, ...]:
    return f"{stem}{drawn.path.suffix}", *(f"{stem}-{extra.path.name}" for extra in drawn.extras)


def _as_compared(names: Collection[str]) -> set[str]:
    """As file systems compare names that tell neither case nor how a letter is composed."""
    return {unicodedata.normalize("NFC", unicodedata.normalize("NFC", name).casefold()) for name in names}


def _store(unpublished: Unpublished, drawn: DrawnLook, names: tuple[str, ...]) -> Iterator[Output]:
    """Store a look and what was made beside it, under these names."""
    look = drawn.look
    main = _stored(unpublished, look, drawn.path, names[0], report=drawn.report)
    yield main
    for extra, name in zip(drawn.extras, names[1:], strict=True):
        part_of = PartOf(main.result_id, extra.part, extra.person)
        yield _stored(unpublished, look, extra.path, name, part_of=part_of)


def _stored(
    unpublished: Unpublished,
    look: Look,
    path: Path,
    filename: str,
    *,
    report: Report | None = None,
    part_of: PartOf | None = None,
) -> Output:
    result_id = new_id("res")
    file = unpublished.store("result", path, result_id, path.suffix)
    return Output(
        result_id=result_id,
        position=look.position,
        key=file.key,
        sha256=file.sha256,
        size_bytes=file.size_bytes,
        content_type=content_type_of(path.suffix),
        filename=filename,
        report=report,
        part_of=part_of,
    )


def _stem(medium: Media) -> str:
    return Path(medium.filename).stem[:80] if medium.filename else medium.id
