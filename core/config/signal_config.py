"""Configuration of one signal: its keys, as one table, and the checks that they do not contradict one another.

The fields of `SignalConfig` are the table: a line there is enough for a new key. Every error names the key's path.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import product
from typing import Any, Dict, Iterator, Mapping, Optional, Sequence, Tuple

from ..values import (
    ARRAY_TYPE,
    COMPARE,
    REDUCTIONS,
    STATUS_TOPICS,
    STATUS_TYPE,
    ConfigError,
    Every,
    JsonObject,
    Keyed,
    Path,
    bound_text,
    canonical_type,
    describe,
    every_step,
    list_text,
    number_text,
    parse_field_path,
    parse_where,
    selection,
    split_type_name,
)
from .schema import REQUIRED, declared, keys, parameters, read_section

LINK = "link"
"""Name of the signal that is 1 while a robot can be reached, else 0. Reserved; conditions may refer to it."""

STATISTICS = ("last", "mean", "min", "max", "stddev", "rate", "frequency_hz", "largest_gap_s", "count", "forecast")
"""Statistics to which bounds can apply."""

_IN_UNIT = ("last", "mean", "min", "max")
"""Statistics in the unit of the signal, and within its valid range."""

OF_ARRIVALS = ("frequency_hz", "largest_gap_s", "count")
"""Statistics of the times of arrival, whatever the values are."""

BOUNDS = ("warn_below", "warn_above", "error_below", "error_above")

GRAPH_KEYS = ("node", "publishers", "subscribers", "lifecycle")
"""Keys in place of `topic`: what is counted in the robot's graph of nodes, or the state of a node in it."""

ACTIVE = 3.0
"""The id of the state `active` in lifecycle_msgs/State."""

MOST_FORECAST_WINDOWS = 3
"""Largest `forecast_s`, in lengths of the window."""

LONGEST_ADVICE = 500
"""Most characters of `what_to_do`."""

LONGEST_NAME = 120
"""Most characters of the name of an element's signal, `drivers[motor_driver: left]`."""

LONGEST_TEMPLATE_NAME = 60
"""Most characters of the name of a signal whose elements are signals: theirs begin with it."""

LONGEST_S = 365.0 * 86_400.0
"""Longest duration in a configuration, in s: a year. Prometheus refuses much longer ones."""

_TIME_FIELDS = (("std_msgs/Time", "data"), ("sensor_msgs/TimeReference", "time_ref"), ("rosgraph_msgs/Clock", "clock"))
"""Type and name of fields that are times, whatever their name says."""

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*\Z")

Mistakes = Iterator[Tuple[str, str]]
"""Key and problem of values that cannot be used; see `read_section`."""


@dataclass(frozen=True)
class Condition:
    """A condition on the latest value of another signal: one comparison, whose numbers are in its unit."""

    CHECKS_WHOLE = True

    signal: str = declared(REQUIRED, "name of the other signal")
    is_: Optional[float] = declared(None, "true while the other signal equals this value, in its unit")
    is_not: Optional[float] = declared(None, "true while the other signal differs from this value, in its unit")
    below: Optional[float] = declared(None, "true while the other signal is below this value, in its unit")
    above: Optional[float] = declared(None, "true while the other signal is above this value, in its unit")
    between: Optional[Tuple[float, ...]] = declared(
        None, "true while the other signal lies between these two values or equals one"
    )

    def mistakes(self, given: JsonObject) -> Mistakes:
        """Yields key and problem of values that cannot be used; see `read_section`."""
        comparisons = list(self.settings)[1:]
        if len(comparisons) != 1:
            names = ", ".join(each.name for each in CONDITION_PARAMETERS[1:])
            yield "", f"expected one of {names}, got {' and '.join(comparisons) or 'none'}"
        elif self.between is not None and (len(self.between) != 2 or self.between[0] > self.between[1]):
            got = list_text(list(map(bound_text, self.between)), 5)
            yield "between", f"expected two numbers, the smaller one first, got [{got}]"

    def __str__(self) -> str:
        return self.text(holds=True)

    @property
    def settings(self) -> JsonObject:
        """The keys that are set, with their values."""
        values = {each.name: getattr(self, each.field) for each in CONDITION_PARAMETERS}
        return {name: value for name, value in values.items() if value is not None}

    def text(self, *, holds: bool) -> str:
        """Returns the condition in words, or its opposite."""
        ((_, signal), (comparison, number)) = self.settings.items()
        verb = "is" if holds is (comparison != "is_not") else "is not"
        side = "" if comparison in ("is", "is_not") else f" {comparison}"
        return f"{signal} {verb}{side} {' and '.join(map(bound_text, self.between or (number,)))}"

    def holds(self, value: float) -> bool:
        """Returns whether the condition is true for this value of the other signal."""
        low, high = self.between or (None, None)
        compared = (
            ("==", self.is_),
            ("!=", self.is_not),
            ("<", self.below),
            (">", self.above),
            (">=", low),
            ("<=", high),
        )
        return all(COMPARE[operator](value, number) for operator, number in compared if number is not None)


