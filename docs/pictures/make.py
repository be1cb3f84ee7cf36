"""Makes the pictures of the README and of docs/ from real runs: `python docs/pictures/make.py [NAME ...]`.

Each scene runs real commands in a pseudo-terminal, and draws the screen that they leave as SVG. A scene whose program
is missing here (`roslaunch`, `ros2`, `colcon`) is skipped with one line. Source the workspace that this package was
built in before the scenes `ros1` and `ros2`. Needs pyte and rich.
"""

from __future__ import annotations

import fcntl
import os
import pty
import select
import shlex
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import termios
import time
from pathlib import Path
from typing import Callable, Dict, List, Mapping, NamedTuple, Sequence

import pyte
from rich.color import Color
from rich.console import Console
from rich.style import Style
from rich.text import Text

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
PACKAGE = "robot_health_monitor"

_SVG = """\
<svg class="rich-terminal" viewBox="0 0 {width} {height}" xmlns="http://www.w3.org/2000/svg">
<style>
.{unique_id}-matrix {{ font-family: monospace; font-size: {char_height}px; line-height: {line_height}px; }}
.{unique_id}-title {{ font-size: 18px; font-weight: bold; font-family: sans-serif; }}
{styles}
</style>
<defs>
<clipPath id="{unique_id}-clip-terminal">
<rect x="0" y="0" width="{terminal_width}" height="{terminal_height}"/>
</clipPath>
{lines}
</defs>
{chrome}
<g transform="translate({terminal_x}, {terminal_y})" clip-path="url(#{unique_id}-clip-terminal)">
{backgrounds}
<g class="{unique_id}-matrix">
{matrix}
</g>
</g>
</svg>
"""
"""rich's own form loads fonts from the network; a picture must not."""


class Terminal:
    """A command in a pseudo-terminal, and the screen that it writes."""

    def __init__(self, command: Sequence[str], variables: Mapping[str, str], columns: int, rows: int) -> None:
        """Starts the command in a process group of its own."""
        self._screen = pyte.HistoryScreen(columns, rows, history=1000)
        self._stream = pyte.ByteStream(self._screen)
        self._master, slave = pty.openpty()
        fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))
        environment = {**variables, "TERM": "xterm-256color", "COLUMNS": str(columns), "LINES": str(rows)}
        self._process = subprocess.Popen(
            list(command), stdin=slave, stdout=slave, stderr=slave, env=environment, start_new_session=True
        )
        os.close(slave)

    def run(self, seconds: float, until: str = "") -> None:
        """Reads what the command writes for `seconds`, or until it ends or has written the text `until`."""
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s and not (until and until in "\n".join(self._screen.display)):
            ready, _, _ = select.select([self._master], [], [], 0.2)
            if ready:
                try:
                    data = os.read(self._master, 65536)
                except OSError:  # the command has ended
                    return
                self._stream.feed(data)

    def end(self) -> None:
        """Ends the command as Ctrl-C would."""
        if self._process.poll() is None:
            os.killpg(self._process.pid, signal.SIGINT)
            self.run(10.0)
        try:
            self._process.wait(10.0)
        except subprocess.TimeoutExpired:
            os.killpg(self._process.pid, signal.SIGKILL)
        os.close(self._master)

    def lines(self) -> List[Text]:
        """Returns the screen with its colours, without empty lines at the end."""
        lines = []
        for row in range(self._screen.lines):
            cells = self._screen.buffer[row]
            line = Text()
            for column in range(self._screen.columns):
                cell = cells[column]
                line.append(cell.data, Style(color=_color(cell.fg), bold=cell.bold))
            line.rstrip()
            lines.append(line)
        while lines and not lines[-1].plain.strip():
            lines.pop()
        return lines


def _color(name: str) -> Color:
    if name == "default":
        return Color.default()
    if len(name) == 6 and all(digit in "0123456789abcdef" for digit in name):
        return Color.parse(f"#{name}")
    return Color.parse({"brown": "yellow"}.get(name, name.replace("bright", "bright_")))


