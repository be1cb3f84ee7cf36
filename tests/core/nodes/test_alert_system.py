"""alert_system on the in-process middleware, in virtual time."""

from __future__ import annotations

from typing import Any, Mapping

import pytest
from harness.kept_history import KeptHistory
from harness.parameters import set_parameter
from harness.port_conformance import levels_to
from harness.stage import Stage, status, values_of

from robot_health_monitor.core.nodes import AlertSystem
from robot_health_monitor.core.nodes.outlets import Event
from robot_health_monitor.core.port.local import LocalBus, LocalMiddleware
from robot_health_monitor.core.port.middleware import Severity, Timer
from robot_health_monitor.core.values.errors import ConfigError
from robot_health_monitor.core.values.faults import Fault
from robot_health_monitor.core.values.model import Level, Sample, Transition

LATCHING: Mapping[str, Any] = {
    "robot_name": "robot1",
    "signals": {"battery_level": {"warn_below": 20.0, "latch": True}, "temperature": {"warn_above": 80.0}},
}
BATTERY: Mapping[str, Any] = {"robot_name": "robot1", "signals": {"battery_level": {"unit": "%", "warn_below": 20.0}}}


@pytest.fixture
def stage() -> Stage:
    return Stage()


def test_exactly_20_percent_and_80_degrees_are_fine(stage: Stage) -> None:
    stage.alert_system({})
    stage.publish("battery_level", 20.0)
    stage.publish("temperature", 80.0)
    assert stage.log(Severity.WARN, Severity.ERROR) == []


@pytest.mark.newest_python
def test_an_hour_of_low_battery_is_one_line_and_one_alert(stage: Stage) -> None:
    alerts = stage.listen("alerts")
    stage.alert_system({"signals": {"battery_level": {"unit": "%", "warn_below": 20.0}}, "robot_name": "robot1"})
    stage.publish("battery_level", 25.0)
    for now_s in range(312, 3912):
        stage.bus.run_until(float(now_s))
        stage.publish("battery_level", 19.5)
    lines = [text for text in stage.log(Severity.WARN) if " WARN: " in text]
    assert lines == ["battery_level WARN: 19.5 % is below 20 % (was STALE for 306 s)"]
    (alert,) = [one for one in alerts if one["level"] == 1]
    assert alert["name"] == "alert_system: battery_level"
    assert alert["message"] == lines[0]
    assert alert["hardware_id"] == "robot1"


def test_reset_clears_a_latched_alert_and_says_which(stage: Stage) -> None:
    stage.alert_system(LATCHING)
    stage.publish("battery_level", 19.0)
    stage.publish("battery_level", 50.0)
    assert stage.bus.call_service("/alert_system/reset") == {"success": True, "message": "reset: battery_level"}
    assert stage.log(Severity.INFO)[-1].startswith("battery_level OK: 50")
    assert stage.bus.call_service("/alert_system/reset")["message"] == "reset: nothing was latched"


def test_a_changed_bound_is_judged_by_at_once(stage: Stage) -> None:
    _, middleware = stage.alert_system(LATCHING)
    stage.publish("temperature", 75.0)
    set_parameter(middleware, "signals.temperature.warn_above", 70.0)
    assert stage.log(Severity.WARN) == ["temperature WARN: 75 is above 70 (was OK for 0 s)"]


def test_a_contradiction_is_refused_and_the_old_bounds_stay(stage: Stage) -> None:
    _, middleware = stage.alert_system(LATCHING)
    with pytest.raises(ConfigError, match=r"signals\.battery_level\.error_below: expected at most"):
        set_parameter(middleware, "signals.battery_level.error_below", 30.0)
    stage.publish("battery_level", 25.0)
    assert stage.log(Severity.WARN, Severity.ERROR) == []


def test_a_change_of_one_signal_does_not_disturb_the_pending_duration_of_another(stage: Stage) -> None:
    signals = {"battery_level": {"warn_below": 20.0, "for_s": 3.0}, "temperature": {"warn_above": 80.0}}
    _, middleware = stage.alert_system({"signals": signals})
    stage.publish("battery_level", 19.0)
    stage.bus.run_until(2.0)
    set_parameter(middleware, "signals.temperature.warn_above", 70.0)
    stage.bus.run_until(3.0)
    assert stage.log(Severity.WARN) == ["battery_level WARN: 19 is below 20 (was OK for 3 s)"]


def test_the_robots_name_can_only_be_given_at_the_start(stage: Stage) -> None:
    _, middleware = stage.alert_system(LATCHING)
    with pytest.raises(ConfigError, match="robot_name"):
        set_parameter(middleware, "robot_name", "robot2")


