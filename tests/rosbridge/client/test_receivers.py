"""Messages that are captured over rosbridge: as bytes from this project's server, as JSON from others."""

from __future__ import annotations

import json
from typing import Any

from harness.raw_conformance import Capture, decoded
from harness.rosbridge_client import ForeignServer, Watched, scenario, until
from harness.rosbridge_peer import FLOAT32, Robot, with_robot

ANY_OBJECT = {"title": "acme_msgs/Arm", "type": "object", "properties": {}}


def subscriptions(server: ForeignServer) -> list[Any]:
    return [fields for fields in server.received if fields["op"] == "subscribe"]


@scenario
async def test_another_server_sends_json_whose_schema_allows_everything() -> None:
    """Never bytes: rosbridge_suite would send nothing to its other clients."""
    foreign = ForeignServer()
    foreign.types["/arm"] = "acme_msgs/msg/Arm"
    watched, capture = Watched(await foreign.start()), Capture()
    try:
        watched.node.subscribe_raw("/arm", "", capture)
        await until(lambda: watched.node.raw_format_of("/arm", "") is not None)
        await foreign.publish("/arm", {"torque": [1.5, None], "name": "left"})
        await until(lambda: len(capture.items) == 1)
        (data, _, raw_format) = capture.items[0]
        assert decoded(data, raw_format) == {"torque": [1.5, None], "name": "left"}
        assert raw_format[:3] == ("json", "acme_msgs/Arm", "jsonschema")
        assert json.loads(raw_format.schema) == ANY_OBJECT
        assert [fields.get("compression", "none") for fields in subscriptions(foreign)] == ["none"]
    finally:
        await watched.close()
        await foreign.close()


@scenario
async def test_a_type_that_this_package_knows_has_its_schema_over_another_server_too() -> None:
    foreign = ForeignServer()
    foreign.types["/level"] = FLOAT32
    watched = Watched(await foreign.start())
    try:
        watched.node.subscribe_raw("/level", "", Capture())
        await until(lambda: watched.node.raw_format_of("/level", "") is not None)
        assert list(json.loads(watched.node.raw_format_of("/level", "").schema)["properties"]) == ["data"]
    finally:
        await watched.close()
        await foreign.close()


@scenario
async def test_a_server_without_rosapi_is_captured_with_a_schema_that_allows_everything() -> None:
    foreign = ForeignServer()
    foreign.rosapi = False
    watched, capture = Watched(await foreign.start()), Capture()
    try:
        watched.node.subscribe_raw("/arm", "acme_msgs/Arm", capture)
        await until(lambda: watched.node.raw_format_of("/arm", "") is not None)
        await foreign.publish("/arm", {"torque": 1})
        await until(lambda: len(capture.items) == 1)
        (data, _, raw_format) = capture.items[0]
        assert data == b'{"torque":1}'
        assert json.loads(raw_format.schema) == ANY_OBJECT
    finally:
        await watched.close()
        await foreign.close()


@scenario
async def test_capture_goes_on_after_a_reconnection_and_follows_a_new_type() -> None:
    foreign = ForeignServer()
    foreign.types["/arm"] = "acme_msgs/Arm"
    watched, capture = Watched(await foreign.start()), Capture()
    try:
        watched.node.subscribe_raw("/arm", "", capture)
        await until(lambda: watched.node.raw_format_of("/arm", "") is not None)
        await foreign.publish("/arm", {"torque": [], "name": "a"})
        await until(lambda: len(capture.items) == 1)
        foreign.types["/arm"] = "acme_msgs/Leg"
        await foreign.sockets[-1].close()
        await until(lambda: "acme_msgs/Leg" in str(watched.node.raw_format_of("/arm", "")))
        await foreign.publish("/arm", {"torque": [], "label": "b"})
        await until(lambda: len(capture.items) == 2)
        first, second = (raw_format for _, _, raw_format in capture.items)
        assert first != second
        assert decoded(*capture.items[1][::2]) == {"torque": [], "label": "b"}
    finally:
        await watched.close()
        await foreign.close()


@scenario
async def test_a_message_that_is_too_large_to_be_read_is_a_fault_until_the_next() -> None:
    foreign = ForeignServer()
    foreign.types["/arm"] = "acme_msgs/Arm"
    watched, capture = Watched(await foreign.start()), Capture()
    try:
        watched.node.subscribe_raw("/arm", "", capture)
        await until(lambda: watched.node.raw_format_of("/arm", "") is not None)
        await foreign.publish("/arm", {"torque": [], "name": "x" * 1_100_000})
        await until(lambda: watched.node.dropped == 1)
        assert [fault.text for fault in watched.node.faults.current().values()] == [
            "dropped 1 messages, the last of 1.1 MB (limit 1.0 MB)"
        ]
        await foreign.publish("/arm", {"torque": [], "name": "x"})
        await until(lambda: len(capture.items) == 1)
        assert not watched.node.faults.current()
    finally:
        await watched.close()
        await foreign.close()


