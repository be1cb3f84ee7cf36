"""This computer, as all sources of one node read it: the kernel's files, once per period, within bounds.

Sources share what they read: `Computer.once` reads a file, or scans the processes, once for all of them. What may hang
(a disk on a network, a daemon) is read by `Computer.ask`, in a thread where there are threads: core itself has none.
"""

from __future__ import annotations

import fnmatch
import glob
import os
import re
from typing import Any, Callable, Dict, List, NamedTuple, Optional, Tuple, TypeVar

from .source import NoSuchSensor, NotMeasuredYet, SensorError

__all__ = [
    "HOST_PATHS",
    "Background",
    "Computer",
    "HostPaths",
    "call_psutil",
    "read_bytes",
    "read_float",
    "read_line",
    "read_text",
    "sorted_paths",
]

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

Raises SensorError if too many functions hang already.
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
    """A computer, and what has been read of it in the current period."""

    def __init__(self, paths: HostPaths = HOST_PATHS, background: Background = run_at_once) -> None:
        """Reads the files below `paths`; `background` runs what may hang."""
        self.paths = paths
        self._background = background
        self._now_s: Optional[float] = None
        self._found: Dict[Tuple[Any, ...], Tuple[Any, Optional[SensorError]]] = {}
        self._absent: Dict[Tuple[Any, ...], Tuple[float, NoSuchSensor]] = {}
        """What was searched for in vain, and when."""
        self._questions: Dict[Tuple[Any, ...], _Question] = {}
        self._kept: Dict[Callable[..., Any], Any] = {}

    def kept(self, make: Callable[[HostPaths], Result]) -> Result:
        """Returns what `make` returned at its first call: state that several sources share, such as the processes."""
        if make not in self._kept:
            self._kept[make] = make(self.paths)
        found: Result = self._kept[make]
        return found

    def once(self, now_s: float, function: Callable[..., Result], *arguments: Any) -> Result:
        """Returns or raises what `function(paths, *arguments)` does; called once for all reads at the same time.

        Where it raises NoSuchSensor, it is called again after `ABSENT_S`.
        """
        if now_s != self._now_s:
            self._now_s = now_s
            self._found.clear()
        key = (function, *arguments)
        found: Any = self._found.get(key)
        if found is None:
            found = self._found[key] = self._searched(now_s, key)
        value, failure = found
        if failure is not None:
            raise failure.with_traceback(None)
        result: Result = value
        return result

    def _searched(self, now_s: float, key: Tuple[Any, ...]) -> Tuple[Any, Optional[SensorError]]:
        absent_s, absent = self._absent.get(key, (0.0, None))
        if absent is not None and 0.0 <= now_s - absent_s < ABSENT_S:
            return None, absent
        function, *arguments = key
        try:
            return function(self.paths, *arguments), None
        except NoSuchSensor as error:
            self._absent[key] = now_s, error
            return None, error
        except SensorError as error:
            return None, error

    def ask(
        self, now_s: float, every_s: float, subject: str, function: Callable[..., Result], *arguments: Any
    ) -> Result:
        """Returns or raises what `function(paths, *arguments)` does, which may hang: nothing waits for it.

        All sources share the answer. One that came after its period is given at the next read.

        Args:
            now_s: the time of the read.
            every_s: how old an answer may be before it is asked for again; 0: it is that of this period.
            subject: what is asked, for errors.
            function: runs in a thread, where there are threads; a function of a module, the same at each read.
            *arguments: what it is called with, after the paths.
        """
        question = self._questions.setdefault((function, *arguments), _Question())
        asked_s = question.asked_s
        is_due = asked_s is None or now_s < asked_s or (now_s != asked_s and now_s - asked_s >= every_s)
        if not question.is_pending and question.is_late:
            question.is_late = False
        elif not question.is_pending and is_due:
            question.asked_s, question.is_pending = now_s, True
            try:
                question.is_late = not self._background(lambda: question.run(function, self.paths, arguments))
            except SensorError:
                question.is_pending = False
                raise
        if question.is_pending:
            if question.asked_s is not None and now_s - question.asked_s >= LATE_S:
                raise SensorError(f"no answer from {subject} for more than {LATE_S:g} s")
            raise NotMeasuredYet(f"no answer from {subject} yet")
        if isinstance(question.error, SensorError):
            raise question.error.with_traceback(None)
        if question.error is not None:
            raise SensorError(f"{type(question.error).__name__}: {question.error}")
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


def call_psutil(function: str, subject: str, paths: HostPaths, *arguments: Any, **options: Any) -> Any:
    """Calls a function of psutil, which reads a `subject`; raises SensorError if that is not possible."""
    try:
        import psutil
    except ImportError:
        raise SensorError("psutil is not installed: install python3-psutil with apt or psutil with pip") from None
    if not hasattr(psutil, function):
        raise SensorError(f"psutil cannot read {subject} on this system; set the source to simulated or none")
    psutil.PROCFS_PATH = paths.proc
    try:
        return getattr(psutil, function)(*arguments, **options)
    except Exception as error:  # psutil raises anything when a driver's file is odd
        raise SensorError(f"psutil cannot read {subject}: {type(error).__name__}: {error}") from error
