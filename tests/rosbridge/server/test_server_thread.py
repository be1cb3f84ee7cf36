from __future__ import annotations

import socket

import pytest

from robot_health_monitor.core.local import LocalBus
from robot_health_monitor.rosbridge.server import Server, ServerThread


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
