"""The dashboard: every query returns, from a real Prometheus, the data that was put in."""

from __future__ import annotations

import json
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, Iterator, Sequence

import pytest
from harness.prometheus_server import PrometheusServer, needs_prometheus

from robot_health_monitor.core import load_config
from robot_health_monitor.ops.export.grafana import export_dashboard
from robot_health_monitor.ops.export.prometheus import export_rules

SIGNALS = {
    "battery_level": {"unit": "%", "warn_below": 20.0, "error_below": 10.0, "stale_after_s": 0.0},
    "temperature": {"unit": "degC", "warn_above": 80.0},
    "motor": {"unit": "rpm", "statistic": "rate"},
    "charge_soon": {"unit": "%", "statistic": "forecast", "forecast_s": 1800.0, "warn_below": 20.0},
    "scan_gap": {"unit": "m", "statistic": "largest_gap_s"},
}
METRICS = """\
robot_health_level{robot="r1",signal="battery_level"} 1
robot_health_level{robot="r1",signal="temperature"} 0
robot_health_level{robot="r1",signal="motor"} 0
robot_health_level{robot="r1",signal="charge_soon"} 0
robot_health_level{robot="r1",signal="scan_gap"} 0
robot_health_level{robot="r2",signal="battery_level"} 2
robot_health_level{robot="r2",signal="temperature"} 3
robot_health_level{robot="r3",signal="battery_level"} 0
robot_health_alert_level{robot="r1",signal="battery_level"} 1
robot_health_alert_level{robot="r1",signal="temperature"} 0
robot_health_alert_level{robot="r2",signal="battery_level"} 2
robot_health_alert_level{robot="r2",signal="temperature"} 0
robot_health_alert_level{robot="r2",signal="link"} 2
robot_health_alert_level{robot="r3",signal="battery_level"} 0
robot_health_value{robot="r1",signal="battery_level"} 15
robot_health_value{robot="r1",signal="temperature"} 50
robot_health_value{robot="r1",signal="motor"} 7
robot_health_value{robot="r2",signal="battery_level"} 5
robot_health_value{robot="r1",signal="charge_soon"} 40
robot_health_value{robot="r1",signal="scan_gap"} 0.5
robot_health_latest{robot="r1",signal="charge_soon"} 70
robot_health_data_valid{robot="r1",signal="battery_level"} 1
robot_health_link_up{robot="r1"} 1
robot_health_link_up{robot="r2"} 0
robot_health_samples_total{robot="r1",signal="battery_level",quality="good"} 10
robot_health_samples_total{robot="r1",signal="battery_level",quality="bad"} 0
robot_health_transitions_total{robot="r1",signal="battery_level",to="WARN"} 1
robot_health_notifications_waiting 4
robot_health_last_tick_timestamp_seconds 1e9
"""


class _Target(BaseHTTPRequestHandler):
    def do_GET(self) -> None:
        self.send_response(200)
        self.send_header("Content-Type", "text/plain; version=0.0.4")
        self.end_headers()
        self.wfile.write(METRICS.encode())

    def log_message(self, *_: object) -> None:
        pass


class _Server(ThreadingHTTPServer):
    def handle_error(self, *_: object) -> None:
        """Prometheus does not wait for a late answer."""


@pytest.fixture
def prometheus(tmp_path: Path) -> Iterator[PrometheusServer]:
    target = _Server(("127.0.0.1", 0), _Target)
    thread = threading.Thread(target=target.serve_forever)
    thread.start()
    server = PrometheusServer(
        tmp_path,
        f"127.0.0.1:{target.server_port}",
        export_rules(interval_s=0.2),
    )
    yield server
    server.close()
    target.shutdown()
    thread.join()
    target.server_close()


def dashboard() -> dict[str, Any]:
    board: dict[str, Any] = json.loads(export_dashboard(load_config({"signals": SIGNALS})))
    return board


def queries() -> dict[str, str]:
    """The query of each panel, by its title, and that of a second line by its letter, with all robots selected."""
    return {
        panel["title"] + target["refId"].replace("A", ""): target["expr"]
        .replace("$robot", ".*")
        .replace("$__rate_interval", "10s")
        for panel in dashboard()["panels"]
        for target in panel["targets"]
    }


def labelled(result: Sequence[dict[str, Any]], *labels: str) -> set[tuple[Any, ...]]:
    return {(*(each["metric"].get(name) for name in labels), float(each["value"][1])) for each in result}


