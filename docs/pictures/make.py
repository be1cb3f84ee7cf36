"""Makes the pictures of the README and of docs/ from real runs: `python docs/pictures/make.py [SCENE ...]`.

Each scene runs real commands in a pseudo-terminal and draws the final screen as SVG. The scenes `ros1` and `ros2` copy
this package into a new workspace, build it and launch it. A scene whose program is missing here (`roslaunch`,
`ros2`, `colcon`) is skipped with one line. The path of the temporary folder and the host name are replaced by neutral
ones. Needs pyte and rich; the scene `web_page` needs selenium.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import shlex
import shutil
import socket
import subprocess
import sys
import tempfile
from pathlib import Path
from types import MappingProxyType
from typing import Any, Mapping, Sequence

from rich.color import Color
from rich.console import Console
from rich.style import Style
from rich.text import Text

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]
from harness.terminal_process import TerminalProcess  # noqa: E402  # found through the line above

PACKAGE = "robot_health_monitor"
_PROGRAM = f"{shlex.quote(sys.executable)} -m {PACKAGE}"
_SVG = (HERE / "terminal.svg").read_text("utf-8")
"""rich's default template loads fonts from the network; a picture must not."""


class Terminal(TerminalProcess):
    """A shell command in a pseudo-terminal, and the screen that it writes."""

    def __init__(self, command: str, variables: Mapping[str, str], columns: int, rows: int) -> None:
        """Starts the command in a new process group."""
        variables = {**variables, "TERM": "xterm-256color", "COLUMNS": str(columns), "LINES": str(rows)}
        super().__init__(["bash", "-c", command], variables, columns=columns, lines=rows)

    def run(self, seconds: float, until: str = "", then_s: float = 0.0) -> None:
        """Reads what the command writes for `seconds`, or until it ends or shows `until`, and `then_s` longer."""
        for longest_s, wanted in ((seconds, until), (then_s, "")):
            with contextlib.suppress(AssertionError):  # it has not come
                self.wait_until(lambda text, wanted=wanted: bool(wanted) and wanted in text, longest_s)

    def end(self) -> None:
        """Ends the command as Ctrl-C would."""
        self.type("\x03")
        self.run(10.0)
        super().end()

    def lines(self, replaced: Mapping[str, str] = MappingProxyType({})) -> list[Text]:
        """Returns the screen with its colours, without empty lines at the end, and with texts replaced."""
        lines = []
        for row in range(self.screen.lines):
            cells = [self.screen.buffer[row][column] for column in range(self.screen.columns)]
            for old, new in replaced.items():
                while old in (written := "".join(cell.data for cell in cells)):
                    start = written.index(old)
                    cells[start : start + len(old)] = [cells[start]._replace(data=character) for character in new]
            line = Text()
            for (color, ground, bold), run in itertools.groupby(cells, lambda cell: (cell.fg, cell.bg, cell.bold)):
                style = Style(color=_color(color), bgcolor=_color(ground), bold=bold)
                line.append("".join(cell.data for cell in run), style)
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
    return Color.parse(name.replace("bright", "bright_").replace("brown", "yellow"))


def draw(name: str, parts: Sequence[Text], columns: int) -> None:
    """Writes the lines of a screen as `name`.svg."""
    console = Console(record=True, width=columns, file=open(os.devnull, "w"), force_terminal=True)
    for part in [*parts, Text("")]:  # an empty line: the picture's edge would cut off underscores
        console.print(part, no_wrap=True, overflow="crop", highlight=False)
    console.save_svg(str(HERE / f"{name}.svg"), title="", code_format=_SVG, unique_id=name.replace("_", "-"))
    print(f"{name}.svg: {len(parts)} lines")


def screen(
    command: str,
    variables: Mapping[str, str],
    size: tuple[int, int],
    replaced: Mapping[str, str] = MappingProxyType({}),
    **end: Any,
) -> list[Text]:
    """Returns what a command shows at its `end`, the arguments of `Terminal.run`."""
    terminal = Terminal(command, variables, *size)
    terminal.run(**end)
    lines = terminal.lines(replaced)
    terminal.end()
    return lines


def live_view(folder: Path, variables: Mapping[str, str]) -> None:
    """The live table of `robot-health run` after the battery's first alerts."""
    end = {"seconds": 130.0, "until": "battery_level ERROR", "then_s": 3.0}
    lines = screen(f"{_PROGRAM} run --robot robot1", variables, (110, 13), **end)
    draw("live_view", [_prompt("make run"), *lines], 110)


def recordings(folder: Path, variables: Mapping[str, str]) -> None:
    """`suggest`, `replay` and `test` on recordings, and the report; needs the extra [recordings]."""
    from past import record

    for seed in (1, 2):
        record(folder / f"healthy{seed}.bag", seed, 2.0)
    record(folder / "night.bag", 3, 2.0, broken=True)
    shutil.copy(HERE / "thresholds.test.yaml", folder)
    for picture, columns, arguments in (
        ("suggest", 132, "suggest healthy1.bag healthy2.bag > thresholds.yaml && cat thresholds.yaml"),
        ("replay", 132, "replay night.bag --thresholds thresholds.yaml --report night.html"),
        ("test", 124, "test thresholds.test.yaml"),
    ):
        command = f"cd {folder} && {_PROGRAM} {arguments}"
        lines = screen(command, variables, (columns, 40), {str(folder): "."}, seconds=60.0)
        draw(picture, [_prompt(f"robot-health {arguments}"), *lines], columns)
    if shutil.which("chromedriver"):
        from web_page import report

        report(folder / "night.html")


