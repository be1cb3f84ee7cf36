"""Runs the executables of ROS 1 and ROS 2: wires nodes, adapter and rosbridge server, and chooses the exit code.

Exit codes: SUCCESS when ended by a signal or by ROS, USAGE also without ROS, FAILED: a supervisor may start it again.
"""

from __future__ import annotations

import sys
from contextlib import ExitStack, closing
from functools import partial
from typing import TYPE_CHECKING, Any, Callable, Mapping, Sequence

from ..runtime.interrupts import Interrupts
from .exit_codes import ExitCode, internal_error_text
from .service_manager import ServiceManager
from .standard_streams import StandardStreams

# Slow imports are in functions: they run once Interrupts handles signals.
if TYPE_CHECKING:
    from ..ros1.process import Ros1Process
    from ..ros2.process import Ros2Process
    from .operations import Operations

EXECUTABLES: Mapping[str, Sequence[str]] = {
    "battery_sensor": ("battery_sensor",),
    "aggregator": ("aggregator",),
    "alert_system": ("alert_system",),
    "health_monitor": ("alert_system", "aggregator", "battery_sensor"),
}
"""The nodes of each executable, in the order in which they start: alert_system must not miss the first values."""

_LIBRARIES = {"ROS 1": ("rospy", "yaml"), "ROS 2": ("rclpy", "yaml")}

_PATIENCE_S = {"ROS 1": 4.0}
"""Of `Interrupts`: a call to a ROS master that hangs must not keep the process from ending."""

Middleware = Any
"""A `core.port.middleware.Middleware`; that module is imported later."""


def _open_process(ros: str, executable: str, interrupts: Interrupts) -> Ros1Process | Ros2Process:
    """Imports the adapter; returns this process as one or several ROS nodes, not started."""
    if ros == "ROS 1":
        from ..ros1.process import Ros1Process

        return Ros1Process(executable, interrupts)
    from ..ros2.process import Ros2Process

    return Ros2Process(interrupts)


def run(ros: str, executable: str) -> int:
    """Runs one of `EXECUTABLES` on `ROS 1` or `ROS 2`; returns the exit code."""
    with StandardStreams() as streams, Interrupts(_PATIENCE_S.get(ros)) as interrupts:
        try:
            if {"-h", "--help"} & set(sys.argv[1:]):
                from .executable_help import help_text

                sys.stdout.write(help_text(executable, ros))
                return ExitCode.SUCCESS
            return _Running(executable, _open_process(ros, executable, interrupts), interrupts).run(streams)
        except KeyboardInterrupt:
            return ExitCode.SUCCESS
        except ModuleNotFoundError as error:
            from ..runtime.libraries import missing_libraries

            missing = ", ".join(missing_libraries(error, *_LIBRARIES.get(ros, ())))
            _print_error(executable, f"needs {ros}: no Python module {missing}; without ROS, use robot-health run")
            return ExitCode.USAGE
        except Exception as error:
            from ..core.values.errors import ConfigError, ServiceError

            if isinstance(error, ConfigError):
                for one in error.all:
                    _print_error(executable, str(one))
                return ExitCode.USAGE
            _print_error(executable, str(error) if isinstance(error, ServiceError) else internal_error_text(error))
            return ExitCode.FAILED


class _Running:
    """A process with its nodes, and what is closed before and after them."""

    def __init__(self, executable: str, process: Ros1Process | Ros2Process, interrupts: Interrupts) -> None:
        self._executable = executable
        self._process = process
        self._interrupts = interrupts
        self._service_manager = ServiceManager()
        self._tick_age_s: Callable[[], float] = lambda: 0.0
        """That of alert_system, in s."""
        self._before_nodes, self._after_nodes = ExitStack(), ExitStack()

    def run(self, streams: StandardStreams) -> int:
        """Runs the nodes; returns the exit code."""
        process = self._process
        with self._after_nodes, closing(process), self._before_nodes:
            try:
                process.start()
                streams.on_change(self._report_stream)
                for name in EXECUTABLES[self._executable]:
                    self._interrupts.check()
                    others = process.middlewares
                    if name != "battery_sensor" or not others or others[0].given_parameters().get("sensors") != "none":
                        self._start_node(name)
                if not process.middlewares:
                    process.close()
                    self._interrupts.wait_until(lambda: False)  # a launch file would report a process that ended
                self._service_manager.watch(process.middlewares[0], self._tick_age_s)
                self._service_manager.ready()
                failure = process.spin()
                if failure:
                    _print_error(self._executable, failure)
                return ExitCode.FAILED if failure else ExitCode.SUCCESS
            finally:
                self._service_manager.stopping()

    def _start_node(self, name: str) -> None:
        """Starts a node; if it refuses its parameters, with those with which it ran last."""
        from ..core.port.middleware import Severity
        from ..core.values.errors import ConfigError
        from ..core.values.faults import PARAMETERS_FAULT

        middleware: Middleware = self._process.create_node(name)
        try:
            self._start(name, middleware)
        except ConfigError as error:
            recovered = self._process.recover_node(name, middleware)
            if recovered is None:
                raise
            self._start(name, recovered)
            text = f"started with the last good ones: {error}"
            recovered.faults.report(PARAMETERS_FAULT, text)
            if name != "alert_system":  # which logs its faults
                recovered.log(Severity.ERROR, f"{PARAMETERS_FAULT}: {text}")

    def _start(self, name: str, middleware: Middleware) -> None:
        from ..core.nodes import Aggregator, BatterySensor
        from ..core.nodes.aggregator import has_inputs
        from ..core.port.middleware import Severity
        from ..core.sensors.computer import Computer
        from ..core.values.errors import ConfigError
        from ..runtime.threads import DetachedCalls

        try:
            if name == "alert_system":
                self._start_alert_system(middleware)
            elif name == "battery_sensor":
                BatterySensor(middleware, Computer(background=DetachedCalls("sources")))
            elif has_inputs(middleware.given_parameters()):
                Aggregator(middleware)
            else:
                text = "aggregator is not started: sensors is none, and no inputs are configured"
                middleware.log(Severity.INFO, text)
                middleware.close()
                self._process.middlewares.remove(middleware)
        except ConfigError as error:
            raise (error if error.file else self._process.locate(error, middleware)) from None

    def _start_alert_system(self, middleware: Middleware) -> None:
        """Starts alert_system, its operations and its rosbridge server."""
        parameters = middleware.given_parameters()
        self._after_nodes.close()  # the operations of a first attempt
        operations: Operations | None = None
        if parameters.get("ops") or parameters.get("rosbridge_port"):
            # Imported only where they are used: they take a megabyte of a small robot's memory.
            from .operations import Operations, configured_ops, read_config

            operations = Operations(read_config(configured_ops(parameters)))
            self._after_nodes.callback(operations.close)
            alert_system = operations.start_only(middleware)
        else:
            from ..core.nodes import AlertSystem

            alert_system = AlertSystem(middleware)
        self._before_nodes.callback(alert_system.save_state)
        self._tick_age_s = lambda: alert_system.tick_age_s
        if operations and (operations.config.server or alert_system.monitor.config.rosbridge_port):
            from .serving import serve_in_thread

            create_node = partial(self._process.create_served_node, middleware)
            server = serve_in_thread(create_node, middleware, alert_system, operations)
            if server is not None:
                self._before_nodes.callback(server.close)

    def _report_stream(self, stream: str, problem: str) -> None:
        for middleware in tuple(self._process.middlewares):
            middleware.faults.report(stream, problem)


def _print_error(executable: str, text: str) -> None:
    sys.stderr.write(f"{executable}: {' '.join(text.split())}\n")
