"""An outlet that the monitor does not have: a CSV file with one row per alert.

    python examples/custom_outlet.py [alerts.csv]

Without a file name, the file is temporary.
An outlet is a function that receives each event once, on ROS 1, ROS 2 and here alike. If it raises, the monitor
reports that as a fault and carries on.
"""

import csv
import sys
import tempfile
from pathlib import Path

from robot_health_monitor.core import Transition
from robot_health_monitor.core.nodes import AlertSystem
from robot_health_monitor.core.nodes.outlets import Event
from robot_health_monitor.core.port import LocalBus


class CsvFile:
    """Appends every alert to a CSV file."""

    def __init__(self, path: str) -> None:
        """Keeps the path; the file is opened for each alert, so that it may be moved at any time."""
        self._path = path

    def __call__(self, event: Event) -> None:
        """Receives a Transition, or a Notice about the monitor itself, which this outlet leaves out."""
        if isinstance(event, Transition):
            with open(self._path, "a", newline="", encoding="utf-8") as file:
                csv.writer(file).writerow([event.now_s, event.signal, event.to_level.name, event.value, event.text])


def main() -> None:
    """Writes the alerts to a file and prints it."""
    if len(sys.argv) > 1:
        run(sys.argv[1])
    else:
        with tempfile.TemporaryDirectory() as folder:
            run(str(Path(folder) / "alerts.csv"))


def run(path: str) -> None:
    """Runs the alert node beside a battery that discharges, in virtual time."""
    bus = LocalBus()
    parameters = {"signals": {"battery_level": {"unit": "%", "warn_below": 20.0, "error_below": 10.0}}}
    AlertSystem(bus.node("alert_system", parameters=parameters), outlets={"csv": CsvFile(path)})

    robot = bus.node("robot")
    robot.advertise("battery_level", "std_msgs/Float32")
    for second in range(30):
        bus.run_until(float(second))
        robot.publish("battery_level", {"data": 30.0 - second})

    with open(path, encoding="utf-8") as file:
        print(file.read(), end="")


if __name__ == "__main__":
    main()
