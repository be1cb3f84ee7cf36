"""The four classes of errors. The class gives the meaning; the text is one line for the person who reads it.

========================  =====================================================  =============================
class                     meaning                                                what to do
========================  =====================================================  =============================
`ConfigError`             the configuration cannot be used                       correct the file, start again
`MessageError`            a message, or a request, does not match its type       correct the sender
`ServiceError`            a service failed, does not exist or did not answer     retry, or report to the caller
`LinkError`               the link to a robot is down                            wait: it is re-established
========================  =====================================================  =============================

Every other error of the project is one of them. A command that raises a ConfigError ends with code 2, one that raises
another ends with code 3.

========================  ==================  ==============================================================
class                     is a                what cannot be used, does not match, failed or is down
========================  ==================  ==============================================================
`RecordingError`          `ConfigError`       a recording that was named on the command line
`UnusableFileError`       `ConfigError`       a history file: in use, of a newer version, or another file
`ProtocolError`           `MessageError`      a message of a peer over a bridge
`FloodError`              `MessageError`      the pings and empty messages of a rosbridge client
`ApiError`                `MessageError`      a request to the page's API
`UnusableStateError`      `MessageError`      a saved state
`Damaged`                 `MessageError`      a part of a recording
`SensorError`             `ServiceError`      a source of values of this machine
`NotMeasuredYet`          `SensorError`       a source that needs two reads
`NoSuchSensor`            `SensorError`       a source that this machine does not have
`DeliveryError`           `ServiceError`      a target of notifications
`MissingLibraryError`     `ServiceError`      a library that is not installed
`OutputError`             `ServiceError`      standard output, or the file of a report
`RedirectError`           `LinkError`         the link to a server that redirects
========================  ==================  ==============================================================
"""

from __future__ import annotations

from typing import Sequence, Tuple

Path = Tuple[str, ...]
"""Keys from the root of a file (or of a node's parameters) down to the one in question."""


class ConfigError(ValueError):
    """A configuration that cannot be used. `str()` is one line: file, line, key, what was expected, what was found."""

    others: tuple[ConfigError, ...] = ()
    """Further mistakes of the same configuration, found in the same pass."""

    def __init__(
        self, problem: str, path: Path = (), file: str = "", line: int | None = None, details: str = ""
    ) -> None:
        """The problem is what was expected and what was found; `file` is empty, or has `path` in `line`, from 1 on.

        `details` are more than fits the line, such as all allowed keys.
        """
        where = file if line is None else f"{file}:{line}"
        super().__init__(": ".join(part for part in (where, ".".join(map(_shown, path)), problem) if part))
        self.problem = problem
        self.path = path
        self.file = file
        self.line = line
        self.details = details

    @property
    def all(self) -> tuple[ConfigError, ...]:
        """This mistake, then the others."""
        return (self, *self.others)

    def below(self, path: Path) -> ConfigError:
        """Returns this mistake and the others with `path` above their paths."""
        return self.joined([each.at((*path, *each.path), each.file, each.line) for each in self.all])

    def at(self, path: Path, file: str, line: int | None) -> ConfigError:
        """Returns this mistake at another place, without the others."""
        return ConfigError(self.problem, path, file, line, self.details)

    @staticmethod
    def joined(errors: Sequence[ConfigError]) -> ConfigError:
        """Returns the first of the errors, with the rest as its `others`."""
        errors[0].others = tuple(errors[1:])
        return errors[0]


def _shown(key: str) -> str:
    """Returns a key, which may be any text, shortened and without control characters."""
    short = key if len(key) <= 80 else key[:77] + "..."
    return short if short.isprintable() else ascii(short)[1:-1]


class Problems:
    """Collects the configuration errors of one pass, so that a user sees all of them at once.

    As a context manager it collects what is raised inside the block, and execution continues behind the block:

    >>> problems = Problems()
    >>> for name in ("one", "two"):
    ...     with problems:
    ...         raise ConfigError("expected a number, got text", (name,))
    >>> [str(error) for error in problems.errors]
    ['one: expected a number, got text', 'two: expected a number, got text']
    """

    LIMIT = 100
    """Most errors that are collected; then the pass ends, because looking for more takes time."""

    def __init__(self) -> None:
        """Starts without errors."""
        self.errors: list[ConfigError] = []

    def add(self, error: ConfigError) -> None:
        """Adds an error and its `others`; raises them when there are `LIMIT`."""
        self.errors.extend(error.all)
        if len(self.errors) >= self.LIMIT:
            del self.errors[self.LIMIT :]
            self.raise_if_any()

    def raise_if_any(self) -> None:
        """Raises the first error, if there is one; it carries the rest in `others`."""
        if self.errors:
            raise ConfigError.joined(self.errors)

    def __enter__(self) -> Problems:
        """Begins a block whose errors are collected."""
        return self

    def __exit__(self, kind: object, error: BaseException | None, traceback: object) -> bool:
        """Collects a ConfigError; other exceptions pass."""
        if isinstance(error, ConfigError):
            self.add(error)
        return isinstance(error, ConfigError)


class MessageError(ValueError):
    """A message, request or response that does not match its type. `str()` names the type, the field and the value."""


class ServiceError(Exception):
    """A service that does not exist, failed or did not answer in time. `str()` says which."""


class LinkError(ConnectionError):
    """The link to a robot is down. `str()` says why."""
