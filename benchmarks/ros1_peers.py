"""Peers of the nodes on ROS 1, and the publisher that feeds both: `python -m benchmarks.ros1_peers ROLE TOPICS`.

`empty`: a node that does nothing. `exercise`: publishes three numbers at 1 Hz and subscribes to them. `subscriber`:
counts the messages on `/bare`, or on TOPICS topics below it, in as few lines as possible; `raw_subscriber` takes their
bytes only. `publisher`: publishes as `pacing.serve` reads from stdin. `diagnostics_subscriber` and
`diagnostics_publisher` do so with arrays of statuses, `camera_publisher` with frames of a camera.
"""

from __future__ import annotations

import os
import sys

import rospy
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


def empty(topics: int) -> None:
    """Idles until it is interrupted."""
    rospy.spin()


def subscriber(topics: int) -> None:
    """Counts messages."""
    received = 0

    def count(message: Float32) -> None:
        nonlocal received
        received += 1

    for topic in topics_below(BARE, topics):
        rospy.Subscriber(topic, Float32, count, tcp_nodelay=True)
    rospy.spin()


def raw_subscriber(topics: int) -> None:
    """Counts messages, of which it takes the bytes only."""
    received = 0

    def count(message: rospy.AnyMsg) -> None:
        nonlocal received
        received += 1

    for topic in topics_below(BARE, topics):
        rospy.Subscriber(topic, rospy.AnyMsg, count, tcp_nodelay=True)
    rospy.spin()


def exercise(topics: int) -> None:
    """Publishes three numbers at 1 Hz and subscribes to them: the minimum that the nodes do."""
    publishers = [rospy.Publisher(f"bare_{number}", Float32, queue_size=10, tcp_nodelay=True) for number in range(3)]
    for publisher in publishers:
        rospy.Subscriber(publisher.resolved_name, Float32, lambda message: None, tcp_nodelay=True)
    rospy.Timer(rospy.Duration(1), lambda event: [publisher.publish(50.0) for publisher in publishers])
    rospy.spin()


def publisher(topics: int) -> None:
    """Publishes to both contestants at the rates given on stdin; the contestants take turns in being first."""
    publishers = [
        [rospy.Publisher(topic, Float32, queue_size=1000, tcp_nodelay=True) for topic in topics_below(name, topics)]
        for name in (BARE, WATCHED)
    ]
    levels = battery_levels()

    def publish(number: int) -> None:
        level = next(levels)
        for publishers_of_one in publishers[:: 1 if number // topics % 2 else -1]:
            publishers_of_one[number % topics].publish(level)

    serve(lambda: all(one.get_num_connections() > 0 for of_one in publishers for one in of_one), publish)


def diagnostics_subscriber(topics: int) -> None:
    """Receives statuses."""
    from diagnostic_msgs.msg import DiagnosticArray

    received = 0

    def count(message: DiagnosticArray) -> None:
        nonlocal received
        received += len(message.status)

    rospy.Subscriber(BARE, DiagnosticArray, count, tcp_nodelay=True)
    rospy.spin()


def diagnostics_publisher(topics: int) -> None:
    """As `publisher`, of arrays of statuses."""
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

    publishers = [rospy.Publisher(name, DiagnosticArray, queue_size=100, tcp_nodelay=True) for name in (BARE, WATCHED)]

    def publish(number: int) -> None:
        message = DiagnosticArray(
            status=[
                DiagnosticStatus(0, name, text, "robot1", [KeyValue(*pair) for pair in values.items()])
                for name, text, values in statuses(number)
            ]
        )
        message.header.stamp = rospy.Time.now()
        for one in publishers[:: 1 if number % 2 else -1]:
            one.publish(message)

    serve(lambda: all(one.get_num_connections() > 0 for one in publishers), publish)


def camera_subscriber(topics: int) -> None:
    """Receives the bytes of the frames of a camera."""
    rospy.Subscriber(CAMERA, rospy.AnyMsg, lambda message: None, tcp_nodelay=True)
    rospy.spin()


def camera_publisher(topics: int) -> None:
    """Publishes frames of a camera, each with a battery level."""
    from sensor_msgs.msg import Image

    camera = rospy.Publisher(CAMERA, Image, queue_size=10, tcp_nodelay=True)
    level = rospy.Publisher(LEVEL, Float32, queue_size=10, tcp_nodelay=True)
    frame, levels = Image(data=os.urandom(FRAME_BYTES)), levels_of_frames()

    def publish(number: int) -> None:
        camera.publish(frame)
        level.publish(next(levels))

    serve(lambda: camera.get_num_connections() > 1 and level.get_num_connections() > 0, publish)


if __name__ == "__main__":
    rospy.init_node(f"peer_{sys.argv[1]}", anonymous=True)
    roles = (
        empty, exercise, subscriber, raw_subscriber, publisher, diagnostics_subscriber, diagnostics_publisher,
        camera_subscriber, camera_publisher,
    )  # fmt: skip
    role = {role.__name__: role for role in roles}[sys.argv[1]]
    role(int(sys.argv[2]))
