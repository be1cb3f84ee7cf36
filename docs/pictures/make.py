"""Makes the pictures of the README and of docs/ from real runs: `python docs/pictures/make.py [SCENE ...]`.

Most scenes run real commands in a pseudo-terminal and draw the final screen as SVG. The scenes `ros1` and `ros2` copy
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
import sys
import tempfile
from functools import partial
from pathlib import Path
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

    def lines(self, replaced: Mapping[str, str]) -> list[Text]:
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
    command: str, variables: Mapping[str, str], size: tuple[int, int], replaced: Mapping[str, str], **end: Any
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
    lines = screen(f"{_PROGRAM} run --robot robot1", variables, (110, 13), {}, **end)
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


def ros(name: str, build: str, setup: str, launch: str, topic: str, folder: Path, variables: Mapping[str, str]) -> None:
    """The three nodes until the first alert of the battery, and what looks at them.

    Args:
        name: prefix of the pictures.
        build: command that builds this package, in a new workspace.
        setup: file of the workspace that a shell sources then.
        launch: command that starts the nodes.
        topic: command that lists and inspects topics.
        folder: an empty folder, the home of the commands.
        variables: environment of the commands.
    """
    workspace = folder / "ws"
    replaced = {str(folder): "/home/user", socket.gethostname(): "robot1"}
    variables = {**variables, "HOME": str(folder)}
    ignored = shutil.ignore_patterns(".*", "build", "install", "log", "__pycache__")
    shutil.copytree(ROOT, workspace / "src" / PACKAGE, ignore=ignored)
    built = screen(f"cd {workspace} && {build}", variables, (100, 24), replaced, seconds=120.0)
    if not (workspace / setup).exists():
        raise RuntimeError("\n".join(line.plain for line in built))
    if "colcon" in build:
        draw("colcon_build", [_prompt(build), *built], 100)
    source = f"source {workspace / setup} > /dev/null && exec"
    launched = Terminal(f"{source} {launch}", variables, 200, 48)
    launched.run(20.0)
    looks: list[Text] = []
    for look in (f"{topic} list", f"{topic} hz /robot1/battery_level"):
        lines = screen(f"{source} {look}", variables, (70, 24), replaced, seconds=12.0, until="window: 4")
        looks += [_prompt(look), *lines, Text("")]
    launched.run(100.0, until="battery_level WARN", then_s=2.0)
    lines = launched.lines(replaced)
    launched.end()
    # roslaunch begins with what it has checked.
    begin = next((row for row, line in enumerate(lines) if line.plain.startswith("NODES")), 0)
    lines = [Text("..."), *lines[begin:]] if begin else lines
    draw(f"{name}_launch", [_prompt(launch), *lines], max(len(line.plain) for line in lines) + 1)
    draw(f"{name}_topics", looks[:-1], 70)


def _prompt(command: str) -> Text:
    return Text(f"$ {command}", Style(bold=True))


_THIS_TREE = {"PYTHONPATH": str(ROOT), "TZ": "UTC"}
_ROS1, _ROS2 = {"ROS_HOSTNAME": "localhost"}, {"ROS_VERSION": "2"}
_ROS1_LAUNCH = f"roslaunch {PACKAGE} health_monitor.launch robot_name:=robot1"
_ROS2_LAUNCH = f"ros2 launch {PACKAGE} health_monitor.launch.py robot_name:=robot1"
_COLCON = f"colcon build --packages-select {PACKAGE}"
SCENES = {
    "live_view": (live_view, sys.executable, _THIS_TREE),
    "recordings": (recordings, sys.executable, _THIS_TREE),
    "web_page": (web_page, "chromedriver", _THIS_TREE),
    "ros1": (partial(ros, "ros1", "catkin_make", "devel/setup.bash", _ROS1_LAUNCH, "rostopic"), "roslaunch", _ROS1),
    "ros2": (partial(ros, "ros2", _COLCON, "install/setup.bash", _ROS2_LAUNCH, "ros2 topic"), "ros2", _ROS2),
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
