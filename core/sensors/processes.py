"""Processes of this computer, as sources: their CPU time, memory, threads and files, and whether they run.

Theory of operation. `Processes` lists the numbers of all processes once per period for all sources. The command line of
a process is read when it is first seen and, since a process replaces it by exec, again while it is young; those of old
processes are checked in turn, a few per period. What a process uses is read of selected ones only. So the cost follows
the number of selected processes, not that of all. Sources that select the same processes share their `Selection`.

A process is its number and its start: numbers are used again. One that ends while it is read, and a zombie, is gone; a
new process of its number is found in the next period. Time is the kernel's (/proc/uptime), since the counters are,
whatever the clock of the node does.
"""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import dataclass, field
from statistics import fmean
from typing import Any, Callable, Mapping
from weakref import WeakValueDictionary

from ..values import matches_pattern
from .computer import Computer, Growth, HostPaths, HostReading, load_psutil, read_bytes
from .source import NotMeasuredYet, SensorError, Source

MOST_MATCHES = 200
"""Processes that one source may select."""
MOST_LETTERS = 1 << 14
"""Of a command line, which may be 2 MB long; the rest is not compared."""
YOUNG_S = 10.0
"""Age up to which a command line is read in every period: a process is started with that of its parent."""
OLD_SCANS = 60
"""The command lines of all old processes are read again within so many periods."""

_TICKS_PER_S = os.sysconf("SC_CLK_TCK")

REDUCTIONS: Mapping[str, Callable[[list[float]], float]] = {"sum": sum, "max": max, "min": min, "mean": fmean}
"""What several processes are reduced by, by the names of the option `reduce`."""


@dataclass
class Known:
    """A process that is listed, with its latest command line."""

    process: Any
    """Psutil's."""
    since_s: float
    """When it was first seen, in s since the computer started; those of the first scan are not young."""
    start: int
    """As `read_stat` returns it."""
    command: str = ""
    """Empty for a zombie, a part of the kernel, or what another user hides."""
    names: frozenset[str] = frozenset()


@dataclass(eq=False)
class Selection:
    """The processes that a pattern of the command line, the name of a ROS node or both select."""

    command: str
    """Pattern of the whole command line, arguments separated by spaces; empty: any."""
    node: str
    """Name of a ROS node, with or without its namespace; empty: any."""
    pids: set[int] = field(default_factory=set)
    """The numbers of those that are selected."""
    readings: dict[Any, tuple[float, float]] | None = None
    """By psutil's process: its CPU time, and the time of the reading since the computer started, in s.

    None before the first scan."""
    starts: int = 0
    """Processes that were seen since the monitor began."""
    most_at_once: int = 0

    def check(self, pid: int, process: Known) -> None:
        """Selects a process whose command line is new, or does not select it any more."""
        self.pids.discard(pid)
        # A pattern such as `*/amcl *` also means an amcl without arguments.
        texts = (process.command, f"{process.command} ") if process.command else ()
        if self.node in ("", *process.names) and any(matches_pattern(each, self.command or "*") for each in texts):
            self.pids.add(pid)

    def use(self, readings: dict[Any, tuple[float, float]]) -> None:
        """Takes over the readings of a period."""
        self.starts += len(readings.keys() - (self.readings or {}).keys())
        self.most_at_once = max(self.most_at_once, len(readings))
        self.readings = readings


class Processes:
    """The processes of a computer; one of them per node, shared by all sources."""

    def __init__(self) -> None:
        """Reads nothing yet."""
        self._known: dict[int, Known] = {}
        self._scans = 0
        self._selections: WeakValueDictionary[tuple[str, str], Selection] = WeakValueDictionary()

    def select(self, command: str, node: str) -> Selection:
        """Returns a selection, which `scan` keeps up to date as long as it is used."""
        selection = self._selections.get((command, node))
        if selection is None:
            self._selections[command, node] = selection = Selection(command, node)
            for pid, process in list(self._known.items()):
                selection.check(pid, process)
        return selection

    def scan(self, paths: HostPaths) -> Processes:
        """Lists the processes, and reads those that are selected."""
        psutil = load_psutil(paths)
        now_s = float(read_bytes(f"{paths.proc}/uptime").split()[0])
        since_s = now_s if self._known else now_s - 2.0 * YOUNG_S
        pids = set(psutil.pids())
        for pid in self._known.keys() - pids:
            self._forget(pid)
        new = pids - self._known.keys()
        for pid in sorted(new):
            with suppress(Exception):  # it has ended; psutil raises anything when a file is cut off
                self._known[pid] = Known(psutil.Process(pid), since_s, read_stat(paths, pid)[0])
        self._scans += 1
        for pid, known in list(self._known.items()):
            is_in_turn = pid % OLD_SCANS == self._scans % OLD_SCANS
            if is_in_turn or pid in new or now_s - known.since_s <= YOUNG_S:
                self._identify(pid)
        selections = list(self._selections.values())
        readings = {}
        for pid in set().union(*(each.pids for each in selections if len(each.pids) <= MOST_MATCHES)):
            known, (start, cpu_s) = self._known[pid], read_stat(paths, pid)
            if start == known.start:
                readings[pid] = known.process, (cpu_s, now_s)
            else:
                self._forget(pid)
        for selection in selections:
            selection.use(dict(readings[pid] for pid in selection.pids if pid in readings))
        return self

    def nodes(self) -> list[str]:
        """Returns the names of the ROS nodes that were started with one, without their namespaces."""
        named = (process for process in self._known.values() if "__n" in process.command)
        return sorted({name for process in named for name in process.names if "/" not in name})

    @property
    def are_hidden(self) -> bool:
        """Whether those of other users are not listed (`hidepid`)."""
        return 1 not in self._known or not self._known[1].command

    def _identify(self, pid: int) -> None:
        """Reads the command line of a process."""
        known = self._known[pid]
        words: list[str] = []
        with suppress(Exception):  # as above, or it is hidden
            words = known.process.cmdline()
        command = " ".join(words)[:MOST_LETTERS]
        if command != known.command:
            known.command, known.names = command, node_names(words)
            for each in list(self._selections.values()):
                each.check(pid, known)

    def _forget(self, pid: int) -> None:
        del self._known[pid]
        for each in list(self._selections.values()):
            each.pids.discard(pid)


