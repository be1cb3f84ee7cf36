"""Runs the executables of ROS 1 and ROS 2: wires nodes, adapter and rosbridge server, and chooses the exit code.

=========  ================================================================
exit code  meaning
=========  ================================================================
0          ended by SIGINT, SIGTERM or a shutdown that ROS requested; --help
2          the configuration cannot be used, or ROS is not installed
3          failed; a supervisor may start it again
=========  ================================================================
"""

from __future__ import annotations

import os
import sys
import traceback
from typing import Any, Callable, List, Mapping, Optional, Protocol, Sequence

from robot_health_monitor.runtime.interrupts import Interrupts

from .service_manager import ServiceManager
from .standard_streams import StandardStreams

# Slow imports are in functions: they run once Interrupts handles signals.

SUCCESS, UNUSABLE, FAILED = 0, 2, 3

_SHORTEST_PERIOD_S = 0.1
"""Of signs of life to systemd, in s."""

EXECUTABLES: Mapping[str, Sequence[str]] = {
    "battery_sensor": ("battery_sensor",),
    "aggregator": ("aggregator",),
    "alert_system": ("alert_system",),
    "health_monitor": ("alert_system", "aggregator", "battery_sensor"),
}
"""The nodes of each executable, in the order in which they start: alert_system must not miss the first values."""

RESPAWN = "ROBOT_HEALTH_RESPAWN"
"""Environment variable in which the launch files pass their argument `respawn`."""

Middleware = Any
"""A `core.middleware.Middleware`; that module is imported later."""


class Process(Protocol):
    """This process as one or several ROS nodes; `ros1/process.py` and `ros2/process.py`."""

    middlewares: List[Middleware]
    """The middlewares of its nodes."""

    def start(self) -> None:
        """Connects the process to ROS.

        Raises:
            ConfigError: ROS cannot use the command line or a parameter file.
            ServiceError: ROS stopped answering.
        """

    def create_node(self, name: str) -> Middleware:
        """Creates the middleware of one node."""

    def create_served_node(self, alert_system: Middleware) -> Middleware:
        """Creates the node that a rosbridge server serves, in the namespace of alert_system."""

    def recover_node(self, name: str, failed: Middleware) -> Optional[Middleware]:
        """Creates a node again, with the parameters with which it ran last; None: no others are known."""

    def locate(self, error: Any, middleware: Middleware) -> Any:
        """Returns a ConfigError of a node, and its others, with file and line where the key comes from a file."""

    def spin(self) -> str:
        """Runs until the process is to end; returns why it failed, empty if it did not."""

    def close(self) -> None:
        """Closes every node and disconnects from ROS. May be called before `start`, and twice."""


def run(
    executable: str,
    open_process: Callable[[str, Interrupts], Process],
    *,
    ros: str,
    patience_s: Optional[float] = None,
) -> int:
    """Runs an executable.

    Args:
        executable: its name, a key of `EXECUTABLES`.
        open_process: imports the adapter and returns a `Process` that is not started.
        ros: name of the middleware for error messages.
        patience_s: see `Interrupts`.

    Returns:
        The exit code.
    """
    with StandardStreams() as streams, Interrupts(patience_s) as interrupts:
        try:
            if {"-h", "--help"} & set(sys.argv[1:]):
                return _help(executable, ros)
            return _run(executable, open_process, streams, interrupts)
        except KeyboardInterrupt:
            return SUCCESS
        except ModuleNotFoundError as error:
            _print_error(executable, f"needs {ros}: no Python module {error.name}; without ROS, use robot-health run")
            return UNUSABLE
        except Exception as error:
            place = traceback.extract_tb(error.__traceback__)[-1]
            where = f"{os.path.basename(place.filename)}:{place.lineno}"
            _print_error(executable, f"internal error: {type(error).__name__}: {error} ({where})")
            return FAILED


def _help(executable: str, ros: str) -> int:
    from .executable_help import help_text

    sys.stdout.write(help_text(executable, ros))
    return SUCCESS


def _run(
    executable: str,
    open_process: Callable[[str, Interrupts], Process],
    streams: StandardStreams,
    interrupts: Interrupts,
) -> int:
    process = open_process(executable, interrupts)

    from robot_health_monitor.core.errors import ConfigError, ServiceError

    running = _Running()
    service_manager = ServiceManager()
    try:
        process.start()
        streams.on_change(lambda name, problem: _report(process, name, problem))
        _start_nodes(process, EXECUTABLES[executable], interrupts, running)
        if not process.middlewares:
            process.close()
            return _end_without_nodes(interrupts)
        _keep_alive(process.middlewares[0], running.alert_system, service_manager)
        service_manager.ready()
        failure = process.spin()
        if failure:
            _print_error(executable, failure)
        return FAILED if failure else SUCCESS
    except ConfigError as error:
        for one in error.all:
            _print_error(executable, str(one))
        return UNUSABLE
    except ServiceError as error:
        _print_error(executable, str(error))
        return FAILED
    finally:
        service_manager.stopping()
        running.close_before_nodes()
        process.close()
        running.close_after_nodes()


