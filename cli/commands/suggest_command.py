"""`robot-health suggest`: thresholds from recordings of healthy robots."""

from __future__ import annotations

import argparse

from ...core.values.errors import ServiceError
from ...runtime.interrupts import Interrupts
from ..arguments import INTERRUPTED, Parser, add, add_recordings


def add_arguments(parser: Parser) -> None:
    """Adds the arguments of the command."""
    parser.description = (
        "Writes a thresholds.yaml to stdout, with the evidence for each value: for the arrivals of every "
        "periodic topic, the age of stamps, batteries, /diagnostics and every other number, or for the signals of "
        "--thresholds."
    )
    add_recordings(parser)
    add(parser, "--thresholds FILE", "suggest for the signals of this configuration")


def run(arguments: argparse.Namespace, interrupts: Interrupts) -> None:
    """Writes the thresholds."""
    try:
        from ..threshold_study import suggest_thresholds

        suggest_thresholds(arguments)
    except KeyboardInterrupt:  # half a result must not look like success
        raise ServiceError(INTERRUPTED) from None
