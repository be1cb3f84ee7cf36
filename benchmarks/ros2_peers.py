"""What the nodes are compared with on ROS 2, and what feeds them: `python -m benchmarks.ros2_peers ROLE`.

The roles are those of `ros1_peers`. Both `empty` and `subscriber` spin as most nodes do, with rclpy's
SingleThreadedExecutor.
"""

from __future__ import annotations

import sys

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node

from benchmarks.pacing import battery_levels, serve


def empty(node: Node) -> None:
    """Does nothing until it is interrupted."""
    rclpy.spin(node)


def subscriber(node: Node) -> None:
    """Counts."""
    from std_msgs.msg import Float32

    received = 0

    def count(message: Float32) -> None:
        nonlocal received
        received += 1

    node.create_subscription(Float32, "/bare", count, 10)
    rclpy.spin(node)


def publisher(node: Node) -> None:
    """Publishes as it is told."""
    from std_msgs.msg import Float32

    publishers = {topic: node.create_publisher(Float32, topic, 10) for topic in ("/bare", "/watched")}
    levels = battery_levels()
    message = Float32()

    def publish(topic: str) -> None:
        message.data = next(levels)
        publishers[topic].publish(message)

    serve(connected=lambda topic: publishers[topic].get_subscription_count() > 0, publish=publish)


if __name__ == "__main__":
    rclpy.init()
    try:
        {"empty": empty, "subscriber": subscriber, "publisher": publisher}[sys.argv[1]](Node(f"peer_{sys.argv[1]}"))
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
