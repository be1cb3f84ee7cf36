"""What the nodes are compared with on ROS 1, and what feeds them: `python -m benchmarks.ros1_peers ROLE`.

`empty`: a node that does nothing. `subscriber`: counts the messages on `/bare`, as few lines as that takes.
`publisher`: does what `pacing.serve` is told on standard input.
"""

from __future__ import annotations

import sys

import rospy
from std_msgs.msg import Float32

from benchmarks.pacing import battery_levels, serve


def empty() -> None:
    """Does nothing until it is interrupted."""
    rospy.spin()


def subscriber() -> None:
    """Counts."""
    received = 0

    def count(message: Float32) -> None:
        nonlocal received
        received += 1

    rospy.Subscriber("/bare", Float32, count, tcp_nodelay=True)
    rospy.spin()


def publisher() -> None:
    """Publishes as it is told."""
    publishers = {
        topic: rospy.Publisher(topic, Float32, queue_size=1000, tcp_nodelay=True) for topic in ("/bare", "/watched")
    }
    levels = battery_levels()
    serve(
        connected=lambda topic: publishers[topic].get_num_connections() > 0,
        publish=lambda topic: publishers[topic].publish(next(levels)),
    )


if __name__ == "__main__":
    rospy.init_node(f"peer_{sys.argv[1]}", anonymous=True)
    {"empty": empty, "subscriber": subscriber, "publisher": publisher}[sys.argv[1]]()
