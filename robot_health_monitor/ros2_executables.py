"""The executables of ROS 2. `executables.py` runs them."""

from __future__ import annotations

from robot_health_monitor.runtime.interrupts import Interrupts

from .executables import Process, run


def battery_sensor() -> int:
    """Runs the sensor node; returns the exit code."""
    return _run("battery_sensor")


def aggregator() -> int:
    """Runs the aggregator node; returns the exit code."""
    return _run("aggregator")


def alert_system() -> int:
    """Runs the alert node; returns the exit code."""
    return _run("alert_system")


def health_monitor() -> int:
    """Runs all three nodes in one process; returns the exit code."""
    return _run("health_monitor")


def _run(executable: str) -> int:
    return run(executable, _open, ros="ROS 2")


def _open(executable: str, interrupts: Interrupts) -> Process:
    from robot_health_monitor.ros2.process import Ros2Process

    return Ros2Process(interrupts)
