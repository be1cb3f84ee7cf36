"""Parameters: one table that validates, with errors that say where, what was found and what is allowed."""

from __future__ import annotations

import math
from typing import Any, Dict

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.core.parameters import (
    Parameter,
    describe,
    flatten,
    read_parameters,
    require_mapping,
    unflatten,
)

NUMBER = Parameter("n", float, 1.0, "a number")
POSITIVE = Parameter("p", float, 1.0, "a number", 0.0)
BETWEEN = Parameter("b", float, 1.0, "a number", 0.0, 100.0)
AT_MOST = Parameter("m", float, 1.0, "a number", None, 7.5)
WHOLE = Parameter("w", int, 1, "a count", 1, 1000)
FLAG = Parameter("f", bool, False, "a switch")
TEXT = Parameter("t", str, "", "a name")
CHOICE = Parameter("c", str, "mean", "a method", choices=("mean", "score"))
LIST = Parameter("l", list, (), "numbers")


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
    ],
)
def test_what_is_allowed_is_taken_as_its_kind(parameter: Parameter, found: object, value: object) -> None:
    read = parameter.read(found)
    assert (read, type(read)) == (value, type(value))


@pytest.mark.parametrize(
    ("parameter", "found", "problem"),
    [
        (NUMBER, "twenty", "found 'twenty', allowed is a number"),
        (NUMBER, "20", "found '20', allowed is a number; YAML takes this for a text, write 20.0"),
        (NUMBER, "1e3", "found '1e3', allowed is a number; YAML takes this for a text, write 1000.0"),
        (NUMBER, True, "found true, allowed is a number"),
        (NUMBER, None, "found nothing, allowed is a number"),
        (NUMBER, [20.0], "found [20.0], allowed is a number"),
        (NUMBER, {"a": 1}, "found a mapping, allowed is a number"),
        (NUMBER, math.nan, "found nan, allowed is a number"),
        (NUMBER, math.inf, "found inf, allowed is a number"),
        (NUMBER, 10**400, "found 1" + "0" * 56 + "..., allowed is a number"),
        (POSITIVE, -1, "found -1, allowed is a number, 0 or more"),
        (BETWEEN, 100.5, "found 100.5, allowed is a number from 0 to 100"),
        (AT_MOST, 8, "found 8, allowed is a number, 7.5 or less"),
        (WHOLE, 1.5, "found 1.5, allowed is a whole number from 1 to 1000"),
        (WHOLE, 0, "found 0, allowed is a whole number from 1 to 1000"),
        (FLAG, 1, "found 1, allowed is true or false"),
        (FLAG, "yes", "found 'yes', allowed is true or false"),
        (TEXT, 5, "found 5, allowed is a text of printable characters"),
        (TEXT, "a\nb", "found 'a\\nb', allowed is a text of printable characters"),
        (TEXT, "\ud800", "found '\\ud800', allowed is a text of printable characters"),
        (CHOICE, "median", "found 'median', allowed is one of mean, score"),
        (LIST, -0.01, "found -0.01, allowed is a list of numbers"),
        (LIST, "12", "found '12', allowed is a list of numbers"),
        (LIST, [1.0, "x"], "found [1.0, 'x'], allowed is a list of numbers"),
        (LIST, [math.nan], "found [nan], allowed is a list of numbers"),
    ],
)
def test_what_is_not_allowed_is_refused_with_what_was_found(parameter: Parameter, found: object, problem: str) -> None:
    with pytest.raises(ConfigError) as raised:
        parameter.read(found, ("signals", "a", parameter.name))
    assert str(raised.value) == f"signals.a.{parameter.name}: {problem}"


def test_an_error_is_one_line_file_line_path_problem() -> None:
    error = ConfigError("found 5, allowed is a text", ("signals", "a", "unit"), "robot.yaml", 7)
    assert str(error) == "robot.yaml:7: signals.a.unit: found 5, allowed is a text"
    assert str(ConfigError("is empty", file="robot.yaml")) == "robot.yaml: is empty"
    assert str(ConfigError("is empty")) == "is empty"
    assert isinstance(error, ValueError)


def test_what_is_left_out_has_its_default() -> None:
    assert read_parameters({"n": 3}, (NUMBER, FLAG)) == {"n": 3.0, "f": False}


def test_an_unknown_key_is_refused_with_a_hint_and_what_there_is() -> None:
    with pytest.raises(ConfigError) as raised:
        read_parameters({"warn_bellow": 1}, (Parameter("warn_below", float, None, ""), FLAG), ("a",), ("signals",))
    assert (
        str(raised.value) == "a.warn_bellow: unknown key; did you mean warn_below? allowed are warn_below, f, signals"
    )


def test_an_unknown_key_like_nothing_that_is_known_gets_no_hint() -> None:
    with pytest.raises(ConfigError) as raised:
        read_parameters({"xyz": 1}, (Parameter("warn_below", float, None, ""),))
    assert str(raised.value) == "xyz: unknown key; allowed are warn_below"


def test_sections_are_left_to_the_caller() -> None:
    assert read_parameters({"signals": 5}, (FLAG,), sections=("signals",)) == {"f": False}


@pytest.mark.parametrize(
    ("found", "problem"),
    [
        (None, "found nothing, allowed is a mapping of keys to values"),
        ([1], "found [1], allowed is a mapping of keys to values"),
        ({1: 2}, "found the key 1, allowed are keys that are texts (quote it)"),
        ({True: 2}, "found the key true, allowed are keys that are texts (quote it)"),
    ],
)
def test_a_mapping_of_texts_is_required(found: object, problem: str) -> None:
    with pytest.raises(ConfigError) as raised:
        require_mapping(found)
    assert str(raised.value) == problem


def test_long_finds_are_shortened_to_sixty_characters() -> None:
    assert describe("x" * 100) == "'" + "x" * 56 + "..."
    assert len(describe("x" * 100)) == 60


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
def test_unflatten_is_the_inverse_of_flatten(tree: Dict[str, Any]) -> None:
    assert unflatten(dict(flatten(tree))) == tree


@pytest.mark.parametrize("values", [{"a": 1, "a.b": 2}, {"a.b": 2, "a": 1}, {"a.b": 1, "a.b.c": 2}])
def test_a_name_that_is_a_value_and_a_parent_is_refused(values: Dict[str, int]) -> None:
    with pytest.raises(ConfigError):
        unflatten(values)
