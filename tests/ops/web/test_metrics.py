"""Metrics, as Prometheus' own tools read them."""

from __future__ import annotations

import asyncio
import shutil
import subprocess
from functools import partial
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("prometheus_client", reason="prometheus_client, whose parser reads the metrics, is not installed")
pytest.importorskip("aiohttp", reason="aiohttp, which serves them, is not installed")

from harness.parameters import set_parameter
from harness.prometheus_server import PrometheusServer, needs_prometheus
from harness.web import Robots, Site, with_site
from prometheus_client.parser import text_string_to_metric_families

from robot_health_monitor.core.values.version import package_version
from robot_health_monitor.ops.web.metrics import Metrics

PROMTOOL = shutil.which("promtool")


def watched(robots: Robots, metrics: Metrics) -> None:
    for robot in robots.all:
        robot.outlets.add("metrics", partial(metrics.count, robot.robot))


def samples(metrics: Metrics, robots: Robots) -> dict[str, dict[Any, float]]:
    """Returns the values by metric and labels, as prometheus_client's own parser reads them."""
    parts = metrics.render([metrics.read(robot) for robot in robots.all])
    body = b"".join(parts)
    found: dict[str, dict[Any, float]] = {}
    for family in text_string_to_metric_families(body.decode("utf-8")):
        for sample in family.samples:
            key = tuple(sample.labels.values())
            assert key not in found.setdefault(sample.name, {})
            found[sample.name][tuple(sorted(sample.labels.items()))] = sample.value
    return found


def labels(**given: str) -> Any:
    return tuple(sorted(given.items()))


def test_every_metric_has_its_value() -> None:
    robots = Robots("atlas", "spot")
    metrics = Metrics(lambda: 3, robots.wall_s, lambda: 2)
    watched(robots, metrics)
    robots.observe(50.0)
    robots.at(101.0)
    robots.observe(19.0)
    robots.observe(float("nan"))
    robots.at(102.5)
    robots.all[1].observe_link(False, "refused")
    found = samples(metrics, robots)
    battery = {"robot": "atlas", "signal": "battery_level"}
    other = {"robot": "spot", "signal": "battery_level"}
    assert found["robot_health_level"] == {
        labels(**battery): 2.0,
        labels(**other): 3.0,
        labels(robot="spot", signal="link"): 2.0,
    }
    assert found["robot_health_value"] == {labels(**battery): 19.0, labels(robot="spot", signal="link"): 0.0}
    assert found["robot_health_data_valid"] == {labels(**battery): 0.0, labels(robot="spot", signal="link"): 1.0}
    assert found["robot_health_samples_total"][labels(**battery, quality="good")] == 2.0
    assert found["robot_health_samples_total"][labels(**battery, quality="bad")] == 1.0
    transitions = found["robot_health_transitions_total"]
    assert {to: transitions[labels(**battery, to=to)] for to in ("OK", "WARN", "ERROR", "STALE")} == {
        "OK": 0.0,
        "WARN": 1.0,
        "ERROR": 1.0,
        "STALE": 0.0,
    }
    assert transitions[labels(robot="spot", signal="link", to="ERROR")] == 1.0
    assert found["robot_health_link_up"] == {labels(robot="spot"): 0.0}
    assert found["robot_health_notifications_waiting"] == {(): 3.0}
    assert found["robot_health_faults"] == {(): 2.0}
    assert found["robot_health_last_tick_timestamp_seconds"] == {(): robots.wall_s()}
    assert found["robot_health_build_info"] == {labels(version=package_version()): 1.0}


def test_a_statistic_has_its_latest_value_and_a_forecast_its_time_to_the_bound() -> None:
    """80 % and half a percent less per second: 70 % at 20 s, 40 % 60 s later, 20 % 100 s later."""
    ahead = {"statistic": "forecast", "window_s": 20.0, "forecast_s": 60.0, "warn_below": 20.0, "invalid_for_s": 9.0}
    robots = Robots(signals={"soon": ahead, "load": {"statistic": "mean", "window_min_s": 0.0}, "battery": {}})
    metrics = Metrics(wall_time_s=robots.wall_s)
    for second in range(21):
        robots.at(100.0 + second)
        for signal in ("soon", "load", "battery"):
            robots.observe(80.0 - 0.5 * second, signal)
        if second == 10:
            assert set(samples(metrics, robots)["robot_health_latest"].values()) == {75.0}
            assert "robot_health_time_to_bound_seconds" not in samples(metrics, robots)
    soon, load, battery = (labels(robot="atlas", signal=signal) for signal in ("soon", "load", "battery"))
    found = samples(metrics, robots)
    assert found["robot_health_value"] == {soon: pytest.approx(40.0), load: pytest.approx(75.0), battery: 70.0}
    assert found["robot_health_latest"] == {soon: 70.0, load: 70.0}
    assert found["robot_health_time_to_bound_seconds"] == {soon: pytest.approx(100.0)}

    robots.observe(float("nan"), "soon")
    found = samples(metrics, robots)
    assert (found["robot_health_latest"], found.get("robot_health_time_to_bound_seconds")) == ({load: 70.0}, None)
    robots.observe(70.0, "soon")
    assert soon in samples(metrics, robots)["robot_health_latest"]
    robots.bus.run_until(126.0)  # stale
    assert "robot_health_latest" not in samples(metrics, robots)


