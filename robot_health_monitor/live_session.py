"""Runs monitors and shows them until an interrupt, the end of a duration, or the loss of the reader."""

from __future__ import annotations

import asyncio
import logging
import sys
from contextlib import asynccontextmanager
from typing import Any, AsyncContextManager, AsyncIterator, Awaitable, Optional, Protocol

from robot_health_monitor.core.faults import Faults
from robot_health_monitor.core.model import Level
from robot_health_monitor.runtime.interrupts import Interrupts
from robot_health_monitor.runtime.libraries import missing_libraries, missing_text

from .operations import Operations
from .output.events import Events, LibraryLog
from .output.lines import JsonLines, Output, OutputError, PlainLines, Shown, is_terminal
from .reloading import OpsReload, ReadSettings, Reloads
from .service_manager import ServiceManager
from .serving import Served, ServerSettings, serve, stop_serving

_SHOW_PERIOD_S = 0.1
_END_S = 1.5
"""Longest wait for the work to end."""
_FAULT = "output"


class Monitors(Shown, Served, Protocol):
    """Monitors of one process that can be shown and served: an embedded monitor or a fleet."""

    async def run(self) -> None:
        """Runs the monitors until it is cancelled."""

    def close(self) -> None:
        """Ends the monitors."""


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


@asynccontextmanager
async def served(
    monitors: Monitors,
    settings: Optional[ServerSettings],
    operations: Operations,
    reloads: Reloads,
    ops_file: str,
    read_settings: ReadSettings,
    *,
    required: bool,
) -> AsyncIterator[Awaitable[None]]:
    """Serves monitors, as `serve`, and adds the reload of ops.yaml; gives what runs the monitors."""
    server = None if settings is None else await serve(monitors, settings, operations, required=required)
    reloads.add(OpsReload(ops_file, operations, server, settings, read_settings).reload)
    try:
        yield monitors.run()
    finally:
        if server is not None:
            await stop_serving(server)


def run_session(
    monitors: Monitors,
    work: AsyncContextManager[Awaitable[Any]],
    events: Events,
    output: Output,
    interrupts: Interrupts,
    reloads: Reloads,
    duration_s: Optional[float] = None,
) -> bool:
    """Runs `work` and shows `monitors`; returns whether the duration has passed and there were alerts.

    Closes `monitors` and `output` at the end. The output never delays the monitors. If it cannot be written, that is a
    fault and monitoring continues; if its reader is gone (`| head`, a terminal that was closed), the session ends.

    `work` opens what is needed, such as a port, and gives what to run until it is cancelled. Output starts once it is
    entered, so that an error there, which is raised, stands alone. Without `duration_s`, only an interrupt ends the
    session. OutputError: the duration has passed, and the output is incomplete.
    """
    library_log = LibraryLog(events)
    logging.getLogger().addHandler(library_log)
    logging.captureWarnings(True)
    try:
        completed = asyncio.run(_run(monitors, work, output, interrupts, reloads, duration_s))
    finally:
        monitors.close()
        output.close()
        logging.captureWarnings(False)
        logging.getLogger().removeHandler(library_log)
    if completed and output.problem:
        raise OutputError(output.problem)
    return completed and events.alerts > 0


async def _run(
    monitors: Monitors,
    work: AsyncContextManager[Awaitable[Any]],
    output: Output,
    interrupts: Interrupts,
    reloads: Reloads,
    duration_s: Optional[float],
) -> bool:
    """Returns whether the whole duration has passed."""
    loop = asyncio.get_running_loop()
    stop = asyncio.Event()
    service_manager = ServiceManager()
    interrupts.on_interrupt(lambda: loop.call_soon_threadsafe(stop.set))
    try:
        async with work as monitoring:
            output.start()
            running = asyncio.ensure_future(monitoring)
            reloading = asyncio.ensure_future(reloads.run())
            # `request` comes after the start of `reloading`.
            interrupts.on_hangup(lambda: loop.call_soon_threadsafe(reloads.request))
            stopped: asyncio.Future[Any] = asyncio.ensure_future(stop.wait())
            service_manager.ready()
            try:
                return await _show(monitors, output, running, stopped, service_manager, duration_s)
            finally:
                service_manager.stopping()
                running.cancel()
                stopped.cancel()
                reloading.cancel()
                await asyncio.wait({running, stopped}, timeout=_END_S)
    finally:
        interrupts.on_hangup(bool)
        interrupts.on_interrupt(bool)  # does nothing: the end is under way


async def _show(
    monitors: Monitors,
    output: Output,
    running: asyncio.Future[Any],
    stopped: asyncio.Future[Any],
    service_manager: ServiceManager,
    duration_s: Optional[float],
) -> bool:
    """Shows the monitors until one of the futures is done; returns whether the whole duration has passed."""
    loop = asyncio.get_running_loop()
    end_s = float("inf") if duration_s is None else loop.time() + duration_s
    while not output.reader_is_gone:
        output.show(monitors)
        if service_manager.watchdog_period_s is not None:
            # One robot's failure must not restart the monitors of the others.
            service_manager.alive(min((system.tick_age_s for system in monitors.alert_systems), default=0.0))
        _report_problem(output.problem, monitors.faults)
        if loop.time() >= end_s:
            return True
        wait_s = min(_SHOW_PERIOD_S, end_s - loop.time())
        done, _ = await asyncio.wait({running, stopped}, timeout=wait_s, return_when=asyncio.FIRST_COMPLETED)
        if running in done:
            running.result()  # raises: otherwise it would go on
        if done:
            return False
    return False


def _report_problem(problem: str, faults: Faults) -> None:
    known = faults.current().get(_FAULT)
    if problem and (known is None or known.text != problem):
        faults.report(_FAULT, problem, Level.WARN)
    elif known is not None and not problem:
        faults.clear(_FAULT)
