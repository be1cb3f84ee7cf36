"""Definitions of types: what they contain, and that an evil one is refused at once."""

from __future__ import annotations

from typing import Any

import pytest
from harness.recorded import ROS1, ROS2, definition

from robot_health_monitor.core.messages.definitions import MOST_FIELDS, SEQUENCE, Field, parse_definition
from robot_health_monitor.core.values.names import canonical_type

SEPARATOR = "=" * 80


def fields(text: str, form: str = "msg") -> list[tuple[str, str, Any]]:
    """Returns the fields of my_robot/Load."""
    return [field[:3] for field in parse_definition("my_robot/Load", text, form)["my_robot/Load"].fields]


def test_a_msg_has_fields_arrays_defaults_and_constants() -> None:
    text = (
        "# a comment with [brackets\n"
        "std_msgs/Header header\n"
        "float64 watts 1.5  # a default\n"
        "float32[36] covariance\n"
        "uint8[] data\n"
        "string<=10[<=5] names ['a', \"b\"]\n"
        "int32 LOW=1\n"
        'string TEXT="# [[[ no comment"\n'
        "string TEXT2 = it's\n"
        "Cell[] cells\n"
        "byte b\n"
        "char c\n"
        "time stamp\n"
        f"{SEPARATOR}\nMSG: my_robot/Cell\nfloat32 volts\n"
        f"{SEPARATOR}\nMSG: std_msgs/Header\nuint32 seq\n"
    )
    assert fields(text) == [
        ("header", "std_msgs/Header", None),
        ("watts", "float64", None),
        ("covariance", "float32", 36),
        ("data", "uint8", SEQUENCE),
        ("names", "string", SEQUENCE),
        ("cells", "my_robot/Cell", SEQUENCE),
        ("b", "uint8", None),
        ("c", "uint8", None),
        ("stamp", "builtin_interfaces/Time", None),
    ]


def test_a_type_without_a_package_may_be_of_another_one() -> None:
    text = f"Header header\n{SEPARATOR}\nMSG: std_msgs/Header\nuint32 seq\n"
    assert fields(text) == [("header", "std_msgs/Header", None)]


def test_an_idl_has_modules_typedefs_enums_constants_and_annotations() -> None:
    text = """
        #include "my_robot/msg/Cell.idl"
        module my_robot {  // a comment {
          module msg {
            /* another } comment */
            module Load_Constants { const long MOST = 5; const string TEXT = "[[[ } ;"; };
            typedef double double__9[9];
            enum Kind { ONE, @default_literal TWO };
            @verbatim (language="comment", text="a } \\" text" "and (more")
            struct Load {
              @unit(value="W") @default (value=(1.5))
              double watts;
              double__9 k;
              my_robot::msg::Cell cell;
              ::other::msg::Thing thing;
              sequence<Cell, 3> cells;
              sequence<octet> data;
              string<255> name;
              unsigned long long big, bigger;
              long bounded[Load_Constants::MOST];
              Kind kind;
            };
          };
        };
    """
    assert fields(text, "idl") == [
        ("watts", "float64", None),
        ("k", "float64", 9),
        ("cell", "my_robot/Cell", None),
        ("thing", "other/Thing", None),
        ("cells", "my_robot/Cell", SEQUENCE),
        ("data", "uint8", SEQUENCE),
        ("name", "string", None),
        ("big", "uint64", None),
        ("bigger", "uint64", None),
        ("bounded", "int32", 5),
        ("kind", "uint32", None),
    ]


@pytest.mark.parametrize("store", [ROS1, ROS2], ids=["ros1", "ros2"])
def test_every_standard_type_is_as_rosbags_parses_it(store: Any) -> None:
    known: dict[str, Any] = getattr(store, "fielddefs", None) or store.FIELDDEFS
    aliases = {"byte": "uint8", "char": "uint8", "octet": "uint8"}
    for name in known:
        parsed = parse_definition(name.replace("/msg/", "/"), definition(store, name), "msg")
        found = parsed[name.replace("/msg/", "/")].fields
        expected = []
        for field, (kind, what) in known[name][1]:
            size = None
            if int(kind) in (3, 4):
                (_, what), bound = what
                size = bound if int(kind) == 3 else SEQUENCE
            plain = what[0] if isinstance(what, tuple) else what.replace("/msg/", "/")
            if field != "structure_needs_at_least_one_member":
                expected.append(Field(field.rstrip("_"), aliases.get(plain, plain), size))
        assert [each._replace(name=each.name.rstrip("_")) for each in found] == expected, name


