"""Paths bound to the definition of a type; the same path reads the same from bytes and from a mapping."""

from __future__ import annotations

from typing import Any

import pytest

from robot_health_monitor.core.messages.definitions import parse_msg
from robot_health_monitor.core.messages.raw_messages import RawFormat, ros1_format
from robot_health_monitor.core.messages.serialized import SerializedType
from robot_health_monitor.core.values.elements import NOT_A_NUMBER, BadDatum, DriverStatus, Elements, Stamp
from robot_health_monitor.core.values.errors import ConfigError
from robot_health_monitor.core.values.field_path import ABSENT, mapping_getter
from robot_health_monitor.rosbridge.protocol.definitions import _serialized

DEFINITION = """
time stamp
string[] name
float64[] effort
float64[2] limits
uint8[] temperatures
Dynamic dynamic
diagnostic_msgs/DiagnosticStatus[] status
Transform[] transforms
Transform transform
================================================================================
MSG: demo/Dynamic
string[] joint_names
Interfaces[] interface_values
================================================================================
MSG: demo/Interfaces
string[] interface_names
float64[] values
================================================================================
MSG: demo/Limits
float64[2] limits
Transform[] transforms
================================================================================
MSG: demo/Transform
time stamp
float64 x
================================================================================
MSG: diagnostic_msgs/DiagnosticStatus
int8 level
string name
string message
diagnostic_msgs/KeyValue[] values
================================================================================
MSG: diagnostic_msgs/KeyValue
string key
string value
"""


def format_of(type_name: str) -> RawFormat:
    """Returns the format of a type of `DEFINITION`."""
    first, *others = DEFINITION.strip().split("=" * 80 + "\n")
    texts = {"demo/Everything": first, **dict(part[len("MSG: ") :].split("\n", 1) for part in others)}
    own = texts.pop(type_name)
    parts = [own, *(f"MSG: {name}\n{text}" for name, text in texts.items() if name != "demo/Everything")]
    return ros1_format(type_name, ("=" * 80 + "\n").join(parts))


def getter(type_name: str, field: str) -> Any:
    return SerializedType("/in", format_of(type_name)).field_getter(field)


def serialized(type_name: str, message: dict[str, Any]) -> bytes:
    """Returns a message as genpy would: by code of the server, which shares none with what reads it."""
    return _serialized(parse_msg(type_name, format_of(type_name).schema), type_name, message)


MESSAGE: dict[str, Any] = {
    "stamp": {"secs": 1_700_000_000, "nsecs": 500_000_000},
    "name": ["wheel_left", "wheel_right", "arm"],
    "effort": [1.5, -2.5, 0.25],
    "limits": [3.0, 4.0],
    "temperatures": "Kyo=",
    "dynamic": {
        "joint_names": ["wheel_left", "arm"],
        "interface_values": [
            {"interface_names": ["position", "effort"], "values": [0.5, 7.5]},
            {"interface_names": ["effort"], "values": [8.5]},
        ],
    },
    "status": [
        {"level": 1, "name": "lidar: front", "message": "weak", "values": [{"key": "T", "value": "41.5"}]},
        {"level": 2, "name": "motor", "message": "stalled", "values": []},
    ],
    "transforms": [
        {"stamp": {"secs": 5, "nsecs": 0}, "x": 1.0},
        {"stamp": {"secs": 6, "nsecs": 0}, "x": 2.0},
    ],
    "transform": {"stamp": {"secs": 7, "nsecs": 0}, "x": 3.0},
}


def read(field: str, message: dict[str, Any]) -> Any:
    """Returns what a field reads, which is the same from a serialized message and from a mapping."""
    found = getter("demo/Everything", field)(serialized("demo/Everything", message))
    of_mapping = mapping_getter(field)(message)
    assert type(of_mapping) is type(found)
    assert of_mapping == found
    return found


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("effort[*]", [("0", 1.5), ("1", -2.5), ("2", 0.25)]),
        ("limits[*]", [("0", 3.0), ("1", 4.0)]),
        ("temperatures[*]", [("0", 43), ("1", 42)]),
        ('effort["*"]', [("wheel_left", 1.5), ("wheel_right", -2.5), ("arm", 0.25)]),
        ('effort["wheel_*"]', [("wheel_left", 1.5), ("wheel_right", -2.5)]),
        ('effort["ar?"]', [("arm", 0.25)]),
        ('dynamic.interface_values["*"].values["effort"]', [("wheel_left", 7.5), ("arm", 8.5)]),
        ('dynamic.interface_values["*"].values["position"]', [("wheel_left", 0.5)]),
        ('dynamic.interface_values["wheel_left"].values["*"]', [("position", 0.5), ("effort", 7.5)]),
        ("dynamic.interface_values[*].values[1]", [("0", 7.5), ("1", None)]),
        ("status[*].level", [("0", 1), ("1", 2)]),
        ('status["*"].level', [("lidar: front", 1), ("motor", 2)]),
        ('status["*"]', [("lidar: front", DriverStatus(1, "weak")), ("motor", DriverStatus(2, "stalled"))]),
        ('status["*"].values["T"]', [("lidar: front", 41.5)]),
        ('status["lidar: front"].values["*"]', [("T", 41.5)]),
        ("transforms[*].x", [("0", 1.0), ("1", 2.0)]),
        ("transforms[*].stamp", [("0", Stamp(5.0)), ("1", Stamp(6.0))]),
        ("transforms[*]", [("0", NOT_A_NUMBER), ("1", NOT_A_NUMBER)]),
        ("dynamic.interface_values[*].values", [("0", NOT_A_NUMBER), ("1", NOT_A_NUMBER)]),
    ],
)
def test_a_path_with_several_elements_reads_name_and_value_of_each(field: str, value: Any) -> None:
    found = read(field, MESSAGE)
    assert type(found) is Elements
    assert found == value


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("stamp", Stamp(1_700_000_000.5)),
        ("transform.stamp", Stamp(7.0)),
        ("transforms[1].stamp", Stamp(6.0)),
        ('effort["wheel_right"]', -2.5),
        ('effort["leg"]', ABSENT),
        ('dynamic.interface_values["wheel_left"].values["effort"]', 7.5),
        ('dynamic.interface_values["arm"].values["position"]', ABSENT),
        ('status["motor"]', DriverStatus(2, "stalled")),
        ("status[0]", DriverStatus(1, "weak")),
        ('status["lidar: front"].values["T"]', 41.5),
        ('status["lidar*"].values["no such key"]', ABSENT),
        ('effort["leg*"]', ABSENT),
    ],
)
def test_a_path_to_one_value_reads_it(field: str, value: Any) -> None:
    found = read(field, MESSAGE)
    assert type(found) is type(value)
    assert found == value


