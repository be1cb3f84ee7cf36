"""The signals that topics can have, from the definitions of their messages, with units where definitions state them."""

from __future__ import annotations

import re
from functools import lru_cache
from typing import Any, Collection, Dict, Iterable, Iterator, List, Mapping, NamedTuple, Optional, Sequence, Set, Tuple

from ..config.signal_config import LINK
from ..messages.definitions import NUMBERS, SEQUENCE, TEXTS, Definitions, Field
from ..values.elements import NAME_ARRAYS, TIME_TYPES
from ..values.formatting import list_text
from ..values.goals import STATUS_TOPICS, STATUS_TYPES
from .suggestion import NO_RULES, Rules

OF_MIDDLEWARE = "a topic of the middleware"
"""Why topics that every robot has are not watched."""
MOST_SIGNALS = 300
"""Signals that are looked at: arrivals of all topics first, then batteries, temperatures and ages, then numbers."""
MOST_FIELDS = 100
"""Numbers of one topic that are looked at; the standard messages have at most 20."""

_LONGEST_NAME = 200
"""Letters of a signal's name; YAML allows 1,024 in a key."""
_MOST_WALKED = 2_000
_NUMBER = 2
"""Lowest priority of signals."""
_DEEPEST = 16
_OF_MIDDLEWARE = ("/clock", "/rosout_agg", "/parameter_events", "/client_count", "/connected_clients")
_ERRORS = 'level >= ERROR and name != "*alert_system"'
"""The alerts of this monitor are errors in the log too."""
_ENDINGS_OF_MIDDLEWARE = ("/_action/feedback", "/_executor_probe")
_NAME = re.compile(r"/[A-Za-z_]\w*(/\w+)*\Z", re.ASCII)
_DIAGNOSTICS = "diagnostic_msgs/DiagnosticArray"
_HEADER = "std_msgs/Header"
_BATTERY = "sensor_msgs/BatteryState"
_TEMPERATURE = "sensor_msgs/Temperature"
_CLOUDS = ("sensor_msgs/PointCloud",)
_FRAMES = ("tf2_msgs/TFMessage", "tf/tfMessage")
_LOGS = ("rosgraph_msgs/Log", "rcl_interfaces/Log")

_TIMES = (*TIME_TYPES, "builtin_interfaces/Duration")

_EIGHT_BITS = ("uint8", "int8", "byte", "char")
_ENDS = ("min", "max")
"""What an array of numbers is reduced to: two signals."""
_OF_ITS_FIELDS = "a message, whose fields are looked at"

_UNITS = """
sensor_msgs/BatteryState voltage=V temperature=degC current=A charge=Ah capacity=Ah design_capacity=Ah
sensor_msgs/Temperature temperature=degC
sensor_msgs/FluidPressure fluid_pressure=Pa
sensor_msgs/Illuminance illuminance=lx
sensor_msgs/Range range=m min_range=m max_range=m field_of_view=rad
sensor_msgs/NavSatFix latitude=deg longitude=deg altitude=m
sensor_msgs/Imu angular_velocity.xyz=rad/s linear_acceleration.xyz=m/s^2
sensor_msgs/MagneticField magnetic_field.xyz=T
geometry_msgs/Twist linear.xyz=m/s angular.xyz=rad/s
geometry_msgs/Pose position.xyz=m
geometry_msgs/Transform translation.xyz=m
geometry_msgs/Accel linear.xyz=m/s^2 angular.xyz=rad/s^2
geometry_msgs/Wrench force.xyz=N torque.xyz=Nm
"""
"""Units that the definitions of the messages state, and REP-103 for geometry_msgs; `.xyz` stands for three fields."""

FRACTIONS = ((_BATTERY, "percentage"), ("sensor_msgs/RelativeHumidity", "relative_humidity"))
"""Fields that are 0 to 1 by definition, shown in %."""

_AGE = "rule: at most 1 s late"
AGE_RULES: Rules = {
    "warn_above": (1.0, _AGE),
    "for_s": (3.0, "a stamp that stands still, not one late message"),
}
_CHARGE_RULES: Rules = {
    "warn_below": (20.0, "rule: the default thresholds.yaml"),
    "error_below": (10.0, "rule: the default thresholds.yaml"),
    "hysteresis": (2.0, "rule: the default thresholds.yaml"),
    "for_s": (5.0, "a sag under load is no alert"),
}
_TEMPERATURE_RULES: Rules = {
    "warn_above": (80.0, "rule: the default thresholds.yaml"),
    "error_above": (95.0, "rule: the default thresholds.yaml"),
    "hysteresis": (2.0, "rule: the default thresholds.yaml"),
}
_SPREAD_RULES: Rules = {
    "warn_above": (0.12, "rule: 3 % of a cell's 4 V"),
    "error_above": (0.2, "rule: 5 % of a cell's 4 V"),
    "for_s": (10.0, "a sag under load is no alert"),
}


