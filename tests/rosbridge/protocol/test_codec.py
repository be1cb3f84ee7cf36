"""The encodings: JSON, CBOR, PNG, and the topic of a message that is too large to decode."""

from __future__ import annotations

import json
import math
import struct
from typing import Any

import cbor2
import pytest
from harness.seeds import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from robot_health_monitor.core.values.errors import MessageError
from robot_health_monitor.rosbridge.protocol.codec import (
    decode,
    decode_cbor,
    encode,
    encode_cbor,
    serialized_publication,
    topic_of_message,
)
from robot_health_monitor.rosbridge.protocol.limits import Limits, ProtocolError


class TestDecoding:
    @pytest.mark.parametrize("data", ['{"a": 1}', b'{"a": 1}', b'\n{"a": 1}', b"\xa1\x61a\x01"])
    def test_json_text_json_bytes_and_cbor_are_read(self, data: Any) -> None:
        assert decode(data, Limits()) == {"a": 1}

    @pytest.mark.parametrize(
        ("data", "problem"),
        [
            ("", "not JSON"),
            ("{{", "not JSON"),
            (b"{\xff", "not UTF-8"),
            ("[]", r"expected an object, got \[\]"),
            ("null", "expected an object, got nothing"),
        ],
    )
    def test_anything_else_is_refused(self, data: Any, problem: str) -> None:
        with pytest.raises(ProtocolError, match=problem):
            decode(data, Limits())

    def test_half_of_a_surrogate_pair_becomes_a_question_mark(self) -> None:
        """One odd name of a topic must not hide the others."""
        assert decode(r'{"topics": ["/a", "/\ud800"], "\uDFFF": 1}', Limits()) == {"topics": ["/a", "/?"], "?": 1}

    def test_a_surrogate_pair_is_one_character(self) -> None:
        assert decode(r'{"id": "\ud83e\udd16 \\ud800"}', Limits()) == {"id": "\U0001f916 \\ud800"}


class TestLimits:
    def test_a_message_of_exactly_the_limit_passes_and_one_byte_more_does_not(self) -> None:
        text = json.dumps({"data": "x" * 100})
        assert decode(text, Limits(message_bytes=len(text))) == {"data": "x" * 100}
        with pytest.raises(ProtocolError, match="longer than"):
            decode(text, Limits(message_bytes=len(text) - 1))

    def test_nesting_up_to_the_limit_passes_and_one_more_does_not(self) -> None:
        def nested(depth: int) -> str:
            return '{"a":' * depth + "1" + "}" * depth

        assert decode(nested(64), Limits())["a"]
        with pytest.raises(ProtocolError, match="nested"):
            decode(nested(65), Limits())
        with pytest.raises(ProtocolError, match="nested"):
            decode("[" * 40_000 + "]" * 40_000, Limits())

    def test_many_brackets_beside_each_other_are_not_nesting(self) -> None:
        assert decode(json.dumps({"data": [[]] * 1000}), Limits()) == {"data": [[]] * 1000}

    def test_lists_and_objects_are_counted(self) -> None:
        assert decode(json.dumps({"data": [[]] * 8}), Limits(containers=10))
        with pytest.raises(ProtocolError, match="more than 10 lists and objects"):
            decode(json.dumps({"data": [[]] * 9}), Limits(containers=10))

    def test_integers_of_more_than_64_bits_are_read_as_floats(self) -> None:
        """Python's int() would take seconds for the last one."""
        largest, smallest, beyond, endless = 2**64 - 1, -(2**63), 10**20, "9" * 300_000
        decoded = decode(f'{{"data": [{largest}, {smallest}, {beyond}, {endless}, -{endless}]}}', Limits())
        assert decoded == {"data": [largest, smallest, 1e20, math.inf, -math.inf]}
        assert [type(number) for number in decoded["data"]] == [int, int, float, float, float]


class TestNumbersThatJsonLacks:
    def test_nan_and_infinities_are_written_as_null(self) -> None:
        message = {"data": math.nan, "list": [math.inf, 1.0, -math.inf], "inner": {"x": math.nan}}
        assert json.loads(encode(message)) == {"data": None, "list": [None, 1.0, None], "inner": {"x": None}}

    def test_bytes_are_written_as_base64(self) -> None:
        assert encode({"data": b"\x00\xff"}) == '{"data":"AP8="}'

    def test_a_value_that_json_lacks_is_a_message_error(self) -> None:
        with pytest.raises(MessageError, match="complex cannot be encoded as JSON"):
            encode({"data": 1j})


LEAF = st.none() | st.booleans() | st.integers() | st.floats() | st.text() | st.binary()
JSON = st.recursive(
    LEAF,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=10), inner, max_size=4),
    max_leaves=12,
)


