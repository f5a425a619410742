"""The documentation pages work without any other host."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path

import pytest

from service.settings import Settings
from tests.service.fixtures import Api, serve
from tests.service.servers import installed

PAGES = ["/docs", "/redoc"]
ELSEWHERE = re.compile(r"(?:https?:)?//[\w.-]+\.\w+")


class Loads(HTMLParser):
    """What a page has the browser load, and the scripts in the page itself."""

    def __init__(self) -> None:
        super().__init__()
        self.addresses: list[str] = []
        self.scripts: list[str] = []
        self._in_script = False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        self._in_script = tag == "script"
        for name in ("src", "href", "spec-url"):
            if (value := given.get(name)) is not None:
                self.addresses.append(value)

    def handle_endtag(self, tag: str) -> None:
        self._in_script = False

    def handle_data(self, data: str) -> None:
        if self._in_script:
            self.scripts.append(data)


def loads(api: Api, page: str) -> Loads:
    answer = api.client.get(page)
    assert answer.status_code == 200
    assert answer.headers["content-type"].startswith("text/html")
    parser = Loads()
    parser.feed(answer.text)
    return parser


@pytest.mark.parametrize("page", PAGES)
def test_a_page_names_no_other_host_and_all_that_it_loads_is_there(api: Api, page: str) -> None:
    found = loads(api, page)
    types = {".js": "text/javascript", ".css": "text/css", ".png": "image/png", ".json": "application/json"}
    assert any(address.endswith(".js") for address in found.addresses)
    for address in found.addresses:
        assert address.startswith("/"), address
        assert not address.startswith("//"), address
        answer = api.client.get(address)
        assert answer.status_code == 200
        assert answer.headers["content-type"].partition(";")[0] == types[Path(address).suffix]
        assert len(answer.content) > 1000
    assert not [script for script in found.scripts if ELSEWHERE.search(script)]


def test_style_sheets_load_nothing_further(api: Api) -> None:
    sheet = api.client.get("/docs/assets/swagger-ui.css").text
    addresses = re.findall(r"url\(\s*[\"']?([^)\"']+)", sheet)
    assert [address for address in addresses if not address.startswith(("data:", "#"))] == []
    assert "@import" not in sheet


@pytest.mark.parametrize("page", PAGES)
def test_the_browser_is_told_to_load_nothing_from_elsewhere(api: Api, page: str) -> None:
    policy = api.client.get(page).headers["content-security-policy"]
    rules = {rule.split()[0]: set(rule.split()[1:]) for rule in policy.split(";")}
    # nor to show it inside another page
    closed = {rules.pop(name, None) == {"'none'"} for name in ("object-src", "base-uri", "frame-ancestors")}
    assert closed == {True}
    assert rules["default-src"] == {"'self'"}
    assert set().union(*rules.values()) == {"'self'", "'unsafe-inline'", "data:", "blob:"}


def test_the_schema_is_sent_to_no_validator(api: Api) -> None:
    assert any('"validatorUrl": null' in script for script in loads(api, "/docs").scripts)


def test_there_are_no_other_files(api: Api) -> None:
    for name in ("swagger-ui.js", "../core.py", "..%2fcore.py", "%2e%2e/core.py", ""):
        assert api.client.get(f"/docs/assets/{name}").status_code == 404


@pytest.fixture
def proxied(settings: Settings) -> Iterator[Api]:
    """An API behind a proxy that adds a path."""
    yield from serve(settings.model_copy(update={"root_path": "/faces"}))


@pytest.mark.parametrize("page", PAGES)
def test_addresses_have_the_path_of_the_proxy(proxied: Api, page: str) -> None:
    found = loads(proxied, page)
    assert all(address.startswith("/faces/") for address in found.addresses)
    assert found.addresses


def test_a_browser_shows_the_interface(api: Api, tmp_path: Path) -> None:
    browser = installed("chromium", "chromium-browser")
    # every name but ours leads nowhere, so that whatever is loaded from elsewhere is missing from the page
    command = [
        *(browser, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path}"),
        *("--host-resolver-rules=MAP * ~NOTFOUND , EXCLUDE 127.0.0.1", "--virtual-time-budget=20000", "--dump-dom"),
    ]
    page = subprocess.run(
        [*command, f"{api.client.base_url}/docs"], capture_output=True, text=True, check=True, timeout=120
    )
    assert "operations-videos" in page.stdout
    assert "Face colour transfer for portrait video" in page.stdout