@pytest.mark.parametrize("field", ['effort["wheel_left"]', 'effort["*"]', 'effort["wheel_*"]'])
def test_an_empty_array_beside_names_is_not_measured(field: str) -> None:
    assert read(field, {**MESSAGE, "effort": []}) is ABSENT


@pytest.mark.parametrize("field", ['effort["wheel_left"]', 'effort["*"]', 'effort["leg"]'])
@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"effort": [1.0]}, "effort has 1 elements, name has 3"),
        ({"effort": [1.0] * 4}, "effort has 4 elements, name has 3"),
        ({"name": []}, "effort has 3 elements, name has 0"),
    ],
)
def test_arrays_of_other_lengths_are_a_bad_datum_that_names_both(
    field: str, changed: dict[str, Any], reason: str
) -> None:
    found = read(field, {**MESSAGE, **changed})
    assert type(found) is BadDatum
    assert found == reason


def test_names_that_are_not_text_are_a_bad_datum_where_they_are_needed() -> None:
    message = {**MESSAGE, "name": ["wheel_left", 5, "arm"]}
    assert mapping_getter('effort["arm"]')(message) == 0.25
    found = mapping_getter('effort["*"]')(message)
    assert type(found) is BadDatum
    assert found == "name[1] is not a text: 5"
    status = {**MESSAGE, "status": [*MESSAGE["status"], {"name": None, "level": 0, "message": ""}]}
    assert mapping_getter('status["*"].level')(status) == "status[2] is not a text: None"
    assert mapping_getter('status["a*"].level')(status) == "status[2] is not a text: None"


@pytest.mark.parametrize("field", ["effort[*]", 'effort["*"]', 'status["*"]'])
def test_more_elements_than_are_read_are_a_bad_datum(field: str) -> None:
    number = 10_001
    many = {**MESSAGE, "name": ["x"] * number, "effort": [0.0] * number, "status": [MESSAGE["status"][0]] * number}
    assert read(field, many) == "10001 elements (limit 10000)"


def test_all_elements_of_an_empty_array_are_none() -> None:
    found = read("effort[*]", {**MESSAGE, "effort": []})
    assert type(found) is Elements
    assert found == []


@pytest.mark.parametrize("field", ["effort[*]", "effort[0]", 'effort["a"]', 'effort["*"]', "effort[*].x"])
@pytest.mark.parametrize("value", [5.0, None, {"a": 1}, "no base64!"])
def test_a_mapping_with_something_else_where_an_array_belongs_has_no_such_field(field: str, value: object) -> None:
    with pytest.raises((TypeError, KeyError, AttributeError)):
        mapping_getter(field)({"name": ["a"], "effort": value})


@pytest.mark.parametrize(
    ("field", "reason"),
    [
        ("stamp[*]", "stamp is a builtin_interfaces/Time, not an array"),
        ('limits["*"].x', "an element of limits is a plain value or a list, without fields"),
        ('transform["*"]', "transform is a demo/Transform, not an array"),
        ("transforms[*].y", "an element of transforms has stamp, x"),
    ],
)
def test_a_wrong_path_with_several_elements_is_refused(field: str, reason: str) -> None:
    with pytest.raises(ConfigError) as caught:
        getter("demo/Everything", field)
    assert str(caught.value) == f"/in: demo/Everything has no field {field}; {reason}"


def test_elements_without_names_anywhere_cannot_be_selected_by_name() -> None:
    with pytest.raises(ConfigError, match="the elements of limits have no name and no key"):
        getter("demo/Limits", 'limits["*"]')


