"""The server over real sockets, in front of a local bus."""

from __future__ import annotations

import math
import socket
import ssl
import struct
from typing import Any

import aiohttp
import pytest
from aiohttp import web
from harness.rosbridge_peer import FLOAT32, Robot, with_robot

from robot_health_monitor.core.port.local import LocalBus
from robot_health_monitor.core.port.middleware import Severity
from robot_health_monitor.core.values.errors import ConfigError
from robot_health_monitor.rosbridge.server import Server, ServerThread
from robot_health_monitor.runtime.access import Access

OPEN = Access(publish=("/in",), services=("/robot/reset", "/offered"), offer=("/offered",))


async def healthz(request: web.Request) -> web.Response:
    return web.Response(text="ok")


async def broken(request: web.Request) -> web.Response:
    raise RuntimeError("broken\nhandler")


def reset(request: Any) -> dict[str, Any]:
    return {"success": True, "message": "nothing was latched"}


class TestSubscribing:
    @staticmethod
    @with_robot()
    async def test_a_client_gets_every_message_in_order(robot: Robot) -> None:
        async with robot.peer() as peer:
            await peer.subscribe("/battery_level", type=FLOAT32)
            robot.publish(*range(1000))
            assert await peer.receive_many(1000) == list(range(1000))

    @staticmethod
    @with_robot()
    async def test_messages_have_the_form_of_the_protocol(robot: Robot) -> None:
        async with robot.peer() as peer:
            await peer.subscribe("/battery_level", type="std_msgs/msg/Float32")
            robot.publish(19.5)
            assert await peer.receive() == {"op": "publish", "topic": "/battery_level", "msg": {"data": 19.5}}

    @staticmethod
    @with_robot()
    async def test_the_type_may_be_left_out_for_a_topic_that_is_there(robot: Robot) -> None:
        async with robot.peer() as peer:
            await peer.subscribe("/battery_level")
            robot.publish(1.0)
            assert (await peer.receive())["msg"] == {"data": 1.0}

    @staticmethod
    @with_robot()
    async def test_a_topic_that_is_not_there_yet_can_be_subscribed_to_with_its_type(robot: Robot) -> None:
        async with robot.peer() as peer:
            await peer.subscribe("/later", type="std_msgs/String")
            robot.node.advertise("/later", "std_msgs/String")
            robot.node.publish("/later", {"data": "here"})
            assert (await peer.receive())["msg"] == {"data": "here"}

    @staticmethod
    @with_robot()
    async def test_a_relative_name_is_answered_as_it_was_asked(robot: Robot) -> None:
        async with robot.peer() as peer:
            await peer.subscribe("battery_level", type=FLOAT32)
            robot.publish(1.0)
            assert (await peer.receive())["topic"] == "battery_level"

    @staticmethod
    @with_robot()
    async def test_an_unsubscribed_topic_is_silent_and_the_robot_no_longer_serves_it(robot: Robot) -> None:
        async with robot.peer() as peer:
            await peer.subscribe("/battery_level", id="one")
            await peer.subscribe("/battery_level", id="two")
            await peer.send("unsubscribe", topic="/battery_level", id="one")
            await peer.settle()
            robot.publish(1.0)
            assert (await peer.receive())["msg"] == {"data": 1.0}
            await peer.send("unsubscribe", topic="/battery_level", id="two")
            await peer.settle()
            robot.publish(2.0)
            await peer.subscribe("/battery_level")
            await peer.send("unsubscribe", topic="/battery_level")
            await peer.settle()
            robot.publish(3.0)
            assert (await peer.call("/rosapi/subscribers", {"topic": "/battery_level"}))["values"] == {
                "subscribers": []
            }

    @staticmethod
    @with_robot()
    async def test_a_client_that_leaves_takes_its_subscriptions_along(robot: Robot) -> None:
        async with robot.peer() as peer:
            await peer.subscribe("/battery_level")
            assert robot.bus.graph().nodes["/rosbridge"].subscribes == ("/battery_level",)
        await robot.until(lambda: robot.server.clients == 0)
        await robot.until(lambda: robot.bus.graph().nodes["/rosbridge"].subscribes == ())

    @staticmethod
    @with_robot()
    async def test_nan_travels_as_null_in_json_and_as_itself_in_cbor(robot: Robot) -> None:
        async with robot.peer() as json_peer, robot.peer() as cbor_peer:
            await json_peer.subscribe("/battery_level")
            await cbor_peer.subscribe("/battery_level", compression="cbor")
            robot.publish(math.nan)
            assert (await json_peer.receive())["msg"] == {"data": None}
            assert math.isnan((await cbor_peer.receive())["msg"]["data"])

    @staticmethod
    @with_robot()
    async def test_cbor_raw_is_the_wire_format_of_ros_1(robot: Robot) -> None:
        async with robot.peer() as peer:
            await peer.subscribe("/battery_level", compression="cbor-raw")
            robot.publish(19.5)
            message = (await peer.receive())["msg"]
            assert message["bytes"] == struct.pack("<f", 19.5)
            assert message["secs"] > 1_600_000_000 and 0 <= message["nsecs"] < 1_000_000_000

    @staticmethod
    @with_robot()
    async def test_throttled_messages_keep_their_distance_and_others_get_all(robot: Robot) -> None:
        async with robot.peer() as slow, robot.peer() as fast:
            await slow.subscribe("/battery_level", throttle_rate=3_600_000)
            await fast.subscribe("/battery_level")
            robot.publish(1.0, 2.0, 3.0)
            assert await fast.receive_many(3) == [1.0, 2.0, 3.0]
            assert await slow.receive_many(1) == [1.0]
            await slow.send("call_service", service="/rosapi/get_time")
            assert (await slow.receive())["op"] == "service_response"

    @staticmethod
    @with_robot()
    async def test_the_log_is_a_topic(robot: Robot) -> None:
        async with robot.peer() as peer:
            await peer.subscribe("/rosout", type="rosgraph_msgs/Log")
            robot.node.log(Severity.WARN, "battery_level WARN: 19.5 % is below 20 %")
            message = (await peer.receive())["msg"]
            assert (message["level"], message["name"]) == (4, "/robot")  # WARN=4 in rosgraph_msgs/Log
            assert message["msg"] == "battery_level WARN: 19.5 % is below 20 %"