@with_robot()
async def test_this_projects_server_sends_bytes_which_are_judged_too(robot: Robot) -> None:
    watched, capture = Watched(robot.url), Capture()
    watched.node.subscribe("/battery_level", FLOAT32, watched.hear, field="data")
    watched.node.subscribe_raw("/battery_level", "", capture)
    robot.publish(0.0)

    def is_captured() -> bool:
        robot.publish(1.0)
        return bool(capture.items)

    await until(is_captured)
    data, _, raw_format = capture.items[0]
    assert (data, raw_format.profile, raw_format.schema) == (b"\0\0\x80?", "ros1", "float32 data\n")
    await watched.settle()
    watched.heard.clear()
    capture.items.clear()
    robot.publish(2.0, 3.0)
    await until(lambda: watched.heard[-2:] == [2.0, 3.0] and capture.values()[-2:] == [2.0, 3.0])
    assert {each.message_encoding for _, _, each in capture.items} == {"ros1"}
    await watched.close()


@with_robot()
async def test_a_subscription_to_whole_messages_reads_them_from_the_captured_bytes(robot: Robot) -> None:
    watched, capture = Watched(robot.url), Capture()
    watched.node.subscribe_raw("/battery_level", FLOAT32, capture)

    def is_captured() -> bool:
        robot.publish(1.0)
        return bool(capture.items)

    await until(is_captured)
    watched.node.subscribe("/battery_level", FLOAT32, watched.hear)
    await watched.settle()
    capture.items.clear()
    robot.publish(2.0)
    await until(lambda: {"data": 2.0} in watched.heard and 2.0 in capture.values())
    assert {each.message_encoding for _, _, each in capture.items} == {"ros1"}
    await watched.close()


@with_robot()
async def test_judging_goes_on_as_before_when_the_capture_ends(robot: Robot) -> None:
    """Also that of a subscription that needs the whole message and begins later."""
    watched, capture = Watched(robot.url), Capture()
    watched.node.subscribe("/battery_level", FLOAT32, watched.hear, field="data")
    captured = watched.node.subscribe_raw("/battery_level", FLOAT32, capture)

    def is_captured() -> bool:
        robot.publish(1.0)
        return bool(capture.items)

    await until(is_captured)
    assert capture.items[-1][2].profile == "ros1"
    watched.node.unsubscribe(captured)
    whole: list[Any] = []
    watched.node.subscribe("/battery_level", FLOAT32, lambda message, now_s: whole.append(message))
    await watched.settle()
    robot.publish(2.0)
    await until(lambda: watched.heard[-1] == 2.0 and whole == [{"data": 2.0}])
    await watched.close()


@with_robot()
async def test_bytes_are_captured_again_after_a_reconnection(robot: Robot) -> None:
    watched, capture = Watched(robot.url), Capture()
    watched.node.subscribe("/battery_level", FLOAT32, watched.hear, field="data")
    watched.node.subscribe_raw("/battery_level", FLOAT32, capture)

    def is_captured() -> bool:
        robot.publish(1.0)
        return bool(capture.items)

    for _ in range(3):
        await until(is_captured)
        assert {each.profile for _, _, each in capture.items} == {"ros1"}
        connection = watched.client.connection
        before = connection._wires
        connection.move(robot.url.replace("http", "ws", 1), token="", ssl_context=None)
        await until(lambda connection=connection, before=before: connection._wires not in (None, before))
        capture.items.clear()
        watched.heard.clear()
    await until(is_captured)
    assert set(watched.heard) == {1.0}
    await watched.close()


@scenario
async def test_a_server_that_answers_nonsense_is_captured_all_the_same() -> None:
    foreign = ForeignServer()
    foreign.types["/arm"] = "no type \n" * 1000
    watched, capture = Watched(await foreign.start()), Capture()
    try:
        watched.node.subscribe_raw("/arm", "acme_msgs/Arm", capture)
        await until(lambda: watched.node.raw_format_of("/arm", "") is not None)
        await foreign.publish("/arm", {"torque": 1})
        await until(lambda: len(capture.items) == 1)
        assert capture.items[0][2].schema_name == "acme_msgs/Arm"
    finally:
        await watched.close()
        await foreign.close()
