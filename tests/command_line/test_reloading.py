"""Reading the configuration again while the process runs."""

from __future__ import annotations

import asyncio
from typing import Any, Awaitable, Callable, List

import pytest
from harness.virtual_loop import run_in_virtual_time

from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.reloading import Reloads


class Part:
    """Returns or raises what it was given."""

    def __init__(self, outcome: Callable[[], Awaitable[str]]) -> None:
        self.reload = outcome


def part(text: str) -> Part:
    async def outcome() -> str:
        return text

    return Part(outcome)


def failing(error: Exception) -> Part:
    async def outcome() -> str:
        raise error

    return Part(outcome)


def lines_of(*parts: Part, requests: int = 1) -> List[str]:
    """Returns the lines of reloads."""
    lines: List[str] = []

    async def run() -> None:
        reloads = Reloads(lambda severity, text: lines.append(f"{severity.name} {text}"))
        for each in parts:
            reloads.add(each)
        reloads.request()  # nothing happens before it runs
        task = asyncio.ensure_future(reloads.run())
        for _ in range(requests):
            await asyncio.sleep(100.0)
            reloads.request()
        await asyncio.sleep(100.0)
        task.cancel()

    run_in_virtual_time(run())
    return lines


@pytest.mark.parametrize(
    ("parts", "lines"),
    [
        ([part("nothing changed"), part("nothing changed")], ["INFO reloaded: nothing changed"]),
        ([part("a changed"), part("nothing changed"), part("b changed")], ["INFO reloaded: a changed; b changed"]),
        ([part("")], []),
        ([part(""), part("nothing changed")], ["INFO reloaded: nothing changed"]),
        (
            [failing(ConfigError("bad", ("x",), file="f", line=3)), part("nothing changed")],
            ["ERROR not reloaded, the old configuration stays in force: f:3: x: bad"],
        ),
        (
            [failing(ConfigError("bad", file="f")), part("b changed")],
            ["ERROR not reloaded, the old configuration stays in force: f: bad", "INFO reloaded: b changed"],
        ),
        ([failing(ValueError("\x1b[2J"))], ["ERROR not reloaded: internal error: ValueError: ?[2J"]),
        ([], []),
    ],
)
def test_each_part_is_reloaded_by_itself_and_what_changed_is_one_line(parts: Any, lines: List[str]) -> None:
    assert lines_of(*parts) == lines


def test_a_part_that_hangs_is_one_error_line_and_blocks_neither_the_others_nor_later_reloads() -> None:
    async def hang() -> str:
        await asyncio.sleep(1e6)
        return ""

    error = "ERROR not reloaded, the old configuration stays in force: a file could not be read within 15 s"
    assert lines_of(Part(hang), part("b changed"), requests=2) == [error, "INFO reloaded: b changed"] * 2
