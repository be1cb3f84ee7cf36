"""Reads package.xml, runs git and other programs, for the release tools."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

ROOT = Path(__file__).resolve().parents[1]
MANIFEST = ROOT / "package.xml"
ARCHIVE = ("-c", "tar.umask=0022", "archive")
"""Makes the archive of a commit, with the same modes everywhere."""

_PLACEHOLDER = re.compile(r"[\w.@/:+-]*\b(example\.(com|net|org)|[\w-]+\.(example|invalid|test))\b[\w./-]*")
"""Domains reserved for examples (RFC 2606)."""


class Refused(SystemExit):
    """A step of a release is refused or fails, which ends the program; `str()` is the reason."""


def run(folder: Path, *command: object, stdin: str = "", **options: Any) -> str:
    """Returns what a command prints in a folder; raises Refused with all of its output if it fails."""
    words = [*map(str, command)]
    done = subprocess.run(words, cwd=folder, input=stdin, capture_output=True, text=True, **options)
    if done.returncode:
        raise Refused(f"{command[0]} {command[1]} failed: {done.stdout}{done.stderr.strip()}")
    return done.stdout.strip("\n")


def git(folder: Path, *arguments: object) -> str:
    """Returns what git prints in a folder; raises Refused if it fails."""
    return run(folder, "git", *arguments)


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
