"""The executables of ROS 2: functions that return the exit code. `executables.py` runs them."""

from __future__ import annotations

from functools import partial

from ..runtime.interrupts import Interrupts
from .executables import Process, run


def _open(executable: str, interrupts: Interrupts) -> Process:
    from ..ros2.process import Ros2Process

    return Ros2Process(interrupts)


_run = partial(run, open_process=_open, ros="ROS 2")
battery_sensor = partial(_run, "battery_sensor")
aggregator = partial(_run, "aggregator")
alert_system = partial(_run, "alert_system")
health_monitor = partial(_run, "health_monitor")
