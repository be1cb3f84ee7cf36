"""The command line: `robot-health`, or `python -m robot_health_monitor`.

Interrupts, exit codes and broken output, for every command. Everything else is imported once an interrupt can end the
process cleanly.
"""

from __future__ import annotations

import os
import sys
from typing import Sequence

from .cli.exit_codes import ExitCode, internal_error_text
from .runtime.interrupts import Interrupts


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line with these arguments, by default those of the process; returns the exit code."""
    with Interrupts() as interrupts:
        try:
            _prepare_streams()
            code = _run_command(argv, interrupts)
            sys.stdout.flush()
            return code
        except KeyboardInterrupt:
            return ExitCode.SUCCESS
        except BrokenPipeError:  # the reader has seen enough, as `| head`
            _abandon_stdout()
            return ExitCode.SUCCESS
        except ModuleNotFoundError as error:
            from .runtime.libraries import missing_libraries, missing_text

            return _fail(missing_text(missing_libraries(error)))
        except OSError as error:
            _abandon_stdout()
            return _fail(f"the output cannot be written: {error.strerror or error}")
        except Exception as error:
            _abandon_stdout()
            return _fail(internal_error_text(error))


def _run_command(argv: Sequence[str] | None, interrupts: Interrupts) -> int:
    from .cli.arguments import parse
    from .core.values.errors import ConfigError, LinkError, MessageError, ServiceError

    try:
        arguments = parse(argv)
    except SystemExit as end:  # help, the version or wrong usage; its output is yet to be flushed
        return int(end.code or ExitCode.SUCCESS)
    try:
        return int(arguments.run(arguments, interrupts) or ExitCode.SUCCESS)
    except ConfigError as error:
        for each in error.all:
            _write_error(str(each) if each.file else f"robot-health {arguments.command}: {each}")
        return ExitCode.USAGE
    except (MessageError, ServiceError, LinkError) as error:
        return _fail(str(error))


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
    return ExitCode.FAILED


def _write_error(text: str) -> None:
    from .core.values.formatting import printable

    try:
        sys.stderr.write(f"{printable(text)}\n")
        sys.stderr.flush()
    except OSError:
        pass  # the exit code is all that is left


if __name__ == "__main__":
    sys.exit(main())
