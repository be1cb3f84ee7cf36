"""The kernel's files of another machine, laid out in a temporary folder."""

from __future__ import annotations

from pathlib import Path
from typing import Mapping, Optional

from robot_health_monitor.core.sensors.computer import Computer, HostPaths


class Machine:
    """Files below `/proc`, `/sys` and `/run` of a machine, as trees of path to text."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.paths = HostPaths(proc=str(root / "proc"), sys=str(root / "sys"), run=str(root / "run"))
        self.computer = Computer(self.paths)
        for folder in self.paths:
            Path(folder).mkdir()

    def __call__(self, *trees: Mapping[str, Optional[str]]) -> None:
        """Writes the files of the trees; a later one changes them, None removes a file."""
        for tree in trees:
            for path, text in tree.items():
                file = self.root / path.lstrip("/")
                if text is None:
                    file.unlink()
                else:
                    file.parent.mkdir(parents=True, exist_ok=True)
                    file.write_text(f"{text}\n", encoding="utf-8")
