"""`robot-health check`: one line per file, on stdout when it is right, on stderr when it is wrong."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path
from typing import Callable
from xml.etree import ElementTree

import pytest
from harness.line_process import LineProcess

from robot_health_monitor.cli.commands.check_command import check, check_field, known_definitions
from robot_health_monitor.core.values.errors import ConfigError

Start = Callable[..., LineProcess]
ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture
def robot_health(robot_health_here: Start) -> Start:
    return robot_health_here


def test_the_installed_configuration_is_right_and_its_contents_are_summed_up(robot_health_process: Start) -> None:
    file = ROOT / "config" / "thresholds.yaml"
    process = robot_health_process("check", file)
    assert process.wait() == 0
    assert [(line.stream, line.text) for line in process.lines] == [
        ("out", f"{file}: OK: 3 signals (battery_level, temperature, cpu_usage), 5 bounds")
    ]


@pytest.mark.newest_python
@pytest.mark.parametrize("file", sorted((ROOT / "config").glob("*.yaml")), ids=lambda file: file.name)
def test_every_configuration_that_is_installed_is_right(robot_health: Start, file: Path) -> None:
    process = robot_health("check", file)
    assert process.wait() == 0, process.text


@pytest.mark.parametrize(
    ("contents", "line"),
    [
        pytest.param(
            b"alert_system:\n  ros__parameters:\n    signals:\n      arm:\n        warn_belw: 1.0\n",
            ":5: alert_system.ros__parameters.signals.arm.warn_belw: unknown key; did you mean warn_below?",
            id="unknown key",
        ),
        pytest.param(
            b"alert_system:\n  ros__parameters:\n    signals:\n      arm: {warn_below: 1.0, error_below: 2.0}\n",
            ":4: alert_system.ros__parameters.signals.arm.error_below: expected at most warn_below (1), got 2",
            id="contradictory bounds",
        ),
        pytest.param(
            b"alert_system:\n  ros__parameters:\n    signals: {arm: {}}\n"
            b"battery_sensor:\n  ros__parameters:\n    battery_level:\n      discharge_rate: fast\n",
            ":7: battery_sensor.ros__parameters.battery_level.discharge_rate: expected a number of at least 0",
            id="another node of the same file",
        ),
        pytest.param(
            b"alert_system:\n  ros__parameters:\n    signals: {arm: {}}\naggregator:\n  ros__parameters: [1]\n",
            ":5: aggregator.ros__parameters: expected a mapping of keys to values, got [1]",
            id="parameters that are a list",
        ),
        pytest.param(
            b"history: {file: a.db}\nnotify:\n  chat: {type: webhok, url: 'http://a'}\n",
            ":3: notify.chat.type: expected one of alertmanager, webhook, command, apprise, heartbeat, got 'webhok'",
            id="ops.yaml",
        ),
        pytest.param(
            b"notfy: {}\n",
            ":1: notfy: unknown key; did you mean notify?",
            id="ops.yaml whose only section is misspelt",
        ),
        pytest.param(b"signals: {arm: {}}\n", ":1: signals: expected below the name of a node: ", id="no node"),
        pytest.param(b"", ": expected a mapping of keys to values, got nothing", id="empty"),
        pytest.param(b"a:\n  b: [1\nc: 2\n", ":3: is not valid YAML: ", id="syntax"),
        pytest.param(b"# 80 \xb0C\n", ": is not UTF-8 text: byte 5 is 0xb0", id="latin-1"),
        pytest.param(b"\xff\xfea\x00:\x00", ": is not UTF-8 text: byte 0 is 0xff", id="UTF-16"),
        pytest.param(bytes(range(256)), ": is not ", id="binary"),
    ],
)
def test_a_wrong_file_is_one_line_with_the_place_and_code_2(
    robot_health: Start, tmp_path: Path, contents: bytes, line: str
) -> None:
    file = tmp_path / "wrong.yaml"
    file.write_bytes(contents)
    process = robot_health("check", file)
    assert process.wait() == 2
    assert [(each.stream, each.text[: len(f"{file}{line}")]) for each in process.lines] == [("err", f"{file}{line}")]


def test_the_example_of_an_ops_yaml_is_right_and_so_is_what_it_shows_in_comments(
    robot_health: Start, tmp_path: Path
) -> None:
    text = (ROOT / "examples" / "ops.yaml").read_text(encoding="utf-8")
    complete = tmp_path / "complete.yaml"
    # An example in a comment is a section, and what is indented below it.
    complete.write_text(re.sub(r"^# (?=(notify|server):|  )", "", text, flags=re.MULTILINE))
    process = robot_health("check", ROOT / "examples" / "ops.yaml", complete)
    assert process.wait() == 0, process.text
    assert [line.text.partition(": ")[2] for line in process.lines] == [
        "OK: history",
        "OK: history, notify, server",
    ]


def test_an_ops_yaml_is_recognised_and_summed_up(robot_health: Start, tmp_path: Path) -> None:
    file = tmp_path / "operations.yaml"
    file.write_text(
        "server: {port: 9090}\n"
        "notify:\n"
        "  pager: {type: alertmanager, url: 'http://10.0.0.2:9093'}\n"
        "  alive: {type: heartbeat, url: 'https://example.com/alive'}\n"
        "history: {file: history.db}\n"
    )
    process = robot_health("check", file)
    assert process.wait() == 0
    assert process.text == f"out: {file}: OK: history, notify, server"


def test_a_node_that_has_the_name_of_a_section_makes_no_ops_yaml(robot_health: Start, tmp_path: Path) -> None:
    file = tmp_path / "server.yaml"
    file.write_text("server: {ros__parameters: {signals: {arm: {}}}}\n")
    process = robot_health("check", file)
    assert process.wait() == 0
    assert process.text == f"out: {file}: OK: 1 signal (arm), 0 bounds"


def test_a_file_that_is_not_there_is_one_line(robot_health: Start, tmp_path: Path) -> None:
    process = robot_health("check", tmp_path / "nowhere.yaml")
    assert process.wait() == 2
    assert process.text == f"err: {tmp_path}/nowhere.yaml: cannot be read: No such file or directory"


def test_a_directory_is_one_line(robot_health: Start, tmp_path: Path) -> None:
    process = robot_health("check", tmp_path)
    assert process.wait() == 2
    assert process.text == f"err: {tmp_path}: cannot be read: expected a file, got a directory, a device or a pipe"


def test_a_file_that_may_not_be_read_is_one_line(command: list[str], environment: dict[str, str], calm: Path) -> None:
    calm.chmod(0)
    if os.geteuid() == 0:  # root may read every file, unless it gives up these capabilities
        if shutil.which("setpriv") is None:
            pytest.skip("setpriv is not installed (Debian's package util-linux)")
        command = ["setpriv", "--bounding-set=-dac_override,-dac_read_search", *command]
    done = subprocess.run([*command, "check", str(calm)], env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == f"{calm}: cannot be read: Permission denied\n"


def test_a_line_break_in_a_name_makes_no_second_line(robot_health: Start, tmp_path: Path) -> None:
    process = robot_health("check", tmp_path / "no\nwhere")
    assert process.wait() == 2
    assert process.text == f"err: {tmp_path}/no?where: cannot be read: No such file or directory"


def test_of_several_files_each_is_judged_and_one_that_is_wrong_decides(
    robot_health: Start, calm: Path, restless: Path, tmp_path: Path
) -> None:
    process = robot_health("check", calm, tmp_path / "nowhere.yaml", restless)
    assert process.wait() == 2
    assert len(process.errors) == 1
    right = [line.text for line in process.lines if line.stream == "out"]
    assert right == [
        f"{calm}: OK: 3 signals (battery_level, temperature, cpu_usage), 1 bound",
        f"{restless}: OK: 1 signal (battery_level), 2 bounds",
    ]


def test_nodes_that_do_not_run_here_are_named(robot_health: Start, tmp_path: Path) -> None:
    file = tmp_path / "more.yaml"
    file.write_text("my_monitor: {ros__parameters: {signals: {arm: {}}}}\nnavigator: {ros__parameters: {speed: 1.0}}\n")
    process = robot_health("check", file)
    assert process.wait() == 0
    assert process.text == f"out: {file}: OK: 1 signal (arm), 0 bounds; not used here: navigator"


MISTAKES = """\
alert_sytem:
  ros__parameters:
    signals: {spare: {warn_belw: 1}}
