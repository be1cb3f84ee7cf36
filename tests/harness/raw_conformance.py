"""The promises of the port about messages as bytes; mixed into the classes that inherit `PortConformance`.

The referee is rosbags, which reads the bytes by the definition that came with them, or `json`.
"""

from __future__ import annotations

import base64
import gc
import json
import os
from functools import partial
from typing import Any, Mapping

import pytest

from harness.port_conformance import DIAGNOSTICS, FLOAT32, JOINTS, START_S, STATUS, Harness, Recorder, levels_to
from harness.waiting import wait_for
from robot_health_monitor.core.messages.raw_messages import RawFormat
from robot_health_monitor.core.nodes import AlertSystem
from robot_health_monitor.core.port.middleware import RawMessage
from robot_health_monitor.core.values.errors import ConfigError, MessageError
from robot_health_monitor.core.values.names import canonical_type

IMAGE = "sensor_msgs/Image"
PIXELS = bytes(range(256)) * 4096
IGNORED = -1.0
_FORMATS = {
    ("ros1", "ros1msg", "ros1"),
    ("cdr", "ros2msg", "ros2"),
    ("json", "jsonschema", ""),
}


class Capture:
    """A callback of `subscribe_raw` that keeps everything."""

    def __init__(self) -> None:
        self.items: list[tuple[bytes, float, RawFormat]] = []

    def __call__(self, message: RawMessage, now_s: float) -> None:
        data, raw_format = message
        self.items.append((data, now_s, raw_format))

    def values(self, field: str = "data") -> list[Any]:
        return counted([decoded(data, raw_format)[field] for data, _, raw_format in self.items])


def decoded(data: bytes, raw_format: RawFormat) -> Mapping[str, Any]:
    """Returns the fields of a message, as the referee reads them."""
    assert isinstance(data, bytes)
    assert (raw_format.message_encoding, raw_format.schema_encoding, raw_format.profile) in _FORMATS
    if raw_format.message_encoding == "json":
        fields = json.loads(data)
        _check(fields, json.loads(raw_format.schema))
        return dict(fields)
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.EMPTY)
    name = raw_format.schema_name if raw_format.profile == "ros2" else raw_format.schema_name.replace("/", "/msg/")
    if raw_format.profile == "ros2":
        assert raw_format.schema_name.count("/msg/") == 1
    store.register(get_types_from_msg(raw_format.schema, name))
    read = store.deserialize_ros1 if raw_format.profile == "ros1" else store.deserialize_cdr
    return _fields(read(data, name))


def _fields(message: Any) -> dict[str, Any]:
    return {name: value for name, value in vars(message).items() if not name.startswith("__")}


def _check(value: Any, schema: Mapping[str, Any]) -> None:
    """Asserts that a value is as its JSON schema says, in the subset that Foxglove reads."""
    kind = schema["type"]
    if kind == "object":
        assert isinstance(value, dict)
        for name, of in schema["properties"].items():
            _check(value[name], of)
    elif kind == "array":
        for item in value:
            _check(item, schema["items"])
    elif kind == "string" and schema.get("contentEncoding"):
        base64.b64decode(value, validate=True)
    else:
        types = {"integer": int, "number": (int, float, type(None)), "string": str, "boolean": bool}
        assert isinstance(value, types[kind])


def begin(harness: Harness, capture: Capture, topic: str) -> None:
    """Publishes numbers that nothing here counts until the first is captured: a server is asked for the definition."""

    def is_captured() -> bool:
        harness.publish(topic, FLOAT32, {"data": IGNORED})
        return bool(capture.items)

    harness.wait_until(is_captured)


def counted(values: list[Any]) -> list[Any]:
    """Returns the values without those of `begin`."""
    return [
        value for value in values if not (isinstance(value, (float, dict)) and value in (IGNORED, {"data": IGNORED}))
    ]


def _are_complete(heard: Recorder, capture: Capture, count: int) -> bool:
    return len(counted(heard.values)) >= count and len(capture.values()) >= count


