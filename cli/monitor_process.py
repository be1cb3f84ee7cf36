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
from typing import Any, Awaitable, Callable, List, Optional, Sequence, Tuple

from ..core.port.local import LogLine
from ..core.port.middleware import NOTHING_CHANGED, Severity
from ..core.values.errors import ConfigError
from ..core.values.formatting import printable
from ..core.values.model import Level
from ..ops.configuration import OpsConfig, ServerOptions
from ..runtime.event_loops import run_in_daemon_thread
from ..runtime.interrupts import Interrupts
from ..runtime.libraries import missing_libraries, missing_text
from ..runtime.tokens import TokenFiles
from .exit_codes import ExitCode
from .operations import Operations, read_config
from .output.events import Events, LibraryLog
from .output.lines import JsonLines, Monitors, Output, OutputError, PlainLines, is_terminal
from .service_manager import ServiceManager
from .serving import ServerSettings, serve, stop_serving

Reload = Callable[[], Awaitable[str]]
"""Reads the configuration of a part again and applies what differs; returns what changed, in one line.

Returns `NOTHING_CHANGED` if nothing did, and an empty text if it has been logged. Raises ConfigError if the new
configuration cannot be used: the old one stays in force.
"""
ReadSettings = Callable[[Optional[ServerOptions]], Optional[ServerSettings]]
"""Returns the settings of the server for the section `server` of an ops.yaml, None if no server is wanted.

Reads the token. Raises ConfigError if a file cannot be used.
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
        serves: bool = True,
    ) -> None:
        """Opens what `ops_file` configures; raises ConfigError, and opens nothing, if it cannot be used.

        `name` is shown before warnings of the process. Log lines less severe than `least` are left out. `serves` is
        whether there is a server in any case.
        """
        self.operations = Operations(read_config(ops_file))
        history = self.operations.history
        if history.file is None and not serves and self.operations.config.server is None:
            history.keeps_samples = False  # no page could show them, and collecting them costs as much as judging
        self.events = Events(output.put, least, silence_of=self.operations.silence_text)
        """Receives what the monitors log and announce."""
        self.tokens = TokenFiles(self.warn)
        self._ops_file = ops_file
        self._name = name
        self._output = output
        self._interrupts = interrupts
        self.settings: Optional[ServerSettings] = None
        """Those of the server that are in force; None if there is none."""

    def __enter__(self) -> MonitorProcess:
        """Returns itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Closes what ops.yaml configures."""
        self.operations.close()

    def warn(self, text: str) -> None:
        """Shows a warning about the process."""
        self.events.on_log(LogLine(time.monotonic(), self._name, Severity.WARN, text))

    def run(
        self,
        monitors: Monitors,
        read_settings: ReadSettings,
        *,
        requires_server: bool,
        duration_s: Optional[float] = None,
    ) -> ExitCode:
        """Serves and shows `monitors` until an interrupt, the end of the duration or the loss of the reader.

        Closes `monitors` and the output. The output never delays the monitors: if it cannot be written, that is a
        fault and monitoring goes on. Only the end of a duration tells whether there were alerts.

        Raises ConfigError before any output if the server cannot be started as configured (with `requires_server`,
        also if its port is taken), and OutputError if the duration has passed and the output is incomplete.
        """
        library_log = LibraryLog(self.events)
        logging.getLogger().addHandler(library_log)
        logging.captureWarnings(True)
        try:
            self.settings = read_settings(self.operations.config.server)
            completed = asyncio.run(self._run(monitors, read_settings, requires_server, duration_s))
        finally:
            monitors.close()
            self._output.close()
            logging.captureWarnings(False)
            logging.getLogger().removeHandler(library_log)
        if completed and self._output.problem:
            raise OutputError(self._output.problem)
        return ExitCode.ALERTS if completed and self.events.alerts else ExitCode.SUCCESS

    async def _run(
        self, monitors: Monitors, read_settings: ReadSettings, requires_server: bool, duration_s: Optional[float]
    ) -> bool:
        """Returns whether the whole duration has passed."""
        loop = asyncio.get_running_loop()
        stop, hangup = asyncio.Event(), asyncio.Event()
        interrupts, server, service_manager = self._interrupts, None, ServiceManager()
        interrupts.on_interrupt(lambda: loop.call_soon_threadsafe(stop.set))
        try:
            if self.settings is not None:
                server = await serve(monitors, self.settings, self.operations, required=requires_server)
            self._output.start()
            running = asyncio.ensure_future(monitors.run())
            stopped: asyncio.Future[Any] = asyncio.ensure_future(stop.wait())
            parts: List[Reload] = [monitors.reload, partial(self.reload_ops, read_settings)]

            async def reload_at_hangups() -> None:
                while True:
                    await hangup.wait()
                    hangup.clear()
                    await reload_all(parts, monitors.log)

            reloading = asyncio.ensure_future(reload_at_hangups())
            interrupts.on_hangup(lambda: loop.call_soon_threadsafe(hangup.set))
            service_manager.ready()
            try:
                return await self._show(monitors, running, stopped, service_manager, duration_s)
            finally:
                service_manager.stopping()
                for task in (running, stopped, reloading):
                    task.cancel()
                await asyncio.wait({running, stopped}, timeout=_END_S)
        finally:
            if server is not None:
                await stop_serving(server)
            interrupts.on_hangup(bool)
            interrupts.on_interrupt(bool)  # does nothing: the end is under way

    async def _show(
        self,
        monitors: Monitors,
        running: asyncio.Future[Any],
        stopped: asyncio.Future[Any],
        service_manager: ServiceManager,
        duration_s: Optional[float],
    ) -> bool:
        """Shows the monitors until one of the futures is done; returns whether the whole duration has passed."""
        loop = asyncio.get_running_loop()
        end_s = float("inf") if duration_s is None else loop.time() + duration_s
        while not self._output.reader_is_gone:
            self._output.show(monitors)
            if service_manager.watchdog_period_s is not None:
                # One robot's failure must not restart the monitors of the others.
                service_manager.alive(min((system.tick_age_s for system in monitors.alert_systems), default=0.0))
            if self._output.problem:
                monitors.faults.report(_FAULT, self._output.problem, Level.WARN)
            else:
                monitors.faults.clear(_FAULT)
            if loop.time() >= end_s:
                return True
            wait_s = min(_SHOW_PERIOD_S, end_s - loop.time())
            done, _ = await asyncio.wait({running, stopped}, timeout=wait_s, return_when=asyncio.FIRST_COMPLETED)
            if running in done:
                running.result()  # raises: otherwise it would go on
            if done:
                return False
        return False

    async def reload_ops(self, read_settings: ReadSettings) -> str:
        """Reads ops.yaml and the server's token, then applies what differs; see `Reload`.

        A revoked token is refused at once, and new targets are notified.
        """

        def read() -> Tuple[OpsConfig, Optional[ServerSettings]]:
            config = read_config(self._ops_file) if self._ops_file else self.operations.config
            return config, read_settings(config.server)

        config, settings = await run_in_daemon_thread(read)
        texts = self._use_settings(settings)
        texts += await run_in_daemon_thread(partial(self.operations.use, config))
        return "; ".join(texts) or NOTHING_CHANGED

    def _use_settings(self, new: Optional[ServerSettings]) -> List[str]:
        old, server, texts = self.settings, self.operations.server, []
        if old is None or new is None or server is None:
            self.settings = new
            return [] if old == new else ["server: takes effect after a restart"]
        if new.token != old.token:
            server.use_token(new.token)
            texts.append("server: the token changed, every client has to present the new one")
        self.settings = new
        others = [name for name, value in vars(new).items() if name != "token" and value != getattr(old, name)]
        if others:
            texts.append(f"server: {', '.join(others)} takes effect after a restart")
        return texts


async def reload_all(parts: Sequence[Reload], log: Callable[[Severity, str], object]) -> None:
    """Reloads parts one after the other, and logs in one line what changed.

    A file that is broken keeps only what it configures from changing.
    """
    texts: List[str] = []
    failed = False
    for reload in parts:
        task = asyncio.ensure_future(reload())
        try:
            await asyncio.wait({task}, timeout=_RELOAD_S)
            if not task.done():
                raise ConfigError(f"a file could not be read within {_RELOAD_S:g} s")
            texts.append(task.result())
        except ConfigError as error:
            failed = True
            more = f" ({len(error.all) - 1} more: robot-health check)" if len(error.all) > 1 else ""
            log(Severity.ERROR, f"not reloaded, the old configuration stays in force: {error}{more}")
        except Exception as error:
            failed = True
            log(Severity.ERROR, printable(f"not reloaded: internal error: {type(error).__name__}: {error}"))
        finally:
            task.cancel()
    changes = [text for text in texts if text not in ("", NOTHING_CHANGED)]
    if changes:
        log(Severity.INFO, f"reloaded: {'; '.join(changes)}")
    elif NOTHING_CHANGED in texts and not failed:
        log(Severity.INFO, f"reloaded: {NOTHING_CHANGED}")


def choose_output(as_json: bool, name_robots: bool = False) -> Output:
    """Returns the output for stdout: JSON if requested, a live table on a terminal, otherwise plain lines.

    `name_robots` puts the robot's name before each transition.
    """
    if as_json:
        return JsonLines(sys.stdout, sys.stderr)
    if is_terminal(sys.stdout):
        try:
            from .output.live import LiveView

            return LiveView(sys.stdout, name_robots)
        except ModuleNotFoundError as error:
            missing = missing_text(missing_libraries(error, "rich"))
            sys.stderr.write(f"{missing} (plain lines instead of the live table)\n")
    return PlainLines(sys.stdout, name_robots)
