"""The launch files with the real `ros2 launch`, from a prefix as colcon installs it."""

from __future__ import annotations

import contextlib
import itertools
import os
import signal
import stat
import subprocess
import sys
from pathlib import Path
from typing import Any, Callable, Iterator

import pytest
from harness.line_process import LineProcess

for module in ("launch", "launch_ros", "ros2cli", "ros2launch"):
    pytest.importorskip(module, reason=f"{module} is not here: it comes with a full ROS 2, pip does not have it")

ROOT = Path(__file__).resolve().parents[2]
NAME = "robot_health_monitor"
NODES = ("battery_sensor", "aggregator", "alert_system")
ARGUMENTS = {
    *("log_level", "use_sim_time", "robot_name", "thresholds", "sensors", "composed", "respawn"),
    *("rosbridge_port", "rosbridge_address", "rosbridge_token_file", "ops"),
}
FLOAT32 = "std_msgs/Float32"
SENSOR_READY = 'sensor "robot" started'
ROS2 = [
    sys.executable,
    "-c",
    "import signal, sys; from ros2cli.cli import main; signal.signal(signal.SIGINT, lambda *_: None); sys.exit(main())",
]
"""The program ros2. launch reads signals in its event loop, and hangs if Python's own handler of SIGINT raises
KeyboardInterrupt meanwhile in what it does, such as the writing of a line."""


