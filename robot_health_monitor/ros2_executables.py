"""The executables of ROS 2: each starts the nodes it is named after in this process, and ends at a signal.

Exit codes: 0 after SIGINT, SIGTERM or a shutdown asked for by ROS; 2 when the configuration cannot be used.
"""

from __future__ import annotations

import signal
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any, Callable, List, Sequence, Tuple

if TYPE_CHECKING:
    from robot_health_monitor.core.config import MonitorConfig
    from robot_health_monitor.ros2.middleware import Ros2Middleware
    from robot_health_monitor.ros2.parameter_files import ParameterFiles

# What takes its time to import is imported by the functions, when a signal can no longer end in a traceback.


def battery_sensor() -> int:
    """Runs the sensor node; returns the exit code."""
    return _run("battery_sensor", ["battery_sensor"])


def aggregator() -> int:
    """Runs the aggregator node; returns the exit code."""
    return _run("aggregator", ["aggregator"])


def alert_system() -> int:
    """Runs the alert node; returns the exit code."""
    return _run("alert_system", ["alert_system"])


def health_monitor() -> int:
    """Runs all three in one process; returns the exit code."""
    return _run("health_monitor", ["alert_system", "aggregator", "battery_sensor"])


class _Interrupt:
    """SIGINT and SIGTERM: noted while the nodes are made, then left to rclpy, whose handlers end the spinning.

    From the start rclpy's handlers would shut its context down under nodes that are being made, and an exception would
    leave its objects half made; they complain of either, each in its own way. rclpy's handlers call this one too, so
    that there is never a KeyboardInterrupt.
    """

    def __init__(self) -> None:
        self.came = False
        self._is_importing = True
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._handle)

    def _handle(self, number: int, frame: Any) -> None:
        self.came = True
        if self._is_importing:
            self.ignore()
            sys.exit(0)

    def note_only(self) -> None:
        """Ends nothing any more, only remembers."""
        self._is_importing = False

    def leave_to_rclpy(self) -> bool:
        """Lets rclpy end the spinning, which no Python code can while it waits; False: a signal has come already."""
        from rclpy.signals import SignalHandlerOptions, install_signal_handlers

        install_signal_handlers(SignalHandlerOptions.ALL)
        return not self.came

    def ignore(self) -> None:
        """Lets nothing disturb the end: launch and a terminal each send SIGINT at Ctrl-C."""
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)


def _run(process: str, names: Sequence[str]) -> int:
    """Runs the nodes of `names` in this process."""
    interrupt = _Interrupt()
    try:
        import rclpy
    except ModuleNotFoundError as error:  # installed with pip on a machine without ROS
        sys.stderr.write(f"{process}: needs ROS 2, and {error.name} is not here; without ROS: robot-health run\n")
        return 2

    from robot_health_monitor.core.errors import ConfigError
    from robot_health_monitor.ros2.parameter_files import ParameterFiles

    interrupt.note_only()
    middlewares: List[Any] = []
    try:
        files = ParameterFiles(sys.argv)
        _init(files)
        _start(names, middlewares, files)
        _spin(middlewares, interrupt)
    except ConfigError as error:
        sys.stderr.write(f"{process}: {error}\n")
        return 2
    finally:
        interrupt.ignore()
        for middleware in middlewares:
            middleware.close()
        rclpy.try_shutdown()
    return 0


def _init(files: ParameterFiles) -> None:
    """Starts rclpy.

    Raises:
        ConfigError: rcl does not understand the arguments or a file.
    """
    import rclpy
    from rclpy.logging import LoggingSeverity, set_logger_level
    from rclpy.signals import SignalHandlerOptions

    set_logger_level("rcl", LoggingSeverity.FATAL)  # it would print a line of its own, which says less
    try:
        with tempfile.TemporaryDirectory() as folder:
            arguments = files.arguments_for_any_namespace(folder)
            rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    except (RuntimeError, ValueError) as error:
        raise files.explained(str(error)) from None
    finally:
        set_logger_level("rcl", LoggingSeverity.UNSET)


def _start(names: Sequence[str], middlewares: List[Any], files: ParameterFiles) -> None:
    """Starts the nodes; appends their middlewares to `middlewares`.

    Raises:
        ConfigError: the configuration of one of them cannot be used.
    """
    from robot_health_monitor.core.errors import ConfigError
    from robot_health_monitor.core.nodes import Aggregator, AlertSystem, BatterySensor
    from robot_health_monitor.ros2.middleware import Ros2Middleware

    classes: Any = {"battery_sensor": BatterySensor, "aggregator": Aggregator, "alert_system": AlertSystem}
    for name in names:
        middlewares.append(Ros2Middleware(name))
    for name, middleware in tuple(zip(names, middlewares)):
        try:
            node = classes[name](middleware)
            if name == "alert_system":
                middlewares.extend(_serve(node.monitor.config, middleware))
        except ConfigError as error:
            raise files.located(error, middleware.name) from None


def _serve(config: MonitorConfig, alert_system: Ros2Middleware) -> List[Any]:
    """Starts the rosbridge server that the alert node may ask for; returns the middleware that it serves.

    Raises:
        ConfigError: its port cannot be had, or a library is missing.
    """
    from robot_health_monitor.core.errors import ConfigError

    if not config.rosbridge_port:
        return []
    try:
        from robot_health_monitor.rosbridge.server.server_thread import ServerThread
    except ModuleNotFoundError as error:
        raise ConfigError(f"needs {error.name}, which is not installed", ("rosbridge_port",)) from None
    from robot_health_monitor.ros2.introspection import Ros2ServedMiddleware

    # Without the process' arguments, since `__node:=` among them is for alert_system.
    served = Ros2ServedMiddleware("rosbridge", namespace=alert_system.node.get_namespace(), use_global_arguments=False)
    server = ServerThread(
        served,
        alert_system.name,
        [signal.topic for signal in config.signals.values()],
        alert_system.given_parameters(),
        host=config.rosbridge_address,
        port=config.rosbridge_port,
        token=Path(config.rosbridge_token_file).read_text().strip() if config.rosbridge_token_file else "",
    )
    served.on_close = server.close
    return [served]


def _spin(middlewares: Sequence[Any], interrupt: _Interrupt) -> None:
    """Runs all nodes in this thread until rclpy's context is shut down."""
    import rclpy
    from rclpy.executors import ExternalShutdownException

    from robot_health_monitor.core.middleware import Severity

    log = middlewares[0].log
    executor, spin = _make_executor(any(middleware.executor == "events" for middleware in middlewares), log)
    for middleware in middlewares:
        executor.add_node(middleware.node)
    while interrupt.leave_to_rclpy() and rclpy.ok():
        try:
            spin()
        except ExternalShutdownException:
            return
        except Exception as error:  # of rclpy itself, such as a client that left before it got its response
            if rclpy.ok():
                log(Severity.ERROR, " ".join(str(error).split()))


def _make_executor(events: bool, log: Callable[..., None]) -> Tuple[Any, Callable[[], None]]:
    """Returns an executor and how to spin it."""
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.task import Future

    from robot_health_monitor.core.middleware import Severity

    executor: Any = SingleThreadedExecutor()
    if events:
        try:
            from rclpy.experimental import EventsExecutor
        except ImportError:
            log(Severity.WARN, "this rclpy has no EventsExecutor: going on with executor: single")
        else:
            executor = EventsExecutor()
            # Its spin() waits without a limit, which the builds of rclpy for pip do not do: they never get round to
            # anything. An hour they do wait.
            return executor, lambda: executor.spin_until_future_complete(Future(), 3600.0)
    return executor, executor.spin
