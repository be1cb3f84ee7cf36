"""Draws docs/structure.svg: the folders with their imports, and the way of one sample, both as they are in the code.

    python docs/draw_structure.py

The imports are read from the modules. The way is that of a battery that falls to 19 %, in a monitor that runs here in
virtual time. A test compares the picture with the code.
"""

from __future__ import annotations

import ast
import sys
from importlib.util import resolve_name
from itertools import dropwhile
from pathlib import Path
from types import FrameType
from typing import Any, Iterator

sys.path.insert(0, str(Path(__file__).resolve().parent))
from generate import ROOT, syntax

from robot_health_monitor.core.nodes import AlertSystem
from robot_health_monitor.core.port.local import LocalBus

PICTURE = ROOT / "docs" / "structure.svg"
PACKAGE = "robot_health_monitor"
LAYERS = (("cli",), ("ros1", "ros2", "rosbridge", "foxglove", "recordings", "ops"), ("runtime",), ("core",))
"""The folders, as the import rules in pyproject.toml order them."""
SIGNAL = {"topic": "battery", "warn_below": 20.0, "flap_detection": True}

_WIDTH, _BOX_WIDTH, _BOX_HEIGHT, _LAYER, _ROW, _COLUMNS = 960, 168, 44, 96, 70, 5
_GAP = (_WIDTH - _COLUMNS * _BOX_WIDTH) / (_COLUMNS + 1)


def folders_imported(folder: str) -> set[str]:
    """Returns the other folders that the modules of a folder import, lazily or not."""
    imported: set[str] = set()
    for file, node in syntax(folder):
        if isinstance(node, ast.ImportFrom):
            package = ".".join([PACKAGE, *file.relative_to(ROOT).parts[:-1]])
            names = resolve_name("." * node.level + (node.module or ""), package).split(".")
            imported.update(names[1:2] if names[0] == PACKAGE else ())
    return imported - {folder}


def way_of_a_sample() -> list[tuple[str, str]]:
    """Returns the modules that a sample passes when it changes the level, and the function that it enters first."""
    bus = LocalBus(0.0, on_log=lambda line: None)
    AlertSystem(bus.node("alert_system", parameters={"signals": {"battery": SIGNAL}}), {"page": lambda event: None})
    robot = bus.node("robot")
    topic = robot.advertise("battery", "std_msgs/Float32")
    for value in (19.0, 25.0):  # what is read once, such as the definition of a type, is no step
        robot.publish(topic, {"data": value})
    bus.run_until(2.0)
    way: dict[str, str] = {}

    def note(frame: FrameType, event: str, _: Any) -> None:
        name = frame.f_code.co_name
        file = Path(frame.f_code.co_filename)
        is_own = "<" not in f"{file}{name}" and not name.startswith("__") and ROOT in file.resolve().parents
        if event == "call" and is_own:
            way.setdefault(file.resolve().relative_to(ROOT).as_posix(), name)

    sys.setprofile(note)
    try:
        robot.publish(topic, {"data": 19.0})
    finally:
        sys.setprofile(None)
    return list(dropwhile(lambda step: step[0] != "core/nodes/alert_system.py", way.items()))


def picture() -> str:
    """Returns the picture as SVG."""
    top = 40.0 + len(LAYERS) * _LAYER + 20.0
    steps = way_of_a_sample()
    height = top + -(-len(steps) // _COLUMNS) * _ROW + 30.0
    lines = [
        (PICTURE.parent / "pictures/structure_head.svg").read_text("utf-8").format(width=_WIDTH, height=f"{height:g}"),
        '<text class="head" x="20" y="24">Folders: an arrow is an import</text>',
        *_folders(40.0),
        f'<text class="head" x="20" y="{top - 4:g}">The way of a sample that changes the level, in core/</text>',
        *_steps(steps, top + 14.0),
        "</svg>",
    ]
    return "\n".join(lines) + "\n"


def _folders(top: float) -> Iterator[str]:
    places = {
        folder: (_WIDTH * (position + 0.5) / len(layer), top + number * _LAYER)
        for number, layer in enumerate(LAYERS)
        for position, folder in enumerate(layer)
    }
    for folder, (x, y) in places.items():
        yield _box(x, y, f"{folder}/", "")
        for other in sorted(folders_imported(folder)):
            to_x, to_y = places[other]
            if folder == "cli" and other in ("core", "runtime"):  # past the layers between, on the left or the right
                edge, half = (5, -_BOX_WIDTH / 2) if other == "core" else (_WIDTH - 5, _BOX_WIDTH / 2)
                yield f'<path d="M{x + half:g},{y + 22:g} H{edge} V{to_y + 22:g} H{to_x + half:g}"/>'
            else:
                enters = to_x + (x - to_x) * 0.12
                yield f'<path d="M{x:g},{y + _BOX_HEIGHT:g} L{enters:g},{to_y:g}"/>'


def _steps(steps: list[tuple[str, str]], top: float) -> Iterator[str]:
    """Yields the boxes row by row, each row from left to right."""
    for number, (file, function) in enumerate(steps):
        row, column = divmod(number, _COLUMNS)
        x = _GAP + column * (_BOX_WIDTH + _GAP) + _BOX_WIDTH / 2
        y = top + row * _ROW
        yield _box(x, y, file.replace("core/", "", 1), f"{function}()")
        if number + 1 < len(steps) and column + 1 < _COLUMNS:
            start = x + _BOX_WIDTH / 2
            yield f'<path d="M{start:g},{y + 22:g} H{start + _GAP:g}"/>'
        elif number + 1 < len(steps):
            bend, below = y + _BOX_HEIGHT + 13, y + _ROW
            yield f'<path d="M{x:g},{y + _BOX_HEIGHT:g} V{bend:g} H{_GAP + _BOX_WIDTH / 2:g} V{below:g}"/>'


def _box(x: float, y: float, name: str, below: str) -> str:
    lines = [f'<rect x="{x - _BOX_WIDTH / 2:g}" y="{y:g}" width="{_BOX_WIDTH}" height="{_BOX_HEIGHT}" rx="6"/>']
    lines.append(f'<text x="{x:g}" y="{y + (19 if below else 27):g}">{name}</text>')
    if below:
        lines.append(f'<text class="small" x="{x:g}" y="{y + 36:g}">{below}</text>')
    return "\n".join(lines)


if __name__ == "__main__":
    PICTURE.write_text(picture(), encoding="utf-8")