def test_time_that_goes_back_is_one_info_line(stage: Stage) -> None:
    stage.alert_system(LATCHING)
    stage.bus.run_until(100.0)
    stage.bus.run_until(40.0)
    stage.bus.run_until(45.0)
    lines = [text for text in stage.log(Severity.INFO) if "went back" in text]
    assert lines == ["time went back by 59.000 s: windows, pending timers and staleness restart"]


def test_the_response_of_a_change_lists_what_changed(stage: Stage) -> None:
    _, middleware = stage.alert_system(LATCHING)
    assert set_parameter(middleware, "signals.battery_level.warn_below", 25.0) == "battery_level.warn_below: 20 -> 25"
    assert set_parameter(middleware, "signals.battery_level.warn_below", 25.0) == "nothing changed"
    signals = {"battery_level": {"warn_below": 25.0, "latch": True}, "wheel": {"warn_above": 1.0}}
    changes = middleware.set_parameters({**LATCHING, "publish_rate": 2.0, "signals": signals})
    assert changes == "publish_rate: 1 -> 2; added wheel; removed temperature"


class TestItself:
    """The status `alert_system: monitor`."""

    def monitor_status(self, stage: Stage, arrays: list[Any]) -> Any:
        return status(arrays[-1], "alert_system: monitor")

    def test_it_has_the_figures_of_the_node(self, stage: Stage) -> None:
        arrays = stage.listen("/diagnostics")
        stage.alert_system(BATTERY, self_report={"clients": lambda: 3})
        stage.bus.run_until(1.5)
        for _ in range(7):
            stage.publish("battery_level", 50.0)
        stage.bus.run_until(3.0)
        own = self.monitor_status(stage, arrays)
        values = values_of(own)
        assert (own["level"], own["message"], own["hardware_id"]) == (0, "no faults", "robot1")
        assert values.pop("version").count(".") == 2
        assert values == {
            "uptime_s": "3",
            "signals": "1",
            "published_topics": "/alerts",
            "simulated": "",
            "without_sensor": "",
            "samples_per_s": "0",  # 7 in the second before
            "dropped": "0",
            "tick_late_s": "0.000",
            "clients": "3",
            "pending_notifications": "0",
            "silenced": "0",
            "fingerprint": "c40d595e85da3536",  # sha256 of "robot1", a zero byte, and the name
        }
        assert values_of(status(arrays[-2], "alert_system: monitor"))["samples_per_s"] == "7"

    def test_a_report_that_raises_hides_no_other(self, stage: Stage) -> None:
        arrays = stage.listen("/diagnostics")
        stage.alert_system(BATTERY, self_report={"clients": lambda: 1 // 0})
        stage.bus.run_until(1.0)
        values = values_of(self.monitor_status(stage, arrays))
        assert values["clients"].startswith("unknown (ZeroDivisionError")
        assert values["signals"] == "1"

    def test_a_fault_is_one_line_one_alert_and_the_level_until_it_ends(self, stage: Stage) -> None:
        alerts, arrays = stage.listen("alerts"), stage.listen("/diagnostics")
        _, middleware = stage.alert_system({**BATTERY, "signals": {"battery_level": {"stale_after_s": 0.0}}})
        middleware.faults.report("rosbridge", "port 9090 is in use")
        middleware.faults.report("disk", "nearly full", Level.WARN)
        stage.bus.run_until(4.0)
        own = self.monitor_status(stage, arrays)
        assert (own["level"], own["message"]) == (2, "rosbridge: port 9090 is in use")
        assert values_of(own)["fault: disk"] == "nearly full"
        middleware.faults.clear("rosbridge")
        middleware.faults.clear("disk")
        stage.bus.run_until(9.0)
        assert self.monitor_status(stage, arrays)["level"] == 0
        assert stage.log(Severity.ERROR) == ["rosbridge: port 9090 is in use"]
        assert stage.log(Severity.WARN) == ["disk: nearly full"]
        assert [text for text in stage.log(Severity.INFO) if "again" in text] == [
            "rosbridge works again",
            "disk works again",
        ]
        assert [(one["name"], one["message"]) for one in alerts] == [
            ("alert_system: monitor", text)
            for text in (
                "rosbridge: port 9090 is in use",
                "disk: nearly full",
                "rosbridge works again",
                "disk works again",
            )
        ]

    def test_an_intermittent_fault_is_one_line(self, stage: Stage) -> None:
        _, middleware = stage.alert_system(BATTERY)
        for second in range(20):
            if second % 2:
                middleware.faults.report("disk", "full")
            else:
                middleware.faults.clear("disk")
            stage.bus.run_until(second + 0.5)
        assert stage.log(Severity.ERROR) == ["disk: full"]


def announced(alerts: list[Any]) -> list[str]:
    return [alert["message"] for alert in alerts]


class TestAPauseOfTheProcess:
    """SIGSTOP and SIGCONT, a debugger, a machine that swaps."""

    def test_is_one_warning_and_no_silence_of_the_robot(self, stage: Stage) -> None:
        alerts = stage.listen("alerts")
        stage.alert_system(BATTERY)
        stage.publish("battery_level", 50.0)
        stage.bus.run_until(3.0)
        stage.bus.run_due(15.0)
        stage.bus.run_until(17.0)
        assert announced(alerts) == []
        assert stage.log(Severity.WARN) == ["the monitor was stopped for 12 s"]
        stage.bus.run_until(18.0)  # 3 s before the pause, 3 s after it
        assert announced(alerts) == ["battery_level STALE: no sample for 6 s (limit 5 s) (was OK for 6 s)"]

    def test_of_3_s_or_less_between_ticks_is_none(self, stage: Stage) -> None:
        alerts = stage.listen("alerts")
        stage.alert_system(BATTERY)
        stage.publish("battery_level", 50.0)
        stage.bus.run_until(2.0)
        for now_s in (5.0, 8.0):
            stage.bus.run_due(now_s)
        assert "stopped" not in " ".join(stage.log(Severity.WARN))
        assert [text[:19] for text in announced(alerts)] == ["battery_level STALE"]

    def test_counts_for_nothing_also_if_a_sample_is_handed_over_first(self, stage: Stage) -> None:
        alerts = stage.listen("alerts")
        stage.alert_system({"signals": {"battery_level": {"warn_below": 20.0, "for_s": 5.0}}})
        stage.bus.run_until(1.0)
        stage.publish("battery_level", 15.0)  # pending from 1 s on
        stage.bus.run_until(2.0)
        stage.bus._now_s = 14.0  # the process goes on; its timers come after the message
        stage.publish("battery_level", 15.0)
        assert announced(alerts) == []
        stage.bus.run_due(14.0)
        for now_s in (15.0, 16.0, 17.0):
            stage.bus.run_until(now_s)
            stage.publish("battery_level", 15.0)
        assert announced(alerts) == []
        stage.bus.run_until(18.0)
        assert announced(alerts) == ["battery_level WARN: 15 is below 20 (was OK for 5 s)"]
        assert stage.log(Severity.WARN)[:1] == ["the monitor was stopped for 12 s"]

    def test_excuses_a_link_that_broke_meanwhile_until_the_next_attempt(self, stage: Stage) -> None:
        alerts = stage.listen("alerts")
        system, _ = stage.alert_system({"signals": {"battery_level": {"stale_after_s": 1.5}}})
        system.observe_link(True)
        stage.publish("battery_level", 50.0)
        stage.bus.run_until(1.0)
        assert not system.excuse_link()  # it broke without a pause
        stage.bus.run_due(13.0)
        assert system.excuse_link()
        stage.bus.run_until(15.0)
        system.observe_link(True)
        stage.bus.run_until(15.4)
        stage.publish("battery_level", 50.0)
        assert announced(alerts) == []
        stage.bus.run_until(16.5)
        system.observe_link(False, "refused")
        assert announced(alerts) == ["link ERROR: down: refused (was OK for 2.5 s)"]

    def test_of_a_simulator_is_none(self, stage: Stage) -> None:
        alerts = stage.listen("alerts")
        stage.alert_system(BATTERY, use_sim_time=True)
        stage.set_clock(100.0)
        stage.publish("battery_level", 50.0)
        stage.bus.run_until(30.0)
        stage.set_clock(100.1)
        stage.bus.run_until(60.0)
        assert announced(alerts) == []
        assert stage.log(Severity.WARN) == []

    def test_is_found_under_simulated_time(self, stage: Stage) -> None:
        alerts = stage.listen("alerts")
        stage.alert_system(BATTERY, use_sim_time=True)
        stage.set_clock(100.0)
        stage.publish("battery_level", 50.0)
        stage.bus.run_until(2.0)
        stage.set_clock(102.0)
        stage.bus._now_s = 14.0
        stage.set_clock(114.0)
        stage.bus.run_due(14.0)
        stage.bus.run_until(15.0)
        assert announced(alerts) == []
        assert stage.log(Severity.WARN) == ["the monitor was stopped for 12 s"]

    def test_of_a_fast_simulator_there_is_none(self, stage: Stage) -> None:
        stage.alert_system(BATTERY, use_sim_time=True)
        for step in range(10):
            stage.bus.run_until(0.1 * step)
            stage.set_clock(100.0 + 10.0 * step)  # a hundred times as fast
            stage.publish("battery_level", 50.0)
        assert "stopped" not in " ".join(stage.log(Severity.WARN))


class TestSimulatedTime:
    """A node with use_sim_time."""

    def test_no_clock_is_a_warning_after_10_s_and_every_minute(self, stage: Stage) -> None:
        events: list[Event] = []
        stage.alert_system(BATTERY, {"test": events.append}, use_sim_time=True)
        stage.bus.run_until(9.5)
        assert events == []
        stage.bus.run_until(131.0)
        assert [event.text for event in events] == [
            f"clock: use_sim_time is set, but /clock has been silent for {waited} s: no signal is judged"
            for waited in (10, 70, 130)
        ]
        assert stage.log(Severity.WARN) == [event.text for event in events]

    def test_no_clock_is_a_status_while_every_signal_is_unknown(self, stage: Stage) -> None:
        arrays = stage.listen("/diagnostics")
        stage.alert_system(BATTERY, use_sim_time=True)
        stage.bus.run_until(12.0)
        assert status(arrays[-1], "alert_system: monitor")["level"] == 1
        assert status(arrays[-1], "alert_system: battery_level")["level"] == 3
        stage.set_clock(500.0)
        stage.bus.run_until(16.0)
        assert status(arrays[-1], "alert_system: monitor")["level"] == 0
        assert stage.log(Severity.INFO)[-1] == "clock works again"

    def test_a_clock_in_time_is_no_warning(self, stage: Stage) -> None:
        stage.alert_system(BATTERY, use_sim_time=True)
        stage.bus.run_until(9.5)
        stage.set_clock(500.0)
        stage.bus.run_until(60.0)
        assert stage.log(Severity.WARN) == []

    def test_a_paused_simulator_pauses_judging_but_not_the_status(self, stage: Stage) -> None:
        arrays = stage.listen("/diagnostics")
        stage.alert_system(BATTERY, use_sim_time=True)
        stage.set_clock(500.0)
        stage.publish("battery_level", 50.0)
        stage.bus.run_until(60.0)
        assert stage.log(Severity.WARN) == []
        assert values_of(status(arrays[-1], "alert_system: monitor"))["uptime_s"] in ("59", "60")


def test_a_sample_can_be_given_without_a_topic(stage: Stage) -> None:
    levels: list[Any] = []
    alert_system, _ = stage.alert_system(BATTERY, {"test": levels_to(levels)})
    alert_system.observe(Sample("link", 0.0, 1.0))
    assert levels == [("link", "ERROR")]


def test_other_threads_read_and_reset_it_as_a_callback_would(stage: Stage) -> None:
    alert_system, middleware = stage.alert_system(LATCHING)
    stage.publish("battery_level", 19.0)
    stage.bus.run_until(3.0)
    stage.publish("battery_level", 50.0)
    assert alert_system.robot == "robot1"
    assert alert_system.read(lambda monitor, now_s: (monitor.report(now_s).overall, now_s)) == (Level.STALE, 3.0)
    assert alert_system.reset() == "reset: battery_level"
    assert alert_system.read(lambda monitor, now_s: monitor.judgements(now_s)["battery_level"].level) is Level.OK
    middleware.faults.report("disk", "full")
    assert alert_system.own_faults() == {"disk": Fault(Level.ERROR, "full")}
    assert alert_system.tick_age_s == 0.0


def test_after_a_restart_a_late_first_tick_is_no_silence(stage: Stage) -> None:
    """Other nodes of the process, and a busy machine, take longer than the startup grace until this one spins."""
    history, alerts = KeptHistory(stage), stage.listen("alerts")
    signals = {"scan": {"type": "std_msgs/Float32", "startup_grace_s": 5.0}}
    node = stage.bus.node("alert_system", parameters={"signals": signals})
    AlertSystem(node, history=history)
    stage.bus.run_due(12.0)
    stage.bus.run_until(17.0)
    assert not [text for text in announced(alerts) if "scan" in text]
    stage.bus.run_until(18.0)  # 6 s after the first tick
    assert announced(alerts)[-1].startswith("scan STALE: no sample since the start 6 s ago (limit 5 s)")


class FailingHistory:
    """A history whose every write raises."""

    keeps_samples = True

    def wall_s(self) -> float:
        return 1000.0

    def restore(self) -> Mapping[str, Any]:
        return {}

    def watched_until_s(self) -> float | None:
        return None

    def record_configuration(self, configuration: Mapping[str, Any]) -> None:
        """Works at the start."""

    def record(self, *_: object) -> None:
        raise OSError("no space left")

    save = record_reset = record_samples = record


def test_a_history_that_raises_keeps_no_alert_from_the_outlets_and_stops_no_tick() -> None:
    bus = LocalBus()
    seen: list[Event] = []
    parameters = {"signals": {"battery_level": {"warn_below": 20.0, "stale_after_s": 5.0}}}
    node = bus.node("alert_system", parameters=parameters)
    alert_system = AlertSystem(node, {"seen": seen.append}, history=FailingHistory())
    alert_system.observe(Sample("battery_level", 15.0, 0.0))
    bus.run_until(7.0)

    assert [event.to_level for event in seen if isinstance(event, Transition)] == [Level.WARN, Level.STALE]
    assert "OSError: no space left" in {fault.text for fault in node.faults.current().values()}


def test_a_history_that_raises_prevents_no_reset_and_no_change_of_thresholds() -> None:
    bus = LocalBus()
    history = FailingHistory()
    node = bus.node("alert_system", parameters={"signals": {"battery_level": {"warn_below": 20.0, "latch": True}}})
    alert_system = AlertSystem(node, history=history)
    alert_system.observe(Sample("battery_level", 15.0, 0.0))
    alert_system.observe(Sample("battery_level", 50.0, 1.0))
    assert alert_system.reset() == "reset: battery_level"
    history.record_configuration = history.record  # type: ignore[method-assign,assignment]
    assert set_parameter(node, "signals.battery_level.warn_below", 60.0) == "battery_level.warn_below: 20 -> 60"
    alert_system.observe(Sample("battery_level", 50.0, 2.0))
    assert alert_system.monitor.report(2.0).statuses["battery_level"].level is Level.WARN
    assert {"storing the reset", "storing the configuration"} <= set(node.faults.current())


def test_what_is_watched_is_logged_with_unit_and_statistic(stage: Stage) -> None:
    signals = {"camera": {"topic": "image", "field": "", "statistic": "frequency_hz", "warn_below": 27.0}}
    stage.alert_system({"signals": signals})
    assert "watching camera on /image: frequency_hz WARN below 27 Hz" in stage.log(Severity.INFO)


def test_what_is_watched_is_logged_with_the_topic_that_is_subscribed_to(stage: Stage) -> None:
    parameters = {"signals": {"odom": {}, "scan": {"topic": "lidar/scan"}}}
    remap = {"odom": "/wheel/odom"}
    AlertSystem(stage.bus.node("alert_system", namespace="robot1", parameters=parameters, remap=remap))
    assert stage.log(Severity.INFO)[-2:] == ["watching odom on /wheel/odom", "watching scan on /robot1/lidar/scan"]


@pytest.mark.parametrize(
    ("given", "defaults"),
    [
        ({}, True),
        ({"robot_name": "atlas"}, True),
        (BATTERY, False),
        ({"alert_system": {"ros__parameters": BATTERY}}, False),
        ({"robot1": {"alert_system": {"ros__parameters": BATTERY}}}, False),
    ],
    ids=["nothing", "a name", "parameters", "a whole file", "a file with a namespace"],
)
def test_only_a_node_without_signals_says_that_it_watches_the_default_ones(
    stage: Stage, given: Mapping[str, Any], defaults: bool
) -> None:
    """`rosparam load thresholds.yaml /alert_system` gives the whole file."""
    system, _ = stage.alert_system(given)
    text = "no signals configured: watching battery_level, temperature, cpu_usage"
    assert (text in stage.log(Severity.INFO)) is defaults
    assert list(system.monitor.config.signals) == (
        ["battery_level", "temperature", "cpu_usage"] if defaults else ["battery_level"]
    )


def test_a_tick_that_stops_alone_is_a_fault(stage: Stage, monkeypatch: pytest.MonkeyPatch) -> None:
    """No pause of the process: its other timers go on."""
    timers: list[Timer] = []
    create_timer = LocalMiddleware.create_timer

    def create(node: LocalMiddleware, *arguments: Any, **options: Any) -> Timer:
        timers.append(create_timer(node, *arguments, **options))
        return timers[-1]

    monkeypatch.setattr(LocalMiddleware, "create_timer", create)
    stage.alert_system(BATTERY)
    stage.bus.run_until(2.0)
    timers[0].cancel()  # the one that ticks
    stage.bus.run_until(12.0)
    assert [text for text in stage.log(Severity.WARN) if text.startswith("tick: ")] == [
        "tick: 6.0 s late (period 1 s): overloaded or suspended"  # last tick at 2 s; looked at 8 s and 9 s
    ]
