"""What a server offers, what is subscribed to, and what is said of topics that are not read."""

from __future__ import annotations

import json
import struct
from typing import Any, Callable

import pytest

from robot_health_monitor.core.messages.raw_messages import RawFormat
from robot_health_monitor.core.values.errors import ConfigError
from robot_health_monitor.foxglove.channels import MOST_CHANNELS, Channels
from robot_health_monitor.foxglove.protocol import Channel

FLOAT32 = "std_msgs/msg/Float32"


def channel(number: int, topic: str = "/battery", **changes: Any) -> Channel:
    raw_format = RawFormat("cdr", FLOAT32, "ros2msg", "float32 data\n")
    return Channel(number, topic, raw_format._replace(**changes))


def cdr(value: float) -> bytes:
    """A std_msgs/Float32: little-endian CDR."""
    return b"\x00\x01\x00\x00" + struct.pack("<f", value)


class Reader:
    """Reads `data` of a topic."""

    is_raw = False

    def __init__(self, topic: str, field: str = "data") -> None:
        self.topic = topic
        self.field = field
        self.values: list[Any] = []
        self.errors: list[str] = []

    def bind(self, channel: Channel, messages: Any) -> Callable[[bytes], None] | None:
        try:
            get = messages.field_getter(self.field)
        except ConfigError as error:
            self.errors.append(str(error))
            return None
        return lambda data: self.values.append(get(data))


class Server:
    """Notes what is sent."""

    def __init__(self) -> None:
        self.sent: list[Any] = []
        self.warnings: list[str] = []
        self.channels = Channels(lambda text: self.sent.append(json.loads(text)), self.warnings.append)

    def take(self) -> list[Any]:
        """Returns the (subscription, channel) and the ended subscriptions of what was sent since the last call."""
        sent, self.sent = self.sent, []
        found: list[Any] = []
        for each in sent:
            found += [(one["id"], one["channelId"]) for one in each.get("subscriptions", ())]
            found += each.get("subscriptionIds", ())
        self.sent.clear()
        return found


def test_only_what_is_watched_is_subscribed_to() -> None:
    server = Server()
    server.channels.advertise([channel(1), channel(2, "/camera")])
    assert server.take() == []
    reader = Reader("/battery")
    server.channels.add(reader)
    assert server.take() == [(0, 1)]
    server.channels.deliver(0, cdr(40.0))
    assert reader.values == [40.0]
    server.channels.remove(reader)
    assert server.take() == [0]
    server.channels.deliver(0, cdr(41.0))
    assert reader.values == [40.0]


def test_a_channel_that_comes_later_is_subscribed_to() -> None:
    server, reader = Server(), Reader("/battery")
    server.channels.add(reader)
    assert server.take() == []
    server.channels.advertise([channel(9)])
    assert server.take() == [(0, 9)]


def test_all_channels_of_a_topic_are_heard_by_all_readers() -> None:
    server, readers = Server(), [Reader("/battery"), Reader("/battery", "")]
    for reader in readers:
        server.channels.add(reader)
    server.channels.advertise([channel(4), channel(5)])
    assert server.take() == [(0, 4), (1, 5)]
    server.channels.deliver(0, cdr(1.5))
    server.channels.deliver(1, cdr(2.5))
    assert readers[0].values == [1.5, 2.5]
    assert readers[1].values == [{"data": 1.5}, {"data": 2.5}]


def test_a_channel_that_is_withdrawn_and_offered_again_is_subscribed_to_again() -> None:
    server, reader = Server(), Reader("/battery")
    server.channels.add(reader)
    server.channels.advertise([channel(1)])
    server.channels.unadvertise([1, 77])
    assert server.take() == [(0, 1)]
    server.channels.advertise([channel(1)])
    assert server.take() == [(1, 1)]
    server.channels.deliver(0, cdr(1.0))  # of the subscription that has ended
    server.channels.deliver(1, cdr(2.0))
    assert reader.values == [2.0]


def test_an_id_that_is_offered_anew_is_the_new_channel() -> None:
    server, reader = Server(), Reader("/battery")
    server.channels.add(reader)
    server.channels.advertise([channel(1), channel(1, "/other")])
    assert server.take() == [(0, 1)]
    server.channels.deliver(0, cdr(1.0))
    assert reader.values == []
    assert server.channels.why_silent("/battery", "") == "no publisher on /battery"


