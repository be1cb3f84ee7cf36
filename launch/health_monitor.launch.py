"""Starts the health monitor of one robot: battery_sensor, aggregator and alert_system.

    ros2 launch robot_health_monitor health_monitor.launch.py robot_name:=robot1 thresholds:=my.yaml

`--show-args` lists the arguments. To include this file, pass `launch_arguments`; `SetRemap` and `PushRosNamespace`
around it reach every node.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition, UnlessCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

PACKAGE = "robot_health_monitor"
LOG_LEVELS = ["DEBUG", "INFO", "WARN", "ERROR", "FATAL"]
BOOLEANS = ["true", "false", "True", "False"]


def generate_launch_description():
    """Returns the arguments and the nodes."""
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "log_level",
                default_value="INFO",
                choices=LOG_LEVELS + [level.lower() for level in LOG_LEVELS],
                description="Least severe log lines to write.",
            ),
            DeclareLaunchArgument(
                "use_sim_time", default_value="false", choices=BOOLEANS, description="Take the time from /clock."
            ),
            DeclareLaunchArgument(
                "robot_name",
                default_value="",
                description="Namespace of the nodes and hardware_id of what they publish. "
                "Empty: no namespace, the host's name.",
            ),
            DeclareLaunchArgument(
                "thresholds",
                default_value=PathJoinSubstitution([FindPackageShare(PACKAGE), "config", "thresholds.yaml"]),
                description="Path of the thresholds.",
            ),
            DeclareLaunchArgument(
                "composed",
                default_value="false",
                choices=BOOLEANS,
                description="true: all three nodes in one process, which costs a third of the memory.",
            ),
            DeclareLaunchArgument(
                "respawn",
                default_value="false",
                choices=BOOLEANS,
                description="true: a node that ends is started again after 2 s.",
            ),
            DeclareLaunchArgument(
                "rosbridge_port",
                default_value="0",
                description="Port on which alert_system serves rosbridge clients; 0: none.",
            ),
            DeclareLaunchArgument(
                "rosbridge_address",
                default_value="127.0.0.1",
                description="Address of that server; any other one needs rosbridge_token_file.",
            ),
            DeclareLaunchArgument(
                "rosbridge_token_file",
                default_value="",
                description="Path of a file with the token that clients must present; empty: none.",
            ),
            *[
                node(name, name=name, condition=UnlessCondition(LaunchConfiguration("composed")))
                for name in ("battery_sensor", "aggregator", "alert_system")
            ],
            # Without a name: it would become that of all three.
            node("health_monitor", condition=IfCondition(LaunchConfiguration("composed"))),
        ]
    )


def node(executable, **options):
    """Returns one process of this package, with what all of them are told."""
    return Node(
        package=PACKAGE,
        executable=executable,
        namespace=LaunchConfiguration("robot_name"),
        # As an argument, not among the parameters: there launch only warns of a file that does not exist, and goes on.
        ros_arguments=[
            "--log-level",
            LaunchConfiguration("log_level"),
            "--params-file",
            LaunchConfiguration("thresholds"),
        ],
        parameters=[
            {
                # As texts even where they look like numbers: a robot may be called 7.
                "robot_name": ParameterValue(LaunchConfiguration("robot_name"), value_type=str),
                "thresholds": ParameterValue(LaunchConfiguration("thresholds"), value_type=str),
                "use_sim_time": ParameterValue(LaunchConfiguration("use_sim_time"), value_type=bool),
                "rosbridge_port": ParameterValue(LaunchConfiguration("rosbridge_port"), value_type=int),
                "rosbridge_address": ParameterValue(LaunchConfiguration("rosbridge_address"), value_type=str),
                "rosbridge_token_file": ParameterValue(LaunchConfiguration("rosbridge_token_file"), value_type=str),
            }
        ],
        respawn=LaunchConfiguration("respawn"),
        respawn_delay=2.0,
        output="screen",
        emulate_tty=True,
        **options,
    )