def test_a_signal_of_a_robot_that_cannot_be_reached_has_no_latest_value() -> None:
    robots = Robots(signals={"load": {"statistic": "mean"}})
    metrics = Metrics(wall_time_s=robots.wall_s)
    robots.observe(1.0, "load")
    robots.all[0].observe_link(True)
    assert "robot_health_latest" in samples(metrics, robots)
    robots.all[0].observe_link(False, "refused")
    assert "robot_health_latest" not in samples(metrics, robots)


def test_the_profile_of_fleets_has_six_series_per_signal_and_the_robot_in_every_series() -> None:
    ahead = {"statistic": "forecast", "window_s": 20.0, "forecast_s": 60.0, "warn_below": 20.0}
    robots = Robots("atlas", "spot", signals={"soon": ahead, "battery": {"warn_below": 20.0}})
    metrics = Metrics(lambda: 3, robots.wall_s)
    watched(robots, metrics)
    for second in range(21):
        robots.at(100.0 + second)
        for signal in ("soon", "battery"):
            robots.observe(80.0 - 0.5 * second, signal)
    robots.bus.nodes[1].cancel_timers()
    robots.all[0].observe_link(True)
    robots.at(125.0)
    read = [metrics.read(robot) for robot in robots.all]
    found: dict[Any, int] = {}
    ticks: dict[str, float] = {}
    for family in text_string_to_metric_families(b"".join(metrics.render(read, "fleet")).decode()):
        for sample in family.samples:
            key = (sample.name, sample.labels["robot"], sample.labels.get("signal"))
            found[key] = found.get(key, 0) + 1
            if sample.name == "robot_health_last_tick_timestamp_seconds":
                ticks[sample.labels["robot"]] = sample.value
    names = {f"robot_health_{name}" for name in ("level", "alert_level", "value", "data_valid", "samples_total")}
    assert {name for name, robot, signal in found if (robot, signal) == ("atlas", "battery")} == names
    assert {name for name, robot, signal in found if (robot, signal) == ("atlas", "soon")} == {
        *names,
        "robot_health_latest",
    }
    assert found["robot_health_samples_total", "atlas", "battery"] == 2
    assert {name for name, robot, signal in found if (robot, signal) == ("atlas", None)} == {
        "robot_health_link_up",
        "robot_health_last_tick_timestamp_seconds",
    }
    assert ticks == {"atlas": robots.wall_s(), "spot": pytest.approx(robots.wall_s() - 5.0, abs=1.0)}
    assert b"robot_health_transitions_total" in b"".join(metrics.render(read))  # the full profile is as before


def test_the_age_of_the_oldest_tick_is_seen() -> None:
    robots = Robots("atlas", "spot")
    robots.bus.nodes[0].cancel_timers()
    robots.at(130.0)
    found = samples(Metrics(wall_time_s=robots.wall_s), robots)
    assert robots.wall_s() - found["robot_health_last_tick_timestamp_seconds"][()] == pytest.approx(30.0, abs=1.0)


def test_counters_go_on_when_the_configuration_changes() -> None:
    robots = Robots()
    metrics = Metrics(wall_time_s=robots.wall_s)
    watched(robots, metrics)
    robots.observe(19.0)
    before = samples(metrics, robots)
    node = robots.bus.nodes[0]
    set_parameter(node, "signals.battery_level.warn_below", 10.0)
    robots.all[0].reset()
    robots.observe(9.0)
    after = samples(metrics, robots)
    for name in ("robot_health_samples_total", "robot_health_transitions_total"):
        assert all(after[name][key] >= value for key, value in before[name].items())
    key = labels(robot="atlas", signal="battery_level", to="WARN")
    assert after["robot_health_transitions_total"][key] == before["robot_health_transitions_total"][key] + 1.0


def test_a_repeated_announcement_is_no_transition() -> None:
    robots = Robots(signals={"battery_level": {"warn_below": 20.0, "repeat_s": 1.0, "stale_after_s": 0.0}})
    metrics = Metrics(wall_time_s=robots.wall_s)
    watched(robots, metrics)
    robots.observe(19.0)
    for second in range(1, 6):
        robots.at(100.0 + second)
    key = labels(robot="atlas", signal="battery_level", to="WARN")
    assert samples(metrics, robots)["robot_health_transitions_total"][key] == 1.0


def test_names_are_escaped() -> None:
    name = 'a"b\\c<d> {e} ü'
    robots = Robots(name)
    robots.observe(50.0)
    found = samples(Metrics(wall_time_s=robots.wall_s), robots)
    assert found["robot_health_level"] == {labels(robot=name, signal="battery_level"): 0.0}


