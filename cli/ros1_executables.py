"""The executables of ROS 1: functions that return the exit code. `executables.py` runs them."""

from __future__ import annotations

from functools import partial

from .executables import run

battery_sensor = partial(run, "ROS 1", "battery_sensor")
aggregator = partial(run, "ROS 1", "aggregator")
alert_system = partial(run, "ROS 1", "alert_system")
health_monitor = partial(run, "ROS 1", "health_monitor")
