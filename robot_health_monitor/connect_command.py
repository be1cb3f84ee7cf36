"""`robot-health connect`: watches robots over rosbridge, without ROS on this machine."""

from __future__ import annotations

import argparse
import ssl
import time
from contextlib import asynccontextmanager
from typing import AsyncIterator, Awaitable, Optional

from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.core.local import LogLine
from robot_health_monitor.core.middleware import Severity
from robot_health_monitor.core.yaml_file import read_yaml

from .fleet import Fleet, read_addresses
from .installed_files import find_installed
from .interrupts import Interrupts
from .live_session import run_session
from .output.choice import choose_output
from .output.events import Events
from .tokens import find_token


def connect(arguments: argparse.Namespace, interrupts: Interrupts) -> bool:
    """Watches robots until an interrupt, or for `--duration`.

    Returns:
        Whether the duration has passed and there were alerts.

    Raises:
        ConfigError: an address, the token file or the configuration cannot be used; or, at the end of the duration, a
            robot refuses this client.
    """
    addresses = read_addresses(arguments.urls)
    file = arguments.thresholds or find_installed("config/thresholds.yaml")
    output = choose_output(arguments.json, name_robots=len(addresses) > 1)
    events = Events(output.add, Severity[arguments.log_level])

    def warn(text: str) -> None:
        events.on_log(LogLine(time.monotonic(), "connect", Severity.WARN, text))

    fleet = Fleet(
        addresses,
        read_yaml(file) if file else None,
        namespace=arguments.namespace,
        token=find_token(arguments.token_file, warn),
        ssl_context=_trust(arguments.ca),
        clock=time.monotonic,
        on_log=events.on_log,
        outlet=events.outlet,
    )

    @asynccontextmanager
    async def work() -> AsyncIterator[Awaitable[None]]:
        yield fleet.run()

    alerts_found = run_session(fleet, work(), events, output, interrupts, arguments.duration)
    if arguments.duration is not None and not interrupts.came:
        fleet.check_own_faults()
    return alerts_found


def _trust(ca_file: Optional[str]) -> Optional[ssl.SSLContext]:
    """Returns the TLS settings that trust the certificate authorities in a file; None: those of the system."""
    if ca_file is None:
        return None
    try:
        return ssl.create_default_context(cafile=ca_file)
    except (OSError, ssl.SSLError) as error:
        raise ConfigError(f"cannot be read as certificates: {error.strerror or error}", file=ca_file) from None
