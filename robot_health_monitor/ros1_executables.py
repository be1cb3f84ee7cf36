"""The executables of ROS 1: each makes this process a node, starts what it is named after, and ends at a signal.

Exit codes: 0 after SIGINT, SIGTERM or a shutdown asked for by ROS; 2 when the configuration cannot be used.
"""

from __future__ import annotations

import logging
import os
import signal
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, Callable, List, Sequence

if TYPE_CHECKING:
    from robot_health_monitor.core.config import MonitorConfig
    from robot_health_monitor.ros1.middleware import Ros1Middleware

# What takes its time to import is imported by the functions, when a signal can no longer end in a traceback.

_POLL_S = 0.2
_PATIENCE_S = 4.0


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
    """SIGINT and SIGTERM. Until rospy runs they are a KeyboardInterrupt wherever the main thread is; then they wait.

    rospy must not be interrupted: a call to the master that was cut off makes the next one fail, and the node stays
    registered. Its own handlers are no better: they shut down within the handler, and wait forever for the lock of a
    call that they interrupted. Only when the end is still not there `_PATIENCE_S` later, something hangs and is
    interrupted after all.
    """

    def __init__(self) -> None:
        self.ros_is_running = False
        self._came = False
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._handle)
        signal.signal(signal.SIGALRM, self._lose_patience)

    def check(self) -> None:
        """Raises KeyboardInterrupt if a signal has come."""
        if self._came:
            raise KeyboardInterrupt

    def wait_until(self, predicate: Callable[[], bool]) -> None:
        """Waits until `predicate()` is true, or raises KeyboardInterrupt when a signal comes."""
        while not predicate():
            self.check()
            time.sleep(_POLL_S)
        self.check()

    def _handle(self, number: int, frame: Any) -> None:
        if not self._came:
            self._came = True
            signal.setitimer(signal.ITIMER_REAL, _PATIENCE_S)
            if not self.ros_is_running:
                raise KeyboardInterrupt

    def _lose_patience(self, number: int, frame: Any) -> None:
        raise KeyboardInterrupt


def _run(process: str, names: Sequence[str]) -> int:
    """Runs the nodes of `names` in this process, whose ROS node is called `process`."""
    interrupt = _Interrupt()
    try:
        return _run_until(interrupt, process, names)
    except KeyboardInterrupt:
        return 0


def _run_until(interrupt: _Interrupt, process: str, names: Sequence[str]) -> int:
    import rospy

    from robot_health_monitor.core.errors import ConfigError

    nodes: List[Any] = []
    try:
        _flush_lines()
        _wait_for_master(process, interrupt)
        interrupt.ros_is_running = True
        rospy.init_node(process, disable_signals=True)
        rospy.on_shutdown(lambda: [node.close() for node in nodes])
        _set_log_level()
        _start(names, nodes, interrupt)
        interrupt.wait_until(rospy.is_shutdown)
    except ConfigError as error:
        sys.stderr.write(f"{process}: {error}\n")
        return 2
    finally:
        rospy.signal_shutdown(f"{process} ends")
    return 0


def _start(names: Sequence[str], nodes: List[Any], interrupt: _Interrupt) -> None:
    """Starts the nodes; appends them to `nodes`.

    Raises:
        ConfigError: the configuration of one of them cannot be used.
        KeyboardInterrupt: a signal has come.
    """
    from robot_health_monitor.core.nodes import Aggregator, AlertSystem, BatterySensor
    from robot_health_monitor.ros1.middleware import Ros1Middleware

    classes = {"battery_sensor": BatterySensor, "aggregator": Aggregator, "alert_system": AlertSystem}
    for name in names:
        interrupt.check()
        middleware = Ros1Middleware(name if len(names) > 1 else "")
        if name == "alert_system":
            _check_file(middleware)
        nodes.append(classes[name](middleware))
        if name == "alert_system":
            nodes[:0] = _serve(nodes[-1].monitor.config, middleware)  # closed first


def _serve(config: MonitorConfig, alert_system: Ros1Middleware) -> List[Any]:
    """Starts the rosbridge server that the alert node may ask for; returns what to close.

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
    from robot_health_monitor.ros1.introspection import Ros1ServedMiddleware

    served = Ros1ServedMiddleware("rosbridge")
    server = ServerThread(
        served,
        alert_system.name,
        [signal.topic for signal in config.signals.values()],
        alert_system.given_parameters(),
        host=config.rosbridge_address,
        port=config.rosbridge_port,
        token=Path(config.rosbridge_token_file).read_text().strip() if config.rosbridge_token_file else "",
    )
    return [server, served]


def _check_file(middleware: Ros1Middleware) -> None:
    """Raises ConfigError with file and line when the file is wrong that the parameters were loaded from.

    The parameters alone cannot tell where they came from. The file may be on another machine than this node.
    """
    from robot_health_monitor.core.config import load_config

    file = middleware.given_parameters().get("thresholds", "")
    if isinstance(file, str) and os.path.isfile(file):
        load_config(file, middleware.name.rpartition("/")[2])


def _wait_for_master(process: str, interrupt: _Interrupt) -> None:
    import rosgraph

    if not rosgraph.is_master_online():
        interrupt.check()  # which may be why
        uri = rosgraph.get_master_uri()
        sys.stderr.write(f"{process}: waiting for the ROS master at {uri} (ROS_MASTER_URI); Ctrl-C ends this\n")
        interrupt.wait_until(rosgraph.is_master_online)


def _set_log_level() -> None:
    import rospy

    from robot_health_monitor.core.config import NODE_PARAMETERS

    log_level = next(parameter for parameter in NODE_PARAMETERS if parameter.name == "log_level")
    level = log_level.read(rospy.get_param("~log_level", log_level.default), (log_level.name,))
    logging.getLogger("rosout").setLevel(level)


def _flush_lines() -> None:
    """Shows each line at once: rospy writes INFO to stdout, which Python buffers when it is no terminal."""
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]  # a real file in an executable
