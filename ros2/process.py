"""This process as one or several ROS 2 nodes (`middleware.py`), which one executor spins.

`Ros2Process` has the methods of `Process` in `cli/executables.py`, as `Ros1Process` does.
"""

from __future__ import annotations

import os
import sys
import time
import warnings
from typing import TYPE_CHECKING, Any, Callable

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.logging import LoggingSeverity, set_logger_level
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions, install_signal_handlers, uninstall_signal_handlers
from rclpy.task import Future
from std_msgs.msg import Empty

from ..core.port import Severity
from ..core.values import ConfigError, Level, ServiceError
from ..runtime.threads import StepThread
from .middleware import Ros2Middleware
from .parameters import ParameterFiles

if TYPE_CHECKING:
    from ..runtime.interrupts import Interrupts

_DEFAULTS = ("--ros-args", "-p", "start_type_description_service:=false", "--")
"""Arguments before those of the user, which override them. Without the service, a node takes 0.2 MB less."""
_PROBE_TOPIC = "~/_executor_probe"
_PROBE_S = 2.0
"""How long the EventsExecutor may take to deliver its first message, in s."""
_IDLE_S = 0.2
_MAX_IDLE_LOAD = 0.1
"""Share of a core above which an executor that has nothing to do is taken for a busy loop."""
_SPIN_S = 3600.0
_LISTEN_S = 0.2
"""How often a listener looks whether it is to end, in s."""
_MAX_DOMAIN_ID = 232
"""Ports of DDS: 7400 + 250 per domain (https://docs.ros.org/en/jazzy/Concepts/Intermediate/About-Domain-ID.html)."""


class Ros2Process:
    """One rclpy context, with one node or several."""

    def __init__(self, interrupts: Interrupts) -> None:
        """Does nothing yet."""
        self.middlewares: list[Ros2Middleware] = []
        self._interrupts = interrupts
        self._log_problem = ""
        self._listening: StepThread | None = None

    def start(self) -> None:
        """Reads the command line and the parameter files."""
        # Until it spins, rclpy's own handlers would shut its context down under nodes that are being created, and an
        # exception would leave its objects half made.
        self._interrupts.defer()
        self._files = ParameterFiles(sys.argv)
        set_logger_level("rcl", LoggingSeverity.FATAL)  # rcl would print a less helpful line as well
        try:
            with self._files.arguments_for_any_namespace() as arguments:
                self._log_problem = log_folder_problem()
                if self._log_problem:  # rcl would refuse to start
                    arguments = [*arguments, "--ros-args", "--disable-external-lib-logs"]
                rclpy.init(args=[*_DEFAULTS, *arguments], signal_handler_options=SignalHandlerOptions.NO)
        except (RuntimeError, ValueError) as error:
            raise self._files.explained(str(error)) from None
        finally:
            set_logger_level("rcl", LoggingSeverity.UNSET)
        _check_domain(rclpy.utilities.get_default_context().get_domain_id())

    def create_node(self, name: str) -> Ros2Middleware:
        """Creates the middleware of one node; raises ServiceError if the RMW refuses, as without network interface."""
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", RuntimeWarning)  # of rclpy, about the node that was not created
                middleware = Ros2Middleware(name)
        except RuntimeError as error:
            rmw = rclpy.get_rmw_implementation_identifier()
            raise ServiceError(f"{rmw} cannot create a node; it may have printed the reason above: {error}") from None
        self.middlewares.append(middleware)
        if self._log_problem:
            middleware.faults.report("log file", self._log_problem, Level.WARN)
        return middleware

    def create_served_node(self, alert_system: Ros2Middleware) -> Ros2Middleware:
        """Creates the node that a rosbridge server serves."""
        # Without the arguments of the process: a `__node:=` among them is meant for alert_system.
        namespace = alert_system.node.get_namespace()
        served = Ros2Middleware("rosbridge", namespace=namespace, use_global_arguments=False)
        self.middlewares.append(served)
        return served

    def create_listener(self, name: str) -> Ros2Middleware:
        """Creates a node that only listens, and runs it at once, in a thread."""
        listener = Ros2Middleware(name)
        self.middlewares.append(listener)
        executor, _ = choose_executor("auto", [listener.node], listener.log)

        def listen() -> float:
            executor.spin_until_future_complete(Future(), _LISTEN_S)
            return 0.0

        self._listening = StepThread("listener", listen, bool)  # it only raises if rclpy is shut down
        self._listening.start()
        return listener

    def recover_node(self, name: str, failed: Ros2Middleware) -> None:
        """Returns None, since parameters that were set at run time end with their node."""

    def locate(self, error: ConfigError, middleware: Ros2Middleware) -> ConfigError:
        """Returns the error and its others with file and line where the key is in a parameter file."""
        first, *others = (self._files.located(one, middleware.name) for one in error.all)
        first.others = tuple(others)
        return first

    def spin(self) -> str:
        """Runs the callbacks of all nodes in this thread until rclpy is shut down."""
        log = self.middlewares[0].log
        nodes = [middleware.node for middleware in self.middlewares]
        _, spin = choose_executor(self.middlewares[0].parameters.executor, nodes, log)
        while self._leave_signals_to_rclpy() and rclpy.ok():
            try:
                spin()
            except ExternalShutdownException:
                break
            except Exception as error:  # of rclpy itself, such as a client that left before it got its response
                if rclpy.ok():
                    log(Severity.ERROR, " ".join(str(error).split()))
        return ""

    def close(self) -> None:
        """Closes every node and shuts rclpy down."""
        if self._listening is not None:
            self._listening.close()
            self._listening.join()
        uninstall_signal_handlers()
        for middleware in self.middlewares:
            middleware.close()
        rclpy.try_shutdown()

    def _leave_signals_to_rclpy(self) -> bool:
        """Lets rclpy's handlers end the spinning, as no Python code can while it waits.

        Returns False if a signal has come. The handlers call Python's too, so `Interrupts` learns of the signal.
        """
        install_signal_handlers(SignalHandlerOptions.ALL)
        return not self._interrupts.came


