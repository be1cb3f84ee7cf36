"""`robot-health suggest`: from a recording to a file that `check` accepts and that raises no alert on a replay."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any, Callable, Sequence

import pytest
from harness.line_process import LineProcess

pytest.importorskip("rosbags")

from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore

from robot_health_monitor.core import load_config

Start = Callable[..., LineProcess]
STORE = get_typestore(Stores.ROS1_NOETIC)


@pytest.fixture
def robot_health(robot_health_here: Start) -> Start:
    return robot_health_here


def write_bag(file: Path, topics: Sequence[Any], start_s: float = 1e9) -> Path:
    """Writes a bag of (topic, type, messages as values of `data` or tuples of their fields, interval in s)."""
    messages: list[Any] = []
    with Writer(file) as writer:
        for topic, name, values, interval_s in topics:
            type_name = name if "/" in name else f"std_msgs/msg/{name}"
            connection = writer.add_connection(topic, type_name, typestore=STORE)
            for number, value in enumerate(values):
                content = value if isinstance(value, tuple) else (value,)
                data = STORE.serialize_ros1(STORE.types[type_name](*content), type_name)
                messages.append((start_s + number * interval_s, connection, data))
        for time_s, connection, data in sorted(messages, key=lambda each: each[0]):
            writer.write(connection, round(time_s * 1e9), bytes(data))
    return file


TRIANGLE = [40.0 + 0.02 * (each if each < 500 else 1000 - each) for each in range(1000)]


def out(process: LineProcess) -> list[str]:
    return [line.text for line in process.lines if line.stream == "out"]


def test_a_file_with_evidence_that_check_accepts(robot_health_process: Start, tmp_path: Path) -> None:
    topics = [("/battery", "Float64", TRIANGLE, 1.0), ("/count", "Int32", range(1000), 1.0)]
    bag = write_bag(tmp_path / "healthy.bag", topics)
    process = robot_health_process("suggest", bag)
    assert process.wait() == 0, process.text
    assert out(process) == [
        "# Suggested by `robot-health suggest` from 16 min 39 s of recordings: healthy.bag",
        "# Replayed with these thresholds, the recordings raise 0 alerts.",
        "# The bounds are those of WARN: recordings of healthy robots do not show where errors begin.",
        "# docs/statistics.md explains how each value is computed. Review before use.",
        "alert_system:",
        "  ros__parameters:",
        "    signals:",
        "      battery_rate:",
        "        # 1,000 samples in 16 min 39 s",
        "        topic: battery",
        "        type: std_msgs/Float64",
        "        field: ''",
        "        statistic: frequency_hz",
        "        warn_below: 0.8             # Hz; 0 alerts; lowest 1 Hz; margin 20 %",
        "        warn_above: 1.2             # Hz; 0 alerts; highest 1 Hz; margin 20 %",
        "        stale_after_s: 5.0          # s; 0 alerts; longest gap 1 s, median 1 s",
        "      battery:",
        "        # 1,000 samples in 16 min 39 s",
        "        topic: battery",
        "        type: std_msgs/Float64",
        "        field: data",
        "        warn_below: 39.0            # 0 alerts; 0.1 % of the samples are below 40.02, lowest 40; margin 0.996",
        "        warn_above: 51.0            # 0 alerts; 0.1 % of the samples are above 49.98, "
        "highest 50; margin 0.996",
        "        hysteresis: 0.02            # 95 % of the steps between samples are at most 0.02",
        "        stale_after_s: 5.0          # s; 0 alerts; longest gap 1 s, median 1 s",
        "      count_rate:",
        "        # 1,000 samples in 16 min 39 s",
        "        topic: count",
        "        type: std_msgs/Int32",
        "        field: ''",
        "        statistic: frequency_hz",
        "        warn_below: 0.8             # Hz; 0 alerts; lowest 1 Hz; margin 20 %",
        "        warn_above: 1.2             # Hz; 0 alerts; highest 1 Hz; margin 20 %",
        "        stale_after_s: 5.0          # s; 0 alerts; longest gap 1 s, median 1 s",
        "      # /count, data: no bounds: the value only rises: looks like a counter",
    ]
    suggested = tmp_path / "suggested.yaml"
    suggested.write_text("\n".join(out(process)))
    assert robot_health_process("check", suggested).wait() == 0
    assert robot_health_process("replay", bag, "--thresholds", suggested).wait() == 0


@pytest.mark.newest_python
def test_healthy_excursions_give_a_duration(robot_health: Start, tmp_path: Path) -> None:
    values = TRIANGLE * 5
    values[1300:1303] = [90.0] * 3
    process = robot_health("suggest", write_bag(tmp_path / "a.bag", [("/battery", "Float64", values, 1.0)]))
    assert process.wait() == 0, process.text
    assert "        for_s: 4.5                  # s; longest healthy excursion beyond a bound 3 s" in out(process)
    assert out(process)[1] == "# Replayed with these thresholds, the recordings raise 0 alerts."


@pytest.mark.newest_python
def test_alerts_that_the_suggestion_raises_are_counted(robot_health: Start, tmp_path: Path) -> None:
    # battery ends after 1,000 s, the other topic lasts for 2,000 s.
    topics = [("/battery", "Float64", TRIANGLE, 1.0), ("/other", "Float64", TRIANGLE * 2, 1.0)]
    process = robot_health("suggest", write_bag(tmp_path / "a.bag", topics))
    assert process.wait() == 0, process.text
    # The number and the arrival of its messages are of one topic.
    assert out(process)[1] == "# Replayed with these thresholds, the recordings raise 1 alert."
    assert "        stale_after_s: 5.0          # s; 1 alert; longest gap 1 s, median 1 s" in out(process)


@pytest.mark.newest_python
def test_a_forecast_is_watched_that_is_silent_in_the_recordings_and_a_comment_if_it_alerts(
    robot_health: Start, tmp_path: Path
) -> None:
    """Of the two motors, `b` gets 1 degree hotter per minute, which is a line through 80 degrees within 30 minutes."""
    header = STORE.types["std_msgs/msg/Header"](0, STORE.types["builtin_interfaces/msg/Time"](0, 0), "")
    flat = [(header, 45.0 + number % 2, 0.0) for number in range(1500)]
    rising = [(header, 45.0 + number / 60.0, 0.0) for number in range(1500)]
    topics = [(topic, "sensor_msgs/msg/Temperature", values, 1.0) for topic, values in (("/a", flat), ("/b", rising))]
    process = robot_health("suggest", write_bag(tmp_path / "a.bag", topics))
    assert process.wait() == 0, process.text
    assert out(process)[1] == "# Replayed with these thresholds, the recordings raise 0 alerts."
    start = out(process).index("      a_temperature_soon:")
    assert out(process)[start + 1 : start + 12] == [
        "        # 1,500 samples in 24 min 59 s",
        "        topic: a",
        "        type: sensor_msgs/Temperature",
        "        field: temperature",
        "        unit: degC",
        "        statistic: forecast",
        "        window_s: 600.0",
        "        forecast_s: 1800.0",
        "        warn_above: 80.0            # degC; 0 alerts; the value in 30 min",
        "        for_s: 300.0                # s; half of the window: noise that looks like a trend is no alert",
        "        stale_after_s: 5.0          # s; 0 alerts; longest gap 1 s, median 1 s",
    ]
    (comment,) = [line for line in out(process) if "b_temperature_soon" in line]
    assert comment.startswith("      # b_temperature_soon: {topic: b, type: sensor_msgs/Temperature,")
    assert comment.endswith(
        "warn_above: 80.0, for_s: 300.0, stale_after_s: 5.0}  # seen 45 to 69.98 degC in 24 min 59 s"
    )
    assert "      b_temperature:" in out(process)


def test_recordings_of_several_days_are_no_silence(robot_health: Start, tmp_path: Path) -> None:
    topics = [("/battery", "Float64", TRIANGLE, 1.0)]
    first, second = write_bag(tmp_path / "a.bag", topics), write_bag(tmp_path / "b.bag", topics, 1e9 + 1e6)
    process = robot_health("suggest", second, first)
    assert process.wait() == 0, process.text
    assert out(process)[1] == "# Replayed with these thresholds, the recordings raise 0 alerts."
    assert "        # 2,000 samples in 33 min 18 s" in out(process)


def test_suggestions_for_the_signals_of_a_file(robot_health: Start, tmp_path: Path) -> None:
    thresholds = tmp_path / "thresholds.yaml"
    thresholds.write_text(
        "alert_system:\n  ros__parameters:\n    robot_name: husky\n    signals:\n"
        "      charge: {topic: battery, unit: '%', scale: 2.0, warn_below: 5.0, error_below: 1.0, latch: true}\n"
        "      arm: {warn_above: 3.0, stale_after_s: 9.0}\n"
    )
    bag = write_bag(tmp_path / "a.bag", [("/battery", "Float64", TRIANGLE, 1.0), ("/other", "Float64", TRIANGLE, 1.0)])
    process = robot_health("suggest", bag, "--thresholds", thresholds)
    assert process.wait() == 0, process.text
    suggested = tmp_path / "suggested.yaml"
    suggested.write_text("\n".join(out(process)))
    config = load_config(suggested)
    assert config.robot_name == "husky"
    assert list(config.signals) == ["charge", "arm"]
    charge, arm = config.signals["charge"], config.signals["arm"]
    # 80.04 - 1.992 and 99.96 + 1.992, outward to whole numbers; the latter is beyond 100 %.
    assert (charge.scale, charge.latch, charge.bounds) == (2.0, True, {"warn_below": 5.0, "error_below": 1.0})
    (given,) = [line for line in out(process) if line.startswith("        warn_below: 5.0")]
    assert "# %; given; 0 alerts; suggested: 78.0; 0.1 % of the samples are below 80.04 %, lowest 80 %" in given
    assert (arm.bounds, arm.stale_after_s) == ({"warn_above": 3.0}, 9.0)
    assert "        # no warn_above: 102 is not below 100, the limit of its values" in out(process)
    assert "        # no message: unchanged" in out(process)


@pytest.mark.newest_python
def test_namespaces(robot_health: Start, tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "a.bag", [(f"/r1/{name}", "Float64", TRIANGLE, 1.0) for name in ("battery", "2d")])
    for arguments, names, topics in (
        ([], ["r1_2d_rate:", "r1_2d:", "r1_battery_rate:", "r1_battery:"], ["r1/2d", "r1/battery"]),
        (["--namespace", "r1"], ["r1_2d_rate:", "r1_2d:", "battery_rate:", "battery:"], ["/r1/2d", "battery"]),
    ):
        process = robot_health("suggest", bag, *arguments)
        assert process.wait() == 0, process.text
        assert [line.split()[0] for line in out(process) if re.match(r" {6}\w", line)] == names
        assert [line.split()[1] for line in out(process) if "topic:" in line][::2] == topics


@pytest.mark.newest_python
def test_the_output_is_the_same_in_every_run(robot_health_process: Start, tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "a.bag", [("/battery", "Float64", TRIANGLE * 20, 0.1)])
    runs = [robot_health_process("suggest", bag) for _ in range(2)]
    assert [run.wait() for run in runs] == [0, 0]
    assert out(runs[0]) == out(runs[1])


def test_recordings_without_a_signal_are_one_line(robot_health: Start, tmp_path: Path) -> None:
    process = robot_health("suggest", write_bag(tmp_path / "a.bag", [("/rosout_agg", "Byte", [0] * 3, 1.0)]))
    assert process.wait() == 2
    assert [line.stream for line in process.lines] == ["err"]
    assert process.lines[0].text.startswith(
        "robot-health suggest: nothing to watch: /rosout_agg: a topic of the middleware"
    )


def test_a_file_of_signals_that_are_not_recorded_stays_as_it_is(robot_health: Start, tmp_path: Path) -> None:
    file = tmp_path / "thresholds.yaml"
    file.write_text("alert_system: {ros__parameters: {signals: {arm: {warn_above: 3.0}}}}\n")
    bag = write_bag(tmp_path / "a.bag", [("/battery", "Float64", TRIANGLE, 1.0)])
    process = robot_health("suggest", bag, "--thresholds", file)
    assert process.wait() == 0, process.text
    assert "        # no message: unchanged" in out(process)
    (tmp_path / "suggested.yaml").write_text("\n".join(out(process)))
    assert load_config(tmp_path / "suggested.yaml").signals["arm"].bounds == {"warn_above": 3.0}


def test_a_signal_may_depend_on_one_that_is_not_recorded(robot_health: Start, tmp_path: Path) -> None:
    thresholds = tmp_path / "thresholds.yaml"
    thresholds.write_text(
        "alert_system: {ros__parameters: {signals: {battery: {warn_below: 5.0, depends_on: [arm]}, "
        "arm: {}, cell: {topic: battery, warn_below: 5.0, only_if: {signal: arm, above: 1.0}}}}}\n"
    )
    bag = write_bag(tmp_path / "a.bag", [("/battery", "Float64", TRIANGLE, 1.0)])
    process = robot_health("suggest", bag, "--thresholds", thresholds)
    assert process.wait() == 0, process.text
    (tmp_path / "suggested.yaml").write_text("\n".join(out(process)))
    config = load_config(tmp_path / "suggested.yaml")
    assert list(config.signals) == ["battery", "arm", "cell"]
    assert config.signals["battery"].depends_on == ("arm",)


def test_a_file_that_is_no_recording_is_one_line(robot_health: Start, tmp_path: Path) -> None:
    process = robot_health("suggest", tmp_path / "none.bag")
    assert process.wait() == 2
    assert [(line.stream, line.text) for line in process.lines] == [("err", f"{tmp_path}/none.bag: no such file")]


def test_a_missing_library_is_one_line_with_the_command_that_installs_it(
    robot_health_process: Start, tmp_path: Path
) -> None:
    (tmp_path / "mcap.py").write_text("raise ModuleNotFoundError('gone', name='mcap')\n")
    (tmp_path / "a.mcap").write_bytes(b"")
    root = Path(__file__).resolve().parents[3]
    process = robot_health_process("suggest", tmp_path / "a.mcap", PYTHONPATH=f"{tmp_path}{os.pathsep}{root}")
    assert process.wait() == 3
    assert [line.text for line in process.lines] == ["robot-health: mcap is not installed: pip install mcap"]


def test_messages_that_are_out_of_order_are_named(robot_health: Start, tmp_path: Path) -> None:
    file = tmp_path / "a.bag"
    with Writer(file) as writer:
        writer.chunk_threshold = 64
        connection = writer.add_connection("/battery", "std_msgs/msg/Float64", typestore=STORE)
        for number in range(200, 0, -1):
            data = STORE.serialize_ros1(STORE.types["std_msgs/msg/Float64"](number), "std_msgs/msg/Float64")
            writer.write(connection, number * 1_000_000_000, bytes(data))
    process = robot_health("suggest", file)
    assert process.wait() == 2, process.text
    warning, problem = [line.text for line in process.lines if line.stream == "err"]
    assert warning.startswith("WARN: ")
    assert warning.endswith(" messages out of order, judged late")
    assert problem.startswith("robot-health suggest: nothing to watch: /battery: not periodic: 200 messages in ")


def test_what_was_given_stays_and_nothing_contradicts_it(robot_health: Start, tmp_path: Path) -> None:
    """The values are 40 to 50: a WARN above 51 would lie above the ERROR that was given."""
    thresholds = tmp_path / "thresholds.yaml"
    thresholds.write_text(
        "alert_system: {ros__parameters: {signals: {battery: "
        "{error_below: 10.0, error_above: 50.5, hysteresis: 3.0, for_s: 7.0, stale_after_s: 90.0}}}}\n"
    )
    bag = write_bag(tmp_path / "a.bag", [("/battery", "Float64", TRIANGLE, 1.0)])
    process = robot_health("suggest", bag, "--thresholds", thresholds)
    assert process.wait() == 0, process.text
    (tmp_path / "suggested.yaml").write_text("\n".join(out(process)))
    found = load_config(tmp_path / "suggested.yaml").signals["battery"]
    assert found.bounds == {"error_below": 10.0, "warn_below": 39.0, "error_above": 50.5}
    assert (found.hysteresis, found.for_s, found.stale_after_s) == (3.0, 7.0, 90.0)
    assert any(line.startswith("        # no warn_above: ") for line in out(process))


def test_what_is_left_out_is_listed(robot_health: Start, tmp_path: Path) -> None:
    bag = tmp_path / "a.bag"
    with Writer(bag) as writer:
        for topic, name in (
            ("/battery", "std_msgs/msg/Float64"),
            ("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray"),
        ):
            connection = writer.add_connection(topic, name, typestore=STORE)
            for number in range(30):
                writer.write(connection, number * 10**9, bytes(20) if "diag" in topic else bytes(8))
        connection = writer.add_connection("/odom", "nav_msgs/msg/Odometry", typestore=STORE)
    process = robot_health("suggest", bag)
    assert process.wait() == 0, process.text
    at = out(process).index("    # Not watched:")
    assert out(process)[at + 1 :] == [
        "    #   /diagnostics: no status",
        "    #   /odom: no message",
    ]


def test_bounds_of_a_short_recording_are_comments(robot_health: Start, tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "a.bag", [("/battery", "Float64", TRIANGLE[350:650], 1.0)])
    process = robot_health("suggest", bag)
    assert process.wait() == 0, process.text
    (tmp_path / "suggested.yaml").write_text("\n".join(out(process)))
    assert list(load_config(tmp_path / "suggested.yaml").signals) == ["battery_rate"]
    assert (
        "      # battery: {topic: battery, type: std_msgs/Float64, field: data, warn_below: 46.5, warn_above: 50.5, "
        "hysteresis: 0.02}  # seen 47 to 50 in 299 s" in out(process)
    )


@pytest.mark.newest_python
def test_a_long_excursion_gives_a_bound_from_the_extreme_and_its_alerts_are_counted(
    robot_health: Start, tmp_path: Path
) -> None:
    values = TRIANGLE * 8
    values[1300:1307] = [500.0] * 7  # less than 0.1 %, and longer than a minute
    process = robot_health("suggest", write_bag(tmp_path / "a.bag", [("/battery", "Float64", values, 10.0)]))
    assert process.wait() == 0, process.text
    (bound,) = [line for line in out(process) if line.startswith("        warn_above: 50")]
    assert "# 0 alerts; " in bound and "highest 500" in bound
    assert not any("for_s" in line for line in out(process))
    assert out(process)[1] == "# Replayed with these thresholds, the recordings raise 0 alerts."


def test_a_sensor_at_1_hz_is_not_left_out_silently(robot_health: Start, tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "a.bag", [("/battery", "Float64", TRIANGLE[:59], 1.0)])
    process = robot_health("suggest", bag)
    assert process.wait() == 0, process.text
    reason = "only 59 valid samples in 58 s; a range needs 100: listen for 120 s"
    assert f"      # /battery, data: no bounds: {reason}" in out(process)


def test_what_this_package_published_is_left_out_by_its_status_not_by_its_name(
    robot_health: Start, tmp_path: Path
) -> None:
    """A driver's own /temperature is watched, beside a /battery_level that battery_sensor published."""
    types, bag = STORE.types, tmp_path / "a.bag"
    values = [types["diagnostic_msgs/msg/KeyValue"]("published_topics", "/battery_level, /_simulated_sensors")]
    status = types["diagnostic_msgs/msg/DiagnosticStatus"](0, "battery_sensor: metrics", "ok", "robot", values)
    header = types["std_msgs/msg/Header"](0, types["builtin_interfaces/msg/Time"](1, 0), "")
    statuses = types["diagnostic_msgs/msg/DiagnosticArray"](header, [status])
    with Writer(bag) as writer:
        for topic, message in (
            ("/battery_level", types["std_msgs/msg/Float32"](50.0)),
            ("/_simulated_sensors", types["std_msgs/msg/String"]("battery_level")),
            ("/temperature", types["std_msgs/msg/Float32"](50.0)),
            ("/diagnostics", statuses),
        ):
            connection = writer.add_connection(topic, message.__msgtype__, typestore=STORE)
            data = bytes(STORE.serialize_ros1(message, message.__msgtype__))
            for second in range(60):
                writer.write(connection, (1_000 + second) * 10**9, data)
    process = robot_health("suggest", bag)
    assert process.wait() == 0, process.text
    assert [line for line in out(process) if line.endswith("published by this monitor")] == [
        "    #   /_simulated_sensors: published by this monitor",
        "    #   /battery_level: published by this monitor",
    ]
    assert [line.strip() for line in out(process) if line.endswith("_rate:")] == ["temperature_rate:"]
