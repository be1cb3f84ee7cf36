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
from typing import Any, Callable, Dict, Iterable, Iterator, List

from benchmarks.page import PAGE, changed_files, version, write_page
from benchmarks.table import Row, table

Part = Callable[[], Iterable[Row]]


def alone(module: str) -> Part:
    """Returns a part that a module measures."""
    return lambda: importlib.import_module(f"benchmarks.{module}").rows()


def node(*questions: str) -> Part:
    """Returns a part that compares the alert node with bare subscribers."""

    def measure(target: Any) -> Iterator[Row]:
        from benchmarks import node_cost

        yield from node_cost.rows(target, *(getattr(node_cost, question) for question in questions))

    return lambda: on_every_middleware(measure, ", ".join(questions))


def on_ros(module: str) -> Part:
    """Returns a part that a module measures on ROS 1 and on ROS 2."""
    return lambda: on_every_middleware(importlib.import_module(f"benchmarks.{module}").rows, module)


def in_turn(*parts: Part) -> Part:
    """Returns a part that consists of several."""
    return lambda: (row for part in parts for row in part())


PARTS: Dict[str, Part] = {
    "observe": alone("observe_cost"),
    "messages": node("MESSAGE"),
    "signals": node("FREQUENCY", "HUNDRED"),
    "statuses": node("DRIVERS"),
    "black_box": in_turn(node("BLACK_BOX"), on_ros("black_box_memory")),
    "host": alone("host_cost"),
    "footprint": on_ros("footprint"),
    "graph": on_ros("graph_cost"),
    "rosbridge": alone("rosbridge_cost"),
    "recordings": alone("recordings_cost"),
    "history": alone("history_cost"),
    "samples": alone("samples_cost"),
    "notifications": alone("notifications_cost"),
    "web": alone("web_cost"),
    "fleet": alone("fleet_cost"),
    "forecast": alone("forecast_alarms"),
    "cells": alone("forecast_cells"),
}


def on_every_middleware(measure: Callable[[Any], Iterable[Row]], what: str) -> Iterator[Row]:
    """Yields the rows for ROS 1 and for ROS 2, or one row with the reason why there are none.

    The variable BENCHMARK_TARGETS, which noxfile.py sets, holds the interpreter and the variables of each.
    """
    from benchmarks import targets

    available = json.loads(os.environ["BENCHMARK_TARGETS"])
    for name, place, start in (("ROS 1", "ros1", targets.ros1), ("ROS 2", "ros2", targets.ros2)):
        try:
            with start(available[place]["python"], available[place]["variables"]) as target:
                yield from measure(target)
        except (OSError, RuntimeError) as problem:
            yield Row(f"{name}, {what}", "", remark=str(problem))


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
    measured: Dict[str, List[Row]] = {}
    for part in asked:
        print(f"measuring {part} ...", file=sys.stderr, flush=True)
        measured[part] = list(PARTS[part]())
    print(table(row for part in measured.values() for row in part))
    if arguments.write:
        write_page(measured, version())
    return 1 if any(row.verdict == "missed" for part in measured.values() for row in part) else 0


if __name__ == "__main__":
    sys.exit(main())