class TestPublishingAndServices:
    @staticmethod
    @with_robot(OPEN)
    async def test_clients_publish_on_allowed_topics(robot: Robot) -> None:
        heard = []
        robot.node.subscribe("/in", FLOAT32, lambda value, now_s: heard.append(value), field="data")
        async with robot.peer() as peer:
            await peer.send("advertise", topic="/in", type="std_msgs/msg/Float32")
            await peer.send("publish", topic="/in", msg={"data": 3.5})
            await robot.until(lambda: heard == [3.5])

    @staticmethod
    @with_robot(OPEN)
    async def test_other_topics_and_wrong_messages_are_refused_with_the_reason(robot: Robot) -> None:
        heard = []
        robot.node.subscribe("/battery_level", FLOAT32, lambda value, now_s: heard.append(value), field="data")
        async with robot.peer() as peer:
            await peer.send("set_level", level="error")
            for topic, message, problem in (
                ("/battery_level", {"data": 0.0}, "clients may not publish on /battery_level"),
                ("/in", {"data": 0.0}, "/in is not advertised"),
            ):
                await peer.send("publish", topic=topic, msg=message, id="p")
                status = await peer.receive()
                assert (status["op"], status["level"], status["id"]) == ("status", "error", "p")
                assert problem in status["msg"]
            await peer.send("advertise", topic="/in", type=FLOAT32)
            await peer.send("publish", topic="/in", msg={"data": "full"})
            assert "expected a number" in (await peer.receive())["msg"]
            await peer.send("advertise", topic="/in", type="std_msgs/String")
            assert "type of /in: expected std_msgs/Float32" in (await peer.receive())["msg"]
        assert heard == []

    @staticmethod
    @with_robot(OPEN)
    async def test_allowed_services_answer_and_others_say_why_not(robot: Robot) -> None:
        robot.node.advertise_service("~reset", "std_srvs/Trigger", reset)
        robot.node.advertise_service("~shutdown", "std_srvs/Trigger", reset)
        async with robot.peer() as peer:
            for args in ({}, [], [{}]):
                response = await peer.call("/robot/reset", args)
                assert (response["result"], response["values"]["message"]) == (True, "nothing was latched")
            refused = await peer.call("/robot/shutdown")
            assert refused["result"] is False
            assert refused["values"] == "clients may not call /robot/shutdown"

    @staticmethod
    @with_robot(OPEN)
    async def test_a_service_that_fails_answers_with_the_reason(robot: Robot) -> None:
        def fail(request: Any) -> dict[str, Any]:
            raise RuntimeError("stuck")

        robot.node.advertise_service("~reset", "std_srvs/Trigger", fail)
        async with robot.peer() as peer:
            response = await peer.call("/robot/reset")
            assert response["result"] is False and "stuck" in response["values"]

    @staticmethod
    @with_robot(OPEN)
    async def test_clients_offer_services_to_one_another(robot: Robot) -> None:
        async with robot.peer() as provider, robot.peer() as caller:
            await provider.send("advertise_service", service="/offered", type="std_srvs/SetBool")
            await provider.settle()
            assert (await caller.call("/rosapi/service_type", {"service": "/offered"}))["values"] == {
                "type": "std_srvs/SetBool"
            }
            await caller.send("call_service", service="/offered", args={"data": True}, id="mine")
            request = await provider.receive()
            assert (request["op"], request["service"], request["args"]) == ("call_service", "/offered", {"data": True})
            await caller.send("service_response", service="/offered", id=request["id"], values={"success": False})
            await provider.send("service_response", service="/offered", id=request["id"], values={"success": True})
            response = await caller.receive()
            assert (response["id"], response["result"], response["values"]) == ("mine", True, {"success": True})

            await caller.send("call_service", service="/offered", args={}, id="second")
            await provider.receive()
            await provider.socket.close()
            response = await caller.receive()
            assert (response["id"], response["result"]) == ("second", False)
            assert "disconnected" in response["values"]

    @staticmethod
    @with_robot(OPEN, call_timeout_s=0.05)
    async def test_a_provider_that_does_not_answer_is_waited_for_only_so_long(robot: Robot) -> None:
        async with robot.peer() as provider, robot.peer() as caller:
            await provider.send("advertise_service", service="/offered", type="std_srvs/Trigger")
            await provider.settle()
            response = await caller.call("/offered")
            assert (response["result"], response["values"]) == (False, "/offered did not respond within 0.05 s")

    @staticmethod
    @with_robot(OPEN)
    async def test_actions_are_refused_as_an_action_server_would(robot: Robot) -> None:
        async with robot.peer() as peer:
            await peer.send("send_action_goal", action="/dock", action_type="docking/Dock", id="goal")
            result = await peer.receive()
            assert (result["op"], result["id"], result["result"]) == ("action_result", "goal", False)
            assert result["status"] == 6  # STATUS_ABORTED of action_msgs/GoalStatus