CONDITION_PARAMETERS = parameters(Condition)
"""Keys of a condition on another signal: the signal and one comparison."""


def _duration(default: Optional[float], description: str, least_s: float = 0.0) -> Any:
    return declared(default, description, least_s, LONGEST_S)


@dataclass(frozen=True)
class SignalConfig:
    """One signal: its source and its rules.

    This is the table of keys: type, default, description, smallest and largest value. Where the type is not optional,
    None becomes the default that follows from other keys.
    """

    CHECKS_WHOLE = True

    name: str
    topic: str = declared(None, "topic of the signal; left out: the signal's name")
    node: str = declared("", "in place of topic: name of nodes, which are counted; * and ? match as in file names")
    publishers: str = declared("", "in place of topic: topic whose publishers are counted; * and ? match")
    subscribers: str = declared("", "in place of topic: topic whose subscribers are counted; * and ? match")
    lifecycle: str = declared("", "in place of topic: node whose lifecycle state is read; ERROR unless it is active")
    action: str = declared("", "in place of topic: name of an action; per goal that ended 0 succeeded, 1 aborted")
    type: str = declared("", "message type, such as std_msgs/Float32; left out: the type that is published")
    field: str = declared("data", "path of the number in the message; empty: count arrivals, the value is 1")
    where: str = declared(
        "", 'condition on a message, only then a sample: level >= ERROR and name == "*controller*"; left out: none'
    )
    reduce: str = declared(
        "",
        "how all elements that the field selects become one value; left out: each is a signal of its own",
        choices=("", *REDUCTIONS),
    )
    scale: float = declared(1.0, "factor that converts the number to the unit")
    unit: str = declared("", "unit of the value, for display and plausibility checks")
    placeholders: Tuple[float, ...] = declared((), "numbers that mean 'not measured', before scaling: invalid data")
    valid_min: Optional[float] = declared(None, "smallest valid value, in the unit; below it the data is invalid")
    valid_max: Optional[float] = declared(None, "largest valid value, in the unit; above it the data is invalid")
    invalid_for_s: float = _duration(0.0, "time for which data must be invalid before it is an ERROR, in s")
    window_s: float = _duration(
        None, "length of the window for statistics, in s; left out: 60, 600 for a forecast", 0.001
    )
    window_min_s: float = _duration(
        None,
        "time for which samples must come before statistics other than last are defined, in s; left out: window_s / 2, "
        "window_s for a forecast; not for a count",
    )
    window_samples: int = declared(
        None, "maximum number of samples in the window; left out: 6000, 100000 for a forecast", 1, 1_000_000
    )
    statistic: str = declared("last", "statistic of the window to which the bounds apply", choices=STATISTICS)
    forecast_s: Optional[float] = _duration(None, "time from the newest sample to the forecast, in s", 0.001)
    warn_below: Optional[float] = declared(None, "WARN below this value, in the unit of the statistic")
    warn_above: Optional[float] = declared(None, "WARN above this value, in the unit of the statistic")
    error_below: Optional[float] = declared(None, "ERROR below this value, in the unit of the statistic")
    error_above: Optional[float] = declared(None, "ERROR above this value, in the unit of the statistic")
    hysteresis: float = declared(
        0.0, "distance from a bound at which its alert clears, in the unit of the statistic", 0.0
    )
    for_s: float = _duration(0.0, "time for which a bound must be crossed before the alert fires, in s")
    keep_firing_for_s: float = _duration(0.0, "time after the bound is no longer crossed until it clears, in s")
    error_for_s: float = _duration(None, "for_s of the ERROR bounds, in s; left out: for_s")
    error_keep_firing_for_s: float = _duration(
        None, "keep_firing_for_s of the ERROR bounds, in s; left out: keep_firing_for_s"
    )
    latch: bool = declared(False, "keep the worst level that fired until reset")
    flap_detection: bool = declared(False, "announce a signal that changes too often once, not at each change")
    flap_high: float = declared(50.0, "state change at which flapping begins, in %", 0.0, 100.0)
    flap_low: float = declared(25.0, "state change below which flapping ends, in %", 0.0, 100.0)
    stale_after_s: float = _duration(
        None, "time without a sample after which it is STALE, in s; 0: never; left out: 5, 0 for an action or a count"
    )
    startup_grace_s: float = _duration(10.0, "stale_after_s before the first sample, in s")
    max_elements: int = declared(200, "maximum number of elements that are signals of their own", 1, 10_000)
    forget_after_s: float = _duration(
        0.0, "time without a sample after which an element is no longer watched, in s; 0: never"
    )
    repeat_s: float = _duration(0.0, "interval of repeated announcements while not OK, in s; 0: none")
    depends_on: Tuple[str, ...] = declared(
        (), "signals, elements or topics without which its own alerts have a known cause: they are not announced"
    )
    what_to_do: str = declared(
        "", "what to do when it alerts: one line, or the address of a page", None, LONGEST_ADVICE
    )
    only_if: Optional[Condition] = declared(
        None, "the bounds apply only while this holds or the other signal is unknown"
    )
    latch_release_if: Optional[Condition] = declared(None, "a latch is released while this holds, as by `reset`")

    def __post_init__(self) -> None:
        for key, default in self._defaults().items():
            if getattr(self, key) is None:
                object.__setattr__(self, key, default)
        if not self.unit and self.reduce != "count" and _is_time(self.type, self.field):
            object.__setattr__(self, "unit", "s")

    def _defaults(self) -> JsonObject:
        """Returns the keys whose default follows from others."""
        is_forecast, is_count, is_of_graph = self.statistic == "forecast", self.statistic == "count", bool(self.graph)
        window_s = self.window_s or (600.0 if is_forecast else 60.0)
        bounds: Dict[str, float] = {}
        if self.lifecycle:
            bounds = {"error_below": ACTIVE, "error_above": ACTIVE}
        elif is_of_graph and not self.bounds:
            bounds = {"error_below": 1.0}
        return {
            "topic": "" if is_of_graph else self.action or self.name,
            "stale_after_s": 0.0 if self.action or is_count else 5.0,
            "window_s": window_s,
            "window_min_s": window_s if is_forecast else 0.0 if is_count else window_s / 2.0,
            "window_samples": 100_000 if is_forecast else 6000,
            "error_for_s": self.for_s,
            "error_keep_firing_for_s": self.keep_firing_for_s,
            **bounds,
        }

    def mistakes(self, given: JsonObject) -> Mistakes:
        """Yields key and problem of each value that cannot be used, or contradicts another; see `read_section`."""
        for names, problem in _keys_to_remove(self):
            yield from ((key, problem) for key in names if given.get(key) not in (None, getattr(SignalConfig, key)))
        yield from _mistakes_of_names(self, given)
        yield from _mistakes_of_paths(self, given)
        if self.scale == 0.0:
            yield "scale", "expected a number other than 0, got 0"
        if self.is_template and 0.0 < self.forget_after_s <= self.stale_after_s:
            expected = f"expected more than stale_after_s ({bound_text(self.stale_after_s)})"
            why = "an element would end before its silence is announced"
            yield "forget_after_s", f"{expected}, got {bound_text(self.forget_after_s)}: {why}"
        yield from _mistakes_of_forecast(self)
        yield from _mistakes_of_bounds(self, given)

    @property
    def is_template(self) -> bool:
        """Whether every element of its field is a signal of its own, with this configuration."""
        return not self.reduce and self.name == template_name(self.name) and every_step(self.field) is not None

    @property
    def is_status(self) -> bool:
        """Whether the field is known to be a DiagnosticStatus as a whole; without a type, by the name of its array."""
        try:
            steps = parse_field_path(self.field)
        except ValueError:
            return False
        if self.reduce or not steps or not isinstance(steps[-1], (Keyed, Every)):
            return False
        type_name = canonical_type(self.type)
        if len(steps) == 1:
            return type_name == STATUS_TYPE
        return steps[:-1] == ("status",) and type_name in ("", ARRAY_TYPE)

    @property
    def graph(self) -> Optional[Tuple[str, str]]:
        """The key of the robot's graph that it has in place of `topic`, and its name; None if it has a topic."""
        return next(((key, getattr(self, key)) for key in GRAPH_KEYS if getattr(self, key)), None)

    @property
    def topics(self) -> Tuple[str, ...]:
        """The topics that bring its samples: of an action those of ROS 2 and of ROS 1; none of the robot's graph."""
        if self.graph is not None:
            return ()
        return tuple(self.action.rstrip("/") + end for end in STATUS_TOPICS) if self.action else (self.topic,)

    @property
    def selection(self) -> Optional[str]:
        """What is read of each message, for `Middleware.subscribe`; None if only its arrival counts."""
        return "" if self.action else selection(self.field, self.where)

    @property
    def bounds(self) -> Mapping[str, float]:
        """The bounds that are set, by their configuration names."""
        return {name: getattr(self, name) for name in BOUNDS if getattr(self, name) is not None}


