"""Images, compose file, manifests and units agree with the service: its settings, commands, times and memory."""

from __future__ import annotations

import configparser
import os
import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer.main
import yaml
from sqlalchemy import text

from deploy.make_secrets import make
from service.catalog import Database, jobs, leases
from service.cli import DRAIN_S, cli
from service.settings import GIB, Settings, store_secrets
from tests.service.catalog.test_parts import add_ready_transfer, split
from tests.service.fixtures import FakeClock, add_media, add_transfer, claim

ROOT = Path(__file__).resolve().parents[2]
KUBERNETES = ROOT / "deploy" / "kubernetes"
COMPOSE: dict[str, Any] = yaml.safe_load((ROOT / "docker-compose.yml").read_text())
OURS = {name: one for name, one in COMPOSE["services"].items() if one["image"].startswith("pvg-")}
WORKLOADS: dict[str, dict[str, Any]] = {
    one["metadata"]["name"]: one["spec"]["template"]["spec"]
    for path in (KUBERNETES / "base").glob("*.yaml")
    for one in yaml.safe_load_all(path.read_text())
    if one["kind"] == "Deployment"
}
UNITS = sorted((ROOT / "deploy" / "systemd").glob("*.service"))
CONFIG = dict(line.split("=", 1) for line in (KUBERNETES / "base" / "settings.env").read_text().splitlines())
#: beside what jobs may take: supervisors, the server that jobs are forked from, and their libraries
HEADROOM = GIB


def unit(path: Path) -> dict[str, str]:
    parsed = configparser.ConfigParser(strict=False, interpolation=None)
    parsed.optionxform = str  # type: ignore[assignment,method-assign]
    parsed.read(path)
    return dict(parsed["Service"])


def containers(pod: dict[str, Any]) -> list[dict[str, Any]]:
    return [*pod.get("initContainers", ()), *pod["containers"]]


def commands() -> Iterator[list[str]]:
    """Every command that anything here runs in an image or from a unit."""
    for one in OURS.values():
        yield one["command"]
        yield one["healthcheck"]["test"][1:]
    for pod in WORKLOADS.values():
        for container in containers(pod):
            yield container["command"]
            probes = [container.get(f"{kind}Probe", {}) for kind in ("startup", "liveness", "readiness")]
            yield from (probe["exec"]["command"] for probe in probes if "exec" in probe)
    yield from (unit(path)["ExecStart"].split() for path in UNITS)
    yield from (yaml.safe_load(found) for found in re.findall(r"^CMD (\[.*\])$", dockerfile(), re.MULTILINE))


def dockerfile() -> str:
    return (ROOT / "Dockerfile").read_text()


def of_size(written: str) -> int:
    number, scale = re.fullmatch(r"(\d+)(g|m|G|Gi|Mi)", written).groups()  # type: ignore[union-attr]
    return int(number) * {"g": GIB, "G": GIB, "Gi": GIB, "m": 2**20, "Mi": 2**20}[scale]


def test_there_is_something_of_each_kind() -> None:
    assert set(OURS) == {"service", "api", "worker", "previews"}
    assert set(WORKLOADS) == {"pvg-api", "pvg-worker", "pvg-previews"}
    assert len(UNITS) == 3
    assert {profile for one in COMPOSE["services"].values() for profile in one["profiles"]} == {"embedded", "scaled"}


@pytest.mark.parametrize("command", list(commands()), ids=" ".join)
def test_every_command_exists(command: list[str]) -> None:
    assert Path(command[0]).name == "pvg-service"
    group = typer.main.get_command(cli)
    context = group.make_context("pvg-service", command[1:], resilient_parsing=True)
    name, found, rest = group.resolve_command(context, command[1:])  # type: ignore[attr-defined]
    found.make_context(name, rest)  # raises for an option that there is not


def test_what_is_built_are_stages_of_the_dockerfile() -> None:
    stages = set(re.findall(r"^FROM \S+ AS (\S+)$", dockerfile(), re.MULTILINE))
    assert {one["build"]["target"] for one in OURS.values()} <= stages
    assert re.findall(r"^FROM .* AS (\S+)$", dockerfile(), re.MULTILINE)[-1] == "worker"
    assert dockerfile().count("\nUSER 10001:0\n") == 2
    named = {one["name"] for one in yaml.safe_load((KUBERNETES / "base" / "kustomization.yaml").read_text())["images"]}
    assert {container["image"] for pod in WORKLOADS.values() for container in containers(pod)} == named
    assert {one["image"] for one in OURS.values()} == named


