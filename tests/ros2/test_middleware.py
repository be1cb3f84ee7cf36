"""What the port over rclpy does beyond the port's promises: names, QoS and publishers as ROS 2 has them."""

from __future__ import annotations

from typing import Any, Sequence

import pytest
from harness.port_conformance import FLOAT32, Recorder, RefusingNode
from harness.raw_conformance import Capture

from robot_health_monitor.core.values.errors import ConfigError


def test_a_latched_message_reaches_a_later_subscription(ros: Any) -> None:
    sensor = ros.node("battery_sensor")
    assert sensor.advertise("listed", "std_msgs/String", latched=True) == "/listed"
    sensor.publish("listed", {"data": "/battery_level"})
    heard = Recorder()
    ros.node("alert_system").subscribe("listed", "std_msgs/String", heard, field="data", latched=True)
    ros.wait_until(lambda: heard.values == ["/battery_level"])


def test_advertise_returns_the_remapped_topic(ros: Any) -> None:
    node = ros.node("battery_sensor", remap={"/temperature": "/sensor_data"})
    assert node.advertise("temperature", FLOAT32) == "/sensor_data"


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

    def reliable_one_arrived() -> bool:
        ros.publish("/in", FLOAT32, {"data": 3.0})
        return 3.0 in heard.values

    ros.wait_until(arrived)
    ros.wait_until(reliable_one_arrived)  # a best-effort subscription may lose messages


def test_subscriptions_are_reliable_while_every_publisher_is(ros: Any) -> None:
    from rclpy.qos import ReliabilityPolicy

    heard, topic = Recorder(), "/reliable"  # discovery may still list a publisher to /in, of the test before
    ros.node("alert_system").subscribe(topic, FLOAT32, heard, field="data")
    ros.publish(topic, FLOAT32, {"data": 1.0})
    ros.wait_until(lambda: heard.values == [1.0])
    ros.wait_until(lambda: len(ros._me.get_subscriptions_info_by_topic(topic)) == 1)
    (info,) = ros._me.get_subscriptions_info_by_topic(topic)
    assert info.qos_profile.reliability == ReliabilityPolicy.RELIABLE


def test_one_subscription_serves_the_fields_that_need_the_message_and_those_that_do_not(ros: Any) -> None:
    """Each message is received once, and its fields are read in the order of the subscriptions."""
    heard: list[Any] = []
    node = ros.node("alert_system")
    for field in ("percentage", "cell_voltage[*]", "charge"):
        node.subscribe(
            "battery", "sensor_msgs/BatteryState", lambda value, now_s, field=field: heard.append(field), field=field
        )
    ros.publish("/battery", "sensor_msgs/BatteryState", {"percentage": 0.5, "charge": 1.0, "cell_voltage": [3.5]})
    ros.wait_until(lambda: len(heard) >= 3)
    assert heard == ["percentage", "cell_voltage[*]", "charge"]
    assert ros._witness.count_subscribers("/battery") == 1


@pytest.mark.parametrize("is_captured_first", [True, False])
def test_judging_and_capture_share_one_subscription_as_bytes(ros: Any, is_captured_first: bool) -> None:
    """What arrives is what rclpy itself deserializes."""
    from rclpy.serialization import deserialize_message
    from sensor_msgs.msg import BatteryState

    node, charge, cells, capture = ros.node("alert_system"), Recorder(), Recorder(), Capture()
    if is_captured_first:
        node.subscribe_raw("battery", "", capture)
    node.subscribe("battery", "sensor_msgs/BatteryState", charge, field="charge")
    node.subscribe("battery", "sensor_msgs/BatteryState", cells, field="cell_voltage[1]")
    if not is_captured_first:
        node.subscribe_raw("battery", "sensor_msgs/msg/BatteryState", capture)

    def is_captured() -> bool:
        ros.publish("/battery", "sensor_msgs/BatteryState", {"charge": 1.0, "cell_voltage": [3.5, 3.75]})
        return bool(capture.items and charge.values and cells.values)

    ros.wait_until(is_captured)
    assert (charge.values[0], cells.values[0]) == (1.0, 3.75)
    found = deserialize_message(capture.items[0][0], BatteryState)
    assert (found.charge, list(found.cell_voltage)) == (1.0, [3.5, 3.75])
    ros.wait_until(lambda: ros._witness.count_subscribers("/battery") == 1)


