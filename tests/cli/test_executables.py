"""What the executables of ROS 1 and ROS 2 share, run with nodes on the in-process middleware."""

from __future__ import annotations

import socket
from pathlib import Path
from typing import Any, Callable, Dict

import pytest

from robot_health_monitor.cli import executables
from robot_health_monitor.cli.exit_codes import ExitCode
from robot_health_monitor.core import Level
from robot_health_monitor.core.port.local import LocalBus
from robot_health_monitor.core.port.middleware import Severity
from robot_health_monitor.core.values.errors import ConfigError, ServiceError
from robot_health_monitor.ops.store import queries
from robot_health_monitor.ops.store.database_file import reading

Parameters = Dict[str, Dict[str, Any]]


class LocalProcess:
    """A process of nodes on one bus, which spins for three seconds of virtual time."""

    def __init__(self, parameters: Parameters, failure: str = "", last_good: Parameters | None = None) -> None:
        self.bus = LocalBus()
        self.last_good = last_good or {}
        self.middlewares: list[Any] = []
        self.closed = False
        self._parameters = parameters
        self._failure = failure

    def start(self) -> None:
        pass

    def create_node(self, name: str) -> Any:
        self.middlewares.append(self.bus.node(name, parameters=self._parameters.get(name, {})))
        return self.middlewares[-1]

    def create_served_node(self, alert_system: Any) -> Any:
        return self.create_node("rosbridge")

    def recover_node(self, name: str, failed: Any) -> Any:
        if name not in self.last_good:
            return None
        failed.close()
        self.middlewares.remove(failed)
        self._parameters[name] = self.last_good[name]
        return self.create_node(name)

    def locate(self, error: ConfigError, middleware: Any) -> ConfigError:
        return ConfigError(error.problem, (middleware.name, *error.path))

    def spin(self) -> str:
        self.bus.run_until(3.0)
        return self._failure

    def close(self) -> None:
        self.closed = True
        for middleware in self.middlewares:
            middleware.close()


