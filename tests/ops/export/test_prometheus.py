"""The exported rules, judged by Prometheus's own promtool: it accepts them, and they fire when the monitor does."""

from __future__ import annotations

import json
import math
import random
import time
from pathlib import Path
from typing import Any, Dict, Iterator, List, Mapping, Optional, Sequence, Tuple

import pytest
import yaml
from harness.http_server import HttpServer, responding
from harness.prometheus_server import PrometheusServer, needs_prometheus
from harness.promtool import needs_promtool, promtool, random_timeline
from harness.seeds import fixed_seed
from prometheus_client.parser import text_string_to_metric_families

from robot_health_monitor.core import ConfigError, Level, Sample, Transition, load_config
from robot_health_monitor.core.elements import DriverStatus, Elements
from robot_health_monitor.core.local import LocalBus
from robot_health_monitor.core.nodes import AlertSystem
from robot_health_monitor.core.outlets import Event
from robot_health_monitor.ops.export.prometheus import Export, export_rules
from robot_health_monitor.ops.metrics import Metrics

ROOT = Path(__file__).resolve().parents[3]
THRESHOLDS = sorted(path.name for path in (ROOT / "config").glob("*.yaml") if "ros__parameters" in path.read_text())
STEPS = 50

Series = Dict[str, List[Optional[float]]]


def exported(signals: Mapping[str, Any], **options: Any) -> Export:
    return export_rules(load_config({"signals": signals}), **options)


@needs_promtool
@pytest.mark.parametrize("file", THRESHOLDS)
def test_promtool_accepts_the_rules_of_every_shipped_configuration(tmp_path: Path, file: str) -> None:
    (tmp_path / "rules.yaml").write_text(export_rules(load_config(ROOT / "config" / file)).text)

    assert promtool(tmp_path, "check", "rules", "--lint-fatal", "rules.yaml") == ""


@needs_promtool
@pytest.mark.parametrize(
    "signals",
    [
        pytest.param({"a": {"warn_below": 1e300, "unit": '"{{ x }}" µ\\'}}, id="unit"),
        pytest.param({"a": {"warn_below": 1.0, "unit": "🌡"}}, id="unit beyond the basic plane of Unicode"),
        pytest.param({"a": {"warn_below": -1e-300, "warn_above": 5e-324, "for_s": 0.0005}}, id="tiny numbers"),
        pytest.param({"a": {"stale_after_s": 0.0}}, id="no rule but invalid data"),
        pytest.param(
            {"a": {"statistic": "forecast", "window_s": 600.001, "forecast_s": 0.001, "error_above": -1e-9}},
            id="forecast",
        ),
        pytest.param(
            {
                "a": {"field": "x[*]", "statistic": "forecast", "forecast_s": 60.0, "warn_below": 1.0},
                "b": {
                    "statistic": "forecast",
                    "forecast_s": 60.0,
                    "warn_below": 1.0,
                    "error_below": 0.0,
                    "error_for_s": 9.0,
                },
                "c": {"field": "y[*]", "warn_below": 1.0, "error_below": 0.0, "error_for_s": 9.0},
                "d": {"field": "z[*]", "warn_below": 1.0, "error_below": 0.0, "error_for_s": 9.0},
                "e": {"field": 'status["*"]', "error_for_s": 9.0},
            },
            id="several of each",
        ),
    ],
)
def test_promtool_accepts_the_rules_of_odd_configurations(tmp_path: Path, signals: Mapping[str, Any]) -> None:
    (tmp_path / "rules.yaml").write_text(exported(signals, robots=['r"1\\', "ä|b", "x.y", "R\u20131 🤖"]).text)

    assert promtool(tmp_path, "check", "rules", "--lint-fatal", "rules.yaml") == ""


