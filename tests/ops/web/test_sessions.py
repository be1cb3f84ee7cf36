"""Tokens, cookies, and the limit of wrong tokens."""

from __future__ import annotations

from typing import List

import pytest

from robot_health_monitor.ops.web.sessions import SESSION_S, LoginLimit, Sessions, TooManyLoginsError


class Clock:
    def __init__(self) -> None:
        self.now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s


def test_without_a_token_everything_is_admitted() -> None:
    sessions = Sessions("")
    assert not sessions.required
    assert sessions.admits({}, {})


@pytest.mark.parametrize(
    ("header", "admitted"),
    [
        ("Bearer s3cret", True),
        ("bearer  s3cret ", True),
        ("Bearer s3cre", False),
        ("Bearer s3cret2", False),
        ("Bearer ", False),
        ("Basic s3cret", False),
        ("s3cret", False),
        ("Bearer \udcff", False),
    ],
)
def test_the_token_in_a_header(header: str, admitted: bool) -> None:
    assert Sessions("s3cret").admits({"Authorization": header}, {}) is admitted


def test_a_cookie_is_valid_for_its_time_and_its_token_only() -> None:
    clock = Clock()
    sessions = Sessions("s3cret", clock)
    value = sessions.new_session()
    assert sessions.admits({}, {sessions.cookie: value})
    assert Sessions("s3cret", clock).admits({}, {sessions.cookie: value})  # after a restart
    other = Sessions("another", clock)
    assert other.cookie != sessions.cookie
    assert not other.admits({}, {other.cookie: value})
    clock.now_s += SESSION_S
    assert not sessions.admits({}, {sessions.cookie: value})


def test_every_session_is_another_and_none_contains_the_token() -> None:
    sessions = Sessions("s3cret")
    values: List[str] = [sessions.new_session() for _ in range(3)]
    assert len(set(values)) == 3
    assert not any("s3cret" in value for value in (*values, sessions.cookie))


@pytest.mark.parametrize("forged", ["", ".", "..", "9999999999.0.", "x" * 10_000, "٣.a.b", "1.2.\udcff", "9" * 150])
def test_a_forged_cookie_is_refused(forged: str) -> None:
    sessions = Sessions("s3cret")
    assert not sessions.admits({}, {sessions.cookie: forged})


def test_a_changed_expiry_is_refused() -> None:
    sessions = Sessions("s3cret")
    expiry, rest = sessions.new_session().split(".", 1)
    assert not sessions.admits({}, {sessions.cookie: f"{int(expiry) + 1}.{rest}"})


def test_ten_wrong_tokens_in_a_minute_lock_one_client() -> None:
    clock = Clock()
    limit = LoginLimit(clock)
    for _ in range(10):
        limit.check("10.0.0.1")
        limit.note_wrong("10.0.0.1")
        clock.now_s += 1.0
    with pytest.raises(TooManyLoginsError) as caught:
        limit.check("10.0.0.1")
    assert caught.value.wait_s == 50.0
    limit.check("10.0.0.2")
    clock.now_s += 50.0
    limit.check("10.0.0.1")


def test_all_clients_together_are_limited_too_and_memory_is_bounded() -> None:
    limit = LoginLimit(Clock())
    for number in range(100):
        limit.check(f"client {number}")
        limit.note_wrong(f"client {number}")
    with pytest.raises(TooManyLoginsError):
        limit.check("client 100")
    for number in range(5000):
        limit.note_wrong(f"client {number}")
    assert len(limit._wrong) == 1000
