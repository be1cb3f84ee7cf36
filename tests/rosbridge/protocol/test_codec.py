from __future__ import annotations

import json
import math
from typing import Any, List

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robot_health_monitor.core.errors import MessageError
from robot_health_monitor.rosbridge.protocol.codec import (
    decode,
    encode_json,
    encode_json_with_nan,
    encode_large_json,
)
from robot_health_monitor.rosbridge.protocol.errors import ProtocolError
from robot_health_monitor.rosbridge.protocol.limits import Limits


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
            ("[]", "expected an object, got a list"),
            ("null", "expected an object, got None"),
            (r'{"id": "\ud800"}', "a string contains half of a surrogate pair"),
            (r'{"\uDFFF": 1}', "a string contains half of a surrogate pair"),
        ],
    )
    def test_anything_else_is_refused(self, data: Any, problem: str) -> None:
        with pytest.raises(ProtocolError, match=problem):
            decode(data, Limits())

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
        assert json.loads(encode_json(message)) == {"data": None, "list": [None, 1.0, None], "inner": {"x": None}}

    def test_a_client_may_write_them_as_python_does(self) -> None:
        assert encode_json_with_nan({"data": math.inf}) == '{"data":Infinity}'

    def test_bytes_are_written_as_base64(self) -> None:
        assert encode_json({"data": b"\x00\xff"}) == '{"data":"AP8="}'

    def test_a_value_that_json_lacks_is_a_message_error(self) -> None:
        with pytest.raises(MessageError, match="complex cannot be encoded as JSON"):
            encode_json({"data": 1j})


LEAF = st.none() | st.booleans() | st.integers() | st.floats() | st.text() | st.binary()
JSON = st.recursive(
    LEAF,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=10), inner, max_size=4),
    max_leaves=12,
)


@settings(max_examples=200)
@given(JSON)
def test_a_large_message_is_encoded_to_the_same_text(value: Any) -> None:
    assert encode_large_json(value) == encode_json(value)


@pytest.mark.parametrize("values", [[0.5, math.nan] * 1000, [{"x": 1}] * 250, [[1, 2]] * 101, list(range(100))])
def test_long_lists_are_encoded_to_the_same_text(values: List[Any]) -> None:
    assert encode_large_json({"data": values, "other": tuple(values)}) == encode_json({"data": values, "other": values})
