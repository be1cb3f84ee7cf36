"""CPU of open pages, and the time of a scrape.

One server lives all the time. Pages and subscribers are connected in turn, a slice each, round after round. What is
compared is the CPU time of the whole server process within a slice, less that of a slice without clients.
"""

from __future__ import annotations

import contextlib
import statistics
import time
import urllib.request
from typing import Callable, Iterator

from benchmarks.peers import SIGNALS
from benchmarks.processes import Process, peer
from benchmarks.table import Row, beside, in_turn, within

CLIENTS, RATE_HZ = 10, 10.0
SLICE_S = 5.0
FLEET, SCRAPES = 200, 15
BARE, PLAIN = "server without page and API", "server"


def rows(rounds: int = 3) -> Iterator[Row]:
    """Measures and yields the rows of the table."""
    with contextlib.ExitStack() as running:
        bare = running.enter_context(peer("monitor", 1, RATE_HZ, "bare"))
        server = running.enter_context(peer("monitor", 1, RATE_HZ))
        bare.reply()
        port = server.reply()

        def with_clients(*topic: str) -> float:
            with peer("clients", port, CLIENTS, *topic) as clients:
                clients.reply()
                while clients.ask("count") == "0":
                    time.sleep(0.1)
                used_ms = _used_ms(server)
            time.sleep(0.5)  # the clients have gone
            return used_ms

        contestants: dict[str, Callable[[], float]] = {
            BARE: lambda: _used_ms(bare),
            PLAIN: lambda: _used_ms(server),
            "pages": with_clients,
            "subscribers": lambda: with_clients("/diagnostics"),
        }
        cpu_ms = in_turn(contestants, rounds)
    median = {name: statistics.median(values) for name, values in cpu_ms.items()}
    pages_ms, subscribers_ms = median["pages"] - median[PLAIN], median["subscribers"] - median[PLAIN]
    what = f"web, {CLIENTS} clients of a robot with {SIGNALS} signals at {RATE_HZ:g} Hz"
    yield Row(what, "rosbridge, /diagnostics", f"{subscribers_ms:.2f} ms/s")
    remark = "CPU of the server, to rosbridge"
    yield Row(what, "pages with plots", f"{pages_ms:.2f} ms/s", pages_ms / subscribers_ms, 1.0, remark)
    yield from beside("web, no page open", {name: cpu_ms[name] for name in (BARE, PLAIN)}, "ms/s", digits=2)
    yield _scrape()


def _used_ms(server: Process) -> float:
    """Returns the CPU time of a slice, in ms per s."""
    begin_s = server.cpu_s()
    time.sleep(SLICE_S)
    return (server.cpu_s() - begin_s) / SLICE_S * 1e3


def _scrape() -> Row:
    times_ms, size = [], 0
    with peer("monitor", FLEET, 1.0) as server:
        url = f"http://127.0.0.1:{server.reply()}/metrics"
        for _ in range(SCRAPES + 1):
            begin_s = time.monotonic()
            with urllib.request.urlopen(url, timeout=30.0) as answer:
                size = len(answer.read())
            times_ms.append((time.monotonic() - begin_s) * 1e3)
            time.sleep(0.2)
    what = f"web, /metrics of {FLEET} robots with {SIGNALS} signals at 1 Hz"
    # The fastest is what it takes when the machine does nothing else.
    return within(what, "server", min(times_ms[1:]), 100.0, "ms", f"{size / 1e6:.1f} MB, fastest of {SCRAPES}")
