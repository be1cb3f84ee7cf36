"""`make release`: what it refuses, in one line each, and what it leaves in the repository."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path
from typing import Callable

import pytest
import yaml

from release.make_release import GENERATORS, check_tagged, release
from release.manifest import Refused

ROOT = Path(__file__).resolve().parents[2]
BUILDS = ["sh", "-c", "mkdir -p dist && echo wheel > dist/a.whl"]
PACKAGE = """<package format="3">
  <name>robot_health_monitor</name>
  <version>0.1.0</version>
  <maintainer email="somebody@robots.dev">Somebody</maintainer>
  <url type="repository">https://robots.dev/monitor</url>
</package>
"""
CHANGELOG = """Changelog
^^^^^^^^^

Forthcoming
-----------
* A new thing.

0.1.0 (2026-01-02)
------------------
* The first things.
"""


def git(folder: Path, *arguments: str) -> str:
    done = subprocess.run(["git", *arguments], cwd=folder, check=True, capture_output=True, text=True)
    return done.stdout.strip()


@pytest.fixture
def repository(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A repository that could be released; its only generated document has the version."""
    for variable in ("AUTHOR", "COMMITTER"):
        monkeypatch.setenv(f"GIT_{variable}_NAME", "Somebody")
        monkeypatch.setenv(f"GIT_{variable}_EMAIL", "somebody@robots.dev")
    folder = tmp_path / "repository"
    files: dict[str, str] = {
        "package.xml": PACKAGE,
        "CHANGELOG.rst": CHANGELOG,
        ".gitignore": "/dist/\n",
        "docs/version.txt": "0.1.0\n",
        "docs/install.md": "git clone <URL of this repository> monitor\n",
        **dict.fromkeys(GENERATORS, ""),
        GENERATORS[0]: (
            "import re, pathlib\n"
            "found = re.search('<version>(.*)</version>', pathlib.Path('package.xml').read_text())\n"
            "pathlib.Path('docs/version.txt').write_text(found[1] + '\\n')\n"
        ),
    }
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    git(folder, "init", "--quiet", "--initial-branch", "main")
    git(folder, "add", ".")
    git(folder, "commit", "--quiet", "--message", "first")
    return folder


def test_a_release_is_a_commit_a_tag_and_files(repository: Path) -> None:
    files = release(repository, "1.0.0", [BUILDS])
    assert [file.name for file in files] == ["a.whl"]
    check = subprocess.run(["sha256sum", "--check", "--strict", "SHA256SUMS"], cwd=repository / "dist")
    assert check.returncode == 0
    assert "<version>1.0.0</version>" in (repository / "package.xml").read_text()
    assert (repository / "docs/version.txt").read_text() == "1.0.0\n"
    assert (repository / "docs/install.md").read_text() == "git clone https://robots.dev/monitor monitor\n"
    changelog = (repository / "CHANGELOG.rst").read_text().splitlines()
    assert changelog[3].startswith("1.0.0 (20")
    assert changelog[4] == "-" * len(changelog[3])
    assert changelog[5:8] == ["* A new thing.", "", "0.1.0 (2026-01-02)"]
    assert git(repository, "rev-parse", "1.0.0^{commit}") == git(repository, "rev-parse", "HEAD")
    assert git(repository, "status", "--porcelain") == ""


def changed(name: str, old: str, new: str) -> Callable[[Path], None]:
    """Returns a commit that replaces a text in a file."""

    def change(repository: Path) -> None:
        text = (repository / name).read_text()
        assert old in text
        (repository / name).write_text(text.replace(old, new))
        git(repository, "commit", "--quiet", "--all", "--message", "a change")

    return change


