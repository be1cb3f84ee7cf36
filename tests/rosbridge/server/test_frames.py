from __future__ import annotations

import pytest

from robot_health_monitor.rosbridge.server.frames import frame


@pytest.mark.parametrize(
    ("message", "header"),
    [
        ("Hello", b"\x81\x05"),  # the example of RFC 6455, section 5.7
        ("", b"\x81\x00"),
        (b"\x01" * 125, b"\x82\x7d"),
        (b"\x01" * 126, b"\x82\x7e\x00\x7e"),
        (b"\x01" * 256, b"\x82\x7e\x01\x00"),  # the same section
        (b"\x01" * 65536, b"\x82\x7f\x00\x00\x00\x00\x00\x01\x00\x00"),  # and again
    ],
)
def test_frames_are_those_of_the_rfc(message: object, header: bytes) -> None:
    assert isinstance(message, (str, bytes))
    payload = message.encode() if isinstance(message, str) else message
    assert frame(message) == header + payload


def test_text_is_sent_as_utf_8() -> None:
    assert frame("\N{DEGREE SIGN}C") == b"\x81\x03\xc2\xb0C"
