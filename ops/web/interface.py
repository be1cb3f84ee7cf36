"""The routes of the page, the API, the metrics and the health check, for the server that they are passed to."""

from __future__ import annotations

import asyncio
import time
from functools import partial
from typing import (
    Any,
    Awaitable,
    Callable,
    Collection,
    Dict,
    Iterable,
    List,
    Mapping,
    Optional,
    Sequence,
    Set,
    Tuple,
    Type,
    TypeVar,
)  # fmt: skip

from aiohttp import web

from ...core.config.schema import read_record, read_texts
from ...core.nodes import AlertSystem
from ...core.nodes.outlets import Event
from ...core.values.errors import ConfigError, MessageError, ServiceError
from ...core.values.faults import Fault
from ...core.values.model import Level, Transition
from ...core.values.version import package_version
from ...runtime.event_loops import ThreadPool
from ...runtime.times import iso_time
from ..black_box.folder import find_file
from ..store.active_silences import Silences
from ..store.history import History
from ..store.silences import silence_json
from .history_requests import (  # fmt: skip
    EndOfSilence,
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
from .requests import (
    API_HEADERS,
    WITH_TOKEN,
    WITHOUT_TOKEN,
    ApiError,
    Client,
    check_same_origin,
    json_response,
    read_object,
    serve_page_file,
)
from .state import OwnState, RobotReader, Samples
from .updates import RobotState, State, Updates

LATEST_TICK_S = 6.0  # largest age of the tick of a healthy monitor: 5 s late
_MOST_PENDING = 500  # requests that wait for a robot or a disk
_READ_TIMEOUT_S = 5.0
_ROBOTS_AT_ONCE = 5  # are read without a pause for others in the same loop
MOST_READ = 200
"""Robots that an update of the pages reads in turn, besides those that announced something or are plotted."""
_KEPT_S = 0.2  # how long an answer of `/api/state` serves further requests
_LEVELS_KEPT_S = 5.0  # likewise of `/api/history/levels`: each is read from many rows
_PAST_AT_ONCE = 1  # requests that read the history: each contends with the monitor for the interpreter
_MOST_PAST_PENDING = 50

_NO_HISTORY = "there is no history; ops.yaml configures one"
_NO_BLACK_BOX = "nothing is recorded; ops.yaml configures a black box"
_MOST_SHOWN = 200
_NO_SILENCES = "there are no silences; ops.yaml configures a history for them"

Item = TypeVar("Item")
Result = TypeVar("Result")
Asked = TypeVar("Asked")
Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]
Json = Dict[str, Any]


