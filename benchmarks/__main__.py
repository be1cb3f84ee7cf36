"""The front command: measures, then prints one table.

    python3 -m benchmarks                   everything that can run here
    python3 -m benchmarks observe           one part of it: observe, messages, signals, footprint, rosbridge

It sets up what it needs under .venv/, as `make test` does. Exit code 1 when a requirement is missed.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from typing import Any, Callable, Iterable, Iterator, List

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from environments import Unavailable, environment, runtime_requirements  # noqa: E402  # found by the line above
from run_all import Machine  # noqa: E402

from benchmarks.table import Row, table  # noqa: E402

REQUIREMENTS = [
    line.partition("#")[0].strip()
    for line in (ROOT / "benchmarks" / "requirements.txt").read_text().splitlines()
    if line.partition("#")[0].strip()
]
PYTHONS = ((3, 12), (3, 13), (3, 11), (3, 14))
"""Versions that river has wheels for, those of ROS 2 first."""


def observe(machine: Machine) -> Iterator[Row]:
    """What a sample costs."""
    from benchmarks import observe_cost

    yield from observe_cost.rows()


def messages(machine: Machine) -> Iterator[Row]:
    """What a message costs."""
    from benchmarks import message_cost

    yield from on_every_middleware(machine, message_cost.rows, "one message at 1 kHz")


def signals(machine: Machine) -> Iterator[Row]:
    """What many signals cost, and one whose messages are only counted."""
    from benchmarks import signals_cost

    yield from on_every_middleware(machine, signals_cost.rows, "many signals, and arrivals of one")


def footprint(machine: Machine) -> Iterator[Row]:
    """What running costs."""
    from benchmarks import footprint

    yield from on_every_middleware(machine, footprint.rows, "memory and CPU")


def rosbridge(machine: Machine) -> Iterator[Row]:
    """What a rosbridge client costs."""
    from benchmarks import rosbridge_cost

    yield from rosbridge_cost.rows()


def on_every_middleware(machine: Machine, measure: Callable[[Any], Iterable[Row]], what: str) -> Iterator[Row]:
    """Yields the rows for ROS 1 and for ROS 2, or one that says why there are none."""
    from benchmarks import targets

    for name, place, start in (("ROS 1", "ros1", targets.ros1), ("ROS 2", "ros2", targets.ros2)):
        try:
            python, variables = getattr(machine, place)
            with start(python, variables) as target:
                yield from measure(target)
        except (Unavailable, RuntimeError) as problem:
            yield Row(f"{name}, {what}", "", remark=str(problem))


PARTS = {"observe": observe, "messages": messages, "signals": signals, "footprint": footprint, "rosbridge": rosbridge}


def main() -> int:
    """Runs the parts that were asked for."""
    parser = argparse.ArgumentParser(prog="python3 -m benchmarks", description="Measures, then prints one table.")
    parser.add_argument("part", nargs="*", help=f"what to measure: {', '.join(PARTS)}; left out: everything")
    asked = parser.parse_args().part or list(PARTS)
    if not set(asked) <= PARTS.keys():
        parser.error(f"there is no such part; there are {', '.join(PARTS)}")
    machine = Machine()
    enter_environment(machine)
    rows: List[Row] = []
    for part in asked:
        print(f"measuring {part} ...", file=sys.stderr, flush=True)
        rows.extend(PARTS[part](machine))
    print(table(rows))
    return 1 if any(row.verdict == "missed" for row in rows) else 0


def enter_environment(machine: Machine) -> None:
    """Goes on in an environment that has what the benchmarks need, made when it is missing."""
    if os.environ.get("BENCHMARKS_ENTERED"):
        return
    version = next((version for version in PYTHONS if version in machine.pythons), None)
    if version is None:
        sys.exit("benchmarks: there is no Python 3.11 to 3.14 on this machine, which river needs")
    try:
        python = environment("benchmarks", machine.pythons[version], [*runtime_requirements(), *REQUIREMENTS])
    except Unavailable as problem:
        sys.exit(f"benchmarks: {problem}")
    command = [str(python), "-m", "benchmarks", *sys.argv[1:]]
    os.execve(str(python), command, {**os.environ, "BENCHMARKS_ENTERED": "1"})


if __name__ == "__main__":
    sys.exit(main())
