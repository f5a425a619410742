from __future__ import annotations

import re
import time
from datetime import timedelta
from pathlib import Path

import pytest
from pydantic import SecretStr, ValidationError

from scripts.settings_table import PAGE, with_table
from service.catalog import utc_now
from service.processes import worker_command
from service.settings import FROM_FILES, Settings, check_names


@pytest.mark.parametrize("host", ["127.0.0.1", "127.1.2.3", "::1", "localhost"])
def test_loopback_addresses_are_open_to_this_machine_only(host: str) -> None:
    assert Settings(host=host).listens_to_loopback_only


def test_settings_that_would_lose_jobs_are_refused() -> None:
    with pytest.raises(ValidationError):
        Settings(lease_s=5, heartbeat_s=5)
    with pytest.raises(ValidationError):
        Settings(job_soft_limit_s=10, job_hard_limit_s=10)


@pytest.mark.parametrize("token", ["figures é", "two words", "a\nb", "ключ"])
def test_a_token_that_no_header_can_carry_is_refused_and_not_quoted(token: str) -> None:
    with pytest.raises(ValidationError, match="metrics_token must be of visible ASCII") as refused:
        Settings(metrics_token=SecretStr(token))
    assert token not in str(refused.value)


def test_any_visible_characters_may_be_of_a_token() -> None:
    Settings(metrics_token=SecretStr("!\"#$%&'()*+,-./09:;<=>?@AZ[\\]^_`az{|}~"))


@pytest.mark.parametrize(
    ("given", "level"), [("info", "INFO"), ("INFO ", "INFO"), ("WARN", "WARNING"), ("fatal", "CRITICAL")]
)
def test_a_log_level_is_one_that_workers_start_with(given: str, level: str) -> None:
    settings = Settings(log_level=given)
    assert settings.log_level == level
    assert level in worker_command(settings)


@pytest.mark.parametrize("given", ["", "LOUD", "20"])
def test_an_unknown_log_level_is_refused_and_the_known_ones_named(given: str) -> None:
    with pytest.raises(ValidationError, match=f"'{given}' is none of DEBUG, INFO, WARNING"):
        Settings(log_level=given)


def test_postgres_addresses_use_the_installed_driver() -> None:
    for given in ("postgres://u@h/d", "postgresql://u@h/d", "postgresql+psycopg://u@h/d"):
        assert Settings(database_url=given).database == "postgresql+psycopg://u@h/d"


def test_addresses_that_sqlalchemy_reads_are_taken() -> None:
    for given in (
        "postgresql+psycopg://user@server:pw@host:5432/db",
        "sqlite+pysqlite:////srv/db",
        "sqlite:////srv/db",
    ):
        assert Settings(database_url=given).database == given


def test_a_long_address_of_a_database_is_refused_at_once() -> None:
    began = time.thread_time()
    with pytest.raises(ValidationError, match="database_url"):
        Settings(database_url=f"postgresql://{'a@' * 20_000}h:x")
    assert time.thread_time() - began < 1


def test_an_address_of_a_database_that_is_none_is_refused_and_not_quoted() -> None:
    for given in ("nonsense", "postgresql://u:secret@h:abc/d", "postgresql://u:secret@h:5432x/d"):
        with pytest.raises(ValidationError, match="database_url") as caught:
            Settings(database_url=given)
        assert "secret" not in str(caught.value)
        assert "nonsense" not in str(caught.value)


@pytest.mark.parametrize("setting", ["max_upload_bytes", "job_memory_bytes", "job_file_bytes"])
def test_bytes_are_no_more_than_a_column_or_a_limit_of_a_process_can_be(setting: str) -> None:
    assert getattr(Settings.model_validate({setting: 2**63 - 1}), setting) == 2**63 - 1
    with pytest.raises(ValidationError, match=setting):
        Settings.model_validate({setting: 2**63})


@pytest.mark.parametrize(
    "given",
    [
        "redis:/127.0.0.1",
        "redis://",
        "redis://:secret@/0",
        "redis://h:x",
        "redis://h/a",
        "amqp://u:secret@h",
        "h:6379",
        "redis+socket://",
    ],
)
def test_a_broker_is_redis_with_a_host(given: str) -> None:
    with pytest.raises(ValidationError, match="redis://host:6379/0") as refused:
        Settings(broker_url=given)
    assert "secret" not in str(refused.value)
    for one in (
        "",
        "redis://h",
        "redis://:secret@h:6379/0",
        "rediss://u:secret@[::1]/3",
        "redis+socket:///run/redis.sock",
    ):
        assert Settings(broker_url=one).broker_url == one


