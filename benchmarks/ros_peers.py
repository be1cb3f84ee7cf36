"""Peers of the nodes on ROS 1 and ROS 2: `BENCHMARK_ROS=ros1 python -m benchmarks.ros_peers ROLE TOPICS`.

`empty`: a node that does nothing. `exercise`: publishes three numbers at 1 Hz and subscribes to them. `subscriber`:
counts the messages on `/bare`, or on TOPICS topics below it, in as few lines as possible; `raw_subscriber` takes their
bytes only. `publisher`: reads lines `RATE_HZ SECONDS`, publishes to both contestants accordingly, and writes how many
messages it has sent. The roles with `diagnostics` do so with arrays of statuses. `robot`: a robot with the nodes and
topics of `GRAPH`, on ROS 1 by name only.

On ROS 2, `empty`, `exercise` and `subscriber` spin as most nodes do, with rclpy's SingleThreadedExecutor; all other
subscribers with its EventsExecutor, which the nodes choose where it works.
"""

from __future__ import annotations

import os
import random
import sys
import time
from typing import Any, Callable, Iterator

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

    ok = 0

    def __init__(self, role: str) -> None:
        import rospy

        self._rospy = rospy
        rospy.init_node(f"peer_{role}", anonymous=True)

    def subscribe(self, topic: str, cls: Any, callback: Callable[[Any], object], *, raw: bool = False) -> None:
        self._rospy.Subscriber(topic, self._rospy.AnyMsg if raw else cls, callback, tcp_nodelay=True)

    def advertise(self, topic: str, cls: Any) -> Any:
        return self._rospy.Publisher(topic, cls, queue_size=1000, tcp_nodelay=True)

    def listeners(self, publisher: Any) -> int:
        return int(publisher.get_num_connections())

    def every_second(self, callback: Callable[[], object]) -> None:
        self._rospy.Timer(self._rospy.Duration(1), lambda event: callback())

    def stamp(self) -> Any:
        return self._rospy.Time.now()

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

    ok = b"\0"

    def __init__(self, role: str) -> None:
        import rclpy
        from rclpy.node import Node

        self._rclpy = rclpy
        rclpy.init()
        self._node = Node(f"peer_{role}")
        self._kept: list[Any] = []

    def subscribe(self, topic: str, cls: Any, callback: Callable[[Any], object], *, raw: bool = False) -> None:
        self._node.create_subscription(cls, topic, callback, 10, raw=raw)

    def advertise(self, topic: str, cls: Any) -> Any:
        return self._node.create_publisher(cls, topic, 10)

    def listeners(self, publisher: Any) -> int:
        return int(publisher.get_subscription_count())

    def every_second(self, callback: Callable[[], object]) -> None:
        self._node.create_timer(1.0, callback)

    def stamp(self) -> Any:
        return self._node.get_clock().now().to_msg()

    def add_node(self, name: str, publishes: list[str], subscribes: str, cls: Any) -> None:
        from rclpy.node import Node
        from rclpy.parameter import Parameter

        plain: Any = {"start_parameter_services": False, "enable_rosout": False}
        plain["parameter_overrides"] = [Parameter("start_type_description_service", value=False)]
        node = Node(name, namespace="robot", **plain)
        node.create_subscription(cls, subscribes, lambda message: None, 10)
        self._kept.append((node, [node.create_publisher(cls, topic, 10) for topic in publishes]))

    def spin(self, *, events: bool = False) -> None:
        from rclpy.executors import ExternalShutdownException
        from rclpy.task import Future

        try:
            if not events:
                self._rclpy.spin(self._node)
                return
            from rclpy.experimental import EventsExecutor

            executor = EventsExecutor()
            executor.add_node(self._node)
            executor.spin_until_future_complete(Future(), 3600.0)  # PyPI's wheels deliver nothing without a time limit
        except (KeyboardInterrupt, ExternalShutdownException):
            pass


