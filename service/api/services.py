"""What one running API holds."""

from __future__ import annotations

from dataclasses import dataclass

from service.catalog import Clock, Database, utc_now
from service.queue import Publisher, make_folders
from service.reaper import Reaper
from service.settings import Settings
from service.storage import Storage


@dataclass(frozen=True)
class Services:
    """The parts of one running API."""

    settings: Settings
    database: Database
    storage: Storage
    publisher: Publisher
    reaper: Reaper


def make_services(settings: Settings, *, clock: Clock = utc_now) -> Services:
    """The parts of an API, not started yet. Raises `OSError` when its folders cannot be made."""
    make_folders(settings)
    database = Database(settings.database, clock=clock)
    storage = Storage(settings)
    publisher = Publisher(settings, database)
    return Services(settings, database, storage, publisher, Reaper(settings, database, storage, publisher))
