"""A process that monitors robots without ROS: it owns what runs, and starts, reloads and ends it in one order.

======  ======================================================================================
start   what ops.yaml configures, the monitors, the server, the output
reload  the monitors, then ops.yaml with the server's token: each by itself, each all or nothing
end     the server, the monitors, the output, what ops.yaml configures
======  ======================================================================================
"""

from __future__ import annotations

import asyncio
import logging
import sys
import time
from functools import partial
from typing import Awaitable, Callable, Sequence

from ..core.port import NOTHING_CHANGED, LogLine, Severity
from ..core.values import ConfigError, Level, printable
from ..ops.configuration import OpsConfig, ServerOptions
from ..runtime.event_loops import run_in_daemon_thread
from ..runtime.interrupts import Interrupts
from ..runtime.libraries import missing_libraries, missing_text
from ..runtime.tokens import TokenFiles
from .exit_codes import ExitCode
from .operations import Operations, read_config
from .output.events import Events
from .output.lines import JsonLines, Monitors, Output, OutputError, is_terminal
from .service_manager import ServiceManager
from .serving import ServerSettings, serve, server_settings, stop_serving

Reload = Callable[[], Awaitable[str]]
"""Reads the configuration of a part again and applies what differs; returns what changed, in one line.

Returns `NOTHING_CHANGED` if nothing did. Raises ConfigError if the new configuration cannot be used: the old one stays
in force.
"""

_SHOW_PERIOD_S = 0.1
_END_S = 1.5
"""Longest wait for the work to end."""
_RELOAD_S = 15.0
"""Longest time to reload one part: a file may be on a server that does not answer, or a pipe without a writer."""
_FAULT = "output"


class MonitorProcess:
    """Opens what an ops.yaml configures, then runs and shows monitors; use it as a context."""

    def __init__(
        self,
        output: Output,
        interrupts: Interrupts,
        *,
        ops_file: str,
        name: str,
        least: Severity = Severity.INFO,
        server: ServerOptions,
        origins: Sequence[str] = (),
        serves: bool = True,
    ) -> None:
        """Opens what `ops_file` configures; raises ConfigError, and opens nothing, if it cannot be used.

        `name` is shown before warnings of the process. Log lines less severe than `least` are left out. `server` is
        what the command line says of the server, `origins` are those that may connect; `serves` is whether there is one
        in any case.
        """
        self.operations = Operations(read_config(ops_file))
        history = self.operations.history
        if history.file is None and not serves and self.operations.config.server is None:
            history.keeps_samples = False  # no page could show them, and collecting them costs as much as judging
        self.events = Events(output.put, least, silence_of=self.operations.silence_text)
        """Receives what the monitors log and announce."""
        self.tokens = TokenFiles(self.warn)
        """Finds the tokens of the server and of the robots."""
        self._arguments, self._origins, self._serves = server, origins, serves
        self._ops_file = ops_file
        self._name = name
        self._output = output
        self._interrupts = interrupts
        self._token = ""
        """That of the server."""

    def __enter__(self) -> MonitorProcess:
        """Returns itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Closes what ops.yaml configures."""
        self.operations.close()

    def warn(self, text: str) -> None:
        """Shows a warning about the process."""
        self.events.on_log(LogLine(time.monotonic(), self._name, Severity.WARN, text))

    def read_settings(self, monitors: Monitors, section: ServerOptions | None) -> ServerSettings | None:
        """Returns the settings of the server for the section `server` of an ops.yaml, None if no server is wanted.

        Reads the token. Raises ConfigError if a file cannot be used.
        """
        if not self._serves and section is None:
            return None
        return server_settings(monitors.server_config, section, self._arguments, self._origins, tokens=self.tokens)

    def run(self, monitors: Monitors, duration_s: float | None = None) -> ExitCode:
        """Serves and shows `monitors` until an interrupt, the end of the duration or the loss of the reader.

        Closes `monitors` and the output. The output never delays the monitors: if it cannot be written, that is a
        fault and monitoring goes on. Only the end of a duration tells whether there were alerts.

        Raises ConfigError before any output if the server cannot be started as configured (also if its port is taken,
        where the command line names it), and OutputError if the duration has passed and the output is incomplete.
        """
        logging.getLogger().addHandler(self.events)
        logging.captureWarnings(True)
        try:
            settings = self.read_settings(monitors, self.operations.config.server)
            completed = asyncio.run(self._run(monitors, settings, duration_s))
        finally:
            monitors.close()
            self._output.close()
            logging.captureWarnings(False)
            logging.getLogger().removeHandler(self.events)
        if completed and self._output.problem:
            raise OutputError(self._output.problem)
        return ExitCode.ALERTS if completed and self.events.alerts else ExitCode.SUCCESS

    async def _run(self, monitors: Monitors, settings: ServerSettings | None, duration_s: float | None) -> bool:
        """Returns whether the whole duration has passed."""
        loop = asyncio.get_running_loop()
        interrupts, output, server, service_manager = self._interrupts, self._output, None, ServiceManager()
        interrupts.defer()
        try:
            if settings is not None:
                self._token = settings.token
                required = self._arguments.port is not None
                server = await serve(monitors, settings, self.operations, required=required)
            output.start()
            running = asyncio.ensure_future(monitors.run())
            reloading: asyncio.Future[None] = asyncio.ensure_future(asyncio.sleep(0.0))
            service_manager.watch(monitors.node, partial(_tick_age_s, monitors))
            service_manager.ready()
            end_s = float("inf") if duration_s is None else loop.time() + duration_s
            try:
                while not (interrupts.came or output.reader_is_gone):
                    self._show(monitors)
                    if loop.time() >= end_s:
                        return True
                    if interrupts.hung_up and reloading.done():
                        interrupts.hung_up = False
                        parts: list[Reload] = [monitors.reload, partial(self.reload_ops, monitors)]
                        reloading = asyncio.ensure_future(reload_all(parts, monitors.node.log))
                    await asyncio.wait({running}, timeout=min(_SHOW_PERIOD_S, end_s - loop.time()))
                    if running.done():
                        running.result()  # raises: otherwise it would go on
                        return False
                return False
            finally:
                service_manager.stopping()
                reloading.cancel()
                running.cancel()
                await asyncio.wait({running}, timeout=_END_S)
        finally:
            if server is not None:
                await stop_serving(server)

    def _show(self, monitors: Monitors) -> None:
        self._output.show(monitors)
        monitors.node.faults.report(_FAULT, self._output.problem, Level.WARN)

    async def reload_ops(self, monitors: Monitors) -> str:
        """Reads ops.yaml and the server's token, then applies what differs; see `Reload`.

        A revoked token is refused at once.
        """

        def read() -> tuple[OpsConfig, ServerSettings | None]:
            config = read_config(self._ops_file) if self._ops_file else self.operations.config
            return config, self.read_settings(monitors, config.server)

        config, settings = await run_in_daemon_thread(read)
        texts, server = [], self.operations.server
        if server is not None and settings is not None and settings.token != self._token:
            server.use_token(settings.token)
            self._token = settings.token
            texts.append("server: the token changed, every client has to present the new one")
        texts += self.operations.use(config)
        return "; ".join(texts) or NOTHING_CHANGED


