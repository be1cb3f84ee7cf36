"""Operations: what an ops.yaml adds to alert_systems. Without ROS: nodes on the in-process middleware."""

from __future__ import annotations

import threading
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any, Callable, Iterator

import pytest
from harness.histories import texts
from harness.http_server import HttpServer
from harness.line_process import LineProcess
from harness.waiting import wait_for

from robot_health_monitor.cli.operations import Operations, configured_ops, read_config
from robot_health_monitor.core import Level
from robot_health_monitor.core.nodes.outlets import Event
from robot_health_monitor.core.port.local import LocalBus
from robot_health_monitor.core.port.middleware import Severity
from robot_health_monitor.core.values.errors import ConfigError
from robot_health_monitor.core.values.model import Transition
from robot_health_monitor.ops.configuration import HistorySettings, OpsConfig, TargetSettings
from robot_health_monitor.ops.store import queries
from robot_health_monitor.ops.store.database_file import reading
from robot_health_monitor.ops.store.matchers import parse_matchers

Start = Callable[..., LineProcess]
SIGNALS = {"battery_level": {"type": "std_msgs/Float32", "warn_below": 20.0}}


class Robot:
    """A robot whose battery_level is published here."""

    def __init__(self, operations: Operations, name: str = "r3", only: bool = False, signals: Any = SIGNALS) -> None:
        self.lines: list[Any] = []
        self.bus = LocalBus(on_log=self.lines.append)
        self.events: list[Event] = []
        self.node = self.bus.node("alert_system", parameters={"robot_name": name, "signals": signals})
        start = operations.start_only if only else operations.start
        self.alert_system = start(self.node, {"test": self.events.append})
        self.sensor = self.bus.node("sensor")
        self.sensor.advertise("battery_level", "std_msgs/Float32")

    def publish(self, percent: float) -> None:
        self.sensor.publish("battery_level", {"data": percent})

    @property
    def announced(self) -> list[Level]:
        return [event.to_level for event in self.events if isinstance(event, Transition)]

    def statuses(self) -> dict[str, dict[str, str]]:
        """Returns the values of every status that is published within a second, by name."""
        found: dict[str, dict[str, str]] = {}

        def note(message: Any, now_s: float) -> None:
            for status in message["status"]:
                found[status["name"]] = {pair["key"]: pair["value"] for pair in status["values"]}

        listener = self.bus.node("listener")
        listener.subscribe("/diagnostics", "diagnostic_msgs/DiagnosticArray", note)
        self.bus.run_until(self.bus.now_s + 2.0)
        listener.close()
        return found


@pytest.fixture
def config(tmp_path: Path) -> OpsConfig:
    return OpsConfig(HistorySettings(str(tmp_path / "history.db")))


@pytest.fixture
def operations(config: OpsConfig) -> Iterator[Operations]:
    with closing(Operations(config)) as opened:
        yield opened


def test_other_targets_are_used_at_once_and_nothing_is_lost_or_sent_twice(config: OpsConfig) -> None:
    with HttpServer() as server:

        def target(name: str, path: str) -> TargetSettings:
            return TargetSettings(name, "webhook", url=f"{server.url}/{path}")

        def paths(number: int) -> list[str]:
            return sorted(server.next().path for _ in range(number))

        first = replace(config, notify=(target("pager", "old"), target("chat", "chat")))
        with closing(Operations(first)) as operations:
            robot = Robot(operations)
            robot.publish(10.0)
            assert paths(2) == ["/chat", "/old"]
            wait_for(lambda: operations.notifier.waiting == 0)
            assert operations.use(first) == []
            more = (target("pager", "new"), target("chat", "chat"), target("late", "late"))
            assert operations.use(replace(config, notify=more)) == ["notify: other targets"]
            assert paths(1) == ["/late"]  # the alert is open, and this target does not know it
            robot.publish(50.0)
            assert paths(3) == ["/chat", "/late", "/new"]
            wait_for(lambda: operations.notifier.waiting == 0)
            dead = TargetSettings("dead", "webhook", url="http://127.0.0.1:1")
            operations.use(replace(config, notify=(dead, target("chat", "chat"))))
            wait_for(lambda: operations.notifier.waiting == 0)
            robot.publish(10.0)
            assert paths(1) == ["/chat"]
            wait_for(operations.faults.current)
            operations.use(config)
            wait_for(lambda: not operations.faults.current())  # those of a target that is gone are gone
            robot.publish(50.0)
            robot.alert_system.close()
        assert server.all() == []


