"""The page and the API as clients see them: a real server, real requests."""

from __future__ import annotations

import asyncio
import json
import socket
import sqlite3
import threading
from pathlib import Path
from typing import Any, Callable
from unittest import mock

import pytest

pytest.importorskip("aiohttp", reason="aiohttp, which serves the page, is not installed")

import aiohttp
from harness.web import Robots, Site, open_page, with_site
from yarl import URL

from robot_health_monitor.core.values.errors import ServiceError
from robot_health_monitor.core.values.faults import Faults
from robot_health_monitor.core.values.model import Level
from robot_health_monitor.ops.store.active_silences import Silences
from robot_health_monitor.ops.store.history import History
from robot_health_monitor.ops.store.matchers import parse_matchers
from robot_health_monitor.ops.store.recurrence import parse_recurrence
from robot_health_monitor.ops.web.requests import WITHOUT_TOKEN
from robot_health_monitor.ops.web.updates import State, _event
from robot_health_monitor.runtime.access import SESSION_S

BEARER = {"Authorization": "Bearer s3cret"}
EXPECTED = {
    "level": "WARN",
    "link": None,
    "signal": "battery_level",
    "message": "19 % is below 20 %",
    "since": "2026-11-22T05:06:41.000Z",
    "monitor": {"level": "OK", "message": "no faults"},
    "show": ["battery_level"],
    "signals": {
        "battery_level": {
            "level": "WARN",
            "state": "firing",
            "value": 19.0,
            "unit": "%",
            "message": "19 % is below 20 %",
            "hint": "",
            "since": "2026-11-22T05:06:41.000Z",
            "silenced": None,
            "bounds": [{"level": "WARN", "side": "below", "value": 20.0, "clears": 22.0}],
            "window": [[1_795_324_000.0, 50.0], [1_795_324_001.0, 19.0]],
            "text": "19 %",
            "outlook": "",
            "statistic": "last",
            "judged": 19.0,
            "judged_unit": "%",
            "forecast": None,
            "forecast_s": None,
            "trend_per_min": None,
            "time_to_bound_s": None,
            "flapping": False,
            "cause": None,
            "affects": 0,
            "latch": True,
        }
    },
}


def low_battery() -> Robots:
    robots = Robots()
    robots.observe(50.0)
    robots.at(101.0)
    robots.observe(19.0)
    return robots


# --- state ------------------------------------------------------------------------------------------------------------


def test_the_state_is_as_documented() -> None:
    async def use(site: Site) -> None:
        status, state = await site.get("/api/state")
        assert status == 200
        assert state.pop("version")
        assert state == {
            "now": "2026-11-22T05:06:41.000Z",
            "monitor": {"level": "OK", "message": "no faults", "faults": []},
            "worst": "WARN",
            "history": True,
            "silencing": True,
            "can_change": True,
            "silences": [],
            "robots": {"atlas": EXPECTED},
        }

    with_site(use, low_battery())


def test_the_state_of_one_robot_and_without_samples() -> None:
    async def use(site: Site) -> None:
        _, state = await site.get("/api/state?robot=spot&window=0")
        assert list(state["robots"]) == ["spot"]
        assert state["robots"]["spot"]["signals"]["battery_level"]["window"] == []
        assert await site.get("/api/state?robot=talos") == (404, {"error": "there is no robot talos"})

    with_site(use, Robots("atlas", "spot"))


def test_a_thousand_requests_are_answered() -> None:
    async def use(site: Site) -> None:
        for _ in range(10):
            answers = await asyncio.gather(*(site.get("/healthz") for _ in range(100)))
            assert {status for status, _ in answers} == {200}

    with_site(use)


@pytest.mark.parametrize("name", ["<img src=x onerror=alert(1)>", "Großer Förderroboter 'Überlänge' \\ \"x\""])
def test_names_are_data(name: str) -> None:
    async def use(site: Site) -> None:
        async with site.session.get(f"{site.url}/api/state") as response:
            body = await response.read()
            assert body.isascii()
            assert list((await response.json())["robots"]) == [name]
        assert (await site.get("/metrics"))[0] in (200, 501)
        async with open_page(site) as page:
            _, state = await page.next("state")
            assert list(state["robots"]) == [name]

    with_site(use, Robots(name))


@pytest.mark.parametrize("value", [float("nan"), float("inf"), 10**400, "\x1b[31m\ud800", None, b"\xff"])
def test_any_value_gives_valid_json(value: object) -> None:
    async def use(site: Site) -> None:
        site.robots.observe(value)
        status, state = await site.get("/api/state")
        assert status == 200
        signal = state["robots"]["atlas"]["signals"]["battery_level"]
        assert signal["value"] is None
        assert signal["message"].startswith("invalid data: ")
        assert signal["message"].isprintable()
        assert (await site.get("/metrics"))[0] in (200, 501)

    with_site(use)


# --- who may read -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", ["/api/state", "/api/events", "/api/history", "/api/history/1", "/metrics"])
def test_reading_needs_the_token(path: str) -> None:
    async def use(site: Site) -> None:
        async with site.session.get(site.url + path) as response:
            assert response.status == 401
            assert response.headers["WWW-Authenticate"] == "Bearer"
            assert await response.json() == {"error": "a token is required"}
        assert (await site.get(path, headers={"Authorization": "Bearer wrong"}))[0] == 401
        assert (await site.get(path, headers={"Authorization": "Basic s3cret"}))[0] == 401

    with_site(use, token="s3cret")


