"""The monitor over rospy: the port, the conversion of messages, and the executables."""