def test_the_platform_is_what_the_builder_says() -> None:
    """An ARG before the first FROM that has a value hides the one that BuildKit gives by itself."""
    assert re.findall(r"^ARG TARGET\w+=", dockerfile(), re.MULTILINE) == []
    assert dockerfile().count("-${TARGETARCH} AS ") == 2


def test_the_data_folder_of_compose_may_be_set() -> None:
    """A volume of a former image is found again."""
    assert {one["environment"]["PVG_DATA_DIR"] for one in OURS.values()} == {"${PVG_DATA_DIR:-/data/pvg}"}


def test_who_may_reach_the_api_of_compose_is_set_in_its_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("service", "api"):
        given = OURS[name]["environment"]
        assert given["PVG_ALLOW_UNAUTHENTICATED_NETWORK"] == "${PVG_ALLOW_UNAUTHENTICATED_NETWORK:-true}"
        for setting in ("PVG_ALLOWED_HOSTS", "PVG_ALLOWED_ORIGINS", "PVG_ROOT_PATH"):
            assert given[setting] == f"${{{setting}:-}}"
            monkeypatch.setenv(setting, "")
        assert given.keys() & {"PVG_METRICS_TOKEN", "PVG_METRICS_TOKEN_FILE"}
    monkeypatch.setenv("PVG_METRICS_TOKEN", "")
    settings = Settings()
    assert not settings.metrics_token.get_secret_value()
    assert settings.host_names == Settings(allowed_hosts="").host_names


def test_the_api_of_the_manifests_answers_who_scrapes_its_pod() -> None:
    (api,) = WORKLOADS["pvg-api"]["containers"]
    given = {one["name"]: one for one in api["env"]}
    names = list(given)
    assert given["POD_IP"]["valueFrom"] == {"fieldRef": {"fieldPath": "status.podIP"}}
    assert names.index("POD_IP") < names.index("PVG_ALLOWED_HOSTS"), "only what comes before is put in"
    assert given["PVG_ALLOWED_HOSTS"]["value"].split(",")[-1] == "$(POD_IP)"
    assert "10.1.2.3" in (Settings(allowed_hosts="faces.example,pvg,10.1.2.3").host_names or ())


def test_the_broker_and_the_database_of_compose_say_when_they_cannot() -> None:
    """The broker refuses before its container is killed; the database is ready when it listens at its address."""
    valkey, postgres = COMPOSE["services"]["valkey"], COMPOSE["services"]["postgres"]
    room = int(valkey["command"][valkey["command"].index("--maxmemory") + 1].removesuffix("mb")) * 2**20
    assert 2 * room <= of_size(valkey["mem_limit"])
    assert postgres["healthcheck"]["test"][1:4] == ["pg_isready", "-h", "127.0.0.1"]


