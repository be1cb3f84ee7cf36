"""What an ops.yaml adds to a process: a history, silences and notifications for its alert_systems.

`run`, `connect` and the ROS executables start their alert_systems with `Operations.start`, with or without an
ops.yaml.
"""

from __future__ import annotations

import threading
import time
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Callable, Dict, List, Mapping, Optional

from robot_health_monitor.core.errors import ConfigError, ServiceError
from robot_health_monitor.core.faults import Faults
from robot_health_monitor.core.middleware import Middleware, Severity
from robot_health_monitor.core.model import Transition
from robot_health_monitor.core.nodes import AlertSystem
from robot_health_monitor.core.nodes.alert_system import TICK_PERIOD_S
from robot_health_monitor.core.nodes.node import host_name
from robot_health_monitor.core.nodes.self_monitor import EMPTY_REPORT, SelfReport
from robot_health_monitor.core.outlets import Outlet
from robot_health_monitor.core.yaml_file import read_yaml
from robot_health_monitor.ops.configuration import OpsConfig, read_ops

if TYPE_CHECKING:
    from robot_health_monitor.ops.active_silences import Silences
    from robot_health_monitor.ops.black_box.black_box import BlackBox
    from robot_health_monitor.ops.black_box.robot_black_box import RobotBlackBox
    from robot_health_monitor.ops.history.history import History, RobotHistory
    from robot_health_monitor.ops.notifications import Notifier
    from robot_health_monitor.rosbridge.server import Server

_CLOSE_S = 1.9
"""Longest time to close everything: a disk or a target may hang."""
_LATE_S = 5.0
"""Age of the last tick from which a robot is not monitored, in s: then there is no heartbeat."""


