"""The file of a report: what it may replace, and how it is written."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import Sequence

from ..core.values import ConfigError
from ..ops.report.report import MARK
from .output.lines import OutputError

_MARKED_BYTES = 1000  # bytes at the start of a report that contain `MARK`


class ReportFile:
    """Where to write a report.

    A slip of the keyboard must not replace a recording by a page. So a report never replaces one of its inputs, and it
    replaces a file that is not a report only if that was asked for.
    """

    def __init__(self, path: str, inputs: Sequence[str], force: bool) -> None:
        """Checks the path, of which a link is followed, before a long replay. Raises ConfigError.

        `inputs` are the files and folders that the command reads. With `force`, a file that is not a report is
        replaced, too.
        """
        self._given, self._path = path, Path(os.path.realpath(path))
        self._inputs = inputs
        self._force = force
        self._check()

    def write(self, page: str) -> None:
        """Writes the page as a whole or not at all. Raises ConfigError, as at first, or OutputError."""
        self._check()
        part = Path(f"{self._path}.{os.getpid()}.part")
        try:
            with open(part, "x", encoding="utf-8") as stream:
                stream.write(page)
            os.replace(part, self._path)
        except OSError as error:
            raise OutputError(f"{self._given}: cannot be written: {error.strerror or error}") from None
        finally:
            with suppress(OSError):  # it has replaced the file
                part.unlink()

    def _check(self) -> None:
        path, exists, problem = self._path, self._path.exists(), ""
        read = [file for each in self._inputs for file in (Path(each), *Path(each).glob("*")) if file.exists()]
        if not os.access(path.parent, os.W_OK):
            problem = "there is no such folder that can be written"
        elif exists and not path.is_file():
            problem = "is not a file"
        elif exists and any(map(path.samefile, read)):
            problem = "is one of the files that this command reads"
        elif exists and not self._force and not _is_report(path):
            problem = "exists and is not a report of robot-health; --force replaces it"
        if problem:
            raise ConfigError(f"--report: {problem}", file=self._given)


def _is_report(path: Path) -> bool:
    with suppress(OSError), open(path, "rb") as stream:
        return MARK.encode() in stream.read(_MARKED_BYTES)
    return False
