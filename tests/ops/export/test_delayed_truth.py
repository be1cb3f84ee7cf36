"""Samples that arrive hours late, with their old stamps, at the real receivers: stored once, and never paged."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
from harness.alertmanager import needs_alertmanager
from harness.prometheus_server import needs_prometheus
from harness.pushing_fleet import PASSWORD, PushingFleet, Scraped, pushing_fleet, until
from harness.remote_write import remote_write, time_series
from harness.reserved import free_port
from harness.tcp_proxy import TcpProxy
from harness.victoria_metrics import needs_victoria_metrics

from robot_health_monitor.core import load_config

pytestmark = [needs_prometheus, needs_alertmanager, pytest.mark.newest_python]
BATTERY = {"battery_level": {"unit": "%", "warn_below": 20.0, "error_below": 10.0, "stale_after_s": 0.0}}
HOUR_S, STEP_S = 3600, 15


def send(fleet: PushingFleet, robot: str, times: list[float], value: float) -> int:
    """Sends the battery's value, its announced level, and the tick of a robot's monitor; returns the answer."""
    signal = {"robot": robot, "signal": "battery_level"}
    level = 2.0 if value < 10.0 else 0.0
    tick = {"__name__": "robot_health_last_tick_timestamp_seconds", "robot": robot}
    return remote_write(
        fleet.port,
        PASSWORD,
        time_series({"__name__": "robot_health_value", **signal}, [(each, value) for each in times]),
        time_series({"__name__": "robot_health_alert_level", **signal}, [(each, level) for each in times]),
        time_series(tick, [(each, each) for each in times]),
    )


def summaries(fleet: PushingFleet, status: str) -> list[str]:
    return [
        alert["annotations"]["summary"]
        for sent in fleet.pager.sent
        for alert in sent["alerts"]
        if alert["status"] == status
    ]


@pytest.mark.parametrize(
    "centre",
    [
        pytest.param(["prometheus"], id="Prometheus"),
        pytest.param(["victoria-metrics", "vmalert"], id="VictoriaMetrics", marks=needs_victoria_metrics),
    ],
)
def test_what_an_offline_robot_delivers_6_h_later_is_stored_once_and_pages_nobody(
    tmp_path: Path, centre: list[str]
) -> None:
    config = load_config({"signals": BATTERY})
    with pushing_fleet(tmp_path, config, free_port, robots=["r1"], silent_after_s=10.0) as fleet:
        for unit in ("alertmanager", *centre):
            fleet.start(unit)
        until(lambda: summaries(fleet, "firing"), lambda: fleet.pager.sent)
        assert summaries(fleet, "firing")[0].startswith("r1: monitor ERROR: has not reported for ")

        now_s = time.time()
        late = [now_s - 6 * HOUR_S + number * STEP_S for number in range(6 * HOUR_S // STEP_S)][:-40]
        for attempt in range(2):  # an agent sends again what was not acknowledged
            for begin in range(0, len(late), 200):
                empty = 2.0 if HOUR_S <= late[begin] - late[0] < 4 * HOUR_S else 80.0
                assert send(fleet, "r1", late[begin : begin + 200], empty) == 204, attempt
        reported: list[int] = []

        def is_resolved() -> bool:
            reported.append(send(fleet, "r1", [time.time()], 80.0))
            return "r1" in str(summaries(fleet, "resolved"))

        until(is_resolved, lambda: fleet.pager.sent)
        assert set(reported) == {204}
        stored = f'count_over_time(robot_health_value{{robot="r1"}}[{7 * HOUR_S}s])'
        until(
            lambda: fleet.by_label(stored, "robot") == {("r1",): len(late) + len(reported)}, lambda: fleet.query(stored)
        )
        low = f'count_over_time((robot_health_value{{robot="r1"}} < 10)[{7 * HOUR_S}s:{STEP_S}s])'
        assert fleet.by_label(low, "robot")[("r1",)] > 500
        judged = f'count_over_time(ALERTS{{signal="battery_level"}}[{7 * HOUR_S}s])'
        assert fleet.by_label(judged, "level") == {}
        assert not any("battery_level" in summary for summary in summaries(fleet, "firing"))

        assert send(fleet, "r1", [time.time()], 2.0) == 204  # what is so now is paged at once
        until(lambda: any(each == "r1: battery_level ERROR (value 2)" for each in summaries(fleet, "firing")))


@needs_victoria_metrics
def test_what_vmagent_has_kept_on_its_disk_for_6_h_is_delivered_once_although_it_was_stopped(tmp_path: Path) -> None:
    """It scrapes 6 h of samples with their stamps at once, while the network is cut, and writes them to its queue."""
    signals, steps = 10, 6 * HOUR_S // STEP_S
    begin_ms = int((time.time() - 6 * HOUR_S) * 1000)
    lines = [
        f'robot_health_value{{robot="r1",signal="s{signal}"}} {step} {begin_ms + step * STEP_S * 1000}\n'
        for step in range(steps)
        for signal in range(signals)
    ]
    # The same at every scrape: series that end get stale markers with the stamps of their samples from this vmagent.
    robot = Scraped("".join(lines).encode)
    with pushing_fleet(tmp_path, load_config({"signals": BATTERY}), free_port) as fleet:
        proxy = TcpProxy(fleet.port)
        proxy.refusing = True
        fleet.start("victoria-metrics")
        fleet.start_agent("r1", [robot.address], unit="vmagent", port=proxy.port)
        until(lambda: robot.series, lambda: robot.series)
        fleet.stop("r1 vmagent")
        robot.stop()
        fleet.start_agent("r1", [robot.address], unit="vmagent", port=proxy.port)
        until(lambda: fleet.by_label("vector(1)"))
        stored = f"count_over_time(robot_health_value[{7 * HOUR_S}s])"
        assert fleet.by_label(stored, "signal") == {}

        proxy.refusing = False
        each = {(f"s{signal}",): float(steps) for signal in range(signals)}
        # vmagent tries again after up to a minute, the longer the network was cut.
        until(lambda: fleet.by_label(stored, "signal") == each, lambda: fleet.by_label(stored, "signal"), limit_s=180.0)
        sums = fleet.by_label(f"sum_over_time(robot_health_value[{7 * HOUR_S}s])", "signal")
        assert sums == {(f"s{signal}",): steps * (steps - 1) / 2.0 for signal in range(signals)}
        proxy.end()
    robot.end()


def test_prometheus_as_agent_sends_no_sample_older_than_its_start(tmp_path: Path) -> None:
    """Why it cannot deliver 6 h in compressed time, nor what it had before a start, nor after a clock was set back."""
    old_ms = int((time.time() - 600.0) * 1000)
    text = (
        f'robot_health_value{{robot="r1",signal="old"}} 1 {old_ms}\nrobot_health_value{{robot="r1",signal="new"}} 1\n'
    )
    robot = Scraped(text.encode)
    with pushing_fleet(tmp_path, load_config({"signals": BATTERY}), free_port) as fleet:
        fleet.start("prometheus")
        fleet.start_agent("r1", [robot.address])
        stored = f"count_over_time(robot_health_value[{HOUR_S}s])"
        until(lambda: fleet.by_label(stored, "signal").get(("new",), 0) >= 3, lambda: fleet.by_label(stored, "signal"))
        assert ("old",) not in fleet.by_label(stored, "signal")
        assert send(fleet, "r1", [old_ms / 1000.0], 1.0) == 204  # the centre would have taken it
    robot.end()


def test_samples_older_than_the_window_are_refused_for_ever_and_so_is_a_fleet_after_a_clock_in_the_future(
    tmp_path: Path,
) -> None:
    """Why agents keep less than the centre takes, and why clocks must be right: docs/fleet.md says both."""
    with pushing_fleet(tmp_path, load_config({"signals": BATTERY}), free_port) as fleet:
        fleet.start("prometheus")
        until(lambda: fleet.by_label("vector(1)"))
        now_s = time.time()
        assert send(fleet, "r1", [now_s], 80.0) == 204
        assert send(fleet, "r1", [now_s - 9.5 * HOUR_S], 80.0) == 204
        assert send(fleet, "r1", [now_s - 10.5 * HOUR_S], 80.0) == 500
        assert send(fleet, "r2", [now_s + 20 * HOUR_S], 80.0) == 204
        assert send(fleet, "r1", [now_s + 1.0], 80.0) == 500


@needs_victoria_metrics
def test_a_clock_in_the_future_does_not_stop_the_fleet_of_victoria_metrics(tmp_path: Path) -> None:
    with pushing_fleet(tmp_path, load_config({"signals": BATTERY}), free_port) as fleet:
        fleet.start("victoria-metrics")
        until(lambda: fleet.by_label("vector(1)"))
        now_s = time.time()
        assert send(fleet, "r2", [now_s + 480 * HOUR_S], 80.0) == 204
        assert send(fleet, "r1", [now_s - 0.5], 80.0) == 204
        until(lambda: fleet.by_label("robot_health_value", "robot") == {("r1",): 80.0})
