"""The topic of a message that is too large to decode."""

from __future__ import annotations

import json
from typing import Any, Dict, Optional, Union

import cbor2
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_health_monitor.rosbridge.client.topic_of_message import topic_of_message

BODY = {"data": "A" * 100_000}


@pytest.mark.parametrize("topic", ["/points", "/" + "x" * 300, "/größe", '/quo"te', "/back\\slash"])
@pytest.mark.parametrize("encode", [json.dumps, cbor2.dumps])
def test_the_topic_is_read_from_the_start_of_a_message(topic: str, encode: Any) -> None:
    assert topic_of_message(encode({"op": "publish", "topic": topic, "msg": BODY})) == topic
    assert topic_of_message(encode({"topic": topic, "id": "one", "op": "publish", "msg": BODY})) == topic


@pytest.mark.parametrize("encode", [json.dumps, cbor2.dumps])
@pytest.mark.parametrize(
    "fields",
    [
        {"op": "publish", "msg": BODY, "topic": "/points"},
        {"op": "service_response", "topic": "/points", "values": BODY},
        {"msg": {"op": "publish", "topic": "/inner"}, "op": "publish", "topic": "/points"},
        {"op": "publish", "topic": 5, "msg": BODY},
        {"op": "publish", "topic": "/" + "x" * 5_000, "msg": BODY},
        {},
    ],
)
def test_without_a_topic_at_the_start_there_is_none(encode: Any, fields: Dict[str, Any]) -> None:
    assert topic_of_message(encode(fields)) is None


def test_white_space_does_not_matter() -> None:
    assert topic_of_message(json.dumps({"op": "publish", "topic": "/points", "msg": BODY}, indent=4)) == "/points"


def test_a_map_whose_length_takes_several_bytes_is_read() -> None:
    """RFC 8949: 0xb8 is a map with its length in one byte, 0xbf one of indefinite length."""
    members = cbor2.dumps("op") + cbor2.dumps("publish") + cbor2.dumps("topic") + cbor2.dumps("/points")
    assert topic_of_message(b"\xb8\x03" + members + cbor2.dumps("msg")) == "/points"
    assert topic_of_message(b"\xbf" + members) == "/points"


@given(st.one_of(st.text(), st.binary(), st.text().map(lambda text: '{"op":"publish","topic":"' + text)))
def test_any_data_is_accepted(data: Union[str, bytes]) -> None:
    topic: Optional[str] = topic_of_message(data)
    assert topic is None or isinstance(topic, str)
