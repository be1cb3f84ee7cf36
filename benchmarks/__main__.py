"""The benchmarks: measures, then prints one table. `make bench` prepares their environment and starts them.

    make bench                     everything that can run here
    make bench ARGS=observe        one part: observe, messages, signals, statuses, black_box, host, footprint,
                                   rosbridge, recordings, history, notifications, web, fleet,
                                   forecast, cells, samples
    make bench ARGS=--write        everything, and writes the tables of docs/reference/benchmarks.md

Exit code 1 when a requirement is missed.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from typing import Any, Callable, Dict, Iterable, Iterator, List

from benchmarks.page import PAGE, changed_files, version, write_page
from benchmarks.table import Row, table


def observe() -> Iterator[Row]:
    """CPU time per sample."""
    from benchmarks import observe_cost

    yield from observe_cost.rows()


def messages() -> Iterator[Row]:
    """CPU time per message."""
    from benchmarks import message_cost

    yield from on_every_middleware(message_cost.rows, "one message at 1 kHz")


def signals() -> Iterator[Row]:
    """CPU time with many signals, and with one whose messages are only counted."""
    from benchmarks import signals_cost

    yield from on_every_middleware(signals_cost.rows, "many signals, and arrivals of one")


def statuses() -> Iterator[Row]:
    """CPU time with 200 statuses, each a signal of its own."""
    from benchmarks import statuses_cost

    yield from on_every_middleware(statuses_cost.rows, "200 statuses through one wildcard")


def black_box() -> Iterator[Row]:
    """CPU time of keeping the bytes of ten topics, and memory of recording a camera."""
    from benchmarks import black_box_cost, black_box_memory

    yield from on_every_middleware(black_box_cost.rows, "black box of ten topics")
    yield from on_every_middleware(black_box_memory.rows, "black box of a camera")


def host() -> Iterator[Row]:
    """CPU time of measuring this computer and its processes."""
    from benchmarks import host_cost

    yield from host_cost.rows()


def footprint() -> Iterator[Row]:
    """Memory and CPU of running nodes."""
    from benchmarks import footprint

    yield from on_every_middleware(footprint.rows, "memory and CPU")


def rosbridge() -> Iterator[Row]:
    """CPU time per delivered message, and memory of a client that never reads."""
    from benchmarks import rosbridge_cost

    yield from rosbridge_cost.rows()


def recordings() -> Iterator[Row]:
    """CPU time and memory of replays."""
    from benchmarks import recordings_cost

    yield from recordings_cost.rows()


def history() -> Iterator[Row]:
    """Time and memory of a long history."""
    from benchmarks import history_cost

    yield from history_cost.rows()


def samples() -> Iterator[Row]:
    """CPU time of the stored samples of 200 robots."""
    from benchmarks import samples_cost

    yield from samples_cost.rows()


def notifications() -> Iterator[Row]:
    """Time from a sample to its alert, with history and notifications."""
    from benchmarks import notifications_cost

    yield from notifications_cost.rows()


def web() -> Iterator[Row]:
    """CPU time of open pages, and the time of a scrape."""
    from benchmarks import web_cost

    yield from web_cost.rows()


def fleet() -> Iterator[Row]:
    """CPU time and memory of 200 robots that are watched by one process."""
    from benchmarks import fleet_cost

    yield from fleet_cost.rows()


def forecast() -> Iterator[Row]:
    """False alarms of forecasts, and how early they warn."""
    from benchmarks import forecast_alarms

    yield from forecast_alarms.rows()


def cells() -> Iterator[Row]:
    """How well forecasts know when a battery will be empty."""
    from benchmarks import forecast_cells

    yield from forecast_cells.rows()


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


PARTS = {
    "observe": observe,
    "messages": messages,
    "signals": signals,
    "statuses": statuses,
    "black_box": black_box,
    "host": host,
    "footprint": footprint,
    "rosbridge": rosbridge,
    "recordings": recordings,
    "history": history,
    "samples": samples,
    "notifications": notifications,
    "web": web,
    "fleet": fleet,
    "forecast": forecast,
    "cells": cells,
}


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
    rows = [row for part in measured.values() for row in part]
    print(table(rows))
    if arguments.write:
        write_page(measured, version())
    return 1 if any(row.verdict == "missed" for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
