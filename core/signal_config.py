"""Configuration of one signal: its keys, as one table, and the checks that they do not contradict one another.

The fields of `SignalConfig` are the table: a line there is enough for a new key. Every error names the key's path.
"""

from __future__ import annotations

import dataclasses
import math
import re
from dataclasses import dataclass, fields, replace
from typing import Any, Dict, Mapping, Optional, Tuple

from .errors import ConfigError, Path, Problems
from .field_path import parse_field_path
from .formatting import bound_text, number_text
from .middleware import split_type_name
from .parameters import Parameter, describe, read_parameters, require_mapping

LINK = "link"
"""Name of the signal that is 1 while a robot can be reached, else 0. Reserved; conditions may refer to it."""

STATISTICS = ("last", "mean", "min", "max", "stddev", "rate", "frequency_hz")
"""Statistics to which bounds can apply."""

BOUNDS = ("warn_below", "warn_above", "error_below", "error_above")

LONGEST_S = 365.0 * 86_400.0
"""Longest duration in a configuration, in s: a year. Prometheus refuses much longer ones."""

_UNIT_RANGES: Mapping[str, Tuple[Optional[float], Optional[float]]] = {
    "%": (0.0, 100.0),
    "degC": (-273.15, None),
    "°C": (-273.15, None),
    "C": (-273.15, None),
    "K": (0.0, None),
    "Hz": (0.0, None),
}
"""Smallest and largest possible value per unit."""

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*\Z")


@dataclass(frozen=True)
class Condition:
    """A condition on the latest value of another signal."""

    signal: str
    """The other signal's name."""
    comparison: str
    """`is`, `is_not`, `below` or `above`."""
    number: float
    """Number with which its value is compared, in its unit."""

    def __str__(self) -> str:
        return self._text(True)

    @property
    def opposite(self) -> str:
        """The text while it does not hold."""
        return self._text(False)

    def _text(self, holds: bool) -> str:
        verb = "is" if holds is (self.comparison != "is_not") else "is not"
        side = "" if self.comparison in ("is", "is_not") else f" {self.comparison}"
        return f"{self.signal} {verb}{side} {bound_text(self.number)}"

    def holds(self, value: float) -> bool:
        """Returns whether the condition is true for this value of the other signal."""
        if self.comparison in ("is", "is_not"):
            # 0.1 as a Float32 is 0.1000000015
            return math.isclose(value, self.number, rel_tol=1e-6) is (self.comparison == "is")
        return value < self.number if self.comparison == "below" else value > self.number


_KINDS: Mapping[str, type] = {
    "bool": bool,
    "int": int,
    "float": float,
    "Optional[float]": float,
    "str": str,
    "Tuple[float, ...]": list,
    "Tuple[str, ...]": tuple,
}
"""Kind of parameter per type of field."""


def _key(default: object, description: str, *limits: Any, **choices: Any) -> Any:
    """Returns the field of a key; the arguments are those of `Parameter` after its kind."""
    return dataclasses.field(metadata={"parameter": Parameter("", object, default, description, *limits, **choices)})