def web_page(folder: Path, variables: Mapping[str, str]) -> None:
    """The web page of one robot with a forecast, a day and an alert, and of a fleet on a wide and a narrow window."""
    import web_page as pictures

    pictures.one_robot(folder, variables)
    pictures.fleet(folder, variables)


def ros1(folder: Path, variables: Mapping[str, str]) -> None:
    """The three nodes under roslaunch, and what rostopic shows of them."""
    workspace = Workspace(folder, variables)
    workspace.build("catkin_make", "devel/setup.bash")
    launch = f"roslaunch {PACKAGE} health_monitor.launch robot_name:=robot1"
    workspace.nodes("ros1", launch, ["rostopic list", "rostopic hz /robot1/battery_level"], first="NODES")


def ros2(folder: Path, variables: Mapping[str, str]) -> None:
    """`colcon build`, the three nodes under ros2 launch, and what ros2 topic shows of them."""
    workspace = Workspace(folder, variables)
    build = f"colcon build --packages-select {PACKAGE}"
    draw("colcon_build", [_prompt(build), *workspace.build(build, "install/setup.bash")], 100)
    launch = f"ros2 launch {PACKAGE} health_monitor.launch.py robot_name:=robot1"
    workspace.nodes("ros2", launch, ["ros2 topic list", "ros2 topic hz /robot1/battery_level"])


class Workspace:
    """A copy of this package in a new workspace, inside a new home folder."""

    def __init__(self, home: Path, variables: Mapping[str, str]) -> None:
        """Copies the package.

        Args:
            home: an empty folder.
            variables: environment of the commands.
        """
        self._folder = home / "ws"
        self._variables = {**variables, "HOME": str(home)}
        self._replaced = {str(home): "/home/user", socket.gethostname(): "robot1"}
        ignored = shutil.ignore_patterns(".*", "build", "install", "log", "__pycache__")
        shutil.copytree(ROOT, self._folder / "src" / PACKAGE, ignore=ignored)

    def build(self, command: str, setup: str) -> list[Text]:
        """Runs a build, then sources `setup`; returns the screen."""
        command = f"cd {self._folder} && {command}"
        lines = screen(command, self._variables, (100, 24), self._replaced, seconds=120.0)
        if not (self._folder / setup).exists():
            raise RuntimeError("\n".join(line.plain for line in lines))
        script = f"source {self._folder / setup} >&2 && env -0"
        sourced = subprocess.run(["bash", "-c", script], env=self._variables, stdout=subprocess.PIPE, check=True)
        self._variables = dict(entry.split("=", 1) for entry in sourced.stdout.decode().split("\0") if "=" in entry)
        return lines

    def nodes(self, name: str, launch: str, looks: Sequence[str], *, first: str = "") -> None:
        """Draws the launched nodes until the first alert of the battery, and the commands that look at them.

        Args:
            name: prefix of the pictures.
            launch: command that starts the nodes.
            looks: commands that inspect the running nodes.
            first: beginning of the first line of the launched nodes to draw; empty: the first of all.
        """
        launched = Terminal(launch, self._variables, 200, 48)
        launched.run(20.0)
        seen: list[Text] = []
        for look in looks:
            lines = screen(look, self._variables, (70, 24), self._replaced, seconds=12.0, until="window: 4")
            seen += [_prompt(look), *lines, Text("")]
        launched.run(100.0, until="battery_level WARN", then_s=2.0)
        lines = launched.lines(self._replaced)
        launched.end()
        if first:
            begin = next(row for row, line in enumerate(lines) if line.plain.startswith(first))
            lines = [Text("..."), *lines[begin:]]
        columns = max(len(line.plain) for line in lines) + 1
        draw(f"{name}_launch", [_prompt(launch), *lines], columns)
        draw(f"{name}_topics", seen[:-1], 70)


def _prompt(command: str) -> Text:
    return Text(f"$ {command}", Style(bold=True))


_HERE_AS_IT_IS = {"PYTHONPATH": str(ROOT), "TZ": "UTC"}
SCENES = {
    "live_view": (live_view, sys.executable, _HERE_AS_IT_IS),
    "recordings": (recordings, sys.executable, _HERE_AS_IT_IS),
    "web_page": (web_page, "chromedriver", _HERE_AS_IT_IS),
    "ros1": (ros1, "roslaunch", {"ROS_HOSTNAME": "localhost"}),
    "ros2": (ros2, "ros2", {"ROS_VERSION": "2"}),
}
"""What makes each, the program without which it is skipped, and variables of its commands."""

if __name__ == "__main__":
    inherited = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    for scene in sys.argv[1:] or SCENES:
        make, needed, variables = SCENES[scene]
        if shutil.which(needed) is None:
            print(f"{scene}: skipped, {needed} is not installed")
            continue
        with tempfile.TemporaryDirectory() as folder:
            make(Path(folder), {**inherited, **variables})