def test_without_robots_there_are_no_series_of_robots() -> None:
    robots = Robots()
    robots.all.clear()
    found = samples(Metrics(wall_time_s=robots.wall_s), robots)
    assert "robot_health_level" not in found
    assert found["robot_health_last_tick_timestamp_seconds"] == {(): robots.wall_s()}


@pytest.mark.skipif(PROMTOOL is None, reason="promtool is not installed (Debian's package prometheus)")
def test_promtool_finds_nothing() -> None:
    robots = Robots("atlas", 'a"b\\c')
    robots.observe(50.0)
    robots.all[0].observe_link(True)
    metrics = Metrics(wall_time_s=robots.wall_s)
    body = b"".join(metrics.render([metrics.read(robot) for robot in robots.all]))
    checked = subprocess.run(
        [str(PROMTOOL), "check", "metrics"], input=body, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
    )
    assert (checked.returncode, checked.stdout.decode()) == (0, "")


@pytest.mark.newest_python
@needs_prometheus
def test_a_real_prometheus_scrapes_them_with_the_token(tmp_path: Path) -> None:
    async def use(site: Site) -> None:
        site.robots.observe(19.0)
        target = f"127.0.0.1:{site.server.port}"
        prometheus = PrometheusServer(tmp_path, target, authorization="s3cret")
        loop = asyncio.get_event_loop()
        try:
            (level,) = await loop.run_in_executor(None, prometheus.wait_for, "robot_health_level")
            assert level["value"][1] == "1"
            assert level["metric"] == {
                "__name__": "robot_health_level",
                "instance": target,
                "job": "robot_health",
                "robot": "atlas",
                "signal": "battery_level",
            }
            site.robots.observe(5.0)
            query = 'robot_health_transitions_total{to="WARN"} == 1 and on (robot, signal) (robot_health_value == 5)'
            assert await loop.run_in_executor(None, prometheus.wait_for, query)
            (up,) = await loop.run_in_executor(None, prometheus.query, "up")
            assert up["value"][1] == "1"
        finally:
            prometheus.close()

    with_site(use, token="s3cret")


def test_the_announced_level_is_a_series_that_differs_from_the_true_one() -> None:
    """A link that is down hides the level of the signals and ends no alert; a signal that waits announces nothing."""
    robots = Robots("atlas", signals={"battery": {"warn_below": 20.0}, "late": {}})
    metrics = Metrics(lambda: 0, robots.wall_s)
    watched(robots, metrics)
    robots.all[0].observe_link(True)
    robots.observe(15.0, "battery")
    robots.all[0].observe_link(False)
    robots.at(101.0)
    parts = metrics.render([metrics.read(robots.all[0])])
    levels = {
        (sample.name.replace("robot_health_", ""), sample.labels["signal"]): sample.value
        for family in text_string_to_metric_families(b"".join(parts).decode())
        for sample in family.samples
        if sample.name.endswith("level")
    }
    assert levels == {
        ("level", "battery"): 3, ("level", "late"): 3, ("level", "link"): 2,
        ("alert_level", "battery"): 1, ("alert_level", "late"): 0, ("alert_level", "link"): 2,
    }  # fmt: skip


def test_a_topic_is_a_series_from_its_first_alert_on() -> None:
    robots = Robots("atlas", signals={"left": {"topic": "/wheels"}, "right": {"topic": "/wheels"}})
    metrics = Metrics(lambda: 0, robots.wall_s)
    watched(robots, metrics)

    def level() -> Any:
        found = samples(metrics, robots)["robot_health_alert_level"]
        return found.get(labels(robot="atlas", signal="/wheels"))

    for signal in ("left", "right"):
        robots.observe(1.0, signal)
    assert level() is None
    for second in range(101, 112):
        robots.at(float(second))
    assert level() == 3
    for signal in ("left", "right"):
        robots.observe(1.0, signal)
    assert level() == 0


def test_a_cause_and_its_effect_are_series_while_they_are() -> None:
    signals = {"motor": {"error_above": 90.0}, "wheel": {"warn_below": 1.0, "depends_on": ["motor"]}}
    robots = Robots("atlas", signals=signals)
    metrics = Metrics(lambda: 0, robots.wall_s)
    for value, name in ((50.0, "motor"), (5.0, "wheel"), (95.0, "motor"), (0.0, "wheel")):
        robots.at(robots.bus.now_s + 1.0)
        robots.observe(value, name)
    found = samples(metrics, robots)
    assert found["robot_health_affects"] == {labels(robot="atlas", signal="motor"): 1.0}
    assert found["robot_health_caused"] == {labels(robot="atlas", signal="wheel"): 1.0}
    robots.at(robots.bus.now_s + 1.0)
    robots.observe(50.0, "motor")
    found = samples(metrics, robots)
    assert "robot_health_affects" not in found and "robot_health_caused" not in found