class TestAskingWhatThereIs:
    @staticmethod
    @with_robot()
    async def test_a_foxglove_style_client_finds_a_ros_1_graph(robot: Robot) -> None:
        """It polls these three, and takes /rosout's type for the version of ROS."""
        robot.node.advertise_service("~reset", "std_srvs/Trigger", reset)
        async with robot.peer() as peer:
            for _ in range(2):
                raw = (await peer.call("/rosapi/topics_and_raw_types"))["values"]
                assert raw["topics"] == ["/battery_level", "/rosout"]
                assert raw["types"] == [FLOAT32, "rosgraph_msgs/Log"]
                assert raw["typedefs_full_text"][0] == "float32 data\n"
                assert "MSG: std_msgs/Header" in raw["typedefs_full_text"][1]
                assert (await peer.call("/rosapi/nodes"))["values"] == {"nodes": ["/robot", "/rosbridge"]}
                details = (await peer.call("/rosapi/node_details", {"node": "/robot"}))["values"]
                assert details == {"publishing": ["/battery_level"], "subscribing": [], "services": ["/robot/reset"]}

    @staticmethod
    @with_robot()
    async def test_status_messages_go_only_to_those_who_asked(robot: Robot) -> None:
        async with robot.peer() as quiet, robot.peer() as curious:
            await curious.send("set_level", level="error")
            for peer in (quiet, curious):
                await peer.send("nonsense")
            problem = {"op": "status", "level": "error", "msg": "unknown operation 'nonsense'"}
            assert await curious.receive() == problem
            await quiet.send("call_service", service="/rosapi/get_time")
            assert (await quiet.receive())["op"] == "service_response"


