"""Parameters: one table that validates, with errors that say where, what was found and what is allowed."""

from __future__ import annotations

import datetime
import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_health_monitor.core.config.parameters import Parameter, flatten, unflatten
from robot_health_monitor.core.config.schema import read_parameters, require_mapping
from robot_health_monitor.core.values.errors import ConfigError
from robot_health_monitor.core.values.formatting import describe

NUMBER = Parameter("n", float, 1.0, "a number")
POSITIVE = Parameter("p", float, 1.0, "a number", 0.0)
BETWEEN = Parameter("b", float, 1.0, "a number", 0.0, 100.0)
AT_MOST = Parameter("m", float, 1.0, "a number", None, 7.5)
WHOLE = Parameter("w", int, 1, "a count", 1, 1000)
FLAG = Parameter("f", bool, False, "a switch")
TEXT = Parameter("t", str, "", "a name")
CHOICE = Parameter("c", str, "mean", "a method", choices=("mean", "score"))
OPTIONAL_CHOICE = Parameter("method", str, "", "a text", choices=("", "mean", "score"))
LIST = Parameter("l", list, (), "numbers")
TEXTS = Parameter("i", tuple, ("battery_level",), "names")


@pytest.mark.parametrize(
    ("parameter", "found", "value"),
    [
        (NUMBER, 20, 20.0),  # YAML's 20 for a bound
        (NUMBER, -0.5, -0.5),
        (POSITIVE, 0.0, 0.0),
        (BETWEEN, 100.0, 100.0),
        (WHOLE, 60, 60),
        (WHOLE, 60.0, 60),  # a middleware that knows doubles only
        (FLAG, True, True),
        (TEXT, "rad/s", "rad/s"),
        (TEXT, "°C", "°C"),
        (CHOICE, "score", "score"),
        (LIST, [-0.01, 0], (-0.01, 0.0)),
        (LIST, (), ()),
        (TEXTS, ["battery_level", "cpu_usage"], ("battery_level", "cpu_usage")),
        (TEXTS, [], ()),
    ],
)
def test_what_is_allowed_is_taken_as_its_kind(parameter: Parameter, found: object, value: object) -> None:
    read = parameter.read(found)
    assert (read, type(read)) == (value, type(value))


@pytest.mark.parametrize(
    ("parameter", "found", "problem"),
    [
        (NUMBER, "twenty", "expected a number, got 'twenty'"),
        (NUMBER, "20", "expected a number, got '20'; YAML reads this as text, write 20.0"),
        (NUMBER, "1e3", "expected a number, got '1e3'; YAML reads this as text, write 1000.0"),
        (NUMBER, "1e400", "expected a number, got '1e400'"),  # infinite, which is not allowed either
        (NUMBER, "nan", "expected a number, got 'nan'"),
        (NUMBER, True, "expected a number, got true"),
        (NUMBER, None, "expected a number, got nothing"),
        (NUMBER, [20.0], "expected a number, got [20.0]"),
        (NUMBER, {"a": 1}, "expected a number, got a mapping"),
        (NUMBER, datetime.date(2020, 1, 31), "expected a number, got the date 2020-01-31"),
        (NUMBER, math.nan, "expected a number, got nan"),
        (NUMBER, math.inf, "expected a number, got inf"),
        (NUMBER, 10**400, "expected a number, got 1" + "0" * 56 + "..."),
        pytest.param(NUMBER, 2**20_000, "expected a number, got a number of 20001 bits", id="huge"),
        (POSITIVE, -1, "expected a number of at least 0, got -1"),
        (BETWEEN, 100.5, "expected a number from 0 to 100, got 100.5"),
        (AT_MOST, 8, "expected a number of at most 7.5, got 8"),
        (WHOLE, 1.5, "expected a whole number from 1 to 1000, got 1.5"),
        (WHOLE, 0, "expected a whole number from 1 to 1000, got 0"),
        (FLAG, 1, "expected true or false, got 1"),
        (FLAG, "yes", "expected true or false, got 'yes'"),
        (TEXT, 5, "expected printable text, got 5; quote it"),
        (TEXT, False, "expected printable text, got false; quote it"),
        (TEXT, datetime.date(2020, 1, 31), "expected printable text, got the date 2020-01-31; quote it"),
        (TEXT, "a\nb", "expected printable text, got 'a\\nb'"),
        (TEXT, "\ud800", "expected printable text, got '\\ud800'"),
        (CHOICE, "median", "expected one of mean, score, got 'median'"),
        (OPTIONAL_CHOICE, "median", "expected one of nothing, mean, score, got 'median'"),
        (LIST, -0.01, "expected a list of numbers, got -0.01"),
        (LIST, "12", "expected a list of numbers, got '12'"),
        (LIST, [1.0, "x"], "expected a list of numbers, got [1.0, 'x']"),
        (LIST, [math.nan], "expected a list of numbers, got [nan]"),
        (TEXTS, "battery_level", "expected a list of texts, got 'battery_level'"),
        (TEXTS, ["battery_level", 1], "expected a list of texts, got ['battery_level', 1]"),
        (TEXTS, {"battery_level": 1}, "expected a list of texts, got a mapping"),
    ],
)
def test_invalid_values_are_refused_with_the_value(parameter: Parameter, found: object, problem: str) -> None:
    with pytest.raises(ConfigError) as raised:
        parameter.read(found, ("signals", "a", parameter.name))
    assert str(raised.value) == f"signals.a.{parameter.name}: {problem}"


