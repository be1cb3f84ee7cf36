"""Messages as a whole: decoding, reading and encoding together."""

from __future__ import annotations

import json
import math
from typing import Any

import cbor2
import pytest
from harness.rosbridge_operations import EXAMPLES
from harness.seeds import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from robot_health_monitor.rosbridge.protocol import Limits, ProtocolError, Wire, decode, encode, operations
from robot_health_monitor.rosbridge.protocol.operations import read_operation


def receive(data: Wire, limits: Limits = Limits()) -> Any:  # noqa: B008 - frozen
    return read_operation(decode(data, limits))


def published(message: dict[str, Any]) -> dict[str, Any]:
    return {"op": "publish", "topic": "/a", "msg": message}


@pytest.mark.parametrize("compression", ["none", "cbor"])
@pytest.mark.parametrize("fields", EXAMPLES, ids=lambda fields: fields["op"])
def test_every_operation_survives_every_encoding(fields: dict[str, Any], compression: str) -> None:
    assert receive(encode(fields, compression)) == receive(json.dumps(fields))


def test_a_compressed_message_is_refused() -> None:
    """Neither roslibpy nor roslibjs send one, and the reference server does not accept one."""
    with pytest.raises(ProtocolError, match="png: received messages must not be compressed"):
        receive('{"op": "png", "data": "iVBORw0KGgo="}')


class TestNumbersThatJsonLacks:
    def test_nan_and_infinities_are_sent_as_null(self) -> None:
        message = {"data": math.nan, "list": [math.inf, 1.0, -math.inf], "inner": {"x": math.nan}}
        expected = {"data": None, "list": [None, 1.0, None], "inner": {"x": None}}
        for is_large in (False, True):
            assert json.loads(encode(published(message), is_large=is_large))["msg"] == expected

    def test_cbor_keeps_them(self) -> None:
        assert receive(encode(published({"data": -math.inf}), "cbor")).msg == {"data": -math.inf}

    def test_byte_arrays_are_sent_as_base64(self) -> None:
        assert json.loads(encode(published({"data": b"\x00\xff"})))["msg"] == {"data": "AP8="}


JSON = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=10), inner, max_size=4),
    max_leaves=12,
)
FIELD_NAMES = sorted({name for operation in operations.OPERATIONS.values() for name in operation.__dataclass_fields__})
OPS = [*operations.OPERATIONS, "png", "fragment", "status"]


def raises_only_its_own_error(data: Any) -> None:
    try:
        receive(data)
    except ProtocolError:
        return


@settings(max_examples=examples(300))
@given(
    st.sampled_from(OPS),
    st.dictionaries(st.sampled_from([*FIELD_NAMES, "data"]), JSON, max_size=8),
    st.sampled_from(["json", "cbor"]),
)
def test_an_operation_with_any_fields_raises_nothing_but_its_own_error(
    op: str, fields: dict[str, Any], encoding: str
) -> None:
    message = {**fields, "op": op}
    raises_only_its_own_error(json.dumps(message) if encoding == "json" else cbor2.dumps(message))


@settings(max_examples=examples(300))
@given(st.text() | st.binary())
def test_any_text_and_any_bytes_raise_nothing_but_its_own_error(data: Any) -> None:
    raises_only_its_own_error(data)


@pytest.mark.newest_python
@settings(max_examples=examples(300))
@given(st.data())
def test_a_damaged_message_raises_nothing_but_its_own_error(data: st.DataObject) -> None:
    wire = encode(data.draw(st.sampled_from(EXAMPLES)), data.draw(st.sampled_from(["none", "cbor"])))
    raw = bytearray(wire.encode() if isinstance(wire, str) else wire)
    for _ in range(data.draw(st.integers(1, 4))):
        raw[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
    raises_only_its_own_error(bytes(raw[: data.draw(st.integers(0, len(raw)))]))