def test_the_page_and_the_health_check_need_no_token() -> None:
    async def use(site: Site) -> None:
        site.robots.bus.nodes[0].faults.report("history", "/secret/place is full")
        assert (await site.get("/"))[0] == 200
        assert await site.get("/healthz") == (200, {"ok": True})  # without the token, nothing is named
        named = {"ok": True, "faults": ["history: /secret/place is full"]}
        assert await site.get("/healthz", headers=BEARER) == (200, named)

    with_site(use, token="s3cret")


def test_a_program_presents_the_token_in_a_header() -> None:
    async def use(site: Site) -> None:
        assert (await site.get("/api/state", headers=BEARER))[0] == 200

    with_site(use, token="s3cret")


def test_a_page_gets_a_cookie_for_the_token() -> None:
    async def use(site: Site) -> None:
        assert await site.post("/api/login", {"token": "wrong"}) == (401, {"error": "wrong token"})
        async with site.session.post(f"{site.url}/api/login", json={"token": "s3cret"}) as response:
            assert (response.status, await response.json()) == (200, {"ok": True})
            (cookie,) = response.headers.getall("Set-Cookie")
        assert "s3cret" not in cookie
        assert cookie.partition("; ")[2] == f"Path=/; Max-Age={SESSION_S}; HttpOnly; SameSite=Strict"
        assert (await site.get("/api/state"))[0] == 200
        async with open_page(site) as page:
            assert (await page.next())[0] == "state"
        assert await site.post("/api/logout", {}) == (200, {"ok": True})
        assert (await site.get("/api/state"))[0] == 401

    with_site(use, token="s3cret")


def test_wrong_tokens_are_limited_and_never_lock_out_the_right_one() -> None:
    async def use(site: Site) -> None:
        for number in range(10):
            guess = {"Authorization": f"Bearer {number}"}
            assert (await site.get("/api/state", headers=guess)) == (401, {"error": "wrong token"})
        for refused in (
            site.session.get(f"{site.url}/api/state", headers={"Authorization": "Bearer guess"}),
            site.session.post(f"{site.url}/api/login", json={"token": "guess"}),
        ):
            async with refused as response:
                assert response.status == 429
                assert 0 < int(response.headers["Retry-After"]) <= 60
        assert (await site.get("/api/state", headers=BEARER))[0] == 200
        assert (await site.post("/api/login", {"token": "s3cret"})) == (200, {"ok": True})
        assert (await site.get("/api/state"))[0] == 200

    with_site(use, token="s3cret")


def test_a_body_before_the_token_is_small() -> None:
    async def use(site: Site) -> None:
        problem = {"error": "expected a body of at most 4096 bytes"}
        assert await site.post("/api/login", {"token": "x" * 4096}) == (413, problem)
        assert await site.post("/api/login", {"token": "x" * 4096}, headers=BEARER) == (401, {"error": "wrong token"})

    with_site(use, token="s3cret")


