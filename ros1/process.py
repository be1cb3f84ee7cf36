"""This process as a ROS 1 node. Its logical nodes (`middleware.py`) share the connection to the master.

`Ros1Process` has the methods of `Process` in `cli/executables.py`, as `Ros2Process` does.
"""

from __future__ import annotations

import logging
import os
import sys
import time
from typing import TYPE_CHECKING

import rosgraph
import rospy
import rospy.impl.paramserver

from ..core.config import load_config
from ..core.values import PARAMETERS_FAULT, ConfigError, Level, ServiceError
from .master import Master, MasterWatch, limit_calls_of_rospy
from .middleware import Ros1Middleware
from .parameters import NodeParameters, set_log_level

if TYPE_CHECKING:
    from ..runtime.interrupts import Interrupts

_REPORT_S = 2.0
"""How long the nodes have to report a fault before the process ends, in s: twice their period."""
_ROSOUT_WITHOUT_TOPICS = "/rosout_disable_topics_generation"


class Ros1Process:
    """One ROS 1 node, with one logical node or several."""

    def __init__(self, executable: str, interrupts: Interrupts) -> None:
        """Does nothing yet; `executable` is the name of the ROS node, which `__name:=` may change."""
        self.middlewares: list[Ros1Middleware] = []
        self._executable = executable
        self._interrupts = interrupts
        self._problem = ""

    def start(self) -> None:
        """Waits for the master and registers with it."""
        name = rosgraph.names.resolve_name(self._executable, rospy.get_name())
        master = Master(name)
        self._wait_for(master)
        # From here on rospy must not be interrupted: a call to the master that was cut off makes the next one fail,
        # and the node stays registered. Its own signal handlers wait forever for the lock of a call they interrupted.
        self._interrupts.defer()
        logging.raiseExceptions = False  # a log file on a full disk gives no tracebacks
        limit_calls_of_rospy(master)
        rospy.init_node(self._executable, disable_signals=True)
        rospy.on_shutdown(self._close_nodes)
        self._master = Master(rospy.get_name())
        self._set_log_level()
        self._keep_log_from_master()
        self._watch = MasterWatch(self._master, rospy.get_name(), self._report_master)
        self._watch.start()

    def create_node(self, name: str) -> Ros1Middleware:
        """Creates the middleware of one logical node; one with the executable's name is the ROS node itself."""
        self.middlewares.append(Ros1Middleware("" if name == self._executable else name))
        if self._problem:
            self.middlewares[-1].faults.report(PARAMETERS_FAULT, self._problem)
        return self.middlewares[-1]

    def create_served_node(self, alert_system: Ros1Middleware) -> Ros1Middleware:
        """Creates the logical node that a rosbridge server serves."""
        return self.create_listener("rosbridge")

    def create_listener(self, name: str) -> Ros1Middleware:
        """Creates a node that only listens, and runs it at once."""
        listener = Ros1Middleware(name)
        self.middlewares.append(listener)
        return listener

    def recover_node(self, name: str, failed: Ros1Middleware) -> Ros1Middleware | None:
        """Creates a node again with the parameters with which it ran last; None if no others are known.

        The parameter server accepts any value and outlives the node, which would otherwise never start again.
        """
        try:
            if not failed.parameters.put_back():
                return None
        except ServiceError:
            return None
        failed.close()
        self.middlewares.remove(failed)
        return self.create_node(name)

    def locate(self, error: ConfigError, middleware: Ros1Middleware) -> ConfigError:
        """Returns the error with file and line if the file that the parameters came from has it too.

        Parameters do not record their file, so launch files pass its path as `thresholds`. It may be on another
        machine.
        """
        try:
            file = middleware.given_parameters().get("thresholds", "")
        except ConfigError:
            return error
        if isinstance(file, str) and os.path.isfile(file):
            try:
                load_config(file, middleware.name.rpartition("/")[2])
            except ConfigError as located:
                return located
        return error

    def spin(self) -> str:
        """Waits for the end; rospy runs its own threads."""
        known = {middleware.name: middleware.parameters for middleware in self.middlewares}
        for parameters in {rospy.get_name(): self._parameters, **known}.values():
            self.middlewares[0].faults.guard("parameter server", parameters.keep)
        self._interrupts.wait_until(lambda: rospy.is_shutdown() or self._watch.lost.is_set())
        if not self._watch.lost.is_set():
            return ""
        end_s = time.monotonic() + _REPORT_S
        self._interrupts.wait_until(lambda: time.monotonic() >= end_s)
        return "the ROS master was restarted; start this node again to register with it"

    def close(self) -> None:
        """Ends the ROS node."""
        if hasattr(self, "_watch"):
            self._watch.close()
        rospy.signal_shutdown(f"{self._executable} ends")
        self._close_nodes()

    def _wait_for(self, master: Master) -> None:
        if not master.is_online():
            self._interrupts.check()  # the signal may have cut off the call
            sys.stderr.write(
                f"{self._executable}: waiting for the ROS master at {master.uri} (ROS_MASTER_URI); Ctrl-C to stop\n"
            )
            self._interrupts.wait_until(master.is_online)

    def _set_log_level(self) -> None:
        """Sets the log level of the process, which is a parameter of the ROS node, also if it has several nodes."""
        self._parameters = NodeParameters(self._master, rospy.get_name())
        try:
            set_log_level(self._parameters.given())
        except ConfigError as error:
            if not self._parameters.put_back():
                raise
            set_log_level(self._parameters.read())
            self._problem = f"started with the last good ones: {error}"
            rospy.logerr(f"{PARAMETERS_FAULT}: {self._problem}")

    def _keep_log_from_master(self) -> None:
        """Caches the parameter that rospy would otherwise ask the master for at every log line."""
        value = bool(self._master.parameter(_ROSOUT_WITHOUT_TOPICS, False))
        rospy.impl.paramserver.get_param_server_cache().set(_ROSOUT_WITHOUT_TOPICS, value)

    def _report_master(self, problem: str, level: Level) -> None:
        for middleware in tuple(self.middlewares):
            middleware.faults.report("ROS master", problem, level)

    def _close_nodes(self) -> None:
        for middleware in self.middlewares:
            middleware.close()