ATTACKS = {
    "nested parentheses": (
        "idl",
        "module a { const long X = " + "(" * 400 + "1" + ")" * 400 + "; struct S { long x; }; };",
    ),
    "a large shift": ("idl", "module a { const long X = 1<<8000000000; struct S { long x[X]; }; };"),
    "a tower of products": (
        "idl",
        "module a { const long A = 99999999; "
        + " ".join(f"const long A{n + 1} = A{n or ''} * A{n or ''};" for n in range(60))
        + " struct S { long x[A60]; }; };",
    ),
    "nested sequences": ("idl", "module a { struct S { " + "sequence<" * 300 + "long" + ">" * 300 + " x; }; };"),
    "a declaration of many words": ("idl", "module a { struct S { " + "a " * 400_000 + "$; }; };"),
    "a constant without a value": ("idl", "module a { module S_Constants { const long X; }; struct T { long x; }; };"),
    "a field without its end": ("idl", "module a { struct T { long x }; };"),
    "a struct in a struct": ("idl", "module a { struct T { struct U { long x; }; }; };"),
    "two dimensions": ("idl", "module a { typedef long pair[2]; struct T { pair x[2]; }; };"),
    "nested annotations": ("idl", "@a(" + "(" * 100_000),
    "nested modules": ("idl", "module a {" * 50_000),
    "a struct without an end": ("idl", "module a { struct T {" + "long x;" * 140_000),
    "a struct of nothing": ("idl", "module a { struct T {" + ";" * 900_000),
    "a constant of many words": ("idl", "module a { const " + "a " * 400_000 + ";"),
    "a constant of many spaces": ("idl", "module a { const a" + " " * 900_000 + ";"),
    "a long size": ("idl", f"module a {{ const long X = {'9' * 900_000}; struct T {{ long x[X]; }}; }};"),
    "a size that is no number": ("idl", 'module a { const string X = "3"; struct T { long x[X]; }; };'),
    "many names": ("idl", "module a { struct T { long x" + ",x" * 400_000 + "$; }; };"),
    "an endless comment": ("idl", "/*" * 500_000),
    "an endless text": ("idl", '"' + "\\" * 500_000),
    "a default over many lines": ("msg", "float32[] x [\n" + "[\n" * 400),
    "a long number": ("msg", "float32[" + "9" * 900_000 + "] x"),
    "a huge array": ("msg", "float32[9999999999] x"),
    "many fields": ("msg", "".join(f"int8 f{number}\n" for number in range(60_000))),
    "a long name": ("msg", f"{'a' * 900_000} x"),
    "a long type name": ("idl", f"module a {{ struct {'a' * 900_000} {{ long x; }}; }};"),
    "much text": ("msg", "# comment\n" * 200_000),
    "many spaces": ("msg", "int8" + " " * 900_000 + "$"),
}


@pytest.mark.parametrize("name", ATTACKS)
def test_an_evil_definition_is_refused_with_one_short_line(name: str) -> None:
    """Without the bounds each of these takes hours, or all memory."""
    form, text = ATTACKS[name]
    with pytest.raises(ValueError) as raised:  # the text is checked below
        parse_definition("a/T", text, form)
    assert len(str(raised.value)) < 400
    assert "\n" not in str(raised.value)


def test_defaults_are_not_parsed() -> None:
    assert fields("float32[] x " + "[1," * 400) == [("x", "float32", SEQUENCE)]


def test_the_largest_definitions_are_parsed() -> None:
    text = "".join(f"float64[36] field_{number}\n" for number in range(MOST_FIELDS))
    assert len(parse_definition("a/T", text, "msg")["a/T"].fields) == MOST_FIELDS


@pytest.mark.parametrize("folder", ["", "msg/", "srv/", "action/"])
def test_all_spellings_of_a_type_are_the_same_type(folder: str) -> None:
    assert canonical_type(f"std_msgs/{folder}Float32") == "std_msgs/Float32"


@pytest.mark.parametrize("text", ["", "Float32", "/", "a/b/c", "a/msg/b/c", "a/msg/"])
def test_what_is_no_type_stays_as_it_is(text: str) -> None:
    assert canonical_type(text) == text
