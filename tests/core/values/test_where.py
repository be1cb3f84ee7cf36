"""`where`: what is a condition, what holds, and that messages of every encoding give what a second evaluator gives."""

from __future__ import annotations

import math
import random
import re
import struct
from typing import Any, Mapping

import pytest

from robot_health_monitor.core.messages.mapping_field import MappingField
from robot_health_monitor.core.messages.raw_messages import ros1_format, ros2_format
from robot_health_monitor.core.messages.serialized import SerializedType, json_getter
from robot_health_monitor.core.values.field_path import ABSENT
from robot_health_monitor.core.values.where import Comparison, parse_where, selected, selection


def test_a_condition_is_split_into_its_comparisons() -> None:
    where = (
        r'level >= ERROR and name == "*contr\"ol?er*" and a.b[0]!=-3.5e1 and status["x and y"].level < 2 and on == true'
    )
    assert parse_where(where) == [
        Comparison("level", ">=", None, "ERROR", ""),
        Comparison("name", "==", None, "", '*contr"ol?er*'),
        Comparison("a.b[0]", "!=", -35.0, "", ""),
        Comparison('status["x and y"].level', "<", 2, "", ""),
        Comparison("on", "==", 1, "", ""),
    ]


EXAMPLE = 'expected comparisons such as level >= ERROR and name == "*arm*", got '


@pytest.mark.parametrize(
    ("where", "problem"),
    [
        ("", EXAMPLE + "''"),
        ("  ", EXAMPLE + "''"),
        ("level", EXAMPLE + "'level'"),
        ("level >=", EXAMPLE + "'level >='"),
        ("level = 3", EXAMPLE + "'level = 3'"),
        ("level => 3", EXAMPLE + "'level => 3'"),
        ('name == "motor', EXAMPLE + "'name == \"motor'"),
        (r'name == "motor\"', EXAMPLE + "'name == \"motor\\\\\"'"),
        ("level == 3.x", EXAMPLE + "'level == 3.x'"),
        ("3 <= level", EXAMPLE + "'3 <= level'"),
        ("level >= 3 and", EXAMPLE + "'level >= 3 and'"),
        ("level >= 3 or x == 1", EXAMPLE + "'level >= 3 or x == 1'"),
        ("level >= 3 x == 1", EXAMPLE + "'level >= 3 x == 1'"),
        ("level >= 3 and x", EXAMPLE + "'x'"),
        ("level >= 1e999", EXAMPLE + "'level >= 1e999'"),
        ("level >= " + "9" * 5000, EXAMPLE + "'level >= " + "9" * 18 + "..." + "9" * 28 + "'"),
        ('name < "motor"', EXAMPLE + "'name < \"motor\"'"),
        ("cells[*] > 3", EXAMPLE + "'cells[*] > 3'"),
        ('status["*"].level > 3', EXAMPLE + "'status[\"*\"].level > 3'"),
        ("[0] > 3", 'a path starts with the name of a field, or with the name of the message as in ["motor"]'),
    ],
)
def test_what_is_no_condition_is_refused(where: str, problem: str) -> None:
    with pytest.raises(ValueError) as caught:
        parse_where(where)
    assert str(caught.value) == problem


@pytest.mark.parametrize(
    ("where", "value", "holds"),
    [
        ("x == 1", True, True),
        ("x == 0", False, True),
        ("x > 0", math.nan, False),
        ("x == 0", math.nan, False),
        ("x != 0", math.nan, True),
        ("x == 0", "0", False),
        ("x >= 0", "0", False),
        ("x != 0", "0", True),
        ('x == "1"', 1, False),
        ('x != "1"', 1, True),
        ('x == "motor"', "motor", True),
        ('x == "Motor"', "motor", False),
        ('x == "m?t*"', "motor", True),
        ('x != "m?t*"', "motor", False),
        ("x == 0.1", 0.10000000149011612, True),
        ("x <= 0.1", 0.10000000149011612, True),
        ("x != 0.1", 0.10000000149011612, False),
        ("x == 10000001", 10000002, False),
        ("x == 18446744073709551615", 2**64 - 1, True),
        ("x == 18446744073709551614", 2**64 - 1, False),
        ("x <= 3", 3, True),
        ("x < 3", 3, False),
        ("x >= 3", 3, True),
        ("x > 3", 3, False),
        ("x != 3", None, False),  # beyond the end of an array
        ("x != 3", ABSENT, False),
        ('x == "*b*"', "a" * 20_000_000, False),
        ('x == "*b"', "a" * 9_999 + "b", True),
        ('x == "*b"', "a" * 9_999 + "bc", True),  # only so many characters are compared
    ],
)
def test_what_holds(where: str, value: object, holds: bool) -> None:
    (comparison,) = parse_where(where)
    assert comparison.holds(value, comparison.number or 0) is holds


def test_a_path_and_its_condition_are_one_text_for_the_port() -> None:
    assert selection("data", "") == "data"
    assert selection("", "") is None
    key = 'status["a where b"].level'
    for path in ("data", "", key):
        bound: list[str] = []

        def bind(one: str, bound: list[str] = bound) -> Any:
            bound.append(one)
            return lambda message: message[one]

        read = selected("/a", "", selection(path, "x == 1") or "", bind, lambda *_: lambda message: 0.0)
        assert bound == ([path] if path else []) + ["x"]
        assert read({"x": 2.0, path: 5.0}) is ABSENT
        assert read({"x": 1.0, path: 5.0}) == (5.0 if path else 1.0)
    assert selected("/a", "", key, lambda path: lambda message: path, lambda *_: lambda message: 0.0)({}) == key


