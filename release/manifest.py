"""Reads package.xml and asks git, for the release tools."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path
from xml.etree import ElementTree

ROOT = Path(__file__).resolve().parents[1]
MANIFEST = ROOT / "package.xml"
ARCHIVE = ("-c", "tar.umask=0022", "archive")
"""Makes the archive of a commit, with the same modes everywhere."""

_PLACEHOLDER = re.compile(r"[\w.@/:+-]*\b(example\.(com|net|org)|[\w-]+\.(example|invalid|test))\b[\w./-]*")
"""Domains reserved for examples (RFC 2606)."""


class Refused(Exception):
    """A step of a release is refused; `str()` is one line with the reason."""


def git(folder: Path, *arguments: object) -> str:
    """Returns what git prints in a folder; raises Refused if it fails."""
    done = subprocess.run(["git", *map(str, arguments)], cwd=folder, capture_output=True, text=True)
    if done.returncode:
        raise Refused(f"git {arguments[0]} failed: {done.stderr.strip()}")
    return done.stdout.strip("\n")


def unpack_sources(repository: Path, folder: Path, name: str) -> Path:
    """Unpacks the last commit of a repository into a folder; returns the folder `name` in that, with the files."""
    folder.mkdir(parents=True, exist_ok=True)
    git(repository, *ARCHIVE, f"--prefix={name}/", f"--output={folder}/sources.tar", "HEAD")
    shutil.unpack_archive(folder / "sources.tar", folder)
    return folder / name


def text(tag: str, manifest: Path = MANIFEST) -> str:
    """Returns the text of the first element with this tag, or on this path of ElementTree."""
    value = ElementTree.parse(manifest).findtext(tag)
    assert value, f"{manifest} has no {tag}"
    return value


def placeholder(manifest: Path = MANIFEST) -> str:
    """Returns the first placeholder address, empty without one, as in a release; comments may have some."""
    match = _PLACEHOLDER.search(ElementTree.tostring(ElementTree.parse(manifest).getroot(), "unicode"))
    return match[0] if match else ""
