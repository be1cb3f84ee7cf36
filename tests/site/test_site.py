"""The documentation site that `make docs` has built: its menu, its links, and the API of core."""

from __future__ import annotations

import re
import runpy
import shutil
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

from robot_health_monitor import core

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
SITE = ROOT / "build" / "docs" / "html"
SOURCES = sorted(page.relative_to(DOCS) for suffix in ("md", "rst") for page in DOCS.rglob(f"*.{suffix}"))


class Page(HTMLParser):
    """The addresses and the anchors of one page."""

    def __init__(self, file: Path) -> None:
        super().__init__()
        self.links: list[str] = []
        self.menu: list[str] = []
        self.ids: set[str] = set()
        self._in_menu = 0
        self.feed(file.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        found = dict(attributes)
        self.ids.add(found.get("id") or "")
        address = found.get("href") or found.get("src")
        if tag == "div" and ("sidebar-tree" in (found.get("class") or "") or self._in_menu):
            self._in_menu += 1
        if address:
            self.links.append(address)
            if self._in_menu:
                self.menu.append(address)

    def handle_endtag(self, tag: str) -> None:
        if tag == "div" and self._in_menu:
            self._in_menu -= 1


@pytest.fixture(scope="module")
def pages() -> dict[Path, Page]:
    assert (SITE / "index.html").exists(), "run: make docs"
    return {file: Page(file) for file in SITE.rglob("*.html")}


def test_every_page_of_docs_is_in_the_menu(pages: dict[Path, Page]) -> None:
    menu = pages[SITE / "index.html"].menu
    expected = {page.with_suffix(".html").as_posix() for page in SOURCES} - {"index.html"}
    assert expected - set(menu) == set()


def test_no_link_within_the_site_is_dead(pages: dict[Path, Page]) -> None:
    """Read from the finished pages, so that it holds for pictures, scripts and the menu, too."""
    dead = []
    for file, page in pages.items():
        for link in page.links:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = (file.parent / unquote(parts.path)).resolve() if parts.path else file
            anchored = parts.fragment and target in pages
            if not target.exists() or (anchored and unquote(parts.fragment) not in pages[target].ids):
                dead.append((file.name, link))
    assert dead == []


def test_nothing_is_loaded_from_elsewhere() -> None:
    """The site works on a robot without a network."""
    loading = re.compile(r"""<(?:script|img|link rel="stylesheet"|iframe)[^>]* (?:src|href)="([^"]+)""")
    loaded = {address for file in SITE.rglob("*.html") for address in loading.findall(file.read_text(encoding="utf-8"))}
    assert any(".css" in address for address in loaded) and any(".svg" in address for address in loaded)
    assert [address for address in loaded if "//" in address] == []


def test_files_outside_of_docs_are_linked_in_the_repository(pages: dict[Path, Page]) -> None:
    links = pages[SITE / "operations.html"].links
    assert "https://robot-health-monitor.example/robot_health_monitor/blob/HEAD/examples/ops.yaml" in links


def test_the_addresses_that_nothing_checks_are_listed() -> None:
    listed = (SITE.parent / "external_links.txt").read_text(encoding="utf-8").splitlines()
    assert "https://github.com/ros/diagnostics" in listed
    assert [link for link in listed if not link.startswith("https://")] == []


def test_every_public_name_of_core_has_its_docstring(pages: dict[Path, Page]) -> None:
    described = {anchor.rpartition(".")[2] for anchor in pages[SITE / "reference" / "library.html"].ids}
    assert [name for name in core.__all__ if name not in described] == []
    assert {"observe", "tick", "report"} <= described


def test_there_is_a_search_over_all_pages() -> None:
    index = (SITE / "searchindex.js").read_text(encoding="utf-8")
    missing = [page for page in SOURCES if f'"{page.with_suffix("").as_posix()}"' not in index]
    assert (SITE / "search.html").exists() and missing == []


def test_a_dead_link_fails_the_build(tmp_path: Path) -> None:
    (tmp_path / "docs").mkdir()
    shutil.copy(DOCS / "conf.py", tmp_path / "docs")
    shutil.copy(ROOT / "package.xml", tmp_path)
    (tmp_path / "docs" / "index.md").write_text("# Title\n\n[gone](gone.md)\n", encoding="utf-8")
    build = [sys.executable, "-m", "sphinx", "-q", "-W", "docs", "html"]
    done = subprocess.run(build, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    assert done.returncode != 0
    assert "gone.md" in done.stdout


def test_the_settings_work_in_the_copy_that_rosdoc2_builds(tmp_path: Path) -> None:
    wrapper = tmp_path / "conf.py"
    wrapper.write_text(f'import os\n\nexec(open("{ROOT}/docs/conf.py").read())\n')
    settings = runpy.run_path(str(wrapper))
    assert (settings["DOCS"], settings["ROOT"]) == (tmp_path.resolve(), ROOT)
