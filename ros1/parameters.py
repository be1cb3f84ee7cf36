"""The parameters of a logical node on the parameter server of ROS 1.

Launch files load a file in ROS 2's form below the node's name, `/alert_system/ros__parameters/signals/...`; private
parameters such as `_publish_rate:=5` stand beside it, `/alert_system/publish_rate`. The parameter server outlives the
node and accepts any value, so the values in force are kept there too: below `last_accepted`, where a launch file that
clears the node's parameters clears them.
"""

from __future__ import annotations

import logging
import threading
from typing import Any

from ..core.config import NODE_PARAMETERS
from ..core.port import OnChange
from ..core.values import PARAMETERS_FAULT, ConfigError, Faults, JsonObject, Message, Path, Problems, describe
from ..runtime.native_node import Log, apply_change
from .master import Master

_FILE_KEY = "ros__parameters"
"""Key above the parameters of a node in a parameter file."""
_ACCEPTED_KEY = "last_accepted"
_LOG_LEVEL = next(parameter for parameter in NODE_PARAMETERS if parameter.name == "log_level")
_SERVER = "parameter server"
_OVERRIDES = tuple(parameter.name for parameter in NODE_PARAMETERS)
"""Arguments of the launch files: private parameters that override the file, and cannot change at run time."""


class NodeParameters:
    """Reads the parameters of one logical node, and puts them back when a change was refused.

    Raises ServiceError if the master does not answer.
    """

    def __init__(self, master: Master, node: str) -> None:
        """Does not read yet; `node` is the full name."""
        self._master = master
        self._node = node
        self._lock = threading.Lock()
        self._given: JsonObject | None = None
        self._latest: Any = {}
        self._in_force: Any = {}
        self._accepted: JsonObject | None = None

    def given(self) -> JsonObject:
        """Returns the configuration in force: what `read` returned, or raised, until a `reload` is accepted."""
        if self._given is None:
            self._given = self.read()
            self._in_force = self._latest
        return self._given

    def read(self) -> JsonObject:
        """Returns the configuration: the parameters of the file together with the private ones.

        Raises:
            ConfigError: a value stands where a mapping is expected, or a parameter is set in both places.
        """
        self._latest = self._master.parameter(self._node, {})
        if not isinstance(self._latest, dict):
            raise ConfigError(f"expected a mapping as the parameter {self._node}, got {describe(self._latest)}")
        kept = self._latest.pop(_ACCEPTED_KEY, None)
        if self._accepted is None and isinstance(kept, dict):
            self._accepted = kept
        private = {key: value for key, value in self._latest.items() if key != _FILE_KEY}
        from_file = self._latest.get(_FILE_KEY, {})
        if not isinstance(from_file, dict):
            raise ConfigError(f"expected a mapping, got {describe(from_file)}", (_FILE_KEY,))
        twice: list[Path] = []
        merged = _merge(from_file, private, (), twice)
        problems = Problems()
        for path in twice:
            if path[0] not in _OVERRIDES:
                first, second = "/".join((self._node, *path)), "/".join((self._node, _FILE_KEY, *path))
                problems.add(ConfigError(f"is set twice: {first} and {second}; delete one of them", path))
        problems.raise_if_any()
        return merged

    def reload(self, apply: OnChange, faults: Faults, log: Log) -> Message:
        """Reads the parameters again, and puts them back if they are refused; returns the response of `~reload`."""

        def read() -> str:
            proposed = self.read()
            changes = apply(proposed)
            self._given = proposed
            self._in_force = self._latest
            return changes

        with self._lock:
            before = self._latest
            accepted, text = apply_change(read, log)
            if accepted:
                faults.guard(_SERVER, self.keep)
                faults.clear(PARAMETERS_FAULT)
            elif self._latest is not before:  # the master has answered
                self._accepted = self._in_force  # this may be before `keep`
                faults.guard(_SERVER, self.put_back)
        return {"success": accepted, "message": text}

    def keep(self) -> None:
        """Keeps the values in force, if there are any, for this node and one that is started again."""
        if self._given is None:
            return
        self._accepted = self._in_force
        self._master.set_parameter(f"{self._node}/{_ACCEPTED_KEY}", self._accepted)

    def put_back(self) -> bool:
        """Replaces what was read last by the values in force; returns whether that changed anything."""
        if self._accepted is None or self._accepted == self._latest:
            return False
        self._master.set_parameter(self._node, {**self._accepted, _ACCEPTED_KEY: self._accepted})
        self._latest = self._in_force = self._accepted
        return True


def set_log_level(parameters: JsonObject) -> None:
    """Sets the log level of this process to that of a configuration; raises ConfigError if it is not a level."""
    level = _LOG_LEVEL.read(parameters.get(_LOG_LEVEL.name, _LOG_LEVEL.default), (_LOG_LEVEL.name,))
    logging.getLogger("rosout").setLevel(level)


def _merge(below: JsonObject, above: JsonObject, path: Path, twice: list[Path]) -> dict[str, Any]:
    """Merges two trees, of which `above` wins; adds the paths of values that are in both to `twice`."""
    merged = {**below, **above}
    for key in below.keys() & above.keys():
        under, over = below[key], above[key]
        if isinstance(under, dict) and isinstance(over, dict):
            merged[key] = _merge(under, over, (*path, key), twice)
        else:
            twice.append((*path, key))
    return merged
