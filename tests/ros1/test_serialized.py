"""Reading serialized messages by the header of their connection."""

from __future__ import annotations

import weakref
from typing import Any, Callable, Mapping

from robot_health_monitor.core.values.field_path import ABSENT

FLOAT = {
    "type": "std_msgs/Float32",
    "md5sum": "73fcbf46b49191e672908e50842a83d4",
    "message_definition": "float32 data\n",
}


def raw(header: Mapping[str, str], data: bytes = b"\x00\x00\x9cA") -> Any:
    import rospy

    message = rospy.AnyMsg().deserialize(data)
    message._connection_header = header
    return message


def bytes_reader(topic: str, expected: str, log: Callable[[Any, str], None]) -> Any:
    """Returns what passes messages on as they are, with their format."""
    from robot_health_monitor.ros1.serialized import message_reader

    return message_reader(topic, expected, lambda raw: lambda data: (data, raw), log)


def field_reader(field: str, log: Callable[[Any, str], None]) -> Any:
    from robot_health_monitor.core.messages.serialized import SerializedType
    from robot_health_monitor.ros1.serialized import message_reader

    return message_reader("/in", "", lambda raw: SerializedType("/in", raw).field_getter(field), log)


def test_the_definition_is_that_of_the_publisher_even_of_a_type_that_is_not_installed() -> None:
    read = bytes_reader("/in", "", lambda severity, text: None)
    data, raw_format = read(raw(FLOAT))
    assert data == b"\x00\x00\x9cA"
    assert raw_format == ("ros1", "std_msgs/Float32", "ros1msg", "float32 data\n")
    foreign = {"type": "acme_msgs/Motor", "md5sum": "0" * 32, "message_definition": "int32 rpm\n"}
    assert read(raw(foreign))[1] == ("ros1", "acme_msgs/Motor", "ros1msg", "int32 rpm\n")


def test_a_publisher_without_a_definition_is_believed_to_have_the_installed_one() -> None:
    read = bytes_reader("/in", "std_msgs/msg/Float32", lambda severity, text: None)
    header = {"type": "std_msgs/Float32", "md5sum": FLOAT["md5sum"]}
    assert read(raw(header))[1].schema.strip() == "float32 data"
    unknown = bytes_reader("/in", "", lambda severity, text: None)(raw({"type": "acme_msgs/Motor"}))
    assert unknown[1].schema == ""


def test_messages_of_another_type_are_left_out_with_one_line() -> None:
    lines: list[str] = []
    read = bytes_reader("/in", "std_msgs/Float64", lambda severity, text: lines.append(text))
    assert [read(raw(FLOAT)) for _ in range(3)] == [ABSENT] * 3
    assert read(raw(dict(FLOAT))) is ABSENT
    assert lines == ["/in: expected messages of type std_msgs/Float64, got std_msgs/Float32"]


def test_two_publishers_with_one_definition_have_one_format() -> None:
    read = bytes_reader("/in", "", lambda severity, text: None)
    first, second = raw(dict(FLOAT)), raw(dict(FLOAT))
    formats = [read(message)[1] for message in (first, second, first)]
    assert formats[0] is formats[1] is formats[2]


def test_any_number_of_definitions_takes_bounded_memory() -> None:
    from robot_health_monitor.ros1.serialized import message_reader

    formats: weakref.WeakSet[Any] = weakref.WeakSet()

    def getter_of(raw_format: Any) -> Any:
        def get(data: bytes) -> Any:
            return raw_format

        formats.add(get)
        return get

    read = message_reader("/in", "", getter_of, lambda severity, text: None)
    for number in range(1000):
        read(raw({"type": "acme_msgs/Motor", "message_definition": f"int32 rpm{number}\n"}))
    assert len(formats) <= 100


def test_messages_that_this_process_reads_itself_are_serialized_again() -> None:
    """rospy subscribes to /clock with its class."""
    from std_msgs.msg import Float32

    message = Float32(19.5)
    message._connection_header = FLOAT
    data, _ = bytes_reader("/in", "", lambda severity, text: None)(message)
    assert data == b"\x00\x00\x9cA"


def test_a_field_is_read_by_the_definition_of_each_publisher() -> None:
    """rospy refuses a publisher with another definition, unless all messages of the topic are received as bytes."""
    lines: list[str] = []
    read = field_reader("data", lambda severity, text: lines.append(text))
    assert read(raw(FLOAT)) == 19.5
    longer = {**FLOAT, "md5sum": "0" * 32, "message_definition": "uint8 id\nfloat32 data\n"}
    assert read(raw(longer, b"\x07\x00\x00\x9cA")) == 19.5
    assert read(raw(FLOAT)) == 19.5
    assert lines == []


def test_a_publisher_of_another_definition_that_it_does_not_send_is_not_read() -> None:
    lines: list[str] = []
    read = field_reader("data", lambda severity, text: lines.append(text))
    assert read(raw({"type": "std_msgs/Float32", "md5sum": "0" * 32})) is ABSENT
    (line,) = lines
    assert line.startswith("/in: std_msgs/Float32 has no field data; ")
    assert read(raw({"type": "std_msgs/Float32", "md5sum": FLOAT["md5sum"]})) == 19.5


def test_the_same_bytes_are_decoded_as_the_type_of_each_publisher() -> None:
    """Python has each byte once, so that messages of one byte are the same object."""
    read = field_reader("data", lambda severity, text: None)
    signed = {"type": "std_msgs/Int8", "message_definition": "int8 data\n"}
    unsigned = {"type": "std_msgs/UInt8", "message_definition": "uint8 data\n"}
    assert [read(raw(header, b"\xff")) for header in (signed, unsigned, signed)] == [-1, 255, -1]
