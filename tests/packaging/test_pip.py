"""pip, on a machine without ROS: the library, the command and its files."""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path
from typing import Dict, List

import pytest
from harness.interpreters import find_pythons
from harness.packaging_workspace import NAME, Workspace, check_share, installed_modules, run, source_modules, version

_PYTHONS = find_pythons()
_OLDEST, *_, _NEWEST = [*_PYTHONS, *_PYTHONS]
_EXAMPLE = """
from robot_health_monitor.core import Level, Monitor, Sample, load_config

monitor = Monitor(load_config({"signals": {"battery_level": {"warn_below": 20.0, "for_s": 3.0}}}))
found = []
for now_s, percent in enumerate([25.0, 19.0, 18.0, 18.0, 18.0]):
    found += monitor.observe(Sample("battery_level", percent, float(now_s)))
assert [(t.from_level, t.to_level, t.now_s) for t in found] == [(Level.OK, Level.WARN, 4.0)], found
assert monitor.tick(5.0) == []
assert monitor.report(5.0).statuses["battery_level"].level is Level.WARN
"""


class Installed:
    """A virtual environment in which pip has installed the package."""

    def __init__(self, workspace: Workspace, python: str, options: List[str], source: str = ".") -> None:
        self.folder = workspace.folder / "venv"
        self.variables: Dict[str, str] = workspace.variables
        run([python, "-m", "venv", str(self.folder)], workspace.folder, self.variables)
        # In the source tree, as people do: pip on Python 3.8 reads a setup.cfg that is there.
        pip = ["-m", "pip", "install", "--no-compile", "--disable-pip-version-check", *options, source]
        run([str(self.folder / "bin" / "python"), *pip], workspace.package, self.variables)

    def run(self, command: str, *arguments: str) -> str:
        """Runs one of the environment's commands and returns what it printed."""
        return run([str(self.folder / "bin" / command), *arguments], self.folder, self.variables).stdout.strip()


def test_an_sdist_holds_the_folders_and_installs_without_the_source_tree(workspace: Workspace) -> None:
    build = "import setuptools.build_meta as backend; print(backend.build_sdist('dist'))"
    archive = run([sys.executable, "-c", build], workspace.package, workspace.variables).stdout.split()[-1]
    (workspace.package / "dist" / archive).rename(workspace.folder / archive)
    shutil.rmtree(workspace.package)
    workspace.package.mkdir()
    installed = Installed(workspace, _PYTHONS[_NEWEST], ["--no-deps"], str(workspace.folder / archive))
    assert version() in installed.run("robot-health", "--version")
    module = Path(installed.run("python", "-c", f"import {NAME}; print({NAME}.__file__)")).parent
    assert installed_modules(module) == source_modules()


@pytest.mark.parametrize("options", [[], ["--no-deps", "-e"]], ids=["install", "install -e"])
@pytest.mark.parametrize("python", sorted({_OLDEST, _NEWEST}))
def test_the_library_and_the_command_work_without_ros(workspace: Workspace, python: str, options: List[str]) -> None:
    installed = Installed(workspace, _PYTHONS[python], options)
    assert version() in installed.run("robot-health", "--version")
    assert version() in installed.run("python", "-m", NAME, "--version")
    module = Path(installed.run("python", "-c", f"import {NAME}; print({NAME}.__file__)")).parent
    if options:
        assert module == workspace.package / NAME
    else:
        installed.run("python", "-c", _EXAMPLE)
        assert installed_modules(module) == source_modules()
        check_share(installed.folder / "share" / NAME)
        # What was installed needs nothing of the source tree.
        shutil.rmtree(workspace.package)
        installed.run("robot-health", "check", str(installed.folder / "share" / NAME / "config" / "thresholds.yaml"))
    assert os.access(installed.folder / "bin" / "robot-health", os.X_OK)


def test_a_node_of_ros2_says_without_ros_what_it_needs(workspace: Workspace) -> None:
    installed = Installed(workspace, _PYTHONS[_NEWEST], ["--no-deps"])
    node = installed.folder / "bin" / "alert_system"
    done = run([str(node)], installed.folder, installed.variables, fails=True)
    assert (done.returncode, len(done.stdout.splitlines())) == (2, 1), done.stdout
    assert "alert_system: needs ROS 2" in done.stdout
