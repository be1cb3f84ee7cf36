"""Whole messages from bytes: compared with rosbags, and bounded whatever the bytes say."""

from __future__ import annotations

import random
import struct
from typing import Any, Dict, Tuple

import numpy as np
import pytest
from harness.recorded import ROS1, ROS2, definition, fields_of, random_message, serialized

from robot_health_monitor.core.definitions import SEQUENCE, Definition, Field, parse_definition
from robot_health_monitor.recordings.deserialization import Deserializer


def same(found: Any, expected: Any, store: Any) -> bool:
    """Returns whether a message has the values of one of rosbags."""
    if hasattr(expected, "__msgtype__"):
        names = [name for name, _ in fields_of(store, expected.__msgtype__)]
        names = [name for name in names if name != "structure_needs_at_least_one_member"]
        return all(same(getattr(found, name), getattr(expected, name), store) for name in names)
    if isinstance(expected, list):
        return len(found) == len(expected) and all(same(*pair, store) for pair in zip(found, expected))
    if isinstance(expected, np.ndarray):
        return bool(np.array_equal(np.asarray(found).view(expected.dtype), expected))
    return bool(found == expected)


@pytest.mark.parametrize("encoding", ["ros1", "cdr"])
def test_every_standard_message_is_read_as_it_was_serialized(encoding: str) -> None:
    store = ROS1 if encoding == "ros1" else ROS2
    chance = random.Random(3)
    names = sorted(getattr(store, "fielddefs", None) or store.FIELDDEFS)
    for name in names:
        own = name.replace("/msg/", "/")
        types = parse_definition(own, definition(store, name), "msg", "int8" if encoding == "ros1" else "uint8")
        get = Deserializer(types, encoding == "cdr").bind(own)
        for _ in range(3):
            message = random_message(chance, store, name)
            assert same(get(serialized(message, encoding)), message, store), name


def reader(fields: Dict[str, Tuple[Field, ...]], is_cdr: bool = False) -> Any:
    return Deserializer({name: Definition(each) for name, each in fields.items()}, is_cdr).bind("a/T")


def test_big_endian_arrays_are_read() -> None:
    get = reader({"a/T": (Field("x", "float64", SEQUENCE), Field("y", "int16", 2))}, is_cdr=True)
    message = get(b"\0\0\0\0" + struct.pack(">I4xdhh", 1, 2.5, -3, 4))
    assert (message.x.tolist(), message.y.tolist()) == ([2.5], [-3, 4])


@pytest.mark.parametrize(
    ("fields", "data"),
    [
        ((Field("x", "string", None),), struct.pack("<i", -5)),
        ((Field("x", "string", SEQUENCE),), struct.pack("<ii", 2**31 - 1, -4)),
        ((Field("x", "float64", SEQUENCE),), struct.pack("<i", -1)),
        ((Field("x", "a/E", SEQUENCE),), struct.pack("<I", 2**32 - 1) + bytes(1000)),
        ((Field("x", "a/E", 2**31),), bytes(1000)),
        ((Field("x", "uint8", 10**9),), bytes(1000)),
    ],
    ids=["string", "strings", "numbers", "messages", "fixed messages", "fixed numbers"],
)
@pytest.mark.parametrize("is_cdr", [False, True], ids=["ros1", "cdr"])
def test_a_length_beyond_the_message_is_refused_at_once(fields: Any, data: bytes, is_cdr: bool) -> None:
    """Lengths that are read as signed would go back, and read the same bytes again and again."""
    get = reader({"a/T": fields, "a/E": (Field("y", "uint8", None),)}, is_cdr)
    with pytest.raises(ValueError, match=r"too short|expected"):
        get(b"\0\1\0\0" * is_cdr + data)


def test_more_elements_than_fit_into_memory_are_refused() -> None:
    get = reader({"a/T": (Field("x", "a/E", SEQUENCE),), "a/E": (Field("y", "uint8", None),)})
    assert len(get(struct.pack("<I", 400_000) + bytes(400_000)).x) == 400_000
    with pytest.raises(ValueError, match="expected at most 500000"):
        get(struct.pack("<I", 600_000) + bytes(600_000))


def nested(size: Any, leaf: Tuple[Field, ...]) -> Dict[str, Tuple[Field, ...]]:
    """Returns types in eight levels."""
    types = {f"a/L{level}": (Field("x", f"a/L{level + 1}", size),) for level in range(8)}
    return {"a/T": (Field("x", "a/L0", size),), **types, "a/L8": leaf}


@pytest.mark.parametrize("leaf", [(), (Field("x", "uint8", 0),)], ids=["empty", "array of size 0"])
@pytest.mark.parametrize("size", [100, SEQUENCE])
def test_arrays_of_empty_elements_are_refused(leaf: Any, size: int) -> None:
    """100 to the power of 8 elements that take no bytes."""
    with pytest.raises(ValueError, match="array of empty values"):
        reader(nested(size, leaf))


def test_many_empty_fields_of_many_empty_fields_are_refused() -> None:
    fields = {name: tuple(Field(f"f{n}", inner, None) for n in range(100)) for name, inner in ("Ta", "ab", "bc")}
    types = {f"a/{name}": tuple(each._replace(kind=f"a/{each.kind}") for each in row) for name, row in fields.items()}
    with pytest.raises(ValueError, match="nearly all of them empty"):
        reader({**types, "a/c": ()})


def test_a_type_that_contains_itself_or_an_unknown_one_is_refused() -> None:
    with pytest.raises(ValueError, match="a/T contains itself"):
        reader({"a/T": (Field("x", "a/T", SEQUENCE),)})
    with pytest.raises(ValueError, match="the definition of a/E is missing"):
        reader({"a/T": (Field("x", "a/E", None),)})
    with pytest.raises(ValueError, match="the definition of wstring is missing"):
        reader({"a/T": (Field("x", "wstring", None),)})


def test_text_that_is_not_utf8_is_readable_still() -> None:
    get = reader({"a/T": (Field("x", "string", None), Field("y", "uint8", None))})
    message = get(struct.pack("<I2sB", 2, b"\xff!", 7))
    assert (message.x, message.y) == ("\ufffd!", 7)


@pytest.mark.parametrize("data", [struct.pack("<BB", 1, 2), b""], ids=["longer", "shorter"])
def test_a_message_of_another_length_is_refused(data: bytes) -> None:
    with pytest.raises(ValueError, match=r"bytes|too short"):
        reader({"a/T": (Field("x", "uint8", None),)})(data)
