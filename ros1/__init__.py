"""ROS 1: the port over rospy, the conversion of messages, and the process."""
