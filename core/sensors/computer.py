"""This computer, as all sources of one node read it: within bounds, and never waiting for it.

A driver, a disk on a network or a daemon may hang, so everything is read by `Computer.ask`, in a thread where there are
threads: core itself has none. Sources share what they ask for: it is read once per period for all of them.
"""

from __future__ import annotations

import fnmatch
import glob
import os
import re
import warnings
from typing import Any, Callable, Dict, List, NamedTuple, Optional, Tuple, TypeVar

from ..values.errors import ServiceError
from ..values.formatting import printable
from .source import NoSuchSensor, NotMeasuredYet, SensorError

Result = TypeVar("Result")

LATE_S = 5.0
"""An answer that takes longer is an error, which is logged; before that, it is merely not there yet."""

ABSENT_S = 10.0
"""Hardware that is absent is searched for again after this time."""

MOST_BYTES = 1 << 20
"""Of a file of the kernel."""


class HostPaths(NamedTuple):
    """Where the kernel's files and the sockets of daemons are. Tests pass folders with the files of other machines."""

    proc: str = "/proc"
    sys: str = "/sys"
    run: str = "/run"


HOST_PATHS = HostPaths()
"""The files of this machine."""

Background = Callable[[Callable[[], None]], bool]
"""Runs a function that may hang. Returns whether it has finished; if not, it is still running in a thread.

Raises ServiceError if too many functions hang already.
"""


def run_at_once(function: Callable[[], None]) -> bool:
    """Runs a function, however long it takes: the `Background` of tests and of single reads."""
    function()
    return True


class _Question:
    """What is asked in the background: its latest answer, and since when the next one is awaited."""

    def __init__(self) -> None:
        self.asked_s: Optional[float] = None
        self.is_pending = False
        self.is_late = False
        """Whether the answer came after its period, and has not been given yet."""
        self.value: Any = None
        self.error: Optional[Exception] = None

    def run(self, function: Callable[..., Any], paths: HostPaths, arguments: Tuple[Any, ...]) -> None:
        try:
            self.value, self.error = function(paths, *arguments), None
        except Exception as error:  # whatever a driver or a library raises is the answer
            self.value, self.error = None, error
        self.is_pending = False


class Computer:
    """A computer, and what has been read of it."""

    def __init__(self, paths: HostPaths = HOST_PATHS, background: Background = run_at_once) -> None:
        """Reads the files below `paths`; `background` runs what may hang."""
        self.paths = paths
        self._background = background
        self._questions: Dict[Tuple[Any, ...], _Question] = {}
        self._kept: Dict[Callable[..., Any], Any] = {}

    def kept(self, make: Callable[[HostPaths], Result]) -> Result:
        """Returns what `make` returned at its first call: state that several sources share, such as the processes."""
        if make not in self._kept:
            self._kept[make] = make(self.paths)
        found: Result = self._kept[make]
        return found

    def ask(
        self, now_s: float, every_s: float, subject: str, function: Callable[..., Result], *arguments: Any
    ) -> Result:
        """Returns or raises what `function(paths, *arguments)` does, which may hang: nothing waits for it.

        An answer that came after its period is given at the next read. Where the function raises NoSuchSensor, it is
        called again after `ABSENT_S`.

        Args:
            now_s: the time of the read.
            every_s: how old an answer may be before it is asked for again; 0: it is that of this period.
            subject: what is asked, for errors.
            function: runs in a thread, where there are threads; the same at each read.
            *arguments: what it is called with, after the paths.
        """
        question = self._questions.setdefault((function, *arguments), _Question())
        asked_s = question.asked_s
        every_s = ABSENT_S if isinstance(question.error, NoSuchSensor) else every_s
        is_due = asked_s is None or now_s < asked_s or (now_s != asked_s and now_s - asked_s >= every_s)
        if not question.is_pending and question.is_late:
            question.is_late = False
        elif not question.is_pending and is_due:
            question.asked_s, question.is_pending = now_s, True
            try:
                question.is_late = not self._background(lambda: question.run(function, self.paths, arguments))
            except ServiceError as error:
                question.is_pending = False
                raise SensorError(str(error)) from None
        if question.is_pending:
            if question.asked_s is not None and now_s - question.asked_s >= LATE_S:
                raise SensorError(f"no answer from {subject} for more than {LATE_S:g} s")
            raise NotMeasuredYet(f"no answer from {subject} yet")
        if isinstance(question.error, SensorError):
            raise question.error.with_traceback(None)
        if question.error is not None:
            raise SensorError(f"{type(question.error).__name__}: {printable(str(question.error)[:200])}")
        found: Result = question.value
        return found


def read_bytes(path: str, most: int = MOST_BYTES) -> bytes:
    """Returns the content of a file of the kernel, at most so many bytes of it; raises OSError."""
    # Not `open`, which takes longer than the kernel does. Only an empty read is the end: a file comes in whole records.
    file = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        content = os.read(file, most)
        while content and len(content) < most:
            more = os.read(file, most - len(content))
            if not more:
                break
            content += more
        return content
    finally:
        os.close(file)


def read_line(path: str) -> bytes:
    """Returns the content of a file that the kernel gives at once; raises OSError."""
    file = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        return os.read(file, 4096)
    finally:
        os.close(file)


def read_text(*parts: str) -> Optional[str]:
    """Returns the content of a small file below folders, None if it cannot be read."""
    try:
        return read_line(os.path.join(*parts)).decode("utf-8", "replace").strip()
    except OSError:
        return None


def read_float(*parts: str) -> Optional[float]:
    """Returns the number in a file, None if there is none: the file of a sensor that is switched off is empty."""
    try:
        return float(read_text(*parts) or "")
    except ValueError:
        return None


def sorted_paths(pattern: str) -> List[str]:
    """Returns the paths that match, hwmon2 before hwmon10."""

    def key(path: str) -> Tuple[object, ...]:
        parts = re.split(r"(\d+)", os.path.basename(path))
        return tuple(int(part) if part.isdigit() else part for part in parts)

    folder, _, names = pattern.rpartition("/")
    if "*" in folder:
        return sorted(glob.glob(pattern), key=key)
    try:  # glob takes several times as long
        return sorted((f"{folder}/{name}" for name in fnmatch.filter(os.listdir(folder), names)), key=key)
    except OSError:
        return []


def load_psutil(paths: HostPaths) -> Any:
    """Returns psutil, which then reads the files of this computer; raises SensorError if it is not installed."""
    try:
        import psutil
    except ImportError:
        raise SensorError("psutil is not installed: install python3-psutil with apt or psutil with pip") from None
    psutil.PROCFS_PATH = paths.proc
    # It warns of figures that are not used here, such as the traffic of the swap.
    warnings.filterwarnings("ignore", category=RuntimeWarning, module="psutil")
    return psutil


def call_psutil(function: str, subject: str, paths: HostPaths, **options: Any) -> Any:
    """Calls a function of psutil, which reads a `subject`; raises SensorError if that is not possible."""
    psutil = load_psutil(paths)
    try:
        return getattr(psutil, function)(**options)
    except Exception as error:  # psutil raises anything when a file is odd
        text = printable(str(error)[:200])
        raise SensorError(f"psutil cannot read {subject}: {type(error).__name__}: {text}") from error
