"""Hosts, origins, tokens, cookies, and the limit of wrong tokens."""

from __future__ import annotations

import json
from typing import Any

import pytest
from aiohttp.test_utils import make_mocked_request

from robot_health_monitor.runtime.access import (
    SESSION_S,
    Access,
    Client,
    Credentials,
    TokenCheck,
    is_loopback,
    is_own_origin,
    matches,
    refusal_of,
)


@pytest.mark.parametrize(
    ("origin", "host", "is_own"),
    [
        ("http://robot:9090", "robot:9090", True),
        ("https://Robot", "rOBOT", True),
        ("http://[::1]:9090", "[::1]:9090", True),
        ("http://robot:9090", "robot:9091", False),
        ("http://evil", "robot", False),
        ("null", "robot", False),
        ("null", "", False),
        ("file://robot", "robot", False),
        ("http://[", "[", False),
        ("", "", False),
    ],
)
def test_a_page_is_the_servers_own_if_its_origin_is_the_host(origin: str, host: str, is_own: bool) -> None:
    assert is_own_origin(origin, host) is is_own


@pytest.mark.parametrize(
    ("origin", "may"),
    [
        ("", True),
        ("http://localhost:8080", True),
        ("http://127.0.0.1", True),
        ("http://[::1]:3000", True),
        ("https://studio.example.org", True),
        ("https://studio.example.org:444", True),
        ("http://studio.example.org", False),
        ("https://studio.example.org.evil.example", False),
        ("http://localhost.evil.example", False),
        ("http://evil.example", False),
        ("null", False),
        ("file://", False),
        ("http://[", False),
    ],
)
def test_pages_of_allowed_origins_may_connect(origin: str, may: bool) -> None:
    access = Access(origins=("https://studio.example.org",))
    assert access.origin_allowed(origin) is may


def test_a_star_allows_every_origin() -> None:
    assert Access(origins=("*",)).origin_allowed("http://evil.example")


@pytest.mark.parametrize(
    ("origin", "host", "may"),
    [
        ("http://robot:9090", "robot:9090", True),
        ("https://robot", "robot", True),
        ("http://robot:8080", "robot:9090", False),
        ("http://evil.example", "robot:9090", False),
        ("file://", "", False),
    ],
)
def test_the_servers_own_pages_may_connect(origin: str, host: str, may: bool) -> None:
    assert Access(token="s3cret").origin_allowed(origin, host) is may


def test_names_are_granted_by_patterns() -> None:
    assert matches("/robot1/battery_level", ["/robot1/*"])
    assert not matches("/robot2/battery_level", ["/robot1/*"])
    assert matches("/reset1", ("/other", "/reset?")) and matches("/other", ("/other", "/reset?"))
    assert not matches("/reset12", ["/reset?"])
    assert not matches("/alert_system/reset", [])


def test_by_default_everything_except_reading_is_denied() -> None:
    access = Access()
    assert (access.publish, access.services, access.offer) == ((), (), ())
    assert access.origin_allowed("http://localhost:3000")
    assert not access.origin_allowed("https://studio.example.org")


@pytest.mark.parametrize(
    ("host", "own"),
    [
        ("127.0.0.1", True),
        ("127.8.8.8", True),
        ("::1", True),
        ("localhost", True),
        ("LOCALHOST:9090", True),
        ("127.0.0.1:9090", True),
        ("[::1]:9090", True),
        ("localhost.evil.example:9090", False),
        ("127.0.0.1.evil.example", False),
        ("0.0.0.0", False),
        ("::", False),
        ("192.168.1.5", False),
        ("robot1", False),
        ("", False),
    ],
)
def test_loopback_names_and_addresses(host: str, own: bool) -> None:
    assert is_loopback(host) is own


