"""pip, on a machine without ROS: the library, the command and its files."""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path

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


class Environment:
    """A virtual environment of a Python."""

    def __init__(self, workspace: Workspace, python: str) -> None:
        self.folder = workspace.folder / "venv"
        self.variables: dict[str, str] = workspace.variables
        self._package = workspace.package
        run([_PYTHONS[python], "-m", "venv", str(self.folder)], workspace.folder, self.variables)

    def pip(self, command: str, *arguments: str) -> None:
        """Runs pip in the source tree, as people do: pip on Python 3.8 reads a setup.cfg that is there."""
        words = ["-m", "pip", command, "--disable-pip-version-check", *arguments]
        run([str(self.folder / "bin" / "python"), *words], self._package, self.variables)

    def run(self, command: str, *arguments: str) -> str:
        """Runs one of the environment's commands and returns what it printed."""
        return run([str(self.folder / "bin" / command), *arguments], self.folder, self.variables).stdout.strip()

    def module(self) -> Path:
        """Checks that the commands work; returns the folder of the package that they run."""
        assert version() in self.run("robot-health", "--version")
        assert version() in self.run("python", "-m", NAME, "--version")
        assert os.access(self.folder / "bin" / "robot-health", os.X_OK)
        return Path(self.run("python", "-c", f"import {NAME}; print({NAME}.__file__)")).parent


def test_an_sdist_installs_without_the_source_tree_and_a_node_of_ros2_says_what_it_needs(workspace: Workspace) -> None:
    build = "import setuptools.build_meta as backend; print(backend.build_sdist('dist'))"
    archive = run([sys.executable, "-c", build], workspace.package, workspace.variables).stdout.split()[-1]
    (workspace.package / "dist" / archive).rename(workspace.folder / archive)
    shutil.rmtree(workspace.package)
    workspace.package.mkdir()
    environment = Environment(workspace, _NEWEST)
    environment.pip("install", "--no-compile", "--no-deps", str(workspace.folder / archive))
    assert installed_modules(environment.module()) == source_modules()

    node = environment.folder / "bin" / "alert_system"
    done = run([str(node)], environment.folder, environment.variables, fails=True)
    assert (done.returncode, len(done.stdout.splitlines())) == (2, 1), done.stdout
    assert "alert_system: needs ROS 2" in done.stdout


@pytest.mark.parametrize("python", sorted({_OLDEST, _NEWEST}))
def test_the_library_and_the_command_work_without_ros(workspace: Workspace, python: str) -> None:
    environment = Environment(workspace, python)
    environment.pip("install", "--no-deps", "-e", ".")
    assert environment.module() == workspace.package / NAME
    environment.pip("uninstall", "--yes", NAME)

    environment.pip("install", "--no-compile", ".")
    environment.run("python", "-c", _EXAMPLE)
    assert installed_modules(environment.module()) == source_modules()
    check_share(environment.folder / "share" / NAME)
    # What was installed needs nothing of the source tree.
    shutil.rmtree(workspace.package)
    environment.run("robot-health", "check", str(environment.folder / "share" / NAME / "config" / "thresholds.yaml"))
