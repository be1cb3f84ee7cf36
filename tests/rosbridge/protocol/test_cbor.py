from __future__ import annotations

import struct
from typing import Any

import cbor2
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robot_health_monitor.core.errors import MessageError
from robot_health_monitor.rosbridge.protocol.cbor import decode_cbor, encode_cbor
from robot_health_monitor.rosbridge.protocol.errors import ProtocolError
from robot_health_monitor.rosbridge.protocol.limits import Limits


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
        b"\xa1\x62\xed\xa0\x01",  # a key that is not UTF-8
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


@settings(max_examples=50)
@given(st.dictionaries(st.text(), VALUES), st.booleans())
def test_decodes_what_the_library_cbor2_encodes(value: Any, canonical: bool) -> None:
    assert decode_cbor(cbor2.dumps(value, canonical=canonical), Limits()) == value


def test_a_value_that_cbor_lacks_is_a_message_error() -> None:
    with pytest.raises(MessageError, match="cannot be encoded as CBOR"):
        encode_cbor({"data": object()})
    with pytest.raises(MessageError, match="cannot be encoded as CBOR"):
        encode_cbor({"data": "\ud800"})
