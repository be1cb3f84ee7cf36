"""A robot with rospy."""

from __future__ import annotations

import threading

import rospy
from battery import PERIOD_S, Battery, write_alert, write_period
from diagnostic_msgs.msg import DiagnosticStatus
from std_msgs.msg import Float32

rospy.init_node("robot", disable_signals=True)
battery = Battery()
publisher = rospy.Publisher("battery_level", Float32, queue_size=10, tcp_nodelay=True)
subscriber = rospy.Subscriber(
    "alerts", DiagnosticStatus, lambda status: write_alert(status.name, status.level), tcp_nodelay=True
)
pause = threading.Event()
while True:
    publisher.publish(battery.level)
    write_period(publisher.get_num_connections() > 0 and subscriber.get_num_connections() > 0)
    pause.wait(PERIOD_S)
