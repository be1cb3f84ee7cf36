"""What `make dist` builds: the same bytes each time, and all that needs no ROS, without the sources."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tarfile
import urllib.request
import zipfile
from email import message_from_bytes
from pathlib import Path
from typing import Callable, Iterator

import pytest
from harness.interpreters import find_pythons
from harness.line_process import LineProcess
from harness.packaging_workspace import NAME, ROOT, source_modules, version
from harness.requirements import runtime_requirements
from harness.reserved import free_port

_PYTHONS = find_pythons()
_OLDEST, *_, _NEWEST = [*_PYTHONS, *_PYTHONS]
_LARGEST_BYTES = 3_000_000
_THRESHOLDS = """
battery_sensor:
  ros__parameters:
    battery_level: {source: simulated, discharge_rate: 30.0}
alert_system:
  ros__parameters:
    signals:
      battery_level: {unit: "%", warn_below: 80.0}
"""
_TEST = """
thresholds: {signals: {battery_level: {warn_below: 20.0}}}
tests:
  - {name: low, input: {battery_level: "25x3 19"}, alerts: [{at_s: 4, signal: battery_level, level: WARN}]}
"""

pytestmark = pytest.mark.skipif(not (ROOT / ".git").exists(), reason="no clone: what is built is the last commit")


def built(folder: Path, repository: Path = ROOT, umask: int = 0o022, **variables: str) -> list[Path]:
    """Builds in a clone; returns the files."""
    clone = folder / "clone"
    subprocess.run(["git", "clone", "--quiet", str(repository), str(clone)], check=True)
    script = clone / "release" / "distributions.py"
    command = [sys.executable, str(script), str(folder / "dist")]
    before = os.umask(umask)
    try:
        subprocess.run(command, check=True, cwd=folder, env={**os.environ, **variables})
    finally:
        os.umask(before)
    return sorted((folder / "dist").iterdir())


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Returns what the session `dist` has built, if it runs these tests."""
    folder = os.environ.get("BUILT_DISTRIBUTIONS")
    if folder:
        return sorted(Path(folder).glob(f"{NAME}-{version()}*"))
    return built(tmp_path_factory.mktemp("first"))


@pytest.fixture(scope="module")
def wheel(files: list[Path]) -> Path:
    return next(file for file in files if file.suffix == ".whl")


@pytest.fixture(scope="module")
def sdist(files: list[Path]) -> Path:
    return next(file for file in files if file.suffix == ".gz")


def test_another_user_elsewhere_builds_the_same_bytes(files: list[Path], tmp_path: Path) -> None:
    again = built(tmp_path, umask=0o077, TZ="Asia/Tokyo", LC_ALL="C", PYTHONHASHSEED="7")
    assert [file.name for file in again] == [file.name for file in files]
    assert [file.read_bytes() for file in again] == [file.read_bytes() for file in files]


def test_the_sdist_holds_what_the_repository_holds(sdist: Path) -> None:
    listed = subprocess.run(
        ["git", "-C", str(ROOT), "ls-tree", "-r", "--name-only", "HEAD"], capture_output=True, text=True
    )
    with tarfile.open(sdist) as archive:
        found = {member.name.partition("/")[2] for member in archive.getmembers() if not member.isdir()}
        members = [member for member in archive.getmembers() if not member.issym()]
        owners = {(member.uid, member.gid, member.uname, member.mode & 0o022) for member in members}
    assert found == {"PKG-INFO", *listed.stdout.splitlines()}
    assert owners == {(0, 0, "root", 0)}