@dataclass(frozen=True)
class SignalConfig:
    """One signal: its source and its rules.

    This is the table of keys: type, default, description, smallest and largest value. Where the type is not optional,
    `read_signal` replaces the default None.
    """

    name: str
    topic: str = _key(None, "topic of the signal; left out: the signal's name")
    type: str = _key("", "message type, such as std_msgs/Float32; left out: the type that is published")
    field: str = _key("data", "path of the number in the message; empty: count arrivals, the value is 1")
    scale: float = _key(1.0, "factor that converts the number to the unit")
    unit: str = _key("", "unit of the value, for display and plausibility checks")
    placeholders: Tuple[float, ...] = _key((), "numbers that mean 'not measured', before scaling: invalid data")
    valid_min: Optional[float] = _key(None, "smallest valid value, in the unit; below it the data is invalid")
    valid_max: Optional[float] = _key(None, "largest valid value, in the unit; above it the data is invalid")
    invalid_for_s: float = _key(0.0, "time for which data must be invalid before it is an ERROR, in s", 0.0)
    window_s: float = _key(60.0, "length of the window for statistics, in s", 0.001)
    window_min_s: float = _key(
        None,
        "time for which samples must come before statistics other than last are defined, in s; left out: window_s / 2",
        0.0,
    )
    window_samples: int = _key(6000, "maximum number of samples in the window", 1, 1_000_000)
    statistic: str = _key("last", "statistic of the window to which the bounds apply", choices=STATISTICS)
    warn_below: Optional[float] = _key(None, "WARN below this value, in the unit of the statistic")
    warn_above: Optional[float] = _key(None, "WARN above this value, in the unit of the statistic")
    error_below: Optional[float] = _key(None, "ERROR below this value, in the unit of the statistic")
    error_above: Optional[float] = _key(None, "ERROR above this value, in the unit of the statistic")
    hysteresis: float = _key(0.0, "distance from a bound at which its alert clears, in the unit of the statistic", 0.0)
    for_s: float = _key(0.0, "time for which a bound must be crossed before the alert fires, in s", 0.0)
    keep_firing_for_s: float = _key(0.0, "time after the bound is no longer crossed until it clears, in s", 0.0)
    error_for_s: float = _key(None, "for_s of the ERROR bounds, in s; left out: for_s", 0.0)
    error_keep_firing_for_s: float = _key(
        None, "keep_firing_for_s of the ERROR bounds, in s; left out: keep_firing_for_s", 0.0
    )
    latch: bool = _key(False, "keep the worst level that fired until reset")
    flap_detection: bool = _key(False, "announce a signal that changes too often once, not at each change")
    flap_high: float = _key(50.0, "state change at which flapping begins, in %", 0.0, 100.0)
    flap_low: float = _key(25.0, "state change below which flapping ends, in %", 0.0, 100.0)
    stale_after_s: float = _key(5.0, "time without a sample after which it is STALE, in s; 0: never", 0.0)
    startup_grace_s: float = _key(10.0, "stale_after_s before the first sample, in s", 0.0)
    repeat_s: float = _key(0.0, "interval of repeated announcements while not OK, in s; 0: none", 0.0)
    only_if: Optional[Condition] = dataclasses.field(
        default=None,
        metadata={"condition": "the bounds apply only while this holds or the other signal is unknown"},
    )
    latch_release_if: Optional[Condition] = dataclasses.field(
        default=None, metadata={"condition": "a latch is released while this holds, as by `reset`"}
    )

    @property
    def bounds(self) -> Mapping[str, float]:
        """The bounds that are set, by their configuration names."""
        return {name: getattr(self, name) for name in BOUNDS if getattr(self, name) is not None}


SIGNAL_PARAMETERS = tuple(
    replace(
        each.metadata["parameter"],
        name=each.name,
        kind=_KINDS[str(each.type)],
        maximum=LONGEST_S if each.name.endswith("_s") else each.metadata["parameter"].maximum,
    )
    for each in fields(SignalConfig)
    if "parameter" in each.metadata
)
"""Keys of a signal, each with unit and range."""

CONDITIONS: Mapping[str, str] = {
    each.name: each.metadata["condition"] for each in fields(SignalConfig) if "condition" in each.metadata
}
"""Keys of a signal that hold a condition on another signal."""

CONDITION_PARAMETERS = (
    Parameter("signal", str, None, "name of the other signal"),
    Parameter("is", float, None, "true while the other signal equals this value, in its unit"),
    Parameter("is_not", float, None, "true while the other signal differs from this value, in its unit"),
    Parameter("below", float, None, "true while the other signal is below this value, in its unit"),
    Parameter("above", float, None, "true while the other signal is above this value, in its unit"),
)
"""Keys of a condition on another signal: the signal and one comparison."""


def read_signal(name: str, found: object, path: Path = ()) -> SignalConfig:
    """Reads the configuration of one signal.

    Raises:
        ConfigError: as `load_config` does.
    """
    problems = Problems()
    if not _NAME.match(name):
        problem = "expected a signal name of letters, digits and _, not beginning with a digit"
        problems.add(ConfigError(problem, path))
    values: Dict[str, Any] = {}
    with problems:
        tree = require_mapping(found, path)
        for key in CONDITIONS:
            if key in tree:
                with problems:
                    values[key] = _read_condition(tree[key], (*path, key))
        values.update(read_parameters(tree, SIGNAL_PARAMETERS, path, tuple(CONDITIONS)))
    problems.raise_if_any()
    if values["topic"] is None:
        values["topic"] = name
    if values["window_min_s"] is None:
        values["window_min_s"] = values["window_s"] / 2.0
    for key in ("for_s", "keep_firing_for_s"):
        if values[f"error_{key}"] is None:
            values[f"error_{key}"] = values[key]
    signal = SignalConfig(name=name, **values)
    with problems:
        _check_source(signal, path)
    if signal.flap_low > signal.flap_high:
        low, high = bound_text(signal.flap_low), bound_text(signal.flap_high)
        key, problem = "flap_low", f"expected at most flap_high ({high}), got {low}"
        if "flap_low" not in tree:
            key, problem = "flap_high", f"expected at least flap_low ({low}), got {high}"
        problems.add(ConfigError(problem, (*path, key)))
    if signal.window_min_s > signal.window_s:
        most, got = bound_text(signal.window_s), bound_text(signal.window_min_s)
        problems.add(ConfigError(f"expected at most window_s ({most}), got {got}", (*path, "window_min_s")))
    _check_order(signal, path, problems)
    _check_unit(signal, path, problems)
    problems.raise_if_any()
    return signal


