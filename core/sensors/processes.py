"""Processes of this computer, as sources: their CPU time, memory, threads and files, and whether they run.

Theory of operation. `Processes` lists the numbers of all processes once per period for all sources. The command line of
a process is read when it is first seen and, since a process replaces it by exec, again while it is young; those of old
processes are checked in turn, a few per period. What a process uses is read of selected ones only. So the cost follows
the number of selected processes, not that of all.

A process is its number and its start: numbers are used again. One that ends while it is read, and a zombie, is gone.
Time is the kernel's (/proc/uptime), since the counters are, whatever the clock of the node does.
"""

from __future__ import annotations

import os
from collections import deque
from dataclasses import dataclass, field
from statistics import fmean
from typing import (
    Any,
    Callable,
    Deque,
    Dict,
    FrozenSet,
    List,
    Mapping,
    MutableMapping,
    NamedTuple,
    Optional,
    Set,
    Tuple,
)
from weakref import WeakValueDictionary

from ..values.patterns import matches_pattern
from .computer import Computer, HostPaths, load_psutil, read_line
from .source import NotMeasuredYet, SensorError

MOST_MATCHES = 200
"""Processes that one source may select."""
MOST_LETTERS = 1 << 14
"""Of a command line, which may be 2 MB long; the rest is not compared."""
YOUNG_S = 10.0
"""Age up to which a command line is read in every period: a process is started with that of its parent."""
OLD_PER_SCAN, OLD_SCANS = 5, 60
"""At least so many command lines of old processes are read again in each period, and all of them within so many."""

REDUCTIONS: Mapping[str, Callable[[List[float]], float]] = {
    "sum": sum,
    "max": max,
    "min": min,
    "mean": fmean,
}
"""What several processes are reduced by, by the names of the option `reduce`."""

Identity = Tuple[int, float]
"""A process: its number, and its start in s since 1970."""


class Reading(NamedTuple):
    """What a process uses."""

    process: Any
    """Of psutil."""
    cpu_s: float

    @property
    def identity(self) -> Identity:
        """Which process it is."""
        return self.process.pid, self.process.create_time()  # which psutil has read before


@dataclass
class Known:
    """A process that is listed, with its latest command line."""

    since_s: float
    """When it was first seen, in s since the computer started; 0: by the first scan."""
    identity: Optional[Identity] = None
    """None until it was read."""
    command: str = ""
    """Empty for a zombie, a part of the kernel, or what another user hides."""
    names: FrozenSet[str] = frozenset()


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

    def matches(self, process: Known) -> bool:
        """Returns whether a process is selected."""
        if not process.command or (self.node and self.node not in process.names):
            return False
        # A pattern such as `*/amcl *` also means an amcl without arguments.
        texts = (process.command, f"{process.command} ")
        return any(matches_pattern(text, self.command or "*") for text in texts)


@dataclass
class Matched:
    """The processes that a selection matches, as sources share them."""

    selection: Selection
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

    def check(self, pid: int, process: Known) -> None:
        """Adds or removes a process whose command line is new."""
        (self.pids.add if self.selection.matches(process) else self.pids.discard)(pid)

    def use(self, at_s: float, readings: Dict[Identity, Reading]) -> None:
        """Takes over the readings of a period."""
        if at_s > self.at_s:  # the kernel's time has a resolution of 10 ms
            self.last_s, self.last = self.at_s, self.readings
            self.at_s = at_s
        self.readings = readings
        self.starts += len(readings.keys() - self.seen)
        self.seen = set(readings)
        self.most_at_once = max(self.most_at_once, len(readings))


