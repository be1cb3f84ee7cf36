"""One sensor and one monitor, as in the textbook example that this package grew from.

Two executables of health_monitor.launch.py with other names, another topic and config/robot_monitor.yaml.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

PACKAGE = "robot_health_monitor"
LOG_LEVELS = ["DEBUG", "INFO", "WARN", "ERROR", "FATAL"]
BOOLEANS = ["true", "false", "True", "False"]


def generate_launch_description():
    """Returns the launch arguments and the nodes."""
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "log_level",
                default_value="INFO",
                choices=LOG_LEVELS + [level.lower() for level in LOG_LEVELS],
                description="lowest severity that is logged",
            ),
            DeclareLaunchArgument(
                "use_sim_time", default_value="false", choices=BOOLEANS, description="true: use the time from /clock"
            ),
            DeclareLaunchArgument(
                "config",
                default_value=PathJoinSubstitution([FindPackageShare(PACKAGE), "config", "robot_monitor.yaml"]),
                description="path of the parameters of both nodes",
            ),
            node("battery_sensor", "temperature_sensor", remappings=[("temperature", "sensor_data")]),
            node("alert_system", "data_monitor"),
        ]
    )


def node(executable, name, **options):
    """Returns one process of this package, with the parameters common to both."""
    return Node(
        package=PACKAGE,
        executable=executable,
        name=name,
        ros_arguments=[
            "--log-level",
            LaunchConfiguration("log_level"),
            "--params-file",
            LaunchConfiguration("config"),
        ],
        parameters=[{"use_sim_time": ParameterValue(LaunchConfiguration("use_sim_time"), value_type=bool)}],
        output="screen",
        emulate_tty=True,
        **options,
    )