@pytest.mark.newest_python
@settings(max_examples=examples(200))
@given(JSON)
def test_a_large_message_is_encoded_to_the_same_text(value: Any) -> None:
    assert encode(value, is_large=True) == encode(value)


@pytest.mark.parametrize("values", [[0.5, math.nan] * 1000, [{"x": 1}] * 250, [[1, 2]] * 101, list(range(100))])
def test_long_lists_are_encoded_to_the_same_text(values: list[Any]) -> None:
    assert encode({"data": values, "other": tuple(values)}, is_large=True) == encode({"data": values, "other": values})


def test_the_bytes_are_those_of_the_specification() -> None:
    """RFC 8949: a map of one pair, a text of 1 byte, the whole number 2."""
    assert encode_cbor({"a": 2}) == b"\xa1\x61\x61\x02"


@pytest.mark.parametrize(
    ("tag", "form", "values"),
    [
        (69, "<2H", [1, 65535]),
        (70, "<2I", [1, 4294967295]),
        (71, "<1Q", [2**64 - 1]),
        (72, "<2b", [-128, 127]),
        (77, "<2h", [-1, 2]),
        (78, "<2i", [-1, 2]),
        (79, "<1q", [-(2**63)]),
        (85, "<2f", [0.5, -2.0]),
        (86, "<1d", [0.1]),
    ],
)
def test_the_reference_servers_typed_arrays_become_lists(tag: int, form: str, values: Any) -> None:
    """The tags and byte order of its cbor_conversion.py."""
    data = cbor2.dumps({"data": cbor2.CBORTag(tag, struct.pack(form, *values))})
    assert decode_cbor(data, Limits()) == {"data": values}


def test_byte_strings_become_base64() -> None:
    assert decode_cbor(cbor2.dumps({"data": b"\x00\xff"}), Limits()) == {"data": "AP8="}


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\xa1",
        b"\xa1\x61\x61\x02\x03"[:3],
        b"\x9b\xff\xff\xff\xff\xff\xff\xff\xff",  # a list of 2**64 - 1 items
        b"\x5b\x7f\xff\xff\xff\xff\xff\xff\xff",  # a byte string of 2**63 - 1 bytes
        b"\xa1\x01\x02",  # a key that is a number
        b"\xd8\x1c\x81\xd8\x1d\x00",  # shared references: a list that contains itself
        b"\xa1\x61a\xd9\x01\x00\x82\x63abc\xd8\x19\x00",  # string references
        b"\xa1\x61a\xc2\x49\x01\x00\x00\x00\x00\x00\x00\x00\x00",  # the big number 2**64
        b"\xa1\x61a\xbb\x00\x00\x00\x00\x7f\xff\xff\xff",  # a map of 2**31 - 1 pairs
        b"\xbf\x61a\x01\xff",  # a map of indefinite length
        b"\xa1\x61a\x5f\x41a\xff",  # a byte string of indefinite length
        b"\xa1\x61a\xf8\x20",  # an unassigned simple value
        b"\xa0\x00",  # bytes after the end
        b"\xc0\x63abc",  # an invalid date
        b"\xd8\x23\x61(",  # a broken regular expression
        b"\xa1\x61a\xd8\x24\x60",  # a MIME message
        b"\xa1\x61a\xd9\x01\x04\x45abcde",  # an address of 5 bytes
        b"\xa1\x61a\xd8\x55\x43abc",  # a typed array of floats of 3 bytes
        b"\xa1\x61a\xd8\xff\x00",  # an unknown tag
        b"\xa1\x61a\xc4\x82\x1b\x7f\xff\xff\xff\xff\xff\xff\xff\x01",  # a fraction with 2**63 digits
        b"\xff",
    ],
)
def test_anything_that_rosbridge_does_not_use_is_refused(data: bytes) -> None:
    with pytest.raises(ProtocolError):
        decode_cbor(data, Limits())


def test_nesting_is_bounded() -> None:
    with pytest.raises(ProtocolError, match="nested more than 64 levels"):
        decode_cbor(b"\x81" * 100_000 + b"\x01", Limits())
    with pytest.raises(ProtocolError):
        decode_cbor(b"\x81" * 65 + b"\x01", Limits())
    assert decode_cbor(b"\x81" * 3 + b"\x01", Limits()) == [[[1]]]


def test_lists_and_maps_are_counted() -> None:
    assert decode_cbor(b"\x89" + b"\x80" * 9, Limits(containers=10)) == [[]] * 9
    with pytest.raises(ProtocolError, match="too many"):
        decode_cbor(b"\x8a" + b"\x80" * 10, Limits(containers=10))


def test_shared_references_do_no_work() -> None:
    """Each level doubles the one before: this message stands for 2**40 lists."""
    bomb = b"\xd8\x1c\x80"
    for level in range(40):
        bomb = b"\xd8\x1c\x82" + bomb + b"\xd8\x1d" + bytes([23 - level % 24])
    with pytest.raises(ProtocolError, match="CBOR tag 28 is not supported"):
        decode_cbor(bomb, Limits())


