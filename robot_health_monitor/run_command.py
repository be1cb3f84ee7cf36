"""`robot-health run`: the monitor in this process, shown on a terminal, in a pipe or to a program."""

from __future__ import annotations

import argparse
import asyncio
from typing import TYPE_CHECKING

from robot_health_monitor.core.middleware import Severity
from robot_health_monitor.core.yaml_file import read_yaml

from .embedded import EmbeddedMonitor, clock, run_timers
from .installed_files import find_installed
from .output.choice import choose_output
from .output.lines import Events
from .serving import start_server

if TYPE_CHECKING:
    from .__main__ import Interrupts


def run(arguments: argparse.Namespace, interrupts: Interrupts) -> bool:
    """Runs the monitor until an interrupt, or for `--duration`.

    Returns:
        Whether it ran to the end of its duration and found alerts.

    Raises:
        ConfigError: the configuration cannot be used, or the port that was asked for.
        BrokenPipeError: nobody reads the output any more.
    """
    file = arguments.thresholds or find_installed("config/thresholds.yaml")
    events = Events(Severity[arguments.log_level])
    now_s = clock()
    monitor = EmbeddedMonitor(
        read_yaml(file) if file else None,
        robot=arguments.robot,
        source=arguments.source,
        start_s=now_s(),
        on_log=events.on_log,
        on_transition=events.on_transition,
    )
    output = choose_output(arguments.json)

    async def run_until_stopped() -> bool:
        """Returns whether it came to its end without an interrupt."""
        loop = asyncio.get_running_loop()
        stop = asyncio.Event()
        interrupts.on_interrupt = lambda: loop.call_soon_threadsafe(stop.set)
        output.attach(loop, monitor)
        server = await start_server(monitor, arguments)
        try:
            timers = asyncio.ensure_future(
                run_timers(monitor.bus, now_s, stop, lambda: output.show(events.take(), monitor))
            )
            interrupted, _ = await asyncio.wait({timers}, timeout=arguments.duration)
            stop.set()
            await timers
            return not interrupted
        finally:
            interrupts.on_interrupt = bool  # does nothing: the end is under way
            if server is not None:
                await server.close()

    try:
        to_the_end = asyncio.run(run_until_stopped())
        output.show(events.take(), monitor)
    finally:
        output.close()
        monitor.close()
    return to_the_end and events.alerts > 0
