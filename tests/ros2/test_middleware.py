"""What the port over rclpy does beyond the port's promises: parameters, names and QoS as ROS 2 has them."""

from __future__ import annotations

from typing import Any, Dict, List, Mapping

import pytest
from harness.port_conformance import FLOAT32, Recorder, RefusingNode

from robot_health_monitor.core.config import described_parameters, load_config
from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.core.middleware import Severity
from robot_health_monitor.core.parameters import Parameter


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


def get(ros: Any, node: Any, *names: str) -> List[Any]:
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
        self.trees: List[Mapping[str, Any]] = []
        self.node = ros.node("alert_system", parameters=given)
        config = load_config(self.node.given_parameters())
        self.node.declare_parameters(described_parameters(config), self._on_change)

    def _on_change(self, tree: Mapping[str, Any]) -> None:
        load_config(tree)
        self.trees.append(tree)


GIVEN: Dict[str, Any] = {"signals": {"battery_level": {"warn_below": 20.0, "error_below": 10.0, "unit": "%"}}}
WARN_BELOW, ERROR_BELOW = "signals.battery_level.warn_below", "signals.battery_level.error_below"


def test_parameters_are_described_with_ranges_and_choices(ros: Any) -> None:
    node = Watched(ros, GIVEN).node
    rate = describe(ros, node, "publish_rate")
    assert "/diagnostics, in Hz" in rate.description
    assert [(limit.from_value, limit.to_value) for limit in rate.floating_point_range] == [(0.01, 100.0)]
    samples = describe(ros, node, "signals.battery_level.window_samples")
    assert [(limit.from_value, limit.to_value) for limit in samples.integer_range] == [(1, 1_000_000)]
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


def test_an_unknown_parameter_is_refused(ros: Any) -> None:
    watched = Watched(ros, GIVEN)
    assert "undeclared" in ros.propose(watched.node, "signals.battery_level.warn_bellow", 3.0)
    assert watched.trees == []


@pytest.mark.parametrize(
    ("given", "key"), [({"executor": "many"}, "executor"), ({"use_sim_time": "perhaps"}, "use_sim_time")]
)
def test_the_arguments_of_the_adapter_are_checked(ros: Any, given: Mapping[str, Any], key: str) -> None:
    with pytest.raises(ConfigError, match=key):
        ros.node("alert_system", parameters=given, sim_time=None).given_parameters()


def test_the_log_level_can_be_changed(ros: Any) -> None:
    node = ros.node("alert_system", parameters={"log_level": "WARN"})
    levels = Parameter("log_level", str, "INFO", "least severe", choices=("INFO", "WARN"))
    node.declare_parameters([levels], lambda tree: None)
    node.log(Severity.INFO, "not this one")
    assert ros.propose(node, "log_level", "INFO") == ""
    node.log(Severity.INFO, "but this one")
    ros.wait_until(lambda: any(line.text == "but this one" for line in ros.log_lines()))
    assert not any(line.text == "not this one" for line in ros.log_lines())


def test_an_invalid_topic_name_is_a_configuration_error(ros: Any) -> None:
    node = ros.node("alert_system")
    with pytest.raises(ConfigError, match="'battery level'"):
        node.subscribe("battery level", FLOAT32, Recorder(), field="data")
    with pytest.raises(ConfigError, match="'1st'"):
        node.advertise("1st", FLOAT32)


def best_effort_publisher(ros: Any, topic: str) -> Any:
    from rclpy.qos import qos_profile_sensor_data
    from std_msgs.msg import Float32

    return ros._me.create_publisher(Float32, topic, qos_profile_sensor_data)


