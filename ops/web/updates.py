"""Server-sent events: one reading and one encoding per update, however many pages are open; none without a page."""

from __future__ import annotations

import asyncio
import contextlib
import json
import time
from collections import Counter
from typing import Any, Awaitable, Callable, Collection, Dict, Iterator, Mapping, NamedTuple, Sequence

from aiohttp import web

from ...core.values import JsonObject, ServiceError
from ...runtime.http_answers import API_HEADERS, ApiError, json_bytes
from .state import Samples

MOST_PAGES = 200
"""Most pages at a time; a further one replaces the oldest of the address that has most."""
MOST_ROBOTS = 10  # whose samples one page gets
MOST_WAITING = 10
"""Events that may wait for a page, about one per second; a page that is slower is disconnected."""
PERIOD_S = 1.0
SHORTEST_S = 0.5
"""Shortest time between two updates: a transition is sent at once, but a burst of them is one update."""
_CHUNK = 65_536
_RETRY = b"retry: 2000\n\n"
_HEADERS = {**API_HEADERS, "Content-Type": "text/event-stream; charset=utf-8", "X-Accel-Buffering": "no"}

Json = Dict[str, Any]


class RobotState(NamedTuple):
    """The state of one robot: of a thousand robots, dictionaries take four times the memory of their JSON."""

    level: str
    data: bytes  # as in `/api/state`


class State(NamedTuple):
    """The state of all robots."""

    common: Json  # as in `/api/state`, without the robots
    robots: Mapping[str, RobotState]

    def parts(self) -> Iterator[bytes]:
        """Yields it as `/api/state` has it: of a thousand robots, a copy of the whole takes 7 MB."""
        yield json_bytes(self.common)[:-1] + b',"robots":{'
        for number, (name, robot) in enumerate(self.robots.items()):
            yield (b"," if number else b"") + json_bytes(name) + b":"
            yield robot.data
        yield b"}}"


_NONE = State({}, {})


class _Page:
    """One open connection."""

    def __init__(self, robots: Sequence[str], request: web.Request) -> None:
        self.robots = robots  # those whose samples it gets
        self.address = request.remote or ""
        self._transport = request.transport
        self._waiting: asyncio.Queue[bytes] = asyncio.Queue(MOST_WAITING + 2)  # `retry` and `state` come first
        self._has_ended = False

    def send(self, event: bytes) -> None:
        """Queues an event; a page that reads too slowly is disconnected."""
        try:
            self._waiting.put_nowait(event)
        except asyncio.QueueFull:
            self.end()

    def end(self) -> None:
        """Disconnects it; what waits for a page that does not read would be kept otherwise."""
        self._has_ended = True
        if self._transport is not None:
            self._transport.abort()
        if self._waiting.empty():
            self._waiting.put_nowait(b"")  # ends the wait for an event

    async def write(self, response: web.StreamResponse) -> None:
        """Writes events until it ends; raises ConnectionError if it has gone."""
        while not self._has_ended:
            event = await self._waiting.get()
            for start in range(0, len(event), _CHUNK):
                await response.write(event[start : start + _CHUNK])


