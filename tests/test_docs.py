"""The documentation builds without a warning, its links lead somewhere, and it needs no network."""

from __future__ import annotations

import shutil
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

ROOT = Path(__file__).resolve().parents[1]
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
LOADED = {("script", "src"), ("link", "href"), ("img", "src"), ("iframe", "src")}
"""What a browser loads by itself."""


class Page(HTMLParser):
    """What a page loads, what it links to, and its anchors."""

    def __init__(self, file: Path) -> None:
        super().__init__()
        self.loads: list[str] = []
        self.links: list[str] = []
        self.anchors: set[str] = set()
        self.feed(file.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name in ("id", "name") and value:
                self.anchors.add(value)
            elif (tag, name) in LOADED and value and ("rel", "canonical") not in attrs:
                self.loads.append(value)
            elif (tag, name) == ("a", "href") and value:
                self.links.append(value)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--quiet", "--site-dir", str(folder)],
        cwd=ROOT, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


@pytest.fixture(scope="module")
def pages(site):
    found = {file: Page(file) for file in site.rglob("*.html") if file.name != "404.html"}
    assert len(found) > 5
    return found


def test_nothing_is_loaded_from_the_network(pages):
    assert not {url for page in pages.values() for url in page.loads if urlsplit(url).netloc}


def test_every_link_leads_somewhere(pages):
    broken = []
    for file, page in pages.items():
        for link in page.links + page.loads:
            url = urlsplit(link)
            if url.scheme or url.netloc:
                continue
            target = (file.parent / unquote(url.path)).resolve() if url.path else file
            there = pages[target].anchors if target in pages else set()
            if not target.is_file() or (url.fragment and unquote(url.fragment) not in there):
                broken.append(f"{file.name}: {link}")
    assert not broken


@pytest.mark.skipif(CHROMIUM is None, reason="no chromium found; Debian: apt-get install chromium")
def test_the_search_works_from_the_disk(site):
    url = f"{(site / 'index.html').as_uri()}?q=Brookmeyer"
    done = subprocess.run(
        [str(CHROMIUM), "--headless", "--no-sandbox", "--disable-gpu", "--dump-dom",
         "--virtual-time-budget=60000", url],
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert "1 matching document" in done.stdout


def test_the_tables_of_the_options_are_those_of_the_program(monkeypatch):
    """``python docs/tables.py`` writes them."""
    monkeypatch.syspath_prepend(str(ROOT / "docs"))
    import tables

    page = tables.PAGE.read_text(encoding="utf-8")
    assert tables.written(page) == page
    assert page.count("| `softmax` |") == 1
