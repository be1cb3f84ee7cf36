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
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from statistics import fmean
from typing import Any, Callable, Mapping, NamedTuple
from weakref import WeakSet

from ..values import matches_pattern
from .computer import Computer, HostPaths, load_psutil, read_bytes
from .source import NotMeasuredYet, SensorError

MOST_MATCHES = 200
"""Processes that one source may select."""
MOST_LETTERS = 1 << 14
"""Of a command line, which may be 2 MB long; the rest is not compared."""
YOUNG_S = 10.0
"""Age up to which a command line is read in every period: a process is started with that of its parent."""
OLD_SCANS = 60
"""The command lines of all old processes are read again within so many periods."""

_TICKS_PER_S = os.sysconf("SC_CLK_TCK")

REDUCTIONS: Mapping[str, Callable[[list[float]], float]] = {
    "sum": sum,
    "max": max,
    "min": min,
    "mean": fmean,
}
"""What several processes are reduced by, by the names of the option `reduce`."""


@dataclass
class Known:
    """A process that is listed, with its latest command line."""

    process: Any
    """Psutil's."""
    since_s: float
    """When it was first seen, in s since the computer started; those of the first scan are not young."""
    start: int
    """As of `Stat`."""
    command: str = ""
    """Empty for a zombie, a part of the kernel, or what another user hides."""
    names: frozenset[str] = frozenset()


class ProcessSource:
    """One metric of the processes that a command line, the name of a node or both select."""

    def __init__(self, metric: str, computer: Computer, command: str = "", node: str = "", reduce: str = "sum") -> None:
        """Selects by what is given of `command` and `node`; `metric` is a key of `METRICS`.

        `command` is a pattern of the whole command line, arguments separated by spaces; `node` is the name of a ROS
        node, with or without its namespace.
        """
        self._computer = computer
        self._command, self._node = command, node
        self._metric = metric
        self._reduce = REDUCTIONS[reduce]
        self.pids: set[int] = set()
        """The numbers of those that are selected."""
        self.at_s = 0.0
        """Time of the readings, in s since the computer started."""
        self.cpu_s: dict[Any, float] = {}
        """CPU time of each process of psutil that is selected."""
        self.last_s = 0.0
        self.last_cpu_s: dict[Any, float] = {}
        """The readings before."""
        self.starts = 0
        """Processes that were seen since the monitor began."""
        self.most_at_once = 0
        self._processes: Processes = computer.shared.setdefault(Processes, Processes())
        self._processes.add(self)

    def check(self, pid: int, process: Known) -> None:
        """Selects a process whose command line is new, or does not select it any more."""
        is_selected = _is_selected(self._command, self._node, process.command, process.names)
        (self.pids.add if is_selected else self.pids.discard)(pid)

    def use(self, at_s: float, cpu_s: dict[Any, float]) -> None:
        """Takes over the readings of a period."""
        self.starts += len(cpu_s.keys() - self.cpu_s.keys())
        self.most_at_once = max(self.most_at_once, len(cpu_s))
        if at_s > self.at_s:  # the kernel's time has a resolution of 10 ms
            self.last_s, self.last_cpu_s, self.at_s = self.at_s, self.cpu_s, at_s
        self.cpu_s = cpu_s

    def read(self, now_s: float) -> float:
        """Returns the value; raises SensorError if no process matches, or if it may not be read."""
        self._computer.ask(now_s, 0.0, "the processes", self._processes.scan)
        given = [("command", self._command), ("node", self._node)]
        selection = " and ".join(f"{name} {value}" for name, value in given if value)
        is_running = self._metric == "process_running"
        if not self.at_s:
            raise NotMeasuredYet("the processes have been listed before this source was made")
        if len(self.pids) > MOST_MATCHES and not is_running:
            raise SensorError(f"{len(self.pids)} processes match {selection} (limit {MOST_MATCHES})")
        if not self.pids and self._processes.are_hidden:
            raise SensorError(f"no visible process matches {selection}: /proc hides those of other users")
        if is_running:
            return float(bool(self.pids))
        if not self.cpu_s:
            raise SensorError(f"no process matches {selection}")
        values = METRICS[self._metric](self)
        if not values:
            raise NotMeasuredYet("not measured yet: the CPU time takes two reads")
        return float(self._reduce(values))


