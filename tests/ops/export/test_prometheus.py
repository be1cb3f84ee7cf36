"""The exported rules, judged by Prometheus's own promtool: an alert fires while a monitor announces its level."""

from __future__ import annotations

import json
import math
import random
import time
from pathlib import Path
from typing import Any, Mapping, Sequence

import pytest
import yaml
from harness.http_server import HttpServer, responding
from harness.prometheus_server import PrometheusServer, needs_prometheus
from harness.promtool import STEPS, needs_promtool, promtool, random_timeline
from harness.seeds import fixed_seed
from harness.victoria_metrics import needs_victoria_metrics, vmalert_problem
from prometheus_client.parser import text_string_to_metric_families

from robot_health_monitor.core import ConfigError, Level, Sample, Transition
from robot_health_monitor.core.nodes import AlertSystem
from robot_health_monitor.core.nodes.outlets import Event
from robot_health_monitor.core.port.local import LocalBus
from robot_health_monitor.core.values.elements import DriverStatus, Elements
from robot_health_monitor.ops.export.prometheus import export_rules
from robot_health_monitor.ops.web.metrics import FLEET, FULL, Metrics

ODD_NAMES = ['r"1\\', "ä|b", "x.y", "R\u2013 🤖", "{{ $labels.x }}", "@ROBOTS@", "null", "$(rm -rf)", "a: b # c"]


@pytest.mark.newest_python
@needs_promtool
@needs_victoria_metrics
@pytest.mark.parametrize("robots", [(), ODD_NAMES[:1], ODD_NAMES])
def test_prometheus_and_vmalert_accept_the_same_rules_whatever_robots_are_called(
    tmp_path: Path, robots: Sequence[str]
) -> None:
    (tmp_path / "rules.yaml").write_text(export_rules(robots=robots))

    assert promtool(tmp_path, "check", "rules", "--lint-fatal", "rules.yaml") == ""
    assert vmalert_problem(tmp_path / "rules.yaml") == ""


@pytest.mark.newest_python
@needs_promtool
@pytest.mark.parametrize("name", ODD_NAMES)
def test_the_alerts_are_those_of_the_robots_that_are_named(tmp_path: Path, name: str) -> None:
    signal = "cells[{{ 1 }}]"
    series = {
        f"robot_health_alert_level{{robot={quoted(robot)}, signal={quoted(signal)}}}": "0 3"
        for robot in (name, "r", "xxy", "ä", "b")
    }
    stale = {
        "exp_labels": {"robot": name, "signal": signal, "level": "STALE", "severity": "warning"},
        "exp_annotations": {"summary": f"{name}: {signal} STALE"},
    }

    assert run_series(tmp_path, export_rules(robots=[name]), series, [("0s", []), ("1s", [stale])]) == ""


@pytest.mark.parametrize("interval_s", [0.0001, 121.0])
def test_an_interval_at_which_prometheus_does_not_see_every_series_is_refused(interval_s: float) -> None:
    with pytest.raises(ConfigError, match=r"expected an interval from 0\.1 to 120 s, got "):
        export_rules(interval_s=interval_s)


@pytest.mark.newest_python
@needs_promtool
def test_labels_are_those_of_a_notification_and_the_summary_has_the_value(tmp_path: Path) -> None:
    labels = {"robot": "r1", "signal": "battery_level"}
    series = {
        'robot_health_alert_level{robot="r1", signal="battery_level", instance="a:9090"}': "0 1 2 2",
        'robot_health_value{robot="r1", signal="battery_level", instance="a:9090"}': "25 19.5 9 9",
        'robot_health_alert_level{robot="r1", signal="link", instance="a:9090"}': "0 0 0 2",
        'robot_health_value{robot="r1", signal="link", instance="a:9090"}': "1 1 1 0",
    }
    warn = {
        "exp_labels": {**labels, "level": "WARN", "severity": "warning"},
        "exp_annotations": {"summary": "r1: battery_level WARN (value 19.5)"},
    }
    error = {
        "exp_labels": {**labels, "level": "ERROR", "severity": "critical"},
        "exp_annotations": {"summary": "r1: battery_level ERROR (value 9)"},
    }
    link = {
        "exp_labels": {**labels, "signal": "link", "level": "ERROR", "severity": "critical"},
        "exp_annotations": {"summary": "r1: link ERROR"},
    }

    assert (
        run_series(
            tmp_path, export_rules(), series, [("0s", []), ("1s", [warn]), ("2s", [error]), ("3s", [error, link])]
        )
        == ""
    )


def quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)


def run_series(folder: Path, text: str, series: Mapping[str, str], expected: Sequence[tuple[str, list[Any]]]) -> str:
    """Returns promtool's findings; empty if the alerts at these times are as expected."""
    alerts = [{"eval_time": time, "alertname": "RobotHealth", "exp_alerts": each} for time, each in expected]
    return promtool_test(folder, text, series, alert_rule_test=alerts)