def _count_messages(ros: Any, topics: list[str], cls: Any, *, events: bool = True, raw: bool = False) -> None:
    received = 0

    def count(message: object) -> None:
        nonlocal received
        received += 1

    for topic in topics:
        ros.subscribe(topic, cls, count, raw=raw)
    ros.spin(events=events)


def _exercise(ros: Any, float32: Any) -> None:
    """The minimum that the nodes do."""
    publishers = [ros.advertise(f"bare_{number}", float32) for number in range(3)]
    for number in range(3):
        ros.subscribe(f"bare_{number}", float32, lambda message: None)
    ros.every_second(lambda: [publisher.publish(float32(data=50.0)) for publisher in publishers])
    ros.spin()


def _robot(ros: Any, float32: Any) -> None:
    """Each node publishes its first and third topic, and subscribes to its second."""
    nodes, topics = GRAPH
    for at in range(nodes):
        first, second, *others = (f"topic_{at}_{topic}" for topic in range(topics))
        ros.add_node(f"node_{at}", [first, *others], second, float32)
    ros.spin()


def _serve(connected: Callable[[], bool], publish: Callable[[int], None]) -> None:
    for line in sys.stdin:
        rate_hz, seconds = map(float, line.split())
        while not connected():
            time.sleep(0.05)
        wanted = round(rate_hz * seconds)
        begin_s = time.monotonic()
        for number in range(wanted):
            time.sleep(max(0.0, begin_s + number / rate_hz - time.monotonic()))
            publish(number)
        print(wanted, flush=True)


def _publish_in_turn(ros: Any, cls: Any, topics: int, message: Callable[[int], Any]) -> None:
    """Publishes to both contestants, which take turns in being first."""
    publishers = [[ros.advertise(topic, cls) for topic in topics_below(name, topics)] for name in (BARE, WATCHED)]

    def publish(number: int) -> None:
        made = message(number)
        for publishers_of_one in publishers[:: 1 if number // topics % 2 else -1]:
            publishers_of_one[number % topics].publish(made)

    _serve(lambda: all(ros.listeners(one) > 0 for of_one in publishers for one in of_one), publish)


def _battery_levels() -> Iterator[float]:
    noise = random.Random(1)
    while True:
        yield min(99.0, max(30.0, 60.0 + noise.gauss(0.0, 5.0)))


def main() -> None:
    """Plays the role that the command line names."""
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
    from std_msgs.msg import Float32

    role, topics = sys.argv[1], int(sys.argv[2])
    ros: Any = (_Ros1 if os.environ["BENCHMARK_ROS"] == "ros1" else _Ros2)(role)
    bare, levels = topics_below(BARE, topics), _battery_levels()

    def statuses(number: int) -> DiagnosticArray:
        message = DiagnosticArray()
        message.header.stamp = ros.stamp()
        for driver in range(STATUSES):
            values = {"temperature": f"{40.0 + number % 10 + driver / 10.0:.1f}", "errors": "0", "firmware": "2.4.1"}
            pairs = [KeyValue(key=key, value=value) for key, value in values.items()]
            status = DiagnosticStatus(level=ros.ok, name=f"driver_{driver}: status", hardware_id="robot1", values=pairs)
            status.message = f"running for {number} s"
            message.status.append(status)
        return message

    roles: dict[str, Callable[[], None]] = {
        "empty": ros.spin,
        "exercise": lambda: _exercise(ros, Float32),
        "robot": lambda: _robot(ros, Float32),
        "subscriber": lambda: _count_messages(ros, bare, Float32, events=False),
        "events_subscriber": lambda: _count_messages(ros, bare, Float32),
        "raw_subscriber": lambda: _count_messages(ros, bare, Float32, raw=True),
        "diagnostics_subscriber": lambda: _count_messages(ros, bare, DiagnosticArray),
        "publisher": lambda: _publish_in_turn(ros, Float32, topics, lambda number: Float32(data=next(levels))),
        "diagnostics_publisher": lambda: _publish_in_turn(ros, DiagnosticArray, 1, statuses),
    }
    roles[role]()


if __name__ == "__main__":
    main()