def test_half_a_body_before_the_token_is_not_waited_for_long(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("robot_health_monitor.ops.web.interface.WITHOUT_TOKEN", (4096, 0.1))

    async def use(site: Site) -> None:
        reader, writer = await asyncio.open_connection("127.0.0.1", site.server.port)
        head = (
            "POST /api/login HTTP/1.1\r\nHost: robot\r\nContent-Type: application/json\r\nContent-Length: 100\r\n\r\n{"
        )
        writer.write(head.encode("ascii"))
        assert await asyncio.wait_for(reader.readline(), 30.0) == b"HTTP/1.1 400 Bad Request\r\n"
        writer.close()

    assert WITHOUT_TOKEN == (4096, 5.0)
    with_site(use, token="s3cret")


def test_without_a_token_a_name_that_is_not_loopback_is_refused() -> None:
    async def use(site: Site) -> None:
        for path in ("/", "/api/state", "/metrics"):
            assert (await site.get(path, headers={"Host": "rebound.example.org"}))[0] == 403

    with_site(use)


# --- changes ----------------------------------------------------------------------------------------------------------


def test_reset_clears_latched_alerts() -> None:
    async def use(site: Site) -> None:
        site.robots.observe(50.0)
        assert (await site.get("/api/state"))[1]["worst"] == "WARN"
        assert await site.post("/api/reset", {"robot": "atlas"}) == (200, {"message": "reset: battery_level"})
        assert site.robots.all[0].monitor.report(101.0).overall is Level.OK
        assert (await site.get("/api/state"))[1]["worst"] == "OK"
        assert await site.post("/api/reset", {"robot": "spot"}) == (404, {"error": "there is no robot spot"})
        assert (await site.post("/api/reset", {}))[0] == 404
        assert (await site.post("/api/reset", {"robot": ["atlas"]}))[0] == 400

    with_site(use, low_battery())


def test_changes_need_the_token_and_the_servers_own_page() -> None:
    async def use(site: Site) -> None:
        body = {"robot": "atlas"}
        assert (await site.post("/api/reset", body))[0] == 401
        own = {**BEARER, "Origin": site.url, "Sec-Fetch-Site": "same-origin"}
        assert (await site.post("/api/reset", body, headers=own))[0] == 200
        for foreign in (
            {"Origin": "https://evil.example.org"},
            {"Origin": "http://127.0.0.1:1"},
            {"Origin": "null"},
            {"Origin": ""},
            {"Sec-Fetch-Site": "cross-site"},
            {"Sec-Fetch-Site": "same-site"},
        ):
            assert (await site.post("/api/reset", body, headers={**BEARER, **foreign}))[0] == 403, foreign
        assert (await site.get("/api/reset", headers=BEARER))[0] == 405

    with_site(use, token="s3cret")


def test_a_page_of_another_local_server_may_not_change_anything() -> None:
    async def use(site: Site) -> None:
        status, answer = await site.post("/api/reset", {"robot": "atlas"}, headers={"Origin": "http://localhost:3000"})
        assert (status, answer["error"]) == (403, "requests that change something must come from the server's own page")

    with_site(use)


@pytest.mark.parametrize(
    ("body", "content_type", "status"),
    [
        (b'{"robot": "atlas"}', "text/plain", 415),
        (b'{"robot": "atlas"}', "application/x-www-form-urlencoded", 415),
        (b"", "application/json", 400),
        (b"[1]", "application/json", 400),
        (b"NaN", "application/json", 400),
        (b"\xff\xfe", "application/json", 400),
        (b"[" * 16_000, "application/json", 400),
        (b"9" * 16_000, "application/json", 400),
        (b'{"robot": "' + b"x" * 20_000 + b'"}', "application/json", 413),
    ],
)
def test_a_body_that_is_no_small_json_object_is_refused(body: bytes, content_type: str, status: int) -> None:
    async def use(site: Site) -> None:
        headers = {"Content-Type": content_type}
        async with site.session.post(f"{site.url}/api/reset", data=body, headers=headers) as response:
            assert response.status == status
            assert list(await response.json()) == ["error"]

    with_site(use)


def test_a_large_body_without_a_length_is_refused() -> None:
    async def chunks() -> Any:
        for _ in range(100):
            yield b" " * 1000

    async def use(site: Site) -> None:
        headers = {"Content-Type": "application/json"}
        try:
            async with site.session.post(f"{site.url}/api/reset", data=chunks(), headers=headers) as response:
                assert response.status == 413
        except aiohttp.ClientConnectionError:
            pass  # the server answered and closed before everything was sent

    with_site(use)


def test_unknown_paths_and_methods_are_errors_in_json() -> None:
    async def use(site: Site) -> None:
        for method, path, status, allowed in (
            ("GET", "/api/nothing", 404, None),
            ("GET", "/nothing", 404, None),
            ("GET", "/nothing.html", 404, None),
            ("GET", "/robots/atlas", 404, None),
            ("PUT", "/api/state", 405, "GET,HEAD"),
            ("POST", "/api/history/1", 405, "GET,HEAD"),
            ("GET", "/api/silence", 405, "POST"),
            ("POST", "/", 405, "GET,HEAD"),
            ("POST", "/healthz", 405, "GET,HEAD"),
        ):
            async with site.session.request(method, site.url + path) as response:
                assert (response.status, response.headers.get("Allow")) == (status, allowed)
                assert list(await response.json()) == ["error"]

        async with site.session.head(f"{site.url}/api/state") as response:
            assert response.status == 200
        async with site.session.head(f"{site.url}/api/events") as response:  # its answer would not end
            assert response.status == 405

    with_site(use)


# --- events -----------------------------------------------------------------------------------------------------------


def test_a_page_gets_the_state_then_only_what_changed() -> None:
    async def use(site: Site) -> None:
        async with open_page(site) as page:
            kind, state = await page.next()
            assert kind == "state"
            assert state["robots"]["atlas"]["signals"]["battery_level"]["window"] == []
            site.robots.at(102.0)
            site.robots.observe(9.0)
            while True:
                _, change = await page.next("change")
                if "robots" in change:
                    break
            assert change == {
                "now": "2026-11-22T05:06:42.000Z",
                "robots": {
                    "atlas": {
                        "message": "9 % is below 20 %",
                        "signals": {
                            "battery_level": {
                                "value": 9.0,
                                "message": "9 % is below 20 %",
                                "text": "9 %",
                                "judged": 9.0,
                            }
                        },
                    }
                },
            }

    with_site(use, low_battery())


def test_an_alert_is_sent_at_once_and_a_page_without_news_gets_the_time() -> None:
    async def use(site: Site) -> None:
        async with open_page(site) as page:
            await page.next("state")
            started_s = asyncio.get_event_loop().time()
            site.robots.observe(9.0)
            _, change = await page.next("change")
            assert change["robots"]["atlas"]["level"] == change["worst"] == "WARN"
            assert asyncio.get_event_loop().time() - started_s < 10.0
            _, change = await page.next("change")
            assert change == {}  # virtual time stands still

    with_site(use)


def test_a_page_gets_the_samples_of_the_robot_that_it_shows() -> None:
    async def use(site: Site) -> None:
        async with open_page(site, "?robot=atlas") as page, open_page(site, "?robot=spot") as other:
            assert (await page.next())[0] == "state"
            assert await page.next("samples") == (
                "samples",
                {
                    "robot": "atlas",
                    "full": True,
                    "signals": {"battery_level": [[1_795_324_000.0, 50.0]]},
                    "window_s": {"battery_level": 60.0},
                },
            )
            site.robots.at(101.0)
            site.robots.observe(49.0)
            while True:
                _, samples = await page.next("samples")
                if samples["signals"]:
                    break
            assert samples["full"] is False
            assert samples["signals"] == {"battery_level": [[1_795_324_001.0, 49.0]]}
            site.robots.at(50.0)  # time went back
            site.robots.observe(48.0)
            while not samples["full"]:
                _, samples = await page.next("samples")
            assert [value for _, value in samples["signals"]["battery_level"]] == [48.0]
            _, samples = await other.next("samples")
            assert (samples["robot"], samples["full"]) == ("spot", True)

    robots = Robots("atlas", "spot")
    robots.observe(50.0)
    with_site(use, robots)


def test_a_page_gets_the_samples_of_several_robots() -> None:
    async def use(site: Site) -> None:
        async with open_page(site, "?robot=atlas&robot=talos&robot=atlas") as page, open_page(site) as other:
            received = [await page.next("samples") for _ in range(2)]
            assert [(samples["robot"], samples["full"]) for _, samples in received] == [
                ("atlas", True),
                ("talos", True),
            ]
            site.robots.observe(49.0, robot=2)
            while not samples_of(received[-1], "talos"):
                received.append(await page.next("samples"))
            assert samples_of(received[-1], "talos") == [49.0]
            assert "spot" not in {samples["robot"] for _, samples in received}
            kinds = [(await other.next())[0] for _ in range(3)]
            assert "samples" not in kinds
        while site.web.updates.pages:
            await asyncio.sleep(0.01)
        assert site.web.updates._samples == {}

    def samples_of(event: tuple[str, dict[str, Any]], robot: str) -> list[float]:
        _, data = event
        return [value for _, value in data["signals"].get("battery_level", ())] if data["robot"] == robot else []

    with_site(use, Robots("atlas", "spot", "talos"))


def test_an_update_that_fails_loses_no_change() -> None:
    async def use(site: Site) -> None:
        async with open_page(site, "?robot=atlas") as page:
            await page.next("samples")
            updates = site.web.updates
            assert updates._task is not None
            updates._task.cancel()  # the test makes the updates
            read = updates._read_samples

            async def fail(robot: str, before: Any) -> Any:
                raise ServiceError("busy")

            updates._read_samples = fail
            site.robots.observe(9.0)
            with pytest.raises(ServiceError):
                await updates._update()
            updates._read_samples = read
            await updates._update()
            while True:
                _, change = await page.next("change")
                if "worst" in change:
                    break
            assert change["worst"] == "WARN"
            assert [value for _, value in (await page.next("samples"))[1]["signals"]["battery_level"]] == [9.0]

    with_site(use)


def test_pages_are_disconnected_and_the_cause_is_logged_when_the_state_cannot_be_read() -> None:
    lines: list[str] = []
    robots = Robots()
    robots.bus.add_log(lambda line: lines.append(line.text))

    async def use(site: Site) -> None:
        async def fail(before: object, plotted: object) -> Any:
            raise RuntimeError("the state is broken")

        async with open_page(site) as page:
            await page.next("state")
            site.web.updates._read_state, read = fail, site.web.updates._read_state
            with pytest.raises((EOFError, aiohttp.ClientError)):
                await page.next("none of this kind")
        while site.web.updates.pages:
            await asyncio.sleep(0.01)
        assert (await site.get("/api/events"))[0] == 500
        assert any("RuntimeError" in line for line in lines)
        site.web.updates._read_state = read
        async with open_page(site) as page:
            assert (await page.next())[0] == "state"

    with_site(use, robots)


def test_an_update_of_a_large_fleet_reads_some_robots_in_turn_and_at_once_those_that_are_plotted_or_announce_something(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("robot_health_monitor.ops.web.interface.MOST_READ", 2)

    async def use(site: Site) -> None:
        def observe_all(value: float) -> None:
            for number in range(6):
                site.robots.observe(value, robot=number)

        async def update(*plotted: str) -> list[float]:
            nonlocal state
            state = await site.web._read_update(state, plotted)
            return [json.loads(robot.data)["signals"]["battery_level"]["value"] for robot in state.robots.values()]

        state = State({}, {})
        observe_all(50.0)
        assert await update() == [50.0] * 6
        observe_all(60.0)
        assert await update() == [50.0, 50.0, 60.0, 60.0, 50.0, 50.0]
        assert await update("a") == [60.0, 50.0, 60.0, 60.0, 60.0, 60.0]
        site.robots.observe(10.0, robot=0)  # an alert
        assert await update() == [10.0, 60.0, 60.0, 60.0, 60.0, 60.0]
        observe_all(70.0)
        await site.post("/api/reset", {"robot": "c"})  # whoever changes something sees it at once
        assert await update() == [70.0] * 6

    with_site(use, Robots(*"abcdef"))


def test_robots_that_come_and_go_are_a_new_state() -> None:
    async def use(site: Site) -> None:
        async with open_page(site) as page:
            await page.next("state")
            site.robots.all.append(site.robots.new("spot"))
            _, state = await page.next("state")
            assert list(state["robots"]) == ["atlas", "spot"]
            del site.robots.all[0]
            _, state = await page.next("state")
            assert list(state["robots"]) == ["spot"]

    with_site(use)


def test_a_hundred_pages_cost_one_encoding() -> None:
    async def use(site: Site) -> None:
        pages = [open_page(site) for _ in range(100)]
        opened = [await page.__aenter__() for page in pages]
        for page in opened:
            await page.next("state")
        updates = site.web.updates
        assert updates._task is not None
        updates._task.cancel()  # the test makes the update
        site.robots.observe(9.0)
        with mock.patch("robot_health_monitor.ops.web.updates._event", wraps=_event) as encode:
            await updates._update()
        assert encode.call_count == 1
        for page in opened:
            _, change = await page.next("change")
            while "worst" not in change:
                _, change = await page.next("change")
            assert change["worst"] == "WARN"
        for each in pages:
            await each.__aexit__(None, None, None)

    with_site(use)


def test_without_a_page_nothing_is_read() -> None:
    async def use(site: Site) -> None:
        async with open_page(site) as page:
            await page.next("state")
        while site.web.updates.pages:
            await asyncio.sleep(0.01)
        assert site.web.updates._task is None
        assert site.web.updates._state.robots == {}

    with_site(use)


def test_an_unknown_robot_has_no_samples() -> None:
    async def use(site: Site) -> None:
        for query in ("?robot=talos", "?robot=atlas&robot=talos"):
            assert await site.get(f"/api/events{query}") == (404, {"error": "there is no robot talos"})
        many = "&".join(f"robot=r{number}" for number in range(11))
        assert await site.get(f"/api/events?{many}") == (400, {"error": "robot: expected at most 10 names, got 11"})
        assert len(site.web.updates.pages) == 0

    with_site(use)


def test_a_new_page_replaces_the_oldest_of_the_address_that_has_most(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("robot_health_monitor.ops.web.updates.MOST_PAGES", 3)

    async def use(site: Site) -> None:
        other = aiohttp.TCPConnector(local_addr=("127.0.0.2", 0))
        async with aiohttp.ClientSession(connector=other) as session:
            elsewhere = Site(site.robots, site.web, site.server, session)
            async with open_page(elsewhere) as first, open_page(site) as second, open_page(site) as third:
                for page in (first, second, third):
                    await page.next()
                async with open_page(site) as new:
                    assert (await new.next())[0] == "state"
                    assert len(site.web.updates.pages) == 3
                    with pytest.raises((EOFError, aiohttp.ClientError)):
                        await second.next("none of this kind")
                    for page in (first, third, new):
                        assert (await page.next())[0] == "change"

    with_site(use)


def test_a_page_that_does_not_read_is_disconnected(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("robot_health_monitor.ops.web.updates.PERIOD_S", 0.01)

    async def use(site: Site) -> None:
        with socket.socket() as page:
            page.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            page.connect(("127.0.0.1", site.server.port))
            page.send(b"GET /api/events?robot=atlas HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
            while not site.web.updates.pages:
                await asyncio.sleep(0.01)
            (connection,) = site.server._connections._timeouts
            connection.transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
            now_s = 100.0
            while site.web.updates.pages:
                now_s += 1.0
                site.robots.at(now_s)
                for signal in many:
                    site.robots.observe(now_s, signal)
                await asyncio.sleep(0.01)

    many = [f"signal_{number}" for number in range(200)]
    with_site(use, Robots(signals={name: {"warn_above": 1e9} for name in many}))


def test_the_end_of_the_server_ends_the_pages() -> None:
    async def use(site: Site) -> None:
        async with open_page(site) as page:
            await page.next()
            await asyncio.wait_for(site.server.close(), 5.0)
            with pytest.raises((EOFError, aiohttp.ClientError)):
                await page.next("none of this kind")

    with_site(use)


# --- history and silences ---------------------------------------------------------------------------------------------


def test_past_alerts_come_with_their_evidence(tmp_path: Path) -> None:
    robots = Robots(history_file=str(tmp_path / "history.db"))
    robots.observe(50.0)
    robots.at(101.0)
    robots.observe(19.0)
    robots.at(102.0)
    robots.observe(18.0)

    async def use(site: Site) -> None:
        status, answer = await site.get("/api/history")
        assert status == 200
        (alert,) = answer["alerts"]
        number = alert.pop("id")
        expected = {
            "time": "2026-11-22T05:06:41.000Z",
            "robot": "atlas",
            "signal": "battery_level",
            "from_level": "OK",
            "to_level": "WARN",
            "value": 19.0,
            "statistic": "last",
            "bound": 20.0,
            "since": "2026-11-22T05:06:40.000Z",
            "text": "battery_level WARN: 19 % is below 20 % (was OK for 1 s)",
            "hint": "",
            "black_box": "",
            "alert_id": number,
            "cause": None,
            "effects": [],
            "repeat": False,
            "notes": [],
        }
        assert alert == expected
        assert (answer["more"], answer["gaps"]) == (False, [])
        status, answer = await site.get(f"/api/history/{number}")
        assert answer == {
            "alert": {"id": number, **expected},
            "unit": "%",
            "bounds": [{"level": "WARN", "side": "below", "value": 20.0, "clears": 22.0}],
            "forecast_s": None,
            "trend_per_min": None,
            "samples": [[1_795_324_000.0, 50.0], [1_795_324_001.0, 19.0]],
            "others": [],
            "silences": [],
            "thresholds": {"unit": "%", "warn_below": 20.0, "hysteresis": 2.0, "latch": True},
        }
        assert (await site.get("/api/history/999"))[0] == 404
        for name in ("x", "-1", "%C2%B2", "9" * 40):
            assert (await site.get(f"/api/history/{name}"))[0] == 400, name
        for query, found in (
            ("robot=atlas&signal=battery_level&level=WARN&since=2026-11-22T05:00:00Z", 1),
            ("robot=spot", 0),
            ("level=ERROR", 0),
            ("since=2026-11-22T06:00:00Z", 0),
            (f"before={number}", 0),
        ):
            assert len((await site.get(f"/api/history?{query}"))[1]["alerts"]) == found, query
        for query in ("level=BAD", "since=yesterday", "since=%ff", "limit=0", "limit=1001", "before=x", "limit=%F9"):
            assert (await site.get(f"/api/history?{query}"))[0] == 400, query
        assert (await site.get("/api/state"))[1]["history"] is True

    with_site(use, robots)


def test_an_alert_comes_with_what_else_was_wrong_silenced_and_in_force(tmp_path: Path) -> None:
    signals = {"battery_level": {"warn_below": 20.0}, "load": {"warn_above": 90.0}, "heat": {"warn_above": 80.0}}
    robots = Robots("atlas", "boreas", signals=signals, history_file=str(tmp_path / "history.db"))
    assert robots.silences is not None and robots.history is not None
    for matchers, author in (("robot=atlas", "ana"), ("robot=boreas", "bo"), ("robot=atlas,signal=load", "cy")):
        robots.silences.add(parse_matchers(matchers), for_s=3600.0, reason="maintenance", author=author)
    robots.observe(99.0, "load")
    robots.observe(99.0, "heat")
    robots.observe(99.0, "load", robot=1)
    robots.at(101.0)
    robots.observe(50.0, "heat")
    robots.observe(10.0)
    robots.at(102.0)
    robots.observe(99.0, "heat")
    robots.observe(50.0)
    robots.silences.add(parse_matchers("robot=atlas"), for_s=3600.0, reason="too late", author="ana")

    async def use(site: Site) -> None:
        (alert,) = (await site.get("/api/history?signal=battery_level&level=WARN"))[1]["alerts"]
        past = (await site.get(f"/api/history/{alert['id']}"))[1]
        assert [(each["signal"], each["to_level"]) for each in past["others"]] == [("load", "WARN")]
        assert [each["author"] for each in past["silences"]] == ["ana"]
        assert past["thresholds"] == {"warn_below": 20.0}

    with_site(use, robots)


def test_the_page_of_an_acknowledged_alert_has_its_acknowledgement(tmp_path: Path) -> None:
    signals = {"battery_level": {"warn_below": 20.0}}
    robots = Robots(signals=signals, history_file=str(tmp_path / "history.db"))
    assert robots.silences is not None
    robots.observe(10.0)
    robots.at(101.0)
    robots.silences.add(parse_matchers("signal=battery*"), until_resolved=True, reason="known", author="ana")
    robots.at(102.0)
    robots.observe(50.0)
    robots.at(103.0)
    robots.observe(10.0)  # the next alert

    async def use(site: Site) -> None:
        alerts = (await site.get("/api/history?level=WARN"))[1]["alerts"]
        pages = [(await site.get(f"/api/history/{each['id']}"))[1] for each in alerts]
        assert [[each["reason"] for each in page["silences"]] for page in pages] == [[], ["known"]]

    with_site(use, robots)


def test_stored_samples_and_the_levels_of_a_day(tmp_path: Path) -> None:
    robots = Robots(history_file=str(tmp_path / "history.db"))
    robots.observe(50.0)
    robots.at(101.0)
    robots.observe(19.0)
    robots.at(105.0)
    robots.observe("x")
    for now_s in range(106, 122):
        robots.at(float(now_s))
    assert robots.history is not None
    robots.history.run(lambda connection: None)
    first = {
        "robot": "atlas", "signal": "battery_level", "start": "2026-11-22T05:06:40.000Z", "seconds": 10.0, "min": 19.0,
        "max": 50.0, "mean": 34.5, "last": 19.0, "good": 2, "bad": 1, "level": "ERROR",
    }  # fmt: skip
    second = {
        **first, "start": "2026-11-22T05:06:50.000Z", "min": None, "max": None, "mean": None, "last": None, "good": 0,
        "bad": 0,
    }  # fmt: skip

    async def use(site: Site) -> None:
        path = "/api/history/samples?robot=atlas&signal=battery_level"
        assert await site.get(path) == (200, {"samples": [first, second], "more": False})
        assert (await site.get(f"{path}&from=2026-11-22T05:06:50Z"))[1]["samples"] == [second]
        assert (await site.get(f"{path}&to=2026-11-22T05:06:50Z"))[1]["samples"] == [first]
        minute = {**first, "start": "2026-11-22T05:06:00.000Z", "seconds": 60.0}
        assert await site.get(f"{path}&seconds=60") == (200, {"samples": [minute], "more": False})
        for query in ("robot=atlas", "signal=battery_level", "robot=a&signal=b&from=x", "robot=a&signal=b&seconds=0"):
            assert (await site.get(f"/api/history/samples?{query}"))[0] == 400, query
        # The cell of 05:00 is the last one of the 24 hours.
        cells = {"from": "2026-11-21T05:15:00.000Z", "seconds": 900.0, "robots": {"atlas": "-" * 95 + "E"}}
        assert await site.get("/api/history/levels") == (200, cells)

    with_site(use, robots)


def test_requests_for_the_past_are_read_one_at_a_time_and_only_so_many_wait(tmp_path: Path) -> None:
    robots = Robots(history_file=str(tmp_path / "history.db"))
    history = robots.history
    assert history is not None
    read, may_read, lock = history.read, threading.Event(), threading.Lock()
    reading: list[int] = [0, 0]  # now, and most at once

    def slow_read(function: Callable[[sqlite3.Connection], object]) -> object:
        with lock:
            reading[0] += 1
            reading[1] = max(reading)
        may_read.wait(30.0)
        found = read(function)
        with lock:
            reading[0] -= 1
        return found

    async def use(site: Site) -> None:
        path = "/api/history/samples?robot=atlas&signal=battery_level"
        asked = [asyncio.ensure_future(site.get(path)) for _ in range(60)]
        answered = iter(asyncio.as_completed(asked))
        refused = [await next(answered) for _ in range(10)]
        assert refused == [(503, {"error": "busy: 50 requests are pending"})] * 10
        assert (await site.get("/healthz"))[0] == (await site.get("/api/state"))[0] == 200
        may_read.set()
        assert sum(status == 200 for status, _ in await asyncio.gather(*asked)) == 50
        assert reading == [0, 1]

    with mock.patch.object(history, "read", slow_read):
        with_site(use, robots)


def test_more_alerts_come_page_by_page(tmp_path: Path) -> None:
    robots = Robots(history_file=str(tmp_path / "history.db"))
    for number in range(6):
        robots.at(101.0 + number)
        robots.observe(19.0 if number % 2 else 50.0)
        robots.all[0].reset()

    async def use(site: Site) -> None:
        _, answer = await site.get("/api/history?limit=3")
        levels: list[tuple[str, bool]] = [(alert["to_level"], answer["more"]) for alert in answer["alerts"]]
        assert levels == [("WARN", True), ("OK", True), ("WARN", True)]
        _, answer = await site.get(f"/api/history?limit=3&before={answer['alerts'][-1]['id']}")
        assert [alert["to_level"] for alert in answer["alerts"]] == ["OK", "WARN"]
        assert answer["more"] is False

    with_site(use, robots)


def test_a_note_on_an_alert_is_added_and_shown(tmp_path: Path) -> None:
    robots = Robots(history_file=str(tmp_path / "history.db"))
    robots.observe(50.0)
    robots.at(101.0)
    robots.observe(19.0)

    async def use(site: Site) -> None:
        body = {"id": 1, "text": "<b>wheel</b>\nblocked", "author": "ana"}
        expected = {"time": "2026-11-22T05:06:41.000Z", "author": "ana", "text": "<b>wheel</b> blocked"}
        assert await site.post("/api/note", body) == (200, {"note": expected})
        assert (await site.post("/api/note", {"id": "1", "text": "x" * 1000}))[0] == 200
        (alert,) = (await site.get("/api/history"))[1]["alerts"]
        assert alert["notes"][0] == expected
        assert alert["notes"][1] == {"time": "2026-11-22T05:06:41.000Z", "author": "", "text": "x" * 1000}
        assert (await site.get("/api/history/1"))[1]["alert"] == alert
        for bad, status in (
            ({"id": 1}, 400),
            ({"id": 1, "text": " \n "}, 400),
            ({"id": 1, "text": 5}, 400),
            ({"id": 1, "text": "x" * 1001}, 400),
            ({"id": 1, "text": "x", "author": "x" * 201}, 400),
            ({"text": "x"}, 400),
            ({"id": "one", "text": "x"}, 400),
            ({"id": 2, "text": "x"}, 404),
            ({"id": "9" * 20, "text": "x"}, 404),
        ):
            assert (await site.post("/api/note", bad))[0] == status, bad
        foreign = {"Origin": "http://evil.example"}
        assert (await site.post("/api/note", body, headers=foreign))[0] == 403
        assert (await site.get("/api/history/1"))[1]["alert"] == alert

    with_site(use, robots)


def test_the_state_has_silences_that_recur_and_are_not_in_force() -> None:
    robots = low_battery()
    robots.history = History(None, robots.wall_s)
    robots.silences = Silences(robots.history)
    for begin in ("05:00", "06:00"):  # it is 05:06
        robots.silences.add(parse_matchers("robot=atlas"), every=parse_recurrence(f"{begin}-07:00", "UTC"))

    async def use(site: Site) -> None:
        _, state = await site.get("/api/state")
        assert [(each["every"], each["timezone"], each["in_force"]) for each in state["silences"]] == [
            ("05:00-07:00", "UTC", True),
            ("06:00-07:00", "UTC", False),
        ]

    with_site(use, robots)


def test_a_silence_is_added_shown_and_expired() -> None:
    robots = low_battery()

    async def use(site: Site) -> None:
        body = {"robot": "atlas", "signal": "battery*", "for_s": 3600, "reason": "<b>charging</b>", "author": "ana"}
        status, answer = await site.post("/api/silence", body)
        assert (status, answer) == (
            200,
            {
                "silence": {
                    "id": "1",
                    "matchers": "robot=atlas,signal=battery*",
                    "reason": "<b>charging</b>",
                    "author": "ana",
                    "since": "2026-11-22T05:06:41.000Z",
                    "until": "2026-11-22T06:06:41.000Z",
                    "until_resolved": False,
                    "every": None,
                    "timezone": None,
                    "in_force": True,
                }
            },
        )
        _, state = await site.get("/api/state")
        assert state["silencing"] is True
        assert state["silences"] == [answer["silence"]]
        for bad in (
            {"for_s": 60},
            {"robot": "atlas"},
            {"robot": "atlas", "for_s": 0},
            {"robot": "atlas", "for_s": -1},
            {"robot": "atlas", "for_s": True},
            {"robot": "atlas", "for_s": "60"},
            {"robot": "atlas", "for_s": 1e12},
            {"robot": "x" * 1000, "for_s": 60},
            {"robot": 3, "for_s": 60},
            {"robot": "\ud800", "for_s": 60},
            {"robot": "two\nlines", "for_s": 60},
        ):
            assert (await site.post("/api/silence", bad))[0] == 400, bad
        assert await site.post("/api/silence/expire", {"id": "1"}) == (200, {"ok": True})
        for gone, status in (("1", 404), ("99", 404), ("9" * 20, 404), ("x", 400), ("", 400), (None, 400)):
            assert (await site.post("/api/silence/expire", {"id": gone}))[0] == status, gone

    with_site(use, robots)


# --- health -----------------------------------------------------------------------------------------------------------


def test_a_monitor_that_does_not_tick_is_unhealthy() -> None:
    async def use(site: Site) -> None:
        assert await site.get("/healthz") == (200, {"ok": True, "faults": []})
        node = site.robots.bus.nodes[0]
        node.cancel_timers()
        site.robots.at(105.0)
        assert (await site.get("/healthz"))[0] == 200
        site.robots.at(107.0)
        assert await site.get("/healthz") == (503, {"ok": False, "error": "no tick for 7 s"})

    with_site(use)


def test_the_state_of_the_monitor_itself_is_the_same_everywhere() -> None:
    """A pager that is down must not make a supervisor restart the monitor, and must not look like a healthy one."""
    process = Faults()

    async def use(site: Site) -> None:
        async def shown() -> Any:
            state = (await site.get("/api/state"))[1]
            (robot,) = state["robots"].values()
            metrics = (await site.get("/metrics"))[1]
            count = next(line for line in metrics.splitlines() if line.startswith("robot_health_faults "))
            return state["monitor"], robot["monitor"], (await site.get("/healthz")), count

        no_faults = {"level": "OK", "message": "no faults"}
        assert await shown() == (
            {**no_faults, "faults": []},
            no_faults,
            (200, {"ok": True, "faults": []}),
            "robot_health_faults 0.0",
        )
        process.report("pager", "cannot be reached")
        site.robots.bus.nodes[0].faults.report("log", "slow", Level.WARN)
        await asyncio.sleep(0.3)  # requests at the same time share an answer
        (name,) = (robot.robot for robot in site.robots.all)
        worst = {"level": "ERROR", "message": "pager: cannot be reached"}
        faults = [
            {"robot": None, "part": "pager", "level": "ERROR", "text": "cannot be reached"},
            {"robot": name, "part": "log", "level": "WARN", "text": "slow"},
        ]
        assert await shown() == (
            {**worst, "faults": faults},
            worst,
            (200, {"ok": True, "faults": ["pager: cannot be reached", "log: slow"]}),
            "robot_health_faults 2.0",
        )

    with_site(use, process_faults=process.current)


# --- metrics ----------------------------------------------------------------------------------------------------------


def test_a_profile_of_metrics_that_does_not_exist_is_an_error() -> None:
    async def scenario(site: Site) -> None:
        assert b"robot_health_level{" in (await site.get("/metrics?profile=fleet"))[1].encode()
        expected = {"error": "profile: expected full or fleet, got 'lean'"}
        assert await site.get("/metrics?profile=lean") == (400, expected)

    with_site(scenario)


# --- black boxes ------------------------------------------------------------------------------------------------------


def test_a_black_box_is_downloaded(tmp_path: Path) -> None:
    content = bytes(range(256)) * 1000
    (tmp_path / "atlas_20261123T014559.123Z_fan.mcap").write_bytes(content)

    async def use(site: Site) -> None:
        address = f"{site.url}/api/black_box/atlas_20261123T014559.123Z_fan.mcap"
        async with site.session.get(address) as response:
            assert response.status == 401
        async with site.session.get(address, headers=BEARER) as response:
            assert (response.status, await response.read()) == (200, content)
            assert (
                response.headers["Content-Disposition"] == 'attachment; filename="atlas_20261123T014559.123Z_fan.mcap"'
            )
            assert response.headers["Content-Type"] == "application/octet-stream"
            assert response.headers["Cache-Control"] == "no-store"

    with_site(use, token="s3cret", black_boxes=str(tmp_path))


@pytest.mark.parametrize(
    "name",
    ["b.mcap", "..%2Fsecret.mcap", "%2Fetc%2Fpasswd", ".lock", "a.mcap.part", "link.mcap", "folder.mcap", "%00.mcap"],
)
def test_nothing_but_black_boxes_is_downloaded(tmp_path: Path, name: str) -> None:
    folder = tmp_path / "black_boxes"
    (folder / "folder.mcap").mkdir(parents=True)
    (tmp_path / "secret.mcap").write_text("secret")
    (folder / ".lock").write_text("")
    (folder / "a.mcap.part").write_text("")
    (folder / "link.mcap").symlink_to(tmp_path / "secret.mcap")

    async def use(site: Site) -> None:
        address = URL(f"{site.url}/api/black_box/{name}", encoded=True)
        async with site.session.get(address) as response:
            assert response.status == 404
            assert "secret" not in (await response.text()).replace("secret.mcap", "")

    with_site(use, black_boxes=str(folder))


def test_without_a_black_box_the_answer_says_so() -> None:
    async def use(site: Site) -> None:
        problem = "nothing is recorded; ops.yaml configures a black box"
        assert await site.get("/api/black_box/a.mcap") == (404, {"error": problem})

    with_site(use)
