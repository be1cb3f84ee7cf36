"""Peers of the nodes on ROS 1 and ROS 2: `python -m benchmarks.ros_peers ros1|ros2 ROLE TOPICS`.

`empty node` does nothing. A `bare subscriber` counts the messages on `/bare`, or on TOPICS topics below it; that of
bytes does not deserialize them. A `publisher` reads lines `RATE_HZ SECONDS`, publishes to both contestants accordingly,
and writes how many messages it has sent. `robot` has the nodes and topics of `GRAPH`, on ROS 1 by name only.

On ROS 2, `bare subscriber` spins as most nodes do, with rclpy's SingleThreadedExecutor; all other subscribers with its
EventsExecutor, which the nodes of this project choose where it works.
"""

from __future__ import annotations

import itertools
import random
import sys
import time
from operator import methodcaller
from typing import Any, Callable

BARE, WATCHED = "/bare", "/watched"
"""Topics of the two contestants, or the prefixes of their topics."""
GRAPH = (100, 3)
"""Nodes of `robot`, and topics of each."""
STATUSES = 200
"""Statuses of a message on /diagnostics."""


def topics_below(name: str, count: int) -> list[str]:
    """Returns the topics of a contestant: its name, or a number of topics below it."""
    return [name] if count == 1 else [f"{name}/t{number}" for number in range(count)]


class _Ros1:
    """What the roles need of rospy."""

    listeners = methodcaller("get_num_connections")

    def __init__(self) -> None:
        import rospy

        self._rospy = rospy
        rospy.init_node("peer", anonymous=True)

    def subscribe(self, topic: str, cls: Any, callback: Callable[[Any], object], *, raw: bool = False) -> None:
        self._rospy.Subscriber(topic, self._rospy.AnyMsg if raw else cls, callback, tcp_nodelay=True)

    def advertise(self, topic: str, cls: Any) -> Any:
        return self._rospy.Publisher(topic, cls, queue_size=1000, tcp_nodelay=True)

    def add_node(self, name: str, publishes: list[str], subscribes: str, cls: Any) -> None:
        import rosgraph

        master, type_name, uri = rosgraph.Master(f"/robot/{name}"), "std_msgs/Float32", self._rospy.get_node_uri()
        master.registerSubscriber(f"/robot/{subscribes}", type_name, uri)
        for topic in publishes:
            master.registerPublisher(f"/robot/{topic}", type_name, uri)

    def spin(self, *, events: bool = False) -> None:
        self._rospy.spin()


class _Ros2:
    """What the roles need of rclpy."""

    listeners = methodcaller("get_subscription_count")

    def __init__(self) -> None:
        import rclpy
        from rclpy.node import Node

        self._rclpy = rclpy
        rclpy.init()
        self._node = Node("peer")
        self._kept: list[Any] = []

    def subscribe(self, topic: str, cls: Any, callback: Callable[[Any], object], *, raw: bool = False) -> None:
        self._node.create_subscription(cls, topic, callback, 10, raw=raw)

    def advertise(self, topic: str, cls: Any) -> Any:
        return self._node.create_publisher(cls, topic, 10)

    def add_node(self, name: str, publishes: list[str], subscribes: str, cls: Any) -> None:
        from rclpy.node import Node
        from rclpy.parameter import Parameter

        plain: Any = {"start_parameter_services": False, "enable_rosout": False}
        plain["parameter_overrides"] = [Parameter("start_type_description_service", value=False)]
        node = Node(name, namespace="robot", **plain)
        node.create_subscription(cls, subscribes, lambda message: None, 10)
        self._kept.append((node, [node.create_publisher(cls, topic, 10) for topic in publishes]))

    def spin(self, *, events: bool = False) -> None:
        if not events:
            self._rclpy.spin(self._node)
            return
        from rclpy.experimental import EventsExecutor

        executor = EventsExecutor()
        executor.add_node(self._node)
        executor.spin_until_future_complete(self._rclpy.Future(), 3600.0)  # without a limit, PyPI's wheels do nothing


def _count_messages(ros: Any, topics: list[str], cls: Any, *, events: bool = True, raw: bool = False) -> None:
    counted = itertools.count()
    for topic in topics:
        ros.subscribe(topic, cls, lambda message: next(counted), raw=raw)
    ros.spin(events=events)


def _robot(ros: Any, float32: Any) -> None:
    """Each node publishes its first and third topic, and subscribes to its second."""
    nodes, topics = GRAPH
    for at in range(nodes):
        first, second, *others = (f"topic_{at}_{topic}" for topic in range(topics))
        ros.add_node(f"node_{at}", [first, *others], second, float32)
    ros.spin()


def _publish(ros: Any, cls: Any, topics: int, message: Callable[[int], Any]) -> None:
    """Publishes to both contestants, which take turns in being first, once all their subscribers are connected."""
    publishers = [[ros.advertise(topic, cls) for topic in topics_below(name, topics)] for name in (BARE, WATCHED)]
    for line in sys.stdin:
        rate_hz, seconds = map(float, line.split())
        while not all(ros.listeners(one) > 0 for of_one in publishers for one in of_one):
            time.sleep(0.05)
        begin_s, wanted = time.monotonic(), round(rate_hz * seconds)
        for number in range(wanted):
            time.sleep(max(0.0, begin_s + number / rate_hz - time.monotonic()))
            made = message(number)
            for of_one in publishers[:: 1 if number // topics % 2 else -1]:
                of_one[number % topics].publish(made)
        print(wanted, flush=True)


def main(package: str, role: str, count: str) -> None:
    """Plays the role that the command line names."""
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
    from std_msgs.msg import Float32

    ros: Any = {"ros1": _Ros1, "ros2": _Ros2}[package]()
    topics, noise = int(count), random.Random(1)
    bare = topics_below(BARE, topics)

    def level(number: int) -> Float32:
        return Float32(data=noise.gauss(60.0, 5.0))

    def statuses(number: int) -> DiagnosticArray:
        common = {"level": DiagnosticStatus.OK, "hardware_id": "robot1", "message": f"running for {number} s"}
        message = DiagnosticArray()
        for driver in range(STATUSES):
            values = {"temperature": f"{40.0 + number % 10 + driver / 10.0:.1f}", "errors": "0", "firmware": "2.4.1"}
            pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
            message.status.append(DiagnosticStatus(name=f"driver_{driver}: status", values=pairs, **common))
        return message

    roles: dict[str, Callable[[], None]] = {
        "empty node": ros.spin,
        "robot": lambda: _robot(ros, Float32),
        "bare subscriber": lambda: _count_messages(ros, bare, Float32, events=False),
        "bare subscriber, EventsExecutor": lambda: _count_messages(ros, bare, Float32),
        "bare subscriber of bytes": lambda: _count_messages(ros, bare, Float32, raw=True),
        "bare subscriber of statuses": lambda: _count_messages(ros, bare, DiagnosticArray),
        "publisher": lambda: _publish(ros, Float32, topics, level),
        "publisher of statuses": lambda: _publish(ros, DiagnosticArray, 1, statuses),
    }
    roles[role]()


if __name__ == "__main__":
    main(*sys.argv[1:])
