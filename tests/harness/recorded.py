"""Recordings for tests, written by rosbags and mcap, never by the code under test; and what it reads from them."""

from __future__ import annotations

import random
import struct
from pathlib import Path
from typing import Any, Iterable, Mapping, NamedTuple, Sequence

import numpy as np
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_typestore

from robot_health_monitor.recordings.decoding import type_of
from robot_health_monitor.recordings.reading import Recordings
from robot_health_monitor.recordings.recording import Channel, RecordingError

ROS1 = get_typestore(Stores.ROS1_NOETIC)
ROS2 = get_typestore(Stores.ROS2_HUMBLE)
FLOAT32 = "std_msgs/msg/Float32"
_NAME, _ARRAY, _SEQUENCE = 2, 3, 4
"""rosbags' kinds of fields."""
_NUMPY = dict.fromkeys(("byte", "char", "octet"), "uint8")
START_NS = 1_700_000_000_000_000_000


class Recorded(NamedTuple):
    """A message that was recorded."""

    time_s: float
    """Seconds since `START_NS`."""
    topic: str
    message: Any
    """A number: a std_msgs/Float32; else a message of rosbags."""


class ReadBack(NamedTuple):
    """What was read from recordings."""

    messages: list[Recorded]
    problems: list[str]
    channels: list[Channel]


def values(topic: str, numbers: Iterable[float], period_s: float = 1.0, start_s: float = 0.0) -> Sequence[Recorded]:
    """Returns Float32 messages at regular times."""
    return [Recorded(start_s + index * period_s, topic, number) for index, number in enumerate(numbers)]


def nanoseconds(time_s: float) -> int:
    """Returns the log time of a message."""
    return START_NS + round(time_s * 1e9)


def native(message: Any, store: Any) -> Any:
    """Returns a message of rosbags; a number becomes a std_msgs/Float32."""
    return store.types[FLOAT32](data=message) if isinstance(message, (int, float)) else message


def serialized(message: Any, encoding: str) -> bytes:
    """Returns the bytes of a message; a number becomes a std_msgs/Float32."""
    store = ROS1 if encoding == "ros1" else ROS2
    found = native(message, store)
    serialize = store.serialize_ros1 if encoding == "ros1" else store.serialize_cdr
    return bytes(serialize(found, found.__msgtype__))


def write_bag(path: Path, messages: Iterable[Recorded], compression: str = "none", chunk_size: int = 1 << 20) -> str:
    """Writes a ROS 1 bag with rosbags; returns its path."""
    writer = rosbag1.Writer(path)
    writer.chunk_threshold = chunk_size
    if compression != "none":
        writer.set_compression(getattr(writer.CompressionFormat, compression.upper()))
    _write(writer, messages, "ros1")
    return str(path)


def write_folder(
    path: Path,
    messages: Iterable[Recorded],
    *,
    version: int | None = None,
    storage: str = "sqlite3",
    compression: str = "",
) -> str:
    """Writes a folder of rosbag2 with rosbags.

    Args:
        path: the folder.
        messages: in any order.
        version: of the metadata; None: 8, or what this rosbags can write.
        storage: `sqlite3` or `mcap`.
        compression: `file`, `message` or empty.

    Returns:
        Its path.
    """
    options: Any = {} if version is None else {"version": version}
    if hasattr(rosbag2, "StoragePlugin"):
        options.setdefault("version", 8)
        options["storage_plugin"] = rosbag2.StoragePlugin[storage.upper()]
    writer = rosbag2.Writer(path, **options)
    if compression:
        enums: Any = rosbag2 if hasattr(rosbag2, "CompressionMode") else writer
        writer.set_compression(enums.CompressionMode[compression.upper()], enums.CompressionFormat.ZSTD)
    _write(writer, messages, "cdr")
    return str(path)


def _write(writer: Any, messages: Iterable[Recorded], encoding: str) -> None:
    """Writes messages with a writer of rosbags, and closes it."""
    store = ROS1 if encoding == "ros1" else ROS2
    with writer:
        connections: Any = {}
        for time_s, topic, message in messages:
            found = native(message, store)
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, found.__msgtype__, typestore=store)
            writer.write(connections[topic], nanoseconds(time_s), serialized(found, encoding))