class WebInterface:
    """Serves the state of robots. It costs nothing until the first request."""

    def __init__(
        self,
        robots: Callable[[], Sequence[AlertSystem]],
        *,
        threads: bool = False,
        history: Optional[History] = None,
        silences: Optional[Silences] = None,
        black_boxes: Optional[str] = None,
        notifications_waiting: Callable[[], int] = int,
        process_faults: Callable[[], Mapping[str, Fault]] = dict,
        wall_time_s: Callable[[], float] = time.time,
    ) -> None:
        """Prepares the routes.

        Args:
            robots: returns the alert_systems of the robots that are watched now.
            threads: whether robots are judged in other threads than the server's loop (ROS).
            history: None: there are no past alerts.
            silences: None: none can be added.
            black_boxes: folder with the recordings of alerts; None: nothing is recorded.
            notifications_waiting: returns how many are not delivered yet.
            process_faults: returns the faults of the monitor that belong to no robot, by part.
            wall_time_s: seconds since 1970.
        """
        self._robots = robots
        self._history = history
        self._silences = silences
        self._black_boxes = black_boxes
        self._wall_time_s = wall_time_s
        # Reading a robot waits for its callbacks, and a history for a disk.
        self._reading = ThreadPool("web", 4, _MOST_PENDING, _READ_TIMEOUT_S) if threads else None
        self._worker = ThreadPool("web", 8, _MOST_PENDING, _READ_TIMEOUT_S)
        self._past = ThreadPool("web history", _PAST_AT_ONCE, _MOST_PAST_PENDING, _READ_TIMEOUT_S)
        self._readers: Dict[AlertSystem, RobotReader] = {}
        self._answers: Dict[Tuple[object, ...], asyncio.Future[Any]] = {}
        self._announced: Set[AlertSystem] = set()
        self._next_read = 0
        self._own_state = OwnState(robots, process_faults)
        self._metrics = Metrics(notifications_waiting, wall_time_s, lambda: len(self._own_state.texts()))
        self.updates = Updates(self._read_update, self._read_samples)
        """The open pages."""

    def watch(self, alert_system: AlertSystem) -> None:
        """Counts the transitions of a robot, and sends them to open pages. Call once for each robot."""

        def note(event: Event) -> None:
            if isinstance(event, Transition):
                self._metrics.count(alert_system.robot, event)
            self._announced.add(alert_system)
            self.updates.note_change()

        alert_system.outlets.add("web", note)

    def routes(self, client_of: Callable[[web.Request], Client]) -> List[web.RouteDef]:
        """Returns the routes; `client_of` returns who sends a request."""
        self._client_of = client_of
        get, post = web.get, web.post
        return [
            get("/api/state", self._reading_route(self._get_state)),
            get("/api/events", self._reading_route(self.updates.serve), allow_head=False),
            get("/api/history", self._past_route(Query, past_alerts)),
            get("/api/history/samples", self._past_route(SamplesQuery, past_samples)),
            get("/api/history/levels", self._reading_route(self._get_past_levels)),
            get("/api/history/{id}", self._reading_route(self._get_past_alert)),
            get("/api/black_box/{name}", self._reading_route(self._get_black_box)),
            post("/api/login", self._route(self._login)),
            post("/api/logout", self._route(self._logout)),
            post("/api/silence", self._changing_route(NewSilence, self._add_silence)),
            post("/api/silence/expire", self._changing_route(EndOfSilence, self._expire_silence)),
            post("/api/note", self._changing_route(NewNote, self._add_note)),
            post("/api/reset", self._changing_route(Reset, self._reset)),
            get("/metrics", self._reading_route(self._get_metrics)),
            get("/healthz", self._route(self._get_health)),
            get("/", serve_page_file),
            get(r"/{name:[\w-]+\.\w+}", serve_page_file),
        ]

    def close(self) -> None:
        """Disconnects every page. Call in the server's loop."""
        self.updates.close()
        for pool in (self._reading, self._worker, self._past):
            if pool is not None:
                pool.close()

    # Checks

    def _route(self, handler: Handler) -> Handler:
        """Answers errors as docs/reference/api.md says."""

        async def handle(request: web.Request) -> web.StreamResponse:
            try:
                return await handler(request)
            except ApiError as error:
                return error.response()
            except ConfigError as error:
                return ApiError(400, error.problem).response()
            except MessageError as error:
                return ApiError(400, str(error)).response()
            except ServiceError as error:
                return ApiError(503, str(error)).response()

        return handle

    def _reading_route(self, handler: Handler) -> Handler:
        async def handle(request: web.Request) -> web.StreamResponse:
            client = self._client_of(request)
            return await handler(request) if client.admitted else client.refusal()

        return self._route(handle)

    def _past_route(self, schema: Type[Asked], read: Callable[[History, Asked], object]) -> Handler:
        """Answers a request with what a function reads from the history."""

        async def handle(request: web.Request) -> web.StreamResponse:
            history, query = _required(self._history, _NO_HISTORY), read_texts(schema, request.query)
            return json_response(await self._past.run(read, history, query))

        return self._reading_route(handle)

    def _changing_route(self, schema: Type[Asked], change: Callable[[Asked], Awaitable[object]]) -> Handler:
        async def handle(request: web.Request) -> web.StreamResponse:
            check_same_origin(request)
            answer = await change(read_record(schema, await read_object(request)))
            self._answers.clear()
            self._announced.update(self._robots())
            self.updates.note_change()
            return json_response(answer)

        return self._reading_route(handle)

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
        robot, window = request.query.get("robot", ""), request.query.get("window", "1") != "0"
        if robot:
            self._require_reader(robot)
        state = await self._shared_answer(("state", robot, window), partial(self._read_state, robot, window), _KEPT_S)
        return await _streamed(request, state.parts(), "application/json; charset=utf-8")

    async def _shared_answer(
        self, key: Tuple[object, ...], read: Callable[[], Awaitable[Result]], kept_s: float
    ) -> Result:
        """Returns an answer that serves all requests with the same key at the same time, and `kept_s` after it came."""
        answer = self._answers.get(key)
        if answer is None:
            answer = self._answers[key] = asyncio.ensure_future(read())

            def forget() -> None:
                if self._answers.get(key) is answer:
                    del self._answers[key]

            loop = asyncio.get_event_loop()
            answer.add_done_callback(lambda done: loop.call_later(0.0 if done.exception() else kept_s, forget))
        result: Result = await asyncio.shield(answer)
        return result

    async def _read_update(self, before: Optional[State], plotted: Collection[str]) -> State:
        """Returns the state. What was `before` counts for most robots of a large fleet: to read all costs too much."""
        announced, self._announced = self._announced, set()
        readers = self._current_readers()
        known: Dict[str, RobotState] = {}
        if before is not None and len(readers) > MOST_READ:
            begin = self._next_read % len(readers)
            self._next_read = begin + MOST_READ
            in_turn = (readers * 2)[begin : begin + MOST_READ]
            read = {reader.alert_system for reader in in_turn} | announced
            known = {name: state for name, state in before.robots.items() if name not in plotted}
            for robot in read:
                known.pop(robot.robot, None)
        return await self._state_of(readers, known)

    async def _read_state(self, robot: str = "", window: bool = False) -> State:
        readers = [reader for reader in self._current_readers() if robot in ("", reader.robot)]
        return await self._state_of(readers, {}, window)

    async def _state_of(
        self, readers: Sequence[RobotReader], known: Mapping[str, RobotState], window: bool = False
    ) -> State:
        unknown = [reader for reader in readers if reader.robot not in known]
        states = await self._read_each(unknown, lambda reader: RobotState.of(reader.state(window=window)))
        read = {**known, **{reader.robot: state for reader, state in zip(unknown, states)}}
        robots = {reader.robot: read[reader.robot] for reader in readers}
        active = [] if self._silences is None else self._silences.active()
        common = {
            "version": package_version(),
            "now": iso_time(self._wall_time_s()),
            "monitor": self._own_state.as_json(),
            "worst": Level.worst(Level[each.level] for each in robots.values()).name,
            "history": self._history is not None,
            "silencing": self._silences is not None,
            "can_change": True,  # every client that may read
            "silences": [silence_json(silence, self._wall_time_s()) for silence in active],
        }
        return State(common, robots)

    async def _read_samples(self, robot: str, before: Optional[Samples]) -> Optional[Samples]:
        reader = self._reader(robot)
        return None if reader is None else await self._read(partial(reader.samples, before))

    def _current_readers(self) -> List[RobotReader]:
        """Returns the readers of the robots that are watched now."""
        robots = self._robots()
        known = self._readers
        self._readers = {
            robot: known.get(robot) or RobotReader(robot, self._own_state, self._wall_time_s) for robot in robots
        }
        return list(self._readers.values())

    def _reader(self, robot: str) -> Optional[RobotReader]:
        return next((reader for reader in self._current_readers() if reader.robot == robot), None)

    def _require_reader(self, robot: str) -> RobotReader:
        return _required(self._reader(robot), f"there is no robot {robot}")

    async def _read(self, function: Callable[[], Result]) -> Result:
        """Reads robots: in a thread if that may wait."""
        return function() if self._reading is None else await self._reading.run(function)

    async def _read_each(self, items: Iterable[Item], function: Callable[[Item], Result]) -> List[Result]:
        results = []
        for number, item in enumerate(items, 1):
            results.append(await self._read(partial(function, item)))
            if number % _ROBOTS_AT_ONCE == 0:
                await asyncio.sleep(0)
        return results

    # History

    async def _get_past_levels(self, request: web.Request) -> web.StreamResponse:
        encode = partial(self._past.run, past_levels, _required(self._history, _NO_HISTORY))
        return json_response(await self._shared_answer(("levels",), encode, _LEVELS_KEPT_S))

    async def _get_past_alert(self, request: web.Request) -> web.StreamResponse:
        history, text = _required(self._history, _NO_HISTORY), request.match_info["id"]
        number = int(text) if text.isascii() and text.isdigit() and len(text) < 19 else -1
        found = await self._past.run(past_alert, history, number)
        past = _required(found, f"there is no alert {text[:_MOST_SHOWN]}; the history deletes old ones")
        reader = self._reader(past.alert["robot"])
        unit, bounds, forecast_s = ("", [], None) if reader is None else reader.plot_of(past.alert["signal"])
        return json_response({"unit": unit, "bounds": bounds, "forecast_s": forecast_s, **past._asdict()})

    async def _get_black_box(self, request: web.Request) -> web.StreamResponse:
        folder, name = _required(self._black_boxes, _NO_BLACK_BOX), request.match_info["name"]
        problem = f"there is no {name[:_MOST_SHOWN]!r}: it is being written, was deleted, or could not be written"
        path = _required(await self._worker.run(find_file, folder, name), problem)
        headers = {"Content-Type": "application/octet-stream", "Content-Disposition": f'attachment; filename="{name}"'}
        return web.FileResponse(path, headers={**API_HEADERS, **headers})

    # Changes

    async def _add_silence(self, new: NewSilence) -> object:
        added = await self._worker.run(new_silence, _required(self._silences, _NO_SILENCES), new)
        return {"silence": silence_json(added, self._wall_time_s())}

    async def _expire_silence(self, end: EndOfSilence) -> object:
        await self._worker.run(expire_silence, _required(self._silences, _NO_SILENCES), end)
        return {"ok": True}

    async def _add_note(self, new: NewNote) -> object:
        return {"note": await self._worker.run(new_note, _required(self._history, _NO_HISTORY), new)}

    async def _reset(self, wanted: Reset) -> object:
        return {"message": await self._read(self._require_reader(wanted.robot).alert_system.reset)}

    # Metrics and health

    async def _get_metrics(self, request: web.Request) -> web.StreamResponse:
        profile = request.query.get("profile", PROFILES[0])
        if profile not in PROFILES:
            raise ApiError(400, f"profile: expected {' or '.join(PROFILES)}, got {profile[:40]!r}")
        robots = await self._read_each(self._robots(), self._metrics.read)
        return await _streamed(request, self._metrics.render(robots, profile), CONTENT_TYPE)

    async def _get_health(self, request: web.Request) -> web.StreamResponse:
        late = [robot for robot in self._robots() if robot.tick_age_s > LATEST_TICK_S]
        if not late:
            admitted = self._client_of(request).admitted
            return json_response({"ok": True, "faults": self._own_state.texts()} if admitted else {"ok": True})
        oldest_s = max(robot.tick_age_s for robot in late)
        return json_response({"ok": False, "error": f"no tick for {oldest_s:.0f} s"}, status=503)


async def _streamed(request: web.Request, parts: Iterable[bytes], content_type: str) -> web.StreamResponse:
    """Sends an answer in parts: of large fleets, all of them take much memory and time."""
    response = web.StreamResponse(headers={**API_HEADERS, "Content-Type": content_type})
    await response.prepare(request)
    if request.method != "HEAD":
        for part in parts:
            await response.write(part)
            await asyncio.sleep(0)
    return response


def _required(found: Optional[Result], problem: str) -> Result:
    """Returns what was found; raises ApiError (404) if that is None."""
    if found is None:
        raise ApiError(404, problem)
    return found