SIGNAL_PARAMETERS = parameters(SignalConfig)
"""Keys of a signal, each with unit and range."""

CONDITIONS: Mapping[str, str] = {each.name: each.description for each in keys(SignalConfig) if each.kind is Condition}
"""Keys of a signal that hold a condition on another signal, with their meaning."""


def template_name(signal: str) -> str:
    """Returns the name under which a signal is configured: `drivers` for the element `drivers[motor: left]`."""
    return signal.partition("[")[0]


def is_element_name(name: str) -> bool:
    """Returns whether a text has the form of an element's name; any text may come from a file or a client."""
    return "[" in name and name.endswith("]") and len(name) <= LONGEST_NAME and name.isprintable()


def read_signal(name: str, settings: object, path: Path = ()) -> SignalConfig:
    """Reads the configuration of one signal; raises ConfigError as `load_config` does."""
    if not _NAME.match(name):
        raise ConfigError("expected a signal name of letters, digits and _, not beginning with a digit", path)
    return read_section(SignalConfig, settings, path, name=name)


def _is_time(type_name: str, field: str) -> bool:
    """Returns whether a field is a time by its name: the types of a robot's own messages are not known here."""
    name = field.rpartition(".")[2]
    return name == "stamp" or name.endswith("_stamp") or (canonical_type(type_name), name) in _TIME_FIELDS