@pytest.mark.parametrize(
    ("prepare", "version", "problem"),
    [
        (lambda _: None, "1.0", "expected a version such as 1.0.0, got '1.0'"),
        (lambda _: None, "v1.0.0", "expected a version such as 1.0.0, got 'v1.0.0'"),
        (lambda _: None, "01.0.0", "expected a version such as 1.0.0, got '01.0.0'"),
        (lambda _: None, "0.1.0", "expected a version above 0.1.0, got 0.1.0"),
        (lambda _: None, "0.0.9", "expected a version above 0.1.0, got 0.0.9"),
        (lambda repository: git(repository, "tag", "1.0.0"), "1.0.0", "the tag 1.0.0 exists already"),
        (
            lambda repository: (repository / "new.py").write_text(""), "1.0.0",
            "uncommitted changes, such as new.py; commit or remove them",
        ),
        (
            changed("package.xml", "robots.dev", "robots.example"), "1.0.0",
            "package.xml: somebody@robots.example is a placeholder; expected a real address",
        ),
        (
            changed("CHANGELOG.rst", "Forthcoming", "Later"), "1.0.0",
            "CHANGELOG.rst: expected a section Forthcoming with what is new, each line behind *",
        ),
        (
            changed("CHANGELOG.rst", "* A new thing.\n", ""), "1.0.0",
            "CHANGELOG.rst: expected a section Forthcoming with what is new, each line behind *",
        ),
        (
            changed("CHANGELOG.rst", "* A new thing.\n", "Nothing: 2 * 2 lines.\n"), "1.0.0",
            "CHANGELOG.rst: expected a section Forthcoming with what is new, each line behind *",
        ),
    ],
)  # fmt: skip
def test_what_is_not_ready_is_refused_and_nothing_changes(
    repository: Path, prepare: Callable[[Path], object], version: str, problem: str
) -> None:
    prepare(repository)
    before = git(repository, "rev-parse", "HEAD"), git(repository, "tag"), git(repository, "status", "--porcelain")
    with pytest.raises(Refused) as refused:
        release(repository, version, [BUILDS])
    assert str(refused.value) == problem
    after = git(repository, "rev-parse", "HEAD"), git(repository, "tag"), git(repository, "status", "--porcelain")
    assert after == before


def test_a_test_that_fails_leaves_nothing_behind(repository: Path) -> None:
    before = git(repository, "rev-parse", "HEAD")
    with pytest.raises(Refused, match="false failed"):
        release(repository, "1.0.0", [BUILDS, ["false"]])
    assert (git(repository, "rev-parse", "HEAD"), git(repository, "tag")) == (before, "")
    assert not (repository / "dist").exists()