def _read_condition(found: object, path: Path) -> Condition:
    values = read_parameters(require_mapping(found, path), CONDITION_PARAMETERS, path)
    signal = values.pop("signal")
    if signal is None:
        raise ConfigError("is missing; expected the name of another signal", (*path, "signal"))
    comparisons = {name: number for name, number in values.items() if number is not None}
    if len(comparisons) != 1:
        found_text = " and ".join(comparisons) or "none"
        raise ConfigError(f"expected one of {', '.join(values)}, got {found_text}", path)
    ((comparison, number),) = comparisons.items()
    return Condition(signal, comparison, number)


def _check_source(signal: SignalConfig, path: Path) -> None:
    problems = Problems()
    if not signal.topic:
        problems.add(ConfigError("expected the name of a topic, got ''", (*path, "topic")))
    if signal.type and split_type_name(signal.type) is None:
        got = describe(signal.type)
        problems.add(ConfigError(f"expected a type such as std_msgs/Float32, got {got}", (*path, "type")))
    try:
        parse_field_path(signal.field)
    except ValueError as error:
        problems.add(
            ConfigError(f"expected the path of a field, got {describe(signal.field)}: {error}", (*path, "field"))
        )
    if signal.scale == 0.0:
        problems.add(ConfigError("expected a number other than 0, got 0", (*path, "scale")))
    problems.raise_if_any()


def _check_order(signal: SignalConfig, path: Path, problems: Problems) -> None:
    def refuse_above(low: str, high: str, why: str) -> None:
        low_value, high_value = getattr(signal, low), getattr(signal, high)
        if low_value is not None and high_value is not None and low_value > high_value:
            expected = f"expected at most {high} ({bound_text(high_value)})"
            problems.add(ConfigError(f"{expected}, got {bound_text(low_value)}: {why}", (*path, low)))

    def refuse_hysteresis(expected: str, why: str) -> None:
        got = bound_text(signal.hysteresis)
        problems.add(ConfigError(f"expected {expected}, got {got}: {why}", (*path, "hysteresis")))

    refuse_above("valid_min", "valid_max", "no value would be valid")
    refuse_above("error_below", "warn_below", "a falling value crosses the WARN bound first")
    refuse_above("warn_above", "error_above", "a rising value crosses the WARN bound first")
    lows = [name for name in ("warn_below", "error_below") if getattr(signal, name) is not None]
    highs = [name for name in ("warn_above", "error_above") if getattr(signal, name) is not None]
    for low in lows:
        for high in highs:
            refuse_above(low, high, "no value would be OK")
            room = getattr(signal, high) - getattr(signal, low)
            if 0.0 <= room < signal.hysteresis:
                refuse_hysteresis(f"at most {number_text(room)}", f"{low} would clear above {high}")
    if signal.statistic not in ("last", "mean", "min", "max"):
        return
    for name, bound in signal.bounds.items():
        with problems:
            _check_range(name, bound, signal.valid_min, signal.valid_max, "valid_min", "valid_max", path)
        clears_at = bound + signal.hysteresis if name in lows else bound - signal.hysteresis
        too_high = name in lows and signal.valid_max is not None and bound <= signal.valid_max < clears_at
        too_low = name in highs and signal.valid_min is not None and clears_at < signal.valid_min <= bound
        if too_high or too_low:
            refuse_hysteresis("less", f"{name} would clear at {number_text(clears_at)}, which is not a valid value")


def _check_range(
    name: str, found: float, low: Optional[float], high: Optional[float], low_name: str, high_name: str, path: Path
) -> None:
    expected = ""
    if low is not None and found < low:
        expected = f"at least {bound_text(low)} ({low_name})"
    elif high is not None and found > high:
        expected = f"at most {bound_text(high)} ({high_name})"
    if expected:
        raise ConfigError(f"expected {expected}, got {bound_text(found)}", (*path, name))


def _check_unit(signal: SignalConfig, path: Path, problems: Problems) -> None:
    low, high = _UNIT_RANGES.get(signal.unit, (None, None))
    limits = {name: getattr(signal, name) for name in ("valid_min", "valid_max")}
    if signal.statistic in ("last", "mean", "min", "max"):
        limits.update(signal.bounds)
    for name, value in limits.items():
        if value is not None:
            unit = f"the minimum of {signal.unit}", f"the maximum of {signal.unit}"
            with problems:
                _check_range(name, value, low, high, *unit, path)
    if signal.unit == "%" and signal.valid_max is not None and signal.valid_max <= 1.0:
        problems.add(
            ConfigError(
                f"expected valid_max 100 for the unit '%', got {bound_text(signal.valid_max)};"
                " a fraction from 0 to 1 has the unit ''",
                (*path, "unit"),
            )
        )
