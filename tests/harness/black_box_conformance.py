"""A black box over a middleware: its file is read by mcap and rosbags, and replayed to the same alert line.

Mixed into the classes that inherit `PortConformance`, except that of the in-process middleware.
"""

from __future__ import annotations

import json
import threading
from pathlib import Path
from typing import Any

import pytest

from harness.port_conformance import FLOAT32, START_S, Harness
from harness.random_black_boxes import judged, without_past
from robot_health_monitor.cli.operations import Operations
from robot_health_monitor.core.values.model import Transition
from robot_health_monitor.ops.configuration import BlackBoxSettings, OpsConfig

SIGNALS = {
    "battery_level": {"type": FLOAT32, "unit": "%", "warn_below": 20.0, "statistic": "max", "window_s": 1.0},
    "temperature": {"warn_above": 80.0, "stale_after_s": 0.0},
}


class BlackBoxConformance:
    """The suite."""

    @pytest.mark.newest_python
    @pytest.mark.parametrize("sim_time", [False, True], ids=["steady", "simulated"])
    def test_a_black_box_is_replayed_to_the_same_line(self, harness: Harness, tmp_path: Path, sim_time: bool) -> None:
        pytest.importorskip("mcap")
        settings = BlackBoxSettings(str(tmp_path), ("/extra/*",), before_s=4.0, after_s=0.5)
        operations = Operations(OpsConfig(black_box=settings))
        node = harness.node(
            "alert_system", namespace="robot1", parameters={"robot_name": "r1", "signals": SIGNALS}, sim_time=sim_time
        )
        events: list[Any] = []
        alert_system = operations.start(node, {"test": events.append})
        harness.publish("/extra/a", FLOAT32, {"data": 1.0})
        pause = threading.Event()
        for number in range(60):
            if sim_time:
                harness.set_time(START_S + 1.0 + 0.125 * number)
            harness.publish("/robot1/battery_level", FLOAT32, {"data": 50.25 if number < 20 else 15.25})
            harness.publish("/robot1/temperature", FLOAT32, {"data": 25.0})
            pause.wait(0.06)
        harness.publish("/extra/a", FLOAT32, {"data": 1.0})

        def transitions() -> list[Transition]:
            return [event for event in events if isinstance(event, Transition)]

        harness.wait_until(lambda: bool(transitions()))
        (alert,) = transitions()
        path = tmp_path / alert.black_box
        assert alert.black_box
        harness.wait_until(path.exists)
        node.exclusively(alert_system.close)
        operations.close()
        assert [text for _, _, text in judged(path, sim_time=sim_time)] == [without_past(alert.text)]
        _check_with_mcap(path)
        _check_with_rosbags(path)


def _check_with_mcap(path: Path) -> None:
    from mcap.reader import make_reader

    with path.open("rb") as stream:
        reader = make_reader(stream)
        topics = {channel.topic for _, channel, _ in reader.iter_messages()}
        summary = reader.get_summary()
        assert summary is not None
        encodings = {channel.message_encoding for channel in summary.channels.values()}
        profile = reader.get_header().profile
    assert topics >= {"/robot1/battery_level", "/robot1/temperature", "/diagnostics"}
    assert any(topic.endswith("/alerts") for topic in topics)
    # Over a bridge, the robot's messages are raw and those of the monitor are JSON.
    bridged = [("", {"json", "ros1"}), ("", {"json", "cdr"})]
    assert (profile, encodings) in [("ros1", {"ros1"}), ("ros2", {"cdr"}), ("", {"json"}), *bridged]
    if profile == "ros2":
        _check_for_rosbag2(summary)


def _check_for_rosbag2(summary: Any) -> None:
    """What the plug-in of rosbag2 reads a bare file by: `read_metadata` and `set_read_order` of its mcap_storage.cpp.

    Statistics, a schema for each channel, and an index in each chunk, without which messages come in another order. A
    metadata record `rosbag2` is optional: this file has none.
    """
    statistics = summary.statistics
    assert statistics.message_count == sum(statistics.channel_message_counts.values()) > 0
    assert statistics.message_end_time > statistics.message_start_time > 0
    schemas = {channel.topic: summary.schemas[channel.schema_id] for channel in summary.channels.values()}
    assert {schema.encoding for schema in schemas.values()} == {"ros2msg"}
    assert schemas["/robot1/battery_level"].name == "std_msgs/msg/Float32"
    assert schemas["/diagnostics"].name == "diagnostic_msgs/msg/DiagnosticArray"
    assert summary.chunk_indexes
    assert all(index.message_index_length > 0 for index in summary.chunk_indexes)


def _check_with_rosbags(path: Path) -> None:
    """The referee of the bytes: rosbags, where it reads a bare file and the messages are those of ROS."""
    from mcap.reader import make_reader
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    found = []
    with path.open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages(topics=["/robot1/battery_level"]):
            assert schema is not None
            if channel.message_encoding == "json":
                found.append(json.loads(message.data)["data"])
                continue
            store = get_typestore(Stores.EMPTY)
            name = "/msg/".join(schema.name.replace("/msg/", "/").split("/"))
            store.register(get_types_from_msg(schema.data.decode("utf-8"), name))
            read = store.deserialize_ros1 if channel.message_encoding == "ros1" else store.deserialize_cdr
            found.append(read(message.data, name).data)  # type: ignore[attr-defined]
    assert set(found) == {50.25, 15.25}
