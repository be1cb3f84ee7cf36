"""Definitions of the messages and services of std_msgs, std_srvs, sensor_msgs and diagnostic_msgs, for use without ROS.

The definitions are those of ROS 1 (Noetic), without comments, with every type spelt `package/Type`, and with the types
of geometry_msgs that they contain. `ROS2_FIELDS` has the fields that only ROS 2 (Jazzy) has.
"""

from __future__ import annotations

import functools
import operator
from typing import Any, Callable, Mapping, Sequence

from ..values import STATUS_TYPE, DriverStatus, Message, canonical_type, parse_field_path, split_type_name, steps_getter
from .definitions import NUMBERS, ROS1_TIMES, Definitions, Field, parse_definition, parse_msg
from .dialect import Dialect
from .native_messages import NativeMessages, bytes_as_text
from .typed_field import bound_path, typed_getter

PACKAGES = ("std_msgs", "std_srvs", "sensor_msgs", "diagnostic_msgs")
"""Packages of which every type is known here."""

_MESSAGES = """
std_msgs/Byte: byte data
std_msgs/Float32: float32 data
std_msgs/Float64: float64 data
std_msgs/Int16: int16 data
std_msgs/Int32: int32 data
std_msgs/Int64: int64 data
std_msgs/Int8: int8 data
std_msgs/UInt16: uint16 data
std_msgs/UInt32: uint32 data
std_msgs/UInt64: uint64 data
std_msgs/UInt8: uint8 data
std_msgs/Bool: bool data
std_msgs/Char: char data
std_msgs/Duration: duration data
std_msgs/String: string data
std_msgs/Time: time data
std_msgs/ByteMultiArray: std_msgs/MultiArrayLayout layout; byte[] data
std_msgs/Float32MultiArray: std_msgs/MultiArrayLayout layout; float32[] data
std_msgs/Float64MultiArray: std_msgs/MultiArrayLayout layout; float64[] data
std_msgs/Int16MultiArray: std_msgs/MultiArrayLayout layout; int16[] data
std_msgs/Int32MultiArray: std_msgs/MultiArrayLayout layout; int32[] data
std_msgs/Int64MultiArray: std_msgs/MultiArrayLayout layout; int64[] data
std_msgs/Int8MultiArray: std_msgs/MultiArrayLayout layout; int8[] data
std_msgs/UInt16MultiArray: std_msgs/MultiArrayLayout layout; uint16[] data
std_msgs/UInt32MultiArray: std_msgs/MultiArrayLayout layout; uint32[] data
std_msgs/UInt64MultiArray: std_msgs/MultiArrayLayout layout; uint64[] data
std_msgs/UInt8MultiArray: std_msgs/MultiArrayLayout layout; uint8[] data
std_msgs/ColorRGBA: float32 r; float32 g; float32 b; float32 a
std_msgs/Empty:
std_msgs/Header: uint32 seq; time stamp; string frame_id
std_msgs/MultiArrayDimension: string label; uint32 size; uint32 stride
std_msgs/MultiArrayLayout: std_msgs/MultiArrayDimension[] dim; uint32 data_offset
geometry_msgs/Point32: float32 x; float32 y; float32 z
geometry_msgs/Quaternion: float64 x; float64 y; float64 z; float64 w
geometry_msgs/Transform: geometry_msgs/Vector3 translation; geometry_msgs/Quaternion rotation
geometry_msgs/Twist: geometry_msgs/Vector3 linear; geometry_msgs/Vector3 angular
geometry_msgs/Vector3: float64 x; float64 y; float64 z
geometry_msgs/Wrench: geometry_msgs/Vector3 force; geometry_msgs/Vector3 torque
sensor_msgs/BatteryState:
  uint8 POWER_SUPPLY_STATUS_UNKNOWN=0; uint8 POWER_SUPPLY_STATUS_CHARGING=1; uint8 POWER_SUPPLY_STATUS_DISCHARGING=2
  uint8 POWER_SUPPLY_STATUS_NOT_CHARGING=3; uint8 POWER_SUPPLY_STATUS_FULL=4; uint8 POWER_SUPPLY_HEALTH_UNKNOWN=0
  uint8 POWER_SUPPLY_HEALTH_GOOD=1; uint8 POWER_SUPPLY_HEALTH_OVERHEAT=2; uint8 POWER_SUPPLY_HEALTH_DEAD=3
  uint8 POWER_SUPPLY_HEALTH_OVERVOLTAGE=4; uint8 POWER_SUPPLY_HEALTH_UNSPEC_FAILURE=5; uint8 POWER_SUPPLY_HEALTH_COLD=6
  uint8 POWER_SUPPLY_HEALTH_WATCHDOG_TIMER_EXPIRE=7; uint8 POWER_SUPPLY_HEALTH_SAFETY_TIMER_EXPIRE=8
  uint8 POWER_SUPPLY_TECHNOLOGY_UNKNOWN=0; uint8 POWER_SUPPLY_TECHNOLOGY_NIMH=1; uint8 POWER_SUPPLY_TECHNOLOGY_LION=2
  uint8 POWER_SUPPLY_TECHNOLOGY_LIPO=3; uint8 POWER_SUPPLY_TECHNOLOGY_LIFE=4; uint8 POWER_SUPPLY_TECHNOLOGY_NICD=5
  uint8 POWER_SUPPLY_TECHNOLOGY_LIMN=6; std_msgs/Header header; float32 voltage; float32 temperature; float32 current
  float32 charge; float32 capacity; float32 design_capacity; float32 percentage; uint8 power_supply_status
  uint8 power_supply_health; uint8 power_supply_technology; bool present; float32[] cell_voltage
  float32[] cell_temperature; string location; string serial_number
sensor_msgs/CameraInfo:
  std_msgs/Header header; uint32 height; uint32 width; string distortion_model; float64[] D; float64[9] K; float64[9] R
  float64[12] P; uint32 binning_x; uint32 binning_y; sensor_msgs/RegionOfInterest roi
sensor_msgs/ChannelFloat32: string name; float32[] values
sensor_msgs/CompressedImage: std_msgs/Header header; string format; uint8[] data
sensor_msgs/FluidPressure: std_msgs/Header header; float64 fluid_pressure; float64 variance
sensor_msgs/Illuminance: std_msgs/Header header; float64 illuminance; float64 variance
sensor_msgs/Image:
  std_msgs/Header header; uint32 height; uint32 width; string encoding; uint8 is_bigendian; uint32 step; uint8[] data
sensor_msgs/Imu:
  std_msgs/Header header; geometry_msgs/Quaternion orientation; float64[9] orientation_covariance
  geometry_msgs/Vector3 angular_velocity; float64[9] angular_velocity_covariance
  geometry_msgs/Vector3 linear_acceleration; float64[9] linear_acceleration_covariance
sensor_msgs/JointState: std_msgs/Header header; string[] name; float64[] position; float64[] velocity; float64[] effort
sensor_msgs/Joy: std_msgs/Header header; float32[] axes; int32[] buttons
sensor_msgs/JoyFeedback:
  uint8 TYPE_LED=0; uint8 TYPE_RUMBLE=1; uint8 TYPE_BUZZER=2; uint8 type; uint8 id; float32 intensity
sensor_msgs/JoyFeedbackArray: sensor_msgs/JoyFeedback[] array
sensor_msgs/LaserEcho: float32[] echoes
sensor_msgs/LaserScan:
  std_msgs/Header header; float32 angle_min; float32 angle_max; float32 angle_increment; float32 time_increment
  float32 scan_time; float32 range_min; float32 range_max; float32[] ranges; float32[] intensities
sensor_msgs/MagneticField:
  std_msgs/Header header; geometry_msgs/Vector3 magnetic_field; float64[9] magnetic_field_covariance
sensor_msgs/MultiDOFJointState:
  std_msgs/Header header; string[] joint_names; geometry_msgs/Transform[] transforms; geometry_msgs/Twist[] twist
  geometry_msgs/Wrench[] wrench
sensor_msgs/MultiEchoLaserScan:
  std_msgs/Header header; float32 angle_min; float32 angle_max; float32 angle_increment; float32 time_increment
  float32 scan_time; float32 range_min; float32 range_max; sensor_msgs/LaserEcho[] ranges
  sensor_msgs/LaserEcho[] intensities
sensor_msgs/NavSatFix:
  std_msgs/Header header; sensor_msgs/NavSatStatus status; float64 latitude; float64 longitude; float64 altitude
  float64[9] position_covariance; uint8 COVARIANCE_TYPE_UNKNOWN=0; uint8 COVARIANCE_TYPE_APPROXIMATED=1
  uint8 COVARIANCE_TYPE_DIAGONAL_KNOWN=2; uint8 COVARIANCE_TYPE_KNOWN=3; uint8 position_covariance_type
sensor_msgs/NavSatStatus:
  int8 STATUS_NO_FIX=-1; int8 STATUS_FIX=0; int8 STATUS_SBAS_FIX=1; int8 STATUS_GBAS_FIX=2; int8 status
  uint16 SERVICE_GPS=1; uint16 SERVICE_GLONASS=2; uint16 SERVICE_COMPASS=4; uint16 SERVICE_GALILEO=8; uint16 service
sensor_msgs/PointCloud: std_msgs/Header header; geometry_msgs/Point32[] points; sensor_msgs/ChannelFloat32[] channels
sensor_msgs/PointCloud2:
  std_msgs/Header header; uint32 height; uint32 width; sensor_msgs/PointField[] fields; bool is_bigendian
  uint32 point_step; uint32 row_step; uint8[] data; bool is_dense
sensor_msgs/PointField:
  uint8 INT8=1; uint8 UINT8=2; uint8 INT16=3; uint8 UINT16=4; uint8 INT32=5; uint8 UINT32=6; uint8 FLOAT32=7
  uint8 FLOAT64=8; string name; uint32 offset; uint8 datatype; uint32 count
sensor_msgs/Range:
  std_msgs/Header header; uint8 ULTRASOUND=0; uint8 INFRARED=1; uint8 radiation_type; float32 field_of_view
  float32 min_range; float32 max_range; float32 range
sensor_msgs/RegionOfInterest: uint32 x_offset; uint32 y_offset; uint32 height; uint32 width; bool do_rectify
sensor_msgs/RelativeHumidity: std_msgs/Header header; float64 relative_humidity; float64 variance
sensor_msgs/Temperature: std_msgs/Header header; float64 temperature; float64 variance
sensor_msgs/TimeReference: std_msgs/Header header; time time_ref; string source
diagnostic_msgs/DiagnosticArray: std_msgs/Header header; diagnostic_msgs/DiagnosticStatus[] status
diagnostic_msgs/DiagnosticStatus:
  byte OK=0; byte WARN=1; byte ERROR=2; byte STALE=3; byte level; string name; string message; string hardware_id
  diagnostic_msgs/KeyValue[] values
diagnostic_msgs/KeyValue: string key; string value
"""

