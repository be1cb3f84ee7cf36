"""Reads the configuration again while the process runs (SIGHUP).

Each part by itself: a file that is broken keeps only what it configures from changing.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Awaitable, Callable, List, Optional, Tuple

from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.core.formatting import printable
from robot_health_monitor.core.middleware import NOTHING_CHANGED, Severity
from robot_health_monitor.core.yaml_file import read_yaml
from robot_health_monitor.ops.configuration import OpsConfig, ServerOptions, read_ops
from robot_health_monitor.runtime.event_loops import run_in_daemon_thread

from .operations import Operations
from .serving import ServerSettings

if TYPE_CHECKING:
    from robot_health_monitor.rosbridge.server import Server

Reload = Callable[[], Awaitable[str]]
"""Reads the configuration of a part again and applies what differs; returns what changed, in one line.

Or `NOTHING_CHANGED`; empty: it has been logged. Raises ConfigError if it cannot be used: the old one stays in force.
"""
ReadSettings = Callable[[Optional[ServerOptions]], Optional[ServerSettings]]
"""Returns the settings of the server for the section `server` of an ops.yaml; reads the token. Raises ConfigError."""

_TIMEOUT_S = 15.0
"""Longest time for one part: a file may be on a server that does not answer, or a pipe that nothing is written to."""


class Reloads:
    """Reloads the parts of a process, one after the other, whenever it is requested."""

    def __init__(self, log: Callable[[Severity, str], object]) -> None:
        """Starts without parts; `log` writes a line."""
        self._log = log
        self._parts: List[Reload] = []
        self._wake: Optional[asyncio.Event] = None

    def add(self, part: Reload) -> None:
        """Adds a part. Call in the loop or before it runs."""
        self._parts.append(part)

    def request(self) -> None:
        """Reloads soon. Call in the loop."""
        if self._wake is not None:
            self._wake.set()

    async def run(self) -> None:
        """Reloads when it is requested, until it is cancelled."""
        wake = self._wake = asyncio.Event()
        while True:
            await wake.wait()
            wake.clear()
            await self._reload()

    async def _reload(self) -> None:
        texts: List[str] = []
        failed = False
        for reload in tuple(self._parts):
            task = asyncio.ensure_future(reload())
            try:
                await asyncio.wait({task}, timeout=_TIMEOUT_S)
                if not task.done():
                    raise ConfigError(f"a file could not be read within {_TIMEOUT_S:g} s")
                texts.append(task.result())
            except ConfigError as error:
                failed = True
                more = f" ({len(error.all) - 1} more: robot-health check)" if len(error.all) > 1 else ""
                self._log(Severity.ERROR, f"not reloaded, the old configuration stays in force: {error}{more}")
            except Exception as error:
                failed = True
                self._log(Severity.ERROR, printable(f"not reloaded: internal error: {type(error).__name__}: {error}"))
            finally:
                task.cancel()
        changes = [text for text in texts if text not in ("", NOTHING_CHANGED)]
        if changes:
            self._log(Severity.INFO, f"reloaded: {'; '.join(changes)}")
        elif NOTHING_CHANGED in texts and not failed:
            self._log(Severity.INFO, f"reloaded: {NOTHING_CHANGED}")


@dataclass
class OpsReload:
    """Reads ops.yaml and the server's token again: a revoked token is refused at once, new targets are notified."""

    file: str
    """Path of the ops.yaml; empty: none."""
    operations: Operations
    server: Optional[Server]
    settings: Optional[ServerSettings]
    """Those of the server that are in force; None: it is not configured."""
    read_settings: ReadSettings

    async def reload(self) -> str:
        """Reads both files, then applies what differs; see `Reload`. If one cannot be used, nothing has changed."""
        config, settings = await run_in_daemon_thread(self._read)
        texts = self._use_settings(settings)
        texts += await run_in_daemon_thread(partial(self.operations.use, config))
        return "; ".join(texts) or NOTHING_CHANGED

    def _read(self) -> Tuple[OpsConfig, Optional[ServerSettings]]:
        config = read_ops(read_yaml(self.file)) if self.file else self.operations.config
        return config, self.read_settings(config.server)

    def _use_settings(self, new: Optional[ServerSettings]) -> List[str]:
        old = self.settings
        if old is None or new is None or self.server is None:
            self.settings = new
            return [] if old == new else ["server: takes effect after a restart"]
        texts = []
        if new.token != old.token:
            self.server.use_token(new.token)
            texts.append("server: the token changed, every client has to present the new one")
        self.settings = new
        others = [name for name, value in vars(new).items() if name != "token" and value != getattr(old, name)]
        if others:
            texts.append(f"server: {', '.join(others)} takes effect after a restart")
        return texts
