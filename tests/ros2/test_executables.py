"""The executables as a user meets them: processes with topics, parameters, signals and exit codes."""

from __future__ import annotations

import functools
import itertools
import re
import signal
from pathlib import Path
from typing import Any, Callable, Iterator, List, Set

import pytest

FLOAT32 = "std_msgs/Float32"
TRIGGER = "std_srvs/Trigger"
ARRAY = "diagnostic_msgs/DiagnosticArray"
STATUS = "diagnostic_msgs/DiagnosticStatus"
ROOT = Path(__file__).resolve().parents[2]
SIGNALS = ("battery_level", "temperature", "cpu_usage")
READY = {
    "battery_sensor": 'sensor "robot" started at 1 Hz',
    "aggregator": "system_health is the mean of",
    "alert_system": "watching cpu_usage",
    "health_monitor": 'sensor "robot" started at 1 Hz',
}


def parameter_file(folder: Path, text: str) -> str:
    file = folder / "thresholds.yaml"
    file.write_text(text, encoding="utf-8")
    return str(file)


def severe_lines(process: Any) -> List[str]:
    return [line.text for line in process.lines if "[INFO]" not in line.text and "[WARN]" not in line.text]


def warnings_of(process: Any, signal_name: str) -> List[str]:
    return [line.text for line in process.lines if f"{signal_name} WARN" in line.text]


def test_battery_sensor_publishes_its_three_metrics(ros: Any, start: Any) -> None:
    process = start("battery_sensor", "--ros-args", "-p", "publish_rate:=20.0", "-p", "battery_level.charge_at:=0.0")
    process.wait_for_text("started at 20 Hz")
    heard = {name: ros.listen(f"/{name}", FLOAT32) for name in ("battery_level", "temperature", "cpu_usage")}
    ros.wait_until(lambda: all(len(messages) >= 3 for messages in heard.values()))
    levels = [message["data"] for message in heard["battery_level"]]
    assert all(0.0 <= level <= 100.0 for level in levels)
    assert levels == sorted(levels, reverse=True)


def test_battery_sensor_publishes_this_computer_and_its_processes(ros: Any, start: Any, tmp_path: Path) -> None:
    host = 'host: {own: {source: process_memory, command: "*battery_sensor*", reduce: max}}'
    text = f"battery_sensor: {{ros__parameters: {{publish_rate: 20.0, host_preset: standard, {host}}}}}\n"
    process = start("battery_sensor", "--ros-args", "--params-file", parameter_file(tmp_path, text))
    process.wait_for_text("systemd_failed, own")
    heard = {name: ros.listen(f"/{name}", FLOAT32) for name in ("disk_percent", "memory_percent", "own")}
    ros.wait_until(lambda: all(len(messages) >= 3 for messages in heard.values()))
    assert 0.0 < heard["disk_percent"][-1]["data"] < 100.0
    assert 10.0 < heard["own"][-1]["data"] < 1000.0  # MB


def test_system_health_is_the_average_of_the_three(ros: Any, start: Any) -> None:
    process = start("aggregator", "--ros-args", "-p", "publish_rate:=20.0")
    process.wait_for_text(READY["aggregator"])
    heard = ros.listen("/system_health", FLOAT32)

    def is_heard() -> bool:  # what is published before both ends are connected is lost
        for topic, value in (("battery_level", 90.0), ("temperature", 45.0), ("cpu_usage", 30.0)):
            ros.publish_to_process(f"/{topic}", FLOAT32, {"data": value})
        return bool(heard)

    ros.wait_until(is_heard)
    assert heard[0]["data"] == 55.0


