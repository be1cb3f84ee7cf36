"""The executables of ROS 1. `executables.py` runs them."""

from __future__ import annotations

from robot_health_monitor.runtime.interrupts import Interrupts

from .executables import Process, run

_PATIENCE_S = 4.0
"""A call to a ROS master that hangs must not keep the process from ending."""


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
    return run(executable, _open, ros="ROS 1", patience_s=_PATIENCE_S)


def _open(executable: str, interrupts: Interrupts) -> Process:
    from robot_health_monitor.ros1.process import Ros1Process

    return Ros1Process(executable, interrupts)
