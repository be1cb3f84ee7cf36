"""The nodes over Foxglove's protocol, besides the port's promises, which test_conformance.py has."""

from __future__ import annotations

import json
from typing import Any

import pytest
from harness.foxglove_client import FLOAT, Server, Watched, cdr, message
from harness.rosbridge_client import scenario, until

from robot_health_monitor.core.messages.raw_messages import RawFormat
from robot_health_monitor.core.values.errors import ConfigError
from robot_health_monitor.core.values.field_path import ABSENT

JSON = {**FLOAT, "id": 8, "topic": "/json", "encoding": "json", "schemaEncoding": "jsonschema", "schema": "{}"}


@scenario
async def test_messages_are_captured_as_they_are_with_their_format() -> None:
    server = Server()
    watched = Watched(await server.start())
    watched.node.subscribe_raw("/battery", "", watched.hear)
    await until(lambda: 3 in server.subscribed)
    await server.send(message(server.subscribed[3], cdr(20.5)))
    await until(lambda: len(watched.heard) == 1)
    raw = RawFormat("cdr", "std_msgs/msg/Float32", "ros2msg", "float32 data\n")
    assert watched.heard == [(cdr(20.5), raw)]
    await watched.close()
    await server.close()


@scenario
async def test_a_channel_of_another_type_is_one_error_line() -> None:
    server = Server()
    watched = Watched(await server.start())
    watched.node.subscribe("/battery", "sensor_msgs/Temperature", watched.hear, field="temperature")
    await until(lambda: bool(watched.problems()))
    for _ in range(3):
        await server.send({"op": "unadvertise", "channelIds": [3]})
        await server.send({"op": "advertise", "channels": [FLOAT]})
    await server.send({"op": "advertise", "channels": [JSON]})
    await until(lambda: "/json" in watched.node.topic_types())
    assert watched.problems() == ["/battery: expected messages of type sensor_msgs/Temperature, got std_msgs/Float32"]
    assert server.subscribed == {}
    await watched.close()
    await server.close()


@scenario
async def test_null_is_nan_and_messages_that_do_not_match_are_one_error_line() -> None:
    server = Server(channels=(JSON,))
    watched = Watched(await server.start())
    watched.node.subscribe("/json", "", watched.hear, field="data")
    await until(lambda: 8 in server.subscribed)
    for text in ('{"data": null}', "{", "[]", '{"other": 1}', "[" * 50_000, '{"data": 3.5}'):
        await server.send(message(server.subscribed[8], text.encode()))
    await until(lambda: 3.5 in watched.heard)
    values = [value for value in watched.heard if value is not ABSENT]
    assert values[0] != values[0] and values[1:] == [3.5]
    assert len(watched.heard) == 6  # each message is a sign of life
    assert len(watched.problems()) == 1 and watched.problems()[0].startswith("/json: a message does not match its type")
    await watched.close()
    await server.close()


@scenario
async def test_a_large_message_in_json_is_a_sign_of_life_and_a_fault_until_one_can_be_read() -> None:
    server = Server(channels=(JSON,))
    watched = Watched(await server.start())
    subscription = watched.node.subscribe("/json", "", watched.hear, field="data")
    await until(lambda: 8 in server.subscribed)
    large = json.dumps({"data": 1.0, "more": "x" * 1_100_000}).encode()
    await server.send(message(server.subscribed[8], large))
    await until(lambda: watched.heard == [ABSENT])
    assert watched.node.dropped == 1
    (fault,) = watched.node.faults.current().values()
    assert fault.text == "dropped 1 messages, the last of 1.1 MB (limit 1.0 MB)"
    await server.send(message(server.subscribed[8], b'{"data": 2.0}'))
    await until(lambda: watched.heard == [ABSENT, 2.0])
    assert not watched.node.faults.current()
    await server.send(message(server.subscribed[8], large))
    await until(lambda: bool(watched.node.faults.current()))
    watched.node.unsubscribe(subscription)
    assert not watched.node.faults.current()
    await watched.close()
    await server.close()


@scenario
async def test_arrivals_are_counted_whatever_the_messages_are() -> None:
    server = Server(channels=({**FLOAT, "schema": "x y z"},))
    watched = Watched(await server.start())
    watched.node.subscribe("/battery", "", watched.hear, field=None)
    await until(lambda: 3 in server.subscribed)
    await server.send(message(server.subscribed[3], b"?"))
    await until(lambda: watched.heard == [1.0])
    await watched.close()
    await server.close()


@scenario
async def test_what_is_known_of_the_robot_is_what_the_server_offers() -> None:
    idl = {**FLOAT, "id": 9, "topic": "/idl", "schemaEncoding": "ros2idl", "schema": "module a {};"}
    server = Server(channels=(FLOAT, JSON, idl, {**FLOAT, "id": 5, "topic": "/picture", "encoding": "protobuf"}))
    watched = Watched(await server.start())
    await until(lambda: len(watched.node.topic_types()) == 4)
    known = {each.topic: each[1:] for each in await watched.client.known_topics()}
    assert known == {
        "/battery": ("std_msgs/Float32", "float32 data\n", "ros2msg"),
        "/json": ("std_msgs/Float32", "", "msg"),
        "/idl": ("std_msgs/Float32", "module a {};", "ros2idl"),
    }
    await watched.close()
    await server.close()


@pytest.mark.parametrize(
    ("type_name", "field"), [("std_msgs/Float32", "value"), ("std_msgs/Nothing", "data"), ("x", "data")]
)
def test_a_wrong_type_or_field_is_a_configuration_error(type_name: str, field: str) -> None:
    @scenario
    async def run() -> None:
        watched = Watched("foxglove://127.0.0.1:9")
        with pytest.raises(ConfigError):
            watched.node.subscribe("/battery", type_name, watched.hear, field=field)
        await watched.close()

    run()


@scenario
async def test_several_fields_of_one_message_are_read_from_one_decoding() -> None:
    schema = "float32[] data\nstring name\n"
    server = Server(channels=({**FLOAT, "schemaName": "a/msg/B", "schema": schema},))
    watched = Watched(await server.start())
    heard: list[Any] = []
    for field in ("data[0]", "data[1]", ""):
        watched.node.subscribe("/battery", "", lambda value, now_s: heard.append(value), field=field)
    await until(lambda: 3 in server.subscribed)
    payload = b"\x00\x01\x00\x00" + b"\x02\x00\x00\x00" + cdr(1.5)[4:] + cdr(2.5)[4:] + b"\x02\x00\x00\x00x\x00"
    await server.send(message(server.subscribed[3], payload))
    await until(lambda: len(heard) == 3)
    assert heard == [1.5, 2.5, {"data": [1.5, 2.5], "name": "x"}]
    await watched.close()
    await server.close()
