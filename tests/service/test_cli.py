from __future__ import annotations

import ast
import os
import re
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager
from datetime import timedelta
from pathlib import Path

import pytest
from click.testing import Result
from sqlalchemy.exc import OperationalError
from typer.testing import CliRunner

from service.catalog import Database, keys, utc_now
from service.catalog.models import MonthlyUsage
from service.cli import _have_keys, cli
from service.key_commands import _named
from service.settings import Settings
from tests.service.fixtures import make_tables
from tests.service.servers import fresh_database, postgres_of_our_own
from tests.waiting import until
from tests.worker.serving import COMMAND, started


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.1.5", "example.com"])
def test_any_other_address_is_refused_without_keys(host: str, tmp_path: Path) -> None:
    assert not Settings(host=host).listens_to_loopback_only
    environment = {"PVG_HOST": host, "PVG_DATA_DIR": str(tmp_path / "data")}
    result = CliRunner().invoke(cli, ["serve"], env=environment)
    assert result.exit_code == 2
    assert "PVG_ALLOW_UNAUTHENTICATED_NETWORK" in result.output
    assert not (tmp_path / "data").exists()


def test_keys_are_made_listed_limited_rotated_and_revoked(tmp_path: Path) -> None:
    environment = {"PVG_DATA_DIR": str(tmp_path / "data"), "PVG_HOST": "0.0.0.0"}

    def run(*arguments: str, code: int = 0) -> str:
        result = CliRunner().invoke(cli, ["keys", *arguments], env=environment)
        assert result.exit_code == code, result.output
        return result.output

    assert "migrate" in run("list", code=2)
    where, warning, text = run("create", "studio", "--rate", "5").splitlines()
    assert where == f"a key in sqlite:///{tmp_path / 'data' / 'catalog.sqlite3'}"
    assert warning.startswith("that database was made just now")
    assert re.fullmatch(r"pvg_[0-9a-f]{32}_[A-Za-z0-9_-]{43}", text)
    assert "keys rotate" in run("create", "studio", code=2)
    run("limit", "studio", "--active-jobs", "7")
    listed = run("list")
    assert all(part in listed for part in ("studio", "active", "5/min", "0/7 jobs"))
    assert text[-43:] not in listed
    other = run("rotate", "studio").strip()
    assert other not in {text, ""}
    assert "former secret" not in run("list")
    third = run("rotate", "studio", "--overlap-s", "3600").strip()
    assert re.search(r"\tformer secret until 20\d\d-\d\d-\d\dT\d\d:\d\d:\d\dZ$", run("list").strip())
    with Database(Settings(data_dir=tmp_path / "data").database).read() as session:
        found = [keys.find(session, one, now=utc_now()) for one in (text, other, third)]
    assert [key is not None and key.name for key in found] == [False, "studio", "studio"]
    assert "0 video(s)" in run("assign", "studio")
    assert "just now" not in run("create", "former")
    run("revoke", "former")
    assert "0 video(s)" in run("assign", "studio", "--from", "former")
    run("revoke", "studio")
    assert "revoked" in run("list")
    assert "former secret" not in run("list")  # it ended with the key
    for useless in (("rotate", "studio"), ("assign", "studio")):
        assert "make another" in run(*useless, code=2)
    for like_an_id in (f"key_{'0' * 32}", text):
        assert "names do not begin" in run("create", like_an_id, code=2)
    assert "no key nobody" in run("revoke", "nobody", code=2)
    with pytest.MonkeyPatch.context() as patch:
        for name, value in environment.items():
            patch.setenv(name, value)
        assert _have_keys(Settings())  # a revoked one keeps the service closed: it may listen anywhere


