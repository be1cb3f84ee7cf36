"""The files of the page: small, without dependencies, and without ways to parse texts as HTML or code."""

from __future__ import annotations

import gzip
import re
from pathlib import Path

import pytest

OPS = Path(__file__).resolve().parents[3] / "ops"
FILES: dict[str, str] = {
    file.name: file.read_text(encoding="utf-8")
    for folder in ("web/page", "plot")
    for file in sorted((OPS / folder).iterdir())
    if file.suffix in (".html", ".css", ".js")
}


def test_the_page_and_its_plot_are_small() -> None:
    contents = [text.encode("utf-8") for text in FILES.values()]
    assert sum(len(gzip.compress(content)) for content in contents) < 48_000  # as sent
    assert sum(map(len, contents)) <= 130_000


@pytest.mark.parametrize("name", FILES)
def test_nothing_comes_from_another_server(name: str) -> None:
    addresses = re.findall(r"\bhttps?://[^\s\"'`)]+", FILES[name])
    assert set(addresses) <= {"http://www.w3.org/2000/svg"}  # a namespace, which is never fetched


@pytest.mark.parametrize("name", [name for name in FILES if name.endswith(".js")])
def test_no_text_is_parsed_as_html_or_code(name: str) -> None:
    forbidden = r"insertAdjacentHTML|outerHTML|document\.write|\beval\(|new Function|DOMParser|innerHTML\s*[+]?="
    assert re.findall(forbidden, FILES[name]) == []


def test_the_policy_finds_nothing_inline() -> None:
    assert re.findall(r"<script(?![^>]*\bsrc=)|<style|\sstyle=|\son\w+=", FILES["index.html"]) == []


def test_every_imported_file_exists() -> None:
    for name, text in FILES.items():
        for imported in re.findall(r"(?:from |import\()\"\./([^\"]+)\"", text):
            assert imported in FILES, f"{name} imports {imported}"
    assert set(re.findall(r"(?:src|href)=\"([\w.]+\.(?:js|css))\"", FILES["index.html"])) <= set(FILES)


def test_every_shape_is_defined() -> None:
    defined = set(re.findall(r"id=\"shape-(\w+)\"", FILES["index.html"]))
    kinds = set(re.findall(r"(\w+): \"[A-Za-z ]+\"", FILES["levels.js"]))
    assert kinds == {"error", "nolink", "stale", "warn", "unknown", "waiting", "ok"}
    assert kinds <= defined
