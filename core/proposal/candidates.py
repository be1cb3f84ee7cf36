"""The signals that topics can have, from the definitions of their messages, with units where definitions state them."""

from __future__ import annotations

import re
from functools import lru_cache
from itertools import islice
from typing import (
    Any,
    Container,
    Counter,
    Dict,
    Iterable,
    Iterator,
    Mapping,
    NamedTuple,
    Sequence,
    Tuple,
)

from ..config import LINK, read_signal
from ..judge import TICKS
from ..messages import NUMBERS, SEQUENCE, TEXTS, Definitions, Field
from ..port import Middleware
from ..values import (
    ARRAY_TYPE,
    NAME_ARRAYS,
    OWN_TOPICS,
    STATUS_TOPICS,
    STATUS_TYPES,
    TIME_TYPES,
    ConfigError,
    is_own_status,
    resolve_name,
)
from .suggestion import Rules, Signal

OF_MIDDLEWARE = "a topic of the middleware"
"""Why topics that every robot has are not watched."""
MOST_SIGNALS = 300
"""Signals that are looked at: of arrivals first, then of batteries, temperatures and ages; and as many of numbers."""
MOST_FIELDS = 100
"""Numbers of one topic that are looked at; the standard messages have at most 20."""

_LONGEST_NAME = 200
"""Letters of a signal's name, without a number at its end; YAML allows 1,024 in a key."""
_MOST_WALKED = 2_000
_ARRIVALS = ("rate", "statuses", "action", "log")
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
Fields = Dict[Tuple[str, str], str]
"""Why fields are not watched, by their topics and paths."""

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

AGE_RULES = Rules("at most 1 s late, not one message alone", {"warn_above": 1.0, "for_s": 3.0})
_SPREAD_RULES = Rules(
    "3 % and 5 % of a cell's 4 V, longer than a sag under load",
    {"warn_above": 0.12, "error_above": 0.2, "for_s": 10.0},
)
_DEFAULT = "the default thresholds.yaml"
_RULES = {
    (_BATTERY, "cell_voltage"): _SPREAD_RULES,
    (_BATTERY, "percentage"): Rules(
        _DEFAULT, {"warn_below": 20.0, "error_below": 10.0, "hysteresis": 2.0, "for_s": 5.0}
    ),
    (_TEMPERATURE, "temperature"): Rules(_DEFAULT, {"warn_above": 80.0, "error_above": 95.0, "hysteresis": 2.0}),
}


class Topic(NamedTuple):
    """One topic of a recording or of a live robot."""

    topic: str
    """Its absolute name."""
    type_name: str
    """`package/Type`."""
    definitions: Definitions | None
    """The types in its definition; None if that is not known, so that only arrivals can be watched."""


class Names:
    """Gives signals names of letters, digits and `_`, each once."""

    def __init__(self, taken: Iterable[str] = ()) -> None:
        """Starts with names that are taken."""
        self._used: set[str] = set(taken)
        self._names: dict[tuple[str, ...], str] = {}

    def of(self, *words: str) -> str:
        """Returns the name for a topic or a field, which no other one has."""
        if words in self._names:
            return self._names[words]
        name = re.sub(r"[^A-Za-z0-9_]", "_", "_".join((words[0].strip("/"), *words[1:])))[:_LONGEST_NAME]
        if not name or name[0].isdigit() or name == LINK:
            name = f"_{name}"
        unique, number = name, 1
        while unique in self._used:
            number += 1
            unique = f"{name}_{number}"
        self._used.add(unique)
        return self._names.setdefault(words, unique)


