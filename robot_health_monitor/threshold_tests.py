"""Unit tests of a thresholds.yaml: series of samples in, expected alerts out, in virtual time.

Sample n of every series comes at n times `interval_s`. Between them the monitor ticks every second, as alert_system
does; a tick at the time of a sample comes after it. A test ends with its longest series.
"""

from __future__ import annotations

import os
from dataclasses import replace
from typing import Any, Dict, Iterator, List, Mapping, NamedTuple, Optional, Sequence, Tuple

from robot_health_monitor.core.config import MonitorConfig, load_config
from robot_health_monitor.core.errors import ConfigError, Path, Problems
from robot_health_monitor.core.formatting import number_text
from robot_health_monitor.core.model import Level, Sample, Transition
from robot_health_monitor.core.monitor import Monitor
from robot_health_monitor.core.nodes.alert_system import TICK_PERIOD_S
from robot_health_monitor.core.parameters import Parameter, describe, read_parameters, require_mapping
from robot_health_monitor.core.signal_config import LINK
from robot_health_monitor.core.yaml_file import read_yaml

from .series import parse_series

TIME_TOLERANCE_S = 1e-6
"""Two times closer than this are the same: `3 * 0.1` is not 0.3."""

LONGEST_TEST_S = 1e6
"""Longest duration of a test."""

_FILE_PARAMETERS = (Parameter("thresholds", str, None, "path of a thresholds.yaml, relative to this file"),)
_TEST_PARAMETERS = (
    Parameter("name", str, None, "what the test shows"),
    Parameter("interval_s", float, 1.0, "time between the samples of a series, in s", 0.0001, LONGEST_TEST_S),
)
_ALERT_PARAMETERS = (
    Parameter("at_s", float, None, "time since the first sample, in s", 0.0),
    Parameter("signal", str, None, "name of the signal"),
    Parameter("level", str, None, "the new level", choices=tuple(level.name for level in Level)),
)


class Alert(NamedTuple):
    """A transition that a test expects, or that occurred."""

    at_s: float
    """Time since the first sample, in s."""
    signal: str
    """Name of the signal."""
    level: Level
    """The new level."""
    text: str = ""
    """The alert line; empty for an expected alert."""

    def __str__(self) -> str:
        return f"at_s: {number_text(self.at_s)}, signal: {self.signal}, level: {self.level.name}"


class ThresholdTest(NamedTuple):
    """One test."""

    name: str
    interval_s: float
    """Time between the samples of a series, in s."""
    series: Mapping[str, Sequence[Optional[float]]]
    """Samples by signal, as in its messages: before `scale`. None: missing."""
    expected: Sequence[Alert]
    """Every alert, in the order of their times."""


class FileOfTests(NamedTuple):
    """The tests of a file."""

    config: MonitorConfig
    tests: Sequence[ThresholdTest]


class Difference(NamedTuple):
    """One line of the comparison of expected and actual alerts."""

    mark: str
    """`-`: expected, did not occur; `+`: occurred, not expected; a space: as expected."""
    alert: Alert


def read_tests(file: str) -> FileOfTests:
    """Reads a file of tests and the thresholds that it names.

    Raises:
        ConfigError: one of the files cannot be used; `others` are further mistakes.
    """
    read = read_yaml(file)
    problems = Problems()
    config = MonitorConfig({})
    tests: List[ThresholdTest] = []
    try:
        with problems:
            config = _read_thresholds(file, read.tree)
        with problems:
            tests = _read_tests(read.tree, config)
        problems.raise_if_any()
    except ConfigError as error:
        raise read.locate(error) from None
    return FileOfTests(config, tests)


def _read_thresholds(file: str, tree: Mapping[str, Any]) -> MonitorConfig:
    thresholds = read_parameters(tree, _FILE_PARAMETERS, sections=("tests",))["thresholds"]
    if not thresholds:
        raise ConfigError("is missing; expected the path of a thresholds.yaml, relative to this file", ("thresholds",))
    return load_config(os.path.join(os.path.dirname(file), thresholds))


def _read_tests(tree: Mapping[str, Any], config: MonitorConfig) -> List[ThresholdTest]:
    problems = Problems()
    tests: Dict[str, ThresholdTest] = {}
    for number, found in enumerate(_list(tree, "tests", "a list of tests", ())):
        path = ("tests", str(number))
        with problems:
            test = _read_test(found, path, config)
            if test.name in tests:
                raise ConfigError("another test of this file has the same name", (*path, "name"))
            tests[test.name] = test
    problems.raise_if_any()
    if not tests:
        raise ConfigError("expected at least one test, got none", ("tests",))
    return list(tests.values())


def _read_test(found: object, path: Path, config: MonitorConfig) -> ThresholdTest:
    tree = require_mapping(found, path)
    problems = Problems()
    values: Dict[str, Any] = {"name": "", "interval_s": 1.0}
    with problems:
        values = read_parameters(tree, _TEST_PARAMETERS, path, ("input", "alerts"))
        if values["name"] is None:
            raise ConfigError("is missing; expected what the test shows", (*path, "name"))
    series: Dict[str, List[Optional[float]]] = {}
    with problems:
        series = _read_series(tree, (*path, "input"), values["interval_s"], config)
    expected: List[Alert] = []
    with problems:
        for number, alert in enumerate(_list(tree, "alerts", "a list of alerts, [] for none", path)):
            with problems:
                expected.append(_read_alert(alert, (*path, "alerts", str(number)), series))
    problems.raise_if_any()
    return ThresholdTest(values["name"], values["interval_s"], series, sorted(expected, key=lambda each: each.at_s))


