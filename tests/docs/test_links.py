"""Every link of every page leads somewhere, and the README stays short."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest
from harness.packaging_workspace import version

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = (".", "docs", "docs/reference", "tests", "examples", "benchmarks", "config")
PAGES = [page for folder in FOLDERS for page in sorted((ROOT / folder).glob("*.md"))]
CHANGES = (ROOT / "CHANGELOG.rst").read_text(encoding="utf-8")


def without_code(page: Path) -> str:
    return re.sub(r"^( *)```.*?^\1```", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)


def anchors(page: Path) -> set[str]:
    """Returns the anchors of a page's headings, as GitHub makes them."""
    found: set[str] = set()
    for heading in re.findall(r"^#+ (.*)$", without_code(page), re.MULTILINE):
        anchor = re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-")
        number = 0
        while (f"{anchor}-{number}" if number else anchor) in found:
            number += 1
        found.add(f"{anchor}-{number}" if number else anchor)
    return found


def links(page: Path) -> list[str]:
    return [link for link in re.findall(r"\]\(([^)\s]+)\)", without_code(page)) if "://" not in link]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_no_relative_link_is_dead(page: Path) -> None:
    for link in links(page):
        file, _, anchor = link.partition("#")
        target = page.parent / file if file else page
        assert target.exists(), link
        assert not anchor or anchor in anchors(target), link


def test_every_page_of_the_shelves_can_be_reached_from_the_readme() -> None:
    reached, waiting = {ROOT / "README.md"}, [ROOT / "README.md"]
    while waiting:
        page = waiting.pop()
        for link in links(page):
            target = (page.parent / link.partition("#")[0]).resolve()
            if target.suffix == ".md" and target not in reached:
                reached.add(target)
                waiting.append(target)
    assert [page for page in PAGES if page not in reached] == []


def test_text_that_names_a_page_names_one_that_exists() -> None:
    """Comments, messages and scripts name pages by their path from the root."""
    suffixes = {".py", ".md", ".rst", ".yaml", ".toml", ".js", ".html", ".launch", ".service", ".txt"}
    own: list[Path] = []
    for folder, below, files in os.walk(ROOT):
        below[:] = [name for name in below if name not in (".venv", ".git", "build", "data")]
        own += [file for file in map(Path(folder).joinpath, files) if file.suffix in suffixes and file.is_file()]
    named = {name for file in own for name in re.findall(r"\bdocs/[\w/]+\.md\b", file.read_text(errors="replace"))}
    assert len(named) > 5
    assert [name for name in sorted(named) if not (ROOT / name).exists()] == []


def test_the_readme_has_at_most_120_lines() -> None:
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 120


@pytest.mark.parametrize("page", ["docs/architecture.md", "CONTRIBUTING.md"])
def test_a_file_that_is_named_exists(page: str) -> None:
    text = (ROOT / page).read_text(encoding="utf-8")
    folders = "cli|core|foxglove|runtime|ros1|ros2|rosbridge|recordings|ops|robot_health_monitor|docs"
    named = re.findall(rf"`((?:{folders})/[\w/]+\.\w+)`", text)
    assert [name for name in named if not (ROOT / name).exists()] == []


def test_the_changelog_begins_with_what_is_new_or_with_this_version() -> None:
    latest, *former = re.findall(r"^(\S.*)\n-+$", CHANGES, re.MULTILINE)
    assert re.fullmatch(rf"Forthcoming|{re.escape(version())} \(\d{{4}}-\d\d-\d\d\)", latest)
    assert "Forthcoming" not in former


def test_the_first_release_takes_nothing_back() -> None:
    first = re.split(r"^\S.*\n-+$", CHANGES, flags=re.MULTILINE)[-1]
    assert re.findall(r"\b(?:no longer|is gone|are gone|removed|deprecated)\b", first) == []