class Candidates:
    """The signals that topics can have, which are listened to, in recordings and on live robots alike.

    At most `MOST_SIGNALS` of arrivals and rules, and as many numbers. Signals of kind `given` may be put in `signals`.
    """

    def __init__(self, namespace: str = "", taken: Iterable[str] = (), *, ages_of_bulk: bool = True) -> None:
        """Starts without topics.

        Topics in the namespace (without slashes at its ends) are relative to it. `taken` are names of signals not to
        use. `ages_of_bulk`: stamps of images and clouds can be read without decoding the message.
        """
        self.namespace = namespace
        self.names = Names(taken)
        self.topics: dict[str, str] = {}
        """Types of the topics, by their absolute names."""
        self.signals: dict[str, Signal] = {}
        """By their names; the arrivals of a topic come first."""
        self.not_watched: dict[str, str] = {}
        """Why topics are not looked at, by their names."""
        self.fields: Fields = {}
        self.own_topics: set[str] = {TICKS}
        """Topics that this package's nodes publish, as their statuses say: a monitor is not watched by itself."""
        self._counts: Counter[str] = Counter()
        """Numbers by their topics, all `numbers`, and all `others`."""
        self._ages_of_bulk = ages_of_bulk

    def add(self, topics: Iterable[Topic]) -> None:
        """Adds the signals of topics; topics that were added before are ignored."""
        new: list[Signal] = []
        for each in sorted(topics, key=lambda each: each.topic):
            first = self.topics.get(each.topic)
            if first is not None:
                if first != each.type_name:
                    self.fields[each.topic, f"as {each.type_name}"] = f"it also has {first}"
                continue
            self.topics[each.topic] = each.type_name
            if each.topic in _OF_MIDDLEWARE or each.topic.endswith(_ENDINGS_OF_MIDDLEWARE):
                self.not_watched[each.topic] = OF_MIDDLEWARE
            elif not _NAME.match(each.topic):
                self.not_watched[each.topic] = "its name is not valid in ROS"
            else:
                new += self._of_topic(each)
        for signal in sorted(new, key=_priority):
            if signal.topic in self.not_watched:
                continue
            is_number = _priority(signal) == _NUMBER
            limits = {signal.topic: MOST_FIELDS, "numbers": MOST_SIGNALS} if is_number else {"others": MOST_SIGNALS}
            exceeded = [most for key, most in limits.items() if self._counts[key] >= most]
            if not exceeded:
                self._counts.update(limits.keys())
                self.signals[signal.name] = signal
            elif signal.kind in _ARRIVALS:
                self.not_watched[signal.topic] = f"more than {exceeded[0]} signals"
            else:
                self.fields[signal.topic, signal.given["field"]] = f"more than {exceeded[0]} signals"

    def begin_recording(self) -> None:
        """Ends the previous recording: the time up to the next one is no gap."""
        for signal in self.signals.values():
            signal.measured.begin_recording()

    def listen(self, node: Middleware, topics: Container[str]) -> None:
        """Subscribes to topics, by their absolute names; a signal that cannot be subscribed is left out."""
        for name, signal in list(self.signals.items()):
            if signal.topic in topics and signal.kind != "action":
                try:
                    # A candidate is listened to by a node in any namespace.
                    place = {} if signal.kind == "given" else {"topic": signal.topic}
                    signal.measured.config = read_signal(name, {**signal.given, **place})
                    signal.measured.listen(node)
                    if signal.kind == "statuses":
                        node.subscribe(signal.topic, ARRAY_TYPE, self._note_own_topics)
                except ConfigError as error:
                    if signal.kind == "given":
                        raise
                    del self.signals[name]
                    self.fields[signal.topic, signal.given["field"]] = error.problem

    @property
    def samples(self) -> int:
        """Messages that were heard until now."""
        return sum(each.measured.samples for each in self.signals.values() if each.kind in ("rate", "statuses"))

    @property
    def statuses(self) -> list[tuple[str, str]]:
        """The drivers' statuses that are watched: the name of a signal, and the name of the status."""
        signals = [each for each in self.signals.values() if each.kind == "statuses"]
        return [(each.name, status) for each in signals for status in each.measured.elements]

    def _note_own_topics(self, message: Any, now_s: float) -> None:
        for status in message["status"]:
            values = {pair["key"]: pair["value"] for pair in status["values"]}
            if OWN_TOPICS in values and is_own_status(status["name"], values):
                self.own_topics.update(values[OWN_TOPICS].split(", "))

    def _of_topic(self, topic: Topic) -> Iterator[Signal]:
        """Yields the signals of one topic; goals, the drivers' statuses and the log have one."""
        short = relative(topic.topic, self.namespace)
        action = next((short[: -len(end)] for end in STATUS_TOPICS if short.endswith(end)), "")
        if topic.type_name in STATUS_TYPES and action:
            given = {"action": action, "statistic": "mean", "window_s": 1200.0, "window_min_s": 0.0}
            yield Signal(self.names.of(action, "goals"), topic.topic, "action", given)
        elif topic.type_name == _DIAGNOSTICS:
            yield self._signal(topic, "statuses", 'status["*"]')
        elif topic.type_name in _LOGS:
            yield self._signal(topic, "log", "", "errors", where=_ERRORS, statistic="count", window_s=60.0)
        else:
            yield self._signal(topic, "rate", "", "rate", statistic="frequency_hz")
            if topic.type_name not in _FRAMES or topic.topic.endswith("_static"):
                yield from self._of_fields(topic)
            else:
                yield self._signal(topic, "frames", 'transforms["*"].header.stamp', rules=AGE_RULES, unit="s")

    def _of_fields(self, topic: Topic) -> Iterator[Signal]:
        """Yields the signals of the fields of a topic, and notes those that have none."""
        fields = list(islice(_walk(topic.definitions or {}, topic.type_name), _MOST_WALKED))
        if topic.definitions is None:
            self.fields[topic.topic, "its fields"] = "the definition of its type is not known"
        is_bulk, has_names = _is_bulk(topic.type_name, fields), any(map(_is_names, fields))
        for path, field, unit in fields:
            reason = _why_no_number(topic.type_name, field, is_bulk=is_bulk)
            if path == "header" and field.kind == _HEADER:
                if self._ages_of_bulk or not is_bulk:
                    yield self._signal(topic, "age", "header.stamp", "age", rules=AGE_RULES, unit="s")
            elif reason:
                self.fields[topic.topic, path] = reason
            elif has_names and "." not in path and field.size == SEQUENCE and field.kind in ("float32", "float64"):
                yield self._signal(topic, "elements", f'{path}["*"]', path)
            else:
                yield from self._numbers(topic, path, field, unit)

    def _numbers(self, topic: Topic, path: str, field: Field, unit: str) -> Iterator[Signal]:
        """Yields the signals of a number or of an array of numbers."""
        words = () if path == "data" else (path,)
        rules = _RULES.get((topic.type_name, path))
        if field.size is None:
            yield self._signal(topic, "number", path, *words, rules=rules, unit=unit)
        elif rules is _SPREAD_RULES:
            yield self._signal(topic, "number", f"{path}[*]", "cell_spread", rules=rules, reduce="spread", unit="V")
        else:
            for reduce in ("min", "max"):
                yield self._signal(topic, "number", f"{path}[*]", *words, reduce, reduce=reduce, unit=unit)

    def _signal(
        self, topic: Topic, kind: str, field: str, *words: str, rules: Rules | None = None, **settings: Any
    ) -> Signal:
        short = relative(topic.topic, self.namespace)
        settings = {key: value for key, value in settings.items() if value}
        given = {"topic": short, "type": topic.type_name, "field": field, **settings}
        return Signal(self.names.of(short, *words), topic.topic, kind, given, rules)


