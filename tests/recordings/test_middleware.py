"""The port over recordings.

`harness/port_conformance.py` cannot run here: it publishes, listens and calls services while the node works. The
promises that a recording can keep are tested here instead.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from harness.recorded import ROS2, START_NS, Recorded, values, write_bag, write_folder, write_mcap
from mcap.writer import Writer

from robot_health_monitor.core.messages.serialized import SerializedType
from robot_health_monitor.core.nodes import AlertSystem
from robot_health_monitor.core.port.local import LogLine
from robot_health_monitor.core.port.middleware import Severity
from robot_health_monitor.core.values.errors import ConfigError, MessageError
from robot_health_monitor.core.values.field_path import ABSENT
from robot_health_monitor.core.values.model import Level, Transition
from robot_health_monitor.recordings.middleware import Player
from robot_health_monitor.recordings.reading import Recordings
from robot_health_monitor.recordings.recording import RecordingError

START_S = START_NS / 1e9
FLOAT32 = "std_msgs/Float32"
SIGNALS = {"signals": {"battery_level": {"warn_below": 20.0, "stale_after_s": 5.0}}}


def transitions(player: Player, parameters: Any = SIGNALS) -> list[tuple[float, str, Level]]:
    """Returns time since the start, signal and level of each transition of an alert_system."""
    found: list[tuple[float, str, Level]] = []

    def note(event: Any) -> None:
        if isinstance(event, Transition):
            found.append((player.wall_s - START_S, event.signal, event.to_level))

    AlertSystem(player.node("alert_system", parameters), {"test": note}, log_alerts=False)
    player.play()
    return found


def test_alert_system_judges_a_recording_at_its_times(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "a.bag", values("/battery_level", [25, 15, 15, 25]))
    assert transitions(Player(Recordings([path]))) == [
        (1.0, "battery_level", Level.WARN),
        (3.0, "battery_level", Level.OK),
    ]


def test_the_age_of_a_stamp_is_that_at_its_log_time(tmp_path: Path) -> None:
    def temperature(time_s: float, age_s: float) -> Recorded:
        stamp_ns = START_NS + round((time_s - age_s) * 1e9)
        kinds = ROS2.types
        stamp = kinds["builtin_interfaces/msg/Time"](sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
        header = kinds["std_msgs/msg/Header"](stamp=stamp, frame_id="")
        message = kinds["sensor_msgs/msg/Temperature"](header=header, temperature=20.0, variance=0.0)
        return Recorded(time_s, "/board", message)

    path = write_folder(tmp_path / "bag", [temperature(0.0, 0.25), temperature(1.0, 2.0), temperature(2.0, -1.0)])
    age = {"topic": "board", "type": "sensor_msgs/Temperature", "field": "header.stamp", "warn_above": 0.5}
    said: list[str] = []
    player = Player(Recordings([str(path)]))
    node = player.node("alert_system", {"signals": {"age": age}})
    AlertSystem(node, {"test": lambda event: said.append(getattr(event, "text", ""))}, log_alerts=False)
    player.play()
    assert said == [
        "age WARN: 2 s is above 0.5 s (was OK for 1 s)",
        "age OK: -1 s is no longer above 0.5 s, clocks differ (was WARN for 1 s)",
    ]


def test_a_silence_inside_a_recording_is_an_alert_and_its_end_is_none(tmp_path: Path) -> None:
    messages = [*values("/battery_level", [25, 25]), Recorded(20.0, "/battery_level", 25), Recorded(21.0, "/x", 1.0)]
    found = transitions(Player(Recordings([write_bag(tmp_path / "a.bag", messages)])))
    assert [level for _, _, level in found if level is not Level.OK] == [Level.STALE]
    assert next(time_s for time_s, _, level in found if level is Level.STALE) in (6.0, 7.0)


def test_a_signal_that_falls_silent_before_the_end_is_stale(tmp_path: Path) -> None:
    messages = [*values("/battery_level", [25, 25]), *values("/camera", range(30))]
    found = transitions(Player(Recordings([write_bag(tmp_path / "a.bag", messages)])))
    assert [level for _, _, level in found][-1] is Level.STALE


def test_a_sample_comes_before_a_tick_at_the_same_instant_also_at_the_end(tmp_path: Path) -> None:
    player = Player(Recordings([write_bag(tmp_path / "a.bag", values("/x", [1, 2, 3]))]))
    node = player.node("node", {})
    calls: list[Any] = []
    node.subscribe("x", FLOAT32, lambda value, now_s: calls.append((value, now_s - START_S)), field="data")
    node.create_timer(1.0, lambda now_s: calls.append(("tick", now_s - START_S)))
    player.play()
    assert calls == [(1.0, 0.0), (2.0, 1.0), ("tick", 1.0), (3.0, 2.0), ("tick", 2.0)]


def test_timers_keep_their_periods_between_messages(tmp_path: Path) -> None:
    player = Player(Recordings([write_bag(tmp_path / "a.bag", values("/x", [1, 2], period_s=2.25))]))
    calls: list[float] = []
    player.node("node", {}).create_timer(0.5, lambda now_s: calls.append(now_s - START_S))
    player.play()
    assert calls == [0.5, 1.0, 1.5, 2.0]


def test_a_timer_that_a_callback_creates_is_called(tmp_path: Path) -> None:
    player = Player(Recordings([write_bag(tmp_path / "a.bag", values("/x", [1, 2]))]))
    node = player.node("node", {})
    calls: list[float] = []
    note = lambda now_s: calls.append(now_s - START_S)  # noqa: E731
    node.subscribe("x", FLOAT32, lambda value, now_s: node.create_timer(0.25, note), field=None)
    player.play()
    assert calls == [0.25, 0.5, 0.75, 1.0]


def test_a_callback_that_raises_is_one_error_line_and_ends_nothing(tmp_path: Path) -> None:
    lines: list[LogLine] = []
    player = Player(Recordings([write_bag(tmp_path / "a.bag", values("/x", [1, 2]))]), on_log=lines.append)
    node = player.node("node", {})
    heard: list[float] = []

    def fail(value: float, now_s: float) -> None:
        heard.append(value)
        raise RuntimeError("broken")

    node.subscribe("x", FLOAT32, fail, field="data")
    node.create_timer(0.5, lambda now_s: 1 / 0)
    player.play()
    assert heard == [1.0, 2.0]
    assert [(line.severity, line.text) for line in lines] == [
        (Severity.ERROR, "RuntimeError in a callback: broken"),
        (Severity.ERROR, "ZeroDivisionError in a callback: division by zero"),
        (Severity.ERROR, "RuntimeError in a callback: broken"),
        (Severity.ERROR, "ZeroDivisionError in a callback: division by zero"),
    ]


def test_after_close_or_unsubscribe_nothing_calls_back(tmp_path: Path) -> None:
    player = Player(Recordings([write_bag(tmp_path / "a.bag", values("/x", [1, 2, 3]))]))
    leaving, closing = player.node("leaving", {}), player.node("closing", {})
    heard: list[str] = []

    def leave(value: float, now_s: float) -> None:
        heard.append("leaving")
        leaving.unsubscribe(subscription)

    def close(value: float, now_s: float) -> None:
        heard.append("closing")
        closing.close()

    subscription = leaving.subscribe("x", FLOAT32, leave)
    closing.subscribe("x", FLOAT32, close)
    closing.create_timer(0.5, lambda now_s: heard.append("tick"))
    player.play()
    assert heard == ["leaving", "closing"]


def test_names_are_resolved_in_the_namespace(tmp_path: Path) -> None:
    recordings = Recordings([write_bag(tmp_path / "a.bag", values("/robot1/battery_level", [15]))])
    assert transitions(Player(recordings, namespace="/robot1/"))[-1][1:] == ("battery_level", Level.WARN)
    assert transitions(Player(recordings)) == []
    assert Player(recordings, namespace="robot1").node("alert_system", {}).name == "/robot1/alert_system"


def test_publications_have_no_listeners(tmp_path: Path) -> None:
    node = Player(Recordings([write_bag(tmp_path / "a.bag", values("/x", [1]))])).node("node", {})
    node.advertise("alerts", FLOAT32)
    assert not node.has_listeners("alerts")
    node.publish("alerts", {"data": 1.0})
    with pytest.raises(MessageError, match="has not advertised /other"):
        node.publish("other", {})


def test_a_wrong_field_is_refused(tmp_path: Path) -> None:
    node = Player(Recordings([write_bag(tmp_path / "a.bag", values("/x", [1]))])).node("node", {})
    with pytest.raises(ConfigError, match="value"):
        node.subscribe("x", FLOAT32, lambda value, now_s: None, field="value")


def test_a_topic_that_is_not_recorded_delivers_nothing(tmp_path: Path) -> None:
    player = Player(Recordings([write_bag(tmp_path / "a.bag", values("/x", [1]))]))
    heard: list[float] = []
    player.node("node", {}).subscribe("y", FLOAT32, lambda value, now_s: heard.append(value))
    player.play()
    assert heard == []
    assert player.why_not_recorded("/x", "") == player.why_not_recorded("/x", "std_msgs/msg/Float32") == ""
    assert player.why_not_recorded("/y", FLOAT32) == "/y is not recorded"


def test_a_node_gets_the_reason(tmp_path: Path) -> None:
    messages = [*values("/battery_state", [1]), *values("/x", [1])]
    node = Player(Recordings([write_bag(tmp_path / "a.bag", messages)]), namespace="robot1").node("node", {})
    assert node.why_silent("/battery", FLOAT32) == "/battery is not recorded"
    assert node.why_silent("y", FLOAT32) == "/robot1/y is not recorded"
    assert node.why_silent("/x", "std_msgs/Int32") == "/x is recorded as std_msgs/Float32, configured as std_msgs/Int32"
    assert node.why_silent("/x", FLOAT32) is None


def test_a_topic_that_is_recorded_with_another_type_delivers_nothing(tmp_path: Path) -> None:
    player = Player(Recordings([write_bag(tmp_path / "a.bag", values("/x", [1]))]))
    heard: list[float] = []
    player.node("node", {}).subscribe("x", "std_msgs/Int32", lambda value, now_s: heard.append(value), field="data")
    player.play()
    assert heard == []
    assert player.why_not_recorded("/x", "std_msgs/Int32") == (
        "/x is recorded as std_msgs/Float32, configured as std_msgs/Int32"
    )


def test_only_watched_fields_are_decoded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where only arrivals matter, messages are counted."""
    asked: list[tuple[str, str]] = []
    real = SerializedType.field_getter

    def counted_getter(types: Any, field: str) -> Any:
        get = real(types, field)

        def counted(data: bytes) -> Any:
            asked.append((types._topic, field))
            return get(data)

        return counted

    monkeypatch.setattr(SerializedType, "field_getter", counted_getter)
    messages = [*values("/x", [1, 2]), *values("/y", [1, 2]), *values("/z", [1, 2])]
    player = Player(Recordings([write_bag(tmp_path / "a.bag", messages)]))
    node = player.node("node", {})
    arrivals: list[float] = []
    node.subscribe("x", FLOAT32, lambda value, now_s: None, field="data")
    node.subscribe("x", FLOAT32, lambda value, now_s: None, field="data")
    node.subscribe("y", FLOAT32, lambda value, now_s: arrivals.append(value), field=None)
    player.play()
    assert asked == [("/x", "data")] * 5  # once more for the first message: can it be read?
    assert arrivals == [1.0, 1.0]


