"""The command line: `robot-health`, or `python -m robot_health_monitor`.

Modules are imported where they are used, so that an interrupt finds this one ready to end cleanly from the start.
"""

from __future__ import annotations

import argparse
import io
import os
import signal
import sys
from typing import TYPE_CHECKING, Any, Callable, List, NoReturn, Optional, Sequence

if TYPE_CHECKING:
    from .core.yaml_file import YamlFile
    from .embedded import Output

FINE, ALERTS_FOUND, WRONG = 0, 1, 2
"""Exit codes: fine; the run found alerts, where judging was its job; usage or configuration."""


def main(argv: Optional[Sequence[str]] = None) -> int:
    """Runs the command line.

    Args:
        argv: the arguments; None: those of the process.

    Returns:
        The exit code.
    """
    with Interrupts() as interrupts:
        try:
            _prepare_streams()
            arguments = _parser().parse_args(argv)
            code = int(arguments.command(arguments, interrupts))
            sys.stdout.flush()
            return code
        except KeyboardInterrupt:
            return FINE
        except BrokenPipeError:  # whoever read has seen enough
            _abandon_stdout()
            return FINE
        except _ExpectedError as error:
            print(error, file=sys.stderr)
            return WRONG
        except OSError as error:
            _abandon_stdout()
            print(f"robot-health: the output cannot be written: {error.strerror or error}", file=sys.stderr)
            return WRONG


class _ExpectedError(Exception):
    """Something that the user can set right. `str()` is the line that says so."""


def _prepare_streams() -> None:
    """Makes sure that stdout and stderr are there, and that no character is too much for them."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:  # closed by whoever started us
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115: it lasts as long as the process
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _abandon_stdout() -> None:
    """Lets the flush at Python's end go into nothing."""
    try:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except (OSError, ValueError):
        pass  # no file below it


class Interrupts:
    """Turns SIGINT and SIGTERM into a clean end: KeyboardInterrupt, or a call of `on_interrupt` once that is set."""

    def __init__(self) -> None:
        """Changes nothing yet."""
        self.on_interrupt: Optional[Callable[[], object]] = None
        self._interrupted = False
        self._before: List[Any] = []

    def __enter__(self) -> Interrupts:
        """Takes the signals."""
        try:
            self._before = [(number, signal.signal(number, self._handle)) for number in _ENDING_SIGNALS]
        except ValueError:
            pass  # not in the main thread, which is the only one that signals reach
        return self

    def __exit__(self, *error: object) -> None:
        """Gives the signals back."""
        for number, handler in self._before:
            signal.signal(number, handler)

    def _handle(self, number: int, frame: object) -> None:
        if self.on_interrupt is not None:
            self.on_interrupt()
        elif not self._interrupted:  # a second one must not disturb the clean end
            self._interrupted = True
            raise KeyboardInterrupt


_ENDING_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        """Says in one line what is wrong; argparse itself prints the usage as well."""
        self.exit(WRONG, f"{self.prog}: {message}; see {self.prog} --help\n")


class _ShowVersion(argparse.Action):
    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        from .installed_files import version

        print(f"robot-health {version()}")
        parser.exit()


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="robot-health",
        description="Watches the health of a robot: battery, temperature, CPU and any other signal.",
        epilog="Exit codes: 0 fine, 1 the run found alerts (run --duration), 2 usage or configuration.",
    )
    parser.add_argument("--version", action=_ShowVersion, nargs=0, help="show the version and exit")
    commands = parser.add_subparsers(metavar="COMMAND", required=True, parser_class=_Parser)
    _add_run(commands)
    _add_check(commands)
    return parser


def _add_run(commands: Any) -> None:
    command = commands.add_parser(
        "run",
        help="monitor in this one process, without ROS",
        description="Runs battery_sensor, aggregator and alert_system in this one process, without ROS. "
        "A terminal shows a live table, a pipe plain lines.",
    )
    command.add_argument("--thresholds", metavar="FILE", help="configuration (default: the one that is installed)")
    command.add_argument("--robot", metavar="NAME", default="", help="the robot's name (default: this host's)")
    command.add_argument(
        "--source",
        choices=("simulated", "host"),
        default="",
        help="where the metrics come from (default: as configured)",
    )
    command.add_argument(
        "--duration",
        metavar="SECONDS",
        type=_positive_seconds,
        help="end after this time, with exit code 1 if there were alerts",
    )
    command.add_argument("--json", action="store_true", help="one JSON object per alert on stdout, the log on stderr")
    command.add_argument(
        "--log-level",
        choices=("DEBUG", "INFO", "WARN", "ERROR", "FATAL"),
        default="INFO",
        help="least severe log lines to show; alerts are always shown (default: INFO)",
    )
    command.set_defaults(command=_run)