alert_system:
  ros__parameters:
    publish_rate: fast
    signals:
      arm: {topic: my arm, type: std_msgs/Flaot32, warn_below: 1, warn_below: 2}
      battery: {type: sensor_msgs/BatteryState, field: percentag, topic: battery,
                hysteresis: -1}
      current: {type: nav_msgs/Odometry, topic: battery}
      link: {}
robot2:
  alert_system: {ros__parameters: {signals: {leg: {scale: 0}}}}
aggregator:
  ros__parameters: {window_s: 0, methd: mean}
battery_sensor:
  ros__parameters:
    publish_rate: 0
    battery_level: {source: hots, charge_at: 100}
    host: {memory: {source: ram}, disk: {}, cpu_usage: {source: cpu_percent}}
batery_sensor:
  ros__parameters: {}
"""


def test_all_mistakes_of_a_file_are_reported_with_the_lines_of_their_keys(robot_health: Start, tmp_path: Path) -> None:
    file = tmp_path / "wrong.yaml"
    file.write_text(MISTAKES)
    process = robot_health("check", file)
    assert process.wait() == 2
    lines = [line.text[len(f"{file}:") :] for line in process.lines if line.stream == "err"]
    signals = "alert_system.ros__parameters.signals"
    expected = [
        "1: alert_sytem: unknown node; did you mean alert_system?",
        "3: alert_sytem.ros__parameters.signals.spare.warn_belw: unknown key; did you mean warn_below?",
        "6: alert_system.ros__parameters.publish_rate: expected a number from 0.01 to 100, got 'fast'",
        f"8: {signals}.arm.warn_below: is given twice, first in line 8",
        f"8: {signals}.arm.topic: expected the name of a topic, got 'my arm'",
        f"8: {signals}.arm.type: expected a message type, got std_msgs/Flaot32, which does not exist;"
        " did you mean std_msgs/Float32?",
        f"9: {signals}.battery.field: battery: sensor_msgs/BatteryState has no field percentag;",
        f"10: {signals}.battery.hysteresis: expected a number of at least 0, got -1",
        f"12: {signals}.link: this name is reserved for the link to the robot; expected another",
        "14: robot2.alert_system: expected one section for alert_system in a file (one file per robot),"
        " got alert_system and robot2.alert_system",
        f"14: robot2.{signals}.leg.scale: expected a number other than 0, got 0",
        "16: aggregator.ros__parameters.window_s: expected a number from 0.001 to 31536000, got 0",
        "16: aggregator.ros__parameters.methd: unknown key; did you mean method?",
        "19: battery_sensor.ros__parameters.publish_rate: expected a number from 0.01 to 1000, got 0",
        "20: battery_sensor.ros__parameters.battery_level.source: expected one of simulated, host, none, got 'hots'",
        "20: battery_sensor.ros__parameters.battery_level.charge_at: expected a number from 0 to 99, got 100",
        "21: battery_sensor.ros__parameters.host.memory.source: expected one of cpu_percent, load_1min, load_5min, ",
        "21: battery_sensor.ros__parameters.host.disk.source: is missing; expected one of cpu_percent, load_1min, ",
        "21: battery_sensor.ros__parameters.host.cpu_usage: is the name of a standard metric; expected another name",
        "22: batery_sensor: unknown node; did you mean battery_sensor?",
    ]
    assert [line[: len(start)] for line, start in zip(lines, expected)] == expected
    assert len(lines) == len(expected)


def test_a_file_of_thousands_of_mistakes_ends_after_a_hundred(robot_health: Start, tmp_path: Path) -> None:
    file = tmp_path / "wrong.yaml"
    keys = "".join(f"      s{number}: {{warn_belw: 1}}\n" for number in range(3000))
    file.write_text(f"alert_system:\n  ros__parameters:\n    signals:\n{keys}")
    process = robot_health("check", file)
    assert process.wait() == 2
    assert len(process.errors) == 101
    assert process.errors[-1] == f"{file}: further mistakes are not shown"


@pytest.mark.newest_python
@pytest.mark.parametrize(
    ("signal", "problem"),
    [
        ("{type: std_msgs/Float32, field: data}", ""),
        ("{type: std_msgs/msg/Float32}", ""),
        ("{type: sensor_msgs/BatteryState, field: 'cell_voltage[3]'}", ""),
        ("{type: sensor_msgs/Imu, field: header.stamp.sec}", ""),
        ("{type: sensor_msgs/Imu, field: header.stamp.secs}", ""),
        ("{type: sensor_msgs/Imu, field: ''}", ""),
        ("{type: sensor_msgs/CameraInfo, field: 'k[0]'}", ""),
        ('{type: diagnostic_msgs/DiagnosticArray, field: \'status["a"].values["b"]\'}', ""),
        ("{type: rcl_interfaces/msg/Log, field: line, where: 'level >= ERROR and name == \"a*\"'}", ""),
        (
            "{type: rosgraph_msgs/Log, field: '', where: 'level >= EROR'}",
            "where: s: rosgraph_msgs/Log has no constant ",
        ),
        ("{type: rosgraph_msgs/Log, field: '', where: 'lvl >= ERROR'}", "where: s: rosgraph_msgs/Log has no field lvl"),
        (
            "{field: '', where: 'level >= '}",
            "where: expected comparisons such as level >= ERROR and name == \"*arm*\", got 'level >='",
        ),
        ("{type: sensor_msgs/Imu}", "field: s: sensor_msgs/Imu has no field data;"),
        ("{type: sensor_msgs/Imu, field: 'orientation_covariance[9]'}", "field: s: sensor_msgs/Imu has no field "),
        ("{type: std_srvs/Trigger}", "type: expected a message type, got std_srvs/Trigger, which does not exist"),
        ("{type: sensor_msgs/Battery}", "type: expected a message type, got sensor_msgs/Battery, which does not exist"),
    ],
)
def test_types_and_fields_of_the_standard_packages_are_checked(
    robot_health: Start, tmp_path: Path, signal: str, problem: str
) -> None:
    file = tmp_path / "thresholds.yaml"
    file.write_text(f"alert_system:\n  ros__parameters:\n    signals:\n      s: {signal}\n")
    process = robot_health("check", file)
    assert process.wait() == (2 if problem else 0), process.text
    start = f"{file}:4: alert_system.ros__parameters.signals.s.{problem}"
    assert [line[: len(start)] for line in process.errors] == ([start] if problem else [])


def test_types_that_are_not_known_here_are_named(robot_health: Start, tmp_path: Path) -> None:
    file = tmp_path / "thresholds.yaml"
    file.write_text(
        "alert_system:\n  ros__parameters:\n    signals:\n      odometry: {type: my_msgs/msg/Wheels, field: left.rpm}\n"
    )
    process = robot_health("check", file)
    assert process.wait() == 0
    assert process.text == (
        f"out: {file}: OK: 1 signal (odometry), 0 bounds; fields not checked, their types are not known here:"
        " my_msgs/Wheels"
    )


@pytest.mark.parametrize(
    "value",
    ["*x11", "59:59:" + ":".join(["59"] * 3000), "9" * 5000],
    ids=["aliases of aliases", "sexagesimal number", "number of 5000 digits"],
)
def test_a_hostile_value_is_one_line(robot_health: Start, tmp_path: Path, value: str) -> None:
    levels = "".join(f"x{level}: &x{level} [{', '.join([f'*x{level - 1}'] * 9)}]\n" for level in range(1, 12))
    file = tmp_path / "bomb.yaml"
    file.write_text(
        f"x0: &x0 [1]\n{levels if '*' in value else ''}alert_system:\n  ros__parameters:\n    signals:\n"
        f"      arm: {{warn_below: {value}}}\n"
    )
    process = robot_health("check", file)
    assert process.wait() == 2
    assert len(process.errors) == 1 and len(process.errors[0]) < 400


def test_a_named_pipe_is_one_line_and_not_waited_for(robot_health: Start, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    process = robot_health("check", tmp_path / "pipe")
    assert process.wait() == 2
    assert process.text == f"err: {tmp_path}/pipe: cannot be read: expected a file, got a directory, a device or a pipe"


def test_no_text_of_a_file_controls_the_terminal(robot_health: Start, tmp_path: Path) -> None:
    file = tmp_path / "wrong.yaml"
    file.write_text('alert_system:\n  ros__parameters: {signals: {"a\\e[31m\\n": {}}, "\\e]0;x": "\\u202e"}\n')
    process = robot_health("check", file)
    assert process.wait() == 2
    assert len(process.errors) == 2
    assert all(line.isprintable() for line in process.errors)


def test_version_is_that_of_package_xml(robot_health: Start) -> None:
    process = robot_health("--version")
    assert process.wait() == 0
    version = ElementTree.parse(ROOT / "package.xml").findtext("version")
    assert process.text == f"out: robot-health {version}"


@pytest.mark.parametrize("arguments", [["--help"], ["run", "--help"], ["check", "--help"]])
def test_help_goes_to_stdout(robot_health: Start, arguments: list) -> None:
    process = robot_health(*arguments)
    assert process.wait() == 0
    assert process.text.startswith("out: usage: robot-health")


def test_a_fleet_file_is_checked_with_the_thresholds_that_it_names(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "t.yaml").write_text("alert_system: {ros__parameters: {signals: {a: {warn_below: 1.0}}}}\n")
    file = tmp_path / "fleet.yaml"
    text = "defaults: {thresholds: t.yaml, token_file: token}\nrobots:\n  a: {url: 'ws://a'}\n"
    file.write_text(text + "  b: {url: 'ws://b'}\n")
    assert check([str(file)])
    assert capsys.readouterr().out == (
        f"{file}: OK: 2 robots; thresholds: {tmp_path}/t.yaml; not read here: {tmp_path}/token\n"
    )
    (tmp_path / "t.yaml").write_text("alert_system: {ros__parameters: {signals: {a: {warn_belw: 1.0}}}}\n")
    file.write_text(text + "  b: {url: 'http://b'}\n")
    assert not check([str(file)])
    lines = capsys.readouterr().err.splitlines()
    assert sorted(line.partition(": ")[0] for line in lines) == [f"{file}:4", f"{tmp_path}/t.yaml:1"]
    file.write_text(text)
    assert not check([str(file)])
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"{tmp_path}/t.yaml:1: alert_system.ros__parameters.signals.a.warn_belw: unknown key")


def test_with_verbose_an_unknown_key_lists_all_allowed_keys(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "t.yaml"
    file.write_text("alert_system: {ros__parameters: {signals: {a: {warn_belw: 1.0, reduc: sum}}}}\n")
    assert not check([str(file)])
    place = f"{file}:1: alert_system.ros__parameters.signals.a"
    lines = [
        f"{place}.warn_belw: unknown key; did you mean warn_below?",
        f"{place}.reduc: unknown key; did you mean reduce?",
    ]
    assert capsys.readouterr().err.splitlines() == lines
    assert not check([str(file)], verbose=True)
    for line, written in zip(lines, capsys.readouterr().err.splitlines()):
        assert written.startswith(f"{line}; the keys here: topic, ")
        assert ", type, field, where, reduce, " in written
        assert written.endswith(", only_if, latch_release_if")


def test_a_fleet_file_of_robots_that_push_needs_no_url(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "fleet.yaml"
    file.write_text("robots: {husky1: {}, r2: {url: 'ws://r2'}}\n")
    assert check([str(file)])
    without = "without url, for export fleet only (connect needs one)"
    assert capsys.readouterr().out == f"{file}: OK: 2 robots; 1 {without}: husky1\n"
    file.write_text(f"robots: {{{', '.join(f'r{number}: {{}}' for number in range(3000))}}}\n")
    assert check([str(file)])
    assert capsys.readouterr().out == f"{file}: OK: 3,000 robots; 3,000 {without}: r0, r1, r2, r3, r4, ...\n"


def test_a_remark_names_its_place_and_is_no_mistake(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "t.yaml"
    text = """\
