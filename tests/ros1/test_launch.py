"""The launch files with the real roslaunch, from a space that catkin has built."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any, Callable, Iterator, Sequence

import pytest
import yaml
from harness.line_process import LineProcess

ROOT = Path(__file__).resolve().parents[2]
ARGUMENTS = {
    *("log_level", "use_sim_time", "robot_name", "thresholds", "sensors", "composed", "respawn"),
    *("rosbridge_port", "rosbridge_address", "rosbridge_token_file", "ops"),
}
FLOAT32 = "std_msgs/Float32"
SENSOR_READY = 'sensor "robot" started'


@pytest.fixture(scope="session")
def devel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A devel space of this package."""
    if not (shutil.which("cmake") and shutil.which("catkin_find")):
        pytest.skip("catkin is not here")
    folder = tmp_path_factory.mktemp("catkin")
    options = {
        "CATKIN_DEVEL_PREFIX": folder / "devel",
        "CATKIN_ENABLE_TESTING": "OFF",
        "PYTHON_EXECUTABLE": sys.executable,
    }
    definitions = [f"-D{name}={value}" for name, value in options.items()]
    for command in (
        ["cmake", "-S", ROOT, "-B", folder / "build", *definitions],
        ["cmake", "--build", folder / "build"],
    ):
        done = subprocess.run([str(part) for part in command], capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr
    return folder / "devel"


@pytest.fixture
def roslaunch(devel: Path, master: Any, parameters: Any) -> Iterator[Callable[..., LineProcess]]:
    """Starts roslaunch with arguments; it is ended after the test if it still runs."""
    processes: list[LineProcess] = []

    def launch(*arguments: Any) -> LineProcess:
        processes.append(LineProcess([devel / "env.sh", "roslaunch", *arguments], master.environment))
        return processes[-1]

    yield launch
    for process in processes:
        process.end()


@pytest.fixture
def ros(ros_process: Any) -> Iterator[Any]:
    from harness.ros1 import Ros1Harness

    harness = Ros1Harness()
    yield harness
    harness.close()


PRINT = """
import contextlib, io, json, sys
import roslaunch
printed = []
for arguments in json.loads(sys.argv[1]):
    sys.argv, text = ["roslaunch", *arguments], io.StringIO()  # parts of roslaunch read sys.argv
    with contextlib.redirect_stdout(text), contextlib.suppress(SystemExit):
        roslaunch.main(sys.argv)
    printed.append(text.getvalue())
print(json.dumps(printed))
"""


def printed(devel: Path, master: Any, *options: Sequence[str]) -> list[str]:
    """Returns what the real roslaunch prints with each list of options, in one process."""
    launches = json.dumps([[first, "robot_health_monitor", "health_monitor.launch", *more] for first, *more in options])
    command = [str(devel / "env.sh"), sys.executable, "-c", PRINT, launches]
    done = subprocess.run(command, env=master.environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    texts = json.loads(done.stdout.splitlines()[-1])
    assert len(texts) == len(options) and all(texts), done.stderr
    return list(texts)


def nodes_of(ros: Any) -> set[str]:
    return {node for kind in ros._master.getSystemState() for _, nodes in kind for node in nodes}


def wait_for_nodes(ros: Any, wanted: set[str]) -> None:
    ros.wait_until(lambda: wanted <= nodes_of(ros))


def test_every_argument_has_a_description(devel: Path, master: Any) -> None:
    (text,) = printed(devel, master, ["--ros-args"])
    listed = text.splitlines()
    described = {line.split()[0].rstrip(":"): line for line in listed if line.startswith("  ")}
    assert set(described) >= ARGUMENTS
    assert not any("undocumented" in line for line in described.values())
    assert not any("Required" in line for line in listed)


def test_arguments_and_thresholds_become_parameters(devel: Path, master: Any, tmp_path: Path) -> None:
    mine = tmp_path / "mine.yaml"
    mine.write_text("alert_system: {ros__parameters: {signals: {fan: {warn_below: 900.0}}}}\n", encoding="utf-8")
    arguments = ("log_level:=debug", "use_sim_time:=true", "robot_name:=robot1", f"thresholds:={mine}")
    optional = ("robot_name:=r/007", "ops:=/etc/ops.yaml", "rosbridge_port:=9090", "rosbridge_token_file:=/etc/token")
    options = [["--dump-params", *each] for each in ((), arguments, optional)]
    default, given, named = map(yaml.safe_load, printed(devel, master, *options))

    file = yaml.safe_load((ROOT / "config" / "thresholds.yaml").read_text(encoding="utf-8"))
    below = "/alert_system/ros__parameters/signals/"
    expected = {
        f"{below}{name}/{key}": value
        for name, signal_tree in file["alert_system"]["ros__parameters"]["signals"].items()
        for key, value in signal_tree.items()
    }
    assert {name: value for name, value in default.items() if name.startswith(below)} == expected
    assert "/use_sim_time" not in default
    # Optional arguments become parameters only if given.
    assert not [name for name, value in default.items() if isinstance(value, str) and not value.strip()]

    assert given["/use_sim_time"] is True
    assert given["/robot1/alert_system/ros__parameters/signals/fan/warn_below"] == 900.0
    assert given["/robot1/alert_system/thresholds"] == str(mine)
    for node in ("battery_sensor", "aggregator", "alert_system"):
        assert given[f"/robot1/{node}/robot_name"] == "robot1"
        assert given[f"/robot1/{node}/log_level"] == "DEBUG"

    assert named["/r/007/alert_system/robot_name"] == "r/007"
    assert named["/r/007/alert_system/ops"] == "/etc/ops.yaml"
    assert named["/r/007/alert_system/rosbridge_token_file"] == "/etc/token"


def test_it_starts_the_nodes_that_were_asked_for(devel: Path, master: Any) -> None:
    nodes = {
        (): {"/battery_sensor", "/aggregator", "/alert_system"},
        ("robot_name:=robot1",): {"/robot1/battery_sensor", "/robot1/aggregator", "/robot1/alert_system"},
        ("composed:=true",): {"/health_monitor"},
        ("composed:=true", "robot_name:=robot1"): {"/robot1/health_monitor"},
        ("sensors:=none",): {"/aggregator", "/alert_system"},
        ("sensors:=none", "composed:=true"): {"/health_monitor"},
    }
    listed = printed(devel, master, *(["--nodes", *arguments] for arguments in nodes))
    assert {arguments: set(text.split()) for arguments, text in zip(nodes, listed)} == nodes


def test_it_can_be_included_with_a_namespace_and_remapped(roslaunch: Any, ros: Any, tmp_path: Path) -> None:
    file = tmp_path / "user.launch"
    file.write_text(
        """<launch>
             <remap from="battery_level" to="power/level"/>
             <group ns="fleet">
               <include file="$(find robot_health_monitor)/launch/health_monitor.launch">
                 <arg name="robot_name" value="robot1"/>
                 <arg name="composed" value="true"/>
               </include>
             </group>
           </launch>""",
        encoding="utf-8",
    )
    process = roslaunch(file)
    process.wait_for_text(SENSOR_READY)
    heard = ros.listen("/fleet/robot1/power/level", FLOAT32)
    reports = ros.listen("/diagnostics", "diagnostic_msgs/DiagnosticArray")
    ros.wait_until(lambda: bool(heard) and bool(reports))
    assert {status["hardware_id"] for message in reports for status in message["status"]} == {"robot1"}
    assert ros.call("/fleet/robot1/alert_system/reset", "std_srvs/Trigger")["success"] is True


def end_cleanly(process: LineProcess, number: int) -> None:
    process.signal(number)
    assert process.wait(30.0) == 0
    assert "Traceback" not in process.text
    assert "escalating" not in process.text
    assert "exit code" not in process.text


def test_a_launch_runs_and_ends_cleanly(roslaunch: Any, ros: Any) -> None:
    process = roslaunch("robot_health_monitor", "health_monitor.launch")
    wait_for_nodes(ros, {"/battery_sensor", "/aggregator", "/alert_system"})
    topics = ("battery_level", "temperature", "cpu_usage", "system_health")
    heard = [ros.listen(f"/{topic}", FLOAT32) for topic in topics]
    ros.wait_until(lambda: all(heard))
    end_cleanly(process, signal.SIGINT)


@pytest.mark.parametrize("composed", ["false", "true"])
def test_without_sensors_only_the_robot_publishes_and_the_aggregator_is_not_started_again_and_again(
    roslaunch: Any, ros: Any, composed: str
) -> None:
    reports = ros.listen("/diagnostics", "diagnostic_msgs/DiagnosticArray")
    options = (f"composed:={composed}", "respawn:=true", "sensors:=none")
    process = roslaunch("robot_health_monitor", "health_monitor.launch", *options)
    process.wait_for_texts("watching cpu_usage", "aggregator is not started")
    ros.wait_until(lambda: len(reports) >= 5)  # longer than the pause before a respawn
    assert "/aggregator" not in nodes_of(ros)
    end_cleanly(process, signal.SIGTERM)
    assert process.text.count("aggregator is not started") == 1
    assert "restarting process" not in process.text
    assert SENSOR_READY not in process.text
    names = {status["name"] for report in reports for status in report["status"]}
    assert {name.partition(":")[0] for name in names} == {"alert_system"}


@pytest.mark.parametrize("composed", ["false", "true"])
def test_without_sensors_inputs_of_the_robot_are_averaged(
    roslaunch: Any, ros: Any, tmp_path: Path, composed: str
) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(
        "alert_system: {ros__parameters: {signals: {pack_level: {warn_below: 20.0}}}}\n"
        "aggregator: {ros__parameters: {inputs: [pack_level]}}\n",
        encoding="utf-8",
    )
    process = roslaunch(
        *("robot_health_monitor", "health_monitor.launch", f"thresholds:={file}"),
        *(f"composed:={composed}", "sensors:=none"),
    )
    process.wait_for_text("system_health is the mean of pack_level")
    heard = ros.listen("/system_health", FLOAT32)

    def is_heard() -> bool:
        ros.publish("/pack_level", FLOAT32, {"data": 80.0})
        return bool(heard)

    ros.wait_until(is_heard)
    assert heard[0] == {"data": 80.0}


def test_a_node_that_ends_is_started_again_on_request(roslaunch: Any, ros: Any) -> None:
    process = roslaunch("robot_health_monitor", "health_monitor.launch", "composed:=true", "respawn:=true")
    for _ in range(2):
        process.wait_for_text(SENSOR_READY)
        ros.wait_until(lambda: node_pid(ros, "/health_monitor") is not None)
        os.kill(node_pid(ros, "/health_monitor"), signal.SIGKILL)
    process.wait_for_text(SENSOR_READY)


def node_pid(ros: Any, node: str) -> Any:
    """Asks a node for its process, as rosnode does."""
    import xmlrpc.client

    import rosgraph

    try:
        with xmlrpc.client.ServerProxy(ros._master.lookupNode(node)) as slave:
            return slave.getPid("/tests")[2]
    except (OSError, rosgraph.MasterException):
        return None


def test_a_refused_value_does_not_keep_a_killed_node_from_starting_again(roslaunch: Any, ros: Any) -> None:
    bound = "/alert_system/ros__parameters/signals/battery_level/warn_below"
    process = roslaunch("robot_health_monitor", "health_monitor.launch", "respawn:=true", "sensors:=none")
    process.wait_for_text("watching cpu_usage")
    ros._master.setParam(bound, "low")
    response = ros.call("/alert_system/reload", "std_srvs/Trigger")
    assert response["success"] is False
    assert ros._master.getParam(bound) == 20.0
    os.kill(node_pid(ros, "/alert_system"), signal.SIGKILL)
    process.wait_for_text("watching battery_level on /battery_level: WARN below 20 %")
    process.wait_for_text("watching cpu_usage")
    assert "exit code 2" not in process.text


def test_a_wrong_file_ends_only_the_node_that_needs_it_which_does_not_start_with_earlier_parameters(
    roslaunch: Any, ros: Any, tmp_path: Path
) -> None:
    """The parameter server outlives a launch."""
    first = roslaunch("robot_health_monitor", "health_monitor.launch", "sensors:=none")
    first.wait_for_text("watching cpu_usage")
    first.signal()
    assert first.wait(30.0) == 0
    file = tmp_path / "wrong.yaml"
    file.write_text("alert_system:\n  ros__parameters:\n    signals:\n      fan: {warn_below: low}\n", encoding="utf-8")
    second = roslaunch("robot_health_monitor", "health_monitor.launch", f"thresholds:={file}")
    second.wait_for_texts("alert_system: ", "exit code 2", SENSOR_READY)
    assert f"{file}:4: " in second.text and "warn_below" in second.text
    second.signal()
    assert second.wait(30.0) == 0


def test_alerts_are_on_the_screen_and_a_signal_that_left_the_file_is_not_watched_any_more(
    roslaunch: Any, ros: Any, tmp_path: Path
) -> None:
    """The parameter server outlives a launch."""
    file = tmp_path / "thresholds.yaml"
    battery = "battery_level: {unit: '%', warn_below: 95.0}"
    for signals in (f"{battery}, pump: {{warn_above: 3.0}}", battery):
        file.write_text(
            f"alert_system: {{ros__parameters: {{signals: {{{signals}}}}}}}\n"
            "battery_sensor: {ros__parameters: {battery_level: {discharge_rate: 4.0}}}\n",
            encoding="utf-8",
        )
        process = roslaunch("robot_health_monitor", "health_monitor.launch", f"thresholds:={file}", "composed:=true")
        process.wait_for_text("battery_level WARN: ")
        process.signal()
        assert process.wait(30.0) == 0
    assert "watching battery_level" in process.text
    assert "watching pump" not in process.text


def test_the_textbook_example_needs_configuration_only(roslaunch: Any, ros: Any) -> None:
    process = roslaunch("robot_health_monitor", "robot_monitor.launch")
    process.wait_for_texts('sensor "temp_sensor_1" started at 2 Hz', "watching sensor_data")
    heard = ros.listen("/sensor_data", FLOAT32)
    ros.wait_until(lambda: len(heard) >= 2)
    assert all(10.0 < message["data"] < 45.0 for message in heard)
    alerts = ros.listen("/alerts", "diagnostic_msgs/DiagnosticStatus")

    def is_announced() -> bool:  # it may be WARN already, from a hot spell of the simulated sensor
        for degrees in (20.0, 30.5):
            ros.publish("/sensor_data", FLOAT32, {"data": degrees})
        return any("WARN: 30.5 degC is above 30 degC" in alert["message"] for alert in alerts)

    ros.wait_until(is_announced)
    process.wait_for_text("sensor_data WARN: 30.5 °C is above 30 °C")
    process.signal()
    assert process.wait(30.0) == 0