@pytest.mark.parametrize("executor", ["single", "events"])
def test_each_crossing_is_one_warning(ros: Any, start: Any, executor: str) -> None:
    process = start(
        "alert_system",
        *("--ros-args", "--params-file", str(ROOT / "config" / "thresholds.yaml"), "-p", f"executor:={executor}"),
        # never stale, however long the connections take
        *itertools.chain(*(("-p", f"signals.{name}.stale_after_s:=0.0") for name in SIGNALS)),
    )
    process.wait_for_text(READY["alert_system"])
    alerts = ros.listen("/alerts", STATUS)
    ros.connect_to_process("/battery_level", {"data": 25.0}, "battery_level")
    ros.connect_to_process("/temperature", {"data": 80.0}, "temperature")
    for percent in (20.0, 19.5, 19.0, 18.0, 23.0, 19.0, 19.0):
        ros.publish_to_process("/battery_level", FLOAT32, {"data": percent})
    for degrees in (80.5, 81.0):
        ros.publish_to_process("/temperature", FLOAT32, {"data": degrees})
    ros.wait_until(lambda: len(alerts) >= 4)
    process.signal()
    assert process.wait(30.0) == 0
    assert severe_lines(process) == []
    assert len(warnings_of(process, "battery_level")) == 2
    assert len(warnings_of(process, "temperature")) == 1
    assert "battery_level WARN: 19.5 % is below 20 %" in warnings_of(process, "battery_level")[0]
    assert sorted((alert["name"], alert["level"]) for alert in alerts) == [
        ("alert_system: battery_level", b"\x00"),
        ("alert_system: battery_level", b"\x01"),
        ("alert_system: battery_level", b"\x01"),
        ("alert_system: temperature", b"\x01"),
    ]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("executable", list(READY))
def test_a_signal_ends_it_cleanly(start: Any, executable: str, number: int) -> None:
    process = start(executable)
    process.wait_for_text(READY[executable])
    process.signal(number)
    assert process.wait(30.0) == 0
    assert severe_lines(process) == []


def test_two_signals_during_the_start_end_it_cleanly(start: Any) -> None:
    """At Ctrl-C a terminal and launch each send one."""
    process = start("health_monitor")
    process.wait_for_text("watching battery_level")
    process.signal()
    process.signal()
    assert process.wait(30.0) == 0
    assert severe_lines(process) == []


def test_a_signal_ends_it_while_simulated_time_stands_still(start: Any) -> None:
    process = start("health_monitor", "--ros-args", "-p", "use_sim_time:=true")
    process.wait_for_text(READY["health_monitor"])
    process.signal()
    assert process.wait(30.0) == 0


@pytest.mark.parametrize("executable", ["alert_system", "health_monitor"])
@pytest.mark.parametrize("namespace", ["/", "/robot1"])
def test_a_wrong_file_ends_it_with_file_line_and_key(
    start: Any, tmp_path: Path, executable: str, namespace: str
) -> None:
    file = parameter_file(
        tmp_path,
        "alert_system:\n  ros__parameters:\n    signals:\n      battery_level:\n        warn_bellow: 20.0\n",
    )
    process = start(executable, "--ros-args", "-r", f"__ns:={namespace}", "--params-file", file)
    assert process.wait() == 2
    (line,) = process.errors
    assert line.startswith(f"{executable}: {file}:5: alert_system.ros__parameters.signals.battery_level.warn_bellow: ")
    assert "warn_below" in line


@pytest.mark.parametrize(
    ("text", "where_and_what"),
    [
        ("alert_system:\n  ros__parameters:\n   a: 1\n    b: 2\n", ":4: is not valid YAML"),
        ("alert_system:\n  ros__parameters:\n    publish_rate: 1.0\n    publish_rate: 2.0\n", ":4: .*is given twice"),
        ("alert_system:\n  publish_rate: 1.0\n", ":1: .*expected the key ros__parameters"),
        ("/**:\n  publish_rate: 1.0\n", r":2: rejected by rcl: Cannot have a value before ros__parameters\Z"),
        ("other:\n  ros__parameters:\n    list: [1, a]\n", ":3: rejected by rcl: Sequence should be of same type"),
        ("alert_system:\n  ros__parameters:\n    signals: {fan: {warn_below: }}\n", ":3: .*got nothing"),
        ("alert_system:\n  ros__parameters:\n    signals:\n      fan: {}\n", ":4: .*fan: expected a mapping with"),
    ],
)
def test_a_file_that_rcl_cannot_read_is_one_line_too(
    start: Any, tmp_path: Path, text: str, where_and_what: str
) -> None:
    file = parameter_file(tmp_path, text)
    process = start("alert_system", "--ros-args", "--params-file", file)
    assert process.wait() == 2
    (line,) = process.errors
    assert re.match(f"alert_system: {re.escape(file)}{where_and_what}", line), line


