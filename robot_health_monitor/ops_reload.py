"""Reads ops.yaml and the token of the server again: a revoked token is refused at once, new targets are notified."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Callable, List, Optional, Tuple

from robot_health_monitor.core.middleware import NOTHING_CHANGED
from robot_health_monitor.core.yaml_file import read_yaml
from robot_health_monitor.ops.configuration import OpsConfig, ServerOptions, read_ops
from robot_health_monitor.runtime.threads import run_in_daemon_thread

from .operations import Operations
from .serving import ServerSettings

if TYPE_CHECKING:
    from robot_health_monitor.rosbridge.server import Server

__all__ = ["OpsReload"]

ReadSettings = Callable[[Optional[ServerOptions]], Optional[ServerSettings]]
"""Returns the settings of the server for the section `server` of an ops.yaml; reads the token. Raises ConfigError."""


class OpsReload:
    """Reloads the operations and the server of one process; see `Reloadable`."""

    def __init__(
        self,
        file: str,
        operations: Operations,
        server: Optional[Server],
        settings: Optional[ServerSettings],
        read_settings: ReadSettings,
    ) -> None:
        """Reads nothing yet.

        Args:
            file: path of the ops.yaml; empty: none.
            operations: what it configures.
            server: the server; None: there is none.
            settings: those that are in force.
            read_settings: reads those of the server.
        """
        self._file = file
        self._operations = operations
        self._server = server
        self._settings = settings
        self._read_settings = read_settings

    async def reload(self) -> str:
        """Reads both files, then applies what differs.

        Raises:
            ConfigError: one of them cannot be used; nothing has changed.
        """
        config, settings = await run_in_daemon_thread(self._read)
        texts = self._use_settings(settings)
        texts += await run_in_daemon_thread(partial(self._operations.use, config))
        return "; ".join(texts) or NOTHING_CHANGED

    def _read(self) -> Tuple[OpsConfig, Optional[ServerSettings]]:
        config = read_ops(read_yaml(self._file)) if self._file else self._operations.config
        return config, self._read_settings(config.server)

    def _use_settings(self, new: Optional[ServerSettings]) -> List[str]:
        old = self._settings
        if old is None or new is None or self._server is None:
            self._settings = new
            return [] if old == new else ["server: takes effect after a restart"]
        texts = []
        if new.token != old.token:
            self._server.use_token(new.token)
            texts.append("server: the token changed, every client has to present the new one")
        self._settings = new
        others = [name for name in new._fields if name != "token" and getattr(new, name) != getattr(old, name)]
        if others:
            texts.append(f"server: {', '.join(others)} takes effect after a restart")
        return texts