def promtool_test(folder: Path, text: str, series: Mapping[str, str], **tests: Any) -> str:
    """Returns promtool's findings about rules over series whose values are a second apart."""
    (folder / "rules.yaml").write_text(text)
    values = [{"series": name, "values": each} for name, each in series.items()]
    test = {"interval": "1s", "input_series": values, **tests}
    (folder / "test.yaml").write_text(
        json.dumps({"rule_files": ["rules.yaml"], "evaluation_interval": "1s", "tests": [test]}, ensure_ascii=False)
    )
    return promtool(folder, "test", "rules", "test.yaml")


class Robot:
    """An alert_system in virtual time, and its /metrics after each second."""

    def __init__(self, name: str, signals: Mapping[str, Any], profile: str) -> None:
        self.name = name
        self._profile = profile
        self._bus = LocalBus()
        node = self._bus.node("alert_system", parameters={"robot_name": name, "signals": signals})
        self._alert_system = AlertSystem(node, {"test": self._note}, log_alerts=False)
        self._metrics = Metrics(wall_time_s=lambda: self._bus.now_s)
        self.series: dict[str, list[str]] = {}
        self._announced: dict[str, Level] = {}
        self.levels: list[dict[str, Level]] = []
        """The announced levels after each second, as its alerts had them."""

    def play(self, step: int, values: Mapping[str, object], link: bool) -> None:
        """Advances by a second: the link, then the samples, then the tick."""
        self._bus.run_due(float(step) - 1e-7)  # before the tick
        self._alert_system.observe_link(link, "refused")
        for name, value in values.items():
            self._alert_system.observe(Sample(name, value, float(step)))
        self._bus.run_until(float(step))
        self.levels.append(dict(self._announced))
        text = b"".join(self._metrics.render([self._metrics.read(self._alert_system)], self._profile)).decode()
        for family in text_string_to_metric_families(text):
            for sample in family.samples:
                labels = ", ".join(f"{name}={json.dumps(value)}" for name, value in sorted(sample.labels.items()))
                series = self.series.setdefault(f"{sample.name}{{{labels}}}", [])
                series += ["_"] * (step - len(series)) + [repr(sample.value)]
        for series in self.series.values():
            if len(series) == step:
                series.append("stale")  # it has ended

    def _note(self, event: Event) -> None:
        if isinstance(event, Transition):
            self._announced[event.signal] = event.to_level