class _Running:
    """What runs beside the nodes of a process."""

    def __init__(self) -> None:
        self.alert_system: Any = None
        self.operations: Any = None
        self.server: Any = None

    def close_before_nodes(self) -> None:
        if self.server is not None:
            self.server.close()
        if self.alert_system is not None:
            self.alert_system.save_state()

    def close_after_nodes(self) -> None:
        if self.operations is not None:
            self.operations.close()
            self.operations = None


def _start_nodes(process: Process, names: Sequence[str], interrupts: Interrupts, running: _Running) -> None:
    """Starts the nodes and, with alert_system, its operations and its rosbridge server.

    Raises:
        ConfigError: the configuration of a node cannot be used.
        KeyboardInterrupt: a signal has come.
    """
    for name in names:
        interrupts.check()
        if name == "battery_sensor" and len(names) > 1 and _without_sensors(process.middlewares[0]):
            continue
        _start_node(process, name, running)
        operations = running.operations
        if name == "alert_system" and operations is not None:
            node = running.alert_system
            if operations.server or node.monitor.config.rosbridge_port:
                running.server = _serve(process, node, process.middlewares[-1], operations)


def _start_node(process: Process, name: str, running: _Running) -> None:
    """Starts a node; with the parameters with which it ran last if it refuses those that were given.

    Raises:
        ConfigError: it refuses both.
    """
    from robot_health_monitor.core.errors import ConfigError
    from robot_health_monitor.core.faults import PARAMETERS_FAULT
    from robot_health_monitor.core.middleware import Severity
    from robot_health_monitor.core.nodes import Aggregator, BatterySensor
    from robot_health_monitor.core.nodes.aggregator import has_inputs

    def start(middleware: Middleware) -> None:
        try:
            if name == "alert_system":
                _start_alert_system(middleware, running)
            elif name == "battery_sensor":
                BatterySensor(middleware)
            elif has_inputs(middleware.given_parameters()):
                Aggregator(middleware)
            else:
                middleware.log(
                    Severity.INFO, "aggregator is not started: sensors is none, and no inputs are configured"
                )
                middleware.close()
                process.middlewares.remove(middleware)
        except ConfigError as error:
            raise (error if error.file else process.locate(error, middleware)) from None

    middleware = process.create_node(name)
    try:
        start(middleware)
    except ConfigError as error:
        recovered = process.recover_node(name, middleware)
        if recovered is None:
            raise
        start(recovered)
        text = f"started with the last good ones: {error}"
        recovered.faults.report(PARAMETERS_FAULT, text)
        if name != "alert_system":  # which logs its faults
            recovered.log(Severity.ERROR, f"{PARAMETERS_FAULT}: {text}")


def _start_alert_system(middleware: Middleware, running: _Running) -> None:
    parameters = middleware.given_parameters()
    running.close_after_nodes()  # those of a first attempt
    if parameters.get("ops") or parameters.get("rosbridge_port"):
        # Imported only where they are used: they take a megabyte of a small robot's memory.
        from .operations import configured_ops, open_operations

        running.operations = open_operations(configured_ops(parameters))
        running.alert_system = running.operations.start_only(middleware)
    else:
        from robot_health_monitor.core.nodes import AlertSystem

        running.alert_system = AlertSystem(middleware)


def _end_without_nodes(interrupts: Interrupts) -> int:
    """Ends a process that has nothing to do; one that would be started again waits for a signal first."""
    if os.environ.get(RESPAWN, "").lower() == "true":
        interrupts.wait_until(lambda: False)
    return SUCCESS


def _keep_alive(middleware: Middleware, alert_system: Optional[Any], service_manager: ServiceManager) -> None:
    """Sends signs of life to systemd, if it asks for them, while the callbacks of a node run."""
    period_s = service_manager.watchdog_period_s
    if period_s is not None:

        def send(now_s: float) -> None:
            service_manager.alive(0.0 if alert_system is None else alert_system.tick_age_s)

        middleware.create_timer(max(_SHORTEST_PERIOD_S, period_s / 2.0), send, steady=True)


def _without_sensors(middleware: Middleware) -> bool:
    return bool(middleware.given_parameters().get("sensors") == "none")


def _serve(process: Process, alert_system: Any, middleware: Middleware, operations: Any) -> Any:
    from .serving import serve_in_thread

    return serve_in_thread(lambda: process.create_served_node(middleware), middleware, alert_system, operations)


def _report(process: Process, stream: str, problem: str) -> None:
    for middleware in tuple(process.middlewares):
        if problem:
            middleware.faults.report(stream, problem)
        else:
            middleware.faults.clear(stream)


def _print_error(executable: str, text: str) -> None:
    sys.stderr.write(f"{executable}: {' '.join(text.split())}\n")