class Topic(NamedTuple):
    """One topic of a recording or of a live robot."""

    topic: str
    """Its absolute name."""
    type_name: str
    """`package/Type`."""
    definitions: Optional[Definitions]
    """The types in its definition; None: it is not known, so that only arrivals can be watched."""


class Candidate(NamedTuple):
    """One signal that a topic can have."""

    name: str
    topic: str
    """The absolute name."""
    kind: str
    """`rate`, `age`, `statuses`, `action`, `log`, `frames` and `elements` (each is measured by itself) or `number`."""
    settings: Mapping[str, Any]
    """Topic relative to the namespace, type, field, statistic and, where the definition has one, unit."""
    rules: Rules = NO_RULES


class Names:
    """Gives signals names of letters, digits and `_`, each once."""

    def __init__(self, taken: Iterable[str] = ()) -> None:
        """Starts with names that are taken."""
        self._used: Set[str] = set(taken)

    def new(self, *words: str) -> str:
        """Returns a name for a topic or a field that has not been returned before."""
        ending = "".join(f"_{word}" for word in words[1:])[:_LONGEST_NAME]
        text = words[0].strip("/")[: _LONGEST_NAME - len(ending)] + ending
        name = re.sub(r"[^A-Za-z0-9_]", "_", text)
        if not name or name[0].isdigit() or name == LINK:
            name = f"_{name}"
        unique, number = name, 1
        while unique in self._used:
            number += 1
            unique = f"{name}_{number}"
        self._used.add(unique)
        return unique


class Listing(NamedTuple):
    """What topics offer."""

    candidates: Sequence[Candidate]
    """Sorted by topic; the arrivals of a topic come first."""
    left_out: Mapping[str, str]
    """Why topics are not looked at, by their names."""
    fields: Mapping[str, Mapping[str, Sequence[str]]]
    """Fields that are not looked at, by the names of topics and the reasons."""
    problems: Sequence[str]
    """One line for each topic of which something is left out."""


def list_candidates(
    topics: Iterable[Topic],
    namespace: str = "",
    names: Optional[Names] = None,
    *,
    ages_of_bulk: bool = True,
    before: Collection[Candidate] = (),
) -> Listing:
    """Returns the signals that topics can have, at most `MOST_SIGNALS`.

    Topics in the namespace (without slashes at its ends) are relative to it. `ages_of_bulk`: stamps of images and
    clouds can be read without decoding the message. `before` are those of topics that were listed before: they count,
    but their numbers take no place from arrivals.
    """
    names = names or Names()
    left_out: Dict[str, str] = {}
    problems: List[str] = []
    known: Dict[str, Topic] = {}
    for each in sorted(topics, key=lambda each: each.topic):
        if each.topic in _OF_MIDDLEWARE or each.topic.endswith(_ENDINGS_OF_MIDDLEWARE):
            left_out[each.topic] = OF_MIDDLEWARE
        elif not _NAME.match(each.topic):
            left_out[each.topic] = "its name is not valid in ROS"
        elif each.topic in known:
            first = known[each.topic].type_name
            if first != each.type_name:
                problems.append(f"{each.topic}: {each.type_name} left out, it also has {first}")
        else:
            known[each.topic] = each
    found: List[Tuple[int, int, Candidate]] = []
    fields: Dict[str, Dict[str, List[str]]] = {}
    for at, topic in enumerate(known.values()):
        others = fields.setdefault(topic.topic, {})
        of_topic = list(_of_topic(topic, namespace, names, others, ages_of_bulk=ages_of_bulk))
        numbers = [each for each in of_topic if each.kind == "number"]
        if len(numbers) > MOST_FIELDS:
            problems.append(f"{topic.topic}: expected at most {MOST_FIELDS} numbers, got more: the rest is left out")
            of_topic = [each for each in of_topic if each.kind != "number"] + numbers[:MOST_FIELDS]
        found += [(_priority(each), at, each) for each in of_topic]
    found.sort(key=lambda each: each[:2])
    arrivals = sum(priority < _NUMBER for priority, _, _ in found)
    room = MOST_SIGNALS - sum(_priority(each) < _NUMBER for each in before)
    most = max(0, min(room, max(arrivals, MOST_SIGNALS - len(before))))
    kept, rest = found[:most], found[most:]
    looked_at = {each.topic for _, _, each in kept}
    for _, _, candidate in rest:
        if candidate.topic not in looked_at:
            left_out[candidate.topic] = f"more than {MOST_SIGNALS} signals"
    cut = sorted({each.topic for _, _, each in rest} & looked_at)
    if cut:
        problems.append(f"more than {MOST_SIGNALS} signals: numbers are left out of {list_text(cut)}")
    kept.sort(key=lambda each: (each[1], each[0]))
    fields = {name: reasons for name, reasons in fields.items() if reasons}
    return Listing([each for _, _, each in kept], left_out, fields, problems)