def _add_check(commands: Any) -> None:
    command = commands.add_parser(
        "check",
        help="say whether a thresholds.yaml is right, without starting anything",
        description="Reads configuration files as the nodes would, and says what is wrong with the first wrong key.",
    )
    command.add_argument("files", metavar="FILE", nargs="+", help="a thresholds.yaml")
    command.set_defaults(command=_check)


def _positive_seconds(text: str) -> float:
    try:
        seconds = float(text)
    except ValueError:
        seconds = 0.0
    if not 0.0 < seconds < 1e9:
        raise argparse.ArgumentTypeError(f"found {text!r}, allowed is a number of seconds above 0")
    return seconds


def _check(arguments: argparse.Namespace, interrupts: Interrupts) -> int:
    code = FINE
    for file in arguments.files:
        try:
            print(f"{file}: OK: {_summary(file)}")
        except _ExpectedError as error:
            print(error, file=sys.stderr)
            code = WRONG
    return code


def _summary(file: str) -> str:
    """Returns what a configuration file holds, once the nodes accept it."""
    from .core.parameters import ConfigError
    from .embedded import EmbeddedMonitor

    read = _read(file)
    try:
        monitor = EmbeddedMonitor(read)
    except ConfigError as error:
        raise _ExpectedError(error) from None
    monitor.close()
    signals = monitor.alert_system.monitor.config.signals
    bounds = sum(len(signal.bounds) for signal in signals.values())
    return (
        f"{len(signals)} signal{'s' * (len(signals) != 1)} ({', '.join(signals)}), {bounds} bound{'s' * (bounds != 1)}"
        + (f"; not used here: {', '.join(monitor.unused_sections)}" if monitor.unused_sections else "")
    )


def _read(file: str) -> YamlFile:
    from .core.parameters import ConfigError
    from .core.yaml_file import read_yaml

    try:
        return read_yaml(file)
    except ConfigError as error:
        raise _ExpectedError(error) from None
    except ImportError:
        raise _ExpectedError("PyYAML is not installed, which reads configuration files: install python3-yaml") from None


def _run(arguments: argparse.Namespace, interrupts: Interrupts) -> int:
    import asyncio

    from .core.middleware import Severity
    from .core.parameters import ConfigError
    from .embedded import EmbeddedMonitor, clock, run
    from .installed_files import find_installed
    from .lines import Events

    file = arguments.thresholds or find_installed("config/thresholds.yaml")
    events = Events(Severity[arguments.log_level])
    now_s = clock()
    try:
        monitor = EmbeddedMonitor(
            _read(str(file)) if file else None,
            robot=arguments.robot,
            source=arguments.source,
            start_s=now_s(),
            on_log=events.on_log,
            on_transition=events.on_transition,
        )
    except ConfigError as error:
        raise _ExpectedError(error) from None

    async def run_until_stopped() -> bool:
        """Returns whether it ended by itself."""
        loop = asyncio.get_running_loop()
        stop = asyncio.Event()
        interrupts.on_interrupt = lambda: loop.call_soon_threadsafe(stop.set)
        output.attach(loop, monitor)
        try:
            running = asyncio.ensure_future(run(monitor.bus, now_s, stop, lambda: output.show(events.take(), monitor)))
            done, _ = await asyncio.wait({running}, timeout=arguments.duration)
            stop.set()
            await running
            return not done
        finally:
            interrupts.on_interrupt = lambda: None  # the end is under way

    output = _choose_output(arguments.json)
    try:
        ended_by_itself = asyncio.run(run_until_stopped())
        output.show(events.take(), monitor)
    finally:
        output.close()
        monitor.close()
    return ALERTS_FOUND if ended_by_itself and events.alerts else FINE


def _choose_output(as_json: bool) -> Output:
    from .lines import JsonOutput, PlainOutput

    if as_json:
        return JsonOutput(sys.stdout, sys.stderr)
    if not sys.stdout.isatty() or os.environ.get("TERM", "dumb") == "dumb":
        return PlainOutput(sys.stdout)
    try:
        from .live_view import LiveView
    except ImportError:
        print("rich is not installed, which draws the live table: plain lines instead", file=sys.stderr)
        return PlainOutput(sys.stdout)
    return LiveView(sys.stdout)


if __name__ == "__main__":
    sys.exit(main())