class Processes:
    """The processes of a computer; one of them per node, shared by all sources."""

    def __init__(self) -> None:
        """Reads nothing yet."""
        self._known: dict[int, Known] = {}
        self._scans = 0
        self._sources: WeakSet[ProcessSource] = WeakSet()

    def add(self, source: ProcessSource) -> None:
        """Keeps what a source selects up to date by `scan`, as long as there is the source."""
        for pid, process in list(self._known.items()):
            source.check(pid, process)
        self._sources.add(source)

    def scan(self, paths: HostPaths) -> Processes:
        """Lists the processes, and reads those that sources have selected."""
        psutil = load_psutil(paths)
        now_s = float(read_bytes(f"{paths.proc}/uptime").split()[0])
        pids = set(psutil.pids())
        stats = {pid: read_stat(paths, pid) for pid in self._selected()}
        since_s = now_s if self._known else now_s - 2.0 * YOUNG_S
        for pid, known in list(self._known.items()):
            stat = stats.get(pid)
            if pid not in pids or (pid in stats and (stat is None or stat.start != known.start)):
                self._forget(pid)  # it has ended; its number may be that of a new one
        new = pids - self._known.keys()
        for pid in sorted(new):
            with suppress(Exception):  # it has ended; psutil raises anything when a file is cut off
                stat = read_stat(paths, pid)
                self._known[pid] = Known(psutil.Process(pid), since_s, stat.start if stat else 0)
        self._scans += 1
        for pid, known in list(self._known.items()):
            is_in_turn = pid % OLD_SCANS == self._scans % OLD_SCANS
            if is_in_turn or pid in new or now_s - known.since_s <= YOUNG_S:
                self._identify(pid)
        stats.update((pid, read_stat(paths, pid)) for pid in self._selected() - stats.keys())
        cpu_s = {
            pid: (self._known[pid].process, stat.cpu_s) for pid, stat in stats.items() if stat and pid in self._known
        }
        for source in list(self._sources):
            source.use(now_s, dict(cpu_s[pid] for pid in source.pids if pid in cpu_s))
        return self

    def nodes(self) -> list[str]:
        """Returns the names of the ROS nodes that were started with one, without their namespaces."""
        named = (process for process in self._known.values() if "__n" in process.command)
        return sorted({name for process in named for name in process.names if "/" not in name})

    @property
    def are_hidden(self) -> bool:
        """Whether those of other users are not listed (`hidepid`)."""
        return 1 not in self._known or not self._known[1].command

    def _selected(self) -> set[int]:
        return set().union(*(each.pids for each in list(self._sources) if len(each.pids) <= MOST_MATCHES))

    def _identify(self, pid: int) -> None:
        """Reads the command line of a process."""
        known = self._known[pid]
        words: list[str] = []
        with suppress(Exception):  # as above, or it is hidden
            words = known.process.cmdline()
        command = " ".join(words)[:MOST_LETTERS]
        if command != known.command:
            known.command, known.names = command, node_names(words)
            for each in list(self._sources):
                each.check(pid, known)

    def _forget(self, pid: int) -> None:
        del self._known[pid]
        for each in list(self._sources):
            each.pids.discard(pid)


class Stat(NamedTuple):
    """What the kernel counts of a process."""

    start: int
    """In ticks since the computer started: with its number, which process it is."""
    cpu_s: float


def read_stat(paths: HostPaths, pid: int) -> Stat | None:
    """Returns what proc(5) has in `stat`, None of a process that has ended. Psutil takes several times as long."""
    with suppress(Exception):  # as above
        # The name, in parentheses, may contain anything.
        fields = read_bytes(f"{paths.proc}/{pid}/stat").rpartition(b")")[2].split()
        if fields[0] not in (b"Z", b"X"):
            return Stat(int(fields[19]), (int(fields[11]) + int(fields[12])) / _TICKS_PER_S)
    return None


@lru_cache(maxsize=256)
def _is_selected(pattern: str, node: str, command: str, names: frozenset[str]) -> bool:
    """Returns whether a process is selected; most sources are one of several with the same selection."""
    if not command or (node and node not in names):
        return False
    # A pattern such as `*/amcl *` also means an amcl without arguments.
    return any(matches_pattern(text, pattern or "*") for text in (command, f"{command} "))


def node_names(words: list[str]) -> frozenset[str]:
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


def _cpu_percent(source: ProcessSource) -> list[float]:
    period_s = source.at_s - source.last_s
    return [
        100.0 * max(0.0, cpu_s - source.last_cpu_s[process]) / period_s
        for process, cpu_s in source.cpu_s.items()
        if process in source.last_cpu_s
    ]


def _of_each(read: Callable[[Any], float]) -> Callable[[ProcessSource], list[float]]:
    """Returns what reads a number of each process, of psutil."""

    def values(source: ProcessSource) -> list[float]:
        import psutil

        numbers: list[float] = []
        for process in source.cpu_s:
            try:
                numbers.append(read(process))
            except psutil.AccessDenied:
                raise SensorError(f"process {process.pid} is another user's, who hides this") from None
            except Exception:  # as above
                continue
        return numbers

    return values


METRICS: Mapping[str, Callable[[ProcessSource], list[float]]] = {
    "process_cpu_percent": _cpu_percent,
    "process_memory": _of_each(lambda process: process.memory_info().rss / 1e6),
    "process_threads": _of_each(lambda process: process.num_threads()),
    "process_files": _of_each(lambda process: process.num_fds()),
    "process_restarts": lambda source: [source.starts - source.most_at_once],
    "process_running": lambda source: [1.0],
}
"""What each metric of the selected processes is reduced from."""