def relative(name: str, namespace: str) -> str:
    """Returns an absolute name as it is written in a namespace, which has no slashes at its ends."""
    prefix = f"/{namespace}/" if namespace else "/"
    return name[len(prefix) :] if name.startswith(prefix) else name


def _priority(candidate: Candidate) -> int:
    return 0 if candidate.kind in ("rate", "statuses", "action", "log") else 1 if candidate.rules else _NUMBER


def _of_topic(
    topic: Topic, namespace: str, names: Names, others: Dict[str, List[str]], *, ages_of_bulk: bool
) -> Iterator[Candidate]:
    """Yields the signals of one topic; `others` receives its other fields by the reasons."""
    only = _only_signal(topic, relative(topic.topic, namespace), names)
    if only is not None:
        yield only
        return
    short = relative(topic.topic, namespace)
    short = topic.topic if short[0].isdigit() else short  # `2d` is no name

    def candidate(kind: str, field: str, *words: str, rules: Rules = NO_RULES, **settings: Any) -> Candidate:
        base = {"topic": short, "type": topic.type_name, "field": field, **settings}
        return Candidate(names.new(short, *words), topic.topic, kind, base, rules)

    definitions = topic.definitions
    fields = list(_walk(definitions, topic.type_name)) if definitions is not None else []
    is_bulk = _is_bulk(topic.type_name, fields)
    named = _named_arrays(topic, fields)
    watched = [*named, "cell_voltage"] if topic.type_name == _BATTERY else list(named)  # by the spread of the cells
    numbers = _numbers(topic, fields, watched, others, is_bulk=is_bulk)
    yield candidate("rate", "", "rate", statistic="frequency_hz")
    has_header = any(path == "header" and field.kind == _HEADER for path, field, _ in fields)
    if has_header and (ages_of_bulk or not is_bulk):
        yield candidate("age", "header.stamp", "age", rules=AGE_RULES, unit="s")
    for path, field, unit in numbers:
        if field.size is not None:
            continue
        rules = _CHARGE_RULES if (topic.type_name, path) == FRACTIONS[0] else NO_RULES
        rules = _TEMPERATURE_RULES if (topic.type_name, path) == (_TEMPERATURE, "temperature") else rules
        words = () if path == "data" else (path,)
        yield candidate("number", path, *words, rules=rules, **({"unit": unit} if unit else {}))
    if topic.type_name == _BATTERY:
        settings = {"reduce": "spread", "unit": "V"}
        yield candidate("number", "cell_voltage[*]", "cell_spread", rules=_SPREAD_RULES, **settings)
    for path, kind in named.items():
        if kind == "frames":
            yield candidate(kind, f'{path}["*"].header.stamp', rules=AGE_RULES, unit="s")
        else:
            yield candidate(kind, f'{path}["*"]', path)
    for path, unit, reduce in [(path, unit, each) for path, field, unit in numbers if field.size for each in _ENDS]:
        ends = (reduce,) if path == "data" else (path, reduce)
        ends_of: Dict[str, Any] = {"reduce": reduce, **({"unit": unit} if unit else {})}
        yield candidate("number", f"{path}[*]", *ends, **ends_of)


def _only_signal(topic: Topic, short: str, names: Names) -> Optional[Candidate]:
    """Returns the signal of a topic that has no other one: the goals of an action, the drivers' statuses, the log."""
    settings: Dict[str, Any] = {"topic": topic.topic, "type": topic.type_name}
    action = next((short[: -len(end)] for end in STATUS_TOPICS if short.endswith(end)), "")
    if topic.type_name in STATUS_TYPES and action:
        settings = {"action": action, "statistic": "mean", "window_s": 1200.0, "window_min_s": 0.0}
        return Candidate(names.new(action, "goals"), topic.topic, "action", settings)
    if topic.type_name == _DIAGNOSTICS:
        settings["field"] = 'status["*"]'
        return Candidate(names.new(topic.topic), topic.topic, "statuses", settings)
    if topic.type_name in _LOGS:
        settings.update(field="", where=_ERRORS, statistic="count", window_s=60.0)
        return Candidate(names.new(topic.topic, "errors"), topic.topic, "log", settings)
    return None


