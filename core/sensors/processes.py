"""Processes of this computer, as sources: their CPU time, memory, threads and files, and whether they run.

Theory of operation. `Processes` lists /proc once per period for all sources. The command line of a process is read when
it is first seen and, since a process replaces it by exec, again while it is young; those of old processes are checked
in turn, a few per period. So the cost follows the number of selected processes, not that of all.

A process is its number and its start: numbers are used again. One that ends while it is read, and a zombie, is gone.
Time is the kernel's (/proc/uptime), since the counters are, whatever the clock of the node does. Formats: proc(5).
"""

from __future__ import annotations

import os
from collections import deque
from dataclasses import dataclass, field
from typing import (
    Callable,
    Deque,
    Dict,
    FrozenSet,
    Iterable,
    List,
    Mapping,
    MutableMapping,
    NamedTuple,
    Optional,
    Set,
    Tuple,
)
from weakref import WeakValueDictionary

from ..patterns import matches_pattern
from .computer import Computer, HostPaths, read_bytes, read_line
from .source import NotMeasuredYet, SensorError

__all__ = ["REDUCTIONS", "Growth", "ProcessSource", "Selection", "node_names"]

MOST_MATCHES = 200
"""Processes that one source may select."""
MOST_COMMAND_BYTES = 1 << 14
"""Of a command line, which may be 2 MB long; the rest is not compared."""
YOUNG_S = 10.0
"""Age up to which a command line is read in every period: a process is started with that of its parent."""
OLD_PER_SCAN, OLD_SCANS = 20, 60
"""At least so many command lines of old processes are read again in each period, and all of them within so many."""
GROWTH_WINDOW_S = 600.0
GROWTH_LEAST_S = 120.0
_LEAST_STEP_S = 0.5
"""Between two readings of memory that count for its growth; bounds the number that is kept."""

_TICK_S = 1.0 / (os.sysconf("SC_CLK_TCK") if hasattr(os, "sysconf") else 100)
_PAGE_MB = (os.sysconf("SC_PAGE_SIZE") if hasattr(os, "sysconf") else 4096) / 1e6

REDUCTIONS: Mapping[str, Callable[[List[float]], float]] = {
    "sum": sum,
    "max": max,
    "min": min,
    "mean": lambda values: sum(values) / len(values),
}
"""What several processes are reduced by, by the names of the option `reduce`."""

Identity = Tuple[int, int]
"""A process: its number, and its start in ticks since the computer started."""


class Selection(NamedTuple):
    """Selects processes; one that is given must match."""

    command: str = ""
    """Pattern of the whole command line, arguments separated by spaces."""
    node: str = ""
    """Name of a ROS node, with or without its namespace."""

    def __str__(self) -> str:
        """Returns the options, as in the configuration."""
        given = [("command", self.command), ("node", self.node)]
        return " and ".join(f"{name} {value}" for name, value in given if value)

    def matcher(self) -> Callable[[_Process], bool]:
        """Returns what decides whether a process matches."""
        command, node = self.command, self.node

        def matches(process: _Process) -> bool:
            if not process.raw or (node and node not in process.names):  # without: a zombie, or part of the kernel
                return False
            # A pattern such as `*/amcl *` also means an amcl without arguments.
            return any(matches_pattern(text, command or "*") for text in (process.command, process.command + " "))

        return matches


class Reading(NamedTuple):
    """What /proc/PID/stat has of a process."""

    identity: Identity
    cpu_s: float
    memory_mb: float
    threads: int


@dataclass
class _Process:
    """A process that runs, with its latest command line."""

    start: Optional[int] = None
    """As in `Identity`; None until it was read."""
    raw: bytes = b""
    command: str = ""
    names: FrozenSet[str] = frozenset()