def check(headers: dict[str, str], access: Access, method: str = "GET") -> int | None:
    refusal = refusal_of(make_mocked_request(method, "/", headers), access, check_host=not access.token)
    assert refusal.isprintable()
    return 403 if refusal else None


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Host": "localhost:9090"}, None),
        ({"Host": "127.0.0.1:9090", "Origin": "http://127.0.0.1:9090"}, None),
        ({"Host": "evil.example"}, 403),
        ({}, 403),
        ({"Host": "localhost:9090", "Origin": "https://evil.example"}, 403),
        ({"Host": "evil.example", "Origin": "http://evil.example"}, 403),
        ({"Host": "localhost", "Authorization": "Bearer anything"}, None),
    ],
)
@pytest.mark.parametrize("method", ["GET", "POST", "DELETE"])
def test_without_a_token_host_and_origin_must_be_local(
    headers: dict[str, str], status: int | None, method: str
) -> None:
    assert check(headers, Access(), method) == status


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Host": "robot:9090"}, None),
        ({"Host": "robot:9090", "Origin": "http://robot:9090"}, None),
        ({"Host": "robot:9090", "Origin": "https://evil.example"}, 403),
    ],
)
def test_with_a_token_only_the_origin_is_checked(headers: dict[str, str], status: int | None) -> None:
    assert check(headers, Access(token="s3cret")) == status


HOST = {"Host": "robot:9090"}


class Clock:
    def __init__(self) -> None:
        self.now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s


def client(check: TokenCheck, headers: dict[str, str], path: str = "/") -> Client:
    return Client(check, make_mocked_request("GET", path, {**HOST, **headers}))


@pytest.mark.parametrize(
    ("headers", "path", "credentials"),
    [
        ({"Authorization": "Bearer s3cret"}, "/", Credentials.VALID),
        ({"Authorization": "bearer  s3cret "}, "/", Credentials.VALID),
        ({}, "/?token=s3cret", Credentials.VALID),
        ({}, "/", Credentials.MISSING),
        ({"Authorization": "Bearer wrong"}, "/", Credentials.WRONG),
        ({"Authorization": "Bearer s3cre"}, "/", Credentials.WRONG),
        ({"Authorization": "Bearer s3cret2"}, "/", Credentials.WRONG),
        ({"Authorization": "Basic s3cret"}, "/", Credentials.WRONG),
        ({"Authorization": "s3cret"}, "/", Credentials.WRONG),
        ({"Authorization": "Bearer"}, "/", Credentials.WRONG),
        ({"Authorization": "Bearer wrong"}, "/?token=s3cret", Credentials.WRONG),
        ({}, "/?token=", Credentials.WRONG),
        ({}, "/?token=%E2%98%83", Credentials.WRONG),
    ],
)
def test_the_token_is_presented_in_the_header_or_the_address(headers: Any, path: str, credentials: Any) -> None:
    assert client(TokenCheck("s3cret"), headers, path).token is credentials
    assert client(TokenCheck(""), headers, path).admitted


def test_any_text_can_be_judged() -> None:
    assert TokenCheck("s3cret").judge("\udcff") is Credentials.WRONG  # the byte 0xff, as aiohttp decodes it
    assert TokenCheck("s3cret").judge(["s3cret"]) is Credentials.WRONG


def login(check: TokenCheck, headers: dict[str, str]) -> str:
    """Returns the header Cookie that a browser sends after a login."""
    response = client(check, headers).login("s3cret")
    assert response.status == 200
    return response.headers["Set-Cookie"].partition(";")[0]


def test_a_cookie_is_valid_for_its_time_and_its_token_only() -> None:
    clock = Clock()
    check = TokenCheck("s3cret", clock)
    cookie = {"Cookie": login(check, {})}
    assert client(check, cookie).admitted
    assert client(TokenCheck("s3cret", clock), cookie).admitted  # after a restart
    other = client(TokenCheck("another", clock), cookie)
    assert (other.admitted, other.cookie) == (False, Credentials.WRONG)
    clock.now_s += SESSION_S
    expired = client(check, cookie)
    assert (expired.admitted, expired.cookie) == (False, Credentials.MISSING)


def test_a_wrong_token_is_not_made_good_by_a_cookie() -> None:
    check = TokenCheck("s3cret")
    assert not client(check, {"Cookie": login(check, {}), "Authorization": "Bearer wrong"}).admitted


