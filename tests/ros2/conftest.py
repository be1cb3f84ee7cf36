"""Two DDS participants for the tests of this folder, on this host only and in a domain that no other run uses."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any, Callable, Iterator, Mapping

import pytest
from harness.line_process import LineProcess
from harness.reserved import ros2_domain

ROOT = Path(__file__).resolve().parents[2]


def pytest_collection_modifyitems(items: Any) -> None:
    """Skips this folder where ROS 2 is missing, and gives the reason."""
    try:
        import rclpy  # noqa: F401
    except ImportError as error:
        for item in items:
            if os.path.dirname(item.path) == os.path.dirname(__file__):
                item.add_marker(pytest.mark.skip(reason=f"no ROS 2: {error}"))


@pytest.fixture(scope="session")
def ros_environment() -> Iterator[dict[str, str]]:
    """Variables that isolate these tests and their processes from other ROS 2 processes."""
    before = dict(os.environ)
    os.environ["ROS_DOMAIN_ID"] = str(ros2_domain("tests"))
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ["PYTHONUNBUFFERED"] = "1"
    for name in ("ROS_STATIC_PEERS", "ROS_LOCALHOST_ONLY", "RCUTILS_CONSOLE_OUTPUT_FORMAT"):
        os.environ.pop(name, None)
    try:
        yield dict(os.environ)
    finally:
        os.environ.clear()
        os.environ.update(before)


@pytest.fixture(scope="session")
def outside(ros_environment: dict[str, str]) -> Iterator[Any]:
    """The participant that represents the rest of the robot."""
    from harness.ros2 import Participant

    participant = Participant(int(ros_environment["ROS_DOMAIN_ID"]))
    try:
        yield participant
    finally:
        participant.close()


@pytest.fixture(scope="session")
def inside(ros_environment: dict[str, str]) -> Iterator[Any]:
    """The participant of the nodes under test, and its spinning thread."""
    from rclpy.executors import SingleThreadedExecutor

    yield from _spinning(ros_environment, SingleThreadedExecutor)


@pytest.fixture(scope="session")
def inside_events(ros_environment: dict[str, str]) -> Iterator[Any]:
    """The same with rclpy's experimental EventsExecutor."""
    experimental = pytest.importorskip("rclpy.experimental", reason="this rclpy has no EventsExecutor")
    yield from _spinning(ros_environment, experimental.EventsExecutor)


def _spinning(ros_environment: dict[str, str], executor_class: Any) -> Iterator[Any]:
    from harness.ros2 import Participant, Spinner

    participant = Participant(int(ros_environment["ROS_DOMAIN_ID"]), executor_class)
    spinner = Spinner(participant)
    try:
        yield participant, spinner
    finally:
        spinner.close()


@pytest.fixture
def start(ros_environment: dict[str, str]) -> Iterator[Callable[..., LineProcess]]:
    """Starts an executable of `ros2_executables.py` from the source tree and ends it after the test."""
    processes: list[LineProcess] = []

    def start_executable(function: str, *arguments: str, environment: Mapping[str, str] | None = None) -> LineProcess:
        code = f"import sys; from robot_health_monitor.cli.ros2_executables import {function}; sys.exit({function}())"
        path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH", "")]))
        variables = {**ros_environment, "PYTHONPATH": path, **(environment or {})}
        processes.append(LineProcess([sys.executable, "-c", code, *arguments], variables))
        return processes[-1]

    yield start_executable
    for process in processes:
        process.end()


@pytest.fixture
def ros(inside: Any, outside: Any) -> Iterator[Any]:
    """The rest of the robot: publishes, subscribes and calls natively."""
    from harness.ros2 import Ros2Harness

    participant, spinner = inside
    harness = Ros2Harness(participant, outside, spinner)
    yield harness
    harness.close()