@pytest.mark.parametrize("is_early", [True, False])
def test_best_effort_publishers_are_captured(ros: Any, is_early: bool) -> None:
    from std_msgs.msg import Float32

    capture, topic = Capture(), f"/sensor_{is_early}"
    publisher = best_effort_publisher(ros, topic) if is_early else None
    node = ros.node("alert_system")
    node.subscribe_raw(topic, FLOAT32, capture)
    publisher = publisher or best_effort_publisher(ros, topic)

    def arrived() -> bool:
        publisher.publish(Float32(data=2.0))
        return bool(capture.items)

    ros.wait_until(arrived)
    assert capture.values()[0] == 2.0


def test_a_message_that_is_not_of_its_type_is_an_error_line_and_captured(ros: Any) -> None:
    """Fast DDS hands such a message over; Cyclone DDS may drop it, and its value is none either way."""
    from rclpy import get_rmw_implementation_identifier
    from std_msgs.msg import Float32

    header_only = b"\x00\x01\x00\x00"
    whole, field, capture = Recorder(), Recorder(), Capture()
    node = ros.node("alert_system")
    node.subscribe("/in_bytes", FLOAT32, whole)
    node.subscribe("/in_bytes", FLOAT32, field, field="data")
    node.subscribe_raw("/in_bytes", FLOAT32, capture)
    publisher = ros._me.create_publisher(Float32, "/in_bytes", 10)

    def captured() -> bool:
        return any(data == header_only for data, _, _ in capture.items)

    def arrived() -> bool:
        publisher.publish(header_only)
        publisher.publish(Float32(data=2.5))
        return bool(whole.values) and (captured() or get_rmw_implementation_identifier() == "rmw_cyclonedds_cpp")

    ros.wait_until(arrived)
    if captured():
        ros.wait_until(lambda: any("does not match its type" in line.text for line in ros.log_lines()))
        ros.wait_until(lambda: field.without)  # a sign of life, without a value
    assert {value["data"] for value in whole.values} == {2.5}
    assert set(field.values) == {2.5}


def test_a_latched_topic_that_is_captured_is_still_latched_for_the_judging(ros: Any) -> None:
    sensor, heard, capture = ros.node("battery_sensor"), Recorder(), Capture()
    sensor.advertise("listed", "std_msgs/String", latched=True)
    sensor.publish("listed", {"data": "/battery_level"})
    node = ros.node("alert_system")
    node.subscribe_raw("listed", "std_msgs/String", capture)
    node.subscribe("listed", "std_msgs/String", heard, field="data", latched=True)
    ros.wait_until(lambda: heard.values == ["/battery_level"])


def test_a_type_that_is_not_installed_cannot_be_captured(ros: Any) -> None:
    with pytest.raises(ConfigError, match="no_such_msgs/Float32"):
        ros.node("alert_system").subscribe_raw("/in", "no_such_msgs/Float32", Capture())


def test_a_refusing_node_keeps_rclpys_own_parameters_out_of_the_tree(ros: Any) -> None:
    given = {"publish_rate": 2.0, "qos_overrides": {"out": {"publisher": {"depth": 5}}}, "executor": "single"}
    node = ros.node("alert_system", parameters=given)
    RefusingNode(node)
    assert node.given_parameters() == {"publish_rate": 2.0}


def test_a_small_step_back_restarts_the_period_too(ros: Any) -> None:
    times_s: list[float] = []
    ros.node("aggregator").create_timer(1.0, times_s.append)
    for step, calls in ((100.75, 0), (100.5, 0), (101.25, 0), (101.5, 1)):
        ros.set_time(step)
        ros.wait_until(lambda expected=calls: len(times_s) >= expected)
    assert times_s == [101.5]


