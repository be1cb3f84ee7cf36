"""The parameters of a logical node on the parameter server of ROS 1.

Launch files load a file in ROS 2's form below the node's name, `/alert_system/ros__parameters/signals/...`; private
parameters such as `_publish_rate:=5` stand beside it, `/alert_system/publish_rate`, and override it. The parameter
server outlives the node and accepts any value, so values that a `~reload` refuses are replaced there by those in force.
"""

from __future__ import annotations

import logging
import threading
from typing import Any, Dict, Mapping, Optional

from ..core.config.monitor_config import NODE_PARAMETERS
from ..core.messages.dialect import Message
from ..core.port.middleware import OnChange
from ..core.values.errors import ConfigError
from ..core.values.faults import Faults
from ..core.values.formatting import describe
from ..runtime.native_node import Log, apply_change
from .master import Master

_FILE_KEY = "ros__parameters"
"""Key above the parameters of a node in a parameter file."""
_LOG_LEVEL = next(parameter for parameter in NODE_PARAMETERS if parameter.name == "log_level")
_SERVER = "parameter server"


class NodeParameters:
    """Reads the parameters of one logical node, and puts them back when a change was refused.

    Raises ServiceError if the master does not answer.
    """

    def __init__(self, master: Master, node: str) -> None:
        """Does not read yet; `node` is the full name."""
        self._master = master
        self._node = node
        self._lock = threading.Lock()
        self._given: Optional[Mapping[str, Any]] = None
        self._found: Any = {}

    def given(self) -> Mapping[str, Any]:
        """Returns the configuration in force: what `read` returned, or raised, until a `reload` is accepted."""
        if self._given is None:
            self._given = self.read()
        return self._given

    def read(self) -> Mapping[str, Any]:
        """Returns the configuration: the parameters of the file, and the private ones, which override them.

        Raises ConfigError if a value stands where a mapping is expected.
        """
        self._found = self._master.parameter(self._node, {})
        if not isinstance(self._found, dict):
            raise ConfigError(f"expected a mapping as the parameter {self._node}, got {describe(self._found)}")
        private = {key: value for key, value in self._found.items() if key != _FILE_KEY}
        from_file = self._found.get(_FILE_KEY, {})
        if not isinstance(from_file, dict):
            raise ConfigError(f"expected a mapping, got {describe(from_file)}", (_FILE_KEY,))
        return _overlay(from_file, private)

    def reload(self, apply: OnChange, faults: Faults, log: Log) -> Message:
        """Reads the parameters again, and puts them back if they are refused; returns the response of `~reload`."""

        def read() -> str:
            proposed = self.read()
            changes = apply(proposed)
            self._given = proposed
            return changes

        with self._lock:
            before = self._found
            accepted, text = apply_change(read, log)
            if accepted:
                faults.clear(_SERVER)
            elif self._found is not before:  # the master has answered
                faults.guard(_SERVER, self._put_back, before)
        return {"success": accepted, "message": text}

    def _put_back(self, accepted: Dict[str, Any]) -> None:
        """Replaces what was read last by the values in force."""
        found, self._found = self._found, accepted
        if isinstance(found, dict):
            self._restore(self._node, found, accepted)
        else:
            self._master.set_parameter(self._node, accepted)

    def _restore(self, name: str, found: Mapping[str, Any], accepted: Mapping[str, Any]) -> None:
        """Touches only what differs: other parameters may be changing at the same time."""
        for key in found.keys() - accepted.keys():
            self._master.delete_parameter(f"{name}/{key}")
        for key, value in accepted.items():
            was = found.get(key)
            if isinstance(value, dict) and isinstance(was, dict):
                self._restore(f"{name}/{key}", was, value)
            elif was != value or type(was) is not type(value):
                self._master.set_parameter(f"{name}/{key}", value)


def set_log_level(parameters: Mapping[str, Any]) -> None:
    """Sets the log level of this process to that of a configuration; raises ConfigError if it is not a level."""
    level = _LOG_LEVEL.read(parameters.get(_LOG_LEVEL.name, _LOG_LEVEL.default), (_LOG_LEVEL.name,))
    logging.getLogger("rosout").setLevel(level)


def _overlay(below: Mapping[str, Any], above: Mapping[str, Any]) -> Dict[str, Any]:
    """Merges two trees; values of `above` win."""
    merged = dict(below)
    for key, value in above.items():
        under = merged.get(key)
        merged[key] = _overlay(under, value) if isinstance(under, dict) and isinstance(value, dict) else value
    return merged
