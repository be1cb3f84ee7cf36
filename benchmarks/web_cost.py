"""CPU of open pages, compared with rosbridge clients of /diagnostics, and the time of a scrape of a large fleet.

How long a person waits for the page is measured by `page_times.py`.

One server lives all the time. Pages and subscribers are connected in turn, a slice each, round after round. What is
compared is the CPU time of the whole server process within a slice, less that of a slice without clients.
"""

from __future__ import annotations

import contextlib
import statistics
import time
import urllib.request
from typing import Dict, Iterator, List

from benchmarks import page_times
from benchmarks.peer import Peer
from benchmarks.table import Row

MODULE = "web_peers"
CLIENTS = 10
SIGNALS = 10
RATE_HZ = 10.0
SLICE_S = 5.0
ROUNDS = 3
FLEET = 200
SCRAPES = 15
SCRAPE_LIMIT_MS = 100.0


def rows() -> Iterator[Row]:
    """Measures and yields the rows of the table."""
    yield from _open_pages()
    yield from _no_page()
    yield from _scrape()
    yield from page_times.rows()


def _open_pages() -> Iterator[Row]:
    cpu_ms: Dict[str, List[float]] = {"none": [], "pages": [], "subscribers": []}
    with contextlib.ExitStack() as running:
        server = Peer(MODULE, "monitor", 1, SIGNALS, RATE_HZ)
        running.callback(server.end)
        for number in range(ROUNDS + 1):
            for kind, found in cpu_ms.items():
                with contextlib.ExitStack() as connected:
                    if kind != "none":
                        clients = Peer(MODULE, kind, server.first, CLIENTS)
                        connected.callback(clients.end)
                    used_ms = float(server.ask(str(SLICE_S))) / SLICE_S * 1e3
                if number:  # the first round warms up
                    found.append(used_ms)
                time.sleep(0.5)  # the clients have gone
    idle_ms = statistics.median(cpu_ms["none"])
    subscribers_ms, pages_ms = (statistics.median(cpu_ms[kind]) - idle_ms for kind in ("subscribers", "pages"))
    what = f"web, {CLIENTS} clients of a robot with {SIGNALS} signals at {RATE_HZ:g} Hz"
    yield Row(what, "rosbridge, /diagnostics", f"{subscribers_ms:.2f} ms/s")
    ratio = pages_ms / subscribers_ms
    yield Row(what, "pages with plots", f"{pages_ms:.2f} ms/s", ratio, 1.0, "CPU of the server, to rosbridge")


def _no_page() -> Iterator[Row]:
    cpu_ms: Dict[str, List[float]] = {"bare": [], "web": []}
    with contextlib.ExitStack() as running:
        servers = {
            "bare": Peer(MODULE, "monitor", 1, SIGNALS, RATE_HZ, "bare"),
            "web": Peer(MODULE, "monitor", 1, SIGNALS, RATE_HZ),
        }
        for server in servers.values():
            running.callback(server.end)
        for number in range(ROUNDS + 1):
            for kind, server in servers.items():
                used_ms = float(server.ask(str(SLICE_S))) / SLICE_S * 1e3
                if number:
                    cpu_ms[kind].append(used_ms)
    what = "web, no page open"
    bare_ms, web_ms = (statistics.median(cpu_ms[kind]) for kind in ("bare", "web"))
    yield Row(what, "server without page and API", f"{bare_ms:.2f} ms/s")
    yield Row(what, "server", f"{web_ms:.2f} ms/s", web_ms / bare_ms, remark="CPU of the monitor, to the one without")


def _scrape() -> Iterator[Row]:
    with contextlib.ExitStack() as running:
        server = Peer(MODULE, "monitor", FLEET, SIGNALS, 1.0)
        running.callback(server.end)
        times_ms: List[float] = []
        for number in range(SCRAPES + 1):
            begin_s = time.monotonic()
            with urllib.request.urlopen(f"http://127.0.0.1:{server.first}/metrics", timeout=30.0) as answer:
                size = len(answer.read())
            if number:
                times_ms.append((time.monotonic() - begin_s) * 1e3)
            time.sleep(0.2)
    what = f"web, /metrics of {FLEET} robots with {SIGNALS} signals at 1 Hz"
    fastest_ms = min(times_ms)  # what it takes when the machine does nothing else
    remark = f"{size / 1e6:.1f} MB, fastest of {SCRAPES}, to {SCRAPE_LIMIT_MS:g} ms"
    yield Row(what, "server", f"{fastest_ms:.0f} ms", fastest_ms / SCRAPE_LIMIT_MS, 1.0, remark)