def test_a_file_that_is_not_there_is_one_line(start: Any, tmp_path: Path) -> None:
    process = start("aggregator", "--ros-args", "--params-file", str(tmp_path / "none.yaml"))
    assert process.wait() == 2
    assert process.errors == [f"aggregator: {tmp_path / 'none.yaml'}: cannot be read: No such file or directory"]


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (("-p", "publish_rate:=fast"), "publish_rate: expected a number from 0.01 to 1000, got 'fast'"),
        (("-p", "log_level:=LOUD"), "log_level: expected one of DEBUG, INFO, WARN, ERROR, FATAL, got 'LOUD'"),
        (("-p", "executor:=many"), "executor: expected one of auto, single, events, got 'many'"),
        (("-r", "nonsense"), "failed to initialize rcl: Couldn't parse remap rule: '-r nonsense'"),
    ],
)
def test_a_wrong_argument_is_one_line(start: Any, arguments: Any, problem: str) -> None:
    process = start("battery_sensor", "--ros-args", *arguments)
    assert process.wait() == 2
    (line,) = process.errors
    assert line.startswith(f"battery_sensor: {problem}")


@pytest.mark.parametrize("how", ["file", "argument"])
def test_an_aggregator_with_an_empty_list_of_inputs_starts(start: Any, tmp_path: Path, how: str) -> None:
    """rcl has no type for an empty list."""
    file = parameter_file(tmp_path, "aggregator: {ros__parameters: {inputs: []}}\n")
    arguments = ("--params-file", file) if how == "file" else ("-p", "inputs:=[]")
    process = start("aggregator", "--ros-args", *arguments)
    process.wait_for_text("system_health is not published: inputs is empty")
    process.signal()
    assert process.wait(30.0) == 0
    assert severe_lines(process) == []


@pytest.mark.parametrize("executable", ["aggregator", "health_monitor"])
def test_without_sensors_only_configured_inputs_are_averaged(start: Any, executable: str) -> None:
    process = start(executable, "--ros-args", "-p", "sensors:=none")
    process.wait_for_text("aggregator is not started: sensors is none, and no inputs are configured")
    process.signal()
    assert process.wait(30.0) == 0
    with_inputs = start(executable, "--ros-args", "-p", "sensors:=none", "-p", "inputs:=[pack_level]")
    if executable == "aggregator":  # alert_system has no parameter inputs
        with_inputs.wait_for_text("system_health is the mean of pack_level")


def test_a_wrong_field_ends_it_before_it_listens(start: Any, tmp_path: Path) -> None:
    file = parameter_file(
        tmp_path,
        "alert_system:\n  ros__parameters:\n    signals:\n      battery_level:\n"
        "        type: std_msgs/Float32\n        field: percentage\n",
    )
    process = start("alert_system", "--ros-args", "--params-file", file)
    assert process.wait() == 2
    (line,) = process.errors
    assert "/battery_level" in line and "std_msgs/Float32" in line and "data" in line


@pytest.mark.parametrize("how", [("--log-level", "warn"), ("-p", "log_level:=WARN")])
def test_the_log_level_is_honoured(start: Any, ros: Any, how: Any) -> None:
    process = start("alert_system", "--ros-args", *how)
    ros.wait_until(lambda: ros.services() >= {"/alert_system/reset"})
    ros.connect_to_process("/battery_level", {"data": 15.0}, "battery_level")
    process.wait_for_text("battery_level WARN")
    process.signal()
    assert process.wait() == 0
    assert [line.text for line in process.lines if "[INFO]" in line.text] == []