@pytest.mark.newest_python
@needs_prometheus
def test_every_query_returns_the_data_that_was_put_in(prometheus: PrometheusServer) -> None:
    expected: dict[str, tuple[Sequence[str], set[tuple[Any, ...]]]] = {
        "Robots": ((), {(3.0,)}),
        "Robots not OK": ((), {(2.0,)}),
        "Worst level per robot": (["robot"], {("r1", 1.0), ("r2", 2.0), ("r3", 0.0)}),
        "Worst announced level per robot": (["robot"], {("r1", 1.0), ("r2", 2.0), ("r3", 0.0)}),
        "Link": (["robot"], {("r1", 0.0), ("r2", 1.0)}),
        "battery_level": (["robot"], {("r1", 15.0), ("r2", 5.0)}),
        "battery_level: level": (["robot"], {("r1", 1.0), ("r2", 2.0), ("r3", 0.0)}),
        "temperature": (["robot"], {("r1", 50.0)}),
        "temperature: level": (["robot"], {("r1", 0.0), ("r2", 3.0)}),
        "motor": (["robot"], {("r1", 7.0)}),
        "motor: level": (["robot"], {("r1", 0.0)}),
        "charge_soon": (["robot"], {("r1", 40.0)}),
        "charge_soonB": (["robot"], {("r1", 70.0)}),
        "charge_soon: level": (["robot"], {("r1", 0.0)}),
        "scan_gap": (["robot"], {("r1", 0.5)}),
        "scan_gap: level": (["robot"], {("r1", 0.0)}),
        "Notifications waiting": ((), {(4.0,)}),
        "Samples per second": (["robot", "quality"], {("r1", "good", 0.0), ("r1", "bad", 0.0)}),
        "Alerts per hour": (["robot", "signal", "to"], {("r1", "battery_level", "WARN", 0.0)}),
    }
    of = queries()
    for title, (labels, wanted) in expected.items():
        prometheus.wait_for(
            of.pop(title), lambda found, labels=labels, wanted=wanted: labelled(found, *labels) == wanted
        )
    prometheus.wait_for(
        of.pop("Time since the last tick"), lambda found: [float(each["value"][1]) > 7e8 for each in found] == [True]
    )
    alerts = {("r1", "battery_level", "WARN", 1.0), ("r2", "battery_level", "ERROR", 1.0), ("r2", "link", "ERROR", 1.0)}
    firing = prometheus.wait_for(
        of.pop("Firing alerts"), lambda found: alerts <= labelled(found, "robot", "signal", "level")
    )
    assert {each["metric"]["alertname"] for each in firing} == {"RobotHealth"}
    assert of == {}


def test_bounds_are_the_thresholds_of_their_plot() -> None:
    panels = {panel["title"]: panel["fieldConfig"]["defaults"] for panel in dashboard()["panels"]}

    battery, temperature = panels["battery_level"], panels["temperature"]

    assert battery["thresholds"]["steps"] == [
        {"color": "red", "value": None},
        {"color": "orange", "value": 10.0},
        {"color": "transparent", "value": 20.0},
    ]
    assert temperature["thresholds"]["steps"] == [
        {"color": "transparent", "value": None},
        {"color": "orange", "value": 80.0},
    ]
    assert [panels[name]["unit"] for name in SIGNALS] == ["percent", "celsius", "suffix:rpm/s", "percent", "s"]


def test_the_plot_of_a_forecast_has_the_latest_value_and_the_time_ahead_in_its_legend() -> None:
    (panel,) = [panel for panel in dashboard()["panels"] if panel["title"] == "charge_soon"]
    assert [(target["refId"], target["legendFormat"]) for target in panel["targets"]] == [
        ("B", "{{robot}}"),
        ("A", "{{robot}} in 30 min"),
    ]


def test_panels_have_numbers_and_do_not_overlap() -> None:
    panels = dashboard()["panels"]
    cells = [
        (x, y)
        for panel in panels
        for at in [panel["gridPos"]]
        for x in range(at["x"], at["x"] + at["w"])
        for y in range(at["y"], at["y"] + at["h"])
    ]

    assert [panel["id"] for panel in panels] == list(range(1, len(panels) + 1))
    assert len(cells) == len(set(cells))
    assert max(x for x, _ in cells) == 23


def test_the_structure_is_that_of_grafanas_schema() -> None:
    """The keys and limits are those of kinds/dashboard/dashboard_kind.cue in Grafana's repository, version 36."""
    board = dashboard()

    assert board.keys() == {
        "title", "uid", "tags", "schemaVersion", "refresh", "time", "templating", "panels",
    }  # fmt: skip
    assert board["schemaVersion"] == 36
    assert 8 <= len(board["uid"]) <= 40
    assert [variable["type"] for variable in board["templating"]["list"]] == ["datasource", "query"]
    for panel in board["panels"]:
        assert panel.keys() == {
            "type", "title", "datasource", "targets", "gridPos", "options", "fieldConfig", "id",
        }  # fmt: skip
        assert panel["type"] in ("stat", "table", "state-timeline", "timeseries")
        at = panel["gridPos"]
        assert at["h"] > 0 and 0 < at["w"] <= 24 and 0 <= at["x"] < 24 and at["x"] + at["w"] <= 24
        assert panel["fieldConfig"].keys() == {"defaults", "overrides"}
        defaults = panel["fieldConfig"]["defaults"]
        assert defaults.keys() <= {"unit", "mappings", "thresholds", "custom"}
        for mapping in defaults.get("mappings", []):
            assert mapping["type"] == "value"
            assert all(result.keys() <= {"text", "color", "icon", "index"} for result in mapping["options"].values())
        if "thresholds" in defaults:
            assert defaults["thresholds"]["mode"] == "absolute"
            first, *others = [step["value"] for step in defaults["thresholds"]["steps"]]
            assert first is None and others == sorted(others)
