"""What alert_system publishes on /diagnostics, read by the real diagnostic_aggregator of ROS 1."""

from __future__ import annotations

import os
import shutil
import socket
from pathlib import Path
from typing import Any, Iterator, Mapping

import pytest
from harness.line_process import LineProcess


@pytest.fixture
def ros(ros_process: Any) -> Iterator[Any]:
    from harness.ros1 import Ros1Harness

    harness = Ros1Harness()
    yield harness
    harness.close()


MANIFEST = """<package format="2"><name>diagnostic_aggregator</name><version>0.0.0</version>
<description>Debian ships the node without it</description><maintainer email="a@b.invalid">a</maintainer>
<license>BSD</license></package>"""


@pytest.fixture
def aggregated(ros: Any, master: Any, tmp_path: Path) -> Iterator[Any]:
    """What a running diagnostic_aggregator publishes: that of the ROS 1 whose roscore runs, not one of a ROS 2."""
    prefix = Path(shutil.which("roscore")).resolve().parents[1]
    node = prefix / "lib" / "diagnostic_aggregator" / "aggregator_node"
    if not node.exists():
        pytest.skip("diagnostic_aggregator is not installed")
    environment = dict(master.environment)
    if prefix == Path("/usr"):  # the node asks where its package is, and gives up when there is none
        package = tmp_path / "diagnostic_aggregator"
        package.mkdir()
        (package / "package.xml").write_text(MANIFEST, encoding="utf-8")
        environment["ROS_PACKAGE_PATH"] = f"{tmp_path}{os.pathsep}/usr/share"
    process = LineProcess([str(node), "_pub_rate:=20.0"], environment)
    yield ros.listen("/diagnostics_agg", "diagnostic_msgs/DiagnosticArray")
    process.end()


def test_the_aggregator_groups_our_statuses_and_rolls_their_levels_up(ros: Any, start: Any, aggregated: Any) -> None:
    alert_system = start("alert_system")
    alert_system.wait_for_text("watching cpu_usage")
    shown: dict[str, Mapping[str, Any]] = {}

    def is_complete() -> bool:
        """Publishes again and again: on a busy machine the aggregator may need longer than a sample is fresh."""
        for topic, value in (("battery_level", 19.0), ("temperature", 60.0), ("cpu_usage", 30.0)):
            ros.publish(f"/{topic}", "std_msgs/Float32", {"data": value})
        shown.clear()
        shown.update((status["name"], status) for status in (aggregated[-1]["status"] if aggregated else []))
        return {name: shown[name]["level"] for name in levels if name in shown} == levels

    levels = {  # the worst of the three is the level of the group
        "/Other": 1,
        "/Other/alert_system: battery_level": 1,
        "/Other/alert_system: temperature": 0,
        "/Other/alert_system: cpu_usage": 0,
    }
    ros.wait_until(is_complete)
    battery = shown["/Other/alert_system: battery_level"]
    assert battery["message"] == "19 % is below 20 %"
    assert battery["hardware_id"] == socket.gethostname()
    values: dict[str, str] = {pair["key"]: pair["value"] for pair in battery["values"]}
    assert {key: values[key] for key in ("value", "unit", "warn_below", "error_below", "bad_samples")} == {
        "value": "19",
        "unit": "%",
        "warn_below": "20",
        "error_below": "10",
        "bad_samples": "0",
    }
    assert int(values["good_samples"]) >= 1