@needs_promtool
@pytest.mark.parametrize("name", ["null", "on", "no", "y"])
def test_a_signal_whose_name_is_no_text_in_yaml_has_its_alert(tmp_path: Path, name: str) -> None:
    text = exported({name: {"warn_below": 20.0, "stale_after_s": 0.0}}).text
    warn = {
        "exp_labels": {"robot": "r1", "signal": name, "level": "WARN", "severity": "warning"},
        "exp_annotations": {"summary": f"r1: {name} WARN: 19 is below 20"},
    }

    series = {f'robot_health_value{{robot="r1", signal="{name}"}}': "25 19"}
    assert run_series(tmp_path, text, series, [("0s", []), ("1s", [warn])]) == ""


@pytest.mark.parametrize("interval_s", [0.0001, 121.0])
def test_an_interval_at_which_prometheus_does_not_see_every_series_is_refused(interval_s: float) -> None:
    with pytest.raises(ConfigError, match=r"expected an interval from 0\.1 to 120 s, got "):
        exported({"a": {"warn_below": 20.0}}, interval_s=interval_s)


@needs_promtool
def test_labels_and_summary_are_those_of_the_monitors_alert(tmp_path: Path) -> None:
    text = exported({"battery_level": {"unit": "%", "warn_below": 20.0, "error_below": 10.0, "for_s": 2.0}}).text
    series = {'robot_health_value{robot="r1", signal="battery_level", instance="a:9090"}': "25 19.5 19.5 19.5 9 9 9"}
    labels = {"robot": "r1", "signal": "battery_level"}
    warn = {
        "exp_labels": {**labels, "level": "WARN", "severity": "warning"},
        "exp_annotations": {"summary": "r1: battery_level WARN: 19.5 % is below 20 %"},
    }
    error = {
        "exp_labels": {**labels, "level": "ERROR", "severity": "critical"},
        "exp_annotations": {"summary": "r1: battery_level ERROR: 9 % is below 10 %"},
    }
    still_warn = {**warn, "exp_annotations": {"summary": "r1: battery_level WARN: 9 % is below 20 %"}}
    expected = [("2s", []), ("3s", [warn]), ("6s", [still_warn, error])]

    assert run_series(tmp_path, text, series, expected) == ""


def run_series(folder: Path, text: str, series: Mapping[str, str], expected: Sequence[Tuple[str, List[Any]]]) -> str:
    """Returns promtool's findings; empty if the alerts at these times are as expected."""
    (folder / "rules.yaml").write_text(text)
    test = {
        "rule_files": ["rules.yaml"],
        "evaluation_interval": "1s",
        "tests": [
            {
                "interval": "1s",
                "input_series": [{"series": name, "values": values} for name, values in series.items()],
                "alert_rule_test": [
                    {"eval_time": time, "alertname": "RobotHealth", "exp_alerts": alerts} for time, alerts in expected
                ],
            }
        ],
    }
    (folder / "test.yaml").write_text(json.dumps(test))
    return promtool(folder, "test", "rules", "test.yaml")


@needs_promtool
def test_a_forecast_needs_its_window_and_of_two_monitors_the_worse_one_counts(tmp_path: Path) -> None:
    """By hand: 100 % and 1 % less per second is 80 % at 20 s, and 20 s later 60 %."""
    soon = {"statistic": "forecast", "window_s": 20.0, "forecast_s": 20.0, "unit": "%", "warn_below": 65.0}
    series = {
        'robot_health_latest{robot="r1", signal="soon", instance="a:9090"}': "100-1x30",
        'robot_health_latest{robot="r1", signal="soon", instance="b:9090"}': "100x30",
    }
    alert = {
        "exp_labels": {"robot": "r1", "signal": "soon", "level": "WARN", "severity": "warning"},
        "exp_annotations": {"summary": "r1: soon WARN: forecast 60 % in 20 s is below 65 %"},
    }
    text = exported({"soon": soon}, interval_s=1.0).text
    assert run_series(tmp_path, text, series, [("19s", []), ("20s", [alert])]) == ""
    text = exported({"soon": {**soon, "window_min_s": 0.0}}, interval_s=1.0).text
    assert run_series(tmp_path, text, series, [("19s", [])]) != ""


