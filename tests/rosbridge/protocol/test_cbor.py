from __future__ import annotations

import struct
from typing import Any

import cbor2
import pytest

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
        b"\xd8\x1c\x81\xd8\x1d\x00",  # a list that holds itself
        b"\xc0\x63abc",  # a date that is none
        b"\xd8\x23\x61(",  # a broken regular expression
        b"\xa1\x61a\xd8\x24\x60",  # a MIME message
        b"\xa1\x61a\xd9\x01\x04\x45abcde",  # an address of 5 bytes
        b"\xa1\x61a\xd8\x55\x43abc",  # an array of floats of 3 bytes
        b"\xa1\x61a\xd8\xff\x00",  # a tag that nobody knows
        b"\xa1\x61a\xc4\x82\x1b\x7f\xff\xff\xff\xff\xff\xff\xff\x01",  # a fraction with 2**63 digits
        b"\xff",
    ],
)
def test_what_rosbridge_does_not_say_is_refused(data: bytes) -> None:
    with pytest.raises(ProtocolError):
        decode_cbor(data, Limits())


def test_nesting_is_bounded() -> None:
    with pytest.raises(ProtocolError):
        decode_cbor(b"\x81" * 100_000 + b"\x01", Limits())
    with pytest.raises(ProtocolError):
        decode_cbor(b"\x81" * 65 + b"\x01", Limits())
    assert decode_cbor(b"\x81" * 3 + b"\x01", Limits()) == [[[1]]]