_SERVICES = """
diagnostic_msgs/AddDiagnostics: string load_namespace; ---; bool success; string message
diagnostic_msgs/SelfTest: ---; string id; byte passed; diagnostic_msgs/DiagnosticStatus[] status
sensor_msgs/SetCameraInfo: sensor_msgs/CameraInfo camera_info; ---; bool success; string status_message
std_srvs/Empty: ---
std_srvs/SetBool: bool data; ---; bool success; string message
std_srvs/Trigger: ---; bool success; string message
"""


def _definitions(text: str) -> dict[str, str]:
    """Returns the definition of each type: `package/Type:` and its lines, with a semicolon between them."""
    definitions: dict[str, str] = {}
    name = ""
    for row in text.strip().splitlines():
        if not row.startswith(" "):
            name, _, row = row.partition(":")
            definitions[name] = ""
        definitions[name] += "".join(f"{line.strip()}\n" for line in row.split(";") if line.strip())
    return definitions


MESSAGES: Mapping[str, str] = _definitions(_MESSAGES)
"""Definition of each message, by type."""

SERVICES: Mapping[str, tuple[str, str]] = {
    name: (request, response)
    for name, text in _definitions(_SERVICES).items()
    for request, _, response in (text.partition("---\n"),)
}
"""Definitions of the request and the response of each service, by type."""

