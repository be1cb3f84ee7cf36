"""The error for messages that are not valid rosbridge."""

from __future__ import annotations

from typing import Union

from robot_health_monitor.core.errors import MessageError

__all__ = ["Id", "ProtocolError", "shown"]

Id = Union[str, int, None]
"""Identifies an operation; None: the peer gave none."""


class ProtocolError(MessageError):
    """A message that is not valid rosbridge or exceeds a limit. `str()` is one line."""

    def __init__(self, problem: str, op: str = "", id: Id = None) -> None:  # noqa: A002 - the protocol's word
        """Stores the problem and the operation that caused it, if known."""
        super().__init__(f"{op}: {problem}" if op else problem)
        self.problem = problem
        self.op = op
        self.id = id


def shown(value: object, length: int = 40) -> str:
    """Returns a value for an error message, at most `length` characters, without control characters."""
    if isinstance(value, (str, bytes)):
        value = value[: length + 1]
    elif isinstance(value, (list, dict)):
        return "a list" if isinstance(value, list) else "an object"
    elif isinstance(value, int) and abs(value) >= 10**length:
        return "a very large number"
    text = ascii(value)
    return text if len(text) <= length else text[: length - 3] + "..."
