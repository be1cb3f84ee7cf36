"""A robot with rclpy."""

from __future__ import annotations

import rclpy
from battery import PERIOD_S, Battery, write_alert, write_period
from diagnostic_msgs.msg import DiagnosticStatus
from std_msgs.msg import Float32


def publish() -> None:
    publisher.publish(Float32(data=battery.level))
    write_period(publisher.get_subscription_count() > 0 and node.count_publishers("/alerts") > 0)


rclpy.init()
battery = Battery()
node = rclpy.create_node("robot")
publisher = node.create_publisher(Float32, "battery_level", 10)
node.create_subscription(DiagnosticStatus, "alerts", lambda status: write_alert(status.name, ord(status.level)), 100)
node.create_timer(PERIOD_S, publish)
rclpy.spin(node)