def test_who_commits_may_be_known_to_this_repository_only(repository: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for variable in ("AUTHOR_NAME", "AUTHOR_EMAIL", "COMMITTER_NAME", "COMMITTER_EMAIL"):
        monkeypatch.delenv(f"GIT_{variable}")
    monkeypatch.setenv("GIT_CONFIG_GLOBAL", "/dev/null")
    monkeypatch.setenv("GIT_CONFIG_SYSTEM", "/dev/null")
    git(repository, "config", "user.useConfigOnly", "true")
    with pytest.raises(Refused, match=r"^git commit failed: .*\n"):
        release(repository, "1.0.0", [BUILDS])
    git(repository, "config", "user.name", "Ann Maintainer")
    git(repository, "config", "user.email", "ann@robots.dev")
    release(repository, "1.0.0", [BUILDS])
    assert git(repository, "log", "-1", "--format=%an %ae") == "Ann Maintainer ann@robots.dev"


@pytest.mark.parametrize("change", ["git commit --quiet --allow-empty --message later", "touch later.py"])
def test_a_change_while_the_tests_run_is_no_release(repository: Path, change: str) -> None:
    with pytest.raises(Refused, match=r"^this repository was changed meanwhile; run make release again$"):
        release(repository, "1.0.0", [BUILDS, ["sh", "-c", f"cd '{repository}' && {change}"]])
    assert git(repository, "tag") == ""
    assert not (repository / "dist").exists()


def test_what_make_release_tagged_may_be_published(repository: Path) -> None:
    release(repository, "1.0.0", [BUILDS])
    check_tagged(repository, "1.0.0")


def tag_by_hand(repository: Path) -> None:
    """The version in package.xml and the generated documents, but nothing else of `make release`."""
    changed("package.xml", "0.1.0", "1.0.0")(repository)
    changed("docs/version.txt", "0.1.0", "1.0.0")(repository)
    git(repository, "tag", "1.0.0")


def released_then(*changes: Callable[[Path], None]) -> Callable[[Path], None]:
    """Returns a release with further commits, to which its tag was moved."""

    def prepare(repository: Path) -> None:
        release(repository, "1.0.0", [BUILDS])
        for change in changes:
            change(repository)
        git(repository, "tag", "--force", "1.0.0")

    return prepare


NOT_MADE = "the tag 1.0.0 is none of make release, whose commit has its name and sets the version"


@pytest.mark.parametrize(
    ("prepare", "version", "problem"),
    [
        (released_then(), "1.0", "git log failed: fatal: bad revision 'refs/tags/1.0'"),
        (lambda repository: git(repository, "tag", "1.0.0"), "1.0.0", NOT_MADE),
        (tag_by_hand, "1.0.0", NOT_MADE),
        (released_then(changed("CHANGELOG.rst", "1.0.0 (", "0.9.0 (")), "1.0.0", NOT_MADE),
        (released_then(changed("package.xml", "somebody@", "anybody@")), "1.0.0", NOT_MADE),
        (
            released_then(lambda repository: (repository / "new.py").write_text("")), "1.0.0",
            "uncommitted changes, such as new.py; commit or remove them",
        ),
    ],
)  # fmt: skip
def test_a_tag_that_make_release_did_not_make_is_not_published(
    repository: Path, prepare: Callable[[Path], object], version: str, problem: str
) -> None:
    prepare(repository)
    with pytest.raises(Refused) as refused:
        check_tagged(repository, version)
    assert str(refused.value) == problem


def test_a_commit_that_is_named_like_the_tag_but_sets_no_version_is_not_published(repository: Path) -> None:
    git(repository, "commit", "--quiet", "--allow-empty", "--message", "1.0.0")
    git(repository, "tag", "1.0.0")
    with pytest.raises(Refused) as refused:
        check_tagged(repository, "1.0.0")
    assert str(refused.value) == NOT_MADE


def test_a_tag_of_another_commit_is_not_published(repository: Path) -> None:
    release(repository, "1.0.0", [BUILDS])
    git(repository, "commit", "--quiet", "--allow-empty", "--message", "later")
    with pytest.raises(Refused, match=r"^the tag 1\.0\.0 is another commit than the one that is checked out$"):
        check_tagged(repository, "1.0.0")


def test_the_workflow_builds_only_what_was_checked_and_tested_and_publishes_only_what_was_built() -> None:
    jobs = yaml.safe_load((ROOT / ".github/workflows/release.yml").read_text())["jobs"]
    steps = [step["run"] for step in jobs["build"]["steps"] if "run" in step]
    tools = re.search(r"Build-Depends: debhelper-compat.*?, (.*)", (ROOT / "release/debian/control").read_text())
    assert tools is not None
    needed = ["debhelper", *(name for name in tools[1].split(", ") if name != "python3")]
    assert steps == [
        'make check-release VERSION="$GITHUB_REF_NAME"',
        "make dist",
        f"sudo apt-get install --yes --no-install-recommends {' '.join(needed)}",
        "/usr/bin/python3 release/debs.py dist/debian robot-health",
    ]
    assert "debian" not in str(jobs["pypi"])  # PyPI refuses a folder with other files
    assert jobs["test"]["uses"] == "./.github/workflows/ci.yml"
    assert {name: job.get("needs") for name, job in jobs.items()} == {
        "test": None, "build": "test", "attest": "build", "pypi": "attest", "github": "pypi",
    }  # fmt: skip
    called = yaml.safe_load((ROOT / ".github/workflows/ci.yml").read_text())
    assert "workflow_call" in called[True]  # YAML 1.1 reads `on` as true
