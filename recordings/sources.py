"""The signals that a recording offers: the numeric fields of the standard messages, with their units."""

from __future__ import annotations

import re
from typing import Any, Dict, Iterable, List, Mapping, NamedTuple, Set, Tuple

from robot_health_monitor.core.definitions import NUMBERS
from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.core.formatting import list_text
from robot_health_monitor.core.signal_config import LINK

from .decoding import types_of
from .recording import Channel

MOST_SIGNALS = 300  # most signals that are looked at
MOST_FIELDS = 100  # most numbers of one topic that are looked at; the standard messages have at most 10

_LONGEST_NAME = 200  # letters of a signal's name; YAML allows 1,024 in a key
SUPPORTED_PACKAGES = ("std_msgs", "sensor_msgs")  # packages whose numbers are taken
_TOPICS = ("/clock", "/rosout", "/rosout_agg", "/parameter_events")  # topics of the middleware itself
_NAME = re.compile(r"/[A-Za-z_]\w*(/\w+)*\Z", re.ASCII)
_TIMES = ("sec", "nanosec", "secs", "nsecs")

_UNITS: Mapping[str, Mapping[str, str]] = {
    "BatteryState": {
        "voltage": "V", "temperature": "degC", "current": "A", "charge": "Ah", "capacity": "Ah", "design_capacity": "Ah"
    },
    "Temperature": {"temperature": "degC"},
    "FluidPressure": {"fluid_pressure": "Pa"},
    "Illuminance": {"illuminance": "lx"},
    "Range": {"range": "m", "min_range": "m", "max_range": "m", "field_of_view": "rad"},
    "NavSatFix": {"latitude": "deg", "longitude": "deg", "altitude": "m"},
    "Imu": {
        f"{field}.{axis}": unit
        for field, unit in (("angular_velocity", "rad/s"), ("linear_acceleration", "m/s^2"))
        for axis in "xyz"
    },
    "MagneticField": {f"magnetic_field.{axis}": "T" for axis in "xyz"},
}  # fmt: skip
"""Units that the definitions of the messages of sensor_msgs state."""

FRACTIONS = (("sensor_msgs/BatteryState", "percentage"), ("sensor_msgs/RelativeHumidity", "relative_humidity"))
"""Fields that are 0 to 1 by definition, shown in %."""


class Source(NamedTuple):
    """One number of a topic, as a signal."""

    name: str
    topic: str  # the absolute one
    settings: Mapping[str, Any]
    """Topic relative to the namespace, type, field and, where the definition has one, unit."""


def list_sources(channels: Iterable[Channel], namespace: str = "") -> Tuple[List[Source], List[str]]:
    """Returns the sources of all topics with standard messages, and a line for each topic that cannot be used.

    A topic with several numbers or none also has a source that only counts its messages; it is the last of its topic.
    Names, and topics in the namespace (without slashes at its ends), are relative to it.
    """
    found: List[Source] = []
    problems: List[str] = []
    left_out: List[str] = []
    prefix = f"/{namespace}/" if namespace else "/"
    names: Set[str] = set()
    seen: Dict[str, str] = {}
    for channel in sorted(channels, key=lambda each: each.topic):
        if channel.topic in _TOPICS or channel.type_name.partition("/")[0] not in SUPPORTED_PACKAGES:
            continue
        if not _NAME.match(channel.topic):
            problems.append(f"{channel.topic}: left out, its name is not valid in ROS")
            continue
        if channel.topic in seen:
            if seen[channel.topic] != channel.type_name:
                problems.append(f"{channel.topic}: {channel.type_name} left out, it also has {seen[channel.topic]}")
            continue
        try:
            fields = _fields(channel)
        except ConfigError as error:
            problems.append(error.problem)
            continue
        seen[channel.topic] = channel.type_name
        if len(fields) > MOST_FIELDS:
            problems.append(f"{channel.topic}: expected at most {MOST_FIELDS} numbers, got more: the rest is left out")
        fields = fields if len(fields) == 1 else [*fields[:MOST_FIELDS], ""]
        if len(found) + len(fields) > MOST_SIGNALS:
            left_out.append(channel.topic)
            continue
        topic = channel.topic[len(prefix) :] if channel.topic.startswith(prefix) else channel.topic
        topic = channel.topic if topic[0].isdigit() else topic  # `/r1/2d` is a name, `2d` is not
        for field in fields:
            settings: Dict[str, Any] = {"topic": topic, "type": channel.type_name, "field": field}
            units = _UNITS.get(channel.type_name.replace("sensor_msgs/", ""), {})
            if field in units:
                settings["unit"] = units[field]
            found.append(Source(_name(topic, field, names), channel.topic, settings))
    if left_out:
        problems.append(f"topics left out, because there are more than {MOST_SIGNALS} signals: {list_text(left_out)}")
    return found, problems


def _fields(channel: Channel) -> List[str]:
    package, _, name = channel.type_name.partition("/")
    if package == "std_msgs" and (name in ("Byte", "Char") or name.endswith("MultiArray")):
        return []
    fields = []
    for path, letter in types_of(channel).numbers():
        is_code = package == "sensor_msgs" and letter in ("b", "B")
        is_time = path.split(".")[-1] in _TIMES
        if letter != NUMBERS["bool"] and not is_code and not is_time and not path.startswith("header."):
            fields.append(path)
    return fields


def _name(topic: str, field: str, names: Set[str]) -> str:
    """Returns a name of letters, digits and _, unlike all of `names`, and adds it to them."""
    words = topic.strip("/") if field in ("", "data") else f"{topic.strip('/')}_{field}"
    name = re.sub(r"[^A-Za-z0-9_]", "_", words[:_LONGEST_NAME])
    if not name or name[0].isdigit() or name == LINK:
        name = f"_{name}"
    unique, number = name, 1
    while unique in names:
        number += 1
        unique = f"{name}_{number}"
    names.add(unique)
    return unique
