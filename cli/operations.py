"""What an ops.yaml adds to a process: a history, silences, notifications and a black box for its alert_systems.

Whoever starts an alert_system starts it with `Operations.start`, with or without an ops.yaml.
"""

from __future__ import annotations

import threading
import time
from contextlib import ExitStack
from functools import partial
from sqlite3 import Connection
from typing import TYPE_CHECKING, Any, Callable, Mapping, NamedTuple

from ..core.config import read_yaml
from ..core.nodes import AlertSystem
from ..core.nodes.alert_system import TICK_PERIOD_S
from ..core.nodes.node import host_name
from ..core.nodes.outlets import Outlet
from ..core.nodes.self_monitor import EMPTY_REPORT, SelfReport
from ..core.port import Middleware, Severity
from ..core.values import Clock, Faults, ServiceError
from ..ops.configuration import SECTIONS, OpsConfig, read_ops
from ..ops.notify.notifier import Notifier
from ..ops.store.active_silences import Silences
from ..ops.store.history import History, RobotHistory

if TYPE_CHECKING:
    from ..ops.black_box.black_box import BlackBox
    from ..ops.black_box.robot_black_box import RobotBlackBox
    from ..rosbridge.server import Server

_CLOSE_S = 1.9
"""Longest time to close everything: a disk or a target may hang."""
_LATE_S = 5.0
"""Age of the last tick from which a robot is not monitored, in s: then there is no heartbeat."""


class _Robot(NamedTuple):
    """What runs for one robot."""

    alert_system: AlertSystem
    history: RobotHistory
    black_box: RobotBlackBox | None


