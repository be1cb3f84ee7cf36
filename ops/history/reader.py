"""Reads a history file, also while a monitor writes it."""

from __future__ import annotations

import sqlite3
from pathlib import Path
from types import TracebackType
from typing import Any, Iterator, List, Optional, Sequence, Tuple, Type, Union
from urllib.parse import quote

from robot_health_monitor.core.errors import ConfigError

from . import queries, schema
from .rows import StoredTransition


class HistoryReader:
    """A read-only connection to a history file. Use it in one thread; it may be opened and closed for each request."""

    def __init__(self, file: Union[str, Path]) -> None:
        """Opens a file.

        Raises:
            ConfigError: it does not exist, cannot be read, or is no history of this version.
        """
        self._file = str(file)
        try:
            Path(file).stat()
            uri = f"file:{quote(str(Path(file).absolute()))}?mode=ro"
            self.connection = sqlite3.connect(uri, uri=True, timeout=2.0, isolation_level=None)
            """The connection, for functions of `queries`."""
            schema.require_known(self.connection)
        except OSError as error:
            raise ConfigError(error.strerror or str(error), file=self._file) from None
        except (sqlite3.Error, schema.UnknownSchemaError) as error:
            raise ConfigError(str(error), file=self._file) from None

    def __enter__(self) -> HistoryReader:
        """Returns itself."""
        return self

    def __exit__(
        self, kind: Optional[Type[BaseException]], error: Optional[BaseException], traceback: Optional[TracebackType]
    ) -> None:
        """Closes the file."""
        self.close()

    def close(self) -> None:
        """Closes the file."""
        self.connection.close()

    def transitions(self, **options: Any) -> Iterator[StoredTransition]:
        """Yields transitions; the options are those of `queries.transitions`."""
        return queries.transitions(self.connection, **options)

    def evidence(self, transition_id: int) -> Sequence[Tuple[float, float]]:
        """Returns the samples of the window at a transition: wall time in s since 1970, value."""
        return queries.evidence(self.connection, transition_id)

    def gaps(self, since_s: float = 0.0) -> List[queries.Gap]:
        """Returns the times in which the monitor did not run."""
        return queries.gaps(self.connection, since_s)
