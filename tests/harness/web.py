"""A real server with the page and its API, on robots that the test moves by hand."""

from __future__ import annotations

import asyncio
import json
from functools import partial
from typing import Any, Awaitable, Callable, Mapping

import aiohttp

from robot_health_monitor.core.nodes import AlertSystem
from robot_health_monitor.core.port.local import LocalBus
from robot_health_monitor.core.values.model import Sample
from robot_health_monitor.ops.configuration import HistorySettings
from robot_health_monitor.ops.store.active_silences import Silences
from robot_health_monitor.ops.store.history import History
from robot_health_monitor.ops.web import WebInterface
from robot_health_monitor.rosbridge.server import Server
from robot_health_monitor.runtime.access import Access

BATTERY: Mapping[str, Any] = {"battery_level": {"unit": "%", "warn_below": 20.0, "hysteresis": 2.0, "latch": True}}
START_S = 1_795_324_000.0
"""Wall time at which the robots start: 2026-11-22T05:06:40Z."""


class Robots:
    """alert_systems in virtual time, which the test moves."""

    def __init__(self, *names: str, signals: Mapping[str, Any] = BATTERY, history_file: str = "") -> None:
        self.history: History | None = None
        self.silences: Silences | None = None
        self.bus = LocalBus(100.0, on_log=lambda line: None)
        self.wall_offset_s = START_S - 100.0
        if history_file:
            self.history = History(HistorySettings(history_file), self.wall_s)
            self.silences = Silences(self.history)
        self.all: list[AlertSystem] = [self.new(name, signals) for name in names or ("atlas",)]

    def new(self, name: str, signals: Mapping[str, Any] = BATTERY) -> AlertSystem:
        node = self.bus.node(
            "alert_system", namespace=f"robot{len(self.bus.nodes)}", parameters={"robot_name": name, "signals": signals}
        )
        history = None if self.history is None else self.history.of_robot(name)
        return AlertSystem(node, {}, log_alerts=False, history=history, silence_of=partial(self.silence_text, name))

    def silence_text(self, robot: str, signal: str) -> str | None:
        silence = None if self.silences is None else self.silences.silence_of(robot, signal)
        return None if silence is None else silence.reason

    def wall_s(self) -> float:
        return self.bus.now_s + self.wall_offset_s

    def interface(self, **options: Any) -> WebInterface:
        """Returns the page of these robots; without a history file, the history begins now, in memory."""
        if self.history is None or self.silences is None:
            self.history = History(None, self.wall_s)
            self.silences = Silences(self.history)
        web = WebInterface(lambda: self.all, self.history, self.silences, **options)
        for alert_system in self.all:
            web.watch(alert_system)
        return web

    def at(self, now_s: float) -> None:
        self.bus.run_due(now_s)

    def observe(self, value: object, signal: str = "battery_level", robot: int = 0) -> None:
        self.all[robot].observe(Sample(signal, value, self.bus.now_s))


class Site:
    """A running server, and a client of it."""

    def __init__(self, robots: Robots, web: WebInterface, server: Server, session: aiohttp.ClientSession) -> None:
        self.robots = robots
        self.web = web
        self.server = server
        self.session = session
        self.url = f"http://127.0.0.1:{server.port}"

    async def get(self, path: str, **options: Any) -> tuple[int, Any]:
        async with self.session.get(self.url + path, **options) as response:
            return response.status, await read(response)

    async def post(self, path: str, body: object, **options: Any) -> tuple[int, Any]:
        async with self.session.post(self.url + path, json=body, **options) as response:
            return response.status, await read(response)


async def read(response: aiohttp.ClientResponse) -> Any:
    text = await response.text()
    return json.loads(text) if response.content_type == "application/json" else text


def with_site(
    use: Callable[[Site], Awaitable[None]],
    robots: Robots | None = None,
    *,
    token: str = "",
    **options: Any,
) -> None:
    """Serves robots and runs `use`; `options` are those of `WebInterface`."""

    async def run() -> None:
        served = robots or Robots()
        web = served.interface(**options)
        access = Access(services=("/alert_system/re*",), token=token)
        node = served.bus.node("server")
        server = Server(node, port=0, access=access, threads=False, routes=web.routes, on_close=web.close)
        await server.start()
        try:
            async with aiohttp.ClientSession(cookie_jar=aiohttp.CookieJar(unsafe=True)) as session:
                await asyncio.wait_for(use(Site(served, web, server, session)), 120.0)
        finally:
            await server.close()
            if served.history is not None:
                served.history.close()

    asyncio.run(run())


class Page:
    """The events of one connection to `/api/events`."""

    def __init__(self, response: aiohttp.ClientResponse) -> None:
        self.response = response

    async def next(self, kind: str = "") -> tuple[str, dict[str, Any]]:
        """Returns the next event, or the next of a kind."""
        while True:
            fields: dict[str, str] = {}
            while True:
                line = (await asyncio.wait_for(self.response.content.readline(), 30.0)).decode("ascii")
                if not line:
                    raise EOFError("the server closed the connection")
                if line == "\n":
                    break
                name, _, value = line.rstrip("\n").partition(": ")
                fields[name] = value
            if "event" in fields and kind in ("", fields["event"]):
                return fields["event"], json.loads(fields["data"])


class open_page:  # noqa: N801  # used as a function
    """Opens `/api/events` for `async with`."""

    def __init__(self, site: Site, query: str = "") -> None:
        self._request = site.session.get(f"{site.url}/api/events{query}", timeout=aiohttp.ClientTimeout(total=None))

    async def __aenter__(self) -> Page:
        response = await self._request.__aenter__()
        assert response.status == 200, await response.text()
        assert response.content_type == "text/event-stream"
        return Page(response)

    async def __aexit__(self, *arguments: Any) -> None:
        await self._request.__aexit__(*arguments)