class Operations:
    """History, silences and notifications of one process. What fails is a fault; the monitoring goes on."""

    def __init__(
        self,
        config: OpsConfig,
        wall_time_s: Callable[[], float] = time.time,
        clock: Callable[[], float] = time.monotonic,
        always_history: bool = False,
    ) -> None:
        """Opens what is configured; `close` ends it. `wall_time_s` gives s since 1970, `clock` monotonic s.

        `always_history` keeps one in memory if no file is configured, for the web page.
        """
        self._clock = clock
        self.config = config
        self.faults = Faults()
        """Faults of its parts. Add the faults of the node that shows them."""
        self.history: Optional[History] = None
        """None: neither a history nor notifications are configured, nor is one always kept."""
        self.silences: Optional[Silences] = None
        """None: as `history`."""
        self.notifier: Optional[Notifier] = None
        """None: as `history`."""
        self.black_box: Optional[BlackBox] = None
        """None: not configured."""
        self._wall_time_s = wall_time_s
        self._black_boxes: Dict[str, RobotBlackBox] = {}
        self._alert_systems: Dict[str, AlertSystem] = {}
        self._histories: Dict[str, RobotHistory] = {}
        self._fed_s = float("-inf")
        self._server: Optional[Server] = None
        if config.history is not None or config.notify or config.black_box is not None or always_history:
            from robot_health_monitor.ops.active_silences import Silences
            from robot_health_monitor.ops.history.history import History
            from robot_health_monitor.ops.notifications import Notifier

            # Without a file, the history is in memory.
            self.history = History(config.history, wall_time_s, self.faults)
            self.silences = Silences(self.history, self.faults, wall_time_s)
            self.notifier = Notifier(
                self.history, config.notify, self.silences, self.faults, wall_time_s, self.is_simulated
            )

        if config.black_box is not None:
            from robot_health_monitor.ops.black_box.black_box import BlackBox

            self.black_box = BlackBox(config.black_box, self.faults, wall_time_s)

    def use(self, config: OpsConfig) -> List[str]:
        """Applies the targets of another configuration and returns what changed; the rest needs a restart.

        May take some seconds. Raises ConfigError if the targets cannot be replaced now.
        """
        texts = []
        if config.notify != self.config.notify and self.notifier is not None:
            try:
                texts.append(f"notify: {self.notifier.use_targets(config.notify)}")
            except ServiceError as error:
                raise ConfigError(f"notify: {error}") from None
        elif config.notify != self.config.notify:
            texts.append("notify: takes effect after a restart")
        if config.history != self.config.history:
            texts.append("history: takes effect after a restart")
        if config.black_box != self.config.black_box:
            texts.append("black_box: takes effect after a restart")
        self.config = config
        return texts

    def start(
        self,
        middleware: Middleware,
        outlets: Optional[Mapping[str, Outlet]] = None,
        *,
        log_alerts: bool = True,
        announce_pauses: bool = True,
        self_report: SelfReport = EMPTY_REPORT,
    ) -> AlertSystem:
        """Starts the alert_system of a robot, with its part of the history; arguments and errors: `AlertSystem`."""
        robot = robot_name(middleware)
        self.end_robot(robot)  # a robot that is started anew
        history = None if self.history is None else self.history.of_robot(robot)
        black_box = self._start_black_box(middleware, robot)
        try:
            alert_system = AlertSystem(
                middleware,
                outlets or {},
                log_alerts=log_alerts,
                history=history,
                announce_pauses=announce_pauses,
                silence_of=partial(self.silence_text, robot),
                black_box_of=_no_black_box if black_box is None else black_box.of_alert,
                self_report=replace(
                    self_report,
                    pending_notifications=self._count_pending,
                    black_box_s=lambda: None if black_box is None else black_box.reach_s,
                ),
            )
        except BaseException:
            if history is not None:
                history.close()
            if black_box is not None:
                black_box.close()
            raise
        if black_box is not None:
            self._black_boxes[robot] = black_box
            middleware.exclusively(partial(black_box.attach, alert_system))
        if history is not None:
            self._histories[robot] = history
        self._alert_systems[robot] = alert_system
        if self.notifier is not None:
            middleware.create_timer(TICK_PERIOD_S, self._note_tick, steady=True)
        return alert_system

    def start_only(
        self, middleware: Middleware, outlets: Optional[Mapping[str, Outlet]] = None, *, log_alerts: bool = True
    ) -> AlertSystem:
        """Starts the only alert_system of the process, as `start`; it shows the faults, and logs what is in use."""
        alert_system = self.start(middleware, outlets, log_alerts=log_alerts, self_report=self.self_report())
        self.faults.add(middleware.faults)
        self.log_summary(middleware.log)
        self.note_robots()
        return alert_system

    def note_robots(self) -> None:
        """Call when all robots have been started: notifications of open alerts of any other robot are ended."""
        if self.notifier is not None:
            self.notifier.end_unwatched(list(self._alert_systems))

    def end_robot(self, robot: str) -> None:
        """Ends the part of a robot that is no longer watched; does nothing for one that is not known."""
        self._alert_systems.pop(robot, None)
        black_box = self._black_boxes.pop(robot, None)
        if black_box is not None:
            black_box.close()
        history = self._histories.pop(robot, None)
        if history is not None:
            history.close()

    def note_server(self, server: Server) -> None:
        """Call when the server has started: the status of the process shows its clients."""
        self._server = server

    def self_report(self) -> SelfReport:
        """Returns what the status of a process shows of its operations and its server."""
        return SelfReport(
            clients=lambda: 0 if self._server is None else self._server.clients,
            pending_notifications=self._count_pending,
            silenced=self.count_silenced,
            clients_dropped=lambda: None if self._server is None else self._server.dropped,
            black_box_dropped=lambda: None if self.black_box is None else self.black_box.ring.dropped,
        )

    def silence_text(self, robot: str, signal: str) -> Optional[str]:
        """Returns reason and end of the silence of an alert; None: it is not silenced. May be called in any thread."""
        silence = None if self.silences is None else self.silences.silence_of(robot, signal)
        return None if silence is None else silence.text

    def is_simulated(self, robot: str, signal: str) -> bool:
        """Returns whether the values of a robot's signal are simulated. May be called in any thread."""
        alert_system = self._alert_systems.get(robot)
        return alert_system is not None and alert_system.is_simulated(signal)

    def count_silenced(self) -> int:
        """Returns how many signals are not OK and silenced, over all robots."""
        return sum(alert_system.count_silenced() for alert_system in self._alert_systems.values())

    def log_summary(self, log: Callable[[Severity, str], object]) -> None:
        """Logs in one line what is in use."""
        if self.config.summary:
            log(Severity.INFO, f"operations: {self.config.summary}")
        if self.history is not None and self.history.file is None:
            log(Severity.INFO, "the history is in memory: it ends with this process (an ops.yaml keeps it in a file)")

    def __enter__(self) -> Operations:
        """Returns itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Closes everything, as `close`."""
        self.close()

    def close(self) -> None:
        """Closes everything within two seconds. The alert_systems must have been closed."""
        if self.history is None:
            return
        closing = threading.Thread(target=self._close, name="close operations", daemon=True)
        closing.start()
        closing.join(_CLOSE_S)

    def _count_pending(self) -> int:
        return 0 if self.notifier is None else self.notifier.waiting

    def _note_tick(self, now_s: float) -> None:
        """Feeds the heartbeat while every robot is monitored; each robot calls this once a second."""
        steady_s = self._clock()
        if self.notifier is not None and steady_s - self._fed_s >= TICK_PERIOD_S / 2.0:
            self._fed_s = steady_s
            if all(alert_system.tick_age_s < _LATE_S for alert_system in tuple(self._alert_systems.values())):
                self.notifier.note_tick()

    def _start_black_box(self, middleware: Middleware, robot: str) -> Optional[RobotBlackBox]:
        if self.black_box is None or self.history is None:
            return None
        from robot_health_monitor.ops.black_box.robot_black_box import RobotBlackBox
        from robot_health_monitor.ops.history.queries import black_boxes_of_open_alerts

        try:
            files = self.history.run(lambda connection: black_boxes_of_open_alerts(connection, robot))
        except ServiceError:  # the history reports it
            files = {}
        return RobotBlackBox(self.black_box, middleware, robot, files)

    def _close(self) -> None:
        for black_box in tuple(self._black_boxes.values()):
            black_box.close()
        for part in (self.notifier, self.silences, self.history, self.black_box):
            if part is not None:
                part.close()


def open_operations(
    file: str, wall_time_s: Callable[[], float] = time.time, *, always_history: bool = False
) -> Operations:
    """Opens what an ops.yaml configures, as `Operations`; empty `file`: none. ConfigError: nothing has been opened."""
    config = read_ops(read_yaml(file)) if file else OpsConfig()
    return Operations(config, wall_time_s, always_history=always_history)


def _no_black_box(transition: Transition) -> str:
    return ""


def configured_ops(parameters: Mapping[str, object]) -> str:
    """Returns the path of the ops.yaml in the parameters of alert_system; empty: none."""
    file = parameters.get("ops", "")
    return file.strip() if isinstance(file, str) else ""  # alert_system reports a value of another type


def robot_name(middleware: Middleware) -> str:
    """Returns the name of the robot that a node's parameters give it, as `AlertSystem` does."""
    return str(middleware.given_parameters().get("robot_name") or host_name())
