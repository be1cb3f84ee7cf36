"""The benchmarks: measures, then prints one table. `make bench` prepares their environment and starts them.

    make bench                     everything that can run here
    make bench ARGS=observe        one part, of those below
    make bench ARGS=--write        everything, and writes the tables of docs/reference/benchmarks.md

Exit code 1 when a requirement is missed.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import sys
from typing import Any, Iterator

from benchmarks.table import PAGE, Row, changed_files, table, version, write_page

PARTS: dict[str, str] = {
    "observe": "observe.rows", "messages": "ros_nodes.compare", "signals": "ros_nodes.compare",
    "statuses": "ros_nodes.compare", "black_box": "ros_nodes.compare", "host": "host.rows",
    "footprint": "ros_nodes.footprint", "graph": "ros_nodes.graph", "rosbridge": "rosbridge.rows",
    "recordings": "recordings.rows", "history": "store.history", "samples": "store.samples",
    "notifications": "notifications.rows", "web": "web.rows", "fleet": "fleet.rows", "forecast": "forecast.rows",
    "cells": "cells.rows",
}  # fmt: skip
"""Module and function of each part. Those of `ros_nodes` take a middleware and the part."""


def measure(part: str) -> Iterator[Row]:
    """Yields the rows of a part; on ROS those for ROS 1 and for ROS 2, or a row with the reason why there are none.

    The variable BENCHMARK_TARGETS, which noxfile.py sets, holds the interpreter and the variables of each.
    """
    module, _, function = PARTS[part].partition(".")
    rows: Any = getattr(importlib.import_module(f"benchmarks.{module}"), function)
    if module != "ros_nodes":
        yield from rows()
        return
    from benchmarks.processes import target

    for package, available in json.loads(os.environ["BENCHMARK_TARGETS"]).items():
        try:
            with target(package, available["python"], available["variables"]) as middleware:
                yield from rows(middleware, part)
        except (OSError, RuntimeError) as problem:
            yield Row(f"{package}, {part}", "", remark=str(problem))


def main() -> int:
    """Runs the requested parts."""
    parser = argparse.ArgumentParser(prog="benchmarks", description="Measures, then prints one table.")
    parser.add_argument("part", nargs="*", help=f"what to measure: {', '.join(PARTS)}; left out: everything")
    parser.add_argument("--write", action="store_true", help=f"measure everything and write the tables of {PAGE.name}")
    arguments = parser.parse_args()
    asked = arguments.part or list(PARTS)
    if not set(asked) <= PARTS.keys():
        parser.error(f"expected parts among {', '.join(PARTS)}")
    if arguments.write and arguments.part:
        parser.error("--write takes no part: all tables are of one version")
    if arguments.write and changed_files():
        parser.error(f"--write: commit first, the page names the commit:\n{changed_files()}")
    measured: dict[str, list[Row]] = {}
    for part in asked:
        print(f"measuring {part} ...", file=sys.stderr, flush=True)
        measured[part] = list(measure(part))
    rows = [row for part in measured.values() for row in part]
    print(table(rows))
    if arguments.write:
        write_page(measured, version())
    return 1 if any(row.verdict == "missed" for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
