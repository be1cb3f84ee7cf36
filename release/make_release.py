"""Makes a release, all but its upload; `make release VERSION=1.0.0` calls it.

    python3 release/make_release.py VERSION
    python3 release/make_release.py --check VERSION    whether the commit checked out may be published as VERSION

In a new clone it sets the version, turns `Forthcoming` of the changelog into the release, generates documents,
commits and tags, runs every test, and builds what is uploaded. The commit and the tag come into the repository at the
end only, so that a release that fails leaves nothing behind. The release workflow checks the tag that was pushed, so
that no tag made by hand is published.
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
from typing import List, Pattern, Sequence, Tuple

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT)]

from release import manifest  # noqa: E402  # found through the line above

_VERSION = re.compile(r"(0|[1-9]\d*)\.(0|[1-9]\d*)\.(0|[1-9]\d*)\Z")
_FORTHCOMING = re.compile(r"^Forthcoming\n-+\n", re.MULTILINE)
_NEXT_SECTION = re.compile(r"^\d+\.\d+\.\d+ \(", re.MULTILINE)
_NEWS = re.compile(r"^\* ", re.MULTILINE)
_ADDRESS = "<URL of this repository>"
"""Stands in the documents for the address in package.xml."""
GENERATORS = ("docs/generate.py", "docs/draw_structure.py", "docs/list_names.py")
COMMANDS: Sequence[Sequence[str]] = (("make", "test"), *([("make", "deb")] if os.geteuid() == 0 else []))
"""They test everything, and leave in dist/ what is uploaded."""


class Refused(Exception):
    """The release is refused; `str()` is one line with the reason."""


def release(repository: Path, version: str, commands: Sequence[Sequence[str]] = COMMANDS) -> List[Path]:
    """Makes a release of the branch that is checked out; returns the files to upload. Raises Refused."""
    _check_repository(repository, version)
    identity = _identity(repository)
    begun = _git(repository, "rev-parse", "HEAD")
    with tempfile.TemporaryDirectory() as place:
        clone = Path(place, "clone")
        _git(Path(place), "clone", "--quiet", *identity, str(repository), str(clone))
        _check_documents(clone)
        _prepare(clone, version)
        for command in commands:
            _run(clone, command)
        built = clone / "dist"
        built.mkdir(exist_ok=True)
        names = sorted(file.relative_to(built) for file in built.rglob("*") if file.is_file())
        if _git(repository, "rev-parse", "HEAD") != begun or _git(repository, "status", "--porcelain"):
            raise Refused("this repository was changed meanwhile; run make release again")
        _git(repository, "fetch", "--quiet", "--no-tags", str(clone), "HEAD")
        _git(repository, "merge", "--quiet", "--ff-only", "FETCH_HEAD")
        _git(repository, "fetch", "--quiet", "--no-tags", str(clone), f"refs/tags/{version}:refs/tags/{version}")
        target = repository / "dist"
        shutil.copytree(built, target, dirs_exist_ok=True)
    sums = "".join(f"{hashlib.sha256((target / name).read_bytes()).hexdigest()}  {name}\n" for name in names)
    (target / "SHA256SUMS").write_text(sums)
    return [target / name for name in names]


def check_tagged(repository: Path, version: str) -> None:
    """Checks that what is checked out is what `release` made for a version. Raises Refused."""
    _number(version)
    _check_committed(repository)
    package = repository / "package.xml"
    present = manifest.text("version", package)
    if present != version:
        raise Refused(f"package.xml: expected version {version}, as the tag, got {present}")
    if _git(repository, "rev-parse", "--verify", f"refs/tags/{version}^{{commit}}") != _git(
        repository, "rev-parse", "HEAD"
    ):
        raise Refused(f"the tag {version} is another commit than the one that is checked out")
    _check_placeholders(package)
    changelog = (repository / "CHANGELOG.rst").read_text("utf-8")
    if _FORTHCOMING.search(changelog):
        raise Refused(f"CHANGELOG.rst: expected the section Forthcoming to be {version}; use make release")
    if not _news(changelog, _section_of(version)):
        raise Refused(f"CHANGELOG.rst: expected lines that begin with * in a section {version} (date), got none")
    _check_documents(repository)


def _check_repository(repository: Path, version: str) -> None:
    number = _number(version)
    _check_committed(repository)
    package = repository / "package.xml"
    present = manifest.text("version", package)
    if number <= _number(present):
        raise Refused(f"expected a version above {present}, got {version}")
    if _git(repository, "tag", "--list", version):
        raise Refused(f"the tag {version} exists already")
    _check_placeholders(package)
    changelog = (repository / "CHANGELOG.rst").read_text("utf-8")
    if _FORTHCOMING.search(changelog) is None:
        raise Refused("CHANGELOG.rst: expected a section Forthcoming with what is new")
    if not _news(changelog, _FORTHCOMING):
        raise Refused("CHANGELOG.rst: expected lines that begin with * in the section Forthcoming, got none")
    if _section_of(version).search(changelog):
        raise Refused(f"CHANGELOG.rst: has a section {version} already, beside Forthcoming")


def _check_committed(repository: Path) -> None:
    changed = _git(repository, "status", "--porcelain").splitlines()
    if changed:
        raise Refused(f"uncommitted changes, such as {changed[0][3:]}; commit or remove them")


def _check_placeholders(package: Path) -> None:
    placeholders = manifest.placeholders(package)
    if placeholders:
        raise Refused(placeholders[0])


def _section_of(version: str) -> Pattern[str]:
    return re.compile(rf"^{re.escape(version)} \(\d{{4}}-\d\d-\d\d\)\n-+\n", re.MULTILINE)


def _news(changelog: str, title: Pattern[str]) -> bool:
    """Returns whether the section with this title says anything."""
    begin = title.search(changelog)
    if begin is None:
        return False
    end = _NEXT_SECTION.search(changelog, begin.end())
    return _NEWS.search(changelog, begin.end(), end.start() if end else len(changelog)) is not None


def _identity(repository: Path) -> List[str]:
    """Returns the options with which a clone commits under the same name as the repository."""
    try:
        committer = re.match("(.*) <(.*)> ", _git(repository, "var", "GIT_COMMITTER_IDENT"))
    except Refused:
        committer = None
    if committer is None:
        raise Refused("git does not know who commits; set user.name and user.email with git config")
    return ["--config", f"user.name={committer[1]}", "--config", f"user.email={committer[2]}"]


def _number(version: str) -> Tuple[int, ...]:
    match = _VERSION.match(version)
    if match is None:
        raise Refused(f"expected a version such as 1.0.0, got {version!r}")
    return tuple(map(int, match.groups()))


def _check_documents(clone: Path) -> None:
    for script in GENERATORS:
        _run(clone, [sys.executable, script])
        changed = _git(clone, "status", "--porcelain").splitlines()
        if changed:
            raise Refused(f"{changed[0][3:]} is out of date; run python {script} and commit")


def _prepare(clone: Path, version: str) -> None:
    """Commits and tags the version."""
    package, changelog = clone / "package.xml", clone / "CHANGELOG.rst"
    package.write_text(
        re.sub(r"<version>[^<]*</version>", f"<version>{version}</version>", package.read_text("utf-8"), count=1),
        "utf-8",
    )
    title = f"{version} ({datetime.now(timezone.utc):%Y-%m-%d})"
    changelog.write_text(
        _FORTHCOMING.sub(f"{title}\n{'-' * len(title)}\n", changelog.read_text("utf-8"), count=1), "utf-8"
    )
    address = manifest.urls(package)["repository"]
    for page in clone.rglob("*.md"):
        text = page.read_text("utf-8")
        if _ADDRESS in text:
            page.write_text(text.replace(_ADDRESS, address), "utf-8")
    for script in GENERATORS:
        _run(clone, [sys.executable, script])
    _git(clone, "commit", "--quiet", "--all", "--message", version)
    _git(clone, "tag", "--annotate", version, "--message", version)


def _run(folder: Path, command: Sequence[str]) -> None:
    # The tools of make have an environment of their own.
    own = ("VIRTUAL_ENV", "PYTHONPATH", "MAKEFLAGS", "MAKELEVEL", "NOX_")
    variables = {name: value for name, value in os.environ.items() if not name.startswith(own)}
    if subprocess.run(command, cwd=folder, env=variables).returncode:
        raise Refused(f"{' '.join(command)} failed")


def _git(folder: Path, *arguments: str) -> str:
    done = subprocess.run(["git", *arguments], cwd=folder, capture_output=True, text=True)
    if done.returncode:
        raise Refused(f"git {arguments[0]} failed: {done.stderr.strip()}")
    return done.stdout.strip("\n")


def main() -> int:
    """Makes a release, or checks one; returns the exit code."""
    check = sys.argv[1:2] == ["--check"]
    arguments = sys.argv[2:] if check else sys.argv[1:]
    if len(arguments) != 1 or not arguments[0]:
        print("release: expected a version: make release VERSION=1.0.0", file=sys.stderr)
        return 2
    (version,) = arguments
    try:
        if check:
            check_tagged(ROOT, version)
            return 0
        files = release(ROOT, version)
    except Refused as problem:
        print(f"release: {problem}", file=sys.stderr)
        return 1
    print(
        f"{version} is committed and tagged, and these are built:",
        *(f"  {file.relative_to(ROOT)}" for file in files),
        sep="\n",
    )
    print(f"To publish it: git push origin HEAD {version}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