ROS2_FIELDS: Mapping[str, str] = {
    "sensor_msgs/CameraInfo": "float64[] d\nfloat64[9] k\nfloat64[9] r\nfloat64[12] p\n",
    "sensor_msgs/Range": "float32 variance\n",
}
"""Fields that only ROS 2 has, by type."""

_ROSGRAPH = _definitions("""
rosgraph_msgs/Clock: time clock
rosgraph_msgs/Log:
  byte DEBUG=1; byte INFO=2; byte WARN=4; byte ERROR=8; byte FATAL=16; std_msgs/Header header; byte level; string name
  string msg; string file; string function; uint32 line; string[] topics
""")
"""Definitions for clients that ask for them; these messages are not checked."""

_UNCHECKED: Mapping[str, str] = {
    **_ROSGRAPH,
    **_definitions("""
rcl_interfaces/Log:
  byte DEBUG=10; byte INFO=20; byte WARN=30; byte ERROR=40; byte FATAL=50
  time stamp; uint8 level; string name; string msg; string file; string function; uint32 line
actionlib_msgs/GoalID: time stamp; string id
actionlib_msgs/GoalStatus:
  uint8 PENDING=0; uint8 ACTIVE=1; uint8 PREEMPTED=2; uint8 SUCCEEDED=3; uint8 ABORTED=4; uint8 REJECTED=5
  uint8 PREEMPTING=6; uint8 RECALLING=7; uint8 RECALLED=8; uint8 LOST=9
  actionlib_msgs/GoalID goal_id; uint8 status; string text
actionlib_msgs/GoalStatusArray: std_msgs/Header header; actionlib_msgs/GoalStatus[] status_list
action_msgs/GoalInfo: unique_identifier_msgs/UUID goal_id; time stamp
action_msgs/GoalStatus:
  int8 STATUS_UNKNOWN=0; int8 STATUS_ACCEPTED=1; int8 STATUS_EXECUTING=2; int8 STATUS_CANCELING=3
  int8 STATUS_SUCCEEDED=4; int8 STATUS_CANCELED=5; int8 STATUS_ABORTED=6; action_msgs/GoalInfo goal_info; int8 status
action_msgs/GoalStatusArray: action_msgs/GoalStatus[] status_list
unique_identifier_msgs/UUID: uint8[16] uuid
"""),
}
"""Definitions of messages that are not checked; only what a signal reads of them is."""

