"""The command line: `robot-health`, or `python -m robot_health_monitor`.

Interrupts, exit codes and broken output, for every command. Everything else is imported once an interrupt can end the
process cleanly.
"""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING, Callable, Dict, Optional, Sequence

from robot_health_monitor.runtime.interrupts import Interrupts

if TYPE_CHECKING:
    import argparse

FINE, ALERTS_FOUND, WRONG_USAGE, FAILED = 0, 1, 2, 3
"""Exit codes: success; alerts were found, or a test failed; usage or configuration error; the command itself failed."""

_LIBRARIES = {
    "yaml": "PyYAML is not installed: it reads configuration files",
    "aiohttp": "aiohttp is not installed: it connects to rosbridge servers",
    "cbor2": "cbor2 is not installed: it decodes messages of rosbridge servers",
    **{
        name: f"{name} is not installed: it reads recordings; pip install lz4 mcap numpy rosbags zstandard"
        for name in ("rosbags", "mcap", "numpy", "zstandard", "lz4")
    },
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
        except BrokenPipeError:  # the reader has seen enough, as `| head`
            _abandon_stdout()
            return FINE
        except ModuleNotFoundError as error:
            return _fail(_LIBRARIES.get(error.name or "", f"{error.name} is not installed"))
        except OSError as error:
            _abandon_stdout()
            return _fail(f"the output cannot be written: {error.strerror or error}")
        except Exception as error:
            _abandon_stdout()
            return _fail(f"internal error: {_place_of(error)}{type(error).__name__}: {error}")


def _run_command(argv: Optional[Sequence[str]], interrupts: Interrupts) -> int:
    from robot_health_monitor.core.errors import ConfigError

    from .arguments import parse
    from .output.display import OutputError

    try:
        arguments = parse(argv)
    except SystemExit as end:  # help, the version or wrong usage; its output is yet to be flushed
        return int(end.code or FINE)
    commands: Dict[str, Callable[[], int]] = {
        "run": lambda: _run(arguments, interrupts),
        "connect": lambda: _connect(arguments, interrupts),
        "check": lambda: _check(arguments),
        "sources": lambda: _sources(arguments),
        "replay": lambda: _replay(arguments),
        "suggest": lambda: _suggest(arguments),
        "test": lambda: _test(arguments),
        "notify": lambda: _notify(arguments),
        "export": lambda: _export(arguments),
        "silence": lambda: _silence(arguments),
        "history": lambda: _history(arguments),
    }
    try:
        return commands[arguments.command]()
    except ConfigError as error:
        for each in error.all:
            _write_error(str(each) if each.file else f"robot-health {arguments.command}: {each}")
        return WRONG_USAGE
    except OutputError as error:
        return _fail(str(error))


def _run(arguments: argparse.Namespace, interrupts: Interrupts) -> int:
    interrupts.take_hangups()
    from .run_command import run

    return ALERTS_FOUND if run(arguments, interrupts) else FINE


def _connect(arguments: argparse.Namespace, interrupts: Interrupts) -> int:
    interrupts.take_hangups()
    from .connect_command import connect

    return ALERTS_FOUND if connect(arguments, interrupts) else FINE


def _check(arguments: argparse.Namespace) -> int:
    from .check_command import check

    return FINE if check(arguments.files) else WRONG_USAGE


def _sources(arguments: argparse.Namespace) -> int:
    from .sources_command import show_sources

    show_sources(arguments.json)
    return FINE


def _replay(arguments: argparse.Namespace) -> int:
    def run() -> int:
        from .replay_command import replay

        return ALERTS_FOUND if replay(arguments) else FINE

    return _read_recordings(run)


def _suggest(arguments: argparse.Namespace) -> int:
    def run() -> int:
        from .suggest_command import suggest_thresholds

        suggest_thresholds(arguments)
        return FINE

    return _read_recordings(run)


def _silence(arguments: argparse.Namespace) -> int:
    from .silence_command import silence

    silence(arguments)
    return FINE


def _history(arguments: argparse.Namespace) -> int:
    from .history_command import show_history

    show_history(arguments)
    return FINE


def _read_recordings(run: Callable[[], int]) -> int:
    """Runs a command that reads recordings; `run` imports it, which needs libraries."""
    from robot_health_monitor.recordings.recording import MissingLibraryError, RecordingError

    try:
        return run()
    except MissingLibraryError as error:
        return _fail(str(error))
    except RecordingError as error:
        _write_error(str(error))
        return WRONG_USAGE
    except KeyboardInterrupt:  # half a verdict must not look like success
        return _fail("interrupted before the end of the recordings")


def _test(arguments: argparse.Namespace) -> int:
    from .test_command import run_tests

    return run_tests(arguments.files)


def _export(arguments: argparse.Namespace) -> int:
    from .export_command import export

    export(arguments)
    return FINE


def _notify(arguments: argparse.Namespace) -> int:
    from .notify_command import notify

    return FINE if notify(arguments.file, arguments.hold) else FAILED


def _prepare_streams() -> None:
    """Ensures that stdout and stderr exist, and that they accept every character."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:  # the parent process closed it
            setattr(sys, name, open(os.devnull, "w"))  # lasts as long as the process
        elif hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


def _abandon_stdout() -> None:
    """Discards what Python flushes at its end."""
    try:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except (OSError, ValueError):
        pass  # it has no file descriptor


def _fail(text: str) -> int:
    _write_error(f"robot-health: {text}")
    return FAILED


def _write_error(text: str) -> None:
    from robot_health_monitor.core.formatting import printable

    try:
        sys.stderr.write(f"{printable(text)}\n")
        sys.stderr.flush()
    except OSError:
        pass  # the exit code is all that is left


def _place_of(error: BaseException) -> str:
    """Returns file and line of the code that raised an error, for a report of the bug."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    if trace is None:
        return ""
    return f"{os.path.basename(trace.tb_frame.f_code.co_filename)}:{trace.tb_lineno}: "


if __name__ == "__main__":
    sys.exit(main())
