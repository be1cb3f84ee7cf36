"""Runs every test that this machine can run, and says at the end what it could not run and why: `make test`.

Each suite runs in an environment of its own under .venv/; its whole output is kept in .venv/results/. Arguments choose
suites by the beginning of their names (`ros1`, `core`, `lint`); without any, all run.
"""

from __future__ import annotations

import ast
import fcntl
import functools
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Callable, Dict, List, Mapping, NamedTuple, Optional, Sequence, Tuple
from xml.etree import ElementTree

from environments import (
    ROOT,
    Unavailable,
    Version,
    ask,
    environment,
    find_pythons,
    install_with_apt,
    requirements_of_tests,
    runtime_requirements,
)

RESULTS = ROOT / ".venv" / "results"
SUITE_TIMEOUT_S = 1200.0
AT_ONCE = 2
"""How many suites run side by side: the tests with a real middleware have deadlines that a crowded machine misses."""

ROS2_REQUIREMENTS = [
    "ros-jazzy-rclpy",
    "ros-jazzy-rmw-fastrtps-cpp",
    "ros-jazzy-std-msgs",
    "ros-jazzy-diagnostic-msgs",
    "ros-std-srvs==5.3.6",
    "ros-sensor-msgs==5.3.6",
]
BUILD_REQUIREMENTS = ["colcon-core>=0.21", "colcon-ros", "colcon-recursive-crawl", "colcon-bash", "colcon-test-result"]
LINT_REQUIREMENTS = ["ruff==0.17.6", "mypy", "import-linter", "types-PyYAML", "types-psutil"]

ROS1_PACKAGES = [
    "catkin",
    "g++",
    "libdiagnostic-aggregator-tools",
    "make",
    "python3-catkin",
    "python3-diagnostic-msgs",
    "python3-diagnostic-updater",
    "python3-pytest",
    "python3-rosbag",
    "python3-rostest",
    "python3-sensor-msgs",
    "python3-std-srvs",
    "ros-core",
    "rosbash",
    "rosdiagnostic",
    "rospack-tools",
]
"""Debian's ROS 1 and what catkin builds with, used where Noetic is not installed."""


class Prepared(NamedTuple):
    """How to run a suite."""

    command: List[str]
    environment: Dict[str, str]
    folder: Path


@dataclass
class Suite:
    """One line of the table at the end."""

    name: str
    prepare: Callable[[Suite], Prepared]
    """Sets up what the suite needs; raises Unavailable."""
    counts_itself: bool = True
    """Whether it writes a junit file; otherwise it is one test, passed when it exits with 0."""
    passed: int = 0
    failed: int = 0
    skipped: Counter[str] = field(default_factory=Counter)
    """How many tests were skipped, by reason."""
    not_run: str = ""
    """Why the suite could not run."""
    took_s: float = 0.0

    @property
    def junit_file(self) -> Path:
        """Where pytest counts."""
        return RESULTS / f"{self.name}.xml"

    @property
    def log_file(self) -> Path:
        """Its whole output."""
        return RESULTS / f"{self.name}.txt"


