"""The command line: `robot-health`, or `python -m robot_health_monitor`.

Here is what every command shares: interrupts, exit codes, what happens when the output breaks. All else is imported
once an interrupt finds this ready to end cleanly.
"""

from __future__ import annotations

import os
import signal
import sys
from typing import Any, Callable, List, Optional, Sequence

FINE, ALERTS_FOUND, WRONG = 0, 1, 2
"""Exit codes: fine; the run found alerts, where judging was its job; usage or configuration."""

_ENDING_SIGNALS = (signal.SIGINT, signal.SIGTERM)


_LIBRARIES = {
    "yaml": "PyYAML is not installed, which reads configuration files",
    "aiohttp": "aiohttp is not installed, which connects to rosbridge servers",
    "cbor2": "cbor2 is not installed, which reads messages of rosbridge servers",
}


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
            code = _run_command(argv, interrupts)
            sys.stdout.flush()
            return code
        except KeyboardInterrupt:
            return FINE
        except BrokenPipeError:  # whoever read has seen enough
            _abandon_stdout()
            return FINE
        except OSError as error:
            _abandon_stdout()
            print(f"robot-health: the output cannot be written: {error.strerror or error}", file=sys.stderr)
            return WRONG


def _run_command(argv: Optional[Sequence[str]], interrupts: Interrupts) -> int:
    from robot_health_monitor.core.errors import ConfigError

    from .arguments import parse

    try:
        arguments = parse(argv)
    except SystemExit as end:  # help, the version, or wrong usage; what it wrote is still to be flushed
        return int(end.code or FINE)
    try:
        if arguments.command == "run":
            from .run_command import run

            alerts_found = run(arguments, interrupts)
            return ALERTS_FOUND if alerts_found else FINE
        if arguments.command == "connect":
            from .connect_command import connect

            alerts_found = connect(arguments, interrupts)
            return ALERTS_FOUND if alerts_found else FINE
        if arguments.command == "sources":
            from .sources_command import show_sources

            show_sources(arguments.json)
            return FINE
        from .check_command import check

        return FINE if check(arguments.files) else WRONG
    except ModuleNotFoundError as error:
        purpose = _LIBRARIES.get(error.name or "")
        if purpose is None:
            raise
        print(f"robot-health: {purpose}", file=sys.stderr)
        return WRONG
    except ConfigError as error:
        print(str(error).replace("\n", "\\n"), file=sys.stderr)  # one line, whatever a file's name holds
        return WRONG


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
        """Gives the signals back; after an interrupt, a second one must not disturb the clean end of the process."""
        if self._interrupted:
            # Not SIG_IGN: Python complains of a race when a signal comes while its handler changes.
            signal.pthread_sigmask(signal.SIG_BLOCK, _ENDING_SIGNALS)
            return
        for number, handler in self._before:
            signal.signal(number, handler)

    def _handle(self, number: int, frame: object) -> None:
        first, self._interrupted = not self._interrupted, True
        if self.on_interrupt is not None:
            self.on_interrupt()
        elif first:
            raise KeyboardInterrupt


def _prepare_streams() -> None:
    """Makes sure that stdout and stderr are there, and that no character is too much for them."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:  # closed by whoever started us
            setattr(sys, name, open(os.devnull, "w"))  # lasts as long as the process
        elif hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


def _abandon_stdout() -> None:
    """Lets the flush at Python's end go into nothing."""
    try:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except (OSError, ValueError):
        pass  # no file below it


if __name__ == "__main__":
    sys.exit(main())
