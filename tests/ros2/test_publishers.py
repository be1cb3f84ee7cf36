"""What discovery has found about publishers; test_middleware.py shows why a topic brings no samples."""

from __future__ import annotations

from typing import Any

import pytest

FLOAT32 = "std_msgs/Float32"


def publisher_of(ros: Any, topic: str, **qos: Any) -> Any:
    from rclpy.qos import QoSProfile
    from std_msgs.msg import Float32

    return ros._me.create_publisher(Float32, topic, QoSProfile(depth=1, **qos))


def known(ros: Any, topic: str, count: int) -> Any:
    """Returns the node under test once it knows so many publishers of a topic."""
    node = ros.node("alert_system", sim_time=False).node
    ros.wait_until(lambda: len(node.get_publishers_info_by_topic(topic)) == count)
    return node


def test_a_topic_is_latched_if_all_of_its_publishers_are(ros: Any) -> None:
    from rclpy.qos import DurabilityPolicy

    from robot_health_monitor.ros2.publishers import are_latched

    latched = {"durability": DurabilityPolicy.TRANSIENT_LOCAL}
    publishers = [publisher_of(ros, "/map", **latched), publisher_of(ros, "/mixed", **latched)]
    publishers += [publisher_of(ros, "/mixed"), publisher_of(ros, "/plain")]
    node = known(ros, "/mixed", 2)
    ros.wait_until(lambda: node.count_publishers("/map") == node.count_publishers("/plain") == 1)
    assert [are_latched(node, topic) for topic in ("/map", "/mixed", "/plain", "/none")] == [True, False, False, False]
    for publisher in publishers:
        ros._me.destroy_publisher(publisher)


def test_a_topic_is_best_effort_if_one_of_its_publishers_is(ros: Any) -> None:
    from rclpy.qos import ReliabilityPolicy

    from robot_health_monitor.ros2.publishers import has_best_effort

    publishers = [publisher_of(ros, "/both"), publisher_of(ros, "/both", reliability=ReliabilityPolicy.BEST_EFFORT)]
    publishers.append(publisher_of(ros, "/reliable"))
    node = known(ros, "/both", 2)
    ros.wait_until(lambda: node.count_publishers("/reliable") == 1)
    assert [has_best_effort(node, topic) for topic in ("/both", "/reliable", "/none")] == [True, False, False]
    for publisher in publishers:
        ros._me.destroy_publisher(publisher)


@pytest.mark.parametrize("type_name", ["", FLOAT32])
def test_what_was_published_on_a_latched_topic_is_received_raw(ros: Any, type_name: str) -> None:
    """So a black box subscribes to /tf_static or /map: published once, before the node began."""
    from rclpy.qos import DurabilityPolicy
    from std_msgs.msg import Float32

    publisher = publisher_of(ros, "/early", durability=DurabilityPolicy.TRANSIENT_LOCAL)
    publisher.publish(Float32(data=2.5))
    node = ros.node("alert_system", sim_time=False)
    ros.wait_until(lambda: node.node.count_publishers("/early") == 1)
    heard: list[tuple[bytes, str]] = []
    node.subscribe_raw("/early", type_name, lambda message, now_s: heard.append((message[0], message[1].schema_name)))
    ros.wait_until(lambda: bool(heard))
    ((data, schema_name),) = heard
    assert (data[-4:], schema_name) == (b"\x00\x00\x20\x40", "std_msgs/msg/Float32")
    ros._me.destroy_publisher(publisher)


def test_a_volatile_publisher_that_replaces_a_latched_one_is_received(ros: Any) -> None:
    """A signal that shares the black box's subscription would be STALE otherwise."""
    from rclpy.qos import DurabilityPolicy
    from std_msgs.msg import Float32

    latched = publisher_of(ros, "/early", durability=DurabilityPolicy.TRANSIENT_LOCAL)
    latched.publish(Float32(data=2.5))
    node = ros.node("alert_system", sim_time=False)
    ros.wait_until(lambda: node.node.count_publishers("/early") == 1)
    captured: list[float] = []
    judged: list[float] = []
    node.subscribe_raw("/early", FLOAT32, lambda message, now_s: captured.append(message[0][-1]))
    node.subscribe("/early", FLOAT32, lambda value, now_s: judged.append(value), field="data")
    ros.wait_until(lambda: bool(captured) and bool(judged))
    volatile = publisher_of(ros, "/early")

    def both_are_heard() -> bool:
        volatile.publish(Float32(data=-2.0))
        return captured[-1] == 0xC0 and judged[-1] == -2.0

    ros.wait_until(both_are_heard)
    assert judged.count(2.5) == 1, "the latched message was delivered again"
    latched.publish(Float32(data=3.0))
    ros.wait_until(lambda: 3.0 in judged)
    for publisher in (latched, volatile):
        ros._me.destroy_publisher(publisher)


def test_a_publisher_that_comes_back_with_another_type_is_received_raw(ros: Any) -> None:
    from std_msgs.msg import Float32, Int32

    first = publisher_of(ros, "/changing")
    node = ros.node("alert_system", sim_time=False)
    ros.wait_until(lambda: node.node.count_publishers("/changing") == 1)
    names: list[str] = []
    node.subscribe_raw("/changing", "", lambda message, now_s: names.append(message[1].schema_name))

    def heard(publisher: Any, message: Any, name: str) -> bool:
        publisher.publish(message)
        return name in names

    ros.wait_until(lambda: heard(first, Float32(), "std_msgs/msg/Float32"))
    ros._me.destroy_publisher(first)
    second = ros._me.create_publisher(Int32, "/changing", 1)
    ros.wait_until(lambda: heard(second, Int32(), "std_msgs/msg/Int32"))
    ros._me.destroy_publisher(second)
