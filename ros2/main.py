"""The executables of ROS 2: each starts the nodes it is named after in this process, and ends at a signal.

Exit codes: 0 after SIGINT, SIGTERM or a shutdown asked for by ROS; 2 when the configuration cannot be used.
"""

from __future__ import annotations

import re
import signal
import sys
from typing import Any, Callable, List, Sequence

# What takes its time to import is imported by the functions, when a signal can no longer end in a traceback.

_RCL_FILE_ERROR = re.compile(
    r".*Couldn't parse params file: '--params-file (?P<file>.+?)'\. Error: (?P<why>.+?)"
    r"(?: (?:at|near) line(?:_num)? (?P<line>\d+))?\s*, at ",
    re.DOTALL,
)


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
    """SIGINT and SIGTERM: before rclpy runs they end the process here; then rclpy's handlers shut its context down.

    rclpy calls this handler from its own, so that there is never a KeyboardInterrupt.
    """

    def __init__(self) -> None:
        self.came = False
        self.ros_is_running: Callable[[], bool] = lambda: False
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._handle)

    def _handle(self, number: int, frame: Any) -> None:
        self.came = True
        if not self.ros_is_running():
            sys.exit(0)

    def ignore(self) -> None:
        """Lets nothing disturb the end: launch and a terminal each send SIGINT at Ctrl-C."""
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)


def _run(process: str, names: Sequence[str]) -> int:
    """Runs the nodes of `names` in this process."""
    interrupt = _Interrupt()
    import rclpy

    from ..core.parameters import ConfigError

    interrupt.ros_is_running = rclpy.ok
    middlewares: List[Any] = []
    try:
        _init(sys.argv)
        _start(names, middlewares, _parameter_files(sys.argv))
        _spin(middlewares)
    except ConfigError as error:
        sys.stderr.write(f"{process}: {error}\n")
        return 2
    except Exception:
        if not interrupt.came:
            raise
    finally:
        interrupt.ignore()
        for middleware in middlewares:
            middleware.close()
        rclpy.try_shutdown()
    return 0


def _init(arguments: Sequence[str]) -> None:
    """Starts rclpy.

    Raises:
        ConfigError: a file of parameters cannot be read, or rcl does not understand the arguments.
    """
    import rclpy
    from rclpy.logging import LoggingSeverity, set_logger_level

    from ..core.parameters import ConfigError
    from ..core.yaml_file import read_yaml

    for file in _parameter_files(arguments):
        read_yaml(file)
    set_logger_level("rcl", LoggingSeverity.FATAL)  # it would print a line of its own, which says less
    try:
        rclpy.init(args=list(arguments))
    except RuntimeError as error:
        raise _explained(str(error), arguments) from None
    except ValueError as error:
        raise ConfigError(_one_line(error)) from None
    finally:
        set_logger_level("rcl", LoggingSeverity.UNSET)


def _start(names: Sequence[str], middlewares: List[Any], files: Sequence[str]) -> None:
    """Starts the nodes; appends their middlewares to `middlewares`.

    Raises:
        ConfigError: the configuration of one of them cannot be used.
    """
    from ..core.nodes import Aggregator, AlertSystem, BatterySensor
    from ..core.parameters import ConfigError
    from .middleware import Ros2Middleware

    classes = {"battery_sensor": BatterySensor, "aggregator": Aggregator, "alert_system": AlertSystem}
    for name in names:
        middlewares.append(Ros2Middleware(name))
    for name, middleware in zip(names, middlewares):
        try:
            classes[name](middleware)
        except ConfigError as error:
            raise _located(error, middleware.name, files) from None


def _spin(middlewares: Sequence[Any]) -> None:
    """Runs all nodes in this thread until rclpy's context is shut down."""
    import rclpy
    from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor

    from ..core.middleware import Severity

    log = middlewares[0].log
    executor: Any = None
    if any(middleware.executor == "events" for middleware in middlewares):
        try:
            from rclpy.experimental import EventsExecutor
        except ImportError:
            log(Severity.WARN, "this rclpy has no EventsExecutor: going on with executor: single")
        else:
            executor = EventsExecutor()
    executor = executor or SingleThreadedExecutor()
    for middleware in middlewares:
        executor.add_node(middleware.node)
    while rclpy.ok():
        try:
            executor.spin()
        except ExternalShutdownException:
            return
        except Exception as error:  # of rclpy itself, such as a client that left before it got its response
            if rclpy.ok():
                log(Severity.ERROR, _one_line(error))


def _parameter_files(arguments: Sequence[str]) -> List[str]:
    return [file for option, file in zip(arguments, arguments[1:]) if option == "--params-file"]


def _located(error: Any, node: str, files: Sequence[str]) -> Any:
    """Returns a ConfigError of `node` with file and line, where the key that it names is in one of `files`."""
    from ..core.config import sections
    from ..core.parameters import ConfigError
    from ..core.yaml_file import read_yaml

    for file in reversed(files):
        read = read_yaml(file)
        for name, section in sections(read.tree).items():
            path = (*section.path, *error.path)
            if name in (node.rpartition("/")[2], "*", "**") and path in read.lines:
                return read.locate(ConfigError(error.problem, path))
    return error


def _explained(problem: str, arguments: Sequence[str]) -> Any:
    """Returns what rcl says of its arguments as a ConfigError, with file and line where it tells them."""
    from ..core.config import load_config
    from ..core.parameters import ConfigError

    for file in _parameter_files(arguments):
        try:
            load_config(file)
        except ConfigError as error:
            if error.line is not None:
                return error
    match = _RCL_FILE_ERROR.match(problem)
    if match is None:
        return ConfigError(_one_line(problem))
    return ConfigError(match["why"], file=match["file"], line=int(match["line"]) if match["line"] else None)


def _one_line(text: object) -> str:
    return " ".join(str(text).split())


