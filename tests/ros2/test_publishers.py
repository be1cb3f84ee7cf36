"""What discovery knows about publishers, beyond the conformance suite: their QoS."""

from __future__ import annotations

import time
from typing import Any, List, Optional, Sequence

from harness.port_conformance import FLOAT32


def lookup(ros: Any, wanted: Sequence[Any]) -> Any:
    from robot_health_monitor.ros2.publishers import PublisherLookup

    return PublisherLookup(ros.node("alert_system").node, lambda: (), lambda topic: wanted)


def answer_when_known(ros: Any, publishers: Any, topic: str) -> Optional[str]:
    """Returns the answer once the publisher is known to the node."""
    ros.wait_until(lambda: bool(publishers._node.get_publishers_info_by_topic(topic)))
    answers: List[Optional[str]] = []
    publishers.look_up(topic, FLOAT32, answers.append)
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
    assert answer_when_known(ros, lookup(ros, [reliable]), "/fast") == incompatible
    assert answer_when_known(ros, lookup(ros, [reliable, best_effort]), "/fast") is None
    assert answer_when_known(ros, lookup(ros, []), "/fast") is None
    ros._me.create_publisher(Float32, "/volatile", reliable)
    assert answer_when_known(ros, lookup(ros, [latched]), "/volatile") == incompatible
    assert answer_when_known(ros, lookup(ros, [best_effort]), "/volatile") is None


def test_the_node_gives_the_qos_of_its_own_subscriptions(ros: Any) -> None:
    """It is best effort once a publisher requires that, so that this is no reason for long."""
    from rclpy.qos import QoSProfile, ReliabilityPolicy
    from std_msgs.msg import Float32

    heard: List[Any] = []
    node = ros.node("alert_system")
    node.subscribe("sensor", FLOAT32, lambda value, now_s: heard.append(value), field="data")
    assert [qos.reliability for qos in node._qos_of("/sensor")] == [ReliabilityPolicy.RELIABLE]
    publisher = ros._me.create_publisher(
        Float32, "/sensor", QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
    )

    def arrived() -> bool:
        publisher.publish(Float32(data=1.0))
        return bool(heard)

    ros.wait_until(arrived)
    assert [qos.reliability for qos in node._qos_of("/sensor")] == [ReliabilityPolicy.BEST_EFFORT]
    assert node.why_silent("sensor", FLOAT32) is None


def test_many_silent_topics_read_the_list_of_topics_once(ros: Any) -> None:
    publishers = lookup(ros, [])
    reads: List[float] = []
    read = publishers._node.get_topic_names_and_types

    def count() -> Any:
        reads.append(time.monotonic())
        return read()

    publishers._node.get_topic_names_and_types = count
    answers: List[Optional[str]] = []
    for number in range(100):
        publishers.look_up(f"/silent_{number}", FLOAT32, answers.append)
    assert answers == [f"no publisher on /silent_{number}" for number in range(100)]
    assert len(reads) <= 1 + (reads[-1] - reads[0]) / 1.0