class Growth:
    """Least-squares slope of the latest readings of a value, O(1) per reading."""

    def __init__(self) -> None:
        """Starts without readings."""
        self._readings: Deque[Tuple[float, float]] = deque()
        self._rebuild()

    def add(self, at_s: float, value: float) -> None:
        """Adds a reading, unless it comes too soon after the latest; drops those that are too old."""
        readings = self._readings
        if readings and at_s - readings[-1][0] < _LEAST_STEP_S:
            return
        readings.append((at_s, value))
        if len(readings) == 1:
            self._rebuild()
            return
        self._change(at_s, value, 1.0)
        while at_s - readings[0][0] > GROWTH_WINDOW_S:
            self._change(*readings.popleft(), -1.0)
            self._dropped += 1
        if self._dropped > len(readings):  # sums from which was subtracted lose digits
            self._rebuild()

    def per_hour(self) -> Optional[float]:
        """Returns the slope per hour; None before two minutes of readings."""
        readings = self._readings
        if not readings or readings[-1][0] - readings[0][0] < GROWTH_LEAST_S:
            return None
        count = len(readings)
        squares = self._square - self._sum_s * self._sum_s / count
        return 3600.0 * (self._product - self._sum_s * self._sum / count) / squares

    def _rebuild(self) -> None:
        self._reference_s, self._reference = self._readings[-1] if self._readings else (0.0, 0.0)
        self._sum_s = self._sum = self._square = self._product = 0.0
        self._dropped = 0
        for at_s, value in self._readings:
            self._change(at_s, value, 1.0)

    def _change(self, at_s: float, value: float, sign: float) -> None:
        distance_s, distance = at_s - self._reference_s, value - self._reference
        self._sum_s += sign * distance_s
        self._sum += sign * distance
        self._square += sign * distance_s * distance_s
        self._product += sign * distance_s * distance


@dataclass
class Matched:
    """The processes that a selection matches, as sources share them."""

    matches: Callable[[_Process], bool]
    is_growing: bool = False
    """Whether the growth is asked for."""
    pids: Set[int] = field(default_factory=set)
    at_s: float = 0.0
    """Time of the readings, in s since the computer started."""
    readings: Dict[Identity, Reading] = field(default_factory=dict)
    last_s: float = 0.0
    last: Dict[Identity, Reading] = field(default_factory=dict)
    """The readings before."""
    seen: Set[Identity] = field(default_factory=set)
    """Those that ran in the previous period or run now."""
    starts: int = 0
    """Processes seen since the monitor began."""
    most_at_once: int = 0
    growth: Dict[Identity, Growth] = field(default_factory=dict)

    def use(self, at_s: float, readings: Iterable[Reading]) -> None:
        """Takes over the readings of a period."""
        if at_s > self.at_s:  # the kernel's time has a resolution of 10 ms
            self.last_s, self.last = self.at_s, self.readings
            self.at_s = at_s
        self.readings = {reading.identity: reading for reading in readings}
        self.starts += len(self.readings.keys() - self.seen)
        self.seen = set(self.readings)
        self.most_at_once = max(self.most_at_once, len(self.readings))
        if self.is_growing:
            self.growth = {identity: self.growth.get(identity) or Growth() for identity in self.readings}
            for identity, reading in self.readings.items():
                self.growth[identity].add(at_s, reading.memory_mb)