class TestStatusesOfThisPackage:
    """They never match a pattern, so that no monitor watches itself or another one; by full name they can be read."""

    @staticmethod
    def message(**others: str) -> dict[str, Any]:
        names = {"lidar: front": "fingers", **others}
        statuses = [
            {"level": 1, "name": name, "message": "hot", "values": [{"key": key, "value": "5"}]}
            for name, key in names.items()
        ]
        return {**MESSAGE, "status": statuses}

    @pytest.mark.parametrize(
        "other", ["alert_system: monitor", "aggregator: inputs", "battery_sensor: sensors", "connect: monitor"]
    )
    def test_are_known_by_their_names(self, other: str) -> None:
        message = self.message(**{other: "key"})
        assert read('status["*"].level', message) == [("lidar: front", 1)]
        assert read('status["*: *"]', message) == [("lidar: front", DriverStatus(1, "hot"))]
        assert read("status[*].level", message) == [("0", 1)]
        assert read(f'status["{other}"].level', message) == 1

    def test_are_known_by_their_fingerprint(self) -> None:
        message = self.message(**{"renamed: battery": "fingerprint"})
        assert read('status["*"].level', message) == [("lidar: front", 1)]
        assert read('status["renamed*"].level', message) is ABSENT
        assert read('status["renamed: battery"]', message) == DriverStatus(1, "hot")

    @pytest.mark.parametrize("values", [None, 7, [7], [{}], "text"])
    def test_do_not_need_values_that_make_sense(self, values: Any) -> None:
        status = {"level": 1, "name": "lidar", "message": "hot", "values": values}
        assert mapping_getter('status["*"].level')({"status": [status]}) == [("lidar", 1)]


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ('["motor"]', DriverStatus(2, "stalled")),
        ('["motor"].level', 2),
        ('["*"]', [("motor", DriverStatus(2, "stalled"))]),
        ('["mo?or"].level', [("motor", 2)]),
        ('["lidar"]', ABSENT),
        ('["lidar*"]', ABSENT),
    ],
)
def test_a_path_may_begin_with_the_name_of_the_message(field: str, value: Any) -> None:
    message = MESSAGE["status"][1]
    name = "diagnostic_msgs/DiagnosticStatus"
    assert getter(name, field)(serialized(name, message)) == value
    assert mapping_getter(field)(message) == value


def test_a_message_without_a_name_has_none_to_begin_with() -> None:
    with pytest.raises(ConfigError, match="the elements of demo/Transform have no name and no key"):
        getter("demo/Transform", '["a"]')


@pytest.mark.parametrize("field", ["[0]", "[*]", "[0].level"])
def test_a_path_does_not_begin_with_an_index(field: str) -> None:
    with pytest.raises(ConfigError, match="a path starts with the name of a field"):
        mapping_getter(field)


@pytest.mark.parametrize(
    ("type_name", "field", "reason"),
    [
        ("demo/Transform", "data", "demo/Transform has stamp, x"),
        ("demo/Everything", "transform.y", "transform has stamp, x"),
        ("demo/Everything", "transform.x.y", "x is a plain value or a list, without fields"),
        ("demo/Everything", "status.name", "status is a plain value or a list, without fields"),
        ("demo/Everything", "status[0].x", "an element of status has level, name, message, values"),
        ("demo/Everything", "transform[0]", "transform is a demo/Transform, not an array"),
        ("demo/Everything", "limits[2]", "limits has 2 elements, the last one is [1]"),
        ("demo/Everything", "limits[1][0]", "an element of limits is a float64, not an array"),
    ],
)
def test_an_invalid_path_is_refused_with_the_available_fields(type_name: str, field: str, reason: str) -> None:
    with pytest.raises(ConfigError) as caught:
        getter(type_name, field)
    assert str(caught.value) == f"/in: {type_name} has no field {field}; {reason}"


def test_a_text_that_is_not_a_path_is_rejected_with_the_topic() -> None:
    with pytest.raises(ConfigError, match=r"^/in: field '\.data' of demo/Transform: '\.data' is not a name"):
        getter("demo/Transform", ".data")


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("stamp.sec", 1_700_000_000),
        ("stamp.secs", 1_700_000_000),
        ("effort[3]", None),
        ("effort", [1.5, -2.5, 0.25]),
        ("temperatures", "Kyo="),
        ("temperatures[1]", 42),
        ("transform", {"stamp": {"secs": 7, "nsecs": 0}, "x": 3.0}),
        ('status["lidar: front"].values["T"].value', "41.5"),
        ("status[0].values[0].key", "T"),
        ("status[1].values", []),
        ("", MESSAGE),
    ],
)
def test_a_field_of_bytes_is_read_by_its_path(field: str, value: Any) -> None:
    assert getter("demo/Everything", field)(serialized("demo/Everything", MESSAGE)) == value


def test_an_array_that_is_too_long_is_not_read() -> None:
    long = {**MESSAGE, "temperatures": bytes(6_000_000)}
    data = serialized("demo/Everything", long)
    assert getter("demo/Everything", "temperatures[*]")(data) == "6000000 elements (limit 10000)"
