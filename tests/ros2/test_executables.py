"""The executables as a user meets them: processes with topics, parameters, signals and exit codes."""

from __future__ import annotations

import functools
import itertools
import re
from pathlib import Path
from typing import Any, Callable, Iterator, Mapping

import pytest
import yaml
from harness.executables_on_ros import ARRAY, FLOAT32, READY, WRONG_FILE, ExecutablesOnRos, file_with, unexpected

ROOT = Path(__file__).resolve().parents[2]


class TestExecutables(ExecutablesOnRos):
    parameter_service = "set_parameters"

    @pytest.fixture
    def run(self, start: Any, tmp_path: Path) -> Any:
        def run_executable(
            executable: str,
            given: Mapping[str, Mapping[str, Any]] = {},
            *,
            name: str = "",
            namespace: str = "",
            remap: Mapping[str, str] = {},
        ) -> Any:
            arguments = ["--ros-args"]
            if given:
                tree = {node: {"ros__parameters": dict(values)} for node, values in given.items()}
                arguments += ["--params-file", file_with(tmp_path, yaml.safe_dump(tree))]
            names = {**remap, **({"__node": name} if name else {}), **({"__ns": namespace} if namespace else {})}
            for old, new in names.items():
                arguments += ["-r", f"{old}:={new}"]
            return start(executable, *arguments)

        return run_executable

    def send(self, ros: Any, topic: str, value: float) -> None:
        ros.publish_to_process(topic, FLOAT32, {"data": value})

    def connect(self, ros: Any, topic: str, value: float, signal_name: str, diagnostics: str = "/diagnostics") -> None:
        ros.connect_to_process(topic, {"data": value}, signal_name, diagnostics)

    @pytest.mark.parametrize("executor", ["single", "events"])
    def test_each_crossing_is_one_warning(self, ros: Any, run: Any, executor: str) -> None:  # type: ignore[override]
        self.check_crossings(ros, run, {"executor": executor})

    def test_the_log_level_of_ros_is_honoured(self, ros: Any, start: Any) -> None:
        self.check_log_level(ros, start("alert_system", "--ros-args", "--log-level", "warn"))


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
    file = file_with(tmp_path, WRONG_FILE)
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
        ("alert_system:\n  ros__parameters:\n    signals: {fan: {warn_below: }}\n", ":3: .*got nothing"),
        ("alert_system:\n  ros__parameters:\n    signals:\n      fan: {}\n", ":4: .*fan: expected a mapping of"),
    ],
)
def test_a_file_that_rcl_cannot_read_is_one_line_too(
    start: Any, tmp_path: Path, text: str, where_and_what: str
) -> None:
    file = file_with(tmp_path, text)
    process = start("alert_system", "--ros-args", "--params-file", file)
    assert process.wait() == 2
    (line,) = process.errors
    assert re.match(f"alert_system: {re.escape(file)}{where_and_what}", line), line


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("/**:\n  publish_rate: 1.0\n", "Cannot have a value before ros__parameters at line 2,"),
        ("other:\n  ros__parameters:\n    list: [1, a]\n", "Sequence should be of same type.* at line_num 3,"),
    ],
)
def test_what_only_rcl_refuses_is_its_own_line_with_the_user_s_file(
    start: Any, tmp_path: Path, text: str, problem: str
) -> None:
    file = file_with(tmp_path, text)
    process = start("alert_system", "--ros-args", "--params-file", file)
    assert process.wait() == 2
    (line,) = process.errors
    assert re.search(f"^alert_system: .*'--params-file {re.escape(file)}'.*{problem}", line), line


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
    file = file_with(tmp_path, "aggregator: {ros__parameters: {inputs: []}}\n")
    arguments = ("--params-file", file) if how == "file" else ("-p", "inputs:=[]")
    process = start("aggregator", "--ros-args", *arguments)
    process.wait_for_text("system_health is not published: inputs is empty")
    process.signal()
    assert process.wait(30.0) == 0
    assert unexpected(process) == []


@pytest.mark.parametrize("executable", ["aggregator", "health_monitor"])
def test_without_sensors_only_configured_inputs_are_averaged(start: Any, executable: str) -> None:
    process = start(executable, "--ros-args", "-p", "sensors:=none")
    process.wait_for_text("aggregator is not started: sensors is none, and no inputs are configured")
    process.signal()
    assert process.wait(30.0) == 0
    with_inputs = start(executable, "--ros-args", "-p", "sensors:=none", "-p", "inputs:=[pack_level]")
    if executable == "aggregator":  # alert_system has no parameter inputs
        with_inputs.wait_for_text("system_health is the mean of pack_level")


def test_a_section_of_a_file_holds_in_any_namespace(start: Any, ros: Any, tmp_path: Path) -> None:
    """To ROS 2 itself, `alert_system:` is `/alert_system` only."""
    file = file_with(
        tmp_path,
        "alert_system:\n  ros__parameters:\n    signals: {fan: {warn_below: 900.0}}\n"
        "/robot1/alert_system:\n  ros__parameters:\n    publish_rate: 5.0\n",
    )
    process = start("alert_system", "--ros-args", "-r", "__ns:=/robot1", "--params-file", file)
    process.wait_for_text("watching fan on /robot1/fan: WARN below 900")


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
    expected: set[str] = {f"/battery_sensor/{name}" for name in ("describe_parameters", "get_parameters")}
    ros.wait_until(lambda: ros.services() >= expected)