@pytest.mark.parametrize("is_early", [True, False])
def test_best_effort_and_reliable_publishers_are_both_received(ros: Any, is_early: bool) -> None:
    from std_msgs.msg import Float32

    heard = Recorder()
    publisher = best_effort_publisher(ros, "/in") if is_early else None
    if is_early:
        ros.wait_until(lambda: ros._witness.count_publishers("/in") == 1)
    node = ros.node("alert_system")
    node.subscribe("in", FLOAT32, heard, field="data")
    if not is_early:
        ros.publish("/in", FLOAT32, {"data": 1.0})
        ros.wait_until(lambda: heard.values == [1.0])
        publisher = best_effort_publisher(ros, "/in")

    def arrived() -> bool:
        publisher.publish(Float32(data=2.0))
        return 2.0 in heard.values

    ros.wait_until(arrived)
    ros.publish("/in", FLOAT32, {"data": 3.0})
    ros.wait_until(lambda: 3.0 in heard.values)


def test_subscriptions_are_reliable_while_every_publisher_is(ros: Any) -> None:
    from rclpy.qos import ReliabilityPolicy

    ros.node("alert_system").subscribe("in", FLOAT32, Recorder(), field="data")
    ros.publish("/in", FLOAT32, {"data": 1.0})
    (info,) = ros._witness.get_subscriptions_info_by_topic("/in")
    assert info.qos_profile.reliability == ReliabilityPolicy.RELIABLE


def test_a_refusing_node_keeps_rclpys_own_parameters_out_of_the_tree(ros: Any) -> None:
    given = {"publish_rate": 2.0, "qos_overrides": {"out": {"publisher": {"depth": 5}}}, "executor": "single"}
    node = ros.node("alert_system", parameters=given)
    RefusingNode(node)
    assert node.given_parameters() == {"publish_rate": 2.0}


def test_a_small_step_back_restarts_the_period_too(ros: Any) -> None:
    times_s: List[float] = []
    ros.node("aggregator").create_timer(1.0, times_s.append)
    for step, calls in ((100.75, 0), (100.5, 0), (101.25, 0), (101.5, 1)):
        ros.set_time(step)
        ros.wait_until(lambda expected=calls: len(times_s) >= expected)
    assert times_s == [101.5]


def test_periods_begin_with_simulated_time(ros: Any) -> None:
    """Until the first message on /clock it is 0; that the clock then shows hours is no reason for a call."""
    times_s: List[float] = []
    node = ros.node("aggregator", before_time=lambda node: node.create_timer(1.0, times_s.append))
    assert node.now_s() == 100.0
    ros.set_time(100.5)
    ros.set_time(101.0)
    ros.wait_until(lambda: bool(times_s))
    assert times_s == [101.0]


def test_cancelled_timers_are_forgotten(ros: Any) -> None:
    node = ros.node("alert_system", sim_time=False)
    kept = node.create_timer(1000.0, lambda now_s: None)
    native = len(list(node.node.timers))
    for steady in (False, True) * 20:
        node.create_timer(1000.0, lambda now_s: None, steady=steady).cancel()
    assert node._timers == [kept]
    assert len(list(node.node.timers)) == native


def test_a_burst_of_alerts_arrives_completely(ros: Any) -> None:
    """With a queue of 10, a reliable subscriber loses what was published while it did not read."""
    node = ros.node("alert_system")
    node.advertise("alerts", FLOAT32)
    messages: List[float] = []
    from std_msgs.msg import Float32

    ros._me.create_subscription(Float32, "/alerts", lambda native: messages.append(native.data), 1000)
    ros.wait_until(lambda: node.has_listeners("alerts"))
    for number in range(500):
        node.publish("alerts", {"data": float(number)})
    ros.wait_until(lambda: len(messages) == 500)
    assert messages == [float(number) for number in range(500)]


def test_a_type_of_a_package_that_is_not_installed_is_rejected(ros: Any) -> None:
    node = ros.node("alert_system")
    with pytest.raises(ConfigError, match="no_such_msgs/Float32"):
        node.advertise("out", "no_such_msgs/Float32")
    with pytest.raises(ConfigError, match="no_such_msgs/Float32"):
        node.subscribe("in", "no_such_msgs/Float32", Recorder(), field="data")