def relative(name: str, namespace: str) -> str:
    """Returns an absolute name as it is written in a namespace, which has no slashes at its ends."""
    prefix = f"/{namespace}/" if namespace else "/"
    is_inside = name.startswith(prefix) and not name[len(prefix) :][0].isdigit()  # `2d` is no name
    return name[len(prefix) :] if is_inside else name


def absolute(name: str, namespace: str) -> str:
    """Returns a name in a namespace, which has no slashes at its ends, as an absolute one."""
    return resolve_name(name, f"/{namespace}/alert_system" if namespace else "/alert_system")


def _priority(signal: Signal) -> int:
    return 0 if signal.kind in _ARRIVALS else 1 if signal.rules else _NUMBER


def _walk(
    definitions: Definitions, type_name: str, prefix: str = "", above: tuple[tuple[str, int], ...] = ()
) -> Iterator[tuple[str, Field, str]]:
    """Yields path, field and unit of the fields of a type and of the messages in it, in place of these."""
    above = (*above, (type_name, len(prefix)))
    definition = definitions.get(type_name)
    for field in definition.fields if definition else ():
        path = f"{prefix}{field.name}"
        unit = next(filter(None, (_units().get((each, path[at:]), "") for each, at in above)), "")
        if "/" not in field.kind or field.size is not None or field.kind in (_HEADER, *_TIMES):
            yield path, field, unit
        elif len(above) < _DEEPEST:
            yield from _walk(definitions, field.kind, f"{path}.", above)


@lru_cache(maxsize=None)
def _units() -> Mapping[tuple[str, str], str]:
    """Returns the units by type and field."""
    units: dict[tuple[str, str], str] = {}
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
        return "times and arrays of messages"
    if is_bulk:
        return "a block of bytes, or beside one: not read"
    if field.kind == "bool":
        return "flags"
    is_code = package == "sensor_msgs" or name in ("Byte", "Char", "ByteMultiArray") or field.size is not None
    return "8 bits: a state or a code" if field.kind in _EIGHT_BITS and is_code else ""


def _is_bulk(type_name: str, fields: Sequence[tuple[str, Field, str]]) -> bool:
    """Returns whether a message is an image, a cloud or another block of bytes."""
    return type_name in _CLOUDS or any(field.kind in _EIGHT_BITS and field.size == SEQUENCE for _, field, _ in fields)


def _is_names(entry: tuple[str, Field, str]) -> bool:
    """Returns whether a field has the names of the elements of arrays beside it, as in a JointState."""
    path, field, _ = entry
    return path in NAME_ARRAYS and field.kind in TEXTS and field.size is not None
