"""The parameters of a node as ROS 2 shows and changes them.

In parameter files, errors name file and line, and a node's section applies in any namespace.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Mapping

import pytest

pytest.importorskip("rclpy")

from robot_health_monitor.core.config.monitor_config import described_parameters, load_config
from robot_health_monitor.core.config.parameters import Parameter
from robot_health_monitor.core.port.middleware import NOTHING_CHANGED, Severity
from robot_health_monitor.core.values.errors import ConfigError
from robot_health_monitor.ros2.parameters import ParameterFiles


def set_atomically(ros: Any, node: Any, values: Mapping[str, Any]) -> str:
    """Sets several parameters as one change; returns the reason of a refusal, empty when it was accepted."""
    from rcl_interfaces.srv import SetParametersAtomically
    from rclpy.parameter import Parameter as Native

    request = SetParametersAtomically.Request(
        parameters=[Native(name, value=value).to_parameter_msg() for name, value in values.items()]
    )
    result = ros._call(f"{node.name}/set_parameters_atomically", SetParametersAtomically, request).result
    assert result.successful == (not result.reason)
    return str(result.reason)


def get(ros: Any, node: Any, *names: str) -> list[Any]:
    from rcl_interfaces.srv import GetParameters
    from rclpy.parameter import parameter_value_to_python

    values = ros._call(f"{node.name}/get_parameters", GetParameters, GetParameters.Request(names=names)).values
    return [parameter_value_to_python(value) for value in values]


def describe(ros: Any, node: Any, name: str) -> Any:
    from rcl_interfaces.srv import DescribeParameters

    request = DescribeParameters.Request(names=[name])
    (descriptor,) = ros._call(f"{node.name}/describe_parameters", DescribeParameters, request).descriptors
    return descriptor


class Watched:
    """A node whose parameters are those of alert_system with one signal."""

    def __init__(self, ros: Any, given: Mapping[str, Any]) -> None:
        self.trees: list[Mapping[str, Any]] = []
        self.node = ros.node("alert_system", parameters=given)
        config = load_config(self.node.given_parameters())
        self.node.declare_parameters(described_parameters(tuple(config.signals)), self._on_change)

    def _on_change(self, tree: Mapping[str, Any]) -> None:
        load_config(tree)
        self.trees.append(tree)


GIVEN: dict[str, Any] = {"signals": {"battery_level": {"warn_below": 20.0, "error_below": 10.0, "unit": "%"}}}
WARN_BELOW, ERROR_BELOW = "signals.battery_level.warn_below", "signals.battery_level.error_below"


def test_parameters_are_described_with_what_is_allowed(ros: Any) -> None:
    node = Watched(ros, GIVEN).node
    rate = describe(ros, node, "publish_rate")
    assert "/diagnostics, in Hz" in rate.description
    assert rate.additional_constraints == "a number from 0.01 to 100"
    statistic = describe(ros, node, "signals.battery_level.statistic")
    assert statistic.additional_constraints.startswith("one of last, mean, min")
    assert "WARN below this value" in describe(ros, node, WARN_BELOW).description


def test_parameters_show_what_was_given_and_the_defaults(ros: Any) -> None:
    node = Watched(ros, GIVEN).node
    assert get(ros, node, WARN_BELOW, "signals.battery_level.warn_above", "publish_rate", "executor") == [
        20.0,
        None,
        1.0,
        "auto",
    ]


def test_a_whole_number_will_do_for_a_bound(ros: Any) -> None:
    watched = Watched(ros, GIVEN)
    assert ros.propose(watched.node, WARN_BELOW, 30) == ""
    assert watched.trees[-1]["signals"]["battery_level"]["warn_below"] == 30
    assert get(ros, watched.node, WARN_BELOW) == [30]


def test_a_contradiction_is_refused_with_the_reason_and_the_old_values_stay(ros: Any) -> None:
    watched = Watched(ros, GIVEN)
    reason = ros.propose(watched.node, WARN_BELOW, 5.0)
    assert reason.startswith("signals.battery_level.error_below: expected at most warn_below (5), got 10")
    assert get(ros, watched.node, WARN_BELOW) == [20.0]
    assert watched.trees == []


def test_a_wrong_kind_is_refused_with_what_is_allowed(ros: Any) -> None:
    watched = Watched(ros, GIVEN)
    assert ros.propose(watched.node, WARN_BELOW, "low") == f"{WARN_BELOW}: expected a number, got 'low'"
    assert get(ros, watched.node, WARN_BELOW) == [20.0]


def test_parameters_that_are_set_together_are_one_change(ros: Any) -> None:
    """Neither bound could be moved below the other's old value alone."""
    watched = Watched(ros, GIVEN)
    assert set_atomically(ros, watched.node, {WARN_BELOW: 5.0, ERROR_BELOW: 2.0}) == ""
    assert [tree["signals"]["battery_level"]["error_below"] for tree in watched.trees] == [2.0]
    assert get(ros, watched.node, WARN_BELOW, ERROR_BELOW) == [5.0, 2.0]
    assert "error_below" in set_atomically(ros, watched.node, {WARN_BELOW: 1.0, "publish_rate": 5.0})
    assert get(ros, watched.node, WARN_BELOW, "publish_rate") == [5.0, 1.0]