class Robot:
    """An alert_system in virtual time, and its /metrics after each second."""

    def __init__(self, name: str, signals: Mapping[str, Any]) -> None:
        self.name = name
        self._bus = LocalBus()
        self._changes: List[Transition] = []
        node = self._bus.node("alert_system", parameters={"robot_name": name, "signals": signals})
        self._alert_system = AlertSystem(node, {"test": self._note}, log_alerts=False)
        self._metrics = Metrics(wall_time_s=lambda: self._bus.now_s)
        self.config = self._alert_system.monitor.config
        self.series: Series = {}
        self.levels: List[Dict[str, Level]] = []
        """The announced levels after each second; of the link, the true one, because its flapping is withheld."""

    def play(self, step: int, values: Mapping[str, object], link: Optional[bool] = None) -> None:
        """Advances by a second: the link, then the samples, then the tick."""
        self._changes.clear()
        now_s = float(step)
        self._bus.run_due(now_s - 1e-7)  # before the tick
        if link is not None:
            self._alert_system.observe_link(link, "refused")
        for name, value in values.items():
            self._alert_system.observe(Sample(name, value, now_s))
        self._bus.run_until(now_s)
        levels = dict(self.levels[-1]) if self.levels else dict.fromkeys(self.config.signals, Level.OK)
        levels.update({change.signal: change.to_level for change in self._changes})
        if link is not None:
            levels["link"] = self._alert_system.monitor.report(now_s).statuses["link"].level
        self.levels.append(levels)
        text = self._metrics.render([self._metrics.read(self._alert_system)])[0].decode()
        for family in text_string_to_metric_families(text):
            for sample in family.samples:
                labels = ", ".join(f'{name}="{value}"' for name, value in sorted(sample.labels.items()))
                series = self.series.setdefault(f"{sample.name}{{{labels}}}", [])
                series += [None] * (step - len(series)) + [sample.value]

    def _note(self, event: Event) -> None:
        if isinstance(event, Transition):
            self._changes.append(event)


def promtool_test(folder: Path, robots: Sequence[Robot], expected: Sequence[Mapping[Tuple[str, str], Level]]) -> str:
    """Returns promtool's findings; empty if after each second the worst firing alert of each signal is as expected."""
    numbers = {Level.ERROR: "2", Level.STALE: "3", Level.WARN: "1"}
    firing = 'ALERTS{{alertstate="firing", level="{}", signal!~"monitor|link"}}'
    worst = " or ".join(
        f"max by (robot, signal) ({firing.format(level.name)} * {number})" for level, number in numbers.items()
    )
    link = 'max by (robot, signal) (ALERTS{alertstate="firing", signal="link"} * 2)'
    # While a robot cannot be reached, the rules of its other signals do not claim to agree.
    worst = f"(({worst}) unless on (robot) robot_health_link_up == 0) or {link}"
    reachable = {
        robot.name: robot.series.get(f'robot_health_link_up{{robot="{robot.name}"}}', [1.0] * STEPS) for robot in robots
    }
    tests = [
        {
            "expr": worst,
            "eval_time": f"{step}s",
            "exp_samples": [
                {"labels": f'{{robot="{robot}", signal="{signal}"}}', "value": int(level)}
                for (robot, signal), level in of_step.items()
                if level is not Level.OK and (signal == "link" or reachable[robot][step])
            ],
        }
        for step, of_step in enumerate(expected)
    ]
    series = {name: values for robot in robots for name, values in robot.series.items()}
    test = {
        "rule_files": [f"{robot.name}.yaml" for robot in robots],
        "evaluation_interval": "1s",
        "tests": [
            {
                "interval": "1s",
                "input_series": [
                    {"series": name, "values": " ".join("_" if value is None else repr(value) for value in values)}
                    for name, values in series.items()
                ],
                "promql_expr_test": tests,
            }
        ],
    }
    for robot in robots:
        text = export_rules(robot.config, robots=[robot.name], interval_s=1.0).text
        (folder / f"{robot.name}.yaml").write_text(text)
    (folder / "test.yaml").write_text(json.dumps(test))
    return promtool(folder, "test", "rules", "test.yaml")


