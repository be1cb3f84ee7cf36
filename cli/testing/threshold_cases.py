"""Unit tests of a thresholds.yaml: series of samples in, expected alerts out, in virtual time.

Sample n of every series comes at n times `interval_s`. Between them the monitor ticks every second, as alert_system
does; a tick at the time of a sample comes after it. A test ends with its longest series.

Series are in the notation of `promtool test rules`: `25x9` is ten samples (a value and nine repetitions), `15-0.5x20`
21 from 15 to 5, `20+2x3` four from 20 to 26, `_` a missing one and `_x3` three of them, not four.
An element has a series under its full name: `cells[3]: "3.9x9"`, `drivers[motor: left]: "0x9 2x3"` (levels).
Those of a signal with `reduce` are one message: `weakest_cell[3]`. Its own series are its reduced values, in its unit.
Those of a time are its ages in s.
Source: https://prometheus.io/docs/prometheus/latest/configuration/unit_testing_rules/#series
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, field, replace
from typing import Any, Dict, Iterator, List, Mapping, Optional, Sequence, Tuple

from ...core.config import (
    LINK,
    REQUIRED,
    MonitorConfig,
    Parameter,
    SignalConfig,
    YamlFile,
    declared,
    is_element_name,
    load_config,
    parse_yaml,
    read_section,
    read_yaml,
    require_mapping,
    template_name,
)
from ...core.judge import Monitor
from ...core.nodes.alert_system import TICK_PERIOD_S
from ...core.values import (
    ConfigError,
    DriverStatus,
    Elements,
    JsonObject,
    Level,
    Path,
    Problems,
    Sample,
    Transition,
    describe,
    number_text,
)

DECIMALS = 6  # of times in s, which are rounded: `3 * 0.1` is not 0.3
TIME_TOLERANCE_S = 1e-6
LONGEST_TEST_S = 1e6
MOST_SAMPLES = 1_000_000  # longest series

_TEXT = Parameter("", str, None, "")
_NUMBER = r"(?:\d+(?:\.\d*)?|\.\d+)(?:e[+-]?\d+)?"
_VALUE = re.compile(rf"(?P<value>[+-]?(?:{_NUMBER}|nan|inf))(?:(?P<step>[+-]{_NUMBER})?x(?P<times>\d+))?\Z", re.I)
_MISSING = re.compile(r"_(?:x(?P<times>\d+))?\Z")


@dataclass(frozen=True)
class _File:
    """The keys of a file of tests."""

    thresholds: Any = declared(REQUIRED, "path of a thresholds.yaml, relative to this file, or its contents")
    tests: Any = declared(REQUIRED, "list of tests")


@dataclass(frozen=True)
class Alert:
    """A transition that a test expects, or that occurred."""

    at_s: float = declared(REQUIRED, "time since the first sample, in s", 0.0)
    signal: str = declared(REQUIRED, "name of the signal")
    level: Level = declared(REQUIRED, "new level")
    text: str = field(default="", compare=False)  # the alert line; empty for an expected alert

    def __str__(self) -> str:
        return f"at_s: {number_text(self.at_s)}, signal: {self.signal}, level: {self.level.name}"


@dataclass(frozen=True)
class ThresholdTest:
    """One test; its fields are the keys in a file."""

    name: str = declared(REQUIRED, "text that says what the test shows")
    input: Any = declared(REQUIRED, "series of each signal")
    """Samples by signal, as in its messages: before `scale`; None where one is missing. Of a status its level."""
    alerts: Any = declared(REQUIRED, "list of alerts, [] for none")
    """Every `Alert`, in the order of their times, which are rounded to `DECIMALS`."""
    interval_s: float = declared(1.0, "time between the samples of a series, in s", 0.0001, LONGEST_TEST_S)


Difference = Tuple[str, Alert]
"""An alert with its mark: `-` expected, did not occur; `+` occurred, not expected; a space: as expected."""


def read_tests(file: str) -> Tuple[MonitorConfig, List[ThresholdTest]]:
    """Reads a file of tests and the thresholds that it names. Raises ConfigError, with all mistakes."""
    return _tests_of(read_yaml(file), os.path.dirname(file))


def parse_tests(text: str, name: str) -> Tuple[MonitorConfig, List[ThresholdTest]]:
    """Reads the text of such a file, with its `name` in errors; paths in it are relative to the working directory."""
    return _tests_of(parse_yaml(text, name), "")


def _tests_of(read: YamlFile, folder: str) -> Tuple[MonitorConfig, List[ThresholdTest]]:
    problems = Problems()
    config = MonitorConfig({})
    tests: List[ThresholdTest] = []
    with read.located():
        with problems:
            read_section(_File, read.tree)
        with problems:
            config = _read_thresholds(read.tree.get("thresholds"), folder)
        with problems:
            for number, each in enumerate(_list(read.tree, ("tests",))):
                with problems:
                    tests.append(_read_test(each, ("tests", str(number)), config))
        if read.tree.get("tests") == []:
            problems.add(ConfigError("expected at least one test, got none", ("tests",)))
        problems.raise_if_any()
    return config, tests


def _read_thresholds(given: object, folder: str) -> MonitorConfig:
    if isinstance(given, Mapping):
        try:
            return load_config(given)
        except ConfigError as error:
            raise error.below(("thresholds",)) from None
    return load_config(os.path.join(folder, _TEXT.read(given, ("thresholds",)))) if given else MonitorConfig({})


def _read_test(given: object, path: Path, config: MonitorConfig) -> ThresholdTest:
    tree = require_mapping(given, path)
    problems = Problems()
    test = ThresholdTest("", {}, [])
    with problems:
        test = read_section(ThresholdTest, tree, path)
    series: Dict[str, List[Optional[float]]] = {}
    with problems:
        for name, value in require_mapping(tree.get("input", {}), (*path, "input")).items():
            with problems:
                series[name] = _read_series(name, value, (*path, "input", name), test.interval_s, config)
        if tree.get("input") == {}:
            raise ConfigError("expected a series for at least one signal, got none", (*path, "input"))
    alerts: List[Alert] = []
    for number, each in enumerate(_list(tree, (*path, "alerts"))):
        with problems:
            alert = read_section(Alert, each, (*path, "alerts", str(number)))
            alerts.append(replace(alert, at_s=round(alert.at_s, DECIMALS)))
    problems.raise_if_any()
    return replace(test, input=series, alerts=sorted(alerts, key=lambda alert: alert.at_s))


def _read_series(
    name: str, given: object, path: Path, interval_s: float, config: MonitorConfig
) -> List[Optional[float]]:
    if config.signals and not _is_input(name, config):
        raise ConfigError(
            f"expected a signal of the thresholds ({', '.join([*list(config.signals)[:20], LINK])})", path
        )
    if name in config.signals and config.signals[name].is_template:
        raise ConfigError(f"expected a series for each element, such as {name}[0]", path)
    series = parse_series(given if isinstance(given, str) else repr(given), path)  # one sample may be a number
    if (len(series) - 1) * interval_s > LONGEST_TEST_S:
        raise ConfigError(f"expected at most {number_text(LONGEST_TEST_S)} s", path)
    return series


def _is_input(name: str, config: MonitorConfig) -> bool:
    template = config.signals.get(template_name(name))
    has_elements = template is not None and (template.is_template or template.reduce != "")
    is_element = has_elements and is_element_name(name)
    return is_element or name in config.signals or name == LINK


def parse_series(text: str, path: Path = ()) -> List[Optional[float]]:
    """Returns the samples of a series, None for a missing one. Raises ConfigError if it is no series, or too long."""
    samples: List[Optional[float]] = []
    for item in text.split():
        missing, value = _MISSING.match(item), _VALUE.match(item)
        if missing:
            samples.extend([None] * _times(missing["times"] or "1", samples, path))
        elif value:
            start, step = float(value["value"]), float(value["step"] or 0.0)
            times = _times(value["times"] or "0", samples, path)
            # Not by adding up: 20.5-0.1x5 must end at 20 exactly.
            samples.extend(start + step * count if step else start for count in range(times + 1))
        else:
            raise ConfigError(f"expected a series such as '25x9 15-0.5x20 _x3 nan', got {describe(item)} in it", path)
    if not samples:
        raise ConfigError("expected a series such as '25x9 15-0.5x20 _x3 nan', got no samples", path)
    return samples


def _times(digits: str, samples: List[Optional[float]], path: Path) -> int:
    # A number of a million digits would take Python minutes.
    times = int(digits) if len(digits) < 10 else MOST_SAMPLES
    if len(samples) + times + 1 > MOST_SAMPLES:
        raise ConfigError(f"expected at most {MOST_SAMPLES} samples in a series", path)
    return times


def _list(tree: JsonObject, path: Path) -> List[Any]:
    listed = tree.get(path[-1], [])
    if not isinstance(listed, list):
        raise ConfigError(f"expected a list of {path[-1]}, got {describe(listed)}", path)
    return listed


def run_test(config: MonitorConfig, test: ThresholdTest) -> List[Alert]:
    """Returns the alerts that a test's samples raise, in the order in which they occur.

    Signals without a series are not judged. Repeated announcements (`repeat_s`) are no transitions.
    """
    given = set(map(template_name, test.input))
    signals = {name: signal for name, signal in config.signals.items() if name in given}
    statuses = {name for name, signal in signals.items() if signal.is_status}
    monitor = Monitor(replace(config, signals=signals))
    monitor.tick(0.0)
    transitions: List[Transition] = []
    for now_s, samples in _steps(test):
        for name, value in _with_reductions(samples, signals):
            is_status = template_name(name) in statuses and isinstance(value, float)
            datum = DriverStatus(int(value) if value.is_integer() else value, "") if is_status else value
            transitions += monitor.observe(Sample(name, datum, now_s))
        if not samples:
            transitions += monitor.tick(now_s)
    return [
        Alert(round(each.now_s, DECIMALS), each.signal, each.to_level, each.text)
        for each in transitions
        if not each.repeat
    ]


def _with_reductions(
    samples: Sequence[Tuple[str, float]], signals: Mapping[str, SignalConfig]
) -> Iterator[Tuple[str, Any]]:
    """Yields the samples of one time, those of the elements of a signal with `reduce` as one message."""
    messages: Dict[str, Elements] = {}
    for name, value in samples:
        signal = template_name(name)
        if signal != name and signals[signal].reduce:
            messages.setdefault(signal, Elements()).append((name[len(signal) + 1 : -1], value))
        else:
            yield name, value
    yield from messages.items()


def _steps(test: ThresholdTest) -> Iterator[Tuple[float, List[Tuple[str, float]]]]:
    """Yields each time with its samples; without samples it is a tick."""
    end_s = (max(map(len, test.input.values())) - 1) * test.interval_s + TIME_TOLERANCE_S
    steps: Dict[Tuple[float, bool], List[Tuple[str, float]]] = {
        (count * TICK_PERIOD_S, True): [] for count in range(1, int(end_s / TICK_PERIOD_S) + 1)
    }
    for name, series in test.input.items():
        for number, value in enumerate(series):
            if value is not None:
                steps.setdefault((round(number * test.interval_s, DECIMALS), False), []).append((name, value))
    for (now_s, _), samples in sorted(steps.items()):
        yield now_s, samples


def compare(expected: Sequence[Alert], actual: Sequence[Alert]) -> List[Difference]:
    """Compares alerts, those of one instant in any order; returns all, in the order of their times, marked."""
    missing = list(expected)
    result: List[Difference] = []
    for alert in actual:
        result.append((" " if alert in missing else "+", alert))
        if alert in missing:
            missing.remove(alert)
    result += [("-", alert) for alert in missing]
    return sorted(result, key=lambda each: (each[1].at_s, "- +".index(each[0])))
