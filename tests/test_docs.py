"""What the documentation points to is there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "client").glob("*.md")])
FOLDERS = ("pvg", "service", "worker", "tests", "docs", "deploy", "scripts", "benchmarks")
ENDINGS = {".py", ".md", ".yaml", ".yml", ".service", ".conf"}
TEXTS = sorted(
    [*ROOT.glob("*.yml"), *PAGES, *(p for name in FOLDERS for p in (ROOT / name).rglob("*") if p.suffix in ENDINGS)]
)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    links = re.findall(r"\]\(([^)\s#]+)", page.read_text())
    missing = [link for link in links if "://" not in link and not (page.parent / link).exists()]
    assert missing == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_to_sections_lead_to_a_heading(page: Path) -> None:
    links = re.findall(r"\]\(([^)\s#:]*)#([^)\s]+)\)", page.read_text())
    targets = [(page.parent / name if name else page, section) for name, section in links]
    missing = [(str(path), section) for path, section in targets if section not in _anchors(path)]
    assert missing == []


def _anchors(page: Path) -> set[str]:
    """The anchors of a page's headings and tags, as GitHub makes them: small letters, hyphens for blanks."""
    text = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)
    heads = [re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", head) for head in re.findall(r"^#+ (.*)$", text, re.MULTILINE)]
    slugs = {re.sub(r"[^\w\- ]", "", head.strip().lower()).replace(" ", "-") for head in heads}
    return slugs | set(re.findall(r'<a (?:id|name)="([^"]+)"', text))


def test_pages_and_sections_that_are_named_exist() -> None:
    missing = []
    for path in TEXTS:
        # a name may go on in the next line, with or without a comment's mark
        text = re.sub(r"\n\s*(#|#:)?\s*", " ", path.read_text())
        pages = re.findall(r"(?<![\w/])docs/[\w/-]+\.md", text)
        missing += [(path.name, page) for page in pages if not (ROOT / page).exists()]
        for page, section in re.findall(r'(?<![\w/])(docs/[\w/-]+\.md), "([^"]+)"', text):
            heads = re.findall(r"^#+ (.*)$", (ROOT / page).read_text(), re.MULTILINE)
            if section not in heads:
                missing.append((path.name, f"{page}, {section}"))
    assert missing == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_code_files_that_are_named_exist(page: Path) -> None:
    if page.parent.name == "decisions":  # records keep the names of their day
        return
    named = re.findall(r"`([\w.-]+(?:/[\w.-]+)+\.py)`", page.read_text())
    roots = [ROOT, page.parent, *(ROOT / name for name in ("pvg", "service", "service/api", "worker"))]
    assert [name for name in named if not any((root / name).exists() for root in roots)] == []


def test_every_warning_of_a_face_is_explained() -> None:
    folder = ROOT / "pvg" / "vectorization"
    texts = [(folder / name).read_text() for name in ("vector_face.py", "plausible.py")]
    given = [said for text in texts for said in re.findall(r'\.append\(\s*f?"([^"{,:;]+)', text)]
    table = (ROOT / "docs" / "api.md").read_text().partition("\n| a warning of its face |")[2].partition("\n\n")[0]
    explained = [said.partition(" …")[0] for said in re.findall(r"`([^`]+)`", table)]
    assert sorted(said.strip() for said in given) == sorted(explained)