def _numbers(
    topic: Topic,
    fields: Sequence[Tuple[str, Field, str]],
    watched: Sequence[str],
    others: Dict[str, List[str]],
    *,
    is_bulk: bool,
) -> List[Tuple[str, Field, str]]:
    """Returns the fields that are numbers or arrays of numbers, apart from `watched` and those of the header."""
    numbers = []
    for path, field, unit in fields:
        reason = _why_no_number(topic.type_name, field, is_bulk=is_bulk)
        if path in watched or path.split(".")[0] == "header" or reason == _OF_ITS_FIELDS:
            continue
        if reason:
            others.setdefault(reason, []).append(path)
        else:
            numbers.append((path, field, unit))
    if topic.definitions is None:
        others["the definition of its type is not known"] = ["its fields"]
    return numbers


def _walk(definitions: Definitions, type_name: str) -> Iterator[Tuple[str, Field, str]]:
    """Yields path, field and unit of the fields of a type and of the messages in it, at most `_MOST_WALKED`."""
    waiting: List[Tuple[str, str, Tuple[Tuple[str, int], ...]]] = [("", type_name, ())]
    walked = 0
    while waiting and walked < _MOST_WALKED:
        prefix, kind, above = waiting.pop(0)
        above = (*above, (kind, len(prefix)))
        definition = definitions.get(kind)
        nested = []
        for field in definition.fields if definition else ():
            walked += 1
            path = f"{prefix}{field.name}"
            unit = next(filter(None, (_units().get((each, path[at:]), "") for each, at in above)), "")
            yield path, field, unit
            is_message = "/" in field.kind and field.size is None
            if is_message and field.kind != _HEADER and field.kind not in _TIMES and len(above) < _DEEPEST:
                nested.append((f"{path}.", field.kind, above))
        waiting[:0] = nested


@lru_cache(maxsize=None)
def _units() -> Mapping[Tuple[str, str], str]:
    """Returns the units by type and field."""
    units: Dict[Tuple[str, str], str] = {}
    for type_name, *fields in filter(None, map(str.split, _UNITS.splitlines())):
        for path, _, unit in (field.partition("=") for field in fields):
            units.update({(type_name, path.replace(".xyz", f".{axis}")): unit for axis in "xyz"})
    return units


def _why_no_number(type_name: str, field: Field, *, is_bulk: bool) -> str:
    """Returns why a field is no number to watch, and no array of numbers; empty if it is one."""
    package, _, name = type_name.partition("/")
    if field.kind in TEXTS:
        return "text"
    if field.kind not in NUMBERS and field.kind not in _EIGHT_BITS:
        return _OF_ITS_FIELDS if field.size is None and field.kind not in _TIMES else "times and arrays of messages"
    if is_bulk:
        return "a block of bytes, or beside one: not read"
    if field.kind == "bool":
        return "flags"
    is_code = package == "sensor_msgs" or name in ("Byte", "Char", "ByteMultiArray") or field.size is not None
    return "8 bits: a state or a code" if field.kind in _EIGHT_BITS and is_code else ""


def _is_bulk(type_name: str, fields: Sequence[Tuple[str, Field, str]]) -> bool:
    """Returns whether a message is an image, a cloud or another block of bytes."""
    return type_name in _CLOUDS or any(field.kind in _EIGHT_BITS and field.size == SEQUENCE for _, field, _ in fields)


def _named_arrays(topic: Topic, fields: Sequence[Tuple[str, Field, str]]) -> Mapping[str, str]:
    """Returns the kind of the arrays whose elements have names: transforms by their frames, if these are not static.

    Otherwise arrays of numbers that have names in an array beside them, as in a JointState.
    """
    if topic.type_name in _FRAMES and not topic.topic.endswith("_static"):
        return {"transforms": "frames"}
    top = {path: field for path, field, _ in fields if "." not in path}
    if not any(name in top and top[name].kind in TEXTS and top[name].size is not None for name in NAME_ARRAYS):
        return {}
    arrays = [name for name, field in top.items() if field.size == SEQUENCE and field.kind in ("float32", "float64")]
    return dict.fromkeys(arrays, "elements")