def levels_of(robots: Sequence[Robot]) -> Iterator[Dict[Tuple[str, str], Level]]:
    for step in range(STEPS):
        yield {(robot.name, name): level for robot in robots for name, level in robot.levels[step].items()}


@pytest.mark.newest_python
@needs_promtool
def test_bounds_hysteresis_and_durations_fire_when_the_monitor_does(tmp_path: Path) -> None:
    """Random timelines. A step without a sample is silence, which is no alert in these."""
    chance = random.Random(fixed_seed())
    timelines = [random_timeline(chance, f"t{number}") for number in range(150)]
    robot = Robot("r1", {each.name: each.signal for each in timelines})
    for step in range(STEPS):
        samples = {each.name: each.values[step] for each in timelines if each.values[step] is not None}
        robot.play(step, samples)
    expected = list(levels_of([robot]))
    assert {level for of_step in expected for level in of_step.values()} == {Level.OK, Level.WARN, Level.ERROR}

    findings = promtool_test(tmp_path, [robot], expected)

    assert not findings, findings[:3000]


def random_faults(chance: random.Random, name: str) -> Tuple[Dict[str, Any], List[object]]:
    """Returns a signal without durations of its bounds, and values among which some are missing or invalid."""
    signal: Dict[str, Any] = {
        "stale_after_s": 3.0,
        "startup_grace_s": chance.choice((0.0, 4.0, 6.0)),
        "invalid_for_s": chance.choice((0.0, 0.0, 2.0)),
        "warn_below": chance.choice((20.0, 21.0)),
        "error_above": chance.choice((80.0, 81.0)),
        "hysteresis": chance.choice((0.0, 2.0)),
    }
    conditions = {"is": 1.0}, {"is_not": 1.0}, {"below": 0.5}, {"above": 0.5}, {"between": [0.0, 0.5]}
    condition = chance.choice((None, *conditions))
    if condition is not None:
        signal["only_if"] = {"signal": "switch", **condition}
    values: List[object] = []
    while len(values) < STEPS:
        kind = chance.random()
        silent = bool(values) and values[-1] is None
        if kind < 0.2 and (condition is None or not silent):
            # Conditions stand still during silence, which the rules cannot express: with one, too short to be STALE.
            values += [None] * chance.randint(1, 8 if condition is None else 2)
        elif kind < 0.3:
            values.append(math.nan)
        else:
            values += [chance.choice((15.0, 21.0, 50.0, 79.0, 85.0))] * chance.randint(1, 4)
    return signal, values[:STEPS]