class RawConformance:
    """The contract of `subscribe_raw`, `serialize` and `topic_types`."""

    def test_bytes_are_read_by_the_definition_that_comes_with_them(self, harness: Harness) -> None:
        node, capture = harness.node("recorder"), Capture()
        subscription = node.subscribe_raw("/joints", "sensor_msgs/JointState", capture)
        assert subscription.topic == "/joints"

        def is_captured() -> bool:
            harness.publish("/joints", "sensor_msgs/JointState", JOINTS)
            return bool(capture.items)

        harness.wait_until(is_captured)
        (data, now_s, raw_format), *_ = capture.items
        assert now_s == pytest.approx(100.0)
        assert canonical_type(raw_format.schema_name) == "sensor_msgs/JointState"
        fields = decoded(data, raw_format)
        assert list(fields["name"]) == ["wheel_left", "wheel_right", "arm"]
        assert list(fields["velocity"]) == [0.5, 1.5]
        assert list(fields["effort"]) == [1.5, -2.5, 0.25]
        assert list(fields["position"]) == []

    def test_nested_messages_are_captured(self, harness: Harness) -> None:
        node, capture = harness.node("recorder"), Capture()
        node.subscribe_raw("/drivers", DIAGNOSTICS, capture)

        def is_captured() -> bool:
            harness.publish("/drivers", DIAGNOSTICS, {"status": [STATUS]})
            return bool(capture.items)

        harness.wait_until(is_captured)
        (status,) = capture.values("status")[0]
        found = status if isinstance(status, dict) else _fields(status)
        assert (found["level"], found["name"], found["message"]) == (2, "driver: left motor", "too hot")
        key, value = (each if isinstance(each, dict) else _fields(each) for each in found["values"])
        assert (key["key"], value["value"]) == ("unit", "81.0")

    def test_the_format_is_one_object_while_the_type_stays(self, harness: Harness) -> None:
        node, capture = harness.node("recorder"), Capture()
        node.subscribe_raw("/in", FLOAT32, capture)
        begin(harness, capture, "/in")
        for number in range(3):
            harness.publish("/in", FLOAT32, {"data": float(number)})
        harness.wait_until(lambda: len(capture.values()) == 3)
        assert capture.values() == [0.0, 1.0, 2.0]
        assert len({id(raw_format) for _, _, raw_format in capture.items}) == 1

    def test_a_type_may_be_known_only_when_the_topic_appears(self, harness: Harness) -> None:
        node, capture = harness.node("recorder"), Capture()
        node.subscribe_raw("/later", "", capture)

        def is_captured() -> bool:
            harness.publish("/later", FLOAT32, {"data": 19.5})
            return bool(capture.items)

        harness.wait_until(is_captured)
        assert capture.values()[0] == 19.5
        assert canonical_type(capture.items[0][2].schema_name) == FLOAT32

    @pytest.mark.parametrize("order", [("judge", "capture"), ("capture", "judge")])
    @pytest.mark.parametrize("field", ["data", "", None])
    def test_judging_and_capture_see_the_same_messages(self, harness: Harness, field: Any, order: Any) -> None:
        node, heard, capture = harness.node("recorder"), Recorder(), Capture()
        for kind in order:
            if kind == "judge":
                node.subscribe("/in", FLOAT32, heard, field=field)
            else:
                node.subscribe_raw("/in", FLOAT32, capture)
        begin(harness, capture, "/in")
        numbers = [float(number) for number in range(20)]
        for at in range(0, 20, 5):  # a subscription of ROS 2 keeps the last ten
            for number in numbers[at : at + 5]:
                harness.publish("/in", FLOAT32, {"data": number})
            harness.wait_until(partial(_are_complete, heard, capture, at + 5))
        expected = {"data": numbers, "": [{"data": number} for number in numbers], None: [1.0] * 20}
        assert field is None or counted(heard.values) == expected[field]
        assert field is not None or set(heard.values) == {1.0}
        assert capture.values() == numbers

    @pytest.mark.newest_python
    def test_a_flood_is_the_same_for_judging_and_capture(self, harness: Harness) -> None:
        """A queue may lose messages, but the same ones for both."""
        node, heard, capture = harness.node("recorder"), Recorder(), Capture()
        node.subscribe("/in", FLOAT32, heard, field="data")
        node.subscribe_raw("/in", FLOAT32, capture)
        begin(harness, capture, "/in")
        for number in range(300):
            harness.publish("/in", FLOAT32, {"data": float(number)})

        def has_ended() -> bool:
            harness.publish("/in", FLOAT32, {"data": 300.0})
            return 300.0 in heard.values and 300.0 in capture.values()

        harness.wait_until(has_ended)
        seen = [values[: values.index(300.0)] for values in (counted(heard.values), capture.values())]
        assert seen[0] == seen[1]
        assert len(seen[0]) > 0

    @pytest.mark.newest_python
    def test_what_is_captured_does_not_wait_for_the_judging(self, harness: Harness) -> None:
        """The time of a message must not include that of the alert which it causes."""
        node, order = harness.node("recorder"), []
        node.subscribe("/in", FLOAT32, lambda value, now_s: order.append(("judged", value)), field="data")
        node.subscribe_raw("/in", FLOAT32, lambda message, now_s: order.append(("captured", decoded(*message)["data"])))

        def hears_both() -> bool:
            harness.publish("/in", FLOAT32, {"data": IGNORED})
            return {("judged", IGNORED), ("captured", IGNORED)} <= set(order)

        harness.wait_until(hears_both)
        harness.publish("/in", FLOAT32, {"data": 1.0})
        harness.wait_until(lambda: ("judged", 1.0) in order and ("captured", 1.0) in order)
        assert order.index(("captured", 1.0)) < order.index(("judged", 1.0))

    def test_alerts_are_those_without_capture(self, harness: Harness) -> None:
        levels: list[tuple[str, str]] = []
        signal = {"topic": "in", "type": FLOAT32, "field": "data", "warn_below": 20.0, "error_below": 10.0}
        node, capture = harness.node("alert_system", parameters={"signals": {"charge": signal}}), Capture()
        AlertSystem(node, {"test": levels_to(levels)})
        node.subscribe_raw("in", "", capture)
        expected: list[tuple[str, str]] = []
        for step, (value, level) in enumerate(((25.0, ""), (15.0, "WARN"), (5.0, "ERROR"), (25.5, "OK"))):
            harness.set_time(START_S + 1.0 + step)
            expected += [("charge", level)] if level else []

            def is_judged(value: float = value, expected: Any = tuple(expected)) -> bool:
                harness.publish("/in", FLOAT32, {"data": value})
                return tuple(levels) == expected and value in capture.values()

            harness.wait_until(is_judged)

    @pytest.mark.parametrize("order", [("judge", "capture"), ("capture", "judge")])
    def test_fields_that_need_the_message_are_judged_as_before(self, harness: Harness, order: Any) -> None:
        node, heard, capture = harness.node("recorder"), Recorder(), Capture()
        for kind in order:
            if kind == "judge":
                node.subscribe("/joints", "sensor_msgs/JointState", heard, field='effort["wheel_right"]')
            else:
                node.subscribe_raw("/joints", "", capture)

        def is_heard() -> bool:
            harness.publish("/joints", "sensor_msgs/JointState", JOINTS)
            return bool(heard.values and capture.items)

        harness.wait_until(is_heard)
        assert heard.values[0] == -2.5
        assert list(capture.values("effort")[0]) == [1.5, -2.5, 0.25]

    def test_either_may_end_without_the_other(self, harness: Harness) -> None:
        node, heard, capture = harness.node("recorder"), Recorder(), Capture()
        judging = node.subscribe("/in", FLOAT32, heard, field="data")
        capturing = node.subscribe_raw("/in", FLOAT32, capture)
        begin(harness, capture, "/in")
        harness.publish("/in", FLOAT32, {"data": 1.0})
        harness.wait_until(lambda: counted(heard.values) == capture.values() == [1.0])
        node.unsubscribe(capturing)
        node.unsubscribe(capturing)
        harness.publish("/in", FLOAT32, {"data": 2.0})
        harness.wait_until(lambda: counted(heard.values) == [1.0, 2.0])
        assert capture.values() == [1.0]
        again = node.subscribe_raw("/in", FLOAT32, capture)
        node.unsubscribe(judging)

        def is_captured() -> bool:
            harness.publish("/in", FLOAT32, {"data": 3.0})
            return len(capture.values()) > 1

        harness.wait_until(is_captured)
        assert capture.values()[1] == 3.0
        assert counted(heard.values) == [1.0, 2.0]
        node.unsubscribe(again)

    def test_images_are_captured_whole(self, harness: Harness) -> None:
        node, capture = harness.node("recorder"), Capture()
        node.subscribe_raw("/camera", IMAGE, capture)
        image = {"height": 1024, "width": 1024, "encoding": "mono8", "step": 1024}

        def is_captured() -> bool:
            harness.publish("/camera", IMAGE, {**image, "data": base64.b64encode(PIXELS).decode()})
            return bool(capture.items)

        harness.wait_until(is_captured)
        found = capture.values()[0]
        assert (base64.b64decode(found) if isinstance(found, str) else bytes(found)) == PIXELS
        assert capture.values("encoding")[0] == "mono8"

    def test_an_exception_of_the_callback_is_one_line_and_affects_nothing_else(self, harness: Harness) -> None:
        node, heard = harness.node("recorder"), Recorder()

        def fail(message: RawMessage, now_s: float) -> None:
            raise RuntimeError("the ring is broken")

        node.subscribe_raw("/in", FLOAT32, fail)
        node.subscribe("/in", FLOAT32, heard, field="data")

        def is_heard() -> bool:
            harness.publish("/in", FLOAT32, {"data": 1.0})
            return bool(heard.values) and any("the ring is broken" in line.text for line in harness.log_lines())

        harness.wait_until(is_heard)
        assert heard.values[0] == 1.0

    def test_what_is_no_type_is_refused(self, harness: Harness) -> None:
        with pytest.raises(ConfigError, match="nonsense"):
            harness.node("recorder").subscribe_raw("/in", "nonsense", Capture())

    def test_a_message_is_serialized_as_it_would_be_captured(self, harness: Harness) -> None:
        node = harness.node("recorder")
        data, raw_format = node.serialize(DIAGNOSTICS, {"status": [STATUS]})
        fields = decoded(data, raw_format)
        (status,) = fields["status"]
        assert (status["name"] if isinstance(status, dict) else status.name) == "driver: left motor"
        with pytest.raises(MessageError, match="volume"):
            node.serialize(FLOAT32, {"volume": 11})
        with pytest.raises(ConfigError, match="nonsense"):
            node.serialize("nonsense", {})

    def test_the_topics_are_listed_with_their_types(self, harness: Harness) -> None:
        node = harness.node("recorder")
        harness.publish("/listed", FLOAT32, {"data": 1.0})
        harness.wait_until(lambda: canonical_type(node.topic_types().get("/listed", "")) == FLOAT32)

    def test_topics_that_come_and_go_leave_no_descriptor(self, harness: Harness) -> None:
        """As a black box with `topics: ["/*"]` subscribes to what a robot publishes for a while."""
        node = harness.node("recorder")

        def come_and_go(first: int, last: int) -> None:
            for number in range(first, last):
                node.unsubscribe(node.subscribe_raw(f"/passing/t{number}", FLOAT32, Capture()))

        def count() -> int:
            return len(os.listdir("/proc/self/fd"))

        gc.disable()  # chance must not close what is left open
        try:
            come_and_go(0, 5)
            before = count()
            come_and_go(5, 505)
            wait_for(lambda: count() <= before + 2)  # something else in this process may use some for a moment
        finally:
            gc.enable()