def choose_executor(
    wanted: str, nodes: list[Any], log: Callable[[Severity, str], None]
) -> tuple[Any, Callable[[], None]]:
    """Chooses the executor of all nodes and adds them to it; returns it and the function that spins it.

    Args:
        wanted: auto, events or single. auto: rclpy's EventsExecutor if it works here, else the single-threaded one.
        nodes: the nodes.
        log: where a choice that differs from an explicit wish is logged.
    """
    if wanted != "single":
        try:
            from rclpy.experimental import EventsExecutor
        except ImportError:
            problem = "this rclpy has none"
        else:
            executor = EventsExecutor(context=nodes[0].context)
            problem = _probe(executor, nodes)
            if not problem:
                # Not spin(): without a time limit the EventsExecutor of PyPI's wheels delivers nothing.
                return executor, lambda: executor.spin_until_future_complete(Future(), _SPIN_S)
            for node in nodes:
                executor.remove_node(node)
            executor.shutdown()
        if wanted == "events":
            log(Severity.WARN, f"executor single instead of events: {problem}")
    single = SingleThreadedExecutor(context=nodes[0].context)
    for node in nodes:
        single.add_node(node)
    return single, single.spin


def _probe(executor: Any, nodes: list[Any]) -> str:
    """Adds the nodes to an executor and tests it; returns what is wrong: it is busy with nothing, or delivers nothing.

    A message is what counts: some RMWs have no events for messages, although timers work.
    """
    busy_s = time.thread_time()
    executor.spin_until_future_complete(Future(), _IDLE_S)
    load = (time.thread_time() - busy_s) / _IDLE_S
    for node in nodes:
        executor.add_node(node)
    if load > _MAX_IDLE_LOAD:
        return f"it is busy while idle ({load:.0%} of a core)"
    delivered: Future = Future()
    node = nodes[0]
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    publisher = node.create_publisher(Empty, _PROBE_TOPIC, latched)
    publisher.publish(Empty())
    subscription = node.create_subscription(Empty, _PROBE_TOPIC, delivered.set_result, latched)
    try:
        executor.spin_until_future_complete(delivered, _PROBE_S)
    finally:
        node.destroy_publisher(publisher)
        node.destroy_subscription(subscription)
    return "" if delivered.done() else f"it delivers no message within {_PROBE_S:g} s"


def _check_domain(domain_id: int) -> None:
    """Raises ConfigError if DDS has no ports for this domain: Fast DDS would end the process in mid-output."""
    if domain_id > _MAX_DOMAIN_ID and rclpy.get_rmw_implementation_identifier() != "rmw_zenoh_cpp":
        raise ConfigError(f"expected at most {_MAX_DOMAIN_ID}, got {domain_id}", ("ROS_DOMAIN_ID",))


def log_folder_problem() -> str:
    """Creates the folder of rcl's log files, as rcl does; returns why it cannot be written to, empty if it can."""
    home = os.environ.get("ROS_HOME") or os.path.join("~", ".ros")
    folder = os.path.expanduser(os.environ.get("ROS_LOG_DIR") or os.path.join(home, "log"))
    try:
        os.makedirs(folder, exist_ok=True)
    except OSError as error:
        return f"no log file: {folder} cannot be created: {error.strerror}"
    return "" if os.access(folder, os.W_OK) else f"no log file: {folder} is read-only"
