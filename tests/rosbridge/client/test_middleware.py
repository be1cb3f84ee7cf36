"""Nodes on a robot behind rosbridge: what the conformance suite does not cover."""

from __future__ import annotations

import asyncio
from typing import Any

from harness.rosbridge_client import ForeignServer, Watched, scenario, until
from harness.rosbridge_peer import FLOAT32, Robot, with_robot

from robot_health_monitor.core.nodes import AlertSystem
from robot_health_monitor.core.nodes.outlets import Event
from robot_health_monitor.rosbridge.client import RosbridgeClient
from robot_health_monitor.runtime.access import Access

EVERYTHING = Access(publish=("*",), services=("*",), offer=("*",))


@with_robot(EVERYTHING)
async def test_nothing_is_published_or_offered_on_the_robot(robot: Robot) -> None:
    watched = Watched(robot.url)
    watched.node.subscribe("/battery_level", FLOAT32, watched.hear, field="data")
    watched.node.advertise("/alerts", FLOAT32)
    watched.node.publish("/alerts", {"data": 1.0})
    watched.node.advertise_service("~reset", "std_srvs/Trigger", lambda request: {})
    await robot.until(lambda: watched.ups == [True])
    await watched.settle()
    assert "/alerts" not in robot.bus.graph().topics
    assert "/watcher/reset" not in robot.server._node.added_services
    robot.publish(1.0)
    await robot.until(lambda: watched.heard == [1.0])
    await watched.close()


@with_robot()
async def test_a_field_that_the_messages_lack_is_one_line(robot: Robot) -> None:
    watched = Watched(robot.url)
    watched.node.subscribe("/battery_level", "", watched.hear, field="percentage")
    await robot.until(lambda: watched.ups == [True])
    await watched.settle()
    robot.publish(1.0, 2.0, 3.0)
    await robot.until(lambda: bool(watched.problems()))
    await watched.settle()
    assert watched.problems() == ["/battery_level has no field percentage; available: data"]
    await watched.close()


@scenario
async def test_names_of_fields_cannot_forge_a_line_or_fill_the_log() -> None:
    foreign = ForeignServer()
    watched = Watched(await foreign.start())
    watched.node.subscribe("/battery_level", FLOAT32, watched.hear, field="data")
    await until(lambda: watched.ups == [True])
    await foreign.publish("/battery_level", {"\n\x1b[2J": 1, **{f"field{number}": 1 for number in range(10_000)}})
    await until(lambda: bool(watched.problems()))
    await watched.close()
    await foreign.close()
    (line,) = watched.problems()
    assert line.isprintable() and len(line) < 300


def test_a_process_that_stood_still_reports_it() -> None:
    """Stopped and continued, as by Ctrl-Z: the clocks of the test jump."""

    @scenario
    async def run() -> None:
        loop = asyncio.get_event_loop()
        jump_s = 0.0
        real_time = loop.time
        loop.time = lambda: real_time() + jump_s  # type: ignore[method-assign]
        client = RosbridgeClient(
            "ws://127.0.0.1:1", clock=loop.time, on_link=lambda *link: None, on_log=lambda line: None
        )
        events: list[Event] = []
        system = AlertSystem(client.node("alert_system"), {"test": events.append})
        task = asyncio.ensure_future(client.run())
        await until(lambda: system.monitor.link_up is None and bool(system.monitor.signals()))  # the first tick
        jump_s = 20.0
        await until(lambda: any(event.text.startswith("the monitor was stopped for 2") for event in events))
        client.close()
        task.cancel()
        await asyncio.wait({task})

    run()


# Simulated time


def clock(seconds: Any, nanoseconds: Any = 0) -> Any:
    return {"clock": {"secs": seconds, "nsecs": nanoseconds}}


@scenario
async def test_samples_wait_for_the_first_clock_message_and_none_looks_stale() -> None:
    foreign = ForeignServer()
    watched = Watched(await foreign.start(), use_sim_time=True)
    times_s: list[float] = []
    watched.node.subscribe("/battery_level", FLOAT32, lambda value, now_s: times_s.append(now_s), field="data")
    timers_s: list[float] = []
    watched.node.create_timer(1.0, timers_s.append)
    await until(lambda: watched.ups == [True])
    for number in range(3):
        await foreign.publish("/battery_level", {"data": float(number)})
    await watched.settle()
    assert watched.node.waiting_for_clock() and times_s == [] and timers_s == []
    await foreign.publish("/clock", clock(1234, 500_000_000))
    await foreign.publish("/battery_level", {"data": 19.5})
    await watched.settle()
    assert times_s == [1234.5] * 4
    await watched.close()
    await foreign.close()


@scenario
async def test_clock_messages_that_hold_no_time_change_nothing() -> None:
    foreign = ForeignServer()
    watched = Watched(await foreign.start(), use_sim_time=True)
    await until(lambda: watched.ups == [True])
    await foreign.publish("/clock", clock(100))
    for stamp in (clock(-1), clock(True), clock("x"), clock(float("nan")), {"clock": None}, {}, clock(10**400)):
        await foreign.publish("/clock", stamp)
    await foreign.sockets[0].send_str('{"op": "publish", "topic": "/clock", "msg": {"clock": {"secs": 1e400}}}')
    await foreign.sockets[0].send_str('{"op": "publish", "topic": "/clock", "msg": {"clock": {"secs": NaN}}}')
    await watched.settle()
    assert watched.node.now_s() == 100.0
    await foreign.publish("/clock", clock(101))
    await watched.settle()
    assert watched.node.now_s() == 101.0 and watched.ups == [True]
    await watched.close()
    await foreign.close()


@scenario
async def test_after_close_no_clock_message_calls_back() -> None:
    foreign = ForeignServer()
    watched = Watched(await foreign.start(), use_sim_time=True)
    watched.node.subscribe("/battery_level", FLOAT32, watched.hear, field="data")
    called: list[str] = []
    watched.node.call_with_time(lambda: called.append("too late"))
    await until(lambda: watched.ups == [True])
    await foreign.publish("/battery_level", {"data": 1.0})
    await watched.settle()
    watched.node.close()
    await foreign.publish("/clock", clock(100))
    await watched.settle()
    assert watched.heard == [] and called == []
    await watched.close()
    await foreign.close()
