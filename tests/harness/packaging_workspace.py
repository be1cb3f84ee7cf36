"""Copies of the source tree, built for real, and the shells of those who use what was built."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import threading
import time
import xmlrpc.client
from pathlib import Path
from typing import Sequence
from xml.etree import ElementTree

import pytest

from harness.requirements import package_folders
from harness.reserved import free_port, ros2_domain

ROOT = Path(__file__).resolve().parents[2]
NAME = "robot_health_monitor"
NODES = ("aggregator", "alert_system", "battery_sensor", "health_monitor")
FOLDERS = package_folders()
DEADLINE_S = 60.0

_NOT_SOURCE = shutil.ignore_patterns(
    ".git", ".*_cache", ".venv", ".hypothesis", "__pycache__", "*.egg-info", "build", "install", "devel", "log"
)


def version() -> str:
    """Returns the version in package.xml."""
    found = ElementTree.parse(ROOT / "package.xml").findtext("version")
    assert found
    return found


def clean_environment(folder: Path) -> dict[str, str]:
    """Returns the variables of a user who has sourced nothing; ROS keeps its files in `folder`."""
    ours = ("ROS_", "AMENT_", "COLCON_", "CMAKE_PREFIX_PATH", "PYTHON", "VIRTUAL_ENV", "PYTEST_")
    variables = {name: value for name, value in os.environ.items() if not name.startswith(ours)}
    return {
        **variables,
        "PATH": "/usr/local/bin:/usr/bin:/bin",
        "ROS_MASTER_URI": f"http://127.0.0.1:{free_port()}",
        "ROS_IP": "127.0.0.1",
        "ROS_DOMAIN_ID": str(ros2_domain("packaging")),
        "ROS_LOCALHOST_ONLY": "1",
        "ROS_HOME": str(folder / "ros"),
        "ROS_LOG_DIR": str(folder / "ros" / "log"),
    }


def run(
    command: Sequence[str], folder: Path, variables: dict[str, str], fails: bool = False
) -> subprocess.CompletedProcess[str]:
    """Runs a command to its end, which must be a good one unless it `fails`."""
    done = subprocess.run(
        command,
        cwd=folder,
        env={**variables, "PWD": str(folder)},  # catkin_make believes it
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=300,
    )
    assert (done.returncode != 0) == fails, f"{' '.join(command)} exited with {done.returncode}:\n{done.stdout}"
    return done


class Workspace:
    """A workspace with this package in src/."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.package = folder / "src" / NAME
        self.variables = clean_environment(folder)
        self.setup = Path()
        """The file that a user sources after the build."""
        self.prefix = Path()
        """What holds lib/ and share/ after the build."""
        shutil.copytree(ROOT, self.package, ignore=_NOT_SOURCE, symlinks=True)

    def colcon(self, verb: str, ros_version: str, *options: str, fails: bool = False) -> str:
        """Runs `colcon build` or `colcon test` as the README says, and returns its output."""
        bases = ["--build-base", f"build/ros{ros_version}", "--install-base", f"install/ros{ros_version}"]
        self.use_colcon(ros_version)
        return run(
            [colcon(), verb, *bases, *options],
            self.folder,
            {**self.variables, "ROS_VERSION": ros_version},
            fails,
        ).stdout

    def use_colcon(self, ros_version: str) -> Workspace:
        """Uses what colcon has built for this ROS."""
        base = self.folder / "install" / f"ros{ros_version}"
        self.setup, self.prefix = base / "setup.bash", base / NAME
        return self

    def use_space(self, name: str) -> Workspace:
        """Uses the space `devel` or `install` that catkin_make has built."""
        self.prefix = self.folder / name
        self.setup = self.prefix / "setup.bash"
        return self

    def catkin_make(self, *targets: str) -> str:
        """Runs `catkin_make` and returns its output."""
        self.use_space("devel")
        return run(["catkin_make", *targets], self.folder, self.variables).stdout

    def shell(self, command: str, fails: bool = False) -> str:
        """Runs `command` in a shell that has sourced the workspace, and returns what it printed."""
        script = f"source '{self.setup}' >/dev/null && {command}"
        return run(["bash", "-c", script], self.folder, self.variables, fails).stdout.strip()

    def start(self, command: str, **variables: str) -> subprocess.Popen[str]:
        """Starts `command` in such a shell, with more variables."""
        return subprocess.Popen(
            ["bash", "-c", f"source '{self.setup}' >/dev/null && exec {command}"],
            cwd=self.folder,
            env={**self.variables, **variables},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )

    def wait_for_node(self, node: str) -> None:
        """Waits until the ROS 1 master of this workspace knows `node`."""
        pause = threading.Event()
        deadline_s = time.monotonic() + DEADLINE_S
        while time.monotonic() < deadline_s:
            try:
                code, _, _ = xmlrpc.client.ServerProxy(self.variables["ROS_MASTER_URI"]).lookupNode("/tests", node)
            except OSError:
                code = 0
            if code == 1:
                return
            pause.wait(0.1)
        raise AssertionError(f"the master does not know {node} after {DEADLINE_S:g} s")

    def replace_tests(self, body: str) -> None:
        """Leaves one test in the package, whose function does `body`. No build reads the tests."""
        shutil.rmtree(self.package / "tests")
        folder = self.package / "tests" / "core"
        folder.mkdir(parents=True)
        (folder / "test_one.py").write_text(
            f"import {NAME}.core\n\n\ndef test_the_only_one():\n    {body}\n", encoding="utf-8"
        )


