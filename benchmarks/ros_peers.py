"""Peers of the nodes on ROS 1 and ROS 2: `BENCHMARK_ROS=ros1 python -m benchmarks.ros_peers ROLE TOPICS`.

`empty`: a node that does nothing. `exercise`: publishes three numbers at 1 Hz and subscribes to them. `subscriber`:
counts the messages on `/bare`, or on TOPICS topics below it, in as few lines as possible; `raw_subscriber` takes their
bytes only. `publisher`: publishes to both contestants as `pacing.serve` reads from stdin. The roles with `diagnostics`
and `camera` do so with arrays of statuses and with frames of a camera.

On ROS 2, `empty`, `exercise` and `subscriber` spin as most nodes do, with rclpy's SingleThreadedExecutor; all other
subscribers with its EventsExecutor, which the nodes choose where it works.
"""

from __future__ import annotations

import os
import sys
from typing import Any, Callable, Dict, List

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from sensor_msgs.msg import Image
from std_msgs.msg import Float32

from benchmarks.pacing import (
    BARE,
    CAMERA,
    FRAME_BYTES,
    LEVEL,
    WATCHED,
    battery_levels,
    levels_of_frames,
    serve,
    statuses,
    topics_below,
)


class Ros1:
    """What the roles need of rospy."""

    ok = 0

    def __init__(self, role: str) -> None:
        """Makes this process a node."""
        import rospy

        self._rospy = rospy
        rospy.init_node(f"peer_{role}", anonymous=True)

    def subscribe(self, topic: str, cls: Any, callback: Callable[[Any], object], *, raw: bool = False) -> None:
        """Calls back with messages, or with their bytes."""
        self._rospy.Subscriber(topic, self._rospy.AnyMsg if raw else cls, callback, tcp_nodelay=True)

    def advertise(self, topic: str, cls: Any) -> Any:
        """Returns a publisher."""
        return self._rospy.Publisher(topic, cls, queue_size=10 if cls is Image else 1000, tcp_nodelay=True)

    def listeners(self, publisher: Any) -> int:
        """Returns how many subscribers a publisher has."""
        return int(publisher.get_num_connections())

    def every_second(self, callback: Callable[[], object]) -> None:
        """Calls back at 1 Hz."""
        self._rospy.Timer(self._rospy.Duration(1), lambda event: callback())

    def stamp(self) -> Any:
        """Returns the time."""
        return self._rospy.Time.now()

    def spin(self, *, events: bool = False) -> None:
        """Runs until it is interrupted."""
        self._rospy.spin()


class Ros2:
    """What the roles need of rclpy."""

    ok = b"\0"

    def __init__(self, role: str) -> None:
        """Makes this process a node."""
        import rclpy
        from rclpy.node import Node

        self._rclpy = rclpy
        rclpy.init()
        self._node = Node(f"peer_{role}")

    def subscribe(self, topic: str, cls: Any, callback: Callable[[Any], object], *, raw: bool = False) -> None:
        """Calls back with messages, or with their bytes."""
        self._node.create_subscription(cls, topic, callback, 10, raw=raw)

    def advertise(self, topic: str, cls: Any) -> Any:
        """Returns a publisher."""
        return self._node.create_publisher(cls, topic, 10)

    def listeners(self, publisher: Any) -> int:
        """Returns how many subscribers a publisher has."""
        return int(publisher.get_subscription_count())

    def every_second(self, callback: Callable[[], object]) -> None:
        """Calls back at 1 Hz."""
        self._node.create_timer(1.0, callback)

    def stamp(self) -> Any:
        """Returns the time."""
        return self._node.get_clock().now().to_msg()

    def spin(self, *, events: bool = False) -> None:
        """Runs until it is interrupted."""
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


def count_messages(ros: Any, topics: List[str], cls: Any, *, events: bool = True, raw: bool = False) -> None:
    """Counts messages."""
    received = 0

    def count(message: object) -> None:
        nonlocal received
        received += 1

    for topic in topics:
        ros.subscribe(topic, cls, count, raw=raw)
    ros.spin(events=events)


def exercise(ros: Any) -> None:
    """Publishes three numbers at 1 Hz and subscribes to them: the minimum that the nodes do."""
    publishers = [ros.advertise(f"bare_{number}", Float32) for number in range(3)]
    for number in range(3):
        ros.subscribe(f"bare_{number}", Float32, lambda message: None)
    ros.every_second(lambda: [publisher.publish(Float32(data=50.0)) for publisher in publishers])
    ros.spin()


def publish_in_turn(ros: Any, cls: Any, topics: int, message: Callable[[int], Any]) -> None:
    """Publishes to both contestants at the rates given on stdin; the contestants take turns in being first."""
    publishers = [[ros.advertise(topic, cls) for topic in topics_below(name, topics)] for name in (BARE, WATCHED)]

    def publish(number: int) -> None:
        made = message(number)
        for publishers_of_one in publishers[:: 1 if number // topics % 2 else -1]:
            publishers_of_one[number % topics].publish(made)

    serve(lambda: all(ros.listeners(one) > 0 for of_one in publishers for one in of_one), publish)


def publish_levels(ros: Any, topics: int) -> None:
    """Publishes battery levels."""
    levels, message = battery_levels(), Float32()

    def next_level(number: int) -> Float32:
        message.data = next(levels)
        return message

    publish_in_turn(ros, Float32, topics, next_level)


def publish_statuses(ros: Any) -> None:
    """Publishes arrays of statuses."""

    def array(number: int) -> DiagnosticArray:
        message = DiagnosticArray()
        message.header.stamp = ros.stamp()
        message.status = [
            DiagnosticStatus(
                level=ros.ok,
                name=name,
                message=text,
                hardware_id="robot1",
                values=[KeyValue(key=key, value=value) for key, value in values.items()],
            )
            for name, text, values in statuses(number)
        ]
        return message

    publish_in_turn(ros, DiagnosticArray, 1, array)


def publish_frames(ros: Any) -> None:
    """Publishes frames of a camera, each with a battery level."""
    camera, level = ros.advertise(CAMERA, Image), ros.advertise(LEVEL, Float32)
    frame, levels = Image(data=os.urandom(FRAME_BYTES)), levels_of_frames()

    def publish(number: int) -> None:
        camera.publish(frame)
        level.publish(Float32(data=next(levels)))

    serve(lambda: ros.listeners(camera) > 1 and ros.listeners(level) > 0, publish)


def main() -> None:
    """Plays the role that the command line names."""
    role, topics = sys.argv[1], int(sys.argv[2])
    ros = (Ros1 if os.environ["BENCHMARK_ROS"] == "ros1" else Ros2)(role)
    bare = topics_below(BARE, topics)
    roles: Dict[str, Callable[[], None]] = {
        "empty": ros.spin,
        "exercise": lambda: exercise(ros),
        "subscriber": lambda: count_messages(ros, bare, Float32, events=False),
        "events_subscriber": lambda: count_messages(ros, bare, Float32),
        "raw_subscriber": lambda: count_messages(ros, bare, Float32, raw=True),
        "diagnostics_subscriber": lambda: count_messages(ros, bare, DiagnosticArray),
        "camera_subscriber": lambda: count_messages(ros, [CAMERA], Image, raw=True),
        "publisher": lambda: publish_levels(ros, topics),
        "diagnostics_publisher": lambda: publish_statuses(ros),
        "camera_publisher": lambda: publish_frames(ros),
    }
    roles[role]()


if __name__ == "__main__":
    main()