def read_stat(paths: HostPaths, pid: int) -> tuple[int, float]:
    """Returns when a process started, in ticks since the computer did, and its CPU time in s, as in proc(5).

    With its number, the start says which process it is: -1 for one that has ended. Psutil takes several times as long.
    """
    with suppress(Exception):  # as above
        # The name, in parentheses, may contain anything.
        fields = read_bytes(f"{paths.proc}/{pid}/stat").rpartition(b")")[2].split()
        if fields[0] not in (b"Z", b"X"):
            return int(fields[19]), (int(fields[11]) + int(fields[12])) / _TICKS_PER_S
    return -1, 0.0


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


def make_source(metric: str, computer: Computer, command: str = "", node: str = "", reduce: str = "sum") -> Source:
    """Returns one metric, a key of `METRICS`, of the processes that are selected (see `Selection`)."""
    processes: Processes = computer.shared.setdefault(Processes, Processes())
    selection, reduction = processes.select(command, node), REDUCTIONS[reduce]
    name = " and ".join(f"{key} {value}" for key, value in (("command", command), ("node", node)) if value)

    def ask(now_s: float) -> dict[Any, tuple[float, float]]:
        """Returns the readings; raises SensorError if no process matches, or too many."""
        computer.ask(now_s, 0.0, "the processes", processes.scan)
        if selection.readings is None:
            raise NotMeasuredYet("the processes have been listed before this source was made")
        if not selection.pids and processes.are_hidden:
            raise SensorError(f"no visible process matches {name}: /proc hides those of other users")
        if metric != "process_running":
            if len(selection.pids) > MOST_MATCHES:
                raise SensorError(f"{len(selection.pids)} processes match {name} (limit {MOST_MATCHES})")
            if not selection.readings:
                raise SensorError(f"no process matches {name}")
        return selection.readings

    def cpu_percent(grown: list[list[float]], elapsed_s: float) -> float | None:
        # The kernel's time, which is that of all readings, has a resolution of 10 ms.
        return reduction([100.0 * cpu_s / time_s for cpu_s, time_s in grown]) if grown[0][1] else None

    numbers = METRICS[metric]
    return HostReading(ask, lambda _: float(reduction(numbers(selection)))) if numbers else Growth(ask, cpu_percent)


def _of_each(read: Callable[[Any], float]) -> Callable[[Selection], list[float]]:
    """Returns what reads a number of each process, of psutil."""

    def values(selection: Selection) -> list[float]:
        import psutil

        numbers: list[float] = []
        for process in selection.readings or ():
            try:
                numbers.append(read(process))
            except psutil.AccessDenied:
                raise SensorError(f"process {process.pid} is another user's, who hides this") from None
            except Exception:  # as above
                continue
        if not numbers:
            raise NotMeasuredYet("the processes have ended")
        return numbers

    return values


METRICS: Mapping[str, Callable[[Selection], list[float]] | None] = {
    "process_cpu_percent": None,
    "process_memory": _of_each(lambda process: process.memory_info().rss / 1e6),
    "process_threads": _of_each(lambda process: process.num_threads()),
    "process_files": _of_each(lambda process: process.num_fds()),
    "process_restarts": lambda selection: [selection.starts - selection.most_at_once],
    "process_running": lambda selection: [bool(selection.pids)],
}
"""What each metric of the selected processes is reduced from; None for CPU time, which is measured between reads."""
