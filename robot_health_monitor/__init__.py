"""Robot Health Monitor: one health monitor for ROS 1, ROS 2 and robots behind rosbridge.

The folders beside the modules (`core`, `ros1` ...) are links to those of the repository; installed, they are folders.
"""