@pytest.fixture(scope="session")
def prefix(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `colcon build` installs and launch looks at: the package's marker, its share and its executables."""
    prefix = tmp_path_factory.mktemp("prefix")
    marker = prefix / "share" / "ament_index" / "resource_index" / "packages" / NAME
    marker.parent.mkdir(parents=True)
    marker.touch()
    for folder in ("launch", "config"):
        share = prefix / "share" / NAME / folder
        share.mkdir(parents=True)
        for file in (ROOT / folder).iterdir():
            (share / file.name).symlink_to(file)
    programs = prefix / "lib" / NAME
    programs.mkdir(parents=True)
    for name in (*NODES, "health_monitor"):
        program = programs / name
        program.write_text(
            f"#!{sys.executable}\nimport sys\nfrom {NAME}.cli.ros2_executables import {name}\nsys.exit({name}())\n",
            encoding="utf-8",
        )
        program.chmod(program.stat().st_mode | stat.S_IXUSR)
    return prefix


@pytest.fixture
def environment(prefix: Path, ros_environment: dict[str, str], tmp_path: Path) -> dict[str, str]:
    def before(name: str, value: Path) -> str:
        return os.pathsep.join(filter(None, [str(value), ros_environment.get(name, "")]))

    return {
        **ros_environment,
        "AMENT_PREFIX_PATH": before("AMENT_PREFIX_PATH", prefix),
        "PYTHONPATH": before("PYTHONPATH", ROOT),
        "ROS_LOG_DIR": str(tmp_path / "log"),
    }


@pytest.fixture
def ros2_launch(environment: dict[str, str]) -> Iterator[Callable[..., LineProcess]]:
    """Starts `ros2 launch` with arguments; it is ended after the test if it still runs."""
    processes: list[LineProcess] = []

    def launch(*arguments: Any) -> LineProcess:
        processes.append(LineProcess([*ROS2, "launch", *arguments], environment))
        return processes[-1]

    yield launch
    for process in processes:
        process.end()
        with contextlib.suppress(ProcessLookupError):  # launch does not always outlive its nodes
            os.killpg(process.pid, signal.SIGKILL)


def nodes_of(ros: Any) -> set:
    return set(ros._me.get_fully_qualified_node_names())


def end(process: LineProcess) -> None:
    """Sends SIGINT to launch and to its nodes, as a terminal does at Ctrl-C, and sees all of them end cleanly."""
    os.killpg(process.pid, signal.SIGINT)
    assert process.wait(30.0) == 0, process.text
    for trouble in ("Traceback", "escalating", "exit code", "has died"):
        assert trouble not in process.text


def test_every_argument_has_a_description(ros2_launch: Any) -> None:
    process = ros2_launch(NAME, "health_monitor.launch.py", "--show-args")
    assert process.wait() == 0
    lines = [line.text.strip() for line in process.lines]
    described = {line.strip("':"): text for line, text in itertools.pairwise(lines) if line.endswith("':")}
    assert set(described) >= ARGUMENTS
    assert not any("no description" in text for text in described.values())


@pytest.mark.parametrize("composed", ["false", "true"])
def test_a_launch_runs_and_ends_cleanly(ros2_launch: Any, ros: Any, composed: str) -> None:
    process = ros2_launch(NAME, "health_monitor.launch.py", f"composed:={composed}")
    ros.wait_until(lambda: nodes_of(ros) >= {f"/{node}" for node in NODES})
    heard = [
        ros.listen(f"/{topic}", FLOAT32) for topic in ("battery_level", "temperature", "cpu_usage", "system_health")
    ]
    ros.wait_until(lambda: all(heard))
    process.wait_for_text("started")
    end(process)
    started = [line.text for line in process.lines if "process started with pid" in line.text]
    assert len(started) == {"false": 3, "true": 1}[composed]


def test_nodes_end_cleanly_at_sigterm(ros2_launch: Any, ros: Any) -> None:
    """launch itself ends at once and leaves its nodes running: service managers signal the whole group."""
    process = ros2_launch(NAME, "health_monitor.launch.py", "composed:=true")
    started = process.wait_for_text("process started with pid")
    process.wait_for_text(SENSOR_READY)
    node = int(started.rpartition("[")[2].rstrip("]"))
    os.kill(node, signal.SIGTERM)
    assert f"process has finished cleanly [pid {node}]" in process.wait_for_text("process has ")
    process.wait()


@pytest.mark.parametrize("composed", ["false", "true"])
def test_without_sensors_only_the_robot_publishes_values(ros2_launch: Any, ros: Any, composed: str) -> None:
    process = ros2_launch(NAME, "health_monitor.launch.py", "sensors:=none", f"composed:={composed}")
    reports = ros.listen("/diagnostics", "diagnostic_msgs/DiagnosticArray")
    process.wait_for_texts("watching cpu_usage", "aggregator is not started")
    ros.wait_until(lambda: len(reports) >= 3)
    assert "/aggregator" not in nodes_of(ros)
    end(process)
    assert SENSOR_READY not in process.text
    names = {status["name"] for report in reports for status in report["status"]}
    assert {name.partition(":")[0] for name in names} == {"alert_system"}


def test_an_aggregator_without_inputs_is_not_started_again_and_again(ros2_launch: Any, ros: Any) -> None:
    process = ros2_launch(NAME, "health_monitor.launch.py", "sensors:=none", "respawn:=true")
    process.wait_for_texts("watching cpu_usage", "aggregator is not started")
    reports = ros.listen("/diagnostics", "diagnostic_msgs/DiagnosticArray")
    ros.wait_until(lambda: len(reports) >= 5)  # longer than the pause before a respawn
    end(process)
    assert process.text.count("aggregator is not started") == 1


@pytest.mark.parametrize("composed", ["false", "true"])
def test_a_robots_name_is_its_namespace_and_hardware_id(
    ros2_launch: Any, ros: Any, tmp_path: Path, composed: str
) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("alert_system: {ros__parameters: {signals: {fan: {warn_below: 900.0}}}}\n", encoding="utf-8")
    process = ros2_launch(
        NAME, "health_monitor.launch.py", "robot_name:=robot1", f"thresholds:={file}", f"composed:={composed}"
    )
    process.wait_for_text("watching fan on /robot1/fan: WARN below 900")
    ros.wait_until(lambda: nodes_of(ros) >= {f"/robot1/{node}" for node in NODES})
    reports = ros.listen("/diagnostics", "diagnostic_msgs/DiagnosticArray")
    ros.wait_until(lambda: len(reports) >= 3)
    assert {status["hardware_id"] for report in reports for status in report["status"]} == {"robot1"}
    end(process)


def test_it_can_be_included_with_a_namespace_and_remapped(ros2_launch: Any, ros: Any, tmp_path: Path) -> None:
    file = tmp_path / "user.launch.py"
    file.write_text(
        f"""
from launch import LaunchDescription
from launch.actions import GroupAction, IncludeLaunchDescription
from launch_ros.actions import PushRosNamespace, SetRemap

def generate_launch_description():
    monitor = IncludeLaunchDescription(
        {str(ROOT / "launch" / "health_monitor.launch.py")!r},
        launch_arguments=[("robot_name", "robot1"), ("composed", "true")],
    )
    remap = SetRemap("battery_level", "power/level")
    return LaunchDescription([GroupAction([PushRosNamespace("fleet"), remap, monitor])])
""",
        encoding="utf-8",
    )
    process = ros2_launch(file)
    process.wait_for_text(SENSOR_READY)
    heard = ros.listen("/fleet/robot1/power/level", FLOAT32)
    reports = ros.listen("/diagnostics", "diagnostic_msgs/DiagnosticArray")
    ros.wait_until(lambda: bool(heard) and bool(reports))
    assert {status["hardware_id"] for message in reports for status in message["status"]} == {"robot1"}
    end(process)


@pytest.mark.parametrize("composed", ["false", "true"])
def test_the_log_level_and_simulated_time_reach_the_nodes(ros2_launch: Any, ros: Any, composed: str) -> None:
    process = ros2_launch(
        NAME, "health_monitor.launch.py", "log_level:=warn", "use_sim_time:=true", f"composed:={composed}"
    )
    ros.wait_until(lambda: ros.services() >= {f"/{node}/set_parameters" for node in NODES})
    steps = itertools.count(200)
    heard = ros.listen("/battery_level", FLOAT32)
    reports = ros.listen("/diagnostics", "diagnostic_msgs/DiagnosticArray")

    def step() -> bool:
        ros.set_time(float(next(steps)))
        return bool(heard) and bool(reports)

    ros.wait_until(step)
    assert 200 <= reports[0]["header"]["stamp"]["sec"] < 10_000
    end(process)
    assert not any(
        "[INFO]" in line.text and "[launch]" not in line.text and "process" not in line.text for line in process.lines
    )


@pytest.mark.parametrize(
    ("argument", "choices"), [("log_level:=LOUD", "DEBUG"), ("composed:=maybe", "true"), ("use_sim_time:=1", "true")]
)
def test_an_argument_that_is_none_of_the_choices_is_refused(ros2_launch: Any, argument: str, choices: str) -> None:
    process = ros2_launch(NAME, "health_monitor.launch.py", argument)
    assert process.wait() != 0
    assert any(argument.partition(":=")[0] in line.text and choices in line.text for line in process.lines)


def test_wrong_thresholds_end_only_the_node_that_needs_them(ros2_launch: Any, ros: Any, tmp_path: Path) -> None:
    file = tmp_path / "wrong.yaml"
    file.write_text("alert_system:\n  ros__parameters:\n    signals:\n      fan: {warn_below: low}\n", encoding="utf-8")
    process = ros2_launch(NAME, "health_monitor.launch.py", f"thresholds:={file}")
    line = process.wait_for_text("alert_system: ")
    assert f"alert_system: {file}:4: " in line and "warn_below" in line
    process.wait_for_text("exit code 2")
    ros.wait_until(lambda: nodes_of(ros) >= {"/battery_sensor", "/aggregator"})
    process.signal()
    assert process.wait(30.0) == 0


def test_thresholds_that_are_not_there_end_every_node(ros2_launch: Any, tmp_path: Path) -> None:
    file = tmp_path / "none.yaml"
    process = ros2_launch(NAME, "health_monitor.launch.py", f"thresholds:={file}")
    process.wait()
    for node in NODES:
        assert f"{node}: {file}: cannot be read: No such file or directory" in process.text
    assert process.text.count("exit code 2") == 3


def test_a_composed_launch_with_a_discharging_battery_warns_on_the_screen(
    ros2_launch: Any, ros: Any, tmp_path: Path
) -> None:
    file = tmp_path / "fast.yaml"
    file.write_text(
        "alert_system: {ros__parameters: {signals: {battery_level: {unit: '%', warn_below: 95.0}}}}\n"
        "battery_sensor: {ros__parameters: {battery_level: {discharge_rate: 4.0}}}\n",
        encoding="utf-8",
    )
    process = ros2_launch(NAME, "health_monitor.launch.py", "composed:=true", f"thresholds:={file}")
    process.wait_for_text("battery_level WARN: ")
    end(process)


def test_a_node_that_ends_is_started_again_on_request(ros2_launch: Any, environment: dict[str, str]) -> None:
    process = ros2_launch(NAME, "health_monitor.launch.py", "composed:=true", "respawn:=true")
    for _ in range(2):
        line = process.wait_for_text("process started with pid")
        process.wait_for_text(SENSOR_READY)
        os.kill(int(line.rpartition("[")[2].rstrip("]")), signal.SIGKILL)
    process.wait_for_text(SENSOR_READY)
    process.signal()
    assert process.wait(30.0) == 0


def test_the_textbook_example_needs_configuration_only(ros2_launch: Any, ros: Any) -> None:
    process = ros2_launch(NAME, "robot_monitor.launch.py")
    ros.wait_until(lambda: nodes_of(ros) >= {"/temperature_sensor", "/data_monitor"})
    heard = ros.listen("/sensor_data", FLOAT32)
    ros.wait_until(lambda: len(heard) >= 2)
    assert all(10.0 < message["data"] < 45.0 for message in heard)
    alerts = ros.listen("/alerts", "diagnostic_msgs/DiagnosticStatus")

    def is_announced() -> bool:  # it may be WARN already, from a hot spell of the simulated sensor
        for degrees in (20.0, 30.5):
            ros.publish_to_process("/sensor_data", FLOAT32, {"data": degrees})
        return any("WARN: 30.5 degC is above 30 degC" in alert["message"] for alert in alerts)

    ros.wait_until(is_announced)
    process.wait_for_text("sensor_data WARN: 30.5 °C is above 30 °C")
    end(process)
    assert 'sensor "temp_sensor_1" started at 2 Hz' in process.text


def test_parameters_can_be_set_with_ros2_param(ros2_launch: Any, environment: dict[str, str]) -> None:
    pytest.importorskip("ros2param", reason="ros2param is not here: it comes with a full ROS 2, pip does not have it")
    process = ros2_launch(NAME, "health_monitor.launch.py", "composed:=true")
    process.wait_for_text(SENSOR_READY)

    def ros2_param(*arguments: str) -> str:
        options = ("--no-daemon", "--spin-time", "3")
        done = subprocess.run(
            [*ROS2, "param", arguments[0], *options, *arguments[1:]], env=environment, capture_output=True, text=True
        )
        return done.stdout + done.stderr

    name = "signals.battery_level.warn_below"
    assert "successful" in ros2_param("set", "/alert_system", name, "30")
    assert "30" in ros2_param("get", "/alert_system", name)
    assert "error_below: expected at most warn_below (5), got 10" in ros2_param("set", "/alert_system", name, "5")
    assert "WARN below this value" in ros2_param("describe", "/alert_system", name)
    end(process)