@pytest.mark.parametrize(
    ("given", "nearest"),
    [
        ("PVG_MAX_UPLOAD_BYTE", "PVG_MAX_UPLOAD_BYTES"),
        ("PVG_STORAGE", "PVG_STORAGE_URL"),
        ("pvg_datadir", "PVG_DATA_DIR"),
        ("PVG_ALLOWED_HOST", "PVG_ALLOWED_HOSTS"),
    ],
)
def test_an_unknown_setting_is_refused_and_the_nearest_named(
    given: str, nearest: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(given, "1")
    with pytest.raises(ValidationError, match=f"{given} is not a setting; the nearest is {nearest}"):
        Settings()


@pytest.mark.parametrize(
    "origins", ["*", "null", "studio.example", "https://a.example/x", "https://a.example, ftp://b", "file://", "://b"]
)
def test_allowed_origins_are_origins(origins: str) -> None:
    with pytest.raises(ValidationError, match="is not an origin"):
        Settings(allowed_origins=origins)
    assert Settings(allowed_origins="https://A.example:8443/ ,").origins == {"https://a.example:8443"}
    app = {"capacitor://localhost", "https://localhost"}  # its pages on one kind of phone and on the other
    assert Settings(allowed_origins=", ".join(app)).origins == app


@pytest.mark.parametrize(
    "setting", [name for name in Settings.model_fields if name.endswith("_s") and "_per_" not in name]
)
@pytest.mark.parametrize("given", ["inf", "1e400", "nan", "1e12"])
def test_times_end_within_a_century(setting: str, given: str) -> None:
    """What was counted from a longer one was no date: each upload, or each round of the reaper, failed."""
    with pytest.raises(ValidationError, match=setting):
        Settings.model_validate({setting: given})


def test_a_century_is_still_a_time() -> None:
    settings = Settings(media_ttl_s=3e9, collect_interval_s=1e9, min_body_bytes_per_s=1e10)  # the last is none
    assert utc_now() + timedelta(seconds=settings.media_ttl_s) > utc_now()


_NO_STORES = [
    "gs://bucket/x",
    "https://s3.example/bucket",
    "s3:/bucket",
    "s3://",
    "S3://bucket",
    "file://srv/faces",
    "file:faces",
]


@pytest.mark.parametrize("url", _NO_STORES)
def test_a_store_is_a_bucket_or_a_folder(url: str) -> None:
    with pytest.raises(ValidationError, match="neither a folder nor of the form s3://bucket/prefix"):
        Settings(storage_url=url)
    for one in ("", "s3://bucket", "s3://bucket/a/b", "s3a://bucket", "/srv/faces", "faces", "./a:b", "my_faces:1"):
        assert Settings(storage_url=one).storage_url == one
    for one in ("file:///srv/faces", "file:/srv/faces", "file://localhost/srv/faces"):
        assert Settings(storage_url=one).local_storage_folder == Path("/srv/faces")


@pytest.mark.parametrize("path", ["faces", "https://a.example/faces", "/fa ces", "/faces?x", "//faces"])
def test_a_root_path_begins_addresses(path: str) -> None:
    with pytest.raises(ValidationError, match="is not a path such as /faces"):
        Settings(root_path=path)
    assert [Settings(root_path=one).root_path for one in ("/a/faces/", "/", "")] == ["/a/faces", "", ""]
    assert Settings(root_path="/studio+a/@faces").root_path == "/studio+a/@faces"


@pytest.mark.parametrize(
    "names", ["https://faces.example", "a.example b.example", "a.example:8443", "a.example, *.b.example", "fä.example"]
)
def test_allowed_hosts_are_what_a_host_field_may_have(names: str) -> None:
    with pytest.raises(ValidationError, match="is not the name of a host"):
        Settings(allowed_hosts=names)
    given = Settings(allowed_hosts="A.example, my_pod,10.0.3.7,[fd00::1],fd00::2,").host_names
    assert given is not None
    assert {"a.example", "my_pod", "10.0.3.7", "fd00::1", "fd00::2"} <= given


@pytest.mark.parametrize("variable", ["PVG_DATA_DIR", "PVG_HOST"])
def test_what_is_needed_is_not_left_empty(variable: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """It meant the folder in which the service was started, and all addresses of the machine."""
    monkeypatch.setenv(variable, "")
    with pytest.raises(ValidationError, match="it names no"):
        Settings()


def test_every_variable_of_our_prefix_in_the_code_is_known() -> None:
    repository = Path(__file__).resolve().parents[2]
    files = [
        path
        for folder in ("pvg", "service", "worker", "scripts", "benchmarks")
        for path in (repository / folder).rglob("*.py")
    ]
    files += [
        repository / name for name in ("Dockerfile", "docker-compose.yml", "Makefile", ".ci/run", "docs/operations.md")
    ]
    files += [path for path in (repository / "deploy").rglob("*") if path.is_file() and path.suffix != ".pyc"]
    files += (repository / "docs" / "operations").glob("*.md")
    names = {name for path in files for name in re.findall(r"\bPVG_[A-Z0-9_]*[A-Z0-9]\b", path.read_text())}
    assert {"PVG_CACHE_DIR", "PVG_DATA_DIR"} <= names
    check_names(names)


def test_the_documentation_says_of_every_setting_what_the_class_does() -> None:
    assert PAGE.read_text() == with_table(PAGE.read_text()), "run `python -m scripts.settings_table --write`"
    assert all(field.description for field in Settings.model_fields.values())


def test_the_documentation_of_uploads_has_the_limits_that_hold_by_default() -> None:
    text = (PAGE.parent / "api.md").read_text()
    table = text.partition("| limit of an upload | by default |\n|---|---|\n")[2].partition("\n\n")[0]
    figures = [int(one.replace(",", "")) for one in re.findall(r"^\| [^|]+ \| ([0-9,]+)", table, re.MULTILINE)]
    told = Settings()
    assert figures == [
        told.max_upload_bytes,
        told.max_pixels,
        told.max_frames,
        told.max_duration_s,
        told.max_frame_rate,
        told.max_streams,
        told.min_face_px,
        told.warn_face_px,
    ]


@pytest.mark.parametrize("setting", FROM_FILES)
def test_a_secret_may_be_in_a_file(setting: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    secret, variable = "postgresql://u:p%40@h/d-and-so-on-and-on", f"PVG_{setting.upper()}"
    if setting == "broker_url":
        secret = "redis://u:p%40@h/0"
    file = tmp_path / "secret"
    file.write_text(secret + "\n")
    monkeypatch.setenv(f"{variable}_FILE", str(file))

    def read(settings: Settings) -> str:
        value = getattr(settings, setting)
        return str(value.get_secret_value() if isinstance(value, SecretStr) else value)

    assert read(Settings()) == secret
    monkeypatch.setenv(variable, "")  # as compose files set what is not given
    assert read(Settings()) == secret
    assert read(Settings.model_validate(Settings().model_dump() | {"port": 0})) == secret
    monkeypatch.setenv(variable, "x" * 32)
    with pytest.raises(ValidationError, match=f"{variable} and {variable}_FILE are both given"):
        Settings()


@pytest.mark.parametrize(("content", "reason"), [(b"\n", "is empty"), (None, "No such file"), (b"\xff", "not text")])
def test_a_file_without_a_secret_is_refused(
    content: bytes | None, reason: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "secret"
    if content is not None:
        file.write_bytes(content)
    monkeypatch.setenv("PVG_METRICS_TOKEN_FILE", str(file))
    with pytest.raises(ValidationError, match=reason):
        Settings()


@pytest.mark.parametrize("name", ["ACCESS_KEY_ID", "SECRET_ACCESS_KEY", "SESSION_TOKEN"])
def test_credentials_of_a_store_are_as_strict(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    variable, file = f"AWS_{name}", tmp_path / "secret"
    monkeypatch.delenv(variable, raising=False)
    monkeypatch.setenv(f"{variable}_FILE", str(file))
    monkeypatch.setenv("PVG_STORAGE_URL", "s3://bucket/prefix")
    for content, reason in ((None, "No such file"), (b"\n", "is empty"), (b"\xff", "not text")):
        if content is not None:
            file.write_bytes(content)
        with pytest.raises(ValidationError, match=f"{variable}_FILE.*{reason}"):
            Settings()
    file.write_text("OURS\n")
    Settings()
    monkeypatch.setenv(variable, "THEIRS")
    with pytest.raises(ValidationError, match=f"{variable} and {variable}_FILE are both given"):
        Settings()
    monkeypatch.setenv("PVG_STORAGE_URL", "")
    Settings()  # nothing is read of a store that is not used


def test_only_secrets_are_read_from_files(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PVG_PORT_FILE", "/dev/null")
    with pytest.raises(ValidationError, match="PVG_PORT_FILE is not a setting"):
        Settings()