def write_mcap(
    path: Path,
    messages: Iterable[Recorded],
    *,
    encoding: str = "cdr",
    compression: str = "none",
    definitions: Mapping[str, Any] | None = None,
    **options: Any,
) -> str:
    """Writes an MCAP file with the library mcap; returns its path.

    Args:
        path: the file.
        messages: in any order.
        encoding: `ros1` or `cdr`.
        compression: `none`, `lz4` or `zstd`.
        definitions: per type, the encoding and text of its definition; types that are left out: their own.
        options: for mcap's writer.
    """
    store = ROS1 if encoding == "ros1" else ROS2
    with open(path, "wb") as file:
        writer = McapWriter(file, compression=CompressionType[compression.upper()], **options)
        writer.start(profile="ros1" if encoding == "ros1" else "ros2", library="test")
        channels: Any = {}
        for time_s, topic, message in messages:
            found = native(message, store)
            name = found.__msgtype__
            if topic not in channels:
                default = ("ros1msg" if encoding == "ros1" else "ros2msg", definition(store, name))
                form, text = (definitions or {}).get(name, default)
                shown = name.replace("/msg/", "/") if encoding == "ros1" else name
                schema = writer.register_schema(shown, form, text.encode()) if form else 0
                channels[topic] = writer.register_channel(topic, encoding, schema)
            time_ns = nanoseconds(time_s)
            writer.add_message(channels[topic], time_ns, serialized(found, encoding), time_ns)
        writer.finish()
    return str(path)


def definition(store: Any, name: str) -> str:
    """Returns the text of a type's definition with those of the types in it."""
    found = store.generate_msgdef(name, ros_version=1 if store is ROS1 else 2)
    return str(found[0])


def read(*paths: str) -> ReadBack:
    """Returns everything that the code under test reads from recordings; one without messages has a problem only."""
    try:
        opened = Recordings(paths)
    except RecordingError as error:
        if "has no message that can be read" not in str(error):
            raise
        return ReadBack([], [str(error).replace("has no message that can be read: ", "")], [])
    with opened as recordings:
        targets = {channel: channel for channel in recordings.channels}
        found = []
        for time_ns, channel, data in recordings.messages(targets):
            value = type_of(channel).field_getter("data")(data) if channel.type_name == "std_msgs/Float32" else data
            found.append(Recorded((time_ns - START_NS) / 1e9, channel.topic, value))
        return ReadBack(found, recordings.problems, recordings.channels)


def fields_of(store: Any, name: str) -> Any:
    """Returns the fields of a type, as rosbags describes them."""
    return (getattr(store, "fielddefs", None) or store.FIELDDEFS)[name][1]


def random_message(chance: random.Random, store: Any, name: str) -> Any:
    """Returns a message with random values and strings of random length."""

    def value(kind: Any, what: Any) -> Any:
        if kind == _NAME:
            return random_message(chance, store, what)
        if kind in (_ARRAY, _SEQUENCE):
            (element, of), size = what
            count = size if kind == _ARRAY else chance.randrange(4)
            items = [value(element, of) for _ in range(count)]
            if element == _NAME or of[0] == "string":
                return items
            return np.array(items, dtype=_NUMPY.get(of[0], of[0]))
        if what[0] == "string":
            return "x" * chance.randrange(9)
        if what[0].startswith("float"):
            return struct.unpack("<f", struct.pack("<f", chance.uniform(-1e6, 1e6)))[0]
        return bool(chance.randrange(2)) if what[0] == "bool" else chance.randrange(100)

    return store.types[name](**{field: value(kind, what) for field, (kind, what) in fields_of(store, name)})


def message_of(store: Any, name: str, given: Mapping[str, Any]) -> Any:
    """Returns a message with some fields, of which parts may be left out: they are 0, empty, or of such fields."""

    def value(kind: Any, what: Any, part: Any) -> Any:
        if kind == _NAME:
            return message_of(store, what, part or {})
        if kind in (_ARRAY, _SEQUENCE):
            (element, of), size = what
            default = [0] * size if kind == _ARRAY else []
            items = [value(element, of, each) for each in (default if part is None else part)]
            return items if element == _NAME or of[0] == "string" else np.array(items, dtype=_NUMPY.get(of[0], of[0]))
        return ("" if what[0] == "string" else 0) if part is None else part

    return store.types[name](
        **{field: value(kind, what, given.get(field)) for field, (kind, what) in fields_of(store, name)}
    )