def test_a_part_of_a_recording_is_played(tmp_path: Path) -> None:
    player = Player(Recordings([write_bag(tmp_path / "a.bag", values("/x", range(10)))]), from_s=3.0, to_s=5.0)
    assert player.wall_s == START_S + 3.0
    heard: list[float] = []
    player.node("node", {}).subscribe("x", FLOAT32, lambda value, now_s: heard.append(value), field="data")
    player.play()
    assert (heard, player.wall_s, player.problems) == ([3.0, 4.0, 5.0], START_S + 5.0, [])


def test_progress_goes_from_0_to_1(tmp_path: Path) -> None:
    player = Player(Recordings([write_bag(tmp_path / "a.bag", values("/x", range(11)))]))
    player.node("node", {}).subscribe("x", FLOAT32, lambda value, now_s: None)
    seen: list[float] = []
    player.play(seen.append)
    assert seen == sorted(seen)
    assert seen[-1] == 1.0


def test_a_recording_of_which_nothing_can_be_decoded_is_not_played(tmp_path: Path) -> None:
    path = write_mcap(
        tmp_path / "a.mcap", values("/x", [1, 2]), definitions={"std_msgs/msg/Float32": ("ros2msg", "float64 data")}
    )
    player = Player(Recordings([path]))
    for field in ("data", ""):
        player.node("node", {}).subscribe("x", FLOAT32, lambda value, now_s: None, field=field)
    with pytest.raises(RecordingError, match=r"a\.mcap: none of its messages on /x can be decoded"):
        player.play()