def test_periods_begin_with_simulated_time(ros: Any) -> None:
    """Until the first message on /clock it is 0; that the clock then shows hours is no reason for a call."""
    times_s: list[float] = []
    node = ros.node("aggregator", before_time=lambda node: node.create_timer(1.0, times_s.append))
    assert node.now_s() == 100.0
    ros.set_time(100.5)
    ros.set_time(101.0)
    ros.wait_until(lambda: bool(times_s))
    assert times_s == [101.0]


def test_cancelled_timers_are_forgotten(ros: Any) -> None:
    node = ros.node("alert_system", sim_time=False)
    native = len(list(node.node.timers))
    for steady in (False, True) * 20:
        node.create_timer(1000.0, lambda now_s: None, steady=steady).cancel()
    kept = node.create_timer(1000.0, lambda now_s: None)
    assert node._steady_timers._timers[-1] is kept
    assert len(node._steady_timers._timers) == 2  # the other one checks the QoS
    assert len(list(node.node.timers)) == native


def test_a_burst_of_alerts_arrives_completely(ros: Any) -> None:
    """With a queue of 10, a reliable subscriber loses what was published while it did not read."""
    node = ros.node("alert_system")
    node.advertise("alerts", FLOAT32)
    messages: list[float] = []
    from std_msgs.msg import Float32

    subscription = ros._me.create_subscription(Float32, "/alerts", lambda native: messages.append(native.data), 1000)
    # Each end learns of the other separately.
    ros.wait_until(lambda: node.has_listeners("alerts") and subscription.get_publisher_count() > 0)
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


def answer_of(ros: Any, wanted: Sequence[Any], topic: str) -> str | None:
    """Returns the answer for subscriptions of some QoS once the publisher is known to the node."""
    from robot_health_monitor.ros2.publishers import PublisherLookup

    node = ros.node("alert_system").node
    ros.wait_until(lambda: bool(node.get_publishers_info_by_topic(topic)))
    answers: list[str | None] = []
    PublisherLookup(node, lambda topic: wanted).look_up(topic, FLOAT32, answers.append)
    (text,) = answers
    return text


def test_publishers_of_a_qos_that_no_subscription_can_hear_are_the_reason(ros: Any) -> None:
    from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
    from std_msgs.msg import Float32

    best_effort = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
    reliable = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
    latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    ros._me.create_publisher(Float32, "/fast", best_effort)
    incompatible = "its publishers are not compatible in QoS"
    assert answer_of(ros, [reliable], "/fast") == incompatible
    assert answer_of(ros, [reliable, best_effort], "/fast") is None
    assert answer_of(ros, [], "/fast") is None
    ros._me.create_publisher(Float32, "/volatile", reliable)
    assert answer_of(ros, [latched], "/volatile") == incompatible
    assert answer_of(ros, [best_effort], "/volatile") is None


def test_a_subscription_is_best_effort_once_a_publisher_requires_that(ros: Any) -> None:
    from rclpy.qos import QoSProfile, ReliabilityPolicy
    from std_msgs.msg import Float32

    heard: list[Any] = []
    node = ros.node("alert_system")
    node.subscribe("sensor", FLOAT32, lambda value, now_s: heard.append(value), field="data")

    def reliabilities() -> list[Any]:
        return [qos.reliability for qos in node._qos_of("/sensor")]

    assert reliabilities() == [ReliabilityPolicy.RELIABLE]
    publisher = ros._me.create_publisher(
        Float32, "/sensor", QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
    )

    def arrived() -> bool:
        publisher.publish(Float32(data=1.0))
        return bool(heard)

    ros.wait_until(arrived)
    assert reliabilities() == [ReliabilityPolicy.BEST_EFFORT]
    assert node.why_silent("sensor", FLOAT32) is None
