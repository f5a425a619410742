"""The page at /: its files, what they may load, and that no more than they are given away."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path

import httpx
import pytest

import service
from service.catalog import keys
from service.catalog.keys import Limits
from tests.service.fixtures import Api

WEB = Path(__file__).resolve().parents[3] / "service" / "web"
FILES = sorted(str(path.relative_to(WEB)) for path in WEB.rglob("*") if path.is_file() and path.name != "index.html")
ELSEWHERE = re.compile(r"(?:https?:)?//[\w-]+\.[\w.-]+")
#: the name of the SVG language, not an address
SVG = "http://www.w3.org"


class Page(HTMLParser):
    """What a page loads, and its attributes."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.addresses: list[str] = []
        self.attributes: set[str] = set()
        self.inline: list[str] = []
        self._in = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._in = tag
        self.attributes |= {name for name, _ in attrs}
        self.addresses += [value for name, value in attrs if name in {"src", "href"} and value and value[0] != "#"]

    def handle_endtag(self, tag: str) -> None:
        self._in = ""

    def handle_data(self, data: str) -> None:
        if self._in in {"script", "style"} and data.strip():
            self.inline.append(data)


def test_the_page_loads_its_own_files_by_relative_addresses(api: Api) -> None:
    answer = api.client.get("/")
    assert answer.status_code == 200
    assert answer.headers["content-type"] == "text/html; charset=utf-8"
    page = Page(answer.text)
    assert {"web/style.css", "web/js/main.js", "web/icon.svg"} <= set(page.addresses)
    for address in page.addresses:
        # so that they hold below whatever path a proxy adds
        assert not address.startswith("/")
        assert api.client.get(f"/{address}").status_code == 200, address


def test_nothing_is_written_into_the_page_that_the_policy_forbids(api: Api) -> None:
    page = Page(api.client.get("/").text)
    assert not page.inline
    assert "style" not in page.attributes
    assert not {name for name in page.attributes if name.startswith("on")}


def test_what_the_page_asks_for_is_not_left_in_the_browsers_files() -> None:
    scripts = [path.read_text() for path in sorted(Path(service.__file__).parent.glob("web/js/*.js"))]
    calls = [call for script in scripts for call in re.findall(r"\bfetch\(.*?\}\)", script, re.DOTALL)]
    assert len(calls) == sum(len(re.findall(r"\bfetch\(", script)) for script in scripts) > 2
    assert [call for call in calls if 'cache: "no-store"' not in call] == []


def test_the_browser_is_told_to_load_nothing_from_elsewhere(api: Api) -> None:
    for path in ("/", "/web/style.css", "/web/js/main.js", "/web/icon.svg"):
        check_headers(api.client.get(path).headers)


def check_headers(headers: httpx.Headers) -> None:
    rules = dict(rule.strip().partition(" ")[::2] for rule in headers["content-security-policy"].split(";"))
    assert rules == {
        "default-src": "'none'",
        "script-src": "'self'",
        "style-src": "'self'",
        "img-src": "'self' blob: data:",
        "media-src": "'self' blob:",
        "connect-src": "'self'",
        "form-action": "'none'",
        "frame-ancestors": "'none'",
        "base-uri": "'none'",
    }
    assert headers["x-content-type-options"] == "nosniff"
    assert headers["referrer-policy"] == "no-referrer"
    assert headers["cross-origin-opener-policy"] == "same-origin"


def test_every_file_is_served_as_it_is_and_not_twice(api: Api) -> None:
    for name in FILES:
        answer = api.client.get(f"/web/{name}")
        assert answer.content == (WEB / name).read_bytes()
        assert answer.headers["cache-control"] == "no-cache"
        etag = answer.headers["etag"]
        assert re.fullmatch(r'"[0-9a-f]{64}"', etag)
        again = api.client.get(f"/web/{name}", headers={"If-None-Match": etag})
        assert (again.status_code, again.content, again.headers["etag"]) == (304, b"", etag)
        head = api.client.head(f"/web/{name}")
        assert (head.status_code, head.content) == (200, b"")
        assert head.headers["content-length"] == str(len(answer.content))


@pytest.mark.parametrize("name", ["index.html", *FILES])
def test_a_file_names_no_other_host(name: str) -> None:
    assert set(ELSEWHERE.findall((WEB / name).read_text())) <= {SVG}


def test_modules_import_modules_that_are_there() -> None:
    for module in (WEB / "js").glob("*.js"):
        for imported in re.findall(r'from "([^"]+)"', module.read_text()):
            assert imported.startswith("./")
            assert (module.parent / imported).is_file(), f"{module.name} imports {imported}"


def test_there_are_no_other_files(api: Api) -> None:
    for name in ("", "index.html", "../cli.py", "..%2fcli.py", "%2e%2e/cli.py", "js", "js/none.js"):
        assert api.client.get(f"/web/{name}").status_code == 404


def test_the_page_asks_for_no_key_and_what_it_calls_does(api: Api) -> None:
    with api.services.background.write() as session:
        keys.create(session, "page", Limits(), now=api.services.database.now())
    assert api.client.get("/").status_code == 200
    assert api.client.get("/web/js/main.js").status_code == 200
    assert api.client.get("/videos").status_code == 401
