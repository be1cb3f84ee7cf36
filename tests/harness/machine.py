"""The kernel's files of another machine, laid out in a temporary folder."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Mapping

from robot_health_monitor.core.sensors.computer import Computer, HostPaths

PAGE = os.sysconf("SC_PAGE_SIZE")
TICKS = os.sysconf("SC_CLK_TCK")


class Machine:
    """Files below `/proc`, `/sys` and `/run` of a machine, as trees of path to text."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.paths = HostPaths(proc=str(root / "proc"), sys=str(root / "sys"), run=str(root / "run"))
        self.computer = Computer(self.paths)
        for folder in self.paths:
            Path(folder).mkdir()

    def __call__(self, *trees: Mapping[str, str | None]) -> None:
        """Writes the files of the trees; a later one changes them, None removes a file."""
        for tree in trees:
            for path, text in tree.items():
                file = self.root / path.lstrip("/")
                if text is None:
                    file.unlink()
                else:
                    file.parent.mkdir(parents=True, exist_ok=True)
                    file.write_text(f"{text}\n", encoding="utf-8")

    def runs(
        self,
        pid: int,
        command: str,
        start: int = 500,
        cpu_s: float = 0.0,
        mb: float = 10.0,
        threads: int = 1,
        state: str = "S",
        name: str = "x",
    ) -> None:
        """Writes the files of a process, by proc(5); arguments are separated by spaces."""
        folder = self.root / "proc" / str(pid)
        (folder / "fd").mkdir(parents=True, exist_ok=True)
        (folder / "cmdline").write_bytes(command.replace(" ", "\0").encode() + b"\0" if command else b"")
        ticks, pages = round(cpu_s * TICKS), round(mb * 1e6 / PAGE)
        numbers = f"1 1 1 0 -1 4194560 0 0 0 0 {ticks - ticks // 3} {ticks // 3} 0 0 20 0 {threads} 0 {start} 0 {pages}"
        (folder / "stat").write_text(f"{pid} ({name}) {state} {numbers} 18446744073709551615{' 0' * 27}\n")
        (folder / "statm").write_text(f"{2 * pages} {pages} 1 1 0 1 0\n")
        (folder / "status").write_text(f"Name:\tx\nState:\t{state} (x)\nThreads:\t{threads}\n")
        stat = folder.parent / "stat"
        if not stat.exists():
            stat.write_text("cpu  1 0 0 9 0 0 0 0 0 0\nbtime 1700000000\n")