_KNOWN: Mapping[str, str] = {**MESSAGES, **_UNCHECKED}
_DEFAULTS = {"bool": False, "string": "", "float32": 0.0, "float64": 0.0}


@functools.lru_cache(maxsize=1)
def _definitions_known() -> Definitions:
    """Returns the definitions of all types, with the fields of both versions of ROS."""
    definitions = {**ROS1_TIMES}
    for name, text in _KNOWN.items():
        definitions[name] = parse_definition(name, text + ROS2_FIELDS.get(name, ""), "ros1msg", is_ros1=True)[name]
    return definitions


def _fields(type_name: Any) -> Sequence[Field]:
    return _definitions_known()[type_name].fields


@functools.lru_cache(maxsize=1)
def _constants_by_fields() -> Mapping[frozenset[str], Mapping[str, float]]:
    """Returns the constants of each type by the names of all its fields, which tell types of JSON apart."""
    by_fields = {}
    for type_name, known in _definitions_known().items():
        if known.constants:
            names = [field.name for field in known.fields]
            ros1 = [name for name in names if not _is_ros2(type_name, name)]
            by_fields.update(dict.fromkeys(map(frozenset, (names, ros1)), known.numbers))
    return by_fields


def constant_getter(path: str, name: str) -> Callable[[Any], float]:
    """Returns a function that finds the constant of a field's type in a message that is a mapping.

    It raises KeyError if the type is not known here, or has no such constant.
    """
    steps = parse_field_path(path)
    while not isinstance(steps[-1], str):
        steps = steps[:-1]
    owner_of = steps_getter(steps[:-1])

    def get(message: Any) -> float:
        owner = owner_of(message)
        fields = _new(STATUS_TYPE) if type(owner) is DriverStatus else owner
        for one in (fields, message):
            constants = _constants_by_fields().get(frozenset(one), {}) if isinstance(one, Mapping) else {}
            if name in constants:
                return constants[name]
        raise KeyError(name)

    return get


