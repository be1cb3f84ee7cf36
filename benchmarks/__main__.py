"""The benchmarks: measures, then prints one table. `make bench` prepares their environment and starts them.

Exit code 1 when a requirement is missed.
"""

from __future__ import annotations

import argparse
import importlib
import sys
from typing import Any

from benchmarks.processes import compile_source
from benchmarks.table import PAGE, Row, changed_files, table, version, write_page

PARTS: dict[str, str] = {
    "observe": "observe.rows", "messages": "ros_nodes.rows", "signals": "ros_nodes.rows", "statuses": "ros_nodes.rows",
    "black_box": "ros_nodes.rows", "host": "host.rows", "footprint": "ros_nodes.rows", "graph": "ros_nodes.rows",
    "rosbridge": "sockets.rosbridge", "recordings": "recordings.rows", "history": "store.history",
    "samples": "store.samples", "notifications": "notifications.rows", "web": "sockets.web", "fleet": "sockets.fleet",
    "forecast": "forecasts.alarms", "cells": "forecasts.cells",
}  # fmt: skip
"""Module and function of each part. That of `ros_nodes` takes the part."""


def main() -> int:
    """Runs the requested parts."""
    parser = argparse.ArgumentParser(prog="benchmarks", description="Measures, then prints one table.")
    parser.add_argument("part", nargs="*", help=f"what to measure: {', '.join(PARTS)}; left out: everything")
    parser.add_argument("--write", action="store_true", help=f"measure everything and write the tables of {PAGE.name}")
    arguments = parser.parse_args()
    if not set(arguments.part) <= PARTS.keys():
        parser.error(f"expected parts among {', '.join(PARTS)}")
    if arguments.write and (arguments.part or changed_files()):
        parser.error(f"--write measures every part of a commit; changed files:\n{changed_files() or 'none'}")
    compile_source(sys.executable)
    measured: dict[str, list[Row]] = {}
    for part in arguments.part or PARTS:
        print(f"measuring {part} ...", file=sys.stderr, flush=True)
        module, _, function = PARTS[part].partition(".")
        rows_of: Any = getattr(importlib.import_module(f"benchmarks.{module}"), function)
        measured[part] = list(rows_of(part) if module == "ros_nodes" else rows_of())
    rows = [row for part in measured.values() for row in part]
    print(table(rows))
    if arguments.write:
        write_page(measured, version())
    return 1 if any(row.verdict == "missed" for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
