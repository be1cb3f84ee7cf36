"""Peers of the nodes on ROS 2, and the publisher that feeds both: `python -m benchmarks.ros2_peers ROLE TOPICS`.

The roles are those of `ros1_peers`. `empty` and `subscriber` spin as most nodes do, with rclpy's
SingleThreadedExecutor; `events_subscriber` with its EventsExecutor, which the nodes choose where it works.
"""

from __future__ import annotations

import os
import sys

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.task import Future

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


def empty(node: Node, topics: int) -> None:
    """Idles until it is interrupted."""
    rclpy.spin(node)


def subscriber(node: Node, topics: int) -> None:
    """Counts messages."""
    _count_messages(node, topics)
    rclpy.spin(node)


def events_subscriber(node: Node, topics: int) -> None:
    """Counts messages, with the EventsExecutor."""
    from rclpy.experimental import EventsExecutor

    _count_messages(node, topics)
    executor = EventsExecutor()
    executor.add_node(node)
    executor.spin_until_future_complete(Future(), 3600.0)  # the wheels of PyPI deliver nothing without a time limit


def raw_subscriber(node: Node, topics: int) -> None:
    """Counts messages as bytes, with the EventsExecutor."""
    from rclpy.experimental import EventsExecutor

    _count_messages(node, topics, raw=True)
    executor = EventsExecutor()
    executor.add_node(node)
    executor.spin_until_future_complete(Future(), 3600.0)


def _count_messages(node: Node, topics: int, *, raw: bool = False) -> None:
    from std_msgs.msg import Float32

    received = 0

    def count(message: object) -> None:
        nonlocal received
        received += 1

    for topic in topics_below(BARE, topics):
        node.create_subscription(Float32, topic, count, 10, raw=raw)


def exercise(node: Node, topics: int) -> None:
    """Publishes three numbers at 1 Hz and subscribes to them: the minimum that the nodes do."""
    from std_msgs.msg import Float32

    publishers = [node.create_publisher(Float32, f"bare_{number}", 10) for number in range(3)]
    for publisher in publishers:
        node.create_subscription(Float32, publisher.topic_name, lambda message: None, 10)
    node.create_timer(1.0, lambda: [publisher.publish(Float32(data=50.0)) for publisher in publishers])
    rclpy.spin(node)


def publisher(node: Node, topics: int) -> None:
    """Publishes to both contestants at the rates given on stdin; the contestants take turns in being first."""
    from std_msgs.msg import Float32

    publishers = [
        [node.create_publisher(Float32, topic, 10) for topic in topics_below(name, topics)] for name in (BARE, WATCHED)
    ]
    levels = battery_levels()
    message = Float32()

    def publish(number: int) -> None:
        message.data = next(levels)
        for publishers_of_one in publishers[:: 1 if number // topics % 2 else -1]:
            publishers_of_one[number % topics].publish(message)

    serve(lambda: all(one.get_subscription_count() > 0 for of_one in publishers for one in of_one), publish)


def diagnostics_subscriber(node: Node, topics: int) -> None:
    """Receives statuses."""
    from diagnostic_msgs.msg import DiagnosticArray
    from rclpy.experimental import EventsExecutor

    received = 0

    def count(message: DiagnosticArray) -> None:
        nonlocal received
        received += len(message.status)

    node.create_subscription(DiagnosticArray, BARE, count, 10)
    executor = EventsExecutor()
    executor.add_node(node)
    executor.spin_until_future_complete(Future(), 3600.0)


def diagnostics_publisher(node: Node, topics: int) -> None:
    """As `publisher`, of arrays of statuses."""
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

    publishers = [node.create_publisher(DiagnosticArray, name, 10) for name in (BARE, WATCHED)]

    def publish(number: int) -> None:
        message = DiagnosticArray()
        message.header.stamp = node.get_clock().now().to_msg()
        message.status = [
            DiagnosticStatus(
                level=DiagnosticStatus.OK,
                name=name,
                message=text,
                hardware_id="robot1",
                values=[KeyValue(key=key, value=value) for key, value in values.items()],
            )
            for name, text, values in statuses(number)
        ]
        for one in publishers[:: 1 if number % 2 else -1]:
            one.publish(message)

    serve(lambda: all(one.get_subscription_count() > 0 for one in publishers), publish)


def camera_subscriber(node: Node, topics: int) -> None:
    """Receives the bytes of the frames of a camera."""
    from rclpy.experimental import EventsExecutor
    from sensor_msgs.msg import Image

    node.create_subscription(Image, CAMERA, lambda data: None, 10, raw=True)
    executor = EventsExecutor()
    executor.add_node(node)
    executor.spin_until_future_complete(Future(), 3600.0)


def camera_publisher(node: Node, topics: int) -> None:
    """Publishes frames of a camera, each with a battery level."""
    from sensor_msgs.msg import Image
    from std_msgs.msg import Float32

    camera, level = node.create_publisher(Image, CAMERA, 10), node.create_publisher(Float32, LEVEL, 10)
    frame, levels = Image(data=os.urandom(FRAME_BYTES)), levels_of_frames()

    def publish(number: int) -> None:
        camera.publish(frame)
        level.publish(Float32(data=next(levels)))

    serve(lambda: camera.get_subscription_count() > 1 and level.get_subscription_count() > 0, publish)


if __name__ == "__main__":
    rclpy.init()
    try:
        roles = (
            empty, exercise, subscriber, events_subscriber, raw_subscriber, publisher, diagnostics_subscriber,
            diagnostics_publisher, camera_subscriber, camera_publisher,
        )  # fmt: skip
        role = {role.__name__: role for role in roles}[sys.argv[1]]
        role(Node(f"peer_{sys.argv[1]}"), int(sys.argv[2]))
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
