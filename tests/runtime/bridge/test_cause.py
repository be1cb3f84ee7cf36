"""The cause of a lost connection, for errors that a test cannot provoke with real sockets; see test_connection.py."""

from __future__ import annotations

import errno
import socket

import aiohttp
import pytest

from robot_health_monitor.runtime.bridge.cause import Cause, RedirectError, cause_of_close, cause_of_error


@pytest.mark.parametrize(
    ("code", "reason", "has_token", "expected"),
    [
        (None, "", False, Cause("connection lost")),
        (1006, "", False, Cause("connection lost")),
        (1000, "bye", False, Cause("the server closed the connection")),
        (1001, "", False, Cause("the server closed the connection")),
        (1008, "token required", False, Cause("check this computer's settings: no token", True)),
        (1008, "token required", True, Cause("check this computer's settings: wrong token", True)),
        (1008, "too many clients", False, Cause("the server closed the connection with code 1008: too many clients")),
        (1011, "", False, Cause("the server closed the connection with code 1011")),
        (4000, "\x1b[2J", False, Cause("the server closed the connection with code 4000: ?[2J")),
    ],
)
def test_a_close_frame_is_explained(code: int | None, reason: str, has_token: bool, expected: Cause) -> None:
    assert cause_of_close(code, reason, has_token) == expected


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (OSError(errno.EHOSTUNREACH, "No route to host"), "no connection: No route to host"),
        (OSError(errno.ENETUNREACH, "Network is unreachable"), "no connection: Network is unreachable"),
        (socket.gaierror(-2, "Name or service not known"), "host name not found"),
        (ConnectionResetError(), "connection lost"),
        (aiohttp.ServerDisconnectedError(), "connection lost"),
        (aiohttp.ServerTimeoutError("No PONG received"), "no answer from the host"),
        (aiohttp.InvalidURL("ws://user:secret@robot"), "check this computer's settings: invalid address"),
        (
            RedirectError(308, "ws://user:secret@other:9090/a?token=secret"),
            "the server redirects to ws://other:9090/a (HTTP 308); redirects are not followed",
        ),
        (RedirectError(302, ""), "the server redirects (HTTP 302); redirects are not followed"),
        (
            RedirectError(302, "/\x1b[2Jlogin"),
            "the server redirects to /?[2Jlogin (HTTP 302); redirects are not followed",
        ),
        (ValueError("ws://user:secret@robot"), "no connection: ValueError"),
    ],
)
def test_an_error_is_explained_without_the_address(error: Exception, text: str) -> None:
    assert cause_of_error(error, has_token=False, server_kind="rosbridge server").text == text


def test_a_reason_from_the_server_is_cut() -> None:
    assert len(cause_of_close(4000, "x" * 10_000, False).text) < 200
