"""The service behind nginx, set up as deploy/proxy/nginx.conf has it."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import httpx
import pytest

from service.settings import Settings
from tests.service.fixtures import PNG, Api, make_ready, serve
from tests.service.servers import free_port, installed, stop
from tests.waiting import until

PROXY = Path(__file__).resolve().parents[2] / "deploy" / "proxy"
NAME = "faces.example"


@pytest.fixture
def service(tmp_path: Path) -> Iterator[Api]:
    settings = Settings(data_dir=tmp_path / "data", reap_interval_s=3600, allowed_hosts=NAME, max_upload_bytes=2**20)
    yield from serve(settings)


@pytest.fixture
def proxy(service: Api, tmp_path: Path) -> Iterator[httpx.Client]:
    """A client that calls the service by its public name, through nginx."""
    with nginx_before(service.address[1], tmp_path) as client:
        yield client


@contextmanager
def nginx_before(service_port: int, tmp_path: Path) -> Iterator[httpx.Client]:
    """nginx before what is at a port, with its logs in the folder `nginx`; a client that calls it."""
    nginx = installed("nginx")
    port, folder = free_port(), tmp_path / "nginx"
    folder.mkdir()
    ours = (PROXY / "nginx.conf").read_text()
    ours, listening = re.subn(r"listen 80;", f"listen 127.0.0.1:{port};", ours)
    ours, leading = re.subn(r"server 127\.0\.0\.1:8000;", f"server 127.0.0.1:{service_port};", ours)
    ours, logging = re.subn(r"/var/log/nginx/", f"{folder}/", ours)
    assert (listening, leading, logging) == (1, 1, 2)
    kinds = ("client_body", "proxy", "fastcgi", "uwsgi", "scgi")
    folders = "".join(f"{kind}_temp_path {folder}/{kind};\n" for kind in kinds)
    whole = folder / "nginx.conf"
    whole.write_text(
        f"daemon off;\nmaster_process off;\npid {folder}/pid;\nerror_log stderr warn;\nevents {{}}\n"
        f"http {{\naccess_log {folder}/access.log;\n{folders}{ours}}}\n"
    )
    command = [nginx, "-p", str(folder), "-c", str(whole)]
    checked = subprocess.run([*command, "-t", "-q"], capture_output=True, text=True, check=False)
    assert checked.returncode == 0, checked.stderr
    process = subprocess.Popen(command)
    try:
        with httpx.Client(base_url=f"http://127.0.0.1:{port}", headers={"Host": NAME}, timeout=30) as client:

            def answers() -> bool:
                assert process.poll() is None
                with suppress(httpx.TransportError):
                    return client.get("/livez").status_code > 0
                return False

            until(answers)
            yield client
    finally:
        stop(process)


def test_a_file_given_by_its_url_may_take_its_time() -> None:
    """It is fetched before the request is answered."""
    nginx = re.search(r"proxy_read_timeout (\d+)s;", (PROXY / "nginx.conf").read_text())
    caddy = re.search(r"response_header_timeout (\d+)s", (PROXY / "Caddyfile").read_text())
    assert nginx is not None
    assert caddy is not None
    for found in (nginx, caddy):
        assert float(found[1]) > Settings().fetch_timeout_s


@pytest.mark.parametrize("is_up", [True, False], ids=["served", "service-away"])
def test_no_log_has_the_signature_of_a_link(is_up: bool, service: Api, tmp_path: Path) -> None:
    path = "/v1/results/res_1/file"
    with nginx_before(service.address[1] if is_up else free_port(), tmp_path) as proxy:
        answer = proxy.get(f"{path}?expires=9&signature=s3cr3t", headers={"Referer": "http://x/?signature=s3cr3t"})
    assert (answer.status_code == 502) is not is_up
    logs = {file.name: file.read_text() for file in (tmp_path / "nginx").glob("*.log")}
    assert path in logs["pvg.access.log"]
    assert [name for name, said in logs.items() if "signature" in said] == []


def test_an_upload_and_its_events_pass(proxy: httpx.Client, service: Api) -> None:
    posted = proxy.post("/v1/references", content=PNG + b"x" * 500_000, headers={"Content-Type": "image/png"})
    assert posted.status_code == 202, posted.text
    assert posted.headers["Location"].startswith("/v1/"), "by the name that the client used"
    medium = posted.json()
    seen = []
    with proxy.stream("GET", f"/v1/jobs/{medium['job']}/events") as events:
        assert events.headers["Content-Type"].startswith("text/event-stream")
        for line in events.iter_lines():
            if not line.startswith("data:"):
                continue
            seen.append(line)
            if len(seen) == 1:  # it was not kept back until there was more
                make_ready(service.services, medium["id"])
    assert len(seen) > 1
    assert '"succeeded"' in seen[-1]
    shown = proxy.get(f"/v1/references/{medium['id']}").json()
    assert shown["state"] == "ready"


def test_what_is_too_large_is_refused_by_the_service(proxy: httpx.Client) -> None:
    answer = proxy.post("/v1/videos", content=b"x" * (2**20 + 1), headers={"Content-Type": "video/mp4"})
    assert answer.status_code == 413
    assert answer.headers["Content-Type"].startswith("application/problem+json")


def test_another_name_does_not_pass(proxy: httpx.Client) -> None:
    assert proxy.get("/v1/videos", headers={"Host": "elsewhere.example"}).status_code == 421
