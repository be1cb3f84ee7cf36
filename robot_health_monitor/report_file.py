"""The file of a report: what it may replace, and how it is written.

A slip of the keyboard must not replace a recording by a page. So a report never replaces one of its inputs, and it
replaces a file that is not a report only if that was asked for.
"""

from __future__ import annotations

import os
from typing import Iterable, Iterator

from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.ops.report import MARK

from .output.lines import OutputError

_MARKED_BYTES = 1000
"""Bytes at the start of a report that contain `MARK`."""


class ReportFile:
    """Where to write a report."""

    def __init__(self, path: str, inputs: Iterable[str], force: bool) -> None:
        """Checks the path before a long replay.

        Args:
            path: the file; a link is followed.
            inputs: files and folders that the command reads.
            force: replace a file that is not a report, too.

        Raises:
            ConfigError: the file could not be written, or must not be replaced.
        """
        self._shown = path
        self._path = os.path.realpath(path)
        self._inputs = list(inputs)
        self._force = force
        self._check()

    def write(self, page: str) -> None:
        """Writes the page as a whole or not at all.

        Raises:
            ConfigError: the file has appeared in the meantime, and must not be replaced.
            OutputError: the file cannot be written.
        """
        self._check()
        part = f"{self._path}.{os.getpid()}.part"
        try:
            with open(part, "x", encoding="utf-8") as stream:
                try:
                    stream.write(page)
                    stream.flush()
                    os.replace(part, self._path)
                except BaseException:
                    os.unlink(part)
                    raise
        except OSError as error:
            raise OutputError(f"{self._shown}: cannot be written: {error.strerror or error}") from None

    def _check(self) -> None:
        problem = self._problem()
        if problem:
            raise ConfigError(f"--report: {problem}", file=self._shown)

    def _problem(self) -> str:
        folder = os.path.dirname(self._path)
        if not os.path.isdir(folder):
            return "there is no such folder"
        if not os.access(folder, os.W_OK):
            return "the folder cannot be written"
        if not os.path.lexists(self._path):
            return ""
        if not os.path.isfile(self._path):
            return "is not a file"
        if any(os.path.samefile(self._path, each) for each in _files(self._inputs)):
            return "is one of the files that this command reads"
        if not self._force and not _is_report(self._path):
            return "exists and is not a report of robot-health; --force replaces it"
        return ""


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
