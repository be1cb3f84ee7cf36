"""The one error that a peer can cause."""

from __future__ import annotations

from typing import Union

Id = Union[str, int, None]
"""What a peer names an interaction by; None: it did not."""


class ProtocolError(ValueError):
    """What a peer sent is not rosbridge, or more than is allowed. `str()` is one line that says what is wrong."""

    def __init__(self, problem: str, op: str = "", id: Id = None) -> None:  # noqa: A002 - the protocol's own word
        """Stores what is wrong and with which operation, as far as that is known."""
        super().__init__(f"{op}: {problem}" if op else problem)
        self.problem = problem
        self.op = op
        self.id = id


def shown(value: object, length: int = 40) -> str:
    """Returns a value's text for an error message, cut where it is long."""
    if isinstance(value, (str, bytes)):
        value = value[: length + 1]
    elif isinstance(value, (list, dict)):
        return "a list" if isinstance(value, list) else "a mapping"
    elif isinstance(value, int) and abs(value) >= 10**length:
        return "a very large number"
    text = repr(value)
    return text if len(text) <= length else text[: length - 3] + "..."
