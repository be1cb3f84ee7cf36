"""The executables of ROS 1: functions that return the exit code. `executables.py` runs them."""

from __future__ import annotations

from functools import partial

from ..runtime.interrupts import Interrupts
from .executables import Process, run

_PATIENCE_S = 4.0
"""A call to a ROS master that hangs must not keep the process from ending."""


def _open(executable: str, interrupts: Interrupts) -> Process:
    from ..ros1.process import Ros1Process

    return Ros1Process(executable, interrupts)


_run = partial(run, open_process=_open, ros="ROS 1", patience_s=_PATIENCE_S)
battery_sensor = partial(_run, "battery_sensor")
aggregator = partial(_run, "aggregator")
alert_system = partial(_run, "alert_system")
health_monitor = partial(_run, "health_monitor")