class Operations:
    """History, silences and notifications of one process. What fails is a fault; the monitoring goes on."""

    def __init__(
        self,
        config: OpsConfig,
        wall_time_s: Clock = time.time,
        clock: Clock = time.monotonic,
    ) -> None:
        """Opens what is configured; `close` ends it. `wall_time_s` gives s since 1970, `clock` monotonic s."""
        self._clock = clock
        self.config = config
        self.faults = Faults()
        """Faults of its parts. Add the faults of the node that shows them."""
        self.history = History(config.history, wall_time_s, self.faults)
        """In memory if no file is configured."""
        self.silences = Silences(self.history)
        self.notifier = self._create_notifier()
        self.black_box: BlackBox | None = None
        """None if none is configured."""
        self.server: Server | None = None
        """The server of the process, whose clients its status shows; None before it has started."""
        self.on_start: list[Callable[[AlertSystem], object]] = []
        """Called with each alert_system that is started."""
        self._robots: dict[str, _Robot] = {}
        self._fed_s = float("-inf")
        if config.black_box is not None:
            from ..ops.black_box.black_box import PART, BlackBox

            try:
                self.black_box = BlackBox(config.black_box, self.faults, wall_time_s)
            except ServiceError as error:  # without its library
                self.faults.report(PART, f"nothing is recorded: {error}")

    def use(self, config: OpsConfig) -> list[str]:
        """Applies the targets of another configuration; returns what changed, and what needs a restart.

        What waits for a target that stays is sent there. Takes up to a second.
        """
        sections = [name for name in SECTIONS if getattr(config, name) != getattr(self.config, name)]
        self.config = config
        if "notify" in sections:
            self.notifier.close()
            self.history.put(self._replace_notifier)
        ends = {"notify": "other targets"}
        return [f"{name}: {ends.get(name, 'takes effect after a restart')}" for name in sections]

    def start(
        self,
        middleware: Middleware,
        outlets: Mapping[str, Outlet] | None = None,
        *,
        self_report: SelfReport = EMPTY_REPORT,
        **options: Any,
    ) -> AlertSystem:
        """Starts the alert_system of a robot, with its part of the history; arguments and errors: `AlertSystem`."""
        name = robot_name(middleware)
        self.end_robot(name)  # a robot that is started anew
        with ExitStack() as undo:  # if the robot's configuration cannot be used
            history = self.history.of_robot(name)
            undo.callback(history.close)
            black_box = self._start_black_box(middleware, name)
            if black_box is not None:
                undo.callback(black_box.close)
            alert_system = AlertSystem(
                middleware,
                outlets or {},
                history=history,
                silence_of=partial(self.silence_text, name),
                black_box_of=(lambda transition: "") if black_box is None else black_box.of_alert,
                self_report={
                    **self_report,
                    "pending_notifications": lambda: self.notifier.waiting,
                    "black_box_s": lambda: None if black_box is None else black_box.reach_s,
                },
                **options,
            )
            undo.pop_all()
        alert_system.on_tick.append(lambda now_s: self.silences.note_causes(name, alert_system.monitor.causes()))
        if black_box is not None:
            middleware.exclusively(partial(black_box.attach, alert_system))
        self._robots[name] = _Robot(alert_system, history, black_box)
        middleware.create_timer(TICK_PERIOD_S, self._note_tick, steady=True)
        for callback in self.on_start:
            self.faults.guard("server", callback, alert_system)
        return alert_system

    def start_only(
        self, middleware: Middleware, outlets: Mapping[str, Outlet] | None = None, **options: Any
    ) -> AlertSystem:
        """Starts the only alert_system of the process, as `start`; it shows the faults, and logs what is in use."""
        alert_system = self.start(middleware, outlets, self_report=self.self_report(), **options)
        self.show_faults(middleware)
        return alert_system

    def show_faults(self, node: Middleware) -> None:
        """Shows the faults of all parts by a node from now on, and logs what is in use. All robots have started."""
        self.faults.add(node.faults)
        if self.config.summary:
            node.log(Severity.INFO, f"operations: {self.config.summary}")
        if self.history.file is None:
            text = "the history is in memory: it ends with this process (an ops.yaml keeps it in a file)"
            node.log(Severity.INFO, text)
        self.note_robots()

    def note_robots(self) -> None:
        """Call when all robots have been started: notifications of open alerts of any other robot are ended."""
        self.notifier.end_unwatched(list(self._robots))

    def end_robot(self, name: str) -> None:
        """Ends the part of a robot that is no longer watched; does nothing for one that is not known."""
        robot = self._robots.pop(name, None)
        if robot is not None:
            if robot.black_box is not None:
                robot.black_box.close()
            robot.history.close()

    def self_report(self) -> SelfReport:
        """Returns what the status of a process shows of its operations and its server."""
        return {
            "clients": lambda: 0 if self.server is None else self.server.clients,
            "pending_notifications": lambda: self.notifier.waiting,
            "silenced": self.count_silenced,
            "clients_dropped": lambda: None if self.server is None else self.server.dropped,
            "black_box_dropped": lambda: None if self.black_box is None else self.black_box.ring.dropped,
        }

    def silence_text(self, robot: str, signal: str) -> str | None:
        """Returns reason and end of an alert's silence, None if it is not silenced. May be called in any thread."""
        silence = self.silences.silence_of(robot, signal)
        return None if silence is None else silence.text

    def is_simulated(self, robot: str, signal: str) -> bool:
        """Returns whether the values of a robot's signal are simulated. May be called in any thread."""
        known = self._robots.get(robot)
        return known is not None and known.alert_system.watched.is_simulated(signal)

    def count_silenced(self) -> int:
        """Returns how many signals are not OK and silenced, over all robots."""
        return sum(robot.alert_system.announcements.count_silenced() for robot in self._robots.values())

    def close(self) -> None:
        """Closes everything within two seconds. The alert_systems must have been closed."""
        closing = threading.Thread(target=self._close, name="close operations", daemon=True)
        closing.start()
        closing.join(_CLOSE_S)

    def _create_notifier(self) -> Notifier:
        server = self.config.server
        public_url = "" if server is None else server.public_url
        return Notifier(self.history, self.config.notify, self.silences, self.is_simulated, public_url)

    def _replace_notifier(self, connection: Connection) -> None:
        """Runs in the thread of the history, between two transitions: each is queued once."""
        self.notifier.detach()
        for part in self.faults.current():
            if part.startswith("notify "):
                self.faults.clear(part)
        self.notifier = self._create_notifier()
        self.note_robots()

    def _note_tick(self, now_s: float) -> None:
        """Feeds the heartbeat while every robot is monitored; each robot calls this once a second."""
        steady_s = self._clock()
        if steady_s - self._fed_s >= TICK_PERIOD_S / 2.0:
            self._fed_s = steady_s
            if all(robot.alert_system.tick_age_s < _LATE_S for robot in tuple(self._robots.values())):
                self.notifier.note_tick()

    def _start_black_box(self, middleware: Middleware, robot: str) -> RobotBlackBox | None:
        if self.black_box is None:
            return None
        from ..ops.black_box.robot_black_box import RobotBlackBox
        from ..ops.store.queries import transitions

        try:
            alerts = self.history.run(lambda connection: [*transitions(connection, robot=robot, open_only=True)])
            files = {each.signal: each.black_box for each in alerts if each.black_box and each.robot == robot}
        except ServiceError:  # the history reports it
            files = {}
        return RobotBlackBox(self.black_box, middleware, robot, files)

    def _close(self) -> None:
        black_boxes = [robot.black_box for robot in tuple(self._robots.values())]
        for part in (*black_boxes, self.notifier, self.history, self.black_box):
            if part is not None:
                part.close()


def read_config(file: str) -> OpsConfig:
    """Reads an ops.yaml; an empty path is an empty one. Raises ConfigError if it cannot be used."""
    return read_ops(read_yaml(file)) if file else OpsConfig()


def configured_ops(parameters: Mapping[str, object]) -> str:
    """Returns the path of the ops.yaml in the parameters of alert_system; empty if there is none."""
    file = parameters.get("ops", "")
    return file.strip() if isinstance(file, str) else ""  # alert_system reports a value of another type


def robot_name(middleware: Middleware) -> str:
    """Returns the name of the robot that a node's parameters give it, as `AlertSystem` does."""
    return str(middleware.given_parameters().get("robot_name") or host_name())