class Machine:
    """What this machine has, found out once and when it is first needed."""

    def __init__(self) -> None:
        self._lock = threading.RLock()

    @functools.cached_property
    def pythons(self) -> Dict[Version, str]:
        """Interpreters by version, oldest first."""
        with self._lock:
            return find_pythons()

    @functools.cached_property
    def plain_environment(self) -> Dict[str, str]:
        """The variables of this process without those of a ROS that was sourced or of a virtual environment."""
        ours = ("ROS_", "AMENT_", "COLCON_", "CMAKE_PREFIX_PATH", "PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV", "PYTEST_")
        return {name: value for name, value in os.environ.items() if not name.startswith(ours)}

    def sourced(self, ros_version: str, distro: str) -> Optional[Dict[str, str]]:
        """Returns the variables of an installed distribution, from this shell or from /opt/ros; None without one."""
        if os.environ.get("ROS_VERSION") == ros_version:
            return dict(os.environ)
        setup = f"/opt/ros/{distro}/setup.bash"
        if not os.path.exists(setup):
            return None
        shell = ["bash", "-c", f"source {setup} >/dev/null && env -0"]
        printed = subprocess.run(shell, env=self.plain_environment, capture_output=True, text=True).stdout
        return dict(line.split("=", 1) for line in printed.split("\0") if "=" in line)

    @functools.cached_property
    def ros1(self) -> Tuple[str, Dict[str, str]]:
        """The Python that has rospy, and its variables; raises Unavailable."""
        with self._lock:
            noetic = self.sourced("1", "noetic")
            if noetic:
                return "/usr/bin/python3", noetic
            problem = ""
            try:
                install_with_apt(ROS1_PACKAGES)
            except Unavailable as error:
                problem = str(error)
            if ask("/usr/bin/python3", "import rospy", self.plain_environment) is None:
                raise Unavailable(f"no ROS 1: {problem}")
            if problem:
                print(f"ROS 1 is not complete: {problem}", flush=True)
            return "/usr/bin/python3", self.plain_environment

    @functools.cached_property
    def ros2(self) -> Tuple[str, Dict[str, str]]:
        """The Python and the variables of its environment, which has rclpy and colcon; raises Unavailable."""
        with self._lock:
            requirements = [*runtime_requirements(), *requirements_of_tests(), *BUILD_REQUIREMENTS]
            jazzy = self.sourced("2", "jazzy")
            if jazzy:
                made = environment("ros2", "/usr/bin/python3", requirements, system_packages=True, run_with=jazzy)
                return str(made), with_path(jazzy, made)
            for version in ((3, 12), (3, 13), (3, 11), (3, 10), (3, 14)):
                if version in self.pythons:
                    made = environment("ros2", self.pythons[version], [*requirements, *ROS2_REQUIREMENTS])
                    return str(made), with_path(self.plain_environment, made)
            raise Unavailable("no ROS 2: neither Jazzy in /opt/ros nor a Python 3.10 to 3.14 for its wheels")

    @functools.cached_property
    def building(self) -> Tuple[str, Dict[str, str]]:
        """The Python and the variables of an environment that has colcon; raises Unavailable."""
        with self._lock:
            try:
                return self.ros2
            except Unavailable:
                requirements = [*runtime_requirements(), *requirements_of_tests(), *BUILD_REQUIREMENTS]
                made = environment("building", list(self.pythons.values())[-1], requirements)
                return str(made), with_path(self.plain_environment, made)


def with_path(variables: Mapping[str, str], python: Path) -> Dict[str, str]:
    """Returns `variables` with the folder of `python` first in the PATH, and the system's own before the user's."""
    folders = [
        str(python.parent),
        "/usr/sbin",
        "/usr/bin",
        "/sbin",
        "/bin",
        *variables.get("PATH", "").split(os.pathsep),
    ]
    return {**variables, "PATH": os.pathsep.join(dict.fromkeys(folders))}


def pytest_command(suite: Suite, python: str, folders: Sequence[str]) -> List[str]:
    """Returns the command that runs the tests in those of `folders` that are there."""
    there = [folder for folder in folders if (ROOT / folder).is_dir()]
    return [python, "-m", "pytest", "-q", "--color=no", f"--junit-xml={suite.junit_file}", *there]


def core(machine: Machine, version: Version, suite: Suite) -> Prepared:
    """What needs no ROS, on one Python."""
    if version not in machine.pythons:
        raise Unavailable(f"there is no Python {version[0]}.{version[1]} on this machine")
    python = environment(suite.name, machine.pythons[version], [*runtime_requirements(), *requirements_of_tests()])
    command = pytest_command(suite, str(python), ["tests/core", "tests/command_line", "tests/rosbridge"])
    return Prepared(command, with_path(machine.plain_environment, python), ROOT)


def ros1(machine: Machine, suite: Suite) -> Prepared:
    """A real roscore, with the system's Python."""
    python, variables = machine.ros1
    requirements = [*runtime_requirements(), *requirements_of_tests()]
    made = environment(suite.name, python, requirements, system_packages=True, run_with=variables)
    return Prepared(pytest_command(suite, str(made), ["tests/ros1"]), with_path(variables, made), ROOT)