alert_system:
  ros__parameters:
    signals:
      battery_soon: {unit: "%", statistic: forecast, forecast_s: 1800.0, warn_below: 20.0}
      cell_soon:
        statistic: forecast
        forecast_s: 600.0
        unit: V
"""
    file.write_text(text)
    assert check([str(file)])
    path = "alert_system.ros__parameters.signals"
    expected = [
        f"{file}: OK: 2 signals (battery_soon, cell_soon), 1 bound",
        f"{file}:4: {path}.battery_soon.for_s: remark: with forecast_s (1800) above window_s (600), "
        "noise alerts falsely; set it to at least 300",
        f"{file}:8: {path}.cell_soon.unit: remark: a forecast of a voltage is questionable; prefer the charge in %",
    ]
    written = capsys.readouterr()
    assert (written.out.splitlines(), written.err) == (expected, "")
    fleet = tmp_path / "fleet.yaml"
    fleet.write_text("robots: {a: {url: 'ws://a', thresholds: t.yaml}}\n")
    assert check([str(fleet)])
    assert capsys.readouterr().out.splitlines()[1:] == expected[1:]
    file.write_text(text + "        stale_after_s: -1\n")
    assert not check([str(file)])
    assert capsys.readouterr().out == ""


@pytest.fixture
def without_ros(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ROS_VERSION", raising=False)


@pytest.mark.usefixtures("without_ros")
@pytest.mark.parametrize(
    ("type_name", "field"),
    [
        ("std_msgs/Float32", "data"),
        ("std_msgs/msg/Float32", "data"),
        ("sensor_msgs/BatteryState", "cell_voltage[0]"),
        ("diagnostic_msgs/DiagnosticArray", 'status["motor: left"].values["Temperature (C)"]'),
        ("sensor_msgs/Imu", ""),
    ],
)
def test_types_of_the_standard_packages_are_known(type_name: str, field: str) -> None:
    assert check_field(known_definitions(), "/topic", type_name, field)


@pytest.mark.usefixtures("without_ros")
def test_a_type_of_another_package_is_unknown_but_no_error() -> None:
    assert not check_field(known_definitions(), "/topic", "my_robot_msgs/Wheel", "speed")


@pytest.mark.usefixtures("without_ros")
def test_a_misspelt_type_of_a_standard_package_names_the_close_one() -> None:
    with pytest.raises(ConfigError, match=r"std_msgs/Flaot32.*did you mean std_msgs/Float32\?") as problem:
        check_field(known_definitions(), "/topic", "std_msgs/Flaot32", "data")
    assert problem.value.path == ("type",)


@pytest.mark.usefixtures("without_ros")
def test_a_field_that_the_type_lacks_lists_those_that_it_has() -> None:
    with pytest.raises(ConfigError, match="percentage") as problem:
        check_field(known_definitions(), "/topic", "sensor_msgs/BatteryState", "percent")
    assert problem.value.path == ("field",)


@pytest.mark.usefixtures("without_ros")
@pytest.mark.parametrize("version", ["1", "2", "nonsense"])
def test_a_sourced_ros_without_its_modules_leaves_the_standard_packages(
    version: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_VERSION", version)
    assert check_field(known_definitions(), "/topic", "std_msgs/Float32", "data")
