from __future__ import annotations

import json
import struct
from typing import Any

import cbor2
import pytest

from robot_health_monitor.core.errors import MessageError
from robot_health_monitor.rosbridge.server.encoded_message import EncodedMessage, Encoding


def payload(frame: bytes) -> bytes:
    """The payload of a short frame (RFC 6455, section 5.2)."""
    assert frame[1] < 126 and len(frame) == 2 + frame[1]
    return frame[2:]


def test_json_and_cbor_carry_the_same_operation() -> None:
    message = EncodedMessage("/a", {"data": 19.5})
    expected = {"op": "publish", "topic": "/a", "msg": {"data": 19.5}}
    assert json.loads(payload(message.frames(Encoding("none")))) == expected
    assert cbor2.loads(payload(message.frames(Encoding("cbor")))) == expected


def test_raw_bytes_come_from_the_middleware_or_from_the_serializer() -> None:
    for message in (
        EncodedMessage("/a", None, b"\x01\x02"),
        EncodedMessage("/a", {"data": 1}, serialize=lambda message: b"\x01\x02"),
    ):
        frame = message.frames(Encoding("cbor-raw"))
        assert cbor2.loads(payload(frame))["msg"]["bytes"] == b"\x01\x02"
    with pytest.raises(MessageError, match="definition of its type is not known"):
        EncodedMessage("/a", {"data": 1}).frames(Encoding("cbor-raw"))


def test_fragments_are_frames_that_join_to_the_message() -> None:
    frames = EncodedMessage("/a", {"data": "x" * 1000}).frames(Encoding("none", 300))
    texts = []
    while frames:
        assert frames[0] == 0x81 and frames[1] == 126
        (length,) = struct.unpack("!H", frames[2:4])
        texts.append(json.loads(frames[4 : 4 + length]))
        frames = frames[4 + length :]
    assert [text["num"] for text in texts] == list(range(texts[0]["total"]))
    assert json.loads("".join(text["data"] for text in texts))["msg"] == {"data": "x" * 1000}


def test_an_encoding_is_computed_once() -> None:
    message = EncodedMessage("/a", {"data": 19.5})
    assert message.frames(Encoding("png")) is message.frames(Encoding("png"))


@pytest.mark.parametrize(("message", "large"), [({"data": 1.0}, False), ({"data": "x" * 900_000}, True)])
def test_large_messages_are_marked(message: Any, large: bool) -> None:
    assert EncodedMessage("/a", message).is_large is large


def test_a_message_that_cannot_be_encoded_is_a_message_error() -> None:
    for compression in ("none", "png", "cbor"):
        with pytest.raises(MessageError):
            EncodedMessage("/a", {"data": object()}).frames(Encoding(compression))
