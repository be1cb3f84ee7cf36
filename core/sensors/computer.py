"""This computer, as all sources of one node read it: within bounds, and never waiting for it.

A driver, a disk on a network or a daemon may hang, so everything is read by `Computer.ask`, in a thread where there are
threads: core itself has none. Sources share what they ask for: it is read once per period for all of them.
"""

from __future__ import annotations

import glob
import math
import os
import re
import warnings
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Callable, Iterable, Mapping, NamedTuple, Sequence, TypeVar

from ..values import ServiceError, list_text, printable
from .source import NoSuchSensor, NotMeasuredYet, SensorError

Result = TypeVar("Result")
Counters = Mapping[Any, Sequence[float]]
"""Counters of each part of the computer, by its name."""

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


@dataclass
class _Question:
    """What is asked in the background: its latest answer, and since when the next one is awaited."""

    asked_s: float = math.nan
    is_pending: bool = False
    is_late: bool = False
    """Whether the answer came after its period, and has not been given yet."""
    value: Any = None
    error: SensorError | None = None

    def run(self, subject: str, function: Callable[..., Any], *arguments: Any) -> None:
        try:
            self.value, self.error = function(*arguments), None
        except SensorError as error:
            self.error = error
        except Exception as error:  # whatever a driver or a library raises is the answer
            text = printable(f"{type(error).__name__}: {str(error)[:200]}")
            self.error = SensorError(f"{subject} cannot be read: {text}")
        self.is_pending = False


@dataclass(eq=False)
class Computer:
    """A computer, and what has been read of it."""

    paths: HostPaths = HOST_PATHS
    background: Background = run_at_once
    """Runs what may hang."""
    shared: dict[type, Any] = field(default_factory=dict)
    """State that several sources share, such as the processes."""
    _questions: dict[tuple[Any, ...], _Question] = field(default_factory=dict)

    def ask(
        self, now_s: float, every_s: float, subject: str, function: Callable[..., Result], *arguments: Any
    ) -> Result:
        """Returns or raises what `function(paths, *arguments)` does, which may hang: nothing waits for it.

        An answer that came after its period is given at the next read. Where the function raises NoSuchSensor, it is
        called again after `ABSENT_S`. Errors of libraries and of the kernel become SensorError.

        Args:
            now_s: the time of the read.
            every_s: how old an answer may be before it is asked for again; 0 if it has to be that of this period.
            subject: what is asked, for errors.
            function: runs in a thread, where there are threads; the same at each read.
            *arguments: what it is called with, after the paths.
        """
        question = self._questions.setdefault((function, *arguments), _Question())
        elapsed_s = now_s - question.asked_s
        every_s = ABSENT_S if isinstance(question.error, NoSuchSensor) else every_s
        if not question.is_pending and question.is_late:
            question.is_late = False
        elif not question.is_pending and elapsed_s != 0.0 and not 0.0 < elapsed_s < every_s:
            question.asked_s, question.is_pending = now_s, True
            call = partial(question.run, subject, function, self.paths, *arguments)
            try:
                question.is_late = not self.background(call)
            except ServiceError as error:
                question.is_pending = False
                raise SensorError(str(error)) from None
        if question.is_pending:
            if now_s - question.asked_s >= LATE_S:
                raise SensorError(f"no answer from {subject} for more than {LATE_S:g} s")
            raise NotMeasuredYet(f"no answer from {subject} yet")
        if question.error is not None:
            raise question.error.with_traceback(None)
        result: Result = question.value
        return result


@dataclass(frozen=True)
class HostReading:
    """A source of a part of an answer; it remembers nothing between two reads."""

    ask: Callable[[float], Any]
    """Returns the answer at a time, or raises SensorError."""
    value: Callable[[Any], float]

    def read(self, now_s: float) -> float:
        """Returns the value, or raises SensorError."""
        return self.value(self.ask(now_s))


@dataclass
class Growth:
    """A source of how much counters grew between two reads."""

    ask: Callable[[float], Counters]
    """Returns the counters of each part of the computer by its name, such as those of each disk."""
    value_of: Callable[[list[list[float]], float], float | None]
    """Called with the growth of each part and the time in s; None if nothing can be said, as within a tick."""
    _counters: Counters = field(default_factory=dict)
    _at_s: float = math.nan
    _value: float | None = None

    def read(self, now_s: float) -> float:
        """Returns the value since the previous read, or that of before if no time has passed; raises SensorError."""
        try:
            counters = self.ask(now_s)
        except NotMeasuredYet:
            raise
        except SensorError:  # such as of an interface that is unplugged; it counts from there
            self._counters, self._value = {}, None
            raise
        elapsed_s = now_s - self._at_s
        # A counter that is smaller than before was reset.
        grown = [
            [max(0, new - old) for new, old in zip(counters[name], last)]
            for name, last in self._counters.items()
            if name in counters
        ]
        if not grown:
            self._value = None
        elif elapsed_s > 0.0:
            value = self.value_of(grown, elapsed_s)
            self._value = self._value if value is None else value
        self._counters, self._at_s = counters, now_s
        if self._value is None:
            raise NotMeasuredYet("not measured yet: it takes two reads")
        return self._value


def part(name: str) -> Callable[[Mapping[str, float | None]], float]:
    """Returns what takes one number of an answer by the name of its source.

    It raises NoSuchSensor if the answer does not have it, and SensorError if it is None: not measured now.
    """

    def value(numbers: Mapping[str, float | None]) -> float:
        if name not in numbers:
            raise NoSuchSensor(f"this machine has no {name}")
        number = numbers[name]
        if number is None:
            raise SensorError(f"{name} has not been measured yet")
        return number

    return value


def read_bytes(path: str, most: int = MOST_BYTES) -> bytes:
    """Returns the content of a file of the kernel, at most so many bytes of it; raises OSError."""
    # Not `open`, which takes longer than the kernel does. Only an empty read is the end: a file comes in whole records.
    file = os.open(path, os.O_RDONLY)
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


def read_text(*parts: str) -> str | None:
    """Returns the content of a small file below folders, None if it cannot be read."""
    try:
        return read_bytes(os.path.join(*parts)).decode("utf-8", "replace").strip()
    except OSError:
        return None


def read_float(*parts: str) -> float | None:
    """Returns the number in a file, None if there is none: the file of a sensor that is switched off is empty."""
    try:
        number = float(read_text(*parts) or "")
    except ValueError:
        return None
    return number if math.isfinite(number) else None


def sorted_paths(pattern: str) -> list[str]:
    """Returns the paths that match, hwmon2 before hwmon10."""

    def key(path: str) -> list[object]:
        return [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", path)]

    return sorted(glob.glob(pattern), key=key)


def chosen(parts: Mapping[Any, Result], noun: str, name: Any, default: Iterable[Any]) -> dict[Any, Result]:
    """Returns the part of this computer with a name, such as one disk; without a name those of `default`.

    Raises SensorError if there is none with this name, and NoSuchSensor if `default` is empty.
    """
    is_named = name not in (None, "")
    names = [name] if is_named else list(default)
    if is_named and name not in parts:
        available = list_text([str(each) for each in parts if each is not None], most=12)
        raise SensorError(f"this machine has no {noun} {name}; available: {available or 'none'}")
    if not names:
        raise NoSuchSensor(f"this machine has no {noun}")
    return {each: parts[each] for each in names}


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
