"""CPU per delivered message and loss of the rosbridge server, compared with a bare aiohttp broadcast.

Both servers live all the time, each with separate clients that only count, and send in turn, a slice each, round
after round. What is compared is the CPU time of the whole server process within a slice, pacing included, divided by
the messages that were to be delivered.
"""

from __future__ import annotations

import contextlib
import time
from typing import Callable, Iterator

from benchmarks.processes import Process, peer
from benchmarks.table import Row, beside, in_turn

SLICE_S = 2.0
SETTLE_S = 0.5
"""Time for messages in flight at the end of a slice."""
CONTESTANTS = {"floor": "bare aiohttp", "server": "rosbridge server"}
AT_MOST_FOR = (10, 1000.0)


def rows(rounds: int = 3) -> Iterator[Row]:
    """Measures and yields the rows of the table."""
    for clients in (1, 10, 50):
        for rate_hz in (100.0, 1000.0):
            yield from _broadcast(clients, rate_hz, rounds)


def _broadcast(clients: int, rate_hz: float, rounds: int) -> Iterator[Row]:
    lost = dict.fromkeys(CONTESTANTS.values(), 0.0)
    contestants: dict[str, Callable[[], float]] = {}
    with contextlib.ExitStack() as running:
        for role, contestant in CONTESTANTS.items():
            server = running.enter_context(peer(role))
            readers = running.enter_context(peer("clients", server.reply(), clients, "/battery_level"))
            readers.reply()

            def measure(name: str = contestant, server: Process = server, readers: Process = readers) -> float:
                before, begin_s = int(readers.ask("count")), server.cpu_s()
                sent = int(server.ask(f"{rate_hz} {SLICE_S}"))
                cpu_s = server.cpu_s() - begin_s
                time.sleep(SETTLE_S)
                lost[name] = max(lost[name], 1.0 - (int(readers.ask("count")) - before) / sent)
                return cpu_s / sent / clients * 1e6

            contestants[contestant] = measure
        cost_us = in_turn(contestants, rounds)
    what = f"rosbridge, {clients} client{'s' * (clients > 1)} at {rate_hz:g} Hz"
    required = 2.0 if (clients, rate_hz) == AT_MOST_FOR else None
    for row in beside(what, cost_us, "us", required, ", per delivered message", digits=1):
        yield row._replace(figure=f"{row.figure}, {lost[row.contestant] * 100.0:.3g} % lost")
