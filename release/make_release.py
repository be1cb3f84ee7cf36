"""Makes a release, all but its upload; `make release VERSION=1.0.0` calls it.

    python3 release/make_release.py VERSION
    python3 release/make_release.py --check VERSION    whether the commit checked out may be published as VERSION

In a work tree beside this one it sets the version, turns `Forthcoming` of the changelog into the release, generates
documents, commits, runs every test, and builds what is uploaded. The commit and its tag come into the branch at the end
only, so that a release that fails leaves nothing behind. The release workflow checks the tag that was pushed, so that
no tag made by hand is published.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import subprocess
import sys
import tempfile
from datetime import datetime, timezone
from pathlib import Path
from typing import Sequence

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT)]

from release import manifest  # noqa: E402  # found through the line above
from release.manifest import Refused, git  # noqa: E402

_VERSION = re.compile(r"(0|[1-9]\d*)\.(0|[1-9]\d*)\.(0|[1-9]\d*)\Z")
_NEWS = re.compile(r"^Forthcoming\n-+\n+\* ", re.MULTILINE)
_ADDRESS = "<URL of this repository>"
"""Stands in the documents for the address in package.xml."""
GENERATORS = ("docs/generate.py", "docs/draw_structure.py", "docs/list_names.py")
COMMANDS: Sequence[Sequence[str]] = (("make", "test"), *([("make", "deb")] if os.geteuid() == 0 else []))
"""They test everything, and leave in dist/ what is uploaded."""


def release(repository: Path, version: str, commands: Sequence[Sequence[str]] = COMMANDS) -> list[Path]:
    """Makes a release of the branch that is checked out; returns the files to upload. Raises Refused."""
    _check_ready(repository, version)
    begun = git(repository, "rev-parse", "HEAD")
    with tempfile.TemporaryDirectory() as place:
        tree = Path(place, "tree")
        git(repository, "worktree", "add", "--quiet", "--detach", tree)
        try:
            _prepare(tree, version)
            for command in commands:
                _run(tree, command)
            _require(
                git(repository, "rev-parse", "HEAD") == begun and not git(repository, "status", "--porcelain"),
                "this repository was changed meanwhile; run make release again",
            )
            git(repository, "merge", "--quiet", "--ff-only", git(tree, "rev-parse", "HEAD"))
            built, target = tree / "dist", repository / "dist"
            names = sorted(file.relative_to(built) for file in built.rglob("*") if file.is_file())
            shutil.copytree(built, target, dirs_exist_ok=True)
        finally:
            git(repository, "worktree", "remove", "--force", tree)
    git(repository, "tag", "--annotate", version, "--message", version)
    sums = "".join(f"{hashlib.sha256((target / name).read_bytes()).hexdigest()}  {name}\n" for name in names)
    (target / "SHA256SUMS").write_text(sums)
    return [target / name for name in names]


def check_tagged(repository: Path, version: str) -> None:
    """Checks that what is checked out is the commit that `release` made for a version and tagged. Raises Refused."""
    _check_committed(repository)
    tagged = git(repository, "log", "-1", "--format=%H %s", f"refs/tags/{version}", "--")
    head = git(repository, "rev-parse", "HEAD")
    _require(tagged.startswith(head), f"the tag {version} is another commit than the one that is checked out")
    _require(
        tagged == f"{head} {version}" and manifest.text("version", repository / "package.xml") == version,
        f"the tag {version} is none of make release, whose commit has its name and sets the version",
    )


def _check_ready(repository: Path, version: str) -> None:
    """Checks what `release` changes."""
    _check_committed(repository)
    present = manifest.text("version", repository / "package.xml")
    _require(_number(version) > _number(present), f"expected a version above {present}, got {version}")
    _require(not git(repository, "tag", "--list", version), f"the tag {version} exists already")
    placeholder = manifest.placeholder(repository / "package.xml")
    _require(not placeholder, f"package.xml: {placeholder} is a placeholder; expected a real address")
    news = _NEWS.search((repository / "CHANGELOG.rst").read_text("utf-8"))
    _require(news, "CHANGELOG.rst: expected a section Forthcoming with what is new, each line behind *")


def _require(condition: object, problem: str) -> None:
    if not condition:
        raise Refused(problem)


def _check_committed(repository: Path) -> None:
    changed = git(repository, "status", "--porcelain")
    _require(not changed, f"uncommitted changes, such as {changed.partition(chr(10))[0][3:]}; commit or remove them")


def _number(version: str) -> tuple[int, ...]:
    match = _VERSION.match(version)
    if match is None:
        raise Refused(f"expected a version such as 1.0.0, got {version!r}")
    return tuple(map(int, match.groups()))


def _prepare(tree: Path, version: str) -> None:
    """Commits the version."""
    title = f"{version} ({datetime.now(timezone.utc):%Y-%m-%d})"
    address = manifest.text("url[@type='repository']", tree / "package.xml")
    _replace(tree / "package.xml", r"<version>[^<]*</version>", f"<version>{version}</version>")
    _replace(tree / "CHANGELOG.rst", r"(?m)^Forthcoming\n-+\n", f"{title}\n{'-' * len(title)}\n")
    for page in tree.rglob("*.md"):
        _replace(page, re.escape(_ADDRESS), address)
    for script in GENERATORS:
        _run(tree, [sys.executable, script])
    git(tree, "commit", "--quiet", "--all", "--message", version)


def _replace(file: Path, old: str, new: str) -> None:
    file.write_text(re.sub(old, new, file.read_text("utf-8")), "utf-8")


def _run(folder: Path, command: Sequence[str]) -> None:
    # The tools of make have an environment of their own.
    own = ("VIRTUAL_ENV", "PYTHONPATH", "MAKEFLAGS", "MAKELEVEL", "NOX_")
    variables = {name: value for name, value in os.environ.items() if not name.startswith(own)}
    _require(not subprocess.run(command, cwd=folder, env=variables).returncode, f"{' '.join(command)} failed")


def main() -> None:
    """Makes a release, or checks one."""
    *options, version = sys.argv[1:] or [""]
    if options == ["--check"]:
        check_tagged(ROOT, version)
        return
    files = release(ROOT, version)
    print(f"{version} is committed and tagged, and these are built:")
    print(*(f"  {file.relative_to(ROOT)}" for file in files), sep="\n")
    print(f"To publish it: git push origin HEAD {version}")


if __name__ == "__main__":
    main()
