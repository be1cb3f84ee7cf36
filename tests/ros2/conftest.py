"""Two DDS participants for the tests of this folder, on this host only and in a domain of their own."""

from __future__ import annotations

import os
from typing import Any, Dict, Iterator

import pytest


def pytest_collection_modifyitems(items: Any) -> None:
    """Skips this folder where there is no ROS 2, and says so."""
    try:
        import rclpy  # noqa: F401
    except ImportError as error:
        for item in items:
            if os.path.dirname(item.path) == os.path.dirname(__file__):
                item.add_marker(pytest.mark.skip(reason=f"ROS 2 is not here: {error}"))


@pytest.fixture(scope="session")
def ros_environment() -> Iterator[Dict[str, str]]:
    """Variables that keep these tests and their processes among themselves."""
    before = dict(os.environ)
    os.environ["ROS_DOMAIN_ID"] = str(1 + os.getpid() % 100)
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ["PYTHONUNBUFFERED"] = "1"
    for name in ("ROS_STATIC_PEERS", "RCUTILS_CONSOLE_OUTPUT_FORMAT"):
        os.environ.pop(name, None)
    try:
        yield dict(os.environ)
    finally:
        os.environ.clear()
        os.environ.update(before)


@pytest.fixture(scope="session")
def outside(ros_environment: Dict[str, str]) -> Iterator[Any]:
    """The participant that stands for everybody else on the robot."""
    from ros2_harness import Participant

    participant = Participant(int(ros_environment["ROS_DOMAIN_ID"]))
    try:
        yield participant
    finally:
        participant.close()


@pytest.fixture(scope="session")
def inside(ros_environment: Dict[str, str]) -> Iterator[Any]:
    """The participant of the nodes under test, and the thread that spins it."""
    from ros2_harness import Participant, Spinner

    participant = Participant(int(ros_environment["ROS_DOMAIN_ID"]))
    spinner = Spinner(participant)
    try:
        yield participant, spinner
    finally:
        spinner.close()
