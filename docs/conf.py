"""Sphinx's settings for the documentation site: `make docs` writes it into build/docs/html.

The pages are plain Markdown that reads the same on the repository's web view. What only the site has is made here: the
menu, from the lists of links in index.md, and the addresses of files outside of docs/, in the repository.
"""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from docutils import nodes
from sphinx.application import Sphinx

DOCS = Path(__file__).resolve().parent
# rosdoc2 builds in a copy of docs/, whose conf.py names the original.
_original = re.search(r'^exec\(open\("(.+)/docs/conf\.py"\)', Path(__file__).read_text("utf-8"), re.MULTILINE)
ROOT = Path(_original[1]) if _original else DOCS.parent
sys.path.insert(0, str(ROOT))

_manifest = ElementTree.parse(ROOT / "package.xml").getroot()
REPOSITORY = _manifest.findtext("url[@type='repository']", "").rstrip("/")

project = "Robot Health Monitor"
author = _manifest.findtext("author", "")
release = version = _manifest.findtext("version", "")
project_copyright = author

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
exclude_patterns: list[str] = []

myst_heading_anchors = 4  # as on the repository's web view
myst_links_external_new_tab = False

autodoc_typehints = "signature"
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
napoleon_google_docstring = True
napoleon_numpy_docstring = False

nitpicky = True
_INTERNAL = "Condition|Faults|Forecast|Judgement|SampleCollector|SampleSummary|Severity|SignalMonitor"
nitpick_ignore_regex = [
    ("py:.*", r"(?!robot_health_monitor\.).*"),  # Python's own types: no inventory is fetched
    ("py:class", rf"robot_health_monitor\.core\.[\w.]+\.({_INTERNAL})"),  # types of a few fields
]

html_theme = "furo"
html_title = f"{project} {version}"
html_copy_source = False
html_show_sphinx = False
html_theme_options = {"source_view_link": f"{REPOSITORY}/blob/HEAD/docs/{{filename}}"}

_external: set[str] = set()


def setup(app: Sphinx) -> dict[str, Any]:
    """Connects the functions of this file."""
    app.connect("source-read", _add_menu)
    app.connect("doctree-read", _link_to_repository)
    app.connect("doctree-resolved", _collect_external_links)
    app.connect("build-finished", _list_external_links)
    return {"parallel_read_safe": True}


def _add_menu(app: Sphinx, docname: str, source: list[str]) -> None:
    """Adds the menu to the first page: a section for each of its headings with links to pages."""
    if docname != app.config.root_doc:
        return
    for section in re.split(r"^## ", source[0], flags=re.MULTILINE)[1:]:
        caption, _, text = section.partition("\n")
        pages = list(dict.fromkeys(re.findall(r"\]\(([\w/]+)\.(?:md|rst)\)", text)))
        if pages:
            source[0] += "\n".join(["", "```{toctree}", ":hidden:", f":caption: {caption}", "", *pages, "```", ""])


def _link_to_repository(app: Sphinx, doctree: nodes.document) -> None:
    """Gives links to files outside of docs/ their address in the repository."""
    folder = (DOCS / app.env.docname).parent
    for node in list(doctree.findall(nodes.Element)):
        if node.get("reftype") != "myst":
            continue
        linked = os.path.relpath(folder / node["reftarget"].partition("#")[0], DOCS.parent)
        target = _existing(ROOT / linked)
        if target and ROOT / "docs" not in (target, *target.parents):
            path = target.relative_to(ROOT).as_posix()
            anchor = f"#{node['reftargetid']}" if node.get("reftargetid") else ""
            node.replace_self(nodes.reference("", "", *node.children, refuri=f"{REPOSITORY}/blob/HEAD/{path}{anchor}"))


def _existing(path: Path) -> Path | None:
    """Returns the file or folder of a link's target; Sphinx has removed the suffix of documents."""
    if ROOT not in path.parents:
        return None
    return next(
        (each for each in (path, *(Path(f"{path}{suffix}") for suffix in source_suffix)) if each.exists()), None
    )


def _collect_external_links(app: Sphinx, doctree: nodes.document, docname: str) -> None:
    _external.update(node["refuri"] for node in doctree.findall(nodes.reference) if "://" in node.get("refuri", ""))


def _list_external_links(app: Sphinx, error: Exception | None) -> None:
    """Writes the addresses that the build does not check beside the site."""
    if not error:
        listed = "".join(f"{link}\n" for link in sorted(_external))
        (Path(app.outdir).parent / "external_links.txt").write_text(listed, encoding="utf-8")