class Processes:
    """The processes of a computer; one of them per node, shared by all sources."""

    def __init__(self, paths: HostPaths) -> None:
        """Reads nothing yet."""
        self._psutil: Any = None
        self._known: Dict[int, Known] = {}
        self._old: Deque[int] = deque()
        """Those whose command line is read again next."""
        self._selected: MutableMapping[Selection, Matched] = WeakValueDictionary()
        """What sources select; a selection ends with its last source."""

    def select(self, selection: Selection) -> Matched:
        """Returns what a selection matches, kept up to date by `scan` as long as the caller keeps it."""
        found = self._selected.get(selection)
        if found is None:
            found = Matched(selection)
            for pid, process in list(self._known.items()):
                found.check(pid, process)
            self._selected[selection] = found
        return found

    def scan(self, paths: HostPaths) -> Processes:
        """Lists the processes, and reads those that sources have selected."""
        self._psutil = load_psutil(paths)
        now_s = float(read_line(f"{paths.proc}/uptime").split()[0])
        pids = set(self._psutil.pids())
        for pid in self._known.keys() - pids:
            self._forget(pid)
        since_s = now_s if self._known else now_s - 2.0 * YOUNG_S  # those of the first scan are not young
        new = sorted(pids - self._known.keys())
        self._known.update((pid, Known(since_s)) for pid in new)
        self._old = self._old or deque(self._known)
        count = min(max(OLD_PER_SCAN, len(self._known) // OLD_SCANS), len(self._old))
        young = [pid for pid, process in self._known.items() if now_s - process.since_s <= YOUNG_S]
        for pid in {*new, *young, *(self._old.popleft() for _ in range(count))} & pids:
            self._identify(pid)
        selected = list(self._selected.values())
        wanted = set().union(*(each.pids for each in selected if len(each.pids) <= MOST_MATCHES))
        found = {pid: reading for pid in wanted for reading in [self._read(pid, now_s)] if reading is not None}
        for each in selected:
            # Some may have ended, or their numbers are now those of others.
            each.use(now_s, {found[pid].identity: found[pid] for pid in each.pids if pid in found})
        return self

    def nodes(self) -> List[str]:
        """Returns the names of the ROS nodes that were started with one, without their namespaces."""
        named = (process for process in self._known.values() if "__n" in process.command)
        return sorted({name for process in named for name in process.names if "/" not in name})

    @property
    def are_hidden(self) -> bool:
        """Whether those of other users are not listed (`hidepid`)."""
        return 1 not in self._known or not self._known[1].command

    def _identify(self, pid: int) -> None:
        """Reads the command line of a process."""
        process = self._known[pid]
        try:
            words = self._psutil.Process(pid).cmdline()
        except Exception:  # it has ended, or is hidden; psutil raises anything when a file is cut off
            words = []
        command = " ".join(words)[:MOST_LETTERS]
        if command != process.command:
            process.command, process.names = command, node_names(words)
            for each in list(self._selected.values()):
                each.check(pid, process)

    def _forget(self, pid: int) -> None:
        del self._known[pid]
        for each in list(self._selected.values()):
            each.pids.discard(pid)

    def _read(self, pid: int, now_s: float) -> Optional[Reading]:
        """Returns what a process uses; None if it has ended."""
        try:
            process = self._psutil.Process(pid)
            with process.oneshot():
                has_ended = process.status() in (self._psutil.STATUS_ZOMBIE, self._psutil.STATUS_DEAD)
                times = process.cpu_times()
            reading = Reading(process, times.user + times.system)
        except Exception:  # as above
            has_ended = True
        if has_ended:
            self._forget(pid)
            return None
        known = self._known[pid]
        if known.identity != reading.identity:
            if known.identity is not None:
                known.since_s = now_s
                self._identify(pid)
            known.identity = reading.identity
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
    if words and not names:
        # Of an interpreter, its first argument that is no option.
        is_python = os.path.basename(words[0]).startswith("python")
        script = next((word for word in words[1:] if is_python and not word.startswith("-")), words[0])
        names = [os.path.basename(script)] if script else []
    prefix = f"/{namespace}/" if namespace else "/"
    return frozenset([*names, *(prefix + name for name in names)])


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

    def read(self, now_s: float) -> float:
        """Returns the value; raises SensorError if no process matches, or if it may not be read."""
        self._computer.ask(now_s, 0.0, "the processes", self._processes.scan)
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
        values = METRICS[self._metric](matched)
        if not values:
            raise NotMeasuredYet("not measured yet: the CPU time takes two reads")
        return self._reduce(values)


def _cpu_percent(matched: Matched) -> List[float]:
    period_s = matched.at_s - matched.last_s
    return [
        100.0 * max(0.0, reading.cpu_s - matched.last[identity].cpu_s) / period_s
        for identity, reading in matched.readings.items()
        if identity in matched.last
    ]


def _of_each(read: Callable[[Any], float]) -> Callable[[Matched], List[float]]:
    """Returns what reads a number of each process, of psutil."""

    def values(matched: Matched) -> List[float]:
        import psutil

        found: List[float] = []
        for reading in matched.readings.values():
            try:
                found.append(read(reading.process))
            except psutil.AccessDenied:
                raise SensorError(f"process {reading.process.pid} is another user's, who hides this") from None
            except Exception:  # as above
                continue
        return found

    return values


METRICS: Mapping[str, Callable[[Matched], List[float]]] = {
    "process_cpu_percent": _cpu_percent,
    "process_memory": _of_each(lambda process: process.memory_info().rss / 1e6),
    "process_threads": _of_each(lambda process: float(process.num_threads())),
    "process_files": _of_each(lambda process: float(process.num_fds())),
    "process_restarts": lambda matched: [float(matched.starts - matched.most_at_once)],
    "process_running": lambda matched: [1.0],
}
"""What each metric of the selected processes is reduced from."""