def test_a_deleted_bound_is_off_and_can_be_set_again(ros: Any) -> None:
    watched = Watched(ros, GIVEN)
    assert ros.propose(watched.node, ERROR_BELOW, None) == ""
    assert "error_below" not in watched.trees[-1]["signals"]["battery_level"]
    assert get(ros, watched.node, ERROR_BELOW) == [None]
    assert ros.propose(watched.node, ERROR_BELOW, 8.0) == ""
    assert watched.trees[-1]["signals"]["battery_level"]["error_below"] == 8.0


@pytest.mark.parametrize(("name", "value"), [("use_sim_time", False), ("executor", "events")])
def test_what_is_fixed_at_the_start_cannot_be_changed(ros: Any, name: str, value: object) -> None:
    watched = Watched(ros, GIVEN)
    assert name in ros.propose(watched.node, name, value)
    assert watched.trees == []


@pytest.mark.parametrize(
    ("given", "key"), [({"executor": "many"}, "executor"), ({"use_sim_time": "perhaps"}, "use_sim_time")]
)
def test_the_arguments_of_the_adapter_are_checked(ros: Any, given: Mapping[str, Any], key: str) -> None:
    with pytest.raises(ConfigError, match=key):
        ros.node("alert_system", parameters=given, sim_time=None).given_parameters()


def test_an_accepted_change_is_one_info_line(ros: Any) -> None:
    node = ros.node("alert_system")
    rate = Parameter("publish_rate", float, 1.0, "rate in Hz")
    node.declare_parameters([rate], lambda tree: NOTHING_CHANGED if tree["publish_rate"] == 3.0 else "rate: 1 -> 2")
    for value in (2.0, 3.0):
        assert ros.propose(node, "publish_rate", value) == ""

    def changes() -> list[str]:
        return [line.text for line in ros.log_lines() if "parameters changed" in line.text]

    ros.wait_until(lambda: bool(changes()))  # log lines come over /rosout
    assert changes() == ["parameters changed: rate: 1 -> 2"]


def test_the_log_level_can_be_changed(ros: Any) -> None:
    node = ros.node("alert_system", parameters={"log_level": "WARN"})
    levels = Parameter("log_level", str, "INFO", "least severe", choices=("INFO", "WARN"))
    node.declare_parameters([levels], lambda tree: None)
    node.log(Severity.INFO, "not this one")
    assert ros.propose(node, "log_level", "INFO") == ""
    node.log(Severity.INFO, "but this one")
    ros.wait_until(lambda: any(line.text == "but this one" for line in ros.log_lines()))
    assert not any(line.text == "not this one" for line in ros.log_lines())


THRESHOLDS = """alert_system:
  ros__parameters:
    signals:
      battery_level: {warn_below: 20.0}
"""


def arguments(file: Path) -> list[str]:
    return ["alert_system", "--ros-args", "--params-file", str(file)]


@pytest.fixture
def thresholds(tmp_path: Path) -> Path:
    file = tmp_path / "thresholds.yaml"
    file.write_text(THRESHOLDS, encoding="utf-8")
    return file


def test_a_section_applies_in_any_namespace(thresholds: Path) -> None:
    files = ParameterFiles(arguments(thresholds))
    with files.arguments_for_any_namespace() as changed:
        assert changed[:3] == ["alert_system", "--ros-args", "--params-file"]
        copy = Path(changed[3]).read_text(encoding="utf-8")
    assert copy == THRESHOLDS.replace("alert_system:", '"/**/alert_system":')
    assert thresholds.read_text(encoding="utf-8") == THRESHOLDS


def test_an_absolute_name_is_not_changed(tmp_path: Path) -> None:
    file = tmp_path / "absolute.yaml"
    file.write_text(THRESHOLDS.replace("alert_system:", "/robot1/alert_system:"), encoding="utf-8")
    with ParameterFiles(arguments(file)).arguments_for_any_namespace() as changed:
        assert Path(changed[3]).read_text(encoding="utf-8") == file.read_text(encoding="utf-8")


def test_copies_are_gone_afterwards(thresholds: Path) -> None:
    with ParameterFiles(arguments(thresholds)).arguments_for_any_namespace() as changed:
        copy = changed[3]
    assert not Path(copy).exists()


def test_an_error_of_a_node_gets_file_and_line(thresholds: Path) -> None:
    files = ParameterFiles(arguments(thresholds))
    error = ConfigError("expected a number", ("signals", "battery_level", "warn_below"))
    assert str(files.located(error, "/robot1/alert_system")).startswith(f"{thresholds}:4: ")
    assert files.located(error, "/robot1/other") is error


def test_a_missing_file_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.yaml"):
        ParameterFiles(arguments(tmp_path / "none.yaml"))


def test_a_message_of_rcl_names_the_users_file_and_its_line(thresholds: Path) -> None:
    files = ParameterFiles(arguments(thresholds))
    with files.arguments_for_any_namespace() as changed:
        problem = (
            f"failed to parse arguments: Couldn't parse params file: '--params-file {changed[3]}'. "
            "Error: Cannot have a value before ros__parameters at line 3, at ./src/parse.c:1"
        )
        explained = files.explained(problem)
    assert str(explained) == problem.replace(changed[3], str(thresholds))
