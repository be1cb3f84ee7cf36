"""Field paths: valid ones, invalid ones, and keyed steps."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_health_monitor.core.values.elements import BadDatum
from robot_health_monitor.core.values.errors import ConfigError
from robot_health_monitor.core.values.field_path import (
    ABSENT,
    Every,
    Keyed,
    element_path,
    every_step,
    key_field,
    mapping_getter,
    number_of_text,
    parse_field_path,
)


@pytest.mark.parametrize(
    ("path", "steps"),
    [
        ("", ()),
        ("data", ("data",)),
        ("pose.position.z", ("pose", "position", "z")),
        ("cell_voltage[0]", ("cell_voltage", 0)),
        ("status[3].level", ("status", 3, "level")),
        ("cells[2][1]", ("cells", 2, 1)),
        ('status["motor: left"].level', ("status", Keyed("motor: left"), "level")),
        ("status['motor: left'].level", ("status", Keyed("motor: left"), "level")),
        ('values["T (C)"]', ("values", Keyed("T (C)"))),
        ('status["a"].values["b"]', ("status", Keyed("a"), "values", Keyed("b"))),
        ('status["it\'s"].level', ("status", Keyed("it's"), "level")),
        ('status["a[0].b"].level', ("status", Keyed("a[0].b"), "level")),
        ('status["Motor ä"].level', ("status", Keyed("Motor ä"), "level")),
        ('status[""].level', ("status", Keyed(""), "level")),
        ("_private2", ("_private2",)),
        ("cell_voltage[*]", ("cell_voltage", Every())),
        ("status[*].level", ("status", Every(), "level")),
        ('effort["*"]', ("effort", Every("*"))),
        ('effort["wheel_?"]', ("effort", Every("wheel_?"))),
        ("status['lidar: *'].level", ("status", Every("lidar: *"), "level")),
    ],
)
def test_a_path_is_split_into_names_indices_and_keys(path: str, steps: object) -> None:
    assert parse_field_path(path) == steps


@pytest.mark.parametrize(
    ("path", "rest"),
    [
        (".data", "'.data'"),
        ("data.", "'.'"),
        ("a..b", "'..b'"),
        ("a b", "' b'"),
        ("cells[-1]", "'[-1]'"),
        ("cells[1", "'[1'"),
        ("cells[]", "'[]'"),
        ("cells[x]", "'[x]'"),
        ('status["a]', "'[\"a]'"),
        ("status[\"a']", "'[\"a\\']'"),
        ("a[0]b", "'b'"),
        ("cells.[0]", "'.[0]'"),
        ("2nd", "'2nd'"),
        ("größe", "'öße'"),
    ],
)
def test_a_text_that_is_not_a_path_is_rejected_with_the_part_that_is_wrong(path: str, rest: str) -> None:
    with pytest.raises(ValueError) as caught:
        parse_field_path(path)
    assert str(caught.value) == f'{rest} is not a name, an index such as [0] or a key such as ["motor"]'


@pytest.mark.parametrize("path", ["[0]", "[*]", "[0].data"])
def test_a_path_does_not_begin_with_an_index(path: str) -> None:
    with pytest.raises(ValueError) as caught:
        parse_field_path(path)
    assert str(caught.value) == (
        'a path starts with the name of a field, or with the name of the message as in ["motor"]'
    )


def test_only_one_part_of_a_path_selects_several_elements() -> None:
    with pytest.raises(ValueError, match=r"^only one part of a path may select several elements$"):
        parse_field_path('status["*"].values[*]')


@pytest.mark.parametrize(
    ("path", "name", "expected"),
    [
        ("cell_voltage[*]", "7", "cell_voltage[7]"),
        ("status[0].values[*].value", "7", "status[0].values[7].value"),
        ('effort["*"]', "wheel_left", 'effort["wheel_left"]'),
        ("effort['wheel_*']", "wheel_left", 'effort["wheel_left"]'),
        ('effort["*"]', 'a "big" arm', "effort['a \"big\" arm']"),
        ('status["motor"].values["*"]', "volts", 'status["motor"].values["volts"]'),
    ],
)
def test_one_of_several_elements_is_written_as_in_a_path(path: str, name: str, expected: str) -> None:
    assert element_path(path, name) == expected


@pytest.mark.parametrize("path", ["", "data", "cells[0]", 'status["motor"].level', "a..b"])
def test_a_path_to_one_value_selects_no_several_elements(path: str) -> None:
    assert every_step(path) is None


@given(st.text())
def test_any_text_is_a_path_or_a_value_error(text: str) -> None:
    try:
        steps = parse_field_path(text)
    except ValueError:
        return
    assert (steps == ()) == (text == "")


@pytest.mark.parametrize(
    ("fields", "found"),
    [
        (["level", "name", "message"], "name"),
        (["key", "value"], "key"),
        (["key", "name"], "name"),
        (["data"], None),
        ([], None),
    ],
)
def test_a_keyed_step_compares_the_name_or_else_the_key(fields: list, found: object) -> None:
    assert key_field(fields) == found


@pytest.mark.parametrize(
    ("text", "number"),
    [
        ("45.5", 45.5),
        (" 7 ", 7.0),
        ("-1e-3", -0.001),
        ("", ""),
        ("87 %", "87 %"),
        ("OK", "OK"),
        ("True", 1.0),
        ("false", 0.0),
        (3, 3),
    ],
)
def test_the_text_of_a_key_value_is_read_as_a_number_where_it_is_one(text: object, number: object) -> None:
    assert number_of_text(text) == number


def test_the_text_nan_is_not_a_number() -> None:
    assert math.isnan(number_of_text("nan"))


def test_a_text_with_underscores_is_no_number_though_python_reads_it_as_one() -> None:
    assert number_of_text("1_000") == "1_000"


BATTERY = {
    "percentage": 0.5,
    "header": {"frame_id": "base"},
    "cell_voltage": [3.5, 4.25],
    "status": [{"name": "motor", "level": 2, "values": [{"key": "T", "value": "81.0"}]}],
}


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("", BATTERY),
        ("percentage", 0.5),
        ("header.frame_id", "base"),
        ("cell_voltage[1]", 4.25),
        ("cell_voltage[2]", None),
        ('status["motor"].level', 2),
        ('status["motor"].values["T"]', 81.0),
        ('status["motor"].values["T"].value', "81.0"),
        ('status["wheel"].level', ABSENT),
    ],
)
def test_a_getter_reads_its_path_from_a_mapping(field: str, value: object) -> None:
    assert mapping_getter(field)(BATTERY) == value


@pytest.mark.parametrize("field", ["voltage", "header.stamp", "percentage.data"])
def test_a_getter_raises_for_a_field_that_is_missing(field: str) -> None:
    with pytest.raises((KeyError, TypeError)):
        mapping_getter(field)(BATTERY)


def test_a_getter_of_a_text_that_is_not_a_path_is_a_configuration_error() -> None:
    with pytest.raises(ConfigError, match=r"^field 'cells\[x\]': '\[x\]' is not a name"):
        mapping_getter("cells[x]")


def test_an_error_about_a_long_path_is_short() -> None:
    with pytest.raises(ValueError, match="is not a name") as problem:
        parse_field_path("data" + "[x" * 3_000)
    assert len(str(problem.value)) < 200


@pytest.mark.parametrize("path", ["numbers[*]", 'numbers["*"]'])
def test_ten_thousand_elements_are_read_and_more_are_a_bad_datum_with_their_number(path: str) -> None:
    names = [str(number) for number in range(10_001)]
    message = {"name": names[:10_000], "numbers": [1.5] * 10_000}
    assert mapping_getter(path)(message) == [(name, 1.5) for name in names[:10_000]]
    too_many = mapping_getter(path)({"name": names, "numbers": [1.5] * 10_001})
    assert type(too_many) is BadDatum
    assert too_many == "10001 elements (limit 10000)"