def _find_class(package: str, kind: str, name: str) -> Any:
    type_name = f"{package}/{name}"
    return type_name if type_name in (_KNOWN if kind == "msg" else SERVICES) else None


def _class_of(kind: str) -> Any:
    return kind if "/" in kind else None


def _new(type_name: Any) -> dict[str, Any]:
    """Returns a message with default values: zeros, empty texts and empty lists."""
    return {field.name: _default(field) for field in _fields(type_name) if not _is_ros2(type_name, field.name)}


def _default(field: Field) -> Any:
    if field.size is not None:
        elements = [_default(field._replace(size=None)) for _ in range(field.size)]
        return bytes_as_text(elements) if field.kind == "uint8" else elements
    return _new(field.kind) if "/" in field.kind else _DEFAULTS.get(field.kind, 0)


def _is_ros2(type_name: str, field: str) -> bool:
    return f" {field}\n" in ROS2_FIELDS.get(type_name, "")


messages = NativeMessages(
    Dialect(_find_class, _fields, _class_of, byte_array=bytes_as_text, new=_new, assign=operator.setitem)
)
"""Looks up types and checks messages, as the adapters of ROS do.

A message class is the name of a type, and a native message is a mapping with all fields of its type.
"""
message_class = messages.message_class


def field_getter(topic: str, type_name: str, field: str) -> Callable[[Any], Any]:
    """Returns a function that reads a field of complete messages; raises ConfigError if there is no such field."""
    return typed_getter(topic, message_class(type_name), _definitions_known(), field)


@functools.lru_cache(maxsize=1000)
def check_type(type_name: str) -> str:
    """Returns a message type as `package/Type` if its definition is known here; empty for types of other packages.

    Raises ConfigError for what is no name of a type, and for a type that a package of `PACKAGES` does not have.
    """
    split = split_type_name(type_name)
    if split is None or split[0] in PACKAGES:
        messages.message_class(type_name)  # raises
    name = canonical_type(type_name)
    return name if name in MESSAGES else ""


def check_field(topic: str, type_name: str, field: str) -> None:
    """Checks a field of a type whose definition is known here; raises ConfigError if there is no such field or type."""
    if check_type(type_name) or canonical_type(type_name) in _KNOWN:
        field_getter(topic, type_name, field)


@functools.lru_cache(maxsize=1000)
def is_number(type_name: str, path: str) -> bool:
    """Returns whether a field is known to be a number, and no bool."""
    try:
        kind = bound_path(_definitions_known(), canonical_type(type_name), parse_field_path(path)).target.kind
    except ValueError:
        return False
    return kind in NUMBERS and kind != "bool"


def complete(type_name: str, message: Message) -> dict[str, Any]:
    """Returns a message with all fields, where its type is known here; raises MessageError if it does not match."""
    known = check_type(type_name)
    completed: dict[str, Any] = messages.to_native(known, message) if known else dict(message)
    return completed


def is_stamped(type_name: str) -> bool:
    """Returns whether messages of a type are known to have a header, and so a stamp."""
    known = check_type(type_name)
    return bool(known) and messages.is_stamped(known)


@functools.lru_cache(maxsize=1000)
def definition(type_name: str) -> str:
    """Returns a type's definition and those of the types it contains, as from `gendeps --cat`; empty if unknown."""
    texts, names, parts = {**MESSAGES, **_ROSGRAPH}, [canonical_type(type_name)], []
    for name in names:  # grows while it runs
        text = texts.get(name, "")
        parts.append(text if name == names[0] else f"{'=' * 80}\nMSG: {name}\n{text}")
        kinds = (field.kind for field in parse_msg(name, text)[name].fields)
        names += dict.fromkeys(kind for kind in kinds if kind in {*MESSAGES} - {*names})
    return "".join(parts)