def ros2(machine: Machine, suite: Suite) -> Prepared:
    """A real rclpy over a real RMW."""
    python, variables = machine.ros2
    return Prepared(pytest_command(suite, python, ["tests/ros2"]), variables, ROOT)


def packaging(machine: Machine, suite: Suite) -> Prepared:
    """Workspaces built with colcon, catkin_make and pip."""
    python, variables = machine.building
    try:
        _ = machine.ros1
    except Unavailable:
        pass  # its tests skip what needs catkin, and say so
    return Prepared(pytest_command(suite, python, ["tests/packaging"]), variables, ROOT)


def lint(machine: Machine, tool: Sequence[str], installed: bool, suite: Suite) -> Prepared:
    """One of the tools that read the source; `installed`: it reads an installed copy."""
    with _lint_lock:
        python = environment("lint", list(machine.pythons.values())[-1], [*runtime_requirements(), *LINT_REQUIREMENTS])
        if installed and not _lint_installed:
            copy = [str(python), "-m", "pip", "install", "-q", "--disable-pip-version-check", "--no-deps"]
            subprocess.run([*copy, "--force-reinstall", str(ROOT)], check=True, stdin=subprocess.DEVNULL)
            _lint_installed.append(True)
    command = [str(python.parent / tool[0]), *tool[1:]]
    # Beside the source tree, an installed copy would not be the one that is imported.
    return Prepared(command, with_path(machine.plain_environment, python), python.parent if installed else ROOT)


_lint_lock = threading.Lock()
_lint_installed: List[bool] = []


def all_suites(machine: Machine) -> List[Suite]:
    """Returns every suite, the longest first."""
    newest = max(machine.pythons, default=(3, 8))
    settings = str(ROOT / "pyproject.toml")
    bind = functools.partial
    suites = [
        Suite("packaging", bind(packaging, machine)),
        Suite("ros1", bind(ros1, machine)),
        Suite("ros2", bind(ros2, machine)),
        Suite("core-3.8", bind(core, machine, (3, 8))),
        Suite(f"core-{newest[0]}.{newest[1]}", bind(core, machine, newest)),
        Suite("lint-ruff", bind(lint, machine, ["ruff", "check", "."], False), False),
        Suite("lint-format", bind(lint, machine, ["ruff", "format", "--check", "."], False), False),
        Suite("lint-mypy", bind(lint, machine, ["mypy", "--config-file", settings], True), False),
        Suite("lint-imports", bind(lint, machine, ["lint-imports", "--config", settings], True), False),
    ]
    return suites if newest > (3, 8) else [suite for suite in suites if suite.name != "core-3.8" or newest == (3, 8)]