VALUES = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**64), 2**64 - 1)
    | st.floats(allow_nan=False)
    | st.floats(allow_nan=False, width=16)
    | st.text(),
    lambda inner: st.lists(inner, max_size=30) | st.dictionaries(st.text(), inner, max_size=30),
    max_leaves=50,
)


@settings(max_examples=examples(50))
@given(st.dictionaries(st.text(), VALUES), st.booleans())
def test_decodes_what_the_library_cbor2_encodes(value: Any, canonical: bool) -> None:
    assert decode_cbor(cbor2.dumps(value, canonical=canonical), Limits()) == value


def test_a_value_that_cbor_lacks_is_a_message_error() -> None:
    with pytest.raises(MessageError, match="cannot be encoded as CBOR"):
        encode_cbor({"data": object()})
    with pytest.raises(MessageError, match="cannot be encoded as CBOR"):
        encode_cbor({"data": "\ud800"})


BODY = {"data": "A" * 100_000}


@pytest.mark.parametrize("topic", ["/points", "/" + "x" * 300, "/größe", '/quo"te', "/back\\slash"])
@pytest.mark.parametrize("encode", [json.dumps, cbor2.dumps])
def test_the_topic_is_read_from_the_start_of_a_message(topic: str, encode: Any) -> None:
    assert topic_of_message(encode({"op": "publish", "topic": topic, "msg": BODY})) == topic


@pytest.mark.parametrize("encode", [json.dumps, cbor2.dumps])
@pytest.mark.parametrize(
    "fields",
    [
        {"op": "publish", "msg": BODY, "topic": "/points"},
        {"topic": "/points", "op": "publish", "msg": BODY},
        {"op": "service_response", "topic": "/points", "values": BODY},
        {"msg": {"op": "publish", "topic": "/inner"}, "op": "publish", "topic": "/points"},
        {"op": "publish", "topic": 5, "msg": BODY},
        {"op": "publish", "topic": "/" + "x" * 5_000, "msg": BODY},
        {},
    ],
)
def test_without_a_topic_at_the_start_there_is_none(encode: Any, fields: dict[str, Any]) -> None:
    assert topic_of_message(encode(fields)) is None


def test_white_space_does_not_matter() -> None:
    assert topic_of_message(json.dumps({"op": "publish", "topic": "/points", "msg": BODY}, indent=4)) == "/points"


def test_a_map_whose_length_takes_several_bytes_is_read() -> None:
    """RFC 8949: 0xb8 is a map with its length in one byte."""
    members = cbor2.dumps("op") + cbor2.dumps("publish") + cbor2.dumps("topic") + cbor2.dumps("/points")
    assert topic_of_message(b"\xb8\x03" + members + cbor2.dumps("msg")) == "/points"


@given(st.one_of(st.text(), st.binary(), st.text().map(lambda text: '{"op":"publish","topic":"' + text)))
def test_any_data_is_accepted(data: str | bytes) -> None:
    topic: str | None = topic_of_message(data)
    assert topic is None or isinstance(topic, str)


def test_serialized_messages_are_taken_from_cbor_without_base64() -> None:
    data = bytes(range(256)) * 8
    message = {"op": "publish", "topic": "/in", "msg": {"secs": 1, "nsecs": 2, "bytes": data}}
    wire = cbor2.dumps(message)
    assert serialized_publication(wire) == ("/in", data)
    assert serialized_publication(cbor2.dumps(dict(reversed(list(message.items()))))) == ("/in", data)
    assert [serialized_publication(wire[:length]) for length in range(len(wire))] == [None] * len(wire)


@pytest.mark.parametrize(
    "message",
    [
        {"op": "publish", "topic": "/in", "msg": {"data": 1.0}},
        {"op": "publish", "topic": "/in", "msg": {"secs": 1, "nsecs": 2, "bytes": "text"}},
        {"op": "publish", "topic": "/in", "msg": {"secs": 1, "nsecs": -2, "bytes": b""}},
        {"op": "publish", "topic": "/in", "msg": {"secs": 1, "secs2": 2, "bytes": b""}},
        {"op": "publish", "topic": "/in", "msg": 3},
        {"op": "status", "topic": "/in", "msg": {"secs": 1, "nsecs": 2, "bytes": b""}},
        {"op": "publish", "msg": {"secs": 1, "nsecs": 2, "bytes": b""}, "id": "x"},
        {"op": "publish", "topic": 3, "msg": {"secs": 1, "nsecs": 2, "bytes": b""}},
        [1],
        3,
    ],
)
def test_other_messages_are_not_taken_for_serialized_ones(message: object) -> None:
    assert serialized_publication(cbor2.dumps(message)) is None