def draw(name: str, title: str, parts: Sequence[Text], columns: int) -> None:
    """Writes the lines of a screen as `name`.svg."""
    console = Console(record=True, width=columns, file=open(os.devnull, "w"), force_terminal=True)
    for part in parts:
        console.print(part, no_wrap=True, overflow="crop", highlight=False)
    console.save_svg(str(HERE / f"{name}.svg"), title=title, code_format=_SVG, unique_id=name.replace("_", "-"))
    print(f"{name}.svg: {len(parts)} lines")


class Scene(NamedTuple):
    """One picture."""

    needs: str
    """Program without which the scene is skipped."""
    make: Callable[[Dict[str, str]], None]


def live_view(variables: Dict[str, str]) -> None:
    """The live table of `robot-health run` after the battery's first alerts."""
    command = [sys.executable, "-m", PACKAGE, "run", "--robot", "robot1"]
    terminal = Terminal(command, {**variables, "PYTHONPATH": str(ROOT)}, 110, 20)
    terminal.run(130.0, until="battery_level ERROR")
    terminal.run(3.0)
    lines = terminal.lines()
    terminal.end()
    draw("live_view", "make run", lines, 110)


def colcon(variables: Dict[str, str]) -> None:
    """`colcon build` of this package in a workspace."""
    with tempfile.TemporaryDirectory() as folder:
        workspace = Path(folder)
        (workspace / "src").mkdir()
        ignore = shutil.ignore_patterns(".*", "build", "install", "log")
        shutil.copytree(ROOT, workspace / "src" / PACKAGE, ignore=ignore)
        command = "cd ~/ros2_ws && colcon build --packages-select robot_health_monitor"
        script = f"cd {shlex.quote(folder)} && colcon build --packages-select {PACKAGE}"
        terminal = Terminal(["bash", "-c", script], {**variables, "ROS_VERSION": "2"}, 100, 24)
        terminal.run(120.0, until="Summary:")
        terminal.run(2.0)
        lines = terminal.lines()
        terminal.end()
    draw("colcon_build", "colcon build", [_prompt(command), *lines], 100)


def ros1(variables: Dict[str, str]) -> None:
    """The three nodes under roslaunch, and what rostopic shows of them."""
    launch = f"roslaunch {PACKAGE} health_monitor.launch"
    _nodes("ros1", launch, ["rostopic list", "rostopic hz /battery_level"], variables)


def ros2(variables: Dict[str, str]) -> None:
    """The three nodes under ros2 launch, and what ros2 topic shows of them."""
    launch = f"ros2 launch {PACKAGE} health_monitor.launch.py"
    _nodes("ros2", launch, ["ros2 topic list", "ros2 topic hz /battery_level"], variables)


def _nodes(name: str, launch: str, looks: Sequence[str], variables: Dict[str, str]) -> None:
    launched = Terminal(shlex.split(launch), variables, 140, 40)
    launched.run(25.0)
    seen: List[Text] = []
    for look in looks:
        terminal = Terminal(shlex.split(look), variables, 100, 16)
        terminal.run(8.0)
        seen += [_prompt(look), *terminal.lines(), Text("")]
        terminal.end()
    launched.run(90.0, until="battery_level WARN")
    lines = launched.lines()
    launched.end()
    draw(f"{name}_launch", launch, [_prompt(launch), *lines], 140)
    draw(f"{name}_topics", looks[0], seen, 100)


def _prompt(command: str) -> Text:
    return Text(f"$ {command}", Style(bold=True))


SCENES = {
    "live_view": Scene(sys.executable, live_view),
    "colcon": Scene("colcon", colcon),
    "ros1": Scene("roslaunch", ros1),
    "ros2": Scene("ros2", ros2),
}


def main(names: Sequence[str]) -> int:
    """Makes the scenes of `names`, all without any; returns the exit code."""
    unknown = [name for name in names if name not in SCENES]
    if unknown:
        print(f"unknown scene {unknown[0]}: expected one of {', '.join(SCENES)}", file=sys.stderr)
        return 2
    for name in names or SCENES:
        scene = SCENES[name]
        if shutil.which(scene.needs) is None:
            print(f"{name}: skipped, {scene.needs} is not installed")
            continue
        scene.make({name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"})
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