@pytest.mark.newest_python
@needs_promtool
def test_silence_invalid_data_conditions_and_links_alert_when_the_monitor_does(tmp_path: Path) -> None:
    chance = random.Random(fixed_seed())
    robots: List[Robot] = []
    expected: List[Dict[Tuple[str, str], Level]] = [{} for _ in range(STEPS)]
    for name in ("still", "linked"):
        faults = {f"s{number}": random_faults(chance, f"s{number}") for number in range(40)}
        switch = [value for _ in range(STEPS // 5) for value in [chance.choice((None, 0.0, 1.0, math.nan))] * 5]
        signals = {"switch": {"stale_after_s": 3.0}, **{key: signal for key, (signal, _) in faults.items()}}
        robot = Robot(name, signals)
        up = [True] * 3 + [chance.random() < 0.8 for _ in range(STEPS)]
        for step in range(STEPS):
            link = up[step // 4] if name == "linked" else None
            values = {"switch": switch[step], **{key: values[step] for key, (_, values) in faults.items()}}
            known = {key: value for key, value in values.items() if value is not None and link is not False}
            robot.play(step, known, link)
            expected[step].update({(name, key): level for key, level in robot.levels[step].items()})
        robots.append(robot)
    seen = {level for of_step in expected for level in of_step.values()}
    assert seen == set(Level)

    findings = promtool_test(tmp_path, robots, expected)

    assert not findings, findings[:3000]


@pytest.mark.newest_python
@needs_promtool
def test_forecasts_gaps_and_conditions_on_statistics_alert_when_the_monitor_does(tmp_path: Path) -> None:
    """Through /metrics. The mean of the switch differs from its latest value, on which the condition is."""
    chance = random.Random(fixed_seed())
    ahead = {"statistic": "forecast", "window_s": 10.0, "forecast_s": 10.0, "warn_below": 20.0, "for_s": 2.0}
    only_if = {"signal": "switch", "is": 1.0}
    robot = Robot(
        "r1",
        {
            "switch": {"statistic": "mean", "window_min_s": 0.0, "stale_after_s": 0.0},
            "soon": {**ahead, "stale_after_s": 0.0},
            "soon_if": {**ahead, "only_if": only_if},
            "scan_gap": {"statistic": "largest_gap_s", "window_s": 10.0, "warn_above": 2.5, "window_min_s": 3.0},
        },
    )
    for step in range(STEPS):
        charge = 20.0 + abs(25.0 - step) + chance.gauss(0.0, 0.1)
        values = {"switch": float(step // 5 % 2), "soon": charge, "soon_if": charge}
        if chance.random() < 0.5:
            values["scan_gap"] = 1.0
        robot.play(step, values)
    expected = list(levels_of([robot]))
    for name in ("soon", "soon_if", "scan_gap"):
        assert {of_step["r1", name] for of_step in expected} >= {Level.OK, Level.WARN}

    findings = promtool_test(tmp_path, [robot], expected)

    assert not findings, findings[:3000]


@pytest.mark.newest_python
@needs_promtool
def test_each_element_has_the_alerts_of_its_template(tmp_path: Path) -> None:
    """The template is a signal too: its value is the number of its elements, to which no bound applies."""
    only_if = {"signal": "cells[1]", "above": 0.5}
    robot = Robot(
        "r1",
        {
            "cells": {
                "field": "cell_voltage[*]",
                "unit": "V",
                "warn_below": 3.2,
                "error_below": 3.0,
                "hysteresis": 0.05,
                "for_s": 2.0,
                "error_for_s": 4.0,
                "stale_after_s": 3.0,
            },
            "ahead": {
                "field": 'effort["*"]',
                "statistic": "forecast",
                "window_s": 10.0,
                "forecast_s": 10.0,
                "warn_above": 30.0,
            },
            "load": {"warn_above": 1.0, "only_if": only_if, "stale_after_s": 0.0},
        },
    )
    chance = random.Random(fixed_seed())
    for step in range(STEPS):
        cells = [("0", 2.8 + step % 14 / 25.0), ("1", chance.choice((2.9, 3.1, 3.22, 3.3))), ("2", 3.3)]
        if step < 5 or 20 <= step < 30:
            cells.pop()  # an element that comes later, and becomes stale
        efforts = [("wheel left", 20.0 - abs(25.0 - step) + chance.gauss(0.0, 0.1)), ("wheel (right]", 1.0)]
        robot.play(step, {"cells": Elements(cells), "ahead": Elements(efforts), "load": 2.0})
    expected = list(levels_of([robot]))
    of_signal = {name: {of_step.get(("r1", name)) for of_step in expected} for name in ("cells[0]", "cells[2]", "load")}
    assert Level.ERROR in of_signal["cells[0]"] and Level.STALE in of_signal["cells[2]"]
    assert {of_step.get(("r1", "ahead[wheel left]")) for of_step in expected} >= {Level.OK, Level.WARN}

    findings = promtool_test(tmp_path, [robot], expected)

    assert not findings, findings[:3000]


@pytest.mark.newest_python
@needs_promtool
@pytest.mark.parametrize("stale_after_s", [0.0, 5.0])
def test_a_level_that_a_driver_reports_is_an_alert_when_the_monitor_says_so(
    tmp_path: Path, stale_after_s: float
) -> None:
    chance = random.Random(fixed_seed())
    statuses = {"type": "diagnostic_msgs/DiagnosticArray", "field": 'status["*"]', "stale_after_s": stale_after_s}
    robot = Robot("r1", {"drivers": statuses, "slow": {**statuses, "error_for_s": 3.0}})
    names = ("motor: left", "motor: right", "laser")
    levels = dict.fromkeys(names, 0)
    for step in range(STEPS):
        levels = {name: chance.choice((level, level, level, 0, 1, 2, 3)) for name, level in levels.items()}
        found = Elements((name, DriverStatus(level, "")) for name, level in levels.items())
        robot.play(step, {"drivers": found, "slow": found})
    expected = list(levels_of([robot]))
    assert {of_step.get(("r1", "drivers[laser]")) for of_step in expected} >= set(Level)

    findings = promtool_test(tmp_path, [robot], expected)

    assert not findings, findings[:3000]


def test_the_alerts_of_elements_have_the_label_of_their_series() -> None:
    text = exported({"cells": {"field": "cell_voltage[*]", "warn_below": 3.2}}).text
    rules = [rule for rule in yaml.safe_load(text)["groups"][0]["rules"] if "alert" in rule]
    (warn,) = [rule for rule in rules if rule["labels"]["level"] == "WARN"]
    signal = "{{/* cells */}}{{ $labels.signal }}"  # a comment, so that it differs between templates
    assert warn["labels"] == {"signal": signal, "level": "WARN", "severity": "warning"}
    assert warn["annotations"]["summary"].startswith(f"{{{{ $labels.robot }}}}: {signal} WARN: ")


class Scraped:
    """The series of one monitor as Prometheus stores them: a string per second, `_` for none."""

    def __init__(self, instance: str, up: str, tick: str = "", **levels: str) -> None:
        target = f'job="robots", instance="{instance}"'
        self.series = {f"up{{{target}}}": up}
        if tick:
            self.series[f"robot_health_last_tick_timestamp_seconds{{{target}}}"] = tick
        for robot, values in levels.items():
            self.series[f'robot_health_level{{robot="{robot}", signal="a", {target}}}'] = values


def missed(folder: Path, scraped: Sequence[Scraped], expected: Mapping[int, Sequence[str]]) -> str:
    """Returns promtool's findings; empty if at each of these seconds the monitors of these robots are missed."""
    (folder / "rules.yaml").write_text(exported({"a": {"warn_below": 20.0}}, interval_s=1.0).text)
    alert = 'sum by (robot, signal, level) (ALERTS{alertname="RobotHealth", alertstate="firing"})'
    labels = '{{robot="{}", signal="monitor", level="ERROR"}}'
    test = {
        "rule_files": ["rules.yaml"],
        "evaluation_interval": "1s",
        "tests": [
            {
                "interval": "1s",
                "input_series": [
                    {"series": name, "values": values} for each in scraped for name, values in each.series.items()
                ],
                "promql_expr_test": [
                    {
                        "expr": alert,
                        "eval_time": f"{second}s",
                        "exp_samples": [{"labels": labels.format(robot), "value": 1} for robot in robots],
                    }
                    for second, robots in expected.items()
                ],
            }
        ],
    }
    (folder / "test.yaml").write_text(json.dumps(test))
    return promtool(folder, "test", "rules", "test.yaml")


@needs_promtool
def test_a_monitor_that_hangs_or_is_down_is_an_alert(tmp_path: Path) -> None:
    scraped = [
        Scraped("one", "1x200", "0+1x200", works="0x200"),
        Scraped("two", "1x200", "0+1x100 100x99", hangs="0x200"),
        Scraped("three", "1x99 0x100", "0+1x99 stale", down="0x99 stale"),
        Scraped("four", "1x99 0x20 1x80", "0+1x99 stale _x20 121+1x80", back="0x99 stale _x20 0x80"),
    ]
    expected = {
        101: [],
        102: ["back", "down"],
        120: ["back", "down"],
        123: ["down"],
        130: ["down"],
        132: ["down"],
        133: ["down", "hangs"],
        199: ["down", "hangs"],
    }
    assert missed(tmp_path, scraped, expected) == ""


@needs_promtool
def test_a_robot_that_its_monitor_no_longer_reports_is_no_alert(tmp_path: Path) -> None:
    """It was taken out of the fleet file; then the monitor is stopped, for longer than Prometheus looks back."""
    scraped = [Scraped("one", "1x199 0x1000", "0+1x199 stale", kept="0x199 stale", removed="2x100 stale")]
    expected: Dict[int, List[str]] = {second: [] for second in range(90, 202)}
    expected.update({202: ["kept"], 300: ["kept"], 1100: ["kept"]})
    assert missed(tmp_path, scraped, expected) == ""


@needs_promtool
@pytest.mark.parametrize(
    "scraped",
    [
        pytest.param(Scraped("one", "1x100 stale", "0+1x100 stale", r1="0x100 stale"), id="while it was up"),
        pytest.param(Scraped("one", "1x50 0x50 stale", "0+1x50 stale", r1="0x50 stale"), id="while it was down"),
    ],
)
def test_a_robot_whose_monitor_is_no_longer_a_target_is_no_alert(tmp_path: Path, scraped: Scraped) -> None:
    assert missed(tmp_path, [scraped], {second: [] for second in (40, *range(102, 500))}) == ""


@needs_promtool
def test_a_robot_that_another_monitor_watches_as_well_is_not_missed(tmp_path: Path) -> None:
    scraped = [
        Scraped("one", "1x200", "0+1x200", r1="0x200"),
        Scraped("two", "1x100 0x100", "0+1x100 stale", r1="0x100 stale", r2="0x100 stale"),
    ]
    assert missed(tmp_path, scraped, {99: [], 110: ["r2"], 200: ["r2"]}) == ""


@needs_promtool
def test_after_a_gap_of_prometheus_itself_a_monitor_that_is_down_is_still_missed(tmp_path: Path) -> None:
    """Its robots are those of the last scrape, not one that was taken out of the fleet file before."""
    scraped = [
        Scraped("one", "1x100 _x1800 0x100", "0+1x100", r1="0x100", removed="0x50 stale"),
        Scraped("two", "1x100 _x1800 1x100", "0+1x100 _x1800 1901+1x100", r2="0x100 _x1800 0x100"),
    ]
    assert missed(tmp_path, scraped, {100: [], 1904: ["r1"], 2000: ["r1"]}) == ""


@needs_promtool
def test_the_link_alert_of_a_robot_that_is_no_longer_watched_ends_at_once(tmp_path: Path) -> None:
    """One that is restored is up for `keep_firing_for_s` of the link, 10 s, before the alert ends."""
    (tmp_path / "rules.yaml").write_text(exported({"a": {"warn_below": 20.0}}, interval_s=1.0).text)
    alert = 'sum by (robot) (ALERTS{alertname="RobotHealth", alertstate="firing", signal="link"})'
    series = {'robot_health_link_up{robot="removed"}': "0x10 stale", 'robot_health_link_up{robot="back"}': "0x10 1x100"}
    expected = {5: ["back", "removed"], 10: ["back", "removed"], 11: ["back"], 20: ["back"], 21: [], 22: []}
    test = {
        "rule_files": ["rules.yaml"],
        "evaluation_interval": "1s",
        "tests": [
            {
                "interval": "1s",
                "input_series": [{"series": name, "values": values} for name, values in series.items()],
                "promql_expr_test": [
                    {
                        "expr": alert,
                        "eval_time": f"{second}s",
                        "exp_samples": [{"labels": f'{{robot="{robot}"}}', "value": 1} for robot in robots],
                    }
                    for second, robots in expected.items()
                ],
            }
        ],
    }
    (tmp_path / "test.yaml").write_text(json.dumps(test))

    assert promtool(tmp_path, "test", "rules", "test.yaml") == ""


def test_every_signal_is_a_group_so_that_they_are_evaluated_on_all_cores() -> None:
    text = exported({"a": {"warn_below": 20.0}, "b": {"warn_above": 1.0}}).text
    groups = {group["name"]: group for group in yaml.safe_load(text)["groups"]}
    labels = {
        name: {rule["labels"]["signal"] for rule in group["rules"] if "alert" in rule} for name, group in groups.items()
    }
    assert labels == {"robot_health a": {"a"}, "robot_health b": {"b"}, "robot_health": {"link", "monitor"}}


def test_every_alert_has_the_labels_and_the_summary_of_a_notification() -> None:
    text = exported({"a": {"warn_below": 20.0, "error_above": 50.0, "error_for_s": 5.0}, "b": {"warn_above": 1.0}}).text
    rules = [rule for group in yaml.safe_load(text)["groups"] for rule in group["rules"] if "alert" in rule]
    assert {rule["alert"] for rule in rules} == {"RobotHealth"}
    assert all(set(rule["labels"]) == {"signal", "level", "severity"} for rule in rules)  # and robot, of the series
    labels = [tuple(rule["labels"].values()) for rule in rules]
    assert len(labels) == len(set(labels)) == 8
    for rule in rules:
        begin = f"{{{{ $labels.robot }}}}: {rule['labels']['signal']} {rule['labels']['level']}: "
        assert list(rule["annotations"]) == ["summary"] and rule["annotations"]["summary"].startswith(begin)


def serve_metrics(server: HttpServer, *robots: str) -> None:
    """Serves the metrics of a working monitor of these robots."""

    def behave(handler: Any) -> None:
        lines = [f"robot_health_last_tick_timestamp_seconds {time.time()}"]
        lines += [f'robot_health_level{{robot="{robot}",signal="a"}} 0' for robot in robots]
        text = "".join(f"{line}\n" for line in lines)
        handler.respond(200, text.encode(), {"Content-Type": "text/plain; version=0.0.4"})

    server.behave = behave


@pytest.mark.newest_python
@needs_prometheus
def test_at_a_real_prometheus_a_monitor_that_is_down_is_an_alert_until_it_is_no_target(tmp_path: Path) -> None:
    rules = exported({"a": {"warn_below": 20.0}}, interval_s=0.5).text
    firing = 'ALERTS{alertname="RobotHealth", alertstate="firing"}'
    with HttpServer() as server:
        target = server.url.partition("//")[2]
        serve_metrics(server, "kept", "removed")
        prometheus = PrometheusServer(tmp_path, target, rules)
        try:
            prometheus.wait_for("robot_health:reported_at", lambda found: len(found) == 2)
            serve_metrics(server, "kept")  # taken out of the fleet file
            prometheus.wait_for("robot_health:reported_at", lambda found: len(found) == 1)
            server.behave = responding(503)
            (alert,) = prometheus.wait_for(firing)
            assert (alert["metric"]["robot"], alert["metric"]["signal"]) == ("kept", "monitor")
            prometheus.scrape([])
            prometheus.wait_for(firing, lambda found: not found)
        finally:
            prometheus.close()


def test_what_promql_cannot_express_is_a_comment_at_its_rule_and_a_problem() -> None:
    export = exported(
        {
            "a": {"warn_below": 20.0, "latch": True, "repeat_s": 60.0},
            "b": {
                "warn_above": 5.0,
                "flap_detection": True,
                "statistic": "mean",
                "only_if": {"signal": "c", "is": 1.0},
            },
            "c": {"statistic": "max"},
            "d": {"statistic": "forecast", "window_s": 149.0, "forecast_s": 60.0, "error_below": 3.0},
        }
    )

    assert export.problems == [
        "a WARN: not expressed: latch: the alert ends when the rule no longer fires",
        "a WARN: not expressed: repeat_s: set repeat_interval in Alertmanager",
        "b WARN: not expressed: flap_detection: every change is an alert",
        "b WARN: not expressed: an undefined mean: the alert ends when the window has too few samples",
        "d ERROR: not expressed: an undefined forecast: the alert ends when the window has too few samples",
        "d ERROR: not expressed: a forecast from fewer than 5 scrapes in half of window_s: the monitor's counts",
    ]
    for problem in export.problems:
        assert f"      # Not expressed: {problem.partition(': not expressed: ')[2]}.\n" in export.text
