"""One robot that is watched over rosbridge: its connection, and the alert_system that judges what arrives."""

from __future__ import annotations

import asyncio
from typing import Callable, Mapping, Optional, Protocol

from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.core.faults import Faults
from robot_health_monitor.core.formatting import list_text, printable
from robot_health_monitor.core.local import LocalMiddleware, LogLine
from robot_health_monitor.core.middleware import NOTHING_CHANGED, Middleware, Severity
from robot_health_monitor.core.monitor import Monitor
from robot_health_monitor.core.nodes import AlertSystem
from robot_health_monitor.core.nodes.self_monitor import SelfReport
from robot_health_monitor.core.outlets import Outlet
from robot_health_monitor.rosbridge.client import Cause, RosbridgeClient
from robot_health_monitor.runtime.log_limit import LimitedLog

from .fleet_configuration import RobotSettings

__all__ = ["Robot", "StartAlertSystem"]

_RESTART_S = 5.0


class StartAlertSystem(Protocol):
    """Creates an alert_system, as the class itself does."""

    def __call__(
        self,
        middleware: Middleware,
        outlets: Mapping[str, Outlet] = ...,
        *,
        log_alerts: bool = ...,
        announce_pauses: bool = ...,
        self_report: SelfReport = ...,
    ) -> AlertSystem:
        """Starts watching."""


class Robot:
    """One robot: its connection, and the alert_system that judges what arrives.

    Nothing is published and no service is offered on the robot.
    """

    def __init__(
        self,
        settings: RobotSettings,
        *,
        outputs: LocalMiddleware,
        clock: Callable[[], float],
        on_log: Callable[[LogLine], None],
        outlet: Outlet,
        log_details: bool = False,
        start: StartAlertSystem = AlertSystem,
    ) -> None:
        """Starts the alert_system; `run` connects.

        Args:
            settings: what to watch, and where.
            outputs: node that publishes what the alert_system announces, and offers its services; closed at the end.
            clock: monotonic seconds.
            on_log: called with every log line; its node is the robot's name.
            outlet: receives the robot's transitions and notices.
            log_details: log what alert_system does at its start, a line per signal; else only warnings.
            start: creates the alert_system.

        Raises:
            ConfigError: the configuration cannot be used.
        """

        def log(line: LogLine) -> None:
            if log_details or started or line.severity > Severity.INFO:
                on_log(line._replace(node=settings.name))

        started = False
        self.name = settings.name
        self.settings = settings
        self.cause: Optional[Cause] = None
        """Why the connection is down; None while it is up and before the first attempt."""
        self.connected = False
        """Whether the connection is up."""
        self._closed = False
        self._outputs = outputs
        self._client = RosbridgeClient(
            settings.url,
            token=settings.token,
            ssl_context=settings.ssl_context,
            read_only=True,
            clock=clock,
            on_log=log,
            on_link=self._note_link,
        )
        self._log = LimitedLog(self._client.log, clock)
        self._node = self._client.node(
            "alert_system",
            namespace=settings.namespace,
            parameters=self._parameters(settings),
            use_sim_time=settings.use_sim_time,
            outputs=outputs,
        )
        self.alert_system = start(
            self._node,
            {"output": outlet},
            log_alerts=False,
            announce_pauses=False,
            self_report=SelfReport(dropped=lambda: self._node.dropped),
        )
        started = True

    @property
    def monitor(self) -> Monitor:
        """Judges the robot's signals."""
        return self.alert_system.monitor

    @property
    def faults(self) -> Faults:
        """What does not work of the monitor of this robot."""
        return self._node.faults

    @property
    def now_s(self) -> float:
        """The time of the robot's monitor, in s: simulated time under `use_sim_time`."""
        return self._node.now_s()

    @property
    def address(self) -> str:
        """The address of its server, without credentials."""
        return self._client.connection.address

    def log_summary(self) -> None:
        """Logs in one line what is watched, and where."""
        self._client.log(Severity.INFO, f"watching {list_text(tuple(self.monitor.config.signals))} at {self.address}")

    def parameters(self) -> Mapping[str, Mapping[str, object]]:
        """Returns the parameters that were given, nested, by the name of the node on `Fleet.bus`."""
        return {self._outputs.name: self._node.given_parameters()}

    async def run(self) -> None:
        """Keeps the connection up until it is cancelled. A failure is logged, and the connection restarted."""
        while not self._closed:
            try:
                await self._client.run()
            except Exception as error:  # one robot's failure must not end the others
                text = printable(f"{type(error).__name__}: {error}")
                self._client.log(Severity.ERROR, f"internal error, reconnecting in {_RESTART_S:g} s: {text}")
                self._node.call(self._note_link, False, Cause(f"internal error: {type(error).__name__}"))
                await asyncio.sleep(_RESTART_S)

    def change(self, settings: RobotSettings) -> str:
        """Applies new settings. Signals that are configured as before keep their state.

        Connects again only if the address, the token or the certificate authorities differ.

        Returns:
            What changed.

        Raises:
            ConfigError: this needs a new `Robot`; nothing was changed.
        """
        old = self.settings
        if (old.namespace, old.use_sim_time) != (settings.namespace, settings.use_sim_time):
            raise ConfigError("the topics and the clock of a robot cannot be changed while it is watched")
        texts = []
        if old.parameters != settings.parameters:
            texts.append(self._node.set_parameters(self._parameters(settings)))
        self.settings = settings
        if (old.url, old.token, old.ca) != (settings.url, settings.token, settings.ca):
            connection = self._client.connection
            connection.move(settings.url, token=settings.token, ssl_context=settings.ssl_context)
            texts.append(f"connecting again, to {self.address}")
        return "; ".join(texts) or NOTHING_CHANGED

    def end(self) -> None:
        """Ends every open alert with a transition to OK, `no longer watched`, and closes."""
        self._node.call(self.alert_system.stop_watching)
        self.close()

    def close(self) -> None:
        """Ends the alert_system and the connection; open alerts stay open."""
        self._closed = True
        self.alert_system.close()
        self._client.close()
        self._outputs.close()

    @staticmethod
    def _parameters(settings: RobotSettings) -> Mapping[str, object]:
        return {**settings.parameters, "robot_name": settings.name}

    def _note_link(self, up: bool, cause: Cause) -> None:
        if self._closed:
            return
        was_connected, self.connected = self.connected, up
        if up:
            self.cause = None
            self._log.write("connected", Severity.INFO, f"connected to {self.address}")
            # Under use_sim_time the robot's clock is unknown until its first message. Until then the link counts as
            # down: otherwise its first message would look like a jump of that many seconds without samples.
            self._node.call_with_time(self._observe_link)
        elif not (was_connected and self._node.exclusively(self.alert_system.excuse_link)):
            if self.cause is not None:  # the alert of the link shows the first cause
                self._log.write(cause.text, Severity.WARN, f"still not connected: {cause.text}")
            self.cause = cause
            self._node.call(self._observe_link)

    def _observe_link(self) -> None:
        self.alert_system.observe_link(self.cause is None, "" if self.cause is None else self.cause.text)