def _keys_to_remove(signal: SignalConfig) -> Iterator[Tuple[Sequence[str], str]]:
    """Yields keys that have no meaning beside others, with the reason."""
    if signal.graph is not None:
        keys = ("type", "field", "where", "reduce", "placeholders", "scale", "unit", "valid_min", "valid_max")
        yield keys, f"{signal.graph[0]} has no message; remove this key"
    if signal.lifecycle:
        yield (*BOUNDS, "hysteresis", "statistic"), "lifecycle is an ERROR unless the node is active; remove this key"
    if signal.action:
        yield ("type", "field", "where"), "the goals of an action have no field; remove this key"
    if signal.is_status:
        problem = f"{signal.field} is a whole DiagnosticStatus, judged by its own level; remove this key"
        of_numbers = (*BOUNDS, "hysteresis", "statistic", "scale", "placeholders", "valid_min", "valid_max")
        yield of_numbers, f"{problem}, or read a number: {signal.field}.level"
    if not signal.is_template:
        problem = 'expected a field such as cell_voltage[*] or status["*"] with it'
        yield ("max_elements", "forget_after_s"), f"{problem}, got {describe(signal.field)}"
    if signal.statistic != "forecast":
        yield ("forecast_s",), f"expected statistic: forecast with it, got {describe(signal.statistic)}"
    if signal.statistic == "count":
        yield ("window_min_s",), "a count is defined from the start; remove this key"


def _mistakes_of_names(signal: SignalConfig, given: JsonObject) -> Mistakes:
    """Yields what is no name of a topic, a type, an action or a node; `*` and `?` match where several are counted."""
    keys = [key for key in ("topic", "action", *GRAPH_KEYS) if given.get(key)]
    if len(keys) > 1:
        yield keys[1], f"expected one of topic, action, {', '.join(GRAPH_KEYS)}, got {' and '.join(keys)}"
    for key in ("action", *GRAPH_KEYS):
        letters, where = (
            (r"[~/\w]+", "") if key in ("action", "lifecycle") else (r"[~/\w*?]+", ", in which * and ? match")
        )
        if key in given and not re.fullmatch(letters, given[key], re.ASCII):
            yield key, f"expected one name such as /lidar_driver{where}, got {describe(given[key])}"
    if not signal.topic and signal.graph is None:
        yield "topic", "expected the name of a topic, got ''"
    if signal.type and split_type_name(signal.type) is None:
        yield "type", f"expected a type such as std_msgs/Float32, got {describe(signal.type)}"