def test_names_namespaces_and_topics_can_be_changed_from_outside(start: Any, ros: Any) -> None:
    remaps = ("__node:=watchdog", "__ns:=/robot1", "battery_level:=power/level", "/diagnostics:=diagnostics")
    process = start("alert_system", "--ros-args", *itertools.chain.from_iterable(("-r", remap) for remap in remaps))
    process.wait_for_text(READY["alert_system"])
    alerts = ros.listen("/robot1/alerts", STATUS)
    ros.connect_to_process("/robot1/power/level", {"data": 50.0}, "battery_level", "/robot1/diagnostics")
    ros.publish_to_process("/robot1/power/level", FLOAT32, {"data": 15.0})
    ros.wait_until(lambda: "watchdog: battery_level" in [alert["name"] for alert in alerts])
    assert ros.call("/robot1/watchdog/reset", TRIGGER)["success"] is True


def test_a_section_of_a_file_holds_in_any_namespace(start: Any, ros: Any, tmp_path: Path) -> None:
    """To ROS 2 itself, `alert_system:` is `/alert_system` only."""
    file = parameter_file(
        tmp_path,
        "alert_system:\n  ros__parameters:\n    signals: {fan: {warn_below: 900.0}}\n"
        "/robot1/alert_system:\n  ros__parameters:\n    publish_rate: 5.0\n",
    )
    process = start("alert_system", "--ros-args", "-r", "__ns:=/robot1", "--params-file", file)
    process.wait_for_text("watching fan on /robot1/fan: WARN below 900")


def test_the_three_in_one_process_have_the_names_and_sections_they_have_alone(
    start: Any, ros: Any, tmp_path: Path
) -> None:
    file = parameter_file(
        tmp_path,
        "battery_sensor: {ros__parameters: {publish_rate: 10.0, battery_level: {discharge_rate: 20.0}}}\n"
        "aggregator: {ros__parameters: {publish_rate: 5.0}}\n",
    )
    process = start("health_monitor", "--ros-args", "--params-file", file)
    process.wait_for_text('sensor "robot" started at 10 Hz')
    heard = ros.listen("/system_health", FLOAT32)
    process.wait_for_text("battery_level WARN")
    ros.wait_until(lambda: bool(heard))
    expected = {"/alert_system/reset", *(f"/{node}/set_parameters" for node in list(READY)[:3])}
    ros.wait_until(lambda: ros.services() >= expected)
    assert ros.call("/alert_system/reset", TRIGGER)["success"] is True


def test_a_bound_can_be_changed_while_it_runs(start: Any, ros: Any) -> None:
    process = start("alert_system", "--ros-args", "--params-file", str(ROOT / "config" / "thresholds.yaml"))
    process.wait_for_text(READY["alert_system"])
    ros.connect_to_process("/battery_level", {"data": 25.0}, "battery_level")
    name = "signals.battery_level.warn_below"
    assert ros.propose_to("/alert_system", name, 30.0) == ""
    ros.publish_to_process("/battery_level", FLOAT32, {"data": 25.0})
    process.wait_for_text("battery_level WARN: 25 % is below 30 %")
    assert ros.propose_to("/alert_system", name, 5.0).startswith("signals.battery_level.error_below: expected at most")
    process.wait_for_text("the old parameters stay in force")
    ros.publish_to_process("/battery_level", FLOAT32, {"data": 33.0})
    process.wait_for_text("battery_level OK")


def test_without_a_file_a_bound_can_be_changed_and_the_other_default_signals_stay(start: Any, ros: Any) -> None:
    process = start("alert_system")
    process.wait_for_text(READY["alert_system"])
    reports = ros.listen("/diagnostics", ARRAY)
    ros.connect_to_process("/battery_level", {"data": 25.0}, "battery_level")
    assert ros.propose_to("/alert_system", "signals.battery_level.warn_below", 30.0) == ""
    ros.publish_to_process("/battery_level", FLOAT32, {"data": 25.0})
    process.wait_for_text("battery_level WARN: 25 % is below 30 %")
    expected = {f"alert_system: {name}" for name in ("battery_level", "temperature", "cpu_usage")}
    reports.clear()
    # A transition brings a status by itself; every second, a report has all of them.
    ros.wait_until(lambda: any(expected <= {status["name"] for status in report["status"]} for report in reports))