def test_what_is_left_out_has_its_default() -> None:
    assert read_parameters({"n": 3}, (NUMBER, FLAG)) == {"n": 3.0, "f": False}


def test_an_unknown_key_is_refused_with_a_hint_and_the_known_keys() -> None:
    with pytest.raises(ConfigError) as raised:
        read_parameters({"warn_bellow": 1}, (Parameter("warn_below", float, None, ""), FLAG), ("a",), ("signals",))
    problem = "unknown key; did you mean warn_below?"
    assert str(raised.value) == f"a.warn_bellow: {problem}"


def test_an_unknown_key_that_resembles_none_gets_no_hint() -> None:
    with pytest.raises(ConfigError) as raised:
        read_parameters({"xyz": 1}, (Parameter("warn_below", float, None, ""),))
    assert str(raised.value) == "xyz: unknown key; expected one of warn_below"


def test_all_mistakes_of_a_level_are_reported_in_the_order_of_the_configuration() -> None:
    with pytest.raises(ConfigError) as raised:
        read_parameters({"w": 0, "x": 1, "f": True, "n": "low"}, (NUMBER, WHOLE, FLAG))
    assert [str(error) for error in raised.value.all] == [
        "w: expected a whole number from 1 to 1000, got 0",
        "x: unknown key; expected one of n, w, f",
        "n: expected a number, got 'low'",
    ]


def test_sections_are_left_to_the_caller() -> None:
    assert read_parameters({"signals": 5}, (FLAG,), sections=("signals",)) == {"f": False}


@pytest.mark.parametrize(
    ("found", "problem"),
    [
        (None, "expected a mapping of keys to values, got nothing"),
        ([1], "expected a mapping of keys to values, got [1]"),
        ({1: 2}, "1: expected text as a key, got 1; quote it"),
        ({True: 2}, "true: expected text as a key, got true; quote it"),
    ],
)
def test_a_mapping_of_texts_is_required(found: object, problem: str) -> None:
    with pytest.raises(ConfigError) as raised:
        require_mapping(found)
    assert str(raised.value) == problem


def test_descriptions_are_shortened_to_sixty_characters() -> None:
    assert describe("x" * 100) == "'" + "x" * 27 + "..." + "x" * 28 + "'"
    assert len(describe("x" * 100)) == 60


def test_describing_a_value_does_not_visit_a_billion_elements() -> None:
    bomb: Any = ["x"]
    for _ in range(60):
        bomb = [bomb] * 10
    assert describe(bomb) == "[[[[...], [...], [...], [...], [...], [...], ...], [[...]..."
    assert len(describe(["x" * 10**6] * 10**6)) == 60


def test_flatten_names_leaves_as_ros2_does() -> None:
    tree = {"publish_rate": 1.0, "signals": {"a": {"warn_below": 20.0, "placeholders": [0.0]}}}
    assert list(flatten(tree)) == [
        ("publish_rate", 1.0),
        ("signals.a.warn_below", 20.0),
        ("signals.a.placeholders", [0.0]),
    ]


names = st.sampled_from(("a", "b", "a_b", "c"))
trees = st.dictionaries(
    names,
    st.recursive(st.integers(), lambda below: st.dictionaries(names, below, min_size=1, max_size=3), max_leaves=8),
    max_size=3,
)


@given(trees)
def test_unflatten_is_the_inverse_of_flatten(tree: dict[str, Any]) -> None:
    assert unflatten(dict(flatten(tree))) == tree


@pytest.mark.parametrize("values", [{"a": 1, "a.b": 2}, {"a.b": 2, "a": 1}, {"a.b": 1, "a.b.c": 2}])
def test_a_name_that_is_a_value_and_a_parent_is_refused(values: dict[str, int]) -> None:
    with pytest.raises(ConfigError):
        unflatten(values)


def test_a_message_names_only_the_first_of_many_choices() -> None:
    many = Parameter("source", str, None, "metric", choices=tuple(f"metric_{number}" for number in range(13)))
    expected = ", ".join(f"metric_{number}" for number in range(12))
    with pytest.raises(ConfigError, match=f"^source: expected one of {expected}, ..., got 'fan'$"):
        many.read("fan", ("source",))