def _tick_age_s(monitors: Monitors) -> float:
    """Returns the least of all robots, in s: one robot's failure must not restart the monitors of the others."""
    return min((system.tick_age_s for system in monitors.alert_systems), default=0.0)


async def reload_all(parts: Sequence[Reload], log: Callable[[Severity, str], object]) -> None:
    """Reloads parts one after the other, and logs in one line what changed.

    A file that is broken keeps only what it configures from changing.
    """
    texts: list[str] = []
    failed = False
    for reload in parts:
        kept = ", the old configuration stays in force"
        problem = f"{kept}: a file could not be read within {_RELOAD_S:g} s"
        try:
            texts.append(await asyncio.wait_for(reload(), _RELOAD_S))
            continue
        except asyncio.TimeoutError:
            pass
        except ConfigError as error:
            more = f" ({len(error.all) - 1} more: robot-health check)" if len(error.all) > 1 else ""
            problem = f"{kept}: {error}{more}"
        except Exception as error:
            problem = f": internal error: {type(error).__name__}: {error}"
        failed = True
        log(Severity.ERROR, printable(f"not reloaded{problem}"))
    changes = [text for text in texts if text != NOTHING_CHANGED]
    if changes or not failed:
        log(Severity.INFO, f"reloaded: {'; '.join(changes) or NOTHING_CHANGED}")


def choose_output(as_json: bool, name_robots: bool = False) -> Output:
    """Returns the output for stdout: JSON if requested, a live table on a terminal, otherwise plain lines.

    `name_robots` puts the robot's name before each transition.
    """
    if as_json:
        return JsonLines()
    if is_terminal(sys.stdout):
        try:
            from .output.live import LiveView

            return LiveView(name_robots)
        except ModuleNotFoundError as error:
            missing = missing_text(missing_libraries(error, "rich"))
            sys.stderr.write(f"{missing} (plain lines instead of the live table)\n")
    return Output(name_robots)