class TestFurtherRoutes:
    @staticmethod
    @with_robot(routes=lambda client_of: [web.get("/healthz", healthz), web.post("/silences", healthz)])
    async def test_are_served_on_the_same_port_with_the_same_checks(robot: Robot) -> None:
        async with aiohttp.ClientSession() as session:
            async with session.get(robot.url + "healthz") as response:
                assert (response.status, await response.text()) == (200, "ok")
            for headers in ({"Origin": "https://evil.example"}, {"Host": "evil.example"}):
                async with session.post(robot.url + "silences", headers=headers) as response:
                    assert response.status == 403
            own = {"Origin": robot.url.rstrip("/")}
            async with session.post(robot.url + "silences", headers=own) as response:
                assert response.status == 200
        async with robot.peer() as peer:
            await peer.settle()

    @staticmethod
    @with_robot(routes=lambda client_of: [web.get("/broken", broken)])
    async def test_a_handler_that_fails_is_one_line_in_the_log(robot: Robot) -> None:
        async with aiohttp.ClientSession() as session, session.get(robot.url + "broken") as response:
            assert response.status == 500
        (line,) = robot.log
        assert line == "refused a request of 127.0.0.1: internal error (RuntimeError)"


class TestWhoMayConnect:
    @staticmethod
    @with_robot(Access(origins=("https://dashboard.example",)))
    async def test_pages_of_other_origins_are_refused(robot: Robot) -> None:
        async with robot.peer(headers={"Origin": "https://dashboard.example"}) as peer:
            await peer.settle()
        with pytest.raises(aiohttp.WSServerHandshakeError) as refusal:
            async with robot.peer(headers={"Origin": "https://evil.example"}):
                pass
        assert refusal.value.status == 403
        assert any("evil.example" in text for text in robot.log)

    @staticmethod
    @with_robot(Access(token="s3cret"))
    async def test_the_right_token_opens_and_a_wrong_one_does_not(robot: Robot) -> None:
        async with robot.peer(headers={"Authorization": "Bearer s3cret"}) as peer:
            await peer.settle()
        with pytest.raises(aiohttp.WSServerHandshakeError) as refusal:
            async with robot.peer(headers={"Authorization": "Bearer guessed"}):
                pass
        assert refusal.value.status == 401
        with pytest.raises(aiohttp.WSServerHandshakeError) as refusal:
            async with robot.peer():
                pass
        assert refusal.value.status == 401
        assert robot.log == [f"refused a client at 127.0.0.1: {problem} token" for problem in ("wrong", "missing")]

    @staticmethod
    @with_robot(Access(token="s3cret"))
    async def test_the_token_is_never_disclosed(robot: Robot) -> None:
        for headers, query in (
            ({"Authorization": "Bearer s3cret"}, ""),
            ({}, "?token=s3cret"),
        ):
            async with robot.peer(headers=headers, query=query) as peer:
                names = (await peer.call("/rosapi/get_param_names"))["values"]["names"]
                values = [(await peer.call("/rosapi/get_param", {"name": name}))["values"]["value"] for name in names]
                assert "s3cret" not in str(values)
        with pytest.raises(aiohttp.WSServerHandshakeError):
            async with robot.peer(query="?token=s3cret-wrong"):
                pass
        assert robot.log == ["refused a client at 127.0.0.1: wrong token"]
        assert "s3cret" not in repr(robot.server.access)

    @staticmethod
    @pytest.mark.parametrize("host", ["evil.example", "robot", "192.168.1.5:9090", "localhost.evil.example", ""])
    def test_without_a_token_only_loopback_names_are_served(host: str) -> None:
        """A page of evil.example may make this name resolve to 127.0.0.1 (DNS rebinding)."""

        @with_robot()
        async def scenario(robot: Robot) -> None:
            with pytest.raises(aiohttp.WSServerHandshakeError) as refusal:
                async with robot.peer(headers={"Host": host}):
                    pass
            assert refusal.value.status == 403
            for loopback in ("localhost:9090", "127.0.0.1", "[::1]:9090"):
                async with robot.peer(headers={"Host": loopback}) as peer:
                    await peer.settle()

        scenario()

    @staticmethod
    @with_robot(Access(token="s3cret"))
    async def test_with_a_token_every_name_is_served(robot: Robot) -> None:
        async with robot.peer(headers={"Host": "robot:9090", "Authorization": "Bearer s3cret"}) as peer:
            await peer.settle()

    @pytest.mark.parametrize("host", ["0.0.0.0", "192.168.1.5", "::"])
    def test_an_address_that_others_can_reach_needs_protection(self, host: str) -> None:
        node = LocalBus().node("rosbridge")
        with pytest.raises(ConfigError, match="reachable from other machines"):
            Server(node, host=host)
        with pytest.raises(ConfigError, match="reachable from other machines"):
            Server(node, host=host, ssl_context=ssl.create_default_context(ssl.Purpose.CLIENT_AUTH))
        Server(node, host=host, access=Access(token="s3cret"))

    @staticmethod
    @with_robot(clients=2)
    async def test_one_client_too_many_is_refused(robot: Robot) -> None:
        async with robot.peer() as first, robot.peer() as second:
            await first.settle()
            await second.settle()
            with pytest.raises(aiohttp.ClientConnectionError):
                async with robot.peer():
                    pass
            await first.settle()