DEFINITION = (
    "uint8 LOW=1\nint8 HIGH=8\nstring NAME=motor\nuint8 level\nstring name\nfloat64 value\nbool flag\nInner inner\n"
    "float64[] list\n" + "=" * 80 + "\nMSG: my_robot/Inner\nint32 FAR=-3\nint32 x\n"
)
TYPE = "my_robot/State"


def cdr(message: Mapping[str, Any]) -> bytes:
    data = b""

    def put(layout: str, value: object) -> None:
        nonlocal data
        data += bytes(-len(data) % struct.calcsize(layout)) + struct.pack(f"<{layout}", value)

    put("B", message["level"])
    text = message["name"].encode() + b"\0"
    put("I", len(text))
    data += text
    put("d", message["value"])
    put("B", message["flag"])
    put("i", message["inner"]["x"])
    put("I", len(message["list"]))
    for number in message["list"]:
        put("d", number)
    return b"\0\1\0\0" + data


def ros1(message: Mapping[str, Any]) -> bytes:
    name, numbers = message["name"].encode(), message["list"]
    return struct.pack(
        f"<BI{len(name)}sdBiI{len(numbers)}d",
        message["level"], len(name), name, message["value"], message["flag"], message["inner"]["x"], len(numbers),
        *numbers,
    )  # fmt: skip


CONSTANTS = {"level": {"LOW": 1, "HIGH": 8}, "inner.x": {"FAR": -3, "HIGH": 8}}


def referee(where: str, message: Mapping[str, Any]) -> bool:
    """Evaluates a condition as SEMANTICS says, with nothing of the package."""
    pieces: list[str] = [""]
    quoted = False
    for at, letter in enumerate(where):  # splits at " and " outside of quotes
        if letter == '"' and where[at - 1] != "\\":
            quoted = not quoted
        pieces[-1] += letter
        if not quoted and pieces[-1].endswith(" and "):
            pieces[-1] = pieces[-1][: -len(" and ")]
            pieces.append("")
    return all(_referee_one(piece, message) for piece in pieces)


def _referee_one(piece: str, message: Mapping[str, Any]) -> bool:
    path, sign, right = piece.split(" ", 2)
    if path.startswith("list["):
        at = int(path[5:-1])
        if at >= len(message["list"]):
            return False
        left: Any = message["list"][at]
    else:
        left = message
        for name in path.split("."):
            left = left[name]
    if right.startswith('"'):
        pattern = right[1:-1].replace('\\"', '"')
        letters = (".*" if letter == "*" else "." if letter == "?" else re.escape(letter) for letter in pattern)
        matches = isinstance(left, str) and re.fullmatch("".join(letters), left, re.DOTALL) is not None
        return matches if sign == "==" else not matches
    if isinstance(left, str) or math.isnan(left):
        return sign == "!="
    number = CONSTANTS[path][right] if right.isalpha() else float(right)
    return {
        "==": left == number, "!=": left != number, "<": left < number, "<=": left <= number, ">": left > number,
        ">=": left >= number,
    }[sign]  # fmt: skip


def _random_comparison(rng: random.Random) -> str:
    path = rng.choice(["level", "name", "value", "flag", "inner.x", "list[0]", "list[2]"])
    if rng.random() < 0.3:
        text = rng.choice(["motor", "m*", "*", "?otor", 'a\\"b', "x and y", ""])
        return f'{path} {rng.choice(["==", "!="])} "{text}"'
    numbers = ["0", "1", "8", "-3", "2.5", "1e1"]
    number = rng.choice([*numbers, *CONSTANTS.get(path, {})])
    return f"{path} {rng.choice(['==', '!=', '<', '<=', '>', '>='])} {number}"


def _random_message(rng: random.Random) -> dict[str, Any]:
    numbers = [0.0, 1.0, 2.5, 8.0, 10.0, -3.0, math.nan]
    return {
        "level": rng.choice([0, 1, 8, 200]),
        "name": rng.choice(["motor", "rotor", 'a"b', "x and y", ""]),
        "value": rng.choice(numbers),
        "flag": rng.random() < 0.5,
        "inner": {"x": rng.choice([-3, 0, 1, 8])},
        "list": [rng.choice(numbers) for _ in range(rng.randrange(4))],
    }


def test_messages_of_every_encoding_match_as_a_second_evaluator_says() -> None:
    rng = random.Random(33)
    types = [SerializedType("/a", make(TYPE, DEFINITION)) for make in (ros2_format, ros1_format)]
    matched = 0
    for _ in range(400):
        where = " and ".join(_random_comparison(rng) for _ in range(rng.choice([1, 1, 2, 3])))
        field = selection(rng.choice(["inner.x", ""]), where) or ""
        getters: list[tuple[Any, Any]] = [
            (types[0].field_getter(field), cdr),
            (types[1].field_getter(field), ros1),
        ]
        if not re.search(r"(LOW|HIGH|FAR)", where):  # JSON brings no definition
            getters.append((MappingField("/a", TYPE, field).read, dict))
        for _ in range(5):
            message = _random_message(rng)
            expected: Any = ABSENT
            if referee(where, message):
                expected = float(message["inner"]["x"]) if field.startswith("inner.x") else 1.0
                matched += 1
            assert [get(encode(message)) for get, encode in getters] == [expected] * len(getters), (where, message)
    assert 300 < matched < 1700


def test_a_null_of_json_is_not_a_number() -> None:
    assert math.isnan(json_getter("/a", "", "data where data != 3")(b'{"data": null}'))
    assert json_getter("/a", "", "level where data == 3")(b'{"data": null, "level": 2}') is ABSENT
