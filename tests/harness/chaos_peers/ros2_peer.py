"""A robot with rclpy: publishes the latest number of its stdin, and prints alerts."""

from __future__ import annotations

import sys
import threading

import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from std_msgs.msg import Float32

LEVELS = ("OK", "WARN", "ERROR", "STALE")
value = 50.0


def write(line: str) -> None:
    """Writes a line at once: `print` writes its end apart, and two threads write here."""
    sys.stdout.write(line)
    sys.stdout.flush()


def read_stdin() -> None:
    global value
    for line in sys.stdin:
        value = float(line)


def take(status: DiagnosticStatus) -> None:
    if status.name.endswith(": battery_level"):
        write(f"alert {LEVELS[ord(status.level)]}\n")


def publish() -> None:
    publisher.publish(Float32(data=value))
    if publisher.get_subscription_count() and node.count_publishers("/alerts"):
        write("connected\n")


rclpy.init()
node = rclpy.create_node("robot")
publisher = node.create_publisher(Float32, "battery_level", 10)
node.create_subscription(DiagnosticStatus, "alerts", take, 100)
node.create_timer(0.05, publish)
threading.Thread(target=read_stdin, daemon=True).start()
rclpy.spin(node)