def examples(chance: random.Random) -> dict[str, tuple[dict[str, Any], list[object]]]:
    """Returns signals with everything that delays, holds back or ends an alert, and their values; None: no sample."""
    found: dict[str, tuple[dict[str, Any], list[object]]] = {}
    for number in range(40):
        timeline = random_timeline(chance, f"t{number}")
        signal = {**timeline.signal, "stale_after_s": chance.choice((0.0, 3.0)), "latch": chance.random() < 0.3}
        if chance.random() < 0.3:
            signal.update(flap_detection=True)
        if chance.random() < 0.3:
            signal["only_if"] = {"signal": "switch", "is": 1.0}
        if chance.random() < 0.3:
            signal.update(statistic="mean", window_s=6.0, window_min_s=2.0)
        found[timeline.name] = signal, [value if chance.random() < 0.9 else math.nan for value in timeline.values]
    found["switch"] = {"stale_after_s": 3.0}, [float(step // 5 % 2) for step in range(STEPS)]
    charge: list[object] = [20.0 + abs(25.0 - step) + chance.gauss(0.0, 0.1) for step in range(STEPS)]
    found["soon"] = {"statistic": "forecast", "window_s": 10.0, "forecast_s": 10.0, "warn_below": 20.0}, charge
    pairs = [[("a", 2.8 + step % 14 / 25.0), ("b b", 3.3)] for step in range(STEPS)]
    cells: list[object] = [Elements(each[: 1 + step // 9 % 2]) for step, each in enumerate(pairs)]
    found["cells"] = {"field": "v[*]", "warn_below": 3.2, "error_below": 3.0, "stale_after_s": 3.0}, cells
    status = {"type": "diagnostic_msgs/DiagnosticArray", "field": 'status["*"]', "stale_after_s": 5.0}
    levels: list[object] = [Elements([("motor: left", DriverStatus(step // 6 % 4, "hot"))]) for step in range(STEPS)]
    found["drivers"] = status, levels
    return found


@pytest.mark.newest_python
@needs_promtool
@pytest.mark.parametrize("profile", [FULL, FLEET])
def test_the_level_of_the_rules_is_the_announced_one_at_every_step(tmp_path: Path, profile: str) -> None:
    chance = random.Random(fixed_seed())
    played = examples(chance)
    robot = Robot("r1", {name: signal for name, (signal, _) in played.items()}, profile)
    up = [chance.random() < 0.85 for _ in range(STEPS)]
    for step in range(STEPS):
        values = {name: values[step] for name, (_, values) in played.items() if values[step] is not None}
        link = up[step // 6] or step < 6
        robot.play(step, values if link else {}, link)
    assert {level for levels in robot.levels for level in levels.values()} == set(Level)
    assert {"link", "cells[b b]", "drivers[motor: left]", "soon"} <= set(robot.levels[-1])
    expected = [
        {
            "expr": 'sum by (signal, level) (ALERTS{alertstate="firing", signal!="monitor"})',
            "eval_time": f"{step}s",
            "exp_samples": [
                {"labels": f"{{signal={json.dumps(name)}, level={json.dumps(level.name)}}}", "value": 1}
                for name, level in levels.items()
                if level is not Level.OK
            ],
        }
        for step, levels in enumerate(robot.levels)
    ]

    series = {name: " ".join(values) for name, values in robot.series.items()}
    findings = promtool_test(tmp_path, export_rules(interval_s=1.0), series, promql_expr_test=expected)

    assert not findings, findings[:3000]


class Scraped:
    """The series of one monitor as Prometheus stores them: a string per second, `_` for none."""

    def __init__(self, instance: str, up: str, tick: str = "", **levels: str) -> None:
        target = f'job="robots", instance="{instance}"'
        self.series = {f"up{{{target}}}": up}
        if tick:
            self.series[f"robot_health_last_tick_timestamp_seconds{{{target}}}"] = tick
        for robot, values in levels.items():
            self.series[f'robot_health_alert_level{{robot="{robot}", signal="a", {target}}}'] = values


def missed(folder: Path, scraped: Sequence[Scraped], expected: Mapping[int, Sequence[str]]) -> str:
    """Returns promtool's findings; empty if at each of these seconds the monitors of these robots are missed."""
    (folder / "rules.yaml").write_text(export_rules(interval_s=1.0))
    alert = 'sum by (robot, signal, level) (ALERTS{alertstate="firing", signal="monitor"})'
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


@pytest.mark.newest_python
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


@pytest.mark.newest_python
@needs_promtool
def test_a_robot_that_its_monitor_no_longer_reports_is_no_alert(tmp_path: Path) -> None:
    """It was taken out of the fleet file; then the monitor is stopped, for longer than Prometheus looks back."""
    scraped = [Scraped("one", "1x199 0x1000", "0+1x199 stale", kept="0x199 stale", removed="2x100 stale")]
    expected: dict[int, list[str]] = {second: [] for second in range(90, 202)}
    expected.update({202: ["kept"], 300: ["kept"], 1100: ["kept"]})
    assert missed(tmp_path, scraped, expected) == ""


@pytest.mark.newest_python
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


@pytest.mark.newest_python
@needs_promtool
def test_a_robot_that_another_monitor_watches_as_well_is_not_missed(tmp_path: Path) -> None:
    scraped = [
        Scraped("one", "1x200", "0+1x200", r1="0x200"),
        Scraped("two", "1x100 0x100", "0+1x100 stale", r1="0x100 stale", r2="0x100 stale"),
    ]
    assert missed(tmp_path, scraped, {99: [], 110: ["r2"], 200: ["r2"]}) == ""


@pytest.mark.newest_python
@needs_promtool
def test_after_a_gap_of_prometheus_itself_a_monitor_that_is_down_is_still_missed(tmp_path: Path) -> None:
    """Its robots are those of the last scrape, not one that was taken out of the fleet file before."""
    scraped = [
        Scraped("one", "1x100 _x1800 0x100", "0+1x100", r1="0x100", removed="0x50 stale"),
        Scraped("two", "1x100 _x1800 1x100", "0+1x100 _x1800 1901+1x100", r2="0x100 _x1800 0x100"),
    ]
    assert missed(tmp_path, scraped, {100: [], 1904: ["r1"], 2000: ["r1"]}) == ""


def test_every_alert_has_the_labels_of_a_notification() -> None:
    rules = [rule for group in yaml.safe_load(export_rules())["groups"] for rule in group["rules"] if "alert" in rule]
    assert {rule["alert"] for rule in rules} == {"RobotHealth"}
    assert [tuple(rule["labels"].items()) for rule in rules] == [
        (("level", "WARN"), ("severity", "warning")),  # robot and signal are those of the series
        (("level", "ERROR"), ("severity", "critical")),
        (("level", "STALE"), ("severity", "warning")),
        (("signal", "monitor"), ("level", "ERROR"), ("severity", "critical")),
    ]


def serve_metrics(server: HttpServer, *robots: str) -> None:
    """Serves the metrics of a working monitor of these robots."""

    def behave(handler: Any) -> None:
        lines = [f"robot_health_last_tick_timestamp_seconds {time.time()}"]
        lines += [f'robot_health_alert_level{{robot="{robot}",signal="a"}} 0' for robot in robots]
        text = "".join(f"{line}\n" for line in lines)
        handler.respond(200, text.encode(), {"Content-Type": "text/plain; version=0.0.4"})

    server.behave = behave


@pytest.mark.newest_python
@needs_prometheus
def test_at_a_real_prometheus_a_monitor_that_is_down_is_an_alert_until_it_is_no_target(tmp_path: Path) -> None:
    rules = export_rules(interval_s=0.5)
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
