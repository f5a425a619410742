"""What one running API holds."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from functools import partial

from service.api import lookups
from service.api.arriving import Arriving
from service.api.calls import LOCK_WAIT_S, Calls
from service.api.fetches import Fetches
from service.api.forecasts import Forecasts
from service.api.meters import Meters
from service.api.places import Places
from service.api.probes import Probe
from service.api.quotas import Lately
from service.api.rates import LinkRates, Rates
from service.api.signing import Signer
from service.api.streams import Streams
from service.api.waiting import JobWatch, PreviewWatch, Snapshot
from service.blobs import Blobs, was_marked
from service.catalog import Clock, Database, Preview, jobs, previews
from service.catalog.jobs import Standing
from service.collector import Collector
from service.egress import Egress
from service.queue import RENDER, Publisher, make_folders
from service.reaper import Reaper
from service.room import Room
from service.settings import Settings
from service.storage import Storage
from service.webhooks import Deliverer


@dataclass
class Known:
    """What the records said last, for while they are away. Until they were read once, the stricter value holds."""

    has_keys: bool = True


@dataclass(frozen=True, kw_only=True)
class Services:
    """The parts of one running API.

    ``database`` is that of the requests, whose threads wait for no lock; ``calls`` says where to use it. The reaper,
    the collector and the publisher have threads of their own, and a database that waits.
    """

    settings: Settings
    database: Database
    background: Database
    storage: Storage
    room: Room
    blobs: Blobs
    publisher: Publisher
    reaper: Reaper
    collector: Collector
    rates: Rates
    link_rates: LinkRates
    arriving: Arriving
    calls: Calls
    watch: JobWatch
    previews: PreviewWatch
    streams: Streams
    places: Places
    egress: Egress
    fetches: Fetches
    deliverer: Deliverer
    signer: Signer
    forecasts: Forecasts
    #: what keys were found to keep
    lately: Lately
    meters: Meters
    known: Known
    #: what /readyz asks
    probes: tuple[Probe, Probe, Probe]

    def close(self) -> None:
        """Close the connections to the database, and let the threads of requests to others go."""
        self.egress.close()
        self.database.close()
        self.background.close()


def make_services(settings: Settings, *, clock: Clock | None = None) -> Services:
    """The parts of an API, not started yet. Raises `OSError` when its folders cannot be made."""
    make_folders(settings)
    room = Room(settings)
    database = Database(settings.database, clock=clock, lock_wait_s=LOCK_WAIT_S, before_freeing=room.give_back)
    background = Database(settings.database, clock=clock, before_freeing=room.give_back)
    storage = Storage(settings, was_marked=partial(was_marked, database))
    publisher = Publisher(settings, background)
    calls = Calls()

    forecasts = Forecasts(settings, database)

    def load(job_ids: Collection[str]) -> dict[str, Snapshot]:
        return load_snapshots(database, job_ids, settings, room, forecasts)

    def stand(job_ids: Collection[str]) -> dict[str, Standing]:
        with database.read() as session:
            return jobs.standings(session, job_ids)

    return Services(
        settings=settings,
        database=database,
        background=background,
        storage=storage,
        room=room,
        blobs=Blobs(database, storage),
        publisher=publisher,
        reaper=Reaper(settings, background, storage, room, Blobs(background, storage), publisher),
        collector=Collector(settings, background, storage),
        rates=Rates(database),
        link_rates=LinkRates(),
        arriving=Arriving(calls, database),
        calls=calls,
        watch=JobWatch(calls, stand, load),
        previews=PreviewWatch(calls, partial(load_previews, database)),
        streams=Streams(settings.max_connections // 2),
        places=Places(max(1, settings.max_connections // 4)),
        egress=Egress(settings),
        fetches=Fetches(),
        # one of its own: receivers whose names resolve slowly hold up no file that is fetched
        deliverer=Deliverer(settings, background, Egress(settings)),
        signer=Signer(settings, database.now),
        forecasts=forecasts,
        lately=Lately(),
        meters=Meters(),
        known=Known(),
        probes=(
            Probe("database", calls, database.ping),
            Probe("storage", calls, storage.ping),
            Probe("broker", calls, lambda: publisher.depth(RENDER)),
        ),
    )


def load_snapshots(
    database: Database, job_ids: Collection[str], settings: Settings, room: Room, forecasts: Forecasts
) -> dict[str, Snapshot]:
    """How each of these jobs stands, with the answer that shows it, by id."""
    with database.read() as session:
        found = jobs.every(session, job_ids)
        bodies = lookups.of_jobs(settings, room, session, found, forecasts=forecasts)
    return {
        job.id: Snapshot(
            jobs.standing_of(job), body.model_dump_json().encode(), None if body.queue is None else body.queue.position
        )
        for job, body in zip(found, bodies, strict=True)
    }


def load_previews(database: Database, preview_ids: Collection[str]) -> tuple[Collection[Preview], Collection[str]]:
    """Those of these pictures that have ended, and the ids of those that are still there."""
    with database.read() as session:
        return previews.ended(session, preview_ids), previews.existing(session, preview_ids)