def test_the_silence_of_a_cause_covers_its_effects(operations: Operations) -> None:
    wheels = {"wheel": {"type": "std_msgs/Float32", "depends_on": ["battery_level"], "stale_after_s": 0.0}}
    signals = {"battery_level": {**SIGNALS["battery_level"], "error_below": 10.0, "stale_after_s": 0.0}}
    robot = Robot(operations, signals={**wheels, **signals})
    robot.publish(5.0)
    operations.silences.add(parse_matchers("signal=battery_level"), until_resolved=True, reason="empty")
    robot.bus.run_until(2.0)
    assert operations.silence_text("r3", "wheel") == "empty (until resolved)"
    assert robot.statuses()["alert_system: wheel"]["silenced"] == "empty (until resolved)"
    robot.publish(50.0)
    assert operations.silence_text("r3", "wheel") is None


def test_without_an_ops_yaml_the_history_is_in_memory() -> None:
    with closing(Operations(read_config(""))) as operations:
        robot = Robot(operations, only=True)
        robot.publish(10.0)
        assert operations.history.file is None and operations.config.server is None
        [alert] = [event for event in robot.events if isinstance(event, Transition)]
        assert texts(operations.history) == [alert.text]
        assert operations.silence_text("r3", "battery_level") is None
        [line] = [line for line in robot.lines if "history" in line.text]
        assert line.severity is Severity.INFO
        assert "in memory" in line.text
        assert not [line for line in robot.lines if line.text.startswith("operations")]


def test_a_restarted_monitor_does_not_announce_an_open_alert_again(config: OpsConfig) -> None:
    with closing(Operations(config)) as operations:
        robot = Robot(operations)
        robot.publish(10.0)
        assert robot.announced == [Level.WARN]
        robot.alert_system.close()
    with closing(Operations(config)) as operations:
        robot = Robot(operations)
        robot.publish(10.0)
        assert robot.announced == []
        robot.publish(50.0)
        assert robot.announced == [Level.OK]


def test_all_robots_share_one_history(config: OpsConfig, operations: Operations) -> None:
    for name in ("r3", "r4"):
        Robot(operations, name).publish(10.0)
    assert config.history is not None
    with reading(config.history.file) as connection:
        assert [(stored.robot, stored.to_level) for stored in queries.transitions(connection)] == [
            ("r3", Level.WARN),
            ("r4", Level.WARN),
        ]


def test_what_is_in_use_is_one_line_in_the_log(config: OpsConfig, operations: Operations) -> None:
    robot = Robot(operations, only=True)
    assert config.history is not None
    assert [line.text for line in robot.lines if "operations" in line.text] == ["operations: history"]


def test_a_silenced_alert_is_announced_and_marked(operations: Operations) -> None:
    robot = Robot(operations)
    operations.silences.add(parse_matchers("robot=r3,signal=battery*"), for_s=60.0, reason="fan is being replaced")
    robot.publish(10.0)
    assert robot.announced == [Level.WARN]
    statuses = robot.statuses()
    assert statuses["alert_system: battery_level"]["silenced"].startswith("fan is being replaced (until 20")
    assert statuses["alert_system: monitor"]["silenced"] == "1"
    assert operations.count_silenced() == 1
    operations.silences.expire(1)
    statuses = robot.statuses()
    assert "silenced" not in statuses["alert_system: battery_level"]
    assert statuses["alert_system: monitor"]["silenced"] == "0"


def test_a_silence_that_matches_nothing_that_is_wrong_is_not_counted(operations: Operations) -> None:
    robot = Robot(operations)
    operations.silences.add(parse_matchers("robot=*"), for_s=60.0)
    robot.publish(50.0)
    assert operations.count_silenced() == 0


