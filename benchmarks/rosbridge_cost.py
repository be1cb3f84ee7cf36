"""CPU per delivered message and loss of the rosbridge server, compared with a bare aiohttp broadcast.

Both servers live all the time, each with separate clients that only count, and send in turn, a slice each, round
after round. What is compared is the CPU time of the whole server process within a slice, pacing included, divided by
the messages that were to be delivered.
"""

from __future__ import annotations

import contextlib
import statistics
import time
from typing import Dict, Iterator, List, Tuple

from benchmarks.peer import Peer
from benchmarks.table import Row, median_ratio

CLIENTS = (1, 10, 50)
RATES_HZ = (100.0, 1000.0)
SLICE_S = 2.0
ROUNDS = 3
SETTLE_S = 0.5
"""Time for messages in flight at the end of a slice."""
AT_MOST = 2.0
AT_MOST_FOR = (10, 1000.0)
STALLED_S = 10.0
STALLED_CHARS = 2000
QUEUE_KB = 1000
"""The server's bound for one client."""


def rows(rounds: int = ROUNDS) -> Iterator[Row]:
    """Measures and yields the rows of the table."""
    for clients in CLIENTS:
        for rate_hz in RATES_HZ:
            yield from _broadcast(clients, rate_hz, rounds)
    yield _stalled()


def _broadcast(clients: int, rate_hz: float, rounds: int) -> Iterator[Row]:
    cpu_us: Dict[str, List[float]] = {"floor": [], "server": []}
    lost: Dict[str, float] = {"floor": 0.0, "server": 0.0}
    with contextlib.ExitStack() as running:
        pairs: Dict[str, Tuple[Peer, Peer]] = {}
        for name in cpu_us:
            server = Peer("rosbridge_peers", name)
            running.callback(server.end)
            pairs[name] = server, Peer("rosbridge_peers", "clients", server.first, clients)
            running.callback(pairs[name][1].end)
        for number in range(rounds + 1):
            for name, (server, readers) in pairs.items():
                before = int(readers.ask("count"))
                sent, cpu_s, _ = server.ask(f"{rate_hz} {SLICE_S} 0").split()
                time.sleep(SETTLE_S)
                received = int(readers.ask("count")) - before
                if number:  # the first round warms up
                    cpu_us[name].append(float(cpu_s) / int(sent) / clients * 1e6)
                    lost[name] = max(lost[name], 1.0 - received / int(sent))
    what = f"rosbridge, {clients} client{'s' * (clients > 1)} at {rate_hz:g} Hz"
    figures = {
        name: f"{statistics.median(values):.1f} us, {lost[name] * 100.0:.3g} % lost" for name, values in cpu_us.items()
    }
    ratio = median_ratio(cpu_us["server"], cpu_us["floor"])
    required = AT_MOST if (clients, rate_hz) == AT_MOST_FOR else None
    yield Row(what, "bare aiohttp", figures["floor"])
    yield Row(what, "rosbridge server", figures["server"], ratio, required, "per delivered message, to bare aiohttp")


def _stalled() -> Row:
    """Measures the memory of a client that subscribes and never reads."""
    with contextlib.ExitStack() as running:
        server = Peer("rosbridge_peers", "server")
        running.callback(server.end)
        warm = Peer("rosbridge_peers", "clients", server.first, 1)
        running.callback(warm.end)
        server.ask(f"1000 1 {STALLED_CHARS}")
        stalled = Peer("rosbridge_peers", "clients", server.first, 1, "stalled")
        running.callback(stalled.end)
        before_kb = int(server.ask(f"1 1 {STALLED_CHARS}").split()[2])
        after_kb = int(server.ask(f"1000 {STALLED_S} {STALLED_CHARS}").split()[2])
    grown_kb = max(0, after_kb - before_kb)
    sent_kb = STALLED_S * STALLED_CHARS
    what = f"rosbridge, a client that never reads {sent_kb / 1000.0:g} MB"
    return Row(
        what, "rosbridge server", f"{grown_kb} kB", grown_kb / QUEUE_KB, 2.0, "memory, to the bound of its queue"
    )
