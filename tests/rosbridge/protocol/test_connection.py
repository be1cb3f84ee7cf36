from __future__ import annotations

import json
import math
from typing import Any, Dict, List

import cbor2
import pytest
from harness.rosbridge_operations import EXAMPLES
from harness.seeds import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from robot_health_monitor.rosbridge.protocol import Wire, operations
from robot_health_monitor.rosbridge.protocol.codec import encode_json
from robot_health_monitor.rosbridge.protocol.connection import Connection, Reassembly, split
from robot_health_monitor.rosbridge.protocol.limits import Limits, ProtocolError


def receive(data: Wire, limits: Limits = Limits()) -> Any:  # noqa: B008 - frozen
    return Connection(limits).receive(data, 0.0)


@pytest.mark.parametrize("fields", EXAMPLES, ids=lambda fields: fields["op"])
class TestEveryOperation:
    @pytest.mark.parametrize("compression", ["none", "cbor"])
    def test_survives_every_encoding(self, fields: Dict[str, Any], compression: str) -> None:
        operation = receive(json.dumps(fields))
        (wire,) = Connection().send(operation, compression=compression)
        assert receive(wire) == operation

    def test_survives_fragmentation(self, fields: Dict[str, Any]) -> None:
        operation = receive(json.dumps(fields))
        wires = Connection().send(operation, fragment_size=7)
        assert len(wires) > 1
        receiver = Connection()
        received = [receiver.receive(wire, 0.0) for wire in wires]
        assert received[:-1] == [None] * (len(wires) - 1)
        assert received[-1] == operation


class TestMessagesInsideMessages:
    def test_a_compressed_message_is_refused(self) -> None:
        """Neither roslibpy nor roslibjs send one, and the reference server does not accept one."""
        (wire,) = Connection().send(operations.SetLevel("none"), compression="png")
        with pytest.raises(ProtocolError, match="png: received messages must not be compressed"):
            receive(wire)

    @pytest.mark.parametrize("op", ["fragment", "png"])
    def test_a_fragmented_message_contains_an_operation(self, op: str) -> None:
        inner = json.dumps({"op": op, "id": "b", "data": "{}", "num": 0, "total": 1})
        with pytest.raises(ProtocolError, match=op):
            receive(json.dumps({"op": "fragment", "id": "a", "data": inner, "num": 0, "total": 1}))


class TestNumbersThatJsonLacks:
    def test_nan_and_infinities_are_sent_as_null(self) -> None:
        message = {"data": math.nan, "list": [math.inf, 1.0, -math.inf], "inner": {"x": math.nan}}
        (wire,) = Connection().send(operations.Publish("/a", message))
        assert json.loads(wire)["msg"] == {"data": None, "list": [None, 1.0, None], "inner": {"x": None}}

    def test_cbor_keeps_them(self) -> None:
        (wire,) = Connection().send(operations.Publish("/a", {"data": -math.inf}), compression="cbor")
        assert receive(wire).msg == {"data": -math.inf}

    def test_byte_arrays_are_sent_as_base64(self) -> None:
        (wire,) = Connection().send(operations.Publish("/a", {"data": b"\x00\xff"}))
        assert json.loads(wire)["msg"] == {"data": "AP8="}


JSON = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=10), inner, max_size=4),
    max_leaves=12,
)
FIELD_NAMES = sorted({name for operation in operations.OPERATIONS.values() for name in operation.__dataclass_fields__})
OPS = [*operations.OPERATIONS, "png"]


def raises_only_its_own_error(connection: Connection, data: Any) -> None:
    try:
        operation = connection.receive(data, 0.0)
    except ProtocolError:
        return
    if operation is not None:
        connection.send(operation)
        connection.send(operation, compression="cbor")


@settings(max_examples=examples(300))
@given(
    st.sampled_from(OPS),
    st.dictionaries(st.sampled_from([*FIELD_NAMES, "data", "num", "total"]), JSON, max_size=8),
    st.sampled_from(["json", "cbor"]),
)
def test_an_operation_with_any_fields_raises_nothing_but_its_own_error(
    op: str, fields: Dict[str, Any], encoding: str
) -> None:
    message = {**fields, "op": op}
    raises_only_its_own_error(Connection(), json.dumps(message) if encoding == "json" else cbor2.dumps(message))


@settings(max_examples=examples(300))
@given(st.text() | st.binary())
def test_any_text_and_any_bytes_raise_nothing_but_its_own_error(data: Any) -> None:
    raises_only_its_own_error(Connection(), data)