def test_a_new_connection_begins_anew() -> None:
    server, reader = Server(), Reader("/battery")
    server.channels.add(reader)
    server.channels.advertise([channel(1)])
    server.channels.end()
    assert server.channels.topics() == {}
    server.take()
    server.channels.advertise([channel(8)])
    assert server.take() == [(1, 8)]


def test_ten_thousand_channels_are_known_and_no_more() -> None:
    server = Server()
    server.channels.advertise(channel(number, f"/t{number}") for number in range(MOST_CHANNELS + 5))
    assert len(server.channels.topics()) == 10_000
    assert server.warnings == ["the server offers more than 10000 channels; further ones are not watched"]


def test_channels_of_one_topic_are_bounded_and_each_is_bound_once() -> None:
    server, bound = Server(), []

    class Counting(Reader):
        def bind(self, channel: Channel, messages: Any) -> Callable[[bytes], None] | None:
            bound.append(channel.id)
            return super().bind(channel, messages)

    server.channels.add(Counting("/battery"))
    server.channels.advertise(channel(number) for number in range(MOST_CHANNELS))
    assert len(server.take()) == 100 and bound == list(range(100))
    assert set(server.warnings) == {"the server offers more than 100 channels of one topic"}


def test_equal_schemas_are_kept_once_and_different_ones_are_bounded() -> None:
    server = Server()
    large = "float32 data\n# " + "x" * 1_000_000
    server.channels.advertise(channel(number, f"/t{number}", schema=large) for number in range(100))
    assert server.warnings == []
    server.channels.advertise(channel(100 + number, f"/u{number}", schema=f"{large}{number}") for number in range(25))
    assert set(server.warnings) == {"the server's schemas take too much memory; some messages cannot be read"}
    assert (
        sum(bool(found.raw_format.schema) for topic, found in server.channels.topics().items() if topic[1] == "u") <= 20
    )


@pytest.mark.parametrize(
    ("schema", "problem"),
    [
        ("", "no field data"),
        ("std_msgs/msg/Float32 data", "itself"),
        ("float32 volts", "volts"),
        ("this is no definition", "definition"),
        ("float32[4000000000] data", "data"),
    ],
)
def test_a_schema_that_cannot_be_used_is_an_error_of_the_reader(schema: str, problem: str) -> None:
    server, reader = Server(), Reader("/battery")
    server.channels.add(reader)
    server.channels.advertise([channel(1, schema=schema)])
    assert server.take() == [] and len(reader.errors) == 1 and "/battery" in reader.errors[0]


def test_bytes_that_are_no_message_of_the_type_do_not_pass() -> None:
    server, reader = Server(), Reader("/battery", "")
    server.channels.add(reader)
    server.channels.advertise([channel(1)])
    with pytest.raises(ValueError):
        server.channels.deliver(0, b"\x00\x01\x00\x00\x01")


@pytest.mark.parametrize(
    ("offered", "wanted", "hint"),
    [
        ([], "", "no publisher on /battery"),
        ([channel(1, "/battery_state")], "", "no publisher on /battery; /battery_state exists"),
        ([channel(1)], "", None),
        ([channel(1)], "std_msgs/Float32", None),
        (
            [channel(1)],
            "sensor_msgs/Temperature",
            "/battery is published as std_msgs/Float32, configured as sensor_msgs/Temperature",
        ),
        (
            [channel(1, message_encoding="protobuf")],
            "",
            "its messages have the encoding protobuf, which is not supported",
        ),
    ],
)
def test_hints_say_why_a_topic_is_silent(offered: list[Channel], wanted: str, hint: str | None) -> None:
    server = Server()
    server.channels.advertise(offered)
    assert server.channels.why_silent("/battery", wanted) == hint


@pytest.mark.parametrize(
    ("changes", "data"),
    [
        ({}, cdr(20.5)),
        (
            {
                "schema_encoding": "ros2idl",
                "schema": "module std_msgs { module msg { struct Float32 { float data; }; }; };",
            },
            cdr(20.5),
        ),
        (
            {"message_encoding": "ros1", "schema_encoding": "ros1msg", "schema_name": "std_msgs/Float32"},
            struct.pack("<f", 20.5),
        ),
        ({"message_encoding": "json", "schema_encoding": "jsonschema", "schema": "{}"}, b'{"data": 20.5}'),
    ],
)
def test_every_encoding_is_read(changes: Any, data: bytes) -> None:
    server, reader = Server(), Reader("/battery")
    server.channels.add(reader)
    server.channels.advertise([channel(1, **changes)])
    server.channels.deliver(0, data)
    assert reader.values == [20.5]