def test_a_time_in_the_far_future_does_not_run_the_timers_of_centuries(tmp_path: Path) -> None:
    player = Player(Recordings([write_bag(tmp_path / "a.bag", [*values("/x", [1]), Recorded(2e9, "/x", 2)])]))
    calls: list[float] = []
    player.node("node", {}).create_timer(1.0, calls.append)
    player.node("other", {}).subscribe("x", FLOAT32, lambda value, now_s: None)
    player.play()
    assert 86_400 <= len(calls) <= 86_402
    assert player.problems == ["no messages for more than 24 h: 1999913599 s skipped"]


class TestSimulatedTime:
    CLOCK = "rosgraph_msgs/msg/Clock"

    def clock(self, wall_s: float, sim_s: float) -> Recorded:
        seconds = int(sim_s)
        stamp = ROS2.types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=round((sim_s - seconds) * 1e9))
        return Recorded(wall_s, "/clock", ROS2.types[self.CLOCK](clock=stamp))

    def test_nodes_follow_the_recorded_clock(self, tmp_path: Path) -> None:
        messages = [self.clock(index * 0.1, 100.0 + index) for index in range(5)]
        messages += [Recorded(index * 0.1 + 0.05, "/x", float(index)) for index in range(5)]
        player = Player(
            Recordings([write_folder(tmp_path / "bag", sorted(messages, key=lambda m: m.time_s))]), use_sim_time=True
        )
        node = player.node("node", {})
        calls: list[Any] = []
        node.subscribe("x", FLOAT32, lambda value, now_s: calls.append((value, now_s)), field="data")
        node.create_timer(2.0, lambda now_s: calls.append(("tick", now_s)))
        player.play()
        assert calls == [
            (0.0, 100.0), (1.0, 101.0), ("tick", 102.0), (2.0, 102.0), (3.0, 103.0), ("tick", 104.0), (4.0, 104.0)
        ]  # fmt: skip

    def test_messages_before_the_first_time_wait_for_it(self, tmp_path: Path) -> None:
        messages = [Recorded(0.0, "/x", 1.0), self.clock(1.0, 50.0), Recorded(2.0, "/x", 2.0)]
        player = Player(Recordings([write_folder(tmp_path / "bag", messages)]), use_sim_time=True)
        calls: list[Any] = []
        player.node("node", {}).subscribe("x", FLOAT32, lambda value, now_s: calls.append((value, now_s)), field="data")
        player.play()
        assert calls == [(1.0, 50.0), (2.0, 50.0)]

    def test_a_recording_without_a_clock_is_refused(self, tmp_path: Path) -> None:
        with pytest.raises(ConfigError, match="no topic /clock"):
            Player(Recordings([write_bag(tmp_path / "a.bag", values("/x", [1]))]), use_sim_time=True)


