from __future__ import annotations

from contextlib import ExitStack
from datetime import timedelta

import pytest
from sqlalchemy.exc import IntegrityError

from service.api.rates import Rates
from service.catalog import Database, Key, amounts, keys, media, windows
from service.catalog.keys import Limits
from tests.service.fixtures import FakeClock, add_media


def make(database: Database, name: str = "studio", limits: Limits | None = None) -> tuple[Key, str]:
    with database.write() as session:
        return keys.create(session, name, limits or Limits(), now=database.now())


def found(database: Database, text: str) -> str | None:
    with database.read() as session:
        key = keys.find(session, text, now=database.now())
    return key and key.id


def test_a_key_is_found_by_its_whole_text_and_only_its_hash_is_stored(database: Database) -> None:
    key, text = make(database)
    assert found(database, text) == key.id
    secret = text.rpartition(key.id.removeprefix("key_") + "_")[2]
    assert len(secret) == 43
    assert secret not in str(vars(key))
    other = text[:-1] + ("A" if text[-1] != "A" else "B")
    for wrong in (other, text[:-1], f"{text} ", text.upper(), "", "pvg_", text.replace("pvg_", "pvg-")):
        assert found(database, wrong) is None
    with pytest.raises(IntegrityError):
        make(database)


def test_a_rotated_key_is_the_same_key_and_a_revoked_one_still_counts(database: Database) -> None:
    with database.read() as session:
        assert not keys.exist(session)
    key, former = make(database)
    with database.write() as session:
        text = keys.rotate(session.get_one(Key, key.id))
    assert (found(database, former), found(database, text)) == (None, key.id)
    with database.write() as session:
        assert keys.revoke(session, key, now=database.now())
        assert not keys.revoke(session, key, now=database.now())
        assert keys.exist(session)
    assert found(database, text) is None


def test_a_former_secret_is_good_for_as_long_as_is_said(database: Database, clock: FakeClock) -> None:
    """An application of many machines has its key changed on one after the other."""
    key, first = make(database)

    def rotate(overlap_s: float | None) -> str:
        until = None if overlap_s is None else clock() + timedelta(seconds=overlap_s)
        with database.write() as session:
            return keys.rotate(session.get_one(Key, key.id), former_until=until)

    def good(*texts: str) -> list[bool]:
        return [found(database, text) == key.id for text in texts]

    second = rotate(60)
    with database.read() as session:
        both = keys.seals(session, key.id, now=clock())
    assert good(first, second) == [True, True]
    third = rotate(60)
    assert good(first, second, third) == [False, True, True]
    clock.forward(61)
    assert good(second, third) == [False, True]
    with database.read() as session:
        assert len(keys.seals(session, key.id, now=clock())) == 1 < len(both)
    fourth = rotate(60)
    fifth = rotate(None)  # a secret that others know ends at once, and so does the one before
    assert good(third, fourth, fifth) == [False, False, True]


def test_what_belongs_to_nobody_is_given_to_a_key_but_for_what_it_has(database: Database) -> None:
    key, _ = make(database)
    theirs = add_media(database, content=b"same", owner=key.id)
    same, other = add_media(database, content=b"same"), add_media(database, content=b"other")
    with database.write() as session:
        assert keys.adopt(session, key) == (1, 1)
    with database.read() as session:
        owners = [session.get_one(type(one), one.id).owner for one in (theirs, same, other)]
        assert owners == [key.id, "", key.id]
        assert amounts.active_jobs(session, key.id) == 2  # the job of what stays, stays
        assert amounts.stored_bytes(session, key.id) == 20
        assert media.get(session, other.id, owner="") is None


def test_several_processes_never_grant_more_than_the_rate(database: Database, clock: FakeClock) -> None:
    key, _ = make(database, limits=Limits(requests_per_minute=60))
    with ExitStack() as stack:
        replicas = [Database(database.url, clock=clock) for _ in range(3)]
        for one in replicas:
            stack.callback(one.close)
        processes = [Rates(one) for one in replicas]
        standings = [processes[i % 3].take(key.id, 60) for i in range(100)]
        assert sum(one.granted for one in standings) == 60
        assert all(
            one.granted for one in standings[:54]
        )  # what others hold of their last shares is not lost, only late
        assert standings[-1].left == 0
        assert 1 <= standings[-1].resets_s <= 60
        clock.forward(60)
        assert processes[0].take(key.id, 60).granted


def test_a_clock_that_is_set_back_keeps_no_key_out(database: Database, clock: FakeClock) -> None:
    key, _ = make(database, limits=Limits(requests_per_minute=60))
    rates, other = Rates(database), Rates(database)
    assert sum(rates.take(key.id, 60).granted for _ in range(100)) == 60
    clock.forward(-3600)
    assert rates.take_held(key.id, 60) is None
    standings = [one.take(key.id, 60) for one in (rates, other) for _ in range(60)]
    assert sum(one.granted for one in standings) == 60  # and the limit holds
    assert max(one.resets_s for one in standings) <= 60
    clock.forward(60)
    assert rates.take(key.id, 60).granted


def test_a_process_whose_clock_is_a_little_behind_counts_with_the_others(database: Database, clock: FakeClock) -> None:
    key, _ = make(database, limits=Limits(requests_per_minute=60))
    rates = Rates(database)
    assert sum(rates.take(key.id, 60).granted for _ in range(60)) == 60
    clock.forward(-60)
    assert not Rates(database).take(key.id, 60).granted


def test_a_rate_costs_a_process_few_writes(database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    key, _ = make(database)
    taken = 0
    original = windows.take_share

    def counted(*args: object, **options: object) -> windows.Share:
        nonlocal taken
        taken += 1
        return original(*args, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(windows, "take_share", counted)
    rates = Rates(database)
    assert sum(rates.take(key.id, 600).granted for _ in range(1000)) == 600
    assert taken <= 21
