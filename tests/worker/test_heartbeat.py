"""A living worker says that it is there, and looks after the disk that may be nobody else's."""

from __future__ import annotations

import os
import time
from pathlib import Path

from sqlalchemy import select

from service.catalog import Database, workers
from service.catalog.models import Worker
from service.ids import new_id
from service.queue import make_folders
from service.settings import Settings
from tests.service.fixtures import add_media, claim
from tests.waiting import until
from worker.heartbeat import Heartbeat


def test_an_idle_worker_removes_what_a_killed_process_was_writing(database: Database, tmp_path: Path) -> None:
    """Of a worker on a machine of its own no API sees the disk, and the job may be done again elsewhere."""
    settings = Settings(data_dir=tmp_path / "data", database_url=database.url, heartbeat_s=0.05)
    make_folders(settings)
    at_work = add_media(database).job_id
    claim(database, at_work)
    of_a_killed_process = settings.spool_folder / f"{new_id('job')}-drawn.mp4"
    of_another = settings.spool_folder / f"{at_work}-drawn.mp4"
    for draft in (of_a_killed_process, of_another):
        draft.write_bytes(b"a face")
    heartbeat = Heartbeat(settings)
    heartbeat.start()
    until(lambda: not of_a_killed_process.exists())
    assert of_another.exists(), "its job is being done"
    with database.read() as session:
        assert workers.lacking(session, since=database.now().replace(year=2000)) == [None]
    heartbeat.stop()

    def left() -> bool:  # it is not waited for long
        with database.read() as session:
            return workers.lacking(session, since=database.now().replace(year=2000)) == []

    until(left)


def test_a_worker_that_begins_while_the_folder_of_the_files_is_away_beats_and_clears_its_disk(
    database: Database, tmp_path: Path
) -> None:
    mount = tmp_path / "mount"
    settings = Settings(
        data_dir=tmp_path / "data", database_url=database.url, storage_url=str(mount / "blobs"), heartbeat_s=0.05
    )
    settings.spool_folder.mkdir(parents=True)
    draft = settings.spool_folder / "drawn.mp4"
    draft.write_bytes(b"a face")
    os.utime(draft, times=(time.time() - 3600,) * 2)
    mount.touch()  # no folder can be made there
    heartbeat = Heartbeat(settings)
    heartbeat.start()
    beats = set()

    def beat_again() -> bool:
        with database.read() as session:
            beats.update(session.scalars(select(Worker.seen_at)))
        return len(beats) > 1

    until(beat_again)
    until(lambda: not draft.exists())
    heartbeat.stop()
