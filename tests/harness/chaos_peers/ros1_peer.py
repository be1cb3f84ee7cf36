"""A robot with rospy: publishes the latest number of its stdin, and prints alerts."""

from __future__ import annotations

import sys
import threading

import rospy
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
        write(f"alert {LEVELS[status.level]}\n")


rospy.init_node("robot", disable_signals=True)
publisher = rospy.Publisher("battery_level", Float32, queue_size=10, tcp_nodelay=True)
subscriber = rospy.Subscriber("alerts", DiagnosticStatus, take, tcp_nodelay=True)
threading.Thread(target=read_stdin, daemon=True).start()
pause = threading.Event()
while True:
    publisher.publish(value)
    if publisher.get_num_connections() and subscriber.get_num_connections():
        write("connected\n")
    pause.wait(0.05)
