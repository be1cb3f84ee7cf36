"""The routes of the page, the API, the metrics and the health check, for the server that they are passed to."""

from __future__ import annotations

import asyncio
from functools import partial
from sqlite3 import Connection
from typing import (
    Any,
    Awaitable,
    Callable,
    Collection,
    Dict,
    Iterable,
    Mapping,
    Sequence,
    TypeVar,
)  # fmt: skip

from aiohttp import web

from ...core.config import read_record, read_texts
from ...core.messages import json_text
from ...core.nodes import AlertSystem
from ...core.nodes.outlets import Event
from ...core.values import ConfigError, Fault, Level, ServiceError, Transition, package_version
from ...runtime.access import Client
from ...runtime.event_loops import ThreadPool
from ...runtime.http_answers import API_HEADERS, ApiError, FileAnswer, json_bytes, json_response
from ...runtime.times import iso_time
from ..black_box.folder import find_file
from ..store.active_silences import Silences
from ..store.history import History
from ..store.silences import silence_json
from .history_requests import (  # fmt: skip
    AlertQuery,
    EndOfSilence,
    LevelsQuery,
    NewNote,
    NewSilence,
    Query,
    Reset,
    SamplesQuery,
    expire_silence,
    new_note,
    new_silence,
    past_alert,
    past_alerts,
    past_levels,
    past_samples,
)
from .metrics import CONTENT_TYPE, PROFILES, Metrics
from .requests import WITH_TOKEN, WITHOUT_TOKEN, check_same_origin, read_object, serve_page_file
from .state import NO_PLOT, OwnState, RobotReader, Samples, plot_of
from .updates import RobotState, State, Updates, no_robot

LATEST_TICK_S = 6.0  # largest age of the tick of a healthy monitor: 5 s late
_MOST_PENDING = 500  # requests that wait for a robot or a disk
_READ_TIMEOUT_S = 5.0
_ROBOTS_AT_ONCE = 5  # are read without a pause for others in the same loop
MOST_READ = 200
"""Robots that an update of the pages reads in turn, besides those that announced something or are plotted."""
_PAST_AT_ONCE = 1  # requests that read the history: each contends with the monitor for the interpreter
_MOST_PAST_PENDING = 50

_MOST_SHOWN = 200

Item = TypeVar("Item")
Result = TypeVar("Result")
Asked = TypeVar("Asked")
Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]
Run = Callable[[Callable[[Any], object], object], Awaitable[object]]
Json = Dict[str, Any]