def test_the_sdist_gives_the_same_wheel(sdist: Path, wheel: Path, tmp_path: Path) -> None:
    pip = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", str(tmp_path), str(sdist)]
    subprocess.run(pip, check=True)
    (again,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(again) as found, zipfile.ZipFile(wheel) as expected:
        modules = {name for name in expected.namelist() if ".dist-info/" not in name}
        assert {name for name in found.namelist() if ".dist-info/" not in name} == modules
        assert [name for name in modules if found.read(name) != expected.read(name)] == []


def test_the_wheel_holds_the_package_only(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        assert sum(info.file_size for info in archive.infolist()) <= _LARGEST_BYTES
    assert {name.partition("/")[0] for name in names} == {
        NAME,
        *(f"{NAME}-{version()}.{kind}" for kind in ("data", "dist-info")),
    }
    assert {name for name in names if name.startswith(f"{NAME}/")} >= {f"{NAME}/{file}" for file in source_modules()}


def test_the_sbom_lists_what_the_package_needs(wheel: Path) -> None:
    from cyclonedx.schema import SchemaVersion
    from cyclonedx.validation.json import JsonStrictValidator

    with zipfile.ZipFile(wheel) as archive:
        (name,) = [name for name in archive.namelist() if ".dist-info/sboms/" in name]
        text = archive.read(name).decode()
    assert JsonStrictValidator(SchemaVersion.V1_6).validate_str(text) is None
    sbom = json.loads(text)
    component = sbom["metadata"]["component"]
    assert (component["name"], component["version"]) == (NAME, version())
    listed = [each["description"].partition(": ")[2] for each in sbom["components"]]
    assert {*listed} >= {*runtime_requirements()}
    assert any("extra ==" in each for each in listed)


def test_the_readme_in_the_metadata_has_no_links_into_the_repository(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        metadata = message_from_bytes(archive.read(f"{NAME}-{version()}.dist-info/METADATA"))
    assert "](docs/" not in metadata.get_payload()


class Installed:
    """A bare environment with the wheel, away from the sources."""

    def __init__(self, folder: Path, python: str, wheel: Path) -> None:
        self.folder = folder
        own = ("PYTHON", "VIRTUAL_ENV", "PYTEST_")
        self.variables = {name: value for name, value in os.environ.items() if not name.startswith(own)}
        uv = os.environ.get("UV")  # takes a tenth of pip's time; tests/packaging/test_pip.py installs with pip
        without_pip = ["--without-pip"] if uv else []
        subprocess.run([python, "-m", "venv", *without_pip, str(folder / "venv")], check=True)
        interpreter = str(folder / "venv/bin/python")
        pip = [uv, "pip", "install", "--python", interpreter] if uv else [interpreter, "-m", "pip", "install"]
        subprocess.run([*pip, "--quiet", f"{wheel}[recordings]"], check=True, cwd=folder, env=self.variables)

    def command(self, *arguments: object) -> list[str]:
        return [str(self.folder / "venv/bin/robot-health"), *map(str, arguments)]

    def printed(self, *arguments: object) -> str:
        """Runs a command to its good end; returns what it printed."""
        done = subprocess.run(
            self.command(*arguments), cwd=self.folder, env=self.variables, capture_output=True, text=True, timeout=60.0
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout


@pytest.fixture(scope="module", params=sorted({_OLDEST, _NEWEST}))
def installed(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, wheel: Path) -> Installed:
    return Installed(tmp_path_factory.mktemp("installed"), _PYTHONS[request.param], wheel)


@pytest.fixture
def start(installed: Installed) -> Iterator[Callable[..., LineProcess]]:
    """Starts the command; it ends with the test."""
    started: list[LineProcess] = []

    def run(*arguments: object) -> LineProcess:
        started.append(LineProcess(installed.command(*arguments), installed.variables, installed.folder))
        return started[-1]

    yield run
    for process in started:
        process.end()


def test_an_installed_wheel_checks_tests_and_exports(installed: Installed) -> None:
    (installed.folder / "thresholds.yaml").write_text(_THRESHOLDS)
    (installed.folder / "low.test.yaml").write_text(_TEST)
    assert version() in installed.printed("--version")
    assert "OK" in installed.printed("check", "thresholds.yaml")
    assert "OK: 1 test" in installed.printed("test", "low.test.yaml")
    assert "alert: RobotHealth" in installed.printed("export", "prometheus", "thresholds.yaml")
    assert "memory_percent" in installed.printed("sources")


def test_an_installed_wheel_watches_serves_connects_and_remembers(
    installed: Installed, start: Callable[..., LineProcess]
) -> None:
    """The monitor of a simulated robot, its page, a second monitor behind rosbridge, the history and the black box."""
    folder, port = installed.folder, free_port()
    (folder / "thresholds.yaml").write_text(_THRESHOLDS)
    (folder / "ops.yaml").write_text("history: {file: history.db}\nblack_box: {folder: boxes, after_s: 1.0}\n")
    robot = start(
        "run", "--source", "simulated", "--thresholds", "thresholds.yaml", "--ops", "ops.yaml", "--port", port
    )
    robot.wait_for_text("battery_level WARN: ")
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/", timeout=20.0) as answer:
        assert b"<!doctype html>" in answer.read().lower()
    second = start("connect", f"ws://127.0.0.1:{port}", "--thresholds", "thresholds.yaml")
    second.wait_for_text("battery_level WARN: ")
    robot.signal()
    assert robot.wait() == 0
    assert "battery_level WARN" in installed.printed("history", "history.db")
    (box, *_) = sorted((folder / "boxes").glob("*.mcap"))
    replayed = subprocess.run(
        installed.command("replay", box),
        cwd=folder,
        env=installed.variables,
        capture_output=True,
        text=True,
        timeout=60.0,
    )
    assert "battery_level WARN" in replayed.stdout


def test_what_is_installed_is_small(installed: Installed) -> None:
    code = f"import {NAME}; print({NAME}.__file__)"
    python = installed.folder / "venv/bin/python"
    done = subprocess.run([python, "-c", code], capture_output=True, text=True, cwd=installed.folder, check=True)
    module = Path(done.stdout.strip()).parent
    sources = [file for file in module.rglob("*") if file.is_file() and file.suffix != ".pyc"]
    assert sum(file.stat().st_size for file in sources) <= _LARGEST_BYTES