def colcon() -> str:
    """Returns colcon's path; skips the test where there is none."""
    beside = Path(sys.executable).parent / "colcon"
    found = str(beside) if beside.exists() else shutil.which("colcon")
    if not found:
        pytest.skip("colcon is not installed")
    return found


_TOOLS_OF_ROS1 = ("catkin_make", "roslaunch", "rosrun", "rospack", "cmake", "c++")


def has_ros1() -> bool:
    """Returns whether there is a ROS 1 to build for."""
    return all(map(shutil.which, _TOOLS_OF_ROS1))


def need_ros1() -> None:
    """Skips the test where there is no ROS 1 to build for."""
    for tool in _TOOLS_OF_ROS1:
        if not shutil.which(tool):
            pytest.skip(f"no ROS 1 to build for: {tool} is not installed")


def need_pytest_of_ros1() -> None:
    """Skips the test where the Python of ROS 1 has no pytest, with which catkin runs the tests."""
    if subprocess.run(["/usr/bin/python3", "-c", "import pytest"], capture_output=True).returncode:
        pytest.skip("/usr/bin/python3 has no pytest (Debian's package python3-pytest)")


def source_modules() -> Sequence[str]:
    """Returns the package's files as they must be after an installation, relative to its folder."""
    files = [path.relative_to(ROOT) for folder in FOLDERS for path in (ROOT / folder).rglob("*.py")]
    files += [path.relative_to(ROOT / NAME) for path in (ROOT / NAME).rglob("*.py")]
    return sorted(str(path) for path in [*files, Path("py.typed")])


def installed_modules(folder: Path) -> Sequence[str]:
    """Returns the package's files in an installed copy."""
    files = [path for pattern in ("*.py", "py.typed") for path in folder.rglob(pattern)]
    return sorted(str(path.relative_to(folder)) for path in files)


def check_share(share: Path) -> None:
    """Checks that launch and configuration files and the systemd unit are installed, all of them."""
    for folder, pattern in (("launch", "*.launch"), ("launch", "*.launch.py"), ("config", "*.yaml")):
        wanted = sorted(path.name for path in (ROOT / folder).glob(pattern))
        assert wanted
        assert sorted(path.name for path in (share / folder).glob(pattern)) == wanted
    assert (share / "package.xml").is_file()
    if not (share / "CMakeLists.txt").is_file():  # an installed copy
        assert (share / "systemd" / "robot-health.service").is_file()