class WebInterface:
    """Serves the state of robots. It costs nothing until the first request."""

    def __init__(
        self,
        robots: Callable[[], Sequence[AlertSystem]],
        history: History,
        silences: Silences,
        *,
        threads: bool = False,
        black_boxes: str | None = None,
        notifications_waiting: Callable[[], int] = int,
        process_faults: Callable[[], Mapping[str, Fault]] = dict,
    ) -> None:
        """Prepares the routes.

        Args:
            robots: returns the alert_systems of the robots that are watched now.
            history: has the past alerts, and the wall clock.
            silences: those of the history.
            threads: whether robots are judged in other threads than the server's loop (ROS).
            black_boxes: folder with the recordings of alerts; None if nothing is recorded.
            notifications_waiting: returns how many are not delivered yet.
            process_faults: returns the faults of the monitor that belong to no robot, by part.
        """
        self._robots = robots
        self._history = history
        self._silences = silences
        self._black_boxes = black_boxes
        self._threads = threads
        # Reading a robot waits for its callbacks, and a history for a disk.
        self._worker = ThreadPool("web", 8, _MOST_PENDING, _READ_TIMEOUT_S)
        self._past = ThreadPool("web history", _PAST_AT_ONCE, _MOST_PAST_PENDING, _READ_TIMEOUT_S)
        self._readers: dict[AlertSystem, RobotReader] = {}
        self._announced: set[str] = set()
        self._next_read = 0
        self._own_state = OwnState(robots, process_faults)
        self._metrics = Metrics(notifications_waiting, history.wall_s, lambda: len(self._own_state.texts()))

    def watch(self, alert_system: AlertSystem) -> None:
        """Counts the transitions of a robot, and sends them to open pages. Call once for each robot."""

        def note(event: Event) -> None:
            if isinstance(event, Transition):
                self._metrics.count(alert_system.robot, event)
            self._announced.add(alert_system.robot)
            self.updates.note_change()

        alert_system.outlets.add("web", note)

    def routes(self, client_of: Callable[[web.Request], Client]) -> list[web.RouteDef]:
        """Returns the routes; `client_of` returns who sends a request. Call in the server's loop.

        What a handler raises is answered by the server: ConfigError, MessageError and ServiceError.
        """
        self._client_of = client_of
        self.updates = Updates(self._read_update, self._read_samples)
        """The open pages."""
        get, post, history, silences = web.get, web.post, self._history, self._silences
        change = self._worker.run
        return [
            get("/api/state", self._for_clients(self._get_state)),
            get("/api/events", self._for_clients(self.updates.serve), allow_head=False),
            get("/api/history", self._past_route(Query, past_alerts)),
            get("/api/history/samples", self._past_route(SamplesQuery, past_samples)),
            get("/api/history/levels", self._past_route(LevelsQuery, past_levels)),
            get("/api/history/{id}", self._past_route(AlertQuery, self._past_alert)),
            get("/api/black_box/{name}", self._for_clients(self._get_black_box)),
            post("/api/login", self._login),
            post("/api/logout", self._logout),
            post("/api/silence", self._route(NewSilence, partial(new_silence, history, silences), change)),
            post("/api/silence/expire", self._route(EndOfSilence, partial(expire_silence, silences), change)),
            post("/api/note", self._route(NewNote, partial(new_note, history), change)),
            post("/api/reset", self._route(Reset, self._reset, self._read)),
            get("/metrics", self._for_clients(self._get_metrics)),
            get("/healthz", self._get_health),
            get("/", serve_page_file),
            get(r"/{name:[\w-]+\.\w+}", serve_page_file),
        ]

    def close(self) -> None:
        """Disconnects every page. Call in the server's loop."""
        self.updates.close()
        for pool in (self._worker, self._past):
            pool.close()

    # Checks

    def _for_clients(self, handler: Handler) -> Handler:
        """Answers a request only if the client has presented the token, or none is required."""

        async def handle(request: web.Request) -> web.StreamResponse:
            client = self._client_of(request)
            return await handler(request) if client.admitted else client.refusal()

        return handle

    def _route(self, schema: type[Asked], answer: Callable[[Asked], object], run: Run) -> Handler:
        """Answers a request with the JSON that a function returns, which `run` calls.

        `schema` is what is asked for, by GET in the address, by POST, which changes something, in the body.
        """

        async def handle(request: web.Request) -> web.StreamResponse:
            if request.method != "POST":
                query = {**request.query, **request.match_info}
                return json_response(await run(answer, read_texts(schema, query)))
            check_same_origin(request)
            value = await run(answer, read_record(schema, await read_object(request)))
            self._announced.update(robot.robot for robot in self._robots())
            self.updates.note_change()
            return json_response(value)

        return self._for_clients(handle)

    def _past_route(self, schema: type[Asked], read: Callable[[Connection, float, Asked], object]) -> Handler:
        """Answers a request with what a function reads from the history, by connection, wall time and what is asked."""
        history = self._history

        def answer(asked: Asked) -> bytes:
            wall_s = history.wall_s()
            try:
                result = history.read(lambda connection: read(connection, wall_s, asked))
            except ConfigError as error:  # the file was replaced or damaged: not the fault of the request
                raise ServiceError(error.problem) from None
            return json_text(result, in_pieces=True).encode("ascii")

        return self._route(schema, answer, self._past.run)

    # Login

    async def _login(self, request: web.Request) -> web.StreamResponse:
        check_same_origin(request)
        client = self._client_of(request)
        body = await read_object(request, WITH_TOKEN if client.admitted else WITHOUT_TOKEN)
        return client.login(body.get("token"))

    async def _logout(self, request: web.Request) -> web.StreamResponse:
        check_same_origin(request)
        return self._client_of(request).logout()

    # State

    async def _get_state(self, request: web.Request) -> web.StreamResponse:
        name, window = request.query.get("robot", ""), request.query.get("window", "1") != "0"
        state = await self._state_of(self._current_readers(name), {}, window)
        if name and not state.robots:
            raise no_robot(name)
        return await _streamed(request, state.parts(), "application/json; charset=utf-8")

    async def _read_update(self, before: State, plotted: Collection[str]) -> State:
        """Returns the state. What was `before` counts for most robots of a large fleet: to read all costs too much."""
        announced, self._announced = self._announced, set()
        readers = self._current_readers()
        begin = self._next_read % max(1, len(readers))
        self._next_read = begin + MOST_READ
        read = {reader.robot for reader in (readers * 2)[begin : self._next_read]}.union(announced, plotted)
        return await self._state_of(readers, {name: state for name, state in before.robots.items() if name not in read})

    async def _state_of(
        self, readers: Sequence[RobotReader], known: Mapping[str, RobotState], window: bool = False
    ) -> State:
        unknown = [reader for reader in readers if reader.robot not in known]
        states = await self._read_each(unknown, lambda reader: _encoded(reader.state(window=window)))
        read = {**known, **{reader.robot: state for reader, state in zip(unknown, states)}}
        robots = {reader.robot: read[reader.robot] for reader in readers}
        now_s = self._history.wall_s()
        common = {
            "version": package_version(),
            "now": iso_time(now_s),
            "monitor": self._own_state.as_json(),
            "worst": Level.worst(Level[each.level] for each in robots.values()).name,
            "history": True,
            "silencing": True,
            "can_change": True,  # every client that may read
            "silences": [silence_json(silence, now_s) for silence in self._silences.active()],
        }
        return State(common, robots)

    async def _read_samples(self, name: str, before: Samples | None) -> Samples | None:
        for reader in self._current_readers(name):
            return await self._read(reader.samples, before)
        return None

    def _current_readers(self, name: str = "") -> list[RobotReader]:
        """Returns the readers of the robots that are watched now, or of the robot of this name."""
        known = self._readers
        self._readers = {
            robot: known.get(robot) or RobotReader(robot, self._own_state, self._history.wall_s)
            for robot in self._robots()
        }
        return [reader for reader in self._readers.values() if name in ("", reader.robot)]

    async def _read(self, function: Callable[..., Result], *arguments: Any) -> Result:
        """Reads robots: in a thread if that may wait."""
        return await self._worker.run(function, *arguments) if self._threads else function(*arguments)

    async def _read_each(self, items: Iterable[Item], function: Callable[[Item], Result]) -> list[Result]:
        results = []
        for number, item in enumerate(items, 1):
            results.append(await self._read(function, item))
            if number % _ROBOTS_AT_ONCE == 0:
                await asyncio.sleep(0)
        return results

    def _reset(self, wanted: Reset) -> Json:
        for robot in self._robots():
            if robot.robot == wanted.robot:
                return {"message": robot.reset()}
        raise no_robot(wanted.robot)

    # History

    def _past_alert(self, connection: Connection, wall_s: float, asked: AlertQuery) -> Json:
        past = past_alert(connection, wall_s, asked)
        alert = past["alert"]
        plots = [plot_of(each, alert["signal"]) for each in self._robots() if each.robot == alert["robot"]]
        return {**(plots or [NO_PLOT])[0], **past}

    async def _get_black_box(self, request: web.Request) -> web.StreamResponse:
        if self._black_boxes is None:
            raise ApiError(404, "nothing is recorded; ops.yaml configures a black box")
        name = request.match_info["name"]
        path = await self._worker.run(find_file, self._black_boxes, name)
        if path is None:
            problem = "it is being written, was deleted, or could not be written"
            raise ApiError(404, f"there is no {name[:_MOST_SHOWN]!r}: {problem}")
        headers = {"Content-Type": "application/octet-stream", "Content-Disposition": f'attachment; filename="{name}"'}
        return FileAnswer(path, headers={**API_HEADERS, **headers})

    # Metrics and health

    async def _get_metrics(self, request: web.Request) -> web.StreamResponse:
        profile = request.query.get("profile", PROFILES[0])
        if profile not in PROFILES:
            raise ApiError(400, f"profile: expected {' or '.join(PROFILES)}, got {profile[:40]!r}")
        robots = await self._read_each(self._robots(), self._metrics.read)
        return await _streamed(request, self._metrics.render(robots, profile), CONTENT_TYPE)

    async def _get_health(self, request: web.Request) -> web.StreamResponse:
        age_s = max((robot.tick_age_s for robot in self._robots()), default=0.0)
        if age_s > LATEST_TICK_S:
            return json_response({"ok": False, "error": f"no tick for {age_s:.0f} s"}, 503)
        admitted = self._client_of(request).admitted
        return json_response({"ok": True, "faults": self._own_state.texts()} if admitted else {"ok": True})


def _encoded(state: Json) -> RobotState:
    return RobotState(state["level"], json_bytes(state))


async def _streamed(request: web.Request, parts: Iterable[bytes], content_type: str) -> web.StreamResponse:
    """Sends an answer in parts: of large fleets, all of them take much memory and time."""
    response = web.StreamResponse(headers={**API_HEADERS, "Content-Type": content_type})
    await response.prepare(request)
    if request.method != "HEAD":
        for part in parts:
            await response.write(part)
            await asyncio.sleep(0)
    return response
