"""The four classes of errors. The class gives the meaning; the text is one line for the person who reads it.

========================  =====================================================  =============================
class                     meaning                                                what to do
========================  =====================================================  =============================
`ConfigError`             the configuration cannot be used                       correct the file, start again
`MessageError`            a message, or a request, does not match its type       correct the sender
`ServiceError`            a service failed, does not exist or did not answer     retry, or report to the caller
`LinkError`               the link to a robot is down                            wait: it is re-established
========================  =====================================================  =============================
"""

from __future__ import annotations

from typing import Optional, Tuple

Path = Tuple[str, ...]
"""Keys from the root of a file (or of a node's parameters) down to the one in question."""


class ConfigError(ValueError):
    """A configuration that cannot be used. `str()` is one line: where, what was found, what is allowed."""

    def __init__(self, problem: str, path: Path = (), file: str = "", line: Optional[int] = None) -> None:
        """Stores where the problem is.

        Args:
            problem: what was found and what is allowed.
            path: keys down to the one in question.
            file: where it was read from, empty if it did not come from a file.
            line: line in `file`, counted from 1.
        """
        where = file if line is None else f"{file}:{line}"
        super().__init__(": ".join(part for part in (where, ".".join(path), problem) if part))
        self.problem = problem
        self.path = path
        self.file = file
        self.line = line


class MessageError(ValueError):
    """A message, request or response that does not match its type. `str()` names the type, the field and the value."""


class ServiceError(Exception):
    """A service that does not exist, failed or did not answer in time. `str()` says which."""


class LinkError(ConnectionError):
    """The link to a robot is down. `str()` says why."""