@pytest.mark.newest_python
@settings(max_examples=examples(300))
@given(st.data())
def test_a_damaged_message_raises_nothing_but_its_own_error(data: st.DataObject) -> None:
    fields = data.draw(st.sampled_from(EXAMPLES))
    compression = data.draw(st.sampled_from(["none", "cbor"]))
    (wire,) = Connection().send(receive(json.dumps(fields)), compression=compression)
    raw = bytearray(wire.encode() if isinstance(wire, str) else wire)
    for _ in range(data.draw(st.integers(1, 4))):
        raw[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
    cut = bytes(raw[: data.draw(st.integers(0, len(raw)))])
    raises_only_its_own_error(Connection(), cut)


@pytest.mark.newest_python
@settings(max_examples=examples(200))
@given(st.lists(st.dictionaries(st.sampled_from(["id", "num", "total", "data"]), JSON, max_size=4), max_size=10))
def test_any_sequence_of_fragments_raises_nothing_but_its_own_error(sequence: List[Dict[str, Any]]) -> None:
    connection = Connection()
    for fields in sequence:
        raises_only_its_own_error(connection, json.dumps({**fields, "op": "fragment"}))


@pytest.mark.newest_python
@settings(max_examples=examples(200))
@given(st.dictionaries(st.text(max_size=10), JSON, max_size=5), st.integers(1, 50))
def test_any_message_survives_any_fragment_size(message: Dict[str, Any], size: int) -> None:
    connection = Connection()
    wires = connection.send(operations.Publish("/a", message), fragment_size=size)
    received = [Connection.receive(connection, wire, 0.0) for wire in wires]
    expected = json.loads(encode_json(message))
    assert received[-1] is not None and received[-1].msg == expected  # type: ignore[union-attr]


def fragment(data: str, num: Any, total: Any, id: Any = "a") -> Any:  # noqa: A002 - the protocol's word
    return operations.read_operation({"op": "fragment", "id": id, "data": data, "num": num, "total": total})


def test_a_text_is_split_as_the_protocol_has_it() -> None:
    assert list(split("abcdefgh", 3, "x")) == [
        {"op": "fragment", "id": "x", "data": "abc", "num": 0, "total": 3},
        {"op": "fragment", "id": "x", "data": "def", "num": 1, "total": 3},
        {"op": "fragment", "id": "x", "data": "gh", "num": 2, "total": 3},
    ]


def test_fragments_may_come_in_any_order_and_twice() -> None:
    reassembly = Reassembly(Limits())
    assert reassembly.add(fragment("c", 2, 3), 0.0) is None
    assert reassembly.add(fragment("a", 0, 3), 0.0) is None
    assert reassembly.add(fragment("?", 0, 3), 0.0) is None
    assert reassembly.add(fragment("b", 1, 3), 0.0) == "abc"


def test_messages_may_be_mixed() -> None:
    reassembly = Reassembly(Limits())
    assert reassembly.add(fragment("a", 0, 2, "one"), 0.0) is None
    assert reassembly.add(fragment("x", 0, 2, 2), 0.0) is None
    assert reassembly.add(fragment("b", 1, 2, "one"), 0.0) == "ab"
    assert reassembly.add(fragment("y", 1, 2, 2), 0.0) == "xy"


def test_the_reference_servers_total_is_understood() -> None:
    """It divides without rounding: 90 characters in pieces of 30 have the total 3.966..."""
    reassembly = Reassembly(Limits())
    total = (90 - 1) / 30 + 1
    assert reassembly.add(fragment("a", 0, total), 0.0) is None
    assert reassembly.add(fragment("b", 1, total), 0.0) is None
    assert reassembly.add(fragment("c", 2, total), 0.0) == "abc"


@pytest.mark.parametrize(
    ("num", "total"),
    [(2, 2), (-1, 2), (0, 0), (0, -1), (0, 10_001), ("0", 2), (None, 2), (0, None), (True, 2), (0, 1e300), (0.0, "2")],
)
def test_a_number_beyond_its_total_is_refused(num: Any, total: Any) -> None:
    with pytest.raises(ProtocolError):
        Reassembly(Limits()).add(fragment("a", num, total), 0.0)


def test_a_total_that_changes_drops_the_message() -> None:
    reassembly = Reassembly(Limits())
    reassembly.add(fragment("a", 0, 2), 0.0)
    with pytest.raises(ProtocolError, match="total: expected 2 as before, got 3"):
        reassembly.add(fragment("b", 1, 3), 0.0)
    assert reassembly.add(fragment("b", 1, 2), 0.0) is None


def test_more_than_the_limit_is_refused_and_forgotten() -> None:
    reassembly = Reassembly(Limits(message_bytes=10))
    reassembly.add(fragment("12345678", 0, 2), 0.0)
    with pytest.raises(ProtocolError, match="more than 10 characters"):
        reassembly.add(fragment("901", 1, 2), 0.0)
    assert reassembly.add(fragment("1234567890", 0, 1, "b"), 0.0) == "1234567890"


def test_the_oldest_of_too_many_messages_is_dropped() -> None:
    reassembly = Reassembly(Limits(partial_messages=2))
    for name in "abc":
        reassembly.add(fragment("1", 0, 2, name), 0.0)
    assert reassembly.add(fragment("2", 1, 2, "b"), 0.0) == "12"
    assert reassembly.add(fragment("2", 1, 2, "a"), 0.0) is None


def test_a_message_that_does_not_go_on_is_dropped_after_the_timeout() -> None:
    reassembly = Reassembly(Limits(fragment_timeout_s=60.0))
    reassembly.add(fragment("a", 0, 2), 0.0)
    reassembly.add(fragment("x", 0, 2, "kept"), 1.0)
    assert reassembly.add(fragment("y", 1, 2, "kept"), 60.5) == "xy"
    assert reassembly.add(fragment("b", 1, 2), 60.5) is None