class Processes:
    """The processes of a computer; one of them per node, shared by all sources."""

    def __init__(self, paths: HostPaths) -> None:
        """Reads nothing yet."""
        self._proc = paths.proc
        self._known: Dict[int, _Process] = {}
        self._young: Dict[int, float] = {}
        """When those that are young were first seen."""
        self._old: Deque[int] = deque()
        """Those whose command line is read again next."""
        self._selected: MutableMapping[Selection, Matched] = WeakValueDictionary()
        """What sources select; a selection ends with its last source."""

    def select(self, selection: Selection) -> Matched:
        """Returns what a selection matches, kept up to date by `scan` as long as the caller keeps it."""
        found = self._selected.get(selection)
        if found is None:
            found = Matched(selection.matcher())
            found.pids = {pid for pid, process in self._known.items() if found.matches(process)}
            self._selected[selection] = found
        return found

    def scan(self, paths: HostPaths) -> Processes:
        """Lists the processes and reads those that are selected. Called once per period."""
        try:
            now_s = self._uptime_s()
            pids = {int(name) for name in os.listdir(self._proc) if name.isdecimal()}
        except (OSError, ValueError, IndexError) as error:
            raise SensorError(f"cannot read the processes in {self._proc}: {str(error)[:100]}") from None
        for pid in self._known.keys() - pids:
            self._forget(pid)
        self._identify_again(now_s)
        is_first = not self._known  # when the monitor starts, most have been running for long
        for pid in pids - self._known.keys():
            self._known[pid] = _Process()
            self._identify(pid)
            if not is_first:
                self._young[pid] = now_s
        selected = list(self._selected.values())
        wanted = set().union(*(each.pids for each in selected if len(each.pids) <= MOST_MATCHES))
        found = {pid: reading for pid in wanted for reading in [self._read(pid, now_s)] if reading is not None}
        for each in selected:
            # Some may have ended, or their numbers are now those of others.
            each.use(now_s, [found[pid] for pid in each.pids if pid in found])
        return self

    def nodes(self) -> List[str]:
        """Returns the names of the ROS nodes that were started with one, without their namespaces."""
        named = (process for process in self._known.values() if "__n" in process.command)
        return sorted({name for process in named for name in process.names if "/" not in name})

    @property
    def are_hidden(self) -> bool:
        """Whether those of other users are not listed (`hidepid`)."""
        return 1 not in self._known or not self._known[1].raw

    def _uptime_s(self) -> float:
        return float(read_line(f"{self._proc}/uptime").split()[0])

    def _identify_again(self, now_s: float) -> None:
        """Reads the command lines that exec may have replaced: those of young processes, and of some old ones."""
        for pid, first_s in list(self._young.items()):
            self._identify(pid)
            if now_s - first_s > YOUNG_S:
                del self._young[pid]
        old = self._old
        if not old:
            old.extend(self._known)
        for _ in range(min(max(OLD_PER_SCAN, len(self._known) // OLD_SCANS), len(old))):
            pid = old.popleft()
            if pid in self._known:
                self._identify(pid)

    def _identify(self, pid: int) -> None:
        try:
            raw = read_bytes(f"{self._proc}/{pid}/cmdline", MOST_COMMAND_BYTES)
        except OSError:  # it has ended, or is another user's and hidden
            raw = b""
        process = self._known[pid]
        if raw == process.raw:
            return
        process.raw = raw
        words = raw.decode("utf-8", "replace").rstrip("\0").split("\0")
        process.command, process.names = " ".join(words), node_names(words)
        for each in self._selected.values():
            if each.matches(process):
                each.pids.add(pid)
            else:
                each.pids.discard(pid)

    def _forget(self, pid: int) -> None:
        self._known.pop(pid, None)
        self._young.pop(pid, None)
        for each in self._selected.values():
            each.pids.discard(pid)

    def _read(self, pid: int, now_s: float) -> Optional[Reading]:
        """Returns what a process uses; None if it has ended."""
        try:
            stat = read_line(f"{self._proc}/{pid}/stat")
            fields = stat[stat.rindex(b")") + 2 :].split(None, 22)  # the name may contain anything
            state, cpu, threads, start, pages = fields[0], fields[11:13], fields[17], fields[19], fields[21]
            reading = Reading(
                (pid, int(start)), (int(cpu[0]) + int(cpu[1])) * _TICK_S, int(pages) * _PAGE_MB, int(threads)
            )
        except (OSError, ValueError, IndexError):
            state = b"X"
        if state in (b"Z", b"X", b"x"):
            self._forget(pid)
            return None
        process = self._known[pid]
        if process.start != reading.identity[1]:
            if process.start is not None:
                self._young[pid] = now_s
                self._identify(pid)
            process.start = reading.identity[1]
        return reading


def node_names(words: List[str]) -> FrozenSet[str]:
    """Returns the names of the ROS nodes that a command starts: those of its arguments, else the executable.

    A name with a namespace is there with and without it.
    """
    names, namespace = [], ""
    for word in words[1:]:
        key, separator, value = word.rpartition(":=")
        rule = key.rpartition(":")[2]  # ROS 2 has `-r node:__node:=name` for one of several nodes
        if separator and rule in ("__name", "__node") and value:
            names.append(value)
        elif separator and rule == "__ns":
            namespace = value.strip("/")
    if not names:
        script = _script(words)
        names = [os.path.basename(script)] if script else []
    prefix = f"/{namespace}/" if namespace else "/"
    return frozenset([*names, *(prefix + name for name in names)])


def _script(words: List[str]) -> str:
    """Returns the executable; that of an interpreter is its first argument that is no option."""
    if os.path.basename(words[0]).startswith("python"):
        return next((word for word in words[1:] if not word.startswith("-")), words[0])
    return words[0]


class ProcessSource:
    """One metric of the selected processes."""

    def __init__(self, metric: str, computer: Computer, command: str = "", node: str = "", reduce: str = "sum") -> None:
        """Selects by `command`, by `node` or by both; `metric` is a key of `METRICS`."""
        self._computer = computer
        self._selection = Selection(command, node)
        self._metric = metric
        self._reduce = REDUCTIONS[reduce]
        self._processes = computer.kept(Processes)
        self._matched = self._processes.select(self._selection)
        self._matched.is_growing = self._matched.is_growing or metric == "process_memory_growth"

    def read(self, now_s: float) -> float:
        """Returns the value; raises SensorError if no process matches, or if it may not be read."""
        self._computer.once(now_s, self._processes.scan)
        matched = self._matched
        if not matched.at_s:
            raise NotMeasuredYet("the processes have been listed before this source was made")
        if len(matched.pids) > MOST_MATCHES:
            if self._metric == "process_running":
                return 1.0
            raise SensorError(f"{len(matched.pids)} processes match {self._selection} (limit {MOST_MATCHES})")
        if not matched.readings:
            if self._processes.are_hidden:
                raise SensorError(f"no visible process matches {self._selection}: /proc hides those of other users")
            if self._metric == "process_running":
                return 0.0
            raise SensorError(f"no process matches {self._selection}")
        return METRICS[self._metric](matched, self._reduce, self._computer.paths)


_Reduce = Callable[[List[float]], float]


def _cpu_percent(matched: Matched, reduce: _Reduce, paths: HostPaths) -> float:
    period_s = matched.at_s - matched.last_s
    spent_s = [
        reading.cpu_s - matched.last[identity].cpu_s
        for identity, reading in matched.readings.items()
        if identity in matched.last
    ]
    if not spent_s:
        raise NotMeasuredYet("the CPU time is not measured yet: it takes two reads")
    return reduce([100.0 * max(0.0, each) / period_s for each in spent_s])


def _growth(matched: Matched, reduce: _Reduce, paths: HostPaths) -> float:
    slopes = [growth.per_hour() for growth in matched.growth.values()]
    known = [slope for slope in slopes if slope is not None]
    if not known:
        raise NotMeasuredYet(f"the growth is not measured yet: it takes {GROWTH_LEAST_S:g} s")
    return reduce(known)


def _files(matched: Matched, reduce: _Reduce, paths: HostPaths) -> float:
    counts: List[float] = []
    for pid, _ in matched.readings:
        folder = f"{paths.proc}/{pid}/fd"
        try:
            # Linux 6.2 and newer have the number as the size of the folder.
            counts.append(os.stat(folder).st_size or len(os.listdir(folder)))
        except FileNotFoundError:
            continue  # it has just ended
        except OSError as error:
            raise SensorError(f"the open files of process {pid} cannot be read: {error.strerror}") from None
    if not counts:
        raise NotMeasuredYet("the processes have just ended")
    return reduce(counts)


METRICS: Mapping[str, Callable[[Matched, _Reduce, HostPaths], float]] = {
    "process_cpu_percent": _cpu_percent,
    "process_memory": lambda matched, reduce, paths: reduce([each.memory_mb for each in matched.readings.values()]),
    "process_memory_growth": _growth,
    "process_threads": lambda matched, reduce, paths: reduce(
        [float(each.threads) for each in matched.readings.values()]
    ),
    "process_files": _files,
    "process_restarts": lambda matched, reduce, paths: float(matched.starts - matched.most_at_once),
    "process_running": lambda matched, reduce, paths: 1.0,
}
"""What a source of each metric returns."""