def test_servers_on_one_host_have_cookies_of_different_names() -> None:
    check = TokenCheck("s3cret")
    names = [
        login(check, {"Host": host}).partition("=")[0] for host in ("robot:9090", "robot:9091", "robot", "[::1]:x")
    ]
    assert names == ["robot_health_9090", "robot_health_9091", "robot_health", "robot_health"]


def test_what_is_sent_before_the_token_does_not_depend_on_it() -> None:
    def sent(token: str) -> list[Any]:
        responses = [
            client(TokenCheck(token), {}).logout(),
            client(TokenCheck(token), {}).refusal(),
            client(TokenCheck(token), {}).login("guess"),
            client(TokenCheck(token), {"Cookie": "robot_health_9090=1.2.3"}).refusal(),
        ]
        return [(response.status, dict(response.headers), response.body) for response in responses]

    assert sent("s3cret") == sent("another")


def test_every_session_is_another_and_none_contains_the_token() -> None:
    cookies = [login(TokenCheck("s3cret"), {}) for _ in range(3)]
    assert len(set(cookies)) == 3
    assert not any("s3cret" in cookie for cookie in cookies)


@pytest.mark.parametrize("forged", [".", "..", "9999999999.0.", "x" * 10_000, "٣.a.b", "1.2.\udcff", "9" * 150])
def test_a_forged_cookie_is_refused(forged: str) -> None:
    assert TokenCheck("s3cret").judge_cookie(forged) is Credentials.WRONG


def test_a_changed_expiry_is_refused() -> None:
    check = TokenCheck("s3cret")
    expiry, rest = check.new_cookie().split(".", 1)
    assert check.judge_cookie(f"{int(expiry) + 1}.{rest}") is Credentials.WRONG


def refused(check: TokenCheck, address: str) -> tuple[int, str]:
    """Returns status and text of the answer to a wrong token."""
    response = check.refuse(address, Credentials.WRONG)
    return response.status, json.loads(response.body or b"")["error"]


def test_every_way_to_present_a_wrong_token_counts_and_the_right_one_is_never_locked_out() -> None:
    clock = Clock()
    check = TokenCheck("s3cret", clock, clock)
    cookie = {"Cookie": login(check, {})}
    ways = [
        lambda: client(check, {"Authorization": "Bearer guess"}).refusal(),
        lambda: client(check, {}, "/?token=guess").refusal(),
        lambda: client(check, {}).login("guess"),
        lambda: client(check, {"Cookie": "robot_health_9090=9999999999.a.b"}).refusal(),
    ]
    assert [ways[number % 4]().status for number in range(10)] == [401] * 10
    clock.now_s += 20.0
    for way in ways:
        response = way()
        assert (response.status, response.headers["Retry-After"]) == (429, "40")
        assert json.loads(response.body or b"") == {"error": "too many wrong tokens; try again in 40 s"}
    assert refused(check, "") == (429, "too many wrong tokens; try again in 40 s")
    assert client(check, {}).refusal().status == 401  # nothing was presented
    assert client(check, {"Authorization": "Bearer s3cret"}).admitted
    assert client(check, {}, "/?token=s3cret").admitted
    assert client(check, cookie).admitted
    assert client(check, {}).login("s3cret").status == 200


def test_ten_wrong_tokens_in_a_minute_are_too_many_of_one_address() -> None:
    clock = Clock()
    check = TokenCheck("s3cret", clock, clock)
    for _ in range(10):
        assert refused(check, "10.0.0.1") == (401, "wrong token")
        clock.now_s += 1.0
    assert refused(check, "10.0.0.1") == (429, "too many wrong tokens; try again in 50 s")
    assert refused(check, "10.0.0.2") == (401, "wrong token")
    clock.now_s += 50.0
    assert refused(check, "10.0.0.1") == (401, "wrong token")


def test_the_memory_for_addresses_is_bounded() -> None:
    check = TokenCheck("s3cret", Clock(), Clock())
    assert {refused(check, f"client {number}")[0] for number in range(5000)} == {401}
    assert len(check._wrong) == 1000