class Updates:
    """Sends the state to pages, then what changes."""

    def __init__(
        self,
        read_state: Callable[[State, Collection[str]], Awaitable[State]],
        read_samples: Callable[[str, Samples | None], Awaitable[Samples | None]],
    ) -> None:
        """Takes what reads. Called in the server's loop.

        Args:
            read_state: returns the state without samples; takes the one before, which is empty if there is none, and
                the robots that pages show with their samples.
            read_samples: returns a robot's samples since an earlier result; None if there is no such robot.
        """
        self._read_state = read_state
        self._read_samples = read_samples
        self.pages: dict[_Page, None] = {}  # those that are open, the oldest first
        self._state = _NONE
        self._encoded_state: bytes | None = None
        self._samples: dict[str, Samples] = {}
        self._task: asyncio.Task[None] | None = None
        self._loop = asyncio.get_event_loop()
        self._wake = asyncio.Event()
        self._reading = asyncio.Lock()

    def note_change(self) -> None:
        """Something was announced: pages get it soon. May be called in any thread."""
        if self.pages:
            with contextlib.suppress(RuntimeError):  # the loop is closed
                self._loop.call_soon_threadsafe(self._wake.set)

    async def serve(self, request: web.Request) -> web.StreamResponse:
        """Answers `/api/events` until the page or the server closes the connection.

        Raises ApiError if too many robots are asked for, or there is no such robot.
        """
        robots = list(dict.fromkeys(filter(None, request.query.getall("robot", []))))
        if len(robots) > MOST_ROBOTS:
            raise ApiError(400, f"robot: expected at most {MOST_ROBOTS} names, got {len(robots)}")
        page = _Page(robots, request)
        await self._add(page)
        try:
            response = web.StreamResponse(headers=_HEADERS)
            await response.prepare(request)
            with contextlib.suppress(ConnectionError):
                await page.write(response)
            return response
        finally:
            self._remove(page)
            page.end()

    def close(self) -> None:
        """Disconnects every page. Call in the loop."""
        for page in self.pages:
            page.end()

    async def _add(self, page: _Page) -> None:
        async with self._reading:
            if self._state is _NONE:
                self._state = await self._read_state(_NONE, ())
            for robot in page.robots:
                if robot not in self._state.robots:
                    raise no_robot(robot)
                self._samples.pop(robot, None)  # the next update has all of them
                self._wake.set()
            page.send(_RETRY)
            page.send(self._state_event())
            self._make_room()
            self.pages[page] = None
            if self._task is None:
                self._task = asyncio.ensure_future(self._run())

    def _make_room(self) -> None:
        """Disconnects pages for a new one. One that is not read, or kept by a browser for going back, looks open."""
        while len(self.pages) >= MOST_PAGES:
            of_address = Counter(page.address for page in self.pages)
            replaced = max(self.pages, key=lambda page: of_address[page.address])
            replaced.end()
            del self.pages[replaced]

    def _plotted(self) -> set[str]:
        """Returns the robots whose samples are sent."""
        return {robot for page in self.pages for robot in page.robots}

    def _remove(self, page: _Page) -> None:
        self.pages.pop(page, None)
        plotted = self._plotted()
        self._samples = {robot: samples for robot, samples in self._samples.items() if robot in plotted}
        if not self.pages:
            self._state, self._encoded_state = _NONE, None
            if self._task is not None:
                self._task.cancel()
                self._task = None

    async def _run(self) -> None:
        """Updates the pages until it is cancelled."""
        while True:
            started_s = time.monotonic()
            try:
                await asyncio.wait_for(self._wake.wait(), PERIOD_S)
                await asyncio.sleep(SHORTEST_S - (time.monotonic() - started_s))
            except asyncio.TimeoutError:
                pass
            self._wake.clear()
            try:
                await self._update()
            except ServiceError:
                pass  # without events the pages show that they have lost the monitor
            except Exception:
                self.close()  # they connect again: the first event fails too, and the server logs why

    async def _update(self) -> None:
        async with self._reading:
            plotted = self._plotted()
            after = await self._read_state(self._state, plotted)
            samples = {robot: await self._read_samples(robot, self._samples.get(robot)) for robot in plotted}
            # Nothing is remembered before everything is read: what is not sent now is sent with the next update.
            changed = changes(self._state, after)
            self._state, self._encoded_state = after, None
            self._samples = {robot: new for robot, new in samples.items() if new is not None}
            event = self._state_event() if changed is None else _event("change", json_bytes(changed))
            sampled = {robot: _event("samples", json_bytes(new.event)) for robot, new in self._samples.items()}
            for page in self.pages:
                page.send(event + b"".join(sampled.get(robot, b"") for robot in page.robots))

    def _state_event(self) -> bytes:
        if self._encoded_state is None:
            self._encoded_state = _event("state", *self._state.parts())
        return self._encoded_state


def no_robot(name: str) -> ApiError:
    """Returns what is raised if there is no robot of this name."""
    return ApiError(404, f"there is no robot {name}")


def _event(kind: str, *data: bytes) -> bytes:
    return b"".join((b"event: ", kind.encode("ascii"), b"\ndata: ", *data, b"\n\n"))


def changes(before: State, after: State) -> Json | None:
    """Returns what changed from one state to the next, as the event `change`; None if robots or signals did."""
    if list(before.robots) != list(after.robots):
        return None
    robots: Json = {}
    for name, robot in after.robots.items():
        if robot == before.robots[name]:
            continue
        known, new = json.loads(before.robots[name].data), json.loads(robot.data)
        old, signals = known.pop("signals"), new["signals"]
        if list(old) != list(signals):
            return None
        changed = {key: _changed_keys(old[key], signal) for key, signal in signals.items() if signal != old[key]}
        robots[name] = _changed_keys(known, {**new, "signals": changed or None})
    return _changed_keys(before.common, {**after.common, "robots": robots or None})


def _changed_keys(before: JsonObject, after: JsonObject) -> Json:
    return {key: value for key, value in after.items() if value != before.get(key)}
