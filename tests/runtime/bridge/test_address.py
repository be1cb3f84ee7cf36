"""Addresses are checked, and shown without anything secret."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_health_monitor.core.values.errors import ConfigError
from robot_health_monitor.runtime.bridge.address import full_address, host_and_port, http_address, shown_address


@pytest.mark.parametrize(
    ("url", "expected"),
    [
        ("ws://robot:9090", ("robot", 9090)),
        ("wss://10.0.0.8", ("10.0.0.8", None)),
        ("ws://[::1]:9090/path", ("::1", 9090)),
        ("ws://user:pass@robot:9090/?token=x", ("robot", 9090)),
    ],
)
def test_an_address_has_a_host_and_perhaps_a_port(url: str, expected: object) -> None:
    assert host_and_port(url) == expected


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("robot:9090", "ws://robot:9090"),
        ("10.0.0.7:80/path", "ws://10.0.0.7:80/path"),
        ("[::1]:9090", "ws://[::1]:9090"),
        ("wss://robot:9090", "wss://robot:9090"),
        ("http://robot:9090", "http://robot:9090"),
        ("robot", "robot"),
        ("robot:port", "robot:port"),
        ("", ""),
    ],
)
def test_a_host_with_a_port_needs_no_scheme(text: str, expected: str) -> None:
    assert full_address(text) == expected


@pytest.mark.parametrize(
    "url",
    [
        "robot:9090",
        "http://robot:9090",
        "ws://",
        "ws://robot:99999",
        "ws://robot:0",
        "ws://a robot:9090",
        "ws://[robot",
        "",
        "ws://a\nb:9090",
    ],
)
def test_anything_else_is_a_configuration_error(url: str) -> None:
    with pytest.raises(ConfigError, match="expected ws://host:port"):
        host_and_port(url)


@pytest.mark.parametrize(
    ("url", "shown"),
    [
        ("ws://robot:9090", "ws://robot:9090"),
        ("ws://user:secret@robot:9090/?token=secret", "ws://robot:9090/"),
        ("wss://secret@robot/path#secret", "wss://robot/path"),
        ("ws://user:p@secret@robot:9090", "ws://robot:9090"),
        ("ws://user:secret@robot:99999", "ws://robot:99999"),
        ("user:secret@robot:9090", "robot:9090"),
        ("ws://robot?token=secret@x", "ws://robot"),
    ],
)
def test_an_address_is_shown_without_credentials(url: str, shown: str) -> None:
    assert shown_address(url) == shown


@given(st.text())
def test_any_text_can_be_shown(text: str) -> None:
    assert "?" not in shown_address(text)


def test_a_refused_address_is_shown_without_credentials() -> None:
    with pytest.raises(ConfigError) as error:
        host_and_port("ws://user:secret@robot:99999/?token=secret")
    assert "secret" not in str(error.value)


@pytest.mark.parametrize(
    ("url", "http"),
    [
        ("ws://ws:1", "http://ws:1"),
        ("wss://robot:9090/ws:", "https://robot:9090/ws:"),
        ("foxglove://robot:8765", "http://robot:8765"),
        ("foxglove+tls://robot:8765/a", "https://robot:8765/a"),
    ],
)
def test_the_first_request_is_http(url: str, http: str) -> None:
    assert http_address(url) == http