@with_robot(Access(token="s3cret"))
async def test_another_token_disconnects_every_client_and_is_required_from_then_on(robot: Robot) -> None:
    async with robot.peer(query="?token=s3cret") as peer:
        await peer.settle()
        robot.server.use_token("s3cret2")
        await peer.closed()
    with pytest.raises(aiohttp.WSServerHandshakeError):
        async with robot.peer(query="?token=s3cret"):
            pass
    async with robot.peer(query="?token=s3cret2") as peer:
        await peer.settle()
    robot.server.use_token("")
    async with robot.peer() as peer:
        await peer.settle()


def test_a_server_that_other_machines_reach_does_not_give_up_its_token() -> None:
    server = Server(LocalBus().node("rosbridge"), host="0.0.0.0", access=Access(token="s3cret"))
    with pytest.raises(ConfigError, match="reachable from other machines: expected a token"):
        server.use_token("")


def test_a_server_runs_in_a_thread_until_it_is_closed() -> None:
    thread = ServerThread(Server(LocalBus().node("rosbridge"), port=0))
    assert (thread.server.clients, thread.server.dropped) == (0, 0)
    socket.create_connection(("127.0.0.1", thread.server.port), 10.0).close()
    thread.close()
    thread.close()
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", thread.server.port), 10.0)


def test_a_port_in_use_is_an_error() -> None:
    first = ServerThread(Server(LocalBus().node("rosbridge"), port=0))
    with pytest.raises(OSError):
        ServerThread(Server(LocalBus().node("rosbridge"), port=first.server.port))
    first.close()


def test_an_error_in_the_loop_is_one_line_in_the_log() -> None:
    bus = LocalBus()
    thread = ServerThread(Server(bus.node("rosbridge"), port=0))

    async def fail() -> None:
        loop = thread._thread.loop
        loop.call_exception_handler({"message": "Fatal read error", "exception": OSError("broken\npipe")})

    thread._thread.call(fail())
    assert [line.text for line in bus.log_lines] == ["rosbridge: Fatal read error: OSError: broken pipe"]
    thread.close()


@with_robot()
async def test_a_log_line_about_clients_is_short_and_one_line_and_ten_a_minute_are_written(robot: Robot) -> None:
    """Errors of clients may quote what they sent."""
    robot.server.log("one\nforged line\r\n")
    robot.server.log("\x1b[31m" + "x" * 1_000_000)
    for number in range(1000):
        robot.server.log(f"refused client {number}")
    assert robot.log == ["one forged line", "?[31m" + "x" * 495, *(f"refused client {number}" for number in range(8))]