def test_a_topic_with_many_channels_is_looked_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """To ask each channel whether its messages can be read would read the file 300 times."""
    path = tmp_path / "many.mcap"
    with path.open("wb") as stream:
        writer: Any = Writer(stream)
        writer.start("ros2", "x")
        for number in range(300):
            schema = writer.register_schema(f"a/msg/T{number}", "ros2msg", b"float64 data")
            channel = writer.register_channel("/x", "cdr", schema)
            writer.add_message(channel, 10**18 + number, b"\0\1\0\0", 10**18 + number)  # too short
        writer.finish()
    passes: list[int] = []
    real = Recordings.messages

    def counted(recordings: Recordings, targets: Any) -> Any:
        passes.append(1)
        return real(recordings, targets)

    monkeypatch.setattr(Recordings, "messages", counted)
    with Recordings([str(path)]) as recordings:
        player = Player(recordings)
        assert player.why_unreadable("/x", "", "data") == "no message on /x can be decoded"
    assert len(passes) <= 2


def test_a_message_that_cannot_be_decoded_is_a_sign_of_life(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:
        writer: Any = Writer(stream)
        writer.start("ros2", "x")
        schema = writer.register_schema("std_msgs/msg/Float32", "ros2msg", b"float32 data")
        channel = writer.register_channel("/x", "cdr", schema)
        for number, data in enumerate((b"\0\0\x80\x3f", b"\0", b"\0\0\0\x40")):
            time_ns = 10**18 + number
            writer.add_message(channel, time_ns, b"\0\1\0\0" + data, time_ns)
        writer.finish()
    heard: list[Any] = []
    with Recordings([str(path)]) as recordings:
        player = Player(recordings)
        player.node("node", {}).subscribe("x", FLOAT32, lambda value, now_s: heard.append(value), field="data")
        player.play()
        assert heard == [1.0, ABSENT, 2.0]
        assert player.problems == ["/x: 1 message could not be decoded and was left out"]