def run_suite(suite: Suite) -> None:
    """Prepares, runs and counts one suite."""
    started_s = time.monotonic()
    try:
        prepared = suite.prepare(suite)
    except Unavailable as problem:
        suite.not_run = str(problem)
        return
    suite.junit_file.unlink(missing_ok=True)
    with suite.log_file.open("w") as log:
        process = subprocess.Popen(
            prepared.command,
            cwd=prepared.folder,
            env=prepared.environment,
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        running.append(process)
        try:
            exit_code = process.wait(SUITE_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            end(process)
            exit_code = process.wait()
            log.write(f"\nended after {SUITE_TIMEOUT_S:g} s without a result\n")
        finally:
            running.remove(process)
    suite.took_s = time.monotonic() - started_s
    count(suite, exit_code)


running: List[subprocess.Popen[bytes]] = []


def end(process: subprocess.Popen[bytes]) -> None:
    """Ends a suite and whatever it started."""
    try:
        os.killpg(process.pid, signal.SIGKILL)
    except ProcessLookupError:
        pass


def count(suite: Suite, exit_code: int) -> None:
    """Counts what a suite that has ended did."""
    if suite.counts_itself and suite.junit_file.exists():
        for case in ElementTree.parse(suite.junit_file).iter("testcase"):
            skipped = case.find("skipped")
            if case.find("failure") is not None or case.find("error") is not None:
                suite.failed += 1
            elif skipped is not None:
                suite.skipped[skip_reason(skipped)] += 1
            else:
                suite.passed += 1
    elif exit_code == 0:
        suite.passed += 1
    if exit_code and not suite.failed:
        suite.failed += 1  # the suite itself: a tool that complains, a collection that fails, a crash


def skip_reason(skipped: ElementTree.Element) -> str:
    """Returns why a test was skipped; for a whole module pytest writes it into the text, after file and line."""
    message = skipped.get("message", "")
    if message == "collection skipped":
        file, _, reason = ast.literal_eval(skipped.text or "('', 0, '')")
        return f"{os.path.relpath(file, ROOT)}: {reason.replace('Skipped: ', '')}"
    return message


def show(suite: Suite) -> None:
    """Prints how a suite went: pytest's last line, or everything when something failed."""
    if suite.not_run:
        print(f"-- {suite.name}: not run: {suite.not_run}", flush=True)
        return
    output = suite.log_file.read_text(errors="replace").rstrip()
    if not suite.failed:
        output = output.rpartition("\n")[2]
    print(f"-- {suite.name} ({suite.took_s:.0f} s)\n{output}", flush=True)


def summary(suites: Sequence[Suite]) -> str:
    """Returns the table, what was left out and why, and the line that counts everything."""
    lines = ["", f"{'suite':<14}{'passed':>8}{'failed':>8}{'skipped':>9}{'seconds':>9}"]
    for suite in suites:
        if suite.not_run:
            lines.append(f"{suite.name:<14}  not run")
        else:
            skipped = sum(suite.skipped.values())
            lines.append(f"{suite.name:<14}{suite.passed:>8}{suite.failed:>8}{skipped:>9}{suite.took_s:>9.0f}")
    left_out = [f"{suite.name}: {suite.not_run}" for suite in suites if suite.not_run]
    left_out += [f"{suite.name}: {n} skipped: {reason}" for suite in suites for reason, n in suite.skipped.items()]
    if left_out:
        lines += ["", "Not run on this machine:", *(f"  {line}" for line in left_out)]
    passed = sum(suite.passed for suite in suites)
    failed = sum(suite.failed for suite in suites)
    skipped = sum(sum(suite.skipped.values()) for suite in suites)
    return "\n".join([*lines, "", f"{passed} passed, {failed} failed, {skipped} skipped"])


def run_suites(suites: Sequence[Suite]) -> None:
    """Runs all of them, `AT_ONCE` side by side, and shows each when it has ended."""
    waiting: queue.SimpleQueue[Suite] = queue.SimpleQueue()
    for suite in suites:
        waiting.put(suite)
    printing = threading.Lock()

    def work() -> None:
        while True:
            try:
                suite = waiting.get_nowait()
            except queue.Empty:
                return
            try:
                run_suite(suite)
            except Exception as error:  # a defect of this file must not look like success
                suite.failed += 1
                suite.log_file.write_text(f"{type(error).__name__}: {error}\n")
            with printing:
                show(suite)

    workers = [threading.Thread(target=work, daemon=True) for _ in range(AT_ONCE)]
    for worker in workers:
        worker.start()
    try:
        for worker in workers:
            worker.join()
    except KeyboardInterrupt:
        for process in list(running):
            end(process)
        raise


def wait_for_others() -> object:
    """Waits until no other run uses the environments; what it returns keeps others waiting."""
    lock = (RESULTS / "lock").open("w")
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        print("waiting for another `make test` in this folder to end", flush=True)
        fcntl.flock(lock, fcntl.LOCK_EX)
    return lock


def main(names: Sequence[str]) -> int:
    """Runs the suites whose names begin with one of `names`, all without any; returns the exit code."""
    RESULTS.mkdir(parents=True, exist_ok=True)
    lock = wait_for_others()
    try:
        install_with_apt(["prometheus", "python3-venv"])
    except Unavailable as problem:
        print(f"not installed: {problem}", flush=True)
    there = all_suites(Machine())
    suites = [suite for suite in there if not names or suite.name.startswith(tuple(names))]
    if not suites:
        print(f"no such suite; there are {', '.join(suite.name for suite in there)}", file=sys.stderr)
        return 2
    try:
        run_suites(suites)
    except KeyboardInterrupt:
        return 130
    print(summary(suites), flush=True)
    del lock
    return 1 if any(suite.failed for suite in suites) or not any(suite.passed for suite in suites) else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