def test_only_what_the_build_asks_for_is_sent_to_it() -> None:
    kept = {line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")}
    copied = {
        part.removeprefix("./").split("/")[0]
        for line in re.findall(r"^COPY (?!--from)(.*)$", dockerfile(), re.MULTILINE)
        for part in line.split()[:-1]
    }
    assert copied <= kept


def test_everything_is_told_to_stop_for_longer_than_it_takes() -> None:
    settings = Settings()
    worker = settings.worker_stop_limit_s
    for name, pod in WORKLOADS.items():
        given = {one["name"]: one.get("value") for one in pod["containers"][0].get("env", ())}
        notice = float(given.get("PVG_STOP_NOTICE_S") or settings.stop_notice_s)
        assert pod["terminationGracePeriodSeconds"] > max(worker, notice + DRAIN_S + 3), name
    longest = max(worker, settings.stop_notice_s + DRAIN_S + 3)
    assert all(float(one["stop_grace_period"].removesuffix("s")) > longest for one in OURS.values())
    assert all(float(unit(path)["TimeoutStopSec"]) > longest for path in UNITS)


def test_jobs_fit_into_the_memory_that_their_container_has() -> None:
    for name in ("service", "worker"):
        given = OURS[name]["environment"]
        jobs_need = int(given["PVG_WORKER_CONCURRENCY"]) * int(given["PVG_JOB_MEMORY_BYTES"])
        assert of_size(OURS[name]["mem_limit"]) >= jobs_need + HEADROOM, name
    jobs_need = int(CONFIG["PVG_WORKER_CONCURRENCY"]) * int(CONFIG["PVG_JOB_MEMORY_BYTES"])
    limit = WORKLOADS["pvg-worker"]["containers"][0]["resources"]["limits"]["memory"]
    assert of_size(limit) >= jobs_need + HEADROOM
    default = Settings.model_fields
    jobs_need = default["worker_concurrency"].default * default["job_memory_bytes"].default
    assert of_size(unit(ROOT / "deploy/systemd/pvg-worker.service")["MemoryMax"]) >= jobs_need + HEADROOM


def test_containers_are_confined_and_limited() -> None:
    for name, one in COMPOSE["services"].items():
        assert one["read_only"] is True, name
        assert one["cap_drop"] == ["ALL"], name
        assert one["security_opt"] == ["no-new-privileges:true"], name
        assert {"mem_limit", "pids_limit", "healthcheck"} <= one.keys(), name
    for name, one in OURS.items():
        assert {"tmpfs", "cpus"} <= one.keys(), name
        assert all(port.startswith("127.0.0.1:") for port in one.get("ports", ())), name
    for name, pod in WORKLOADS.items():
        assert pod["enableServiceLinks"] is False, name
        assert pod["automountServiceAccountToken"] is False, name
        assert pod["securityContext"]["runAsNonRoot"] is True, name
        assert (pod["securityContext"]["runAsUser"], pod["securityContext"]["runAsGroup"]) == (10001, 0), name
        for container in containers(pod):
            assert container["securityContext"] == {
                "allowPrivilegeEscalation": False,
                "readOnlyRootFilesystem": True,
                "capabilities": {"drop": ["ALL"]},
            }, name
            assert {"requests", "limits"} <= container["resources"].keys(), name
            assert {"/data", "/tmp"} <= {mount["mountPath"] for mount in container["volumeMounts"]}, name


def test_an_outage_of_the_database_ends_no_worker() -> None:
    for name in ("pvg-worker", "pvg-previews"):
        probe = WORKLOADS[name]["containers"][0]["livenessProbe"]
        assert probe["periodSeconds"] * probe["failureThreshold"] > Settings().max_outage_s


def test_secrets_that_are_made_are_those_that_are_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "secrets"
    made = make(folder)
    assert set(made) == set(COMPOSE["secrets"])
    assert {one["file"] for one in COMPOSE["secrets"].values()} == {f"./secrets/{name}" for name in made}
    assert folder.stat().st_mode & 0o777 == 0o700
    before = {name: (folder / name).read_text() for name in made}
    assert make(folder) == []
    assert before == {name: (folder / name).read_text() for name in made}
    for service in ("api", "worker", "previews"):
        read = {name: path for name, path in OURS[service]["environment"].items() if name.endswith("_FILE")}
        assert {Path(path).name for path in read.values()} == set(OURS[service]["secrets"])
        for name, path in read.items():
            monkeypatch.setenv(name, str(folder / Path(path).name))
    settings = Settings()
    assert settings.database == f"postgresql+psycopg://pvg:{before['postgres_password']}@postgres/pvg"
    assert settings.link_secret.get_secret_value() == before["link_secret"]


def test_the_queue_is_counted_as_the_scaler_asks(database: Database, clock: FakeClock) -> None:
    """KEDA's query on the tables as they are migrated: what a worker could take, and what one has."""
    (trigger,) = scaled_object()["spec"]["triggers"]
    assert trigger["metadata"]["targetQueryValue"] == CONFIG["PVG_WORKER_CONCURRENCY"]

    def queued() -> int:
        with database.read() as session:
            return int(session.execute(text(trigger["metadata"]["query"])).scalar_one())

    assert queued() == 0
    medium = add_media(database)
    add_transfer(database, medium, medium)
    assert queued() == 1, "the transfer waits for its medium, and no worker could take it"
    lease = claim(database, medium.job_id)
    assert queued() == 1
    with database.write() as session:
        assert jobs.cancel(session, medium.job_id, now=clock())
    assert queued() == 1
    with database.write() as session:
        assert leases.confirm_cancel(session, lease, now=clock())
    assert queued() == 0
    _, job_id = add_ready_transfer(database)
    assert queued() == 1
    split(database, job_id, 3)
    assert queued() == 3, "three workers could be at it; the whole is nobody's meanwhile"


def scaled_object() -> dict[str, Any]:
    documents: list[dict[str, Any]] = list(yaml.safe_load_all((KUBERNETES / "keda" / "scaling.yaml").read_text()))
    (found,) = [one for one in documents if one["kind"] == "ScaledObject"]
    assert found["spec"]["scaleTargetRef"]["name"] in WORKLOADS
    return found


def test_workers_get_no_secret_that_they_do_not_need() -> None:
    of_the_api = {"PVG_LINK_SECRET_FILE", "PVG_METRICS_TOKEN_FILE"}
    for name, pod in WORKLOADS.items():
        read = CONFIG | {one["name"]: one.get("value") for c in containers(pod) for one in c.get("env", ())}
        paths = {Path(path).name for path in read.values() if path and path.startswith("/secrets/")}
        (secret,) = [volume["secret"] for volume in pod["volumes"] if volume["name"] == "secrets"]
        assert (of_the_api <= read.keys()) is (name == "pvg-api")
        if name != "pvg-api":
            assert {one["key"] for one in secret["items"]} == {one["path"] for one in secret["items"]} == paths
    for name, one in OURS.items():
        assert bool(of_the_api & one["environment"].keys()) is (name == "api")


def test_the_compose_file_for_an_object_store_goes_over_the_main_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    over = yaml.safe_load((ROOT / "deploy" / "compose.s3.yml").read_text())
    assert set(over["services"]) == {name for name, one in OURS.items() if "scaled" in one["profiles"]}
    assert not COMPOSE["networks"]["front"], "it has a way out"
    for name, one in over["services"].items():
        assert one["networks"] == ["front"]
        assert set(one["secrets"]) == set(over["secrets"])
        given = OURS[name]["environment"] | one["environment"]
        for secret in {*OURS[name]["secrets"], *one["secrets"]}:
            (tmp_path / secret).write_text("postgresql://u:p@h/d" if secret == "database_url" else "a" * 40)
        for variable, value in given.items():
            path = str(value or "")
            if path.startswith("/run/secrets/"):
                monkeypatch.setenv(variable, str(tmp_path / Path(path).name))
    monkeypatch.setenv("PVG_STORAGE_URL", "s3://faces/pvg")
    Settings()
    assert store_secrets(os.environ) == {"access_key_id": "a" * 40, "secret_access_key": "a" * 40}


def test_how_a_store_is_reached_is_handed_on_and_documented() -> None:
    over = yaml.safe_load((ROOT / "deploy" / "compose.s3.yml").read_text())
    page = (ROOT / "docs" / "operations.md").read_text()
    for one in over["services"].values():
        for name in ("AWS_ENDPOINT", "AWS_ALLOW_HTTP", "AWS_READ_TIMEOUT"):
            assert one["environment"].get(name, "not there") is None, "handed on when it is set"
            assert name in page


@pytest.mark.parametrize("overlay", ["base", "keda", "shared-folder"])
def test_the_manifests_are_put_together(overlay: str) -> None:
    if not shutil.which("kubectl") and not shutil.which("kustomize"):
        pytest.skip("neither kubectl nor kustomize is installed")
    command = ["kustomize", "build"] if shutil.which("kustomize") else ["kubectl", "kustomize"]
    command.append(str(KUBERNETES / overlay))
    made = subprocess.run(command, capture_output=True, text=True, check=True, timeout=300).stdout
    documents = [one for one in yaml.safe_load_all(made) if one]
    names = {(one["kind"], one["metadata"]["name"]) for one in documents}
    maps = {one["metadata"]["name"] for one in documents if one["kind"] == "ConfigMap"}
    claims = {one["metadata"]["name"] for one in documents if one["kind"] == "PersistentVolumeClaim"}
    for one in documents:
        if one["kind"] == "Deployment":
            pod = one["spec"]["template"]["spec"]
            assert {ref["configMapRef"]["name"] for c in containers(pod) for ref in c["envFrom"]} <= maps
            wanted = {v["persistentVolumeClaim"]["claimName"] for v in pod["volumes"] if "persistentVolumeClaim" in v}
            assert wanted == claims
            (data,) = [volume for volume in pod["volumes"] if volume["name"] == "data"]
            assert "ephemeral" in data, "drafts are told by locks, and room by what the disk says"
            places = {(m["name"], m["mountPath"]) for c in containers(pod) for m in c["volumeMounts"]}
            assert (("blobs", "/blobs") in places) is bool(claims)
            assert all(len(c["volumeMounts"]) == 3 + len(claims) for c in containers(pod))
            assert ("replicas" in one["spec"]) is not (overlay == "keda" and one["metadata"]["name"] == "pvg-worker")
    assert (("ScaledObject", "pvg-worker") in names) is (overlay == "keda")


def test_the_secrets_of_the_manifests_have_the_names_that_are_documented() -> None:
    text_of_page = (ROOT / "docs" / "operations" / "deployment.md").read_text()
    given = [*CONFIG.values()]
    given += [str(one.get("value")) for pod in WORKLOADS.values() for c in containers(pod) for one in c.get("env", ())]
    keys = {Path(path).name for path in given if path.startswith("/secrets/")}
    assert all(f"--from-literal={key}=" in text_of_page for key in keys | {"queue-url"})
