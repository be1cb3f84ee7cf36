"""The file of a report: what it may replace, and how it is written."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Iterable, Iterator, Sequence

from ..core.values import ConfigError
from ..ops.report.report import MARK
from .output.lines import OutputError

_MARKED_BYTES = 1000  # bytes at the start of a report that contain `MARK`


@dataclass
class ReportFile:
    """Where to write a report.

    A slip of the keyboard must not replace a recording by a page. So a report never replaces one of its inputs, and it
    replaces a file that is not a report only if that was asked for.
    """

    path: str
    inputs: Sequence[str]
    """Files and folders that the command reads."""
    force: bool
    """Replace a file that is not a report, too."""

    def __post_init__(self) -> None:
        """Checks the path, of which a link is followed, before a long replay. Raises ConfigError."""
        self._real_path = os.path.realpath(self.path)
        self._check()

    def write(self, page: str) -> None:
        """Writes the page as a whole or not at all. Raises ConfigError, as at first, or OutputError."""
        self._check()
        part = f"{self._real_path}.{os.getpid()}.part"
        try:
            with open(part, "x", encoding="utf-8") as stream:
                try:
                    stream.write(page)
                    stream.flush()
                    os.replace(part, self._real_path)
                except BaseException:
                    os.unlink(part)
                    raise
        except OSError as error:
            raise OutputError(f"{self.path}: cannot be written: {error.strerror or error}") from None

    def _check(self) -> None:
        folder, exists = os.path.dirname(self._real_path), os.path.lexists(self._real_path)
        if not os.path.isdir(folder):
            problem = "there is no such folder"
        elif not os.access(folder, os.W_OK):
            problem = "the folder cannot be written"
        elif exists and not os.path.isfile(self._real_path):
            problem = "is not a file"
        elif exists and any(os.path.samefile(self._real_path, each) for each in _files(self.inputs)):
            problem = "is one of the files that this command reads"
        elif exists and not self.force and not _is_report(self._real_path):
            problem = "exists and is not a report of robot-health; --force replaces it"
        else:
            return
        raise ConfigError(f"--report: {problem}", file=self.path)


def _files(paths: Iterable[str]) -> Iterator[str]:
    """Yields the files of files and folders, as far as they exist."""
    for path in paths:
        names = [path]
        if os.path.isdir(path) and os.access(path, os.R_OK):
            names = [os.path.join(path, name) for name in os.listdir(path)]
        yield from filter(os.path.exists, names)


def _is_report(path: str) -> bool:
    try:
        with open(path, "rb") as stream:
            return MARK.encode("ascii") in stream.read(_MARKED_BYTES)
    except OSError:
        return False
