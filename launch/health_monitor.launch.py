"""Starts the health monitor of one robot: battery_sensor, aggregator and alert_system.

    ros2 launch robot_health_monitor health_monitor.launch.py robot_name:=robot1 thresholds:=my.yaml

`--show-args` lists the arguments. To include this file, pass `launch_arguments`; `SetRemap` and `PushRosNamespace`
around it apply to every node.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution, PythonExpression
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

PACKAGE = "robot_health_monitor"
LOG_LEVELS = ["DEBUG", "INFO", "WARN", "ERROR", "FATAL"]
BOOLEANS = ["true", "false", "True", "False"]
ARGUMENTS = {
    "log_level": ("INFO", "lowest severity that is logged", LOG_LEVELS + [level.lower() for level in LOG_LEVELS]),
    "use_sim_time": ("false", "true: use the time from /clock", BOOLEANS),
    "robot_name": ("", "namespace of the nodes and hardware_id of their messages; empty: no namespace, the host name"),
    "thresholds": (
        PathJoinSubstitution([FindPackageShare(PACKAGE), "config", "thresholds.yaml"]),
        "path of thresholds.yaml",
    ),
    "sensors": (
        "simulated",
        "source of the metrics of battery_sensor that the thresholds file gives no source; "
        "none: battery_sensor is not started, nor is aggregator unless its inputs are configured",
        ["simulated", "host", "none"],
    ),
    "composed": ("false", "true: all nodes in one process, which needs a third of the memory", BOOLEANS),
    "respawn": ("false", "true: a node that ends is started again after 2 s", BOOLEANS),
    "rosbridge_port": ("0", "port of the rosbridge server of alert_system; 0: no server"),
    "rosbridge_address": ("127.0.0.1", "address of the rosbridge server; any other one needs a token"),
    "rosbridge_token_file": ("", "path of a file with the token that clients must present; empty: no token"),
    "ops": ("", "path of an ops.yaml (history, notifications, server); empty: none"),
}
"""Default, description and, where not every text is allowed, the choices."""
PARAMETERS = {
    # Strings even if they look like numbers: a robot may be named 7.
    **dict.fromkeys(["robot_name", "thresholds", "rosbridge_address", "rosbridge_token_file", "sensors", "ops"], str),
    "use_sim_time": bool,
    "rosbridge_port": int,
}
SEPARATE = PythonExpression(["'", LaunchConfiguration("composed"), "'.lower() != 'true'"])
SENSORS = PythonExpression(["'", LaunchConfiguration("sensors"), "' != 'none'"])


def generate_launch_description():
    """Returns the launch arguments and the nodes."""
    return LaunchDescription(
        [
            *(argument(name, *values) for name, values in ARGUMENTS.items()),
            node(
                "battery_sensor",
                name="battery_sensor",
                condition=IfCondition(PythonExpression([SEPARATE, " and ", SENSORS])),
            ),
            node("aggregator", name="aggregator", condition=IfCondition(SEPARATE)),
            node("alert_system", name="alert_system", condition=IfCondition(SEPARATE)),
            # Without a name, which would rename all its nodes.
            node("health_monitor", condition=IfCondition(LaunchConfiguration("composed"))),
        ]
    )


def argument(name, default, description, choices=None):
    """Returns one launch argument."""
    return DeclareLaunchArgument(name, default_value=default, description=description, choices=choices)


def node(executable, **options):
    """Returns one process of this package with the parameters common to all."""
    return Node(
        package=PACKAGE,
        executable=executable,
        namespace=LaunchConfiguration("robot_name"),
        # An argument instead of a parameter file of launch, which only warns if the file does not exist.
        ros_arguments=[
            "--log-level",
            LaunchConfiguration("log_level"),
            "--params-file",
            LaunchConfiguration("thresholds"),
        ],
        parameters=[
            {name: ParameterValue(LaunchConfiguration(name), value_type=kind) for name, kind in PARAMETERS.items()}
        ],
        respawn=LaunchConfiguration("respawn"),
        respawn_delay=2.0,
        output="screen",
        emulate_tty=True,
        **options,
    )
