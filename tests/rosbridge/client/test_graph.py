"""The graph as rosapi of rosbridge_suite gives it (branches ros1 and ros2, rosapi/src/rosapi/proxy.py)."""

from __future__ import annotations

import asyncio
from typing import Any, Mapping, Sequence

import pytest
from harness.rosbridge_client import ForeignServer, Watched, scenario, until

from robot_health_monitor.core.nodes import AlertSystem
from robot_health_monitor.core.port.graph import Unread, Wanted
from robot_health_monitor.rosbridge.client import graph, topics

SERVER = "/rosbridge_websocket"
ACTIVE = {"current_state": {"id": 3, "label": "active"}}


@pytest.fixture(autouse=True)
def quickly(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(graph, "_PERIOD_S", 0.02)


class Rosapi:
    """A robot's rosapi, behind a server that subscribes for its clients as the node SERVER."""

    def __init__(self, server: ForeignServer) -> None:
        self.nodes: list[str] = []
        self.publishers: dict[str, list[str]] = {}
        self.subscribers: dict[str, list[str]] = {}
        self.others: dict[str, Any] = {}
        """Responses of further services."""
        self.runs = True
        self.calls: list[str] = []
        self._server = server
        server.answer = self._answer

    def _answer(self, service: str, request: Mapping[str, Any]) -> Any:
        self.calls.append(service)
        if service in self.others:
            return self.others[service]
        if not self.runs or not service.startswith("/rosapi/"):
            return f"Service {service} does not exist"
        topic = request.get("topic", "")
        subscribed = {each["topic"] for each in self._server.received if each["op"] == "subscribe"}
        subscribed -= {each["topic"] for each in self._server.received if each["op"] == "unsubscribe"}
        own = [SERVER] if topic in subscribed else []
        answers = {
            "nodes": self.nodes,
            "topics": [*self.publishers, *self.subscribers],
            "publishers": self.publishers.get(topic, []),
            "subscribers": [*self.subscribers.get(topic, []), *own],
        }
        name = service[len("/rosapi/") :]
        return {name: answers[name], **({"types": [""] * len(answers[name])} if name == "topics" else {})}


class Reader:
    """A client that reads what is wanted of a foreign server's graph."""

    def __init__(self, *wanted: Wanted) -> None:
        self.seen: list[Any] = []
        self.wanted: Sequence[Wanted] = wanted
        self.server = ForeignServer()
        self.rosapi = Rosapi(self.server)

    async def start(self) -> None:
        self.watched = Watched(await self.server.start())
        self.watched.node.follow_graph(lambda: self.wanted, lambda counts, now_s: self.seen.append(counts))

    async def reads(self, expected: Any) -> None:
        """Returns when a later reading is as expected."""
        self.seen.clear()
        await until(lambda: expected in self.seen)

    async def close(self) -> None:
        await self.watched.close()
        await self.server.close()


@scenario
async def test_every_reading_counts_what_a_robot_with_ros_1_has_now() -> None:
    wanted = [("node", "/lidar"), ("node", "/ro*"), ("publishers", "/scan"), ("subscribers", "/cmd_*")]
    reader = Reader(*wanted)
    reader.rosapi.nodes = ["/rosout", "/rosapi", SERVER, "/lidar"]
    reader.rosapi.publishers = {"/scan": ["/lidar"], "/rosout": ["/lidar"]}
    reader.rosapi.subscribers = {"/cmd_vel": ["/base"], "/cmd_arm": ["/arm"], "/rosout": ["/rosout"]}
    await reader.start()
    await reader.reads(dict(zip(wanted, [1.0, 2.0, 1.0, 2.0])))  # the node /rosout is not counted
    reader.rosapi.nodes.remove("/lidar")
    reader.rosapi.publishers["/scan"] = []
    reader.rosapi.subscribers["/cmd_vel"] = []
    await reader.reads(dict(zip(wanted, [0.0, 2.0, 0.0, 1.0])))
    await reader.close()


@scenario
async def test_init_learns_which_nodes_publish_and_which_have_a_lifecycle() -> None:
    reader = Reader()
    reader.rosapi.nodes = ["/lidar", "/nav", SERVER]
    reader.rosapi.publishers = {"/scan": ["/lidar"], "/plan": ["/nav"], "/points": ["/lidar", "/late"]}
    reader.rosapi.others = {"/rosapi/services": {"services": ["/nav/get_state", "/lidar/get_loggers"]}}
    await reader.start()
    await until(lambda: reader.watched.ups == [True])
    assert await reader.watched.client.known_nodes(["/scan", "/plan", "/points", "/other"]) == {
        "/lidar": (["/scan", "/points"], (), []),
        "/nav": (["/plan"], (), ["/nav/get_state"]),
        SERVER: ([], (), []),
        "/late": (["/points"], (), []),  # it came after the nodes were listed
    }
    await reader.close()


@scenario
async def test_the_servers_own_node_does_not_count_where_it_subscribes_for_this_monitor() -> None:
    reader = Reader(("subscribers", "/scan"), ("subscribers", "/map"))
    reader.rosapi.subscribers = {"/map": [SERVER]}  # for another client
    await reader.start()
    reader.watched.node.subscribe("/scan", "sensor_msgs/LaserScan", reader.watched.hear, field="range_max")
    await reader.reads({("subscribers", "/scan"): 0.0, ("subscribers", "/map"): 1.0})
    reader.rosapi.subscribers["/scan"] = ["/slam"]
    await reader.reads({("subscribers", "/scan"): 1.0, ("subscribers", "/map"): 1.0})
    used = [each for each in reader.server.received if "robot_health_monitor_" in str(each.get("topic"))]
    assert [each["op"] for each in used] == ["subscribe", "unsubscribe"]
    await reader.close()


@scenario
async def test_while_the_servers_own_node_is_not_known_its_subscriptions_are_not_counted() -> None:
    reader = Reader(("node", "/slam"), ("subscribers", "/scan"))
    reader.rosapi.others["/rosapi/subscribers"] = {"subscribers": []}  # not discovered yet
    await reader.start()
    reader.watched.node.subscribe("/scan", "sensor_msgs/LaserScan", reader.watched.hear, field="range_max")
    await reader.reads({("node", "/slam"): 0.0})
    del reader.rosapi.others["/rosapi/subscribers"]
    await reader.reads({("node", "/slam"): 0.0, ("subscribers", "/scan"): 0.0})
    await reader.close()


@scenario
async def test_lifecycle_states_of_a_robot_with_ros_2_come_from_get_state() -> None:
    nav, driver, twice = ("lifecycle", "/nav"), ("lifecycle", "/driver"), ("node", "/twice")
    reader = Reader(nav, driver, twice)
    reader.rosapi.nodes = ["/nav", "/driver", "/twice", "/twice"]
    reader.rosapi.others = {"/nav/get_state": ACTIVE}
    await reader.start()
    await reader.reads({nav: 3.0, twice: 2.0})  # /driver has no get_state
    reader.rosapi.others["/nav/get_state"] = {"current_state": "inactive"}
    await reader.reads({twice: 2.0})
    reader.rosapi.nodes = ["/driver"]
    await reader.reads({nav: 0.0, twice: 0.0})
    await reader.close()


@scenario
async def test_a_node_that_does_not_answer_is_called_once() -> None:
    reader = Reader(("lifecycle", "/nav"))
    reader.rosapi.nodes = ["/nav"]
    reader.rosapi.others = {"/nav/get_state": None}
    await reader.start()
    await until(lambda: len(reader.seen) > 5)
    assert reader.seen[-1] == {}
    assert reader.rosapi.calls.count("/nav/get_state") == 1
    await reader.close()


@scenario
async def test_a_server_without_rosapi_is_named_once_and_what_it_has_is_watched_when_it_answers() -> None:
    reader = Reader()
    reader.rosapi.runs = False
    reader.rosapi.nodes = ["/lidar"]
    await reader.start()
    parameters = {"signals": {"lidar": {"node": "/lidar"}, "level": {"stale_after_s": 0.0}}}
    events: list[Any] = []
    system = AlertSystem(reader.watched.client.node("alert_system", parameters=parameters), {"test": events.append})

    def texts() -> list[str]:
        return [event.text for event in events if event.text.startswith("lidar ")]

    reason = "/rosapi/nodes failed: Service /rosapi/nodes does not exist"
    absent = f"lidar is not watched: the server's rosapi does not give the graph: {reason}"
    await until(lambda: reader.rosapi.calls.count("/rosapi/nodes") > 5)
    assert texts() == [absent]
    assert list(system.monitor.report(0.0).statuses) == ["level"]
    reader.rosapi.runs = True
    await until(lambda: "lidar" in system.monitor.report(0.0).statuses)
    await until(lambda: system.monitor.report(0.0).statuses["lidar"].message == "node /lidar is there")
    assert texts() == [absent, "lidar is watched again"]
    reader.rosapi.runs = False  # it has crashed
    await reader.close()


@pytest.mark.parametrize("nodes", ["Service /rosapi/nodes does not exist", {"nodes": 3}, {"nodes": [None]}, {}])
def test_a_graph_that_was_read_and_cannot_be_read_any_more_stays_watched(nodes: Any) -> None:
    @scenario
    async def run() -> None:
        reader = Reader(("node", "/lidar"))
        await reader.start()
        await reader.reads({("node", "/lidar"): 0.0})
        reader.rosapi.others["/rosapi/nodes"] = nodes
        reader.seen.clear()
        await until(lambda: any(isinstance(each, Unread) and each.is_watched for each in reader.seen))
        await reader.close()

    run()


@scenario
async def test_nothing_is_called_back_after_cancel() -> None:
    reader = Reader(("node", "/lidar"))
    await reader.start()
    seen: list[Any] = []
    timer = reader.watched.node.follow_graph(lambda: reader.wanted, lambda counts, now_s: seen.append(counts))
    await until(lambda: bool(seen))
    timer.cancel()
    before = len(seen)
    for _ in range(3):
        await reader.reads({("node", "/lidar"): 0.0})
    assert len(seen) == before
    await reader.close()


@scenario
async def test_the_node_that_published_is_remembered_and_named_when_it_is_gone() -> None:
    reader = Reader()
    reader.rosapi.publishers = {"/scan": ["/lidar"]}
    reader.rosapi.nodes = ["/lidar"]
    await reader.start()
    lookup = topics.PublisherLookup(reader.watched.client.connection.call)
    await until(lambda: reader.watched.ups == [True])
    remembering = asyncio.ensure_future(lookup.remember(lambda: ["/scan"], 0.01))
    await until(lambda: reader.rosapi.calls.count("/rosapi/publishers") > 1)
    reader.rosapi.publishers, reader.rosapi.nodes = {}, []
    answers: list[Any] = []
    lookup.look_up("/scan", "", answers.append)
    await until(lambda: answers == ["node /lidar is gone"])
    remembering.cancel()
    await reader.close()