def run(executable: str, open_process: Callable[[str, Any], Any], ros: str) -> int:
    """Runs an executable in a process that a function opens."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(executables, "_open_process", lambda ros, name, interrupts: open_process(name, interrupts))
        return executables.run(ros, executable)


def start(executable: str, process: LocalProcess) -> int:
    return run(executable, lambda name, interrupts: process, ros="ROS")


@pytest.mark.parametrize(
    ("executable", "nodes"),
    [
        ("battery_sensor", ["/battery_sensor"]),
        ("aggregator", ["/aggregator"]),
        ("alert_system", ["/alert_system"]),
        ("health_monitor", ["/alert_system", "/aggregator", "/battery_sensor"]),
    ],
)
def test_an_executable_starts_its_nodes_and_closes_them(executable: str, nodes: list[str]) -> None:
    process = LocalProcess({})
    assert start(executable, process) == ExitCode.SUCCESS
    assert [middleware.name for middleware in process.middlewares] == nodes
    assert process.closed and process.bus.nodes == []


NO_SENSORS = {"sensors": "none"}


@pytest.mark.parametrize(
    ("inputs", "nodes"),
    [
        ({}, ["/alert_system"]),
        ({"inputs": ["pack_level"]}, ["/alert_system", "/aggregator"]),
        ({"inputs": []}, ["/alert_system", "/aggregator"]),
    ],
)
def test_without_sensors_a_composed_process_averages_only_configured_inputs(inputs: Any, nodes: list[str]) -> None:
    process = LocalProcess({"alert_system": NO_SENSORS, "aggregator": {**NO_SENSORS, **inputs}})
    assert start("health_monitor", process) == ExitCode.SUCCESS
    assert [middleware.name for middleware in process.middlewares] == nodes


def test_without_sensors_and_inputs_aggregator_waits_for_a_signal_without_a_node() -> None:
    process = LocalProcess({"aggregator": NO_SENSORS})
    waited: list[bool] = []

    def wait_until(predicate: Callable[[], bool]) -> None:
        waited.append(predicate())
        raise KeyboardInterrupt

    def open_process(name: str, interrupts: Any) -> LocalProcess:
        interrupts.wait_until = wait_until
        return process

    assert run("aggregator", open_process, ros="ROS") == ExitCode.SUCCESS
    assert waited == [False] and process.closed
    assert [line.text for line in process.bus.log_lines] == [
        "aggregator is not started: sensors is none, and no inputs are configured"
    ]
    assert process.bus.now_s == 0.0


def test_a_configuration_that_cannot_be_used_is_one_line_and_code_2(capfd: pytest.CaptureFixture[str]) -> None:
    process = LocalProcess({"aggregator": {"publish_rate": "fast"}})
    assert start("aggregator", process) == ExitCode.USAGE
    written = capfd.readouterr().err
    assert written.startswith("aggregator: /aggregator.publish_rate: expected a number")
    assert written.count("\n") == 1 and process.closed


@pytest.mark.parametrize("executable", ["alert_system", "health_monitor"])
def test_a_node_that_refuses_its_parameters_starts_with_the_last_good_ones(executable: str, tmp_path: Path) -> None:
    ops = tmp_path / "ops.yaml"
    ops.write_text("history: {file: history.db}\n")
    good = {"ops": str(ops), "signals": {"fan": {"warn_below": 900.0}}}
    bad = {"ops": str(ops), "signals": {"fan": {"warn_below": "low", "field": "speed"}}}
    process = LocalProcess({"alert_system": bad}, last_good={"alert_system": good})
    assert start(executable, process) == ExitCode.SUCCESS
    assert process.middlewares[0].given_parameters() == good
    fault = process.middlewares[0].faults.current()["parameters"]
    assert fault.level is Level.ERROR
    assert fault.text == (
        "started with the last good ones: /alert_system.signals.fan.warn_below: expected a number, got 'low'"
    )
    errors = [line.text for line in process.bus.log_lines if line.severity >= Severity.ERROR]
    assert errors == [f"parameters: {fault.text}"]


def test_the_other_nodes_log_that_they_started_with_the_last_good_parameters() -> None:
    process = LocalProcess({"aggregator": {"publish_rate": 0.0}}, last_good={"aggregator": {"publish_rate": 2.0}})
    assert start("aggregator", process) == ExitCode.SUCCESS
    (error,) = [line.text for line in process.bus.log_lines if line.severity >= Severity.ERROR]
    assert error.startswith("parameters: started with the last good ones: /aggregator.publish_rate: expected a number")


def test_last_good_parameters_that_are_refused_too_end_it_with_code_2(capfd: pytest.CaptureFixture[str]) -> None:
    process = LocalProcess({"aggregator": {"publish_rate": 0.0}}, last_good={"aggregator": {"publish_rate": 1e9}})
    assert start("aggregator", process) == ExitCode.USAGE
    assert "got 1000000000.0" in capfd.readouterr().err


def test_a_process_that_failed_says_why_and_ends_with_code_3(capfd: pytest.CaptureFixture[str]) -> None:
    assert start("aggregator", LocalProcess({}, failure="the master was restarted")) == ExitCode.FAILED
    assert capfd.readouterr().err.splitlines()[-1] == "aggregator: the master was restarted"


def fail_with(error: BaseException) -> Callable[..., Any]:
    def open_process(name: str, interrupts: Any) -> Any:
        raise error

    return open_process


@pytest.mark.parametrize(
    ("error", "code", "line"),
    [
        (ModuleNotFoundError("no", name="rclpy"), ExitCode.USAGE, "no Python module rclpy"),
        (KeyError("surprise"), ExitCode.FAILED, ": KeyError: 'surprise'"),
    ],
)
def test_what_goes_wrong_at_the_start_is_one_line(
    error: BaseException, code: int, line: str, capfd: pytest.CaptureFixture[str]
) -> None:
    assert run("alert_system", fail_with(error), ros="ROS 2") == code
    written = capfd.readouterr().err
    assert line in written and written.count("\n") == 1


def test_an_interrupt_at_the_start_is_a_clean_end() -> None:
    assert run("alert_system", fail_with(KeyboardInterrupt()), ros="ROS 2") == ExitCode.SUCCESS


def test_a_ros_that_stopped_answering_is_code_3(capfd: pytest.CaptureFixture[str]) -> None:
    process = LocalProcess({})
    process.start = fail_at_start  # type: ignore[method-assign]
    assert start("alert_system", process) == ExitCode.FAILED
    assert capfd.readouterr().err == "alert_system: the ROS master does not answer\n"


def fail_at_start() -> None:
    raise ServiceError("the ROS master does not answer")


def test_a_rosbridge_server_that_cannot_start_stops_nothing_else() -> None:
    process = LocalProcess({"alert_system": {"rosbridge_port": 1, "rosbridge_address": "192.0.2.1"}})
    assert start("alert_system", process) == ExitCode.SUCCESS
    assert "server" in process.middlewares[0].faults.current()


@pytest.mark.parametrize("executable", ["alert_system", "battery_sensor"])
def test_systemd_receives_the_start_signs_of_life_and_the_end(executable: str, tmp_path: Any, monkeypatch: Any) -> None:
    address = str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(address)
        systemd.settimeout(60.0)
        monkeypatch.setenv("NOTIFY_SOCKET", address)
        monkeypatch.setenv("WATCHDOG_USEC", "4000000")
        assert start(executable, LocalProcess({})) == ExitCode.SUCCESS
        received = [systemd.recv(100) for _ in range(5)]  # the kernel keeps ten messages
    assert received == [b"READY=1", *3 * [b"WATCHDOG=1"], b"STOPPING=1"]


def test_the_ops_yaml_of_the_parameter_gives_alert_system_a_history(tmp_path: Path) -> None:
    file = tmp_path / "ops.yaml"
    file.write_text("history: {file: history.db}\n")
    given = {"robot_name": "r3", "ops": str(file), "signals": {"temperature": {"startup_grace_s": 1.0}}}
    process = LocalProcess({"alert_system": given, "battery_sensor": {"ops": str(file)}})
    assert start("alert_system", process) == ExitCode.SUCCESS
    with reading(tmp_path / "history.db") as connection:
        assert [(stored.robot, stored.to_level) for stored in queries.transitions(connection)] == [("r3", Level.STALE)]
    again = LocalProcess({"alert_system": given})
    assert start("alert_system", again) == ExitCode.SUCCESS
    with reading(tmp_path / "history.db") as connection:
        assert len(list(queries.transitions(connection))) == 1  # still stale: nothing new


def test_a_wrong_ops_yaml_ends_the_node_before_it_subscribes(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "ops.yaml"
    file.write_text("history: {file: a.db, keep_gb: 1}\nnotfy: {}\n")
    process = LocalProcess({"alert_system": {"ops": str(file)}})
    assert start("alert_system", process) == ExitCode.USAGE
    assert capfd.readouterr().err.splitlines() == [
        f"alert_system: {file}:1: history.keep_gb: unknown key; did you mean keep_mb?",
        f"alert_system: {file}:2: notfy: unknown key; did you mean notify?",
    ]
    assert process.bus.log_lines == []  # it watches nothing


def test_the_other_nodes_do_not_read_the_ops_yaml() -> None:
    process = LocalProcess({"battery_sensor": {"ops": "/nowhere/ops.yaml"}})
    assert start("battery_sensor", process) == ExitCode.SUCCESS


def test_the_server_of_an_ops_yaml_is_started(tmp_path: Path) -> None:
    pytest.importorskip("aiohttp", reason="aiohttp, which carries the WebSockets, is not installed")
    file = tmp_path / "ops.yaml"
    file.write_text("server: {port: 0}\n")
    process = LocalProcess({"alert_system": {"ops": str(file)}})
    assert start("alert_system", process) == ExitCode.SUCCESS
    assert any("rosbridge: serving on ws://127.0.0.1:" in line.text for line in process.bus.log_lines)
