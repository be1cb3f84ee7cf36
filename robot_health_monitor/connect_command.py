"""`robot-health connect`: watches robots over rosbridge, with no ROS installed here."""

from __future__ import annotations

import argparse
import asyncio
import ssl
from typing import TYPE_CHECKING, Optional

from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.core.middleware import Severity
from robot_health_monitor.core.yaml_file import read_yaml

from .embedded import clock
from .fleet import Fleet, read_addresses
from .installed_files import find_installed
from .output.choice import choose_output
from .output.lines import Events

if TYPE_CHECKING:
    from .__main__ import Interrupts

_SHOW_PERIOD_S = 0.1


def connect(arguments: argparse.Namespace, interrupts: Interrupts) -> bool:
    """Watches robots until an interrupt, or for `--duration`.

    Returns:
        Whether it ran to the end of its duration and found alerts.

    Raises:
        ConfigError: an address or the configuration cannot be used.
        BrokenPipeError: nobody reads the output any more.
    """
    addresses = read_addresses(arguments.urls)
    file = arguments.thresholds or find_installed("config/thresholds.yaml")
    events = Events(Severity[arguments.log_level])
    fleet = Fleet(
        addresses,
        read_yaml(file) if file else None,
        namespace=arguments.namespace,
        token=arguments.token,
        ssl_context=_trust(arguments.ca),
        clock=clock(),
        on_log=events.on_log,
        on_transition=events.on_transition,
    )
    output = choose_output(arguments.json, name_robots=len(addresses) > 1)

    async def run_until_stopped() -> bool:
        """Returns whether it came to its end without an interrupt."""
        loop = asyncio.get_running_loop()
        stop = asyncio.Event()
        interrupts.on_interrupt = lambda: loop.call_soon_threadsafe(stop.set)
        output.attach(loop, fleet)
        running, stopped = asyncio.ensure_future(fleet.run()), asyncio.ensure_future(stop.wait())
        end_s = None if arguments.duration is None else loop.time() + arguments.duration
        try:
            while not stopped.done() and not running.done() and (end_s is None or loop.time() < end_s):
                output.show(events.take(), fleet)
                await asyncio.wait({running, stopped}, timeout=_SHOW_PERIOD_S, return_when=asyncio.FIRST_COMPLETED)
            if running.done():
                running.result()  # it has failed, for otherwise it goes on
            return not stop.is_set()
        finally:
            interrupts.on_interrupt = bool  # does nothing: the end is under way
            fleet.close()
            for task in (running, stopped):
                task.cancel()
            await asyncio.wait({running, stopped})

    try:
        to_the_end = asyncio.run(run_until_stopped())
        output.show(events.take(), fleet)
    finally:
        output.close()
        fleet.close()
    return to_the_end and events.alerts > 0


def _trust(ca_file: Optional[str]) -> Optional[ssl.SSLContext]:
    """Returns what trusts the certificate authorities in a file; None: the system's are trusted."""
    if ca_file is None:
        return None
    try:
        return ssl.create_default_context(cafile=ca_file)
    except (OSError, ssl.SSLError) as error:
        raise ConfigError(f"cannot be read as certificates: {error}", file=ca_file) from None
