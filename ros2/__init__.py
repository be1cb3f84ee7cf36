"""The monitor over rclpy: the port, the conversion of messages, and the executables."""
