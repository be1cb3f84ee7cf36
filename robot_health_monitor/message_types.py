"""Checks types and fields of messages: against ROS where it is sourced, else against the standard packages."""

from __future__ import annotations

import difflib
import os
from typing import Any, List, Protocol

from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.core.middleware import split_type_name
from robot_health_monitor.core.standard_messages import MESSAGES, PACKAGES, messages

__all__ = ["Definitions", "check_field", "known_definitions"]


class Definitions(Protocol):
    """Definitions of messages: `NativeMessages`, or the module `messages` of an adapter."""

    def message_class(self, type_name: str) -> Any:
        """Returns the class of a type; raises ConfigError if it is unknown."""

    def field_getter(self, topic: str, type_name: str, field: str) -> Any:
        """Returns a function that reads a field; raises ConfigError if the type has no such field."""


def known_definitions() -> List[Definitions]:
    """Returns the definitions that are available, the best first: those of ROS, then the standard packages."""
    found: List[Definitions] = [messages]
    version = os.environ.get("ROS_VERSION", "")
    try:
        if version == "1":
            from robot_health_monitor.ros1 import messages as ros1_messages

            found.insert(0, ros1_messages)
        elif version == "2":
            from robot_health_monitor.ros2 import messages as ros2_messages

            found.insert(0, ros2_messages)
    except ImportError:
        pass  # only the environment of ROS is there
    return found


def check_field(definitions: List[Definitions], topic: str, type_name: str, field: str) -> bool:
    """Checks a type and the path of a field.

    Args:
        definitions: the definitions to look in, the best first.
        topic: the topic, for the error.
        type_name: the type, `package/Type`.
        field: the path of the field; empty: only the type is checked.

    Returns:
        Whether the type is known.

    Raises:
        ConfigError: the type does not exist (its path is `type`), or has no such field (its path is `field`).
    """
    for each in definitions:
        try:
            each.message_class(type_name)
        except ConfigError:
            continue
        try:
            each.field_getter(topic, type_name, field)
        except ConfigError as error:
            raise ConfigError(error.problem, ("field",)) from None
        return True
    split = split_type_name(type_name)
    if split is None or split[0] not in PACKAGES:
        return False
    spelling = "/".join(split)
    close = difflib.get_close_matches(spelling, MESSAGES, n=1)
    hint = f"; did you mean {close[0]}?" if close else ""
    raise ConfigError(f"expected a message type, got {spelling}, which does not exist{hint}", ("type",))