def test_keys_go_by_the_clock_of_the_database(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A command may run on any machine: by its own clock a former secret would have ended, or be good for too long."""
    ahead = utc_now() + timedelta(hours=2)
    monkeypatch.setattr("service.catalog.database.utc_now", lambda: ahead)
    environment = {"PVG_DATA_DIR": str(tmp_path / "data")}

    def run(*arguments: str) -> str:
        result = CliRunner().invoke(cli, ["keys", *arguments], env=environment)
        assert result.exit_code == 0, result.output
        return result.output

    former = run("create", "studio").splitlines()[-1]
    run("rotate", "studio", "--overlap-s", "3600")
    assert "former secret until" in run("list")
    url = f"sqlite:///{tmp_path / 'data' / 'catalog.sqlite3'}"
    with closing(Database(url)) as database, database.read() as session:
        found = keys.find(session, former, now=ahead)
    assert found is not None
    assert found.created_at == ahead
    run("revoke", "studio")
    with closing(Database(url)) as database, database.read() as session:
        assert [key.revoked_at for key in keys.every(session)] == [ahead]


def test_files_of_another_database_go_only_once_they_are_adopted_and_though_they_are_most(tmp_path: Path) -> None:
    def run(database: str, *arguments: str, code: int = 0) -> str:
        environment = {"PVG_DATA_DIR": str(tmp_path / database), "PVG_STORAGE_URL": str(tmp_path / "blobs")}
        environment |= {"PVG_ORPHAN_TTL_S": "0"}
        make_tables(f"sqlite:///{tmp_path}/{database}/catalog.sqlite3")
        done = subprocess.run(
            [*COMMAND, *arguments],
            env=os.environ | environment,
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )
        assert done.returncode == code, done.stderr
        return done.stderr

    run("first", "gc")
    folder = tmp_path / "blobs" / "source" / "00"
    folder.mkdir(parents=True)
    for number in range(30):
        (folder / f"{number:064x}-vid_{number:032x}.mp4").write_bytes(b"x")
    said = run("second", "gc", code=1)
    assert "0 file(s) removed" in said
    assert "the store is another database's" in said
    assert "`pvg-service adopt`" in said
    assert "30 of 30 file(s) have no record" in run("second", "adopt")
    assert "gc --even-most" in run("second", "gc", code=1)
    assert len(list(folder.iterdir())) == 30
    assert "30 file(s) removed; 30 had no record" in run("second", "gc", "--even-most")
    assert list(folder.iterdir()) == []


def test_gc_goes_on_where_there_is_no_room_and_says_what_it_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make_tables(f"sqlite:///{tmp_path}/data/catalog.sqlite3")
    full = sqlite3.OperationalError("database or disk is full")
    full.sqlite_errorcode = sqlite3.SQLITE_FULL

    def forget(_: Database) -> None:
        raise OperationalError("PRAGMA wal_checkpoint(TRUNCATE)", None, full)

    monkeypatch.setattr(Database, "forget", forget)
    monkeypatch.setattr("service.cli.configure", lambda _: None)  # of this process, which is the tests'
    folder = tmp_path / "data" / "blobs" / "source" / "00"
    folder.mkdir(parents=True)
    (folder / f"{0:064x}-vid_{0:032x}.mp4").write_bytes(b"x")
    os.utime(folder / f"{0:064x}-vid_{0:032x}.mp4", (0, 0))
    environment = {"PVG_DATA_DIR": str(tmp_path / "data")}
    assert CliRunner().invoke(cli, ["adopt"], env=environment).exit_code == 0
    said = CliRunner().invoke(cli, ["gc"], env=environment)
    assert said.exit_code == 1
    assert said.output.splitlines()[-2:] == [
        "1 file(s) removed; 1 had no record",
        "pvg-service: the disk is full, not done: clearing the log of SQLite; run it again once there is room",
    ]


def test_tables_that_know_no_keys_are_gone_back_to_only_when_it_is_said(tmp_path: Path) -> None:
    environment = os.environ | {"PVG_DATA_DIR": str(tmp_path / "data")}

    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        command = [*COMMAND, *arguments]
        return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300, check=False)

    assert run("keys", "create", "studio").returncode == 0
    assert run("keys", "revoke", "studio").returncode == 0
    assert run("migrate", "--to", "0008").returncode == 0
    refused = run("migrate", "--to", "0007")
    assert (refused.returncode, refused.stderr.count("\n")) == (1, 1)
    assert "--open-to-all" in refused.stderr
    with sqlite3.connect(tmp_path / "data" / "catalog.sqlite3") as connection:
        assert connection.execute("SELECT version_num FROM alembic_version").fetchone() == ("0008",)
    assert run("migrate", "--to", "0007", "--open-to-all").returncode == 0


def test_a_key_is_all_that_is_printed(tmp_path: Path) -> None:
    folder = tmp_path / "data"
    folder.mkdir()
    folder.chmod(0o755)
    command = [*COMMAND, "keys", "create", "studio"]
    made = subprocess.run(
        command, env=os.environ | {"PVG_DATA_DIR": str(folder)}, capture_output=True, text=True, timeout=300, check=True
    )
    assert re.fullmatch(r"pvg_[0-9a-f]{32}_[A-Za-z0-9_-]{43}\n", made.stdout)
    assert "it is closed now" in made.stderr
    assert f"a key in sqlite:///{folder / 'catalog.sqlite3'}" in made.stderr


@pytest.mark.parametrize(
    ("limit", "most"), [("--rate", 2**31 - 1), ("--active-jobs", 2**31 - 1), ("--bytes", 2**63 - 1)]
)
def test_a_key_s_limits_are_numbers_that_every_database_takes(limit: str, most: int, tmp_path: Path) -> None:
    environment = {"PVG_DATA_DIR": str(tmp_path / "data")}
    for arguments in (["create", "studio", limit, str(most)], ["limit", "studio", limit, str(most)]):
        larger = [*arguments[:-1], str(most + 1)]
        assert CliRunner().invoke(cli, ["keys", *larger], env=environment).exit_code == 2
        assert CliRunner().invoke(cli, ["keys", *arguments], env=environment).exit_code == 0
    listed = CliRunner().invoke(cli, ["keys", "list"], env=environment).output
    assert re.search(rf"\b{most}\b", listed)


def test_a_database_is_named_without_its_password() -> None:
    for where in ("u:secret@h:5/d", "u@h:5/d?password=secret", "u:secret@h:5/d?sslmode=require"):
        named = _named(Settings(database_url=f"postgresql://{where}").database)
        assert "secret" not in named
        assert "@h:5/d" in named


def test_a_bad_setting_is_one_line_that_names_it() -> None:
    result = CliRunner().invoke(cli, ["serve"], env={"PVG_MAX_UPLOAD_BYTES": "lots"})
    assert result.exit_code == 2
    assert result.output.count("\n") == 1
    assert "PVG_MAX_UPLOAD_BYTES" in result.output


@pytest.mark.parametrize(
    ("arguments", "setting", "code", "words"),
    [
        (["serve"], {"PVG_LEASE_S": "5"}, 2, "lease_s must be at least twice"),
        (["worker"], {"PVG_WORKER_CONCURENCY": "5"}, 2, "the nearest is PVG_WORKER_CONCURRENCY"),
        (["migrate"], {"PVG_DATABASE_URL": "nonsense"}, 2, "PVG_DATABASE_URL"),
        (
            ["migrate"],
            {"PVG_DATABASE_URL": "postgresql://u:secret@host:abc/d"},
            2,
            "PVG_DATABASE_URL: it is not of the form",
        ),
        (["migrate"], {"PVG_DATABASE_URL": "mysql://u:secret@h/d"}, 2, "PVG_DATABASE_URL"),
        (["serve"], {"PVG_BROKER_URL": "amqp://u:secret@h"}, 2, "PVG_BROKER_URL"),
        (["migrate"], {"PVG_DATABASE_URL": "postgresql://u:secret@127.0.0.1:1/d"}, 1, "database"),
        (["gc"], {}, 2, "pvg-service migrate"),
        (["adopt"], {}, 2, "pvg-service migrate"),
        (["migrate"], {"PVG_DATA_DIR": "/dev/null/data"}, 1, "/dev/null/data"),
    ],
)
def test_what_it_cannot_start_with_is_one_line(
    arguments: list[str], setting: dict[str, str], code: int, words: str, tmp_path: Path
) -> None:
    command = [str(Path(sys.executable).with_name("pvg-service")), *arguments]
    environment = os.environ | {"PVG_DATA_DIR": str(tmp_path / "data")} | setting
    result = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300, check=False)
    assert result.returncode == code
    assert result.stderr.count("\n") == 1
    assert words in result.stderr
    assert "secret" not in result.stderr


def test_a_worker_begins_only_with_tables_of_its_version(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = Settings(data_dir=tmp_path / "data")
    begun: list[str] = []

    def begin(*_: object) -> None:
        begun.append("worker")

    monkeypatch.setattr("service.cli.START_WAIT_S", 0)
    monkeypatch.setattr(os, "execve", begin)

    def begin_with(url: str = "") -> Result:
        return CliRunner().invoke(
            cli, ["worker"], env={"PVG_DATA_DIR": str(settings.data_dir), "PVG_DATABASE_URL": url}
        )

    def is_refused() -> bool:
        answer = begin_with()
        assert answer.output.count("\n") == answer.output.count("pvg-service migrate")
        return answer.exit_code == 2

    assert is_refused(), "there are none yet"
    make_tables(settings.database)
    assert not is_refused()
    for version in ("0018", "9999"):
        with sqlite3.connect(settings.data_dir / "catalog.sqlite3") as connection:
            connection.execute("UPDATE alembic_version SET version_num = ?", (version,))
        assert is_refused(), version
    assert begun == ["worker"]
    assert begin_with("postgresql://u:secret@127.0.0.1:1/d").exit_code == 0, "it waits for a database that is away"
    assert begun == ["worker"] * 2


def test_the_service_starts_without_the_method_and_the_worker() -> None:
    code = "import sys, service.api.app, service.cli; print(sorted(m.split('.')[0] for m in sys.modules))"
    loaded = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout
    modules = set(ast.literal_eval(loaded))
    assert "fastapi" in modules
    assert not modules & {"pvg", "worker", "cv2", "numpy", "onnxruntime", "av", "numba"}


def test_a_service_waits_for_a_database_that_starts_with_it(tmp_path: Path) -> None:
    with postgres_of_our_own() as postgres, fresh_database(postgres.url) as database:
        postgres.stop()
        with running(tmp_path, database) as log:
            until(lambda: "does not answer yet" in log.read_text(), 180)
            postgres.start()
            until(lambda: "Application startup complete" in log.read_text(), 180)
            assert "cannot be used" not in log.read_text()


@contextmanager
def running(folder: Path, database: str) -> Iterator[Path]:
    """`pvg-service serve` without a worker; what it says."""
    log, command = folder / "log", [*COMMAND, "serve", "--no-worker"]
    with started(command, folder / "data", log, port="0", database_url=database):
        yield log


def test_what_keys_have_had_done_is_listed_by_month(tmp_path: Path) -> None:
    environment = {"PVG_DATA_DIR": str(tmp_path / "data")}

    def run(*arguments: str, code: int = 0) -> list[list[str]]:
        result = CliRunner().invoke(cli, arguments, env=environment)
        assert result.exit_code == code, result.output
        return [line.split("\t") for line in result.output.splitlines()]

    assert "migrate" in run("usage", code=2)[0][0]
    run("keys", "create", "studio")
    assert run("usage") == []
    database = Database(Settings(data_dir=tmp_path / "data").database)
    with database.write() as session:
        (key,) = keys.every(session)
        for owner, month in (("", "2026-10"), (key.id, "2026-10"), (key.id, "2026-11")):
            counts = {"succeeded": 12, "failed": 1, "looks": 17, "frames": 4080, "milliseconds": 136_000, "uploads": 5}
            session.add(MonthlyUsage(owner=owner, month=month, **counts, upload_bytes=9_151_055))
    database.close()
    said = ["12 succeeded", "1 failed", "0 canceled", "0 expired"]
    said += ["17 looks", "4080 frames", "136.000 s", "5 uploads", "9151055 bytes"]
    of_nobody = ["2026-10", "-", "-", *said]
    of_key = [[month, key.id, "studio", *said] for month in ("2026-10", "2026-11")]
    assert run("usage") == [of_nobody, *of_key]
    assert run("usage", "--month", "2026-11") == of_key[1:]
    for wrong in ("2026-13", "2026", "november"):
        assert "--month" in run("usage", "--month", wrong, code=2)[0][0]
