"""Calls to a real ROS master, and to one that is down or hangs."""

from __future__ import annotations

import contextlib
import http.server
import os
import signal
import socket
import sys
import threading
import xmlrpc.client
from typing import Any

import pytest

from robot_health_monitor.core.values.errors import ServiceError


@pytest.fixture
def connection(master: Any, monkeypatch: pytest.MonkeyPatch) -> Any:
    from robot_health_monitor.ros1.master import Master

    monkeypatch.setenv("ROS_MASTER_URI", master.uri)
    return Master("/tests")


def test_it_reads_parameters_services_and_topics(connection: Any, parameters: Any) -> None:
    parameters("/some/number", 7)
    assert connection.is_online()
    assert connection.parameter("/some", {}) == {"number": 7}
    assert connection.parameter("/none", "default") == "default"
    assert connection.find_service("/none") is None
    assert connection.find_service("/rosout/get_loggers").startswith("rosrpc://")
    assert connection.topic_types()["/rosout_agg"] == "rosgraph_msgs/Log"
    publishers, _, _ = connection.system_state()
    assert ("/rosout_agg", ["/rosout"]) in publishers


def test_a_master_has_one_identity_and_knows_its_nodes(connection: Any) -> None:
    assert connection.identity("/rosout") == connection.identity("/rosout") is not None
    assert connection.identity("/missing") is None


def test_a_master_that_hangs_is_a_service_error(monkeypatch: pytest.MonkeyPatch) -> None:
    from robot_health_monitor.ros1.master import Master

    with socket.socket() as hanging:
        hanging.bind(("127.0.0.1", 0))
        hanging.listen()
        monkeypatch.setenv("ROS_MASTER_URI", f"http://127.0.0.1:{hanging.getsockname()[1]}")
        master = Master("/tests", timeout_s=0.1)
        assert not master.is_online()
        with pytest.raises(ServiceError, match="does not answer"):
            master.identity("/tests")


def reply(value: Any) -> bytes:
    return xmlrpc.client.dumps((value,), methodresponse=True).encode()


@pytest.mark.parametrize(
    "body",
    [
        b"",
        b"<html>a proxy's page",
        reply(7).replace(b"7", b"many"),
        b"<?xml version='1.0'?><methodResponse>\x1b[31m",
        b"\xff\xfe",
        xmlrpc.client.dumps(xmlrpc.client.Fault(1, "no"), methodresponse=True).encode(),
        *map(
            reply, [7, [], [1], [1, "", 7], [1, "", [7]], [1, "", [[1, 2, 3]]], ["x", "y", "z"], {"a": 1}, [[]], [{}]]
        ),
        reply([0, "x" * 10_000, 0]),
    ],
)
def test_a_master_that_answers_nonsense_is_a_service_error(body: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    from robot_health_monitor.ros1.master import Master

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            self.rfile.read(int(self.headers["Content-Length"]))
            self.send_response(200)
            self.send_header("Content-Type", "text/xml")
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *arguments: Any) -> None:
            """Writes nothing."""

    with http.server.HTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        try:
            monkeypatch.setenv("ROS_MASTER_URI", f"http://127.0.0.1:{server.server_port}")
            master = Master("/tests")
            for call in (master.system_state, master.topic_types):
                with pytest.raises(ServiceError) as error:
                    call()
                assert str(error.value).isprintable()
            with contextlib.suppress(ServiceError):
                assert master.find_service("/some") in (None, "z")
            with contextlib.suppress(ServiceError):
                master.parameter("/some", {})
            with contextlib.suppress(ServiceError):
                master.identity("/tests")
            master.is_online()
        finally:
            server.shutdown()
            thread.join()


@pytest.mark.parametrize("uri", ["nonsense", "ftp://127.0.0.1:1"])
def test_an_address_that_is_none_is_a_service_error(monkeypatch: pytest.MonkeyPatch, uri: str) -> None:
    from robot_health_monitor.ros1.master import Master

    monkeypatch.setenv("ROS_MASTER_URI", uri)
    with pytest.raises(ServiceError, match="ROS_MASTER_URI"):
        Master("/tests")


class Answers:
    """A master whose answers are given: None: it is down; a list: its identity for each next check."""

    uri = "http://robot:11311"

    def __init__(self, *identities: Any) -> None:
        self._identities = list(identities)

    def identity(self, node: str) -> Any:
        identity = self._identities.pop(0)
        if identity == "down":
            raise ServiceError("the ROS master at http://robot:11311 does not answer (refused)")
        return identity


@pytest.mark.parametrize(
    ("identities", "changes"),
    [
        ([(1, "a"), (1, "a"), None], ["ERROR"]),
        ([(1, "a"), (2, "a")], ["ERROR"]),
        ([(1, "a"), (1, "b")], ["ERROR"]),
        ([(1, "a"), "down", (1, "a"), None], ["OK", "ERROR"]),
        ([(1, "a"), "down", "down", "down", (1, "a"), "down", "down", None], ["WARN", "OK", "WARN", "ERROR"]),
    ],
)
def test_a_loss_is_reported_once_and_a_restart_ends_the_watch(identities: Any, changes: list[str]) -> None:
    from robot_health_monitor.ros1.master import MasterWatch

    seen: list[str] = []
    watch = MasterWatch(Answers(*identities), "/tests", lambda text, level: seen.append(level.name), period_s=0.0)
    watch.start()
    watch.join(10.0)
    assert watch.lost.is_set()
    assert seen == changes


def test_a_node_that_was_killed_is_gone_when_it_has_not_answered_twice_10_s_apart(
    start_master: Any, free_port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a master of its own, which goes on listing the node: other tests wait for all that theirs lists."""
    from harness.line_process import LineProcess

    from robot_health_monitor.ros1.master import Master, NodeChecks

    master = start_master(free_port)
    monkeypatch.setenv("ROS_MASTER_URI", master.uri)
    connection = Master("/tests")
    code = "import rospy; rospy.init_node('crashes'); print('up', flush=True); rospy.spin()"
    process = LineProcess([sys.executable, "-c", code], master.environment)
    try:
        process.wait_for_text("up")
        now_s = 0.0
        checks = NodeChecks(connection, lambda: now_s)
        assert checks.gone({"/crashes"}) == set()
        assert connection.answers("/crashes") is True
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
        assert connection.answers("/crashes") is False
        found = []
        for now_s in (9.0, 10.0, 19.0, 20.0, 22.0):
            found.append((now_s, checks.gone({"/crashes"})))
        assert found == [(9.0, set()), (10.0, set()), (19.0, set()), (20.0, {"/crashes"}), (22.0, {"/crashes"})]
        _, _, services = connection.system_state()
        assert ("/crashes/get_loggers", ["/crashes"]) in services  # the master goes on listing it
    finally:
        process.end()