def _read_series(
    tree: Mapping[str, Any], path: Path, interval_s: float, config: MonitorConfig
) -> Dict[str, List[Optional[float]]]:
    if "input" not in tree:
        raise ConfigError("is missing; expected a series per signal", path)
    found = require_mapping(tree["input"], path)
    if not found:
        raise ConfigError("expected a series for at least one signal, got none", path)
    problems = Problems()
    series: Dict[str, List[Optional[float]]] = {}
    text = Parameter("input", str, None, "")
    for name, value in found.items():
        with problems:
            if config.signals and name not in (*config.signals, LINK):
                known = ", ".join([*list(config.signals)[:20], LINK])
                raise ConfigError(f"expected a signal of the thresholds ({known})", (*path, name))
            if isinstance(value, (int, float)) and not isinstance(value, bool):
                value = repr(value)  # one sample, such as `25`
            series[name] = parse_series(text.read(_one_line(value), (*path, name)), (*path, name))
            if (len(series[name]) - 1) * interval_s > LONGEST_TEST_S:
                raise ConfigError(f"expected at most {number_text(LONGEST_TEST_S)} s", (*path, name))
    problems.raise_if_any()
    return series


def _one_line(value: object) -> object:
    """Returns a text of several lines, such as YAML's `|`, as one line."""
    return " ".join(value.split()) if isinstance(value, str) else value


def _read_alert(found: object, path: Path, series: Mapping[str, Any]) -> Alert:
    values = read_parameters(require_mapping(found, path), _ALERT_PARAMETERS, path)
    problems = Problems()
    for parameter in _ALERT_PARAMETERS:
        if values[parameter.name] is None:
            problems.add(ConfigError(f"is missing; expected {parameter.description}", (*path, parameter.name)))
    if values["signal"] is not None and series and values["signal"] not in series:
        problem = f"expected a signal of `input` ({', '.join(list(series)[:20])}), got {describe(values['signal'])}"
        problems.add(ConfigError(problem, (*path, "signal")))
    problems.raise_if_any()
    return Alert(values["at_s"], values["signal"], Level[values["level"]])


def _list(tree: Mapping[str, Any], key: str, expected: str, path: Path) -> List[Any]:
    if key not in tree:
        raise ConfigError(f"is missing; expected {expected}", (*path, key))
    if not isinstance(tree[key], list):
        raise ConfigError(f"expected {expected}, got {describe(tree[key])}", (*path, key))
    found: List[Any] = tree[key]
    return found


def run_test(config: MonitorConfig, test: ThresholdTest) -> List[Alert]:
    """Returns the alerts that a test's samples raise, in the order in which they occur.

    Signals without a series are not judged. Repeated announcements (`repeat_s`) are no transitions.
    """
    signals = {name: signal for name, signal in config.signals.items() if name in test.series}
    monitor = Monitor(replace(config, signals=signals))
    monitor.tick(0.0)
    alerts: List[Alert] = []
    for now_s, samples in _steps(test):
        for name, value in samples:
            alerts.extend(_alerts(monitor.observe(Sample(name, value, now_s))))
        if not samples:
            alerts.extend(_alerts(monitor.tick(now_s)))
    return alerts


def _steps(test: ThresholdTest) -> Iterator[Tuple[float, List[Tuple[str, float]]]]:
    """Yields each time with its samples; without samples it is a tick."""
    ticks = 1
    length = max(map(len, test.series.values()))
    for number in range(length):
        now_s = number * test.interval_s
        while ticks * TICK_PERIOD_S < now_s - TIME_TOLERANCE_S:
            yield ticks * TICK_PERIOD_S, []
            ticks += 1
        samples = [(name, series[number]) for name, series in test.series.items() if number < len(series)]
        present = [(name, value) for name, value in samples if value is not None]
        if present:
            yield now_s, present
        if ticks * TICK_PERIOD_S <= now_s + TIME_TOLERANCE_S:
            yield max(now_s, ticks * TICK_PERIOD_S), []
            ticks += 1


def _alerts(transitions: Sequence[Transition]) -> List[Alert]:
    return [
        Alert(transition.now_s, transition.signal, transition.to_level, transition.text)
        for transition in transitions
        if not transition.repeat
    ]


def compare(expected: Sequence[Alert], actual: Sequence[Alert]) -> List[Difference]:
    """Compares alerts; those of one instant in any order.

    Returns:
        Every alert in the order of the times, marked; all marks are spaces if nothing differs.
    """
    missing = list(expected)
    result: List[Difference] = []
    for alert in actual:
        match = next((each for each in missing if _same(each, alert)), None)
        if match is not None:
            missing.remove(match)
        result.append(Difference("+" if match is None else " ", alert))
    result.extend(Difference("-", alert) for alert in missing)
    return sorted(result, key=lambda each: (each.alert.at_s, "- +".index(each.mark)))


def _same(expected: Alert, actual: Alert) -> bool:
    return (
        expected.signal == actual.signal
        and expected.level is actual.level
        and abs(expected.at_s - actual.at_s) <= TIME_TOLERANCE_S
    )