def test_a_robot_that_is_removed_leaves_the_others_alone(operations: Operations) -> None:
    removed, kept = Robot(operations, "r3"), Robot(operations, "r4")
    operations.end_robot("r3")
    removed.publish(10.0)
    kept.publish(10.0)
    assert kept.announced == [Level.WARN]
    operations.end_robot("r3")


def test_a_robot_that_is_started_anew_continues_its_alert(operations: Operations) -> None:
    Robot(operations).publish(10.0)
    second = Robot(operations)
    second.publish(10.0)
    assert second.announced == []


def test_a_wrong_configuration_of_a_robot_is_an_error_and_it_can_be_started_again(operations: Operations) -> None:
    node = LocalBus().node("alert_system", parameters={"robot_name": "r3", "signals": {}})
    with pytest.raises(ConfigError, match=r"^signals: expected at least one signal, got none; `robot-health init`"):
        operations.start(node)
    robot = Robot(operations)
    robot.publish(10.0)
    assert robot.announced == [Level.WARN]


def test_a_history_that_cannot_be_opened_is_a_fault_and_alerts_are_announced(tmp_path: Path) -> None:
    (tmp_path / "history.db").mkdir()
    with closing(Operations(OpsConfig(HistorySettings(str(tmp_path / "history.db"))))) as operations:
        robot = Robot(operations, only=True)
        robot.publish(10.0)
        assert robot.announced == [Level.WARN]
        assert "history" in robot.node.faults.current()


def test_the_end_does_not_wait_for_a_disk_that_hangs(config: OpsConfig) -> None:
    operations = Operations(config)
    hung = threading.Event()
    assert operations.history is not None
    operations.history.put(lambda connection: hung.wait(30.0))
    operations.close()
    assert not hung.is_set()  # the disk still hangs, and we are here
    hung.set()


def test_a_wrong_ops_yaml_is_an_error_before_anything_is_opened(tmp_path: Path) -> None:
    file = tmp_path / "ops.yaml"
    file.write_text("history: {file: history.db, keep_days: -1}\n")
    with pytest.raises(ConfigError, match=r"ops\.yaml:1: history\.keep_days: expected a number from "):
        read_config(str(file))
    assert not (tmp_path / "history.db").exists()


@pytest.mark.parametrize(("parameter", "file"), [("", ""), (" ", ""), ("/etc/ops.yaml", "/etc/ops.yaml"), (3, "")])
def test_the_path_may_be_a_parameter(parameter: object, file: str) -> None:
    assert configured_ops({"ops": parameter}) == file
    assert configured_ops({}) == ""


def test_a_heartbeat_is_fed_while_every_robot_is_monitored(monkeypatch: pytest.MonkeyPatch) -> None:
    target = TargetSettings("alive", "heartbeat", url="http://127.0.0.1:9/", timeout_s=1.0)
    with closing(Operations(OpsConfig(notify=(target,)), clock=lambda: robot.bus.now_s)) as operations:
        assert operations.notifier is not None
        fed: list[float] = []
        monkeypatch.setattr(operations.notifier, "note_tick", lambda: fed.append(robot.bus.now_s))
        robot, other = Robot(operations, "r3"), Robot(operations, "r4")
        robot.bus.run_until(3.5)
        assert fed == [1.0, 2.0, 3.0]
        monkeypatch.setattr(type(other.alert_system), "tick_age_s", 6.0)
        robot.bus.run_until(6.5)
        assert fed == [1.0, 2.0, 3.0]


def test_waiting_notifications_are_shown() -> None:
    target = TargetSettings("horn", "command", command=("/bin/false",))
    with closing(Operations(OpsConfig(notify=(target,)))) as notifying:
        robot = Robot(notifying)
        robot.publish(10.0)
        assert notifying.notifier is not None
        wait_for(lambda: notifying.notifier.waiting)  # it is queued in another thread
        assert robot.statuses()["alert_system: monitor"]["pending_notifications"] == "1"