def _mistakes_of_paths(signal: SignalConfig, given: JsonObject) -> Mistakes:
    """Yields what is wrong with that which is read of each message."""
    try:
        parse_field_path(signal.field)
    except ValueError as error:
        yield "field", f"expected the path of a field, got {describe(signal.field)}: {error}"
    try:
        if "where" in given:
            parse_where(signal.where)
    except ValueError as error:
        yield "where", str(error)
    if signal.reduce and every_step(signal.field) is None:
        yield "reduce", f'expected a field with [*] or a pattern such as ["*"], got {describe(signal.field)}'
    if signal.is_template and len(signal.name) > LONGEST_TEMPLATE_NAME:
        expected = f"expected a signal name of at most {LONGEST_TEMPLATE_NAME} characters with it"
        yield "field", f"{expected}, got {len(signal.name)}"


def _mistakes_of_forecast(signal: SignalConfig) -> Mistakes:
    if signal.statistic != "forecast":
        return
    longest_s = MOST_FORECAST_WINDOWS * signal.window_s
    if signal.forecast_s is None:
        yield "forecast_s", "is missing; expected the time ahead in s, which statistic: forecast requires"
    elif signal.forecast_s > longest_s:
        expected = f"expected at most {MOST_FORECAST_WINDOWS} times window_s ({bound_text(longest_s)})"
        yield "forecast_s", f"{expected}, got {bound_text(signal.forecast_s)}"
    if len({name.partition("_")[2] for name in signal.bounds}) > 1:
        yield "statistic", f"a forecast has bounds on one side; use two signals, got {' and '.join(signal.bounds)}"


def _mistakes_of_bounds(signal: SignalConfig, given: JsonObject) -> Mistakes:
    """Yields limits that are in the wrong order, and bounds whose alert would never clear."""
    bounds = signal.bounds
    lows = [name for name in bounds if name.endswith("below")]
    highs = [name for name in bounds if name not in lows]
    lowest, highest = (("valid_min",), ("valid_max",)) if signal.statistic in _IN_UNIT else ((), ())
    sides = list(product((*lows, *lowest), (*highs, *highest)))
    ordered = {
        **dict.fromkeys(sides, ": no value would be OK"),
        ("valid_min", "valid_max"): ": no value would be valid",
        ("flap_low", "flap_high"): "",
        ("window_min_s", "window_s"): "",
        ("error_below", "warn_below"): ": a falling value crosses the WARN bound first",
        ("warn_above", "error_above"): ": a rising value crosses the WARN bound first",
        **dict.fromkeys((*product(lowest, lows), *product(highs, highest)), ""),
        **dict.fromkeys(product(bounds if signal.statistic == "count" else (), ("window_samples",)), ""),
    }
    for (low, high), why in ordered.items():
        least, most = getattr(signal, low), getattr(signal, high)
        if least is None or most is None:
            continue
        if least > most:
            is_low = low in given and (low != "valid_min" or high == "valid_max")
            key, expected, got = (low, f"at most {high}", least) if is_low else (high, f"at least {low}", most)
            other = float(most if is_low else least)
            yield key, f"expected {expected} ({bound_text(other)}), got {bound_text(float(got))}{why}"
        elif (low, high) in sides and most - least < signal.hysteresis and (low in bounds or high in bounds):
            clears = f"{low} would clear above {high}" if low in bounds else f"{high} would clear below {low}"
            got = bound_text(signal.hysteresis)
            yield "hysteresis", f"expected at most {number_text(most - least)}, got {got}: {clears}"


LINK_CONFIG = read_signal(
    LINK,
    {
        "valid_min": 0.0, "valid_max": 1.0, "error_below": 1.0, "keep_firing_for_s": 10.0, "flap_detection": True,
        "stale_after_s": 0.0,
    },
)  # fmt: skip
"""How the link to a robot is judged: ERROR at once while it is down, OK once it has been up for 10 s. Never stale."""