def test_simulated_time_is_followed(start: Any, ros: Any) -> None:
    """Messages carry simulated time, and a signal becomes stale when it jumps."""
    process = start("alert_system", "--ros-args", "-p", "use_sim_time:=true")
    process.wait_for_text(READY["alert_system"])
    reports = ros.listen("/diagnostics", ARRAY)

    def advance_until_shown(level: bytes, times_s: Iterator[float], publish: Callable[[], object]) -> None:
        def is_shown() -> bool:
            publish()
            ros.set_time(next(times_s))
            shown = [(status["name"], status["level"]) for report in tuple(reports) for status in report["status"]]
            return ("alert_system: battery_level", level) in shown

        ros.wait_until(is_shown)

    # The first samples may be lost: the publisher may know the node before the node knows the publisher.
    publish = functools.partial(ros.publish_to_process, "/battery_level", FLOAT32, {"data": 50.0})
    advance_until_shown(b"\x00", itertools.count(200.5), publish)
    assert reports[-1]["header"]["stamp"]["nanosec"] == 500_000_000
    reports.clear()
    advance_until_shown(b"\x03", itertools.count(10_000.0, 100.0), lambda: None)
    process.wait_for_text(" STALE: no message ")  # one alert, of one of the silent topics


def test_services_and_parameters_are_there_for_every_node(start: Any, ros: Any) -> None:
    process = start("battery_sensor")
    process.wait_for_text(READY["battery_sensor"])
    expected: Set[str] = {f"/battery_sensor/{name}" for name in ("describe_parameters", "get_parameters")}
    ros.wait_until(lambda: ros.services() >= expected)


def test_after_kill_9_an_open_alert_continues_and_is_not_announced_again(start: Any, ros: Any, tmp_path: Path) -> None:
    """In a namespace: until a timeout, the killed process is still in the graph, and later tests would meet it."""
    (tmp_path / "ops.yaml").write_text("history: {file: history.db}\n", encoding="utf-8")
    reports = ros.listen("/killed/diagnostics", ARRAY)
    file = parameter_file(  # never stale, however long the start takes
        tmp_path,
        f"alert_system: {{ros__parameters: {{ops: {tmp_path / 'ops.yaml'},"
        " signals: {battery_level: {warn_below: 20.0, stale_after_s: 0.0}}}}\n",
    )
    names = ("-r", "__ns:=/killed", "-r", "/diagnostics:=/killed/diagnostics")
    arguments = ("--ros-args", "--params-file", file, *names)

    def publish_until_shown(value: float, level: bytes) -> None:
        def is_shown() -> bool:
            ros.publish_to_process("/killed/battery_level", FLOAT32, {"data": value})
            shown = [(status["name"], status["level"]) for report in tuple(reports) for status in report["status"]]
            return ("alert_system: battery_level", level) in shown

        reports.clear()
        ros.wait_until(is_shown)

    first = start("alert_system", *arguments)
    first.wait_for_text("watching battery_level")
    publish_until_shown(15.0, b"\x01")
    first.signal(signal.SIGKILL)
    first.wait()
    second = start("alert_system", *arguments)
    second.wait_for_text("watching battery_level")
    publish_until_shown(15.0, b"\x01")
    publish_until_shown(50.0, b"\x00")
    assert "(was WARN for " in second.wait_for_text("battery_level OK")
    assert warnings_of(second, "battery_level") == []


def test_a_wrong_ops_yaml_ends_it_before_it_listens(start: Any, tmp_path: Path) -> None:
    (tmp_path / "ops.yaml").write_text("history: {fil: history.db}\n")
    process = start("alert_system", "--ros-args", "-p", f"ops:={tmp_path}/ops.yaml")
    assert process.wait() == 2
    errors = [line.text for line in process.lines if "ops.yaml" in line.text]
    assert errors == [
        f"alert_system: {tmp_path}/ops.yaml:1: history.fil: unknown key; did you mean file?",
        f"alert_system: {tmp_path}/ops.yaml:1: history.file: is missing; expected the path of the SQLite file, which "
        "is created",
    ]
    assert "watching" not in process.text
