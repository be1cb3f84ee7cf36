"""ROS 2: the port over rclpy, the conversion of messages, and the process."""
